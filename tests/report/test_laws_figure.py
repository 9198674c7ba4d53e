"""Laws side by side: loops of known area, residuals of known size, and a panel for each."""

from types import SimpleNamespace

import numpy as np
import xarray as xr

from jbw.law_comparison import compare
from jbw.law_comparison.compare import loops, residuals
from jbw.oscillator.laws import law_named
from jbw.report.laws import laws_figure

THETA = {"omega_n": 118.0, "zeta": 0.004, "power_loss": 120.0, "power_exponent": 0.7, "cubic": -2e7}
Y = 2e-3


def candidate(*laws):
    fit = SimpleNamespace(theta=THETA, residual=None)
    data = SimpleNamespace(held={}, labels=("low", "high"), runs=("a", "b"))
    return SimpleNamespace(laws=laws, fitted=SimpleNamespace(fit=fit, data=data))


NAMED = {"linear": candidate(), "masing_power + cubic": candidate("masing_power", "cubic")}


def test_loops_have_the_area_of_the_energy_that_is_lost():
    loop_data = loops(NAMED, Y)
    y = loop_data["displacement"].values
    assert not loop_data["force"].sel(law="linear").values.any()
    force = loop_data["force"].sel(law="masing_power + cubic").values
    area = np.sum(0.5 * (force + np.roll(force, -1)) * (np.roll(y, -1) - y))
    lost = float(law_named("masing_power").build(THETA).loop(Y).energy(Y))
    # The trapezium rule on two hundred points.
    np.testing.assert_allclose(abs(area), lost, rtol=1e-3)


def test_residuals_are_of_the_highest_level_and_of_the_size_of_the_error(monkeypatch):
    left = {"low": np.ones(300), "high": np.full(300, 0.2)}
    monkeypatch.setattr(compare.dataset, "residual_by_label", lambda *of: left)
    sizes = {"low": 10 * np.sqrt(300), "high": np.sqrt(300)}
    monkeypatch.setattr(compare.dataset, "size_by_label", lambda of: sizes)
    residual_data = residuals(NAMED, "b")
    assert residual_data.attrs["group"] == "high"
    assert residual_data.sizes["part"] == 100
    np.testing.assert_allclose(residual_data["left"].values, 0.2)
    assert residuals(NAMED, None).attrs["group"] == "low"  # the largest response


def test_every_part_of_a_comparison_has_a_panel():
    laws, runs = list(NAMED), ["a", "b"]
    band = np.ones((2, 3, 5)) * np.array([0.9, 1.0, 1.1])[None, :, None]
    curves = xr.Dataset(
        {name: (("law", "quantile", "amplitude"), band) for name in ("frequency", "damping")},
        {"law": laws, "amplitude": np.linspace(1e-4, 1e-3, 5)},
        {"y_fitted": 8e-4},
    )
    curves["hopeless"] = "law", [True, False]
    scores = xr.Dataset(
        {"error": (("law", "run"), [[0.1, 0.2], [0.01, 0.02]]), "line": ("run", [0.03, np.nan])},
        {"law": laws, "run": runs},
    )
    left = xr.Dataset({"left": (("law", "part"), np.ones((2, 9)))}, {"law": laws}, {"group": "b"})
    parts = {"/curves": curves, "/scores": scores, "/loops": loops(NAMED, Y), "/residuals": left}
    drawn = laws_figure(xr.DataTree.from_dict(parts))
    assert drawn.size == 5
    labels = drawn[0, 0].get_legend_handles_labels()[1]
    assert labels == ["linear, fit alone", "masing_power + cubic"]
    # As comparisons of earlier versions.
    del parts["/residuals"], parts["/loops"], curves["hopeless"]
    assert laws_figure(xr.DataTree.from_dict(parts)).size == 3
