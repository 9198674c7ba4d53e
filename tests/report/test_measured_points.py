"""Points of the records beside the backbone, against the readings in the tree."""

import numpy as np
import pytest
import xarray as xr

from jbw.report.charts import charts_of
from jbw.report.loops import backbone
from jbw.report.measured_points import measured_points
from jbw.report.opening import lead
from jbw.results.run import RunSummary

AMPLITUDE = np.linspace(1e-4, 4e-3, 40)
CURVE = xr.Dataset(
    {
        name: (("quantile", "amplitude"), np.stack([0.99 * x, x, 1.01 * x]))
        for name, x in (("frequency", 20 - 500 * AMPLITUDE), ("damping", 0.01 + AMPLITUDE))
    },
    {"amplitude": AMPLITUDE},
    {"y_fitted": 3e-3},
)


def readings(kind, y, frequency_hz, **attrs):
    y = np.atleast_1d(y)
    values = {"y": y, "frequency_hz": frequency_hz + 0 * y, "damping": 0.01 + y}
    variables = {name: ("reading", reading) for name, reading in values.items()}
    return xr.Dataset(variables, attrs={"test": kind, "kind": kind, "fitted": 1, **attrs})


def tree_of(**tests):
    groups = {f"/look/{name}": dataset for name, dataset in tests.items()}
    return xr.DataTree.from_dict({"/": xr.Dataset(), "/verification/backbone": CURVE, **groups})


def test_repeats_are_their_mean_with_their_scatter_and_a_decay_is_its_pieces():
    y = 1e-3 * np.array([0.99, 1.0, 1.01])
    sweep = readings("sweep", y, 19.0 + 1e3 * (y - 1e-3))
    decay = readings("decay", [2e-3, 1e-3, 2e-4, 5e-5], 19.5, fitted=0)
    repeats, pieces = measured_points(tree_of(sweep=sweep, decay=decay), CURVE)
    assert repeats.y == pytest.approx([1e-3])
    assert repeats.values["frequency"] == pytest.approx([19.0])
    # Of -0.01, 0 and 0.01 Hz, by hand.
    assert repeats.std["frequency"] == pytest.approx([0.01])
    assert (repeats.is_fitted, pieces.is_fitted) == (True, False)
    # The last lies below the curve's first amplitude.
    np.testing.assert_allclose(pieces.y, [2e-3, 1e-3, 2e-4])
    assert np.isnan(pieces.std["damping"]).all()


def test_other_modes_other_drives_and_larger_motion_are_left_out():
    posterior = xr.Dataset({"omega_n_voltage": (("chain", "draw"), np.ones((1, 2)))})
    tree = tree_of(
        noise=readings("noise", 2e-5, 20.0, drive="force"),  # however small
        other=readings("noise", 1e-3, 40.0),
        shaken=readings("sweep", 1e-3, 19.0, drive="voltage"),
        large=readings("sweep", 5e-3, 19.0),
    )
    tree["posterior"] = xr.DataTree(posterior)
    assert [reading.kind for reading in measured_points(tree, CURVE)] == ["noise"]
    assert measured_points(tree_of(), CURVE) == []


def test_every_kind_has_an_open_symbol_and_a_legend_entry():
    tree = tree_of(
        a=readings("noise", 2e-4, 20.0),
        b=readings("sweep", 1e-3, 19.5),
        c=readings("sweep", 2e-3, 19.0, fitted=0),
    )
    frequency, right = backbone(tree).flat
    labels = [text.get_text() for text in frequency.figure.legends[0].get_texts()]
    assert labels[2:] == ["noise", "sweep", "sweep, held out", "beyond what was fitted"]
    points = frequency.lines[1:]
    abscissae = [line.get_xdata().tolist() for line in points]
    assert abscissae == [pytest.approx([0.2]), pytest.approx([1.0]), pytest.approx([2.0])]
    assert {line.get_markerfacecolor() for line in points} == {"none"}
    assert [line.get_marker() for line in points] == ["o", "s", "s"]
    assert right.lines[1].get_ydata() == pytest.approx([1.02])  # per cent
    # Bars of one standard deviation to either side, 0.01 Hz, where there are repeats; in the
    # interactive page as well.
    y = 1e-3 * np.array([0.99, 1.0, 1.01])
    tree = tree_of(a=readings("sweep", y, 19.0 + 1e3 * (y - 1e-3)))
    (_, bars) = backbone(tree)[0, 0].collections
    np.testing.assert_allclose(bars.get_segments()[0], [[1.0, 18.99], [1.0, 19.01]], rtol=1e-9)
    names = [trace["name"] for trace in charts_of(tree)[0].lines]
    assert names == ["99 % band: parameters alone", "_scatter", "median of the model", "sweep"]


def test_the_picture_with_points_stands_first_where_there_are_any():
    mode = {"main": "joint", "steps": {"joint": {"parameters": {"zeta": {}}}}}
    assert lead(RunSummary.read(mode), ["amplitude", "backbone"]) == "amplitude"
    read = mode | {"look": {"tests": [{"test": "sweep"}]}}
    assert lead(RunSummary.read(read), ["amplitude", "backbone"]) == "backbone"
