"""The law without a form in a result: its group, its columns, its sentences."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from jbw.freeform.free_law import free_law
from jbw.measurement.readings.statement import RecordTable
from jbw.report.law_table import free_law_table
from jbw.report.messages import free_law as messages
from jbw.results.laws import StoredLaws
from jbw.study.free_group import (
    free_law_groups,
    free_law_record,
    free_law_sentences,
    gap_sentences,
)
from jbw.study.study import Study, load_study

HZ, ZETA, TOP = 20.0, 5e-3, 1e-3


@pytest.fixture(scope="module")
def law():
    y = TOP * np.geomspace(0.05, 1.0, 12)
    covariances = np.diag(np.full(12, 1e-3) ** 2), np.diag(np.full(12, 5e-5) ** 2)
    tables = [
        RecordTable(y[start:], np.full(12 - start, HZ), np.full(12 - start, ZETA),
              *(c[start:, start:] for c in covariances))
        for start in (0, 2, 4)
    ]  # fmt: skip
    return free_law(tables, named=False, num_particles=100)


def test_the_ends_of_a_group_and_the_words_of_scattered_readings():
    """Bands go to a third of the smallest amplitude; squares of four times are twice the errors."""
    y = np.array([0.1, 0.5])
    law = SimpleNamespace(
        rows=SimpleNamespace(y=y, inflation=4.0), rule="broken", masing=9.0, log_evidence={},
        bands=lambda at: (np.ones((3, len(at))), np.ones((3, len(at)))),
        least_damping=lambda at: np.ones(len(at)),
    )  # fmt: skip
    (group,) = free_law_groups(law).values()
    assert group["amplitude"].values[[0, -1]] == pytest.approx([0.1 / 3, 1.5], rel=1e-12)
    assert free_law_sentences(law)[-1] == messages.scattered(2.0)


def test_the_group_has_bands_over_the_readings_and_beyond(law):
    (group,) = free_law_groups(law).values()
    assert group["amplitude"].values[0] == pytest.approx(0.05 * TOP / 3)
    assert group["amplitude"].values[-1] == pytest.approx(3 * TOP)
    low, _, high = group["damping"].sel(amplitude=0.3 * TOP, method="nearest").values
    assert low < ZETA < high
    assert np.all(group["least_damping"] < ZETA * 1.05)
    assert free_law_groups(None) == {}


def test_the_backbone_has_its_columns_and_nothing_far_from_the_readings(law, toy):
    made = load_study(toy / "run").tree.to_dict()
    assert "/free_law" in made  # every identification of one mode with readings has it
    tree = xr.DataTree.from_dict({p: group for p, group in made.items() if p != "/free_law"})
    reach = float(tree["verification/backbone"]["amplitude"].values[-1])
    (group,) = free_law_groups(law).values()
    scaled = group.assign_coords(amplitude=group["amplitude"] * reach / TOP)
    plain = Study(tree, {}).backbone()
    assert not [column for column in plain if "free" in column]
    joined = xr.DataTree.from_dict({**made, "/free_law": scaled})
    frame = Study(joined, {}).backbone()
    near = frame[frame.index > 0.1 * reach]
    assert np.all(near["damping_free_low"] < near["damping_free_high"])
    assert near["frequency_hz_free"].to_numpy() == pytest.approx(HZ, rel=1e-3)
    below = frame[frame.index < 0.9 * 0.05 * reach / 3]
    assert below["damping_free"].isna().all()


def test_a_record_and_sentences_say_the_same_numbers(law):
    record = free_law_record(law)
    assert record["masing"] == law.rule
    assert max(record["log_evidence_difference"].values()) == 0.0
    sentences = free_law_sentences(law)
    assert "at 1 mm are " in sentences[0]
    assert len(sentences) >= 3
    table = free_law_table(StoredLaws.read({"free_law": record}))
    assert len(table.rows) == len(record["log_evidence"])
    assert free_law_sentences(None) == gap_sentences(None) == []
    assert free_law_table(StoredLaws()) is None
