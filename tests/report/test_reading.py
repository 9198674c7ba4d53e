"""Densities, extremes, phases and numbers against closed forms."""

import json

import numpy as np
import pytest
import xarray as xr

from jbw.errors import DataError
from jbw.report.loops import strokes
from jbw.report.posterior import marginal_density
from jbw.report.records import extremes, resonance_slice
from jbw.report.responses import relative_to_median, resonance_window
from jbw.report.result import parameters, read_result, wrap_band, wrap_degrees
from jbw.report.tables import table_of_tests
from jbw.report.text import number, percent, seconds, step_name, symbol, unit_text
from jbw.results.run import RunSummary
from jbw.verification.predict import warnings_of


def test_density_of_normal_draws_is_the_normal_density():
    draws = np.random.default_rng(1).standard_normal(20_000)
    points, density = marginal_density(draws, None)
    normal = np.exp(-0.5 * points**2) / np.sqrt(2 * np.pi)
    # The kernel widens the peak by h^2 = 1.6 % (bias 0.003) and the draws scatter by 0.006.
    np.testing.assert_allclose(density, normal, atol=0.02)
    np.testing.assert_allclose(np.trapezoid(density, points), 1.0, atol=1e-3)


def test_density_of_uniform_draws_does_not_fall_at_the_bounds():
    draws = np.random.default_rng(2).uniform(2.0, 6.0, 20_000)
    points, density = marginal_density(draws, (2.0, 6.0))
    # Reflection keeps all of the mass inside; 0.25 with the draws' scatter of some percent.
    np.testing.assert_allclose(density, 0.25, atol=0.04)
    assert points[0] >= 2.0
    assert points[-1] <= 6.0


@pytest.mark.parametrize("draws", [np.full(50, 3.0), np.zeros((4, 5)), np.array([1.0, np.nan])])
def test_density_of_frozen_or_broken_draws_is_finite(draws):
    points, density = marginal_density(draws, None)
    assert np.all(np.isfinite(points))
    assert np.all(np.isfinite(density))


def test_extremes_hold_every_sample():
    time = np.arange(10_007) / 100.0
    signal = np.sin(37.0 * time)
    at, low, high = extremes(time, signal, signal, count=100)
    assert at.size <= 100
    assert low.min() == signal.min()
    assert high.max() == signal.max()


def test_the_resonance_is_cut_out_by_periods():
    # 5 Hz: six periods around the swell at 4 s are 1.2 s.
    time = np.arange(10_000) / 1000.0
    signal = np.exp(-(((time - 4.0) / 1.5) ** 2)) * np.cos(2 * np.pi * 5.0 * time)
    part = resonance_slice(signal)
    assert part.start < 4000 < part.stop
    # The crossings near the swell are counted to within one or two of five.
    assert 0.9 < (part.stop - part.start) / 1000.0 < 1.6


def test_resonance_window_of_a_flat_and_of_a_peaked_curve():
    freq = np.linspace(0.0, 10.0, 1001)
    peak = 1.0 / (1.0 + ((freq - 4.0) / 0.1) ** 2)
    low, high = resonance_window(freq, peak, depth=0.5)
    # Half of the Lorentzian is one half-width off, on a grid of 0.01.
    np.testing.assert_allclose([low, high], [3.9, 4.1], atol=0.011)
    assert resonance_window(freq, np.ones_like(freq)) == (0.0, 10.0)


def test_phases_do_not_jump():
    phase = np.radians([-179.0, 179.0, -181.0, 10.0])
    np.testing.assert_allclose(wrap_degrees(phase), [-179.0, -181.0, -181.0, 10.0], atol=1e-9)
    band = wrap_band(np.radians([[170.0], [179.0], [188.0]]))
    np.testing.assert_allclose(band[:, 0], [-190.0, -181.0, -172.0], atol=1e-9)


def test_relative_kernel_is_one_at_its_own_median(tree):
    kernel = tree["verification/h3"].to_dataset()
    relative = relative_to_median(kernel, "nuts")
    np.testing.assert_allclose(relative["nuts_magnitude"][1], 1.0, rtol=1e-14)
    np.testing.assert_allclose(relative["nuts_phase"][1], 0.0, atol=1e-14)
    # The toy data are turned by 0.12 rad, with 5 % of noise over 8 repeats.
    np.testing.assert_allclose(relative["measured_phase"].mean("repeat"), 0.12, atol=0.08)


