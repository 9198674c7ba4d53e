"""The list of hypotheses, and the table of it in the documentation."""

from pathlib import Path

import pytest

from jbw.measurement.faults.hypotheses import HYPOTHESES
from jbw.measurement.faults.hypothesis import Hypothesis

PAGE = Path(__file__).parents[2] / "docs" / "theory" / "readings.md"
# What a table calls the record of a test that a hypothesis offers.
SEEN_IN = {"in_loop": {"loop"}, "suspects": {"fit"}, "causes": {"decay", "sweep"}}


def rows():
    """Name and records of every row of the table of hypotheses."""
    table = PAGE.read_text(encoding="utf-8").partition("| hypothesis |")[2].partition("\n\n")[0]
    cells = [[x.strip() for x in line.split("|")] for line in table.splitlines()[2:]]
    return {name: set(records.split(", ")) for _, name, records, *_ in cells}


def test_the_table_has_a_row_for_each_hypothesis_in_its_order():
    assert list(rows()) == [one.name for one in HYPOTHESES]


@pytest.mark.parametrize("one", HYPOTHESES, ids=lambda one: one.name)
def test_the_table_has_the_records_that_a_hypothesis_reads(one):
    for offered, records in SEEN_IN.items():
        is_offered = getattr(type(one), offered) is not getattr(Hypothesis, offered)
        seen = bool(records & rows()[one.name])
        # A reading may show a fault without a joint fit, or with a check of the samples.
        assert seen == is_offered or (seen and offered == "causes"), (one.name, offered)
