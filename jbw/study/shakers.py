"""What a test's record says of its shaker, in a sentence, for `jbw check`."""

from jbw.campaign.tables import TestSpec
from jbw.errors import JbwError
from jbw.identification.shaker import read_shaker, shaker_sentence
from jbw.measurement.records import Record, Test
from jbw.report.messages.study import no_shaker


def read_of_shaker(spec: TestSpec, record: Record) -> str:
    """The shaker's attachment and the mode that it moves; or why they cannot be read."""
    test = Test(
        spec.kind, (record,), name=spec.name, band_hz=spec.band, periods=spec.periods,
        settle=spec.settle,
    )  # fmt: skip
    try:
        return shaker_sentence(spec.name, read_shaker(test))
    except JbwError as error:
        return no_shaker(spec.name, " ".join(str(error).split()))