def test_strokes_walk_down_and_up_the_loop():
    y = np.cos(np.linspace(0.3, 0.3 + 2 * np.pi, 64, endpoint=False))
    down, up = strokes(y)
    assert np.all(np.diff(y[down]) < 0)
    assert np.all(np.diff(y[up]) > 0)
    assert set(down) | set(up) == set(range(64))


def test_parameters_of_an_array_carry_their_level(tree):
    by_name = {
        parameter.name: parameter for parameter in parameters(tree["posterior"].to_dataset())
    }
    assert {"noise_std[0.05]", "noise_std[0.2]"} <= set(by_name)
    assert by_name["alpha"].box == (425.0, 575.0)
    assert by_name["alpha"].truth == 497.40
    assert by_name["noise_std[0.2]"].truth is None


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (340.2134, 2.41, "340.2"),
        (340.2134, 24.1, "340"),
        (0.00443712, 2.1e-5, "0.004437"),
        (6.8e-9, 1.2e-10, "6.80×10⁻⁹"),
        (-1.5, 0.1, "−1.50"),
        (2.0e7, 1.0e6, "2.00×10⁷"),
        (0.0, 0.1, "0.00"),
        (0.3, 40.0, "0"),
        (None, 1.0, "–"),
        (float("nan"), None, "–"),
        (float("inf"), None, "∞"),
        (118.1239, None, "118"),
    ],
)
def test_numbers_show_two_digits_of_their_sd(value, sd, text):
    assert number(value, sd) == text


def test_words():
    assert symbol("omega_n") == "ωₙ"
    assert symbol("noise_std[0.05]") == "noise sd at 0.05"
    assert symbol("y_0") == "y_0"
    assert unit_text("1/(m s^2)") == "m⁻¹ s⁻²"
    # Old runs, in the dialects of their time.
    assert unit_text("m^-2 s^6") == "s⁶/m²"
    assert unit_text("N kg-1 per unit of input") == "N/kg per unit of input"
    assert unit_text("1") == ""
    assert percent(0.0123) == "1.23 %"
    assert seconds(83.4) == "1 min 23 s"
    assert step_name("third_order_nuts") == "Step 3: third-order kernel, NUTS"


def test_a_result_is_read_back(tree, summary, tmp_path):
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    small = xr.DataTree.from_dict({"/posterior": tree["posterior"].to_dataset()})
    small.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    read_summary, read_tree = read_result(tmp_path)
    assert read_summary.plain() == summary
    xr.testing.assert_equal(read_tree["posterior"].to_dataset(), small["posterior"].to_dataset())


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(DataError, match=r"no summary\.json"):
        read_result(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    (tmp_path / "posterior.nc").write_bytes(b"nothing")
    with pytest.raises(DataError, match="cannot be read"):
        read_result(tmp_path)


@pytest.mark.parametrize(("reach", "says"), [(1.04, ""), (1.06, "1.1 times")])
def test_a_twentieth_beyond_the_fitted_displacement_is_as_good_as_within(reach, says):
    """A peak is known to some per cent; from 1.05 on the table and a warning say so."""
    row = {"kind": "sweep", "fitted": False, "extrapolation": reach, "nrmse": 0.1, "coverage": 0.9}
    shown = table_of_tests(RunSummary.read({"predictions": {"strong": row}}), xr.DataTree())
    (used,) = (c.cell(shown.rows[0]).text for c in shown.columns if c.heading == "remark")
    assert says in used
    assert [section.heading for section in shown.sections] == ["Held out (1 test)"]
    assert ("times" in used) == (reach > 1.05)
    attrs = {"test": "strong", "extrapolation": reach, "y_peak": [0.9, 1.0, reach]}
    warnings = warnings_of(xr.Dataset(attrs={**attrs, "y_peak_fitted": 1.0}))
    assert bool(warnings) == (reach > 1.05)
