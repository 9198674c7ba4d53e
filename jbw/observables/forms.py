"""Grouping of tests that can be reduced together: equal sampling rate, response and length."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from jaxtyping import Float

from jbw.errors import DataError
from jbw.measurement.records import Test

Form = tuple[float, str, int, int, str, *tuple[float, ...]]


def first_alike(sources: Float[np.ndarray, "level time"]) -> Iterator[int]:
    """Yield, for each level's source signal, the index of the first level with an equal signal."""
    seen: dict[bytes, int] = {}
    for i, source in enumerate(sources):
        yield seen.setdefault(source.tobytes(), i)


def form_of(test: Test) -> Form:
    """Return the properties by which tests are grouped, such as sampling rate and length."""
    record = test.records[0]
    skipped = round(test.settle * record.fs)
    band = test.band_hz or ()
    return record.fs, record.response, record.num_samples, skipped, test.residuals, *band


def common_form(tests: Sequence[Test]) -> Form:
    """Return the common properties of tests that are reduced together; raise if they differ."""
    forms = {form_of(test) for test in tests}
    if len(forms) != 1:
        raise DataError(
            "Tests reduced together must share sampling frequency, response, length, samples "
            f"skipped, `residuals` and band, but found {sorted(forms)}.",
            remedy="Reduce the tests separately, or cut the records to the same length.",
        )
    return forms.pop()


def by_form(tests: Sequence[Test]) -> list[list[Test]]:
    """Return the tests grouped by equal properties; each group is reduced together."""
    return [list(same) for _, same in groupby(sorted(tests, key=form_of), key=form_of)]
