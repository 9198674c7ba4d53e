"""Which tests a figure draws of many, and that the others are not lost."""

import numpy as np
import pytest
import xarray as xr

from jbw.errors import ConfigError, DataError
from jbw.report.chosen import chosen_names, selected
from jbw.report.figures import FIGURES
from jbw.report.responses import softening
from jbw.report.tables import every_test, table_of_tests, with_records
from jbw.results.run import RunSummary


def campaign(*tests):
    """Tests of kind sweep, by name, level and whether anything of them was fitted."""
    return [
        (name, xr.Dataset(attrs={"kind": "sweep", "level": level, "fitted": fitted}))
        for name, level, fitted in tests
    ]


DAYS = campaign(
    *((f"{level}V_day{day}", level, int(level != 0.1))
      for level in (0.05, 0.1, 0.2) for day in (1, 2, 3)),
)  # fmt: skip


def test_the_ends_of_what_was_fitted_and_a_held_out_test_stand_for_all():
    assert chosen_names(DAYS) == {"0.05V_day1", "0.1V_day1", "0.2V_day1"}


def test_few_tests_are_all_drawn_and_leave_no_rest():
    few = DAYS[:3]
    assert selected(few, "chosen") == few
    with pytest.raises(DataError, match="All tests of this kind are already drawn"):
        selected(few, "rest")


def test_chosen_and_rest_are_all_in_their_order():
    chosen, rest = selected(DAYS, "chosen"), selected(DAYS, "rest")
    assert len(chosen) == 3
    assert sorted([*chosen, *rest], key=lambda pair: pair[0]) == selected(DAYS, "all")
    assert [name for name, _ in rest] == [name for name, _ in DAYS if name not in dict(chosen)]


def test_without_a_held_out_test_further_levels_fill_up():
    fitted = campaign(*((f"{level}", level, 1) for level in (1.0, 2.0, 3.0, 4.0)))
    assert {"1.0", "4.0"} < chosen_names(fitted)
    assert len(chosen_names(fitted)) == 3


def test_another_part_is_refused():
    with pytest.raises(ConfigError, match="`part` must be 'chosen'"):
        selected(DAYS, "some")


def test_figures_of_many_tests_draw_three_and_the_rest_apart(tree):
    frf_tests = tree["verification/frf"].children
    (name, first), *_ = frf_tests.items()
    groups = {f"/verification/frf/{name}_{i}": first.to_dataset() for i in range(5)}
    many = xr.DataTree.from_dict(groups)
    assert FIGURES["figure_11"](many).size == 3 * 3
    assert sum(ax.get_visible() for ax in FIGURES["figure_11"](many, part="rest").flat) == 3 * 2
    shown = FIGURES["figure_11"](many, part="all").flat
    assert sum(ax.get_visible() for ax in shown) == 3 * 5


def test_one_curve_a_level_is_the_mean_of_its_tests_and_their_range(tree):
    """Two tests at half and at one and a half times a curve: their mean is the curve itself."""
    (name, first), *_ = tree["verification/frf"].children.items()
    test = first.to_dataset()
    pair = {}
    for i, factor in enumerate((0.5, 1.5)):
        scaled = test.assign(measured_magnitude=factor * test["measured_magnitude"])
        pair[f"/verification/frf/{name}_{i}"] = scaled
    ax = softening(xr.DataTree.from_dict(pair))
    curve, peak = ax.lines
    assert "2 tests, peak at" in curve.get_label()
    mean = test["measured_magnitude"].mean("repeat")
    shown = (
        np.isin(mean[mean.dims[0]].values, curve.get_xdata())
        if mean.dims[0] in mean.coords
        else slice(None)
    )
    np.testing.assert_allclose(curve.get_ydata(), mean.values[shown], rtol=1e-12)
    (band,) = ax.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(1.5 * float(test["measured_magnitude"].max()))
    assert peak.get_ydata()[0] == pytest.approx(float(mean.max()))


def test_one_list_tells_of_every_test_whether_it_was_fitted():
    summary = {
        "tests": [
            {"test": "weak", "kind": "noise", "fitted": 1, "repeats": 1},
            {"test": "tone", "kind": "tones", "fitted": 0, "repeats": 1},
        ],
        "predictions": {"weak": {"nrmse": 0.1, "fitted": True}, "family of tones": {"nrmse": 0.2}},
    }
    rows = every_test(RunSummary.read(summary))
    assert [row.test for row in rows] == ["weak", "tone", "family of tones"]
    assert rows[0].nrmse == 0.1
    assert rows[0].fitted == 1
    old = xr.DataTree.from_dict(
        {"/look/weak": xr.Dataset(attrs={"test": "weak", "kind": "noise", "fitted": 0})}
    )
    (read,) = every_test(RunSummary.read({}), old)
    assert read.fitted == 0


def test_records_of_decays_stand_in_the_place_of_their_test():
    """A test of one record without a number of its own stays, and so does one without a row."""
    of_decays = {"kind": "decay", "fitted": 1, "run": "monday"}
    summary = {
        "tests": [
            {"test": "soft", "repeats": 2, **of_decays},
            {"test": "softer", "repeats": 1, **of_decays},
            {"test": "hard", "repeats": 3, **of_decays},
        ],
        "predictions": {
            name: {"kind": "decay", "fitted": True, "nrmse": 0.01}
            for name in ("soft 1", "soft 2", "softer")
        },
    }
    rows = with_records(every_test(RunSummary.read(summary)))
    assert [row.test for row in rows] == ["softer", "hard", "soft 1", "soft 2"]
    assert {row.run for row in rows} == {"monday"}
    assert rows[-1].repeats is None
    (section,) = table_of_tests(RunSummary.read(summary)).sections
    assert section.heading == "Fitted (4 records)"
