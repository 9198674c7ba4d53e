"""Predictions from a run's posterior, against integrations and closed forms made without jbw."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from decays import OMEGA_N as DECAY_OMEGA_N
from decays import TRUTH as DECAY_TRUTH
from decays import decay_test
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from scipy.stats import norm

from jbw.campaign.loading import Campaign
from jbw.errors import ConfigError, DataError
from jbw.measurement.records import Record, Test
from jbw.study.basis import Request, basis_attrs, basis_of, seen_of
from jbw.study.identify import Study
from jbw.study.known_noise import ALIKE, LEFT_OUT, OWN, REPEATS, UNKNOWN
from jbw.study.planned import planned_sweep, planned_tones
from jbw.study.predicting import predict, row_of, warnings_of
from jbw.study.reach import mark_reach

FS, SIZE = 256.0, 768
OMEGA_N, ZETA, GAIN = 118.0, 0.01, 15.0
JOINT = {"omega_n": OMEGA_N, "zeta": ZETA, "alpha": 3000.0, "delta": 400.0, "gamma": 150.0}
SILENT = {**JOINT, "alpha": 1e-6, "delta": 1.0, "gamma": 1.0}
UNITS = {"input": "V", "velocity": "m/s"}
Z = norm.ppf(0.995)


def burst(level):
    """A sweep through the resonance that begins and ends at rest, as a function of time."""
    span = SIZE / FS

    def u(t):
        phase = 2 * np.pi * (14.0 * t + 4.0 / span * t**2)
        return level * np.sin(np.pi * np.clip(t / (0.8 * span), 0, 1)) ** 2 * np.sin(phase)

    return u


def integrated(u, joint, t):
    """Displacement and velocity by DOP853 on Eqs. (1) and (2), the law at any nu, here 1."""
    nu = 1.0
    omega_n, zeta, alpha, delta, gamma = joint.values()

    def rate(time, state):
        y, v, z = state
        dz = alpha * v - gamma * abs(v) * abs(z) ** (nu - 1) * z - delta * v * abs(z) ** nu
        return v, GAIN * u(time) - 2 * zeta * omega_n * v - (omega_n**2 - alpha) * y - z, dz

    found = solve_ivp(rate, (0, t[-1]), (0, 0, 0), "DOP853", t, rtol=1e-9, atol=1e-12)
    return found.y[0], found.y[1]


def a_test(level, joint=SILENT, noise=0.0, repeats=1, kind="sweep", name="sweep", unit="V"):
    rng = np.random.default_rng(5)
    t = np.arange(SIZE) / FS
    source = burst(level)(t)
    if joint is SILENT:
        system = ([GAIN, 0.0], [1.0, 2 * ZETA * OMEGA_N, OMEGA_N**2])
        fine = np.arange(32 * SIZE) / (32 * FS)
        velocity = lsim(system, burst(level)(fine), fine)[1][::32]
    else:
        velocity = integrated(burst(level), joint, t)[1]
    role = "force" if unit == "N" else "input"
    records = tuple(
        Record(
            FS,
            {role: source, "velocity": velocity + noise * rng.standard_normal(SIZE)},
            {role: unit, "velocity": "m/s"},
        )
        for _ in range(repeats)
    )
    return Test(kind, records, name, level=level)


def a_tree(draws, *, y_peak=1.0, noise=None, seen=(), substeps=8, held=None):
    variables: dict[str, Any] = {
        name: (("chain", "draw"), np.atleast_2d(values)) for name, values in draws.items()
    }
    if noise is not None:
        shape = next(iter(variables.values()))[1].shape
        stacked = np.broadcast_to(list(noise.values()), (*shape, len(noise)))
        variables["noise_std"] = (("chain", "draw", "level"), stacked)
    posterior = xr.Dataset(variables, {"level": list(noise)} if noise else {})
    tree = xr.DataTree.from_dict({"/": xr.Dataset(), "/posterior": posterior})
    tests = json.dumps({test.name: seen_of(test)._asdict() for test in seen})
    tree.attrs.update(y_peak=y_peak, tests=tests, substeps=substeps, held=json.dumps(held or {}))
    return tree


def same(joint, count=4, **more):
    return {name: np.full(count, value) for name, value in {**joint, "gain": GAIN, **more}.items()}


def spread(relative=0.01, count=400):
    """Draws of a linear oscillator whose gain alone is uncertain, by a Gaussian's quantiles."""
    unit = norm.ppf((np.arange(count) + 0.5) / count)
    return {**same(SILENT, count), "gain": GAIN * (1 + relative * unit / unit.std())}


def test_the_truth_predicts_an_integrated_record():
    test = a_test(0.3, JOINT)
    y, _ = integrated(burst(0.3), JOINT, np.arange(SIZE) / FS)
    found = predict(basis_of(a_tree(same(JOINT), y_peak=np.abs(y).max())), test)
    # The joint slips: 5 % of its stiffness are lost at this displacement.
    assert JOINT["delta"] * np.abs(y).max() > 0.5
    # Eight steps a sample of a step that is of fourth order in the input leave 1.3e-7.
    assert found.attrs["nrmse"] < 1e-6
    np.testing.assert_allclose(found.attrs["y_peak"], np.abs(y).max(), rtol=1e-6)
    assert found.attrs["extrapolation"] == pytest.approx(1.0, rel=1e-6)
    assert warnings_of(found) == []
    assert {"model_magnitude", "measured_magnitude"} <= set(found.data_vars)  # in frequency too
    assert found["model_band"].attrs["units"] == "m/s"


def test_a_gaussian_gain_has_the_band_of_its_closed_form():
    test, sigma = a_test(0.1, noise=0.02, repeats=4), 0.02
    clean = a_test(0.1).records[0].channels["velocity"]
    tree = a_tree(spread(), noise={"sweep": sigma}, seen=[test])
    found = predict(basis_of(tree), test, Request(400))
    low, middle, high = found["predictive_band"].values
    width = Z * np.sqrt((0.01 * clean) ** 2 + sigma**2)
    np.testing.assert_allclose(high - middle, width, rtol=1e-3)
    np.testing.assert_allclose(middle - low, width, rtol=1e-3)
    # Quantiles of 400 draws at the tail: off by a tenth of the spacing of the last two.
    alone = found["model_band"].values
    np.testing.assert_allclose(alone[2] - alone[1], Z * 0.01 * np.abs(clean), rtol=0.05, atol=1e-6)
    assert found.attrs["noise"] == OWN
    # Four standard errors of a share; the mean of the repeats is off by half the noise.
    count = found.attrs["num_values"]
    assert count == 4 * SIZE
    assert abs(found.attrs["coverage"] - 0.99) < 4 * np.sqrt(0.99 * 0.01 / count)
    left = 0.5 * sigma * np.sqrt(SIZE)
    expected = left / np.hypot(left, np.linalg.norm(clean))
    assert found.attrs["nrmse"] == pytest.approx(expected, rel=4 / np.sqrt(2 * SIZE))


def test_noise_is_of_its_kind_or_said_not_to_be_known():
    test = a_test(0.01, noise=0.02, name="new")
    fitted = a_test(0.02, name="old")
    basis = basis_of(a_tree(same(SILENT), noise={"old": 0.02}, seen=[fitted]))
    alike = predict(basis, test)
    assert (alike.attrs["noise"], alike.attrs["noise_std"]) == (ALIKE, 0.02)
    other = predict(basis, a_test(0.01, name="new", kind="multisine"))
    assert other.attrs["noise"] == UNKNOWN
    assert "predictive_band" not in other
    repeats = predict(basis, a_test(0.01, noise=0.02, repeats=3, name="new", kind="multisine"))
    assert repeats.attrs["noise"] == REPEATS
    assert repeats.attrs["noise_std"] == pytest.approx(0.02, rel=0.1)
    without = predict(basis, test, Request(noise=False))
    assert without.attrs["noise"] == LEFT_OUT
    assert "predictive_band" not in without
    assert without.attrs["coverage"] < 0.01  # draws that agree have no width


def test_a_level_beyond_what_was_fitted_is_flagged():
    test = a_test(0.02, name="strong")
    known = predict(basis_of(a_tree(same(SILENT))), a_test(0.01)).attrs["y_peak"][1]
    found = predict(basis_of(a_tree(same(SILENT), y_peak=known)), test)
    assert found.attrs["extrapolation"] == pytest.approx(2.0, rel=1e-9)  # a linear oscillator
    (said,) = warnings_of(found)
    assert all(part in said for part in ("`strong`", "2 times", "add a test of that level"))
    assert row_of(found)["beyond"]


def test_a_sweep_far_from_the_mode_is_said_to_hardly_move_it():
    basis = basis_of(a_tree(same(SILENT), seen=[a_test(0.01)]))
    found = predict(basis, planned_sweep(basis, (60.0, 90.0), 0.1, 3.0, FS))
    assert found.attrs["input_near_mode"] < 0.01
    assert "hardly moves the mode" in " ".join(warnings_of(found))
    assert not {"measured", "measured_band"} & set(found.data_vars)
    assert "coverage" not in found.attrs
    assert found.attrs["level_unit"] == "V"  # as the run's source


def receptance(omega):
    return GAIN / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)


def test_planned_tones_are_those_of_the_transfer_function():
    basis = basis_of(a_tree(spread(), seen=[a_test(0.01)]))
    freq = (15.0, 18.0, 19.0)
    found = predict(basis, planned_tones(basis, freq, 0.2))
    omega = 2 * np.pi * np.array(freq)
    velocity = 0.2 * omega * np.abs(receptance(omega))
    # The median of an even number of draws lies between two of them, the joint carries 1e-6 N/kg.
    np.testing.assert_allclose(found["model_magnitude"][1], velocity, rtol=1e-4)
    wide = found["model_magnitude"].values
    np.testing.assert_allclose(wide[2] - wide[1], Z * 0.01 * velocity, rtol=0.05)
    turned = np.angle(1j * receptance(omega))
    np.testing.assert_allclose(found["model_phase"][1], turned, atol=1e-4)
    assert found.attrs["y_peak"][1] == pytest.approx(np.max(velocity / omega), rel=1e-4)


def test_a_tone_is_predicted_where_its_measurement_lies_far_off():
    omega, level = 2 * np.pi * 18.2, 0.05
    t = np.arange(2560) / 256.0
    y, _ = integrated(lambda time: level * np.cos(omega * time), JOINT, t)
    late = t > 8.0  # exp(-zeta omega_n 8 s) = 8e-5
    basis_functions = np.stack([np.cos(omega * t[late]), -np.sin(omega * t[late])], axis=1)
    real, imaginary = np.linalg.lstsq(basis_functions, y[late])[0]
    truth = complex(real, imaginary)
    off = 0.6 * truth * np.exp(0.3j)
    channels = {
        "frequency": np.array([18.2]),
        "input": np.array([level]),
        "displacement": np.array([abs(off)]),
        "phase": np.array([np.angle(off)]),
    }
    units = {"frequency": "Hz", "input": "V", "displacement": "m", "phase": "rad"}
    test = Test("frf", (Record(np.nan, channels, units),), "curve", level=level)
    found = predict(basis_of(a_tree(same(JOINT))), test)
    # Four odd harmonics balanced leave out 1e-6; the transient leaves 1e-4 of the first period.
    assert float(found["model_magnitude"][1, 0]) == pytest.approx(abs(truth), rel=2e-4)
    assert found.attrs["nrmse"] == pytest.approx(abs(truth - off) / abs(off), rel=2e-3)
    assert found.attrs["y_peak"][1] == pytest.approx(abs(truth), rel=2e-4)


@pytest.mark.slow  # the steady solver compiles for half a minute
def test_periods_of_a_multisine_are_those_of_the_transfer_function():
    size, rng = 256, np.random.default_rng(3)
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / FS)
    lines = np.where((omega > 30) & (omega < 300), np.exp(2j * np.pi * rng.random(129)), 0)
    u, y = np.fft.irfft(lines, size), np.fft.irfft(lines * receptance(omega), size)
    v = np.fft.irfft(lines * 1j * omega * receptance(omega), size)
    noisy = np.tile(v, 4) + 1e-3 * v.std() * rng.standard_normal(4 * size)
    record = Record(FS, {"input": np.tile(u, 4), "velocity": noisy}, UNITS)
    test = Test("multisine", (record,), "periods", level=1.0, periods=4)
    found = predict(basis_of(a_tree(same(SILENT), y_peak=np.abs(y).max())), test)
    # The mean of four periods of noise 1e-3 is off by 5e-4; 256 samples say so to 4 %.
    assert found.attrs["nrmse"] == pytest.approx(5e-4, rel=0.2)
    assert found.attrs["coverage"] > 0.96
    assert found.attrs["noise"] == REPEATS
    assert found.attrs["extrapolation"] == pytest.approx(1.0, rel=1e-3)


def test_a_push_is_predicted_in_closed_form():
    y = np.linspace(0.0, 0.01, 401)
    decay = JOINT["gamma"] + JOINT["delta"]
    z = JOINT["alpha"] / decay * (1 - np.exp(-decay * y))
    force = ((OMEGA_N**2 - JOINT["alpha"]) * y + z) / 0.5
    channels = {"displacement": y, "restoring_force": force}
    record = Record(100.0, channels, {"displacement": "m", "restoring_force": "N"})
    test = Test("loop", (record,), "pushed", level=0.01)
    draws = same(JOINT)
    del draws["gain"]
    found = predict(basis_of(a_tree(draws, held={"gain": 0.5}, y_peak=0.004)), test)
    assert found.attrs["nrmse"] < 1e-12
    np.testing.assert_allclose(found.attrs["y_peak"], 0.01)
    assert found.attrs["extrapolation"] == pytest.approx(2.5)


def test_decays_are_predicted_from_their_first_half_second():
    square, share = DECAY_OMEGA_N**2, DECAY_TRUTH["share"]
    joint = {
        "omega_n": DECAY_OMEGA_N,
        "zeta": DECAY_TRUTH["zeta"],
        "alpha": share * square,
        "delta": DECAY_TRUTH["softening"] / share,
        "gamma": DECAY_TRUTH["opening"] / share,
    }
    tree = a_tree({name: np.full(8, value) for name, value in joint.items()}, y_peak=1.5e-3)
    test = decay_test(states=((2.0e-3, 0.0), (0.3e-3, -0.2)), noise=1e-5)
    found = predict(basis_of(tree), test, Request(8))
    assert found.sizes["record"] == 2
    # White noise of 1e-5 m/s through the band is 2e-5 of the first swings; the initial state is
    # read from half a second, 10 periods, with the second mode 60 dB down.
    assert found.attrs["nrmse"] < 2e-3
    assert found.attrs["noise"] == UNKNOWN
    assert "predictive_band" not in found
    # From 2 mm and from hypot(0.3 mm, 0.2 m/s / omega_n) = 1.6 mm; a quarter second later, less.
    rate = DECAY_TRUTH["zeta"] * DECAY_OMEGA_N
    assert 1.5e-3 < found.attrs["y_peak"][1] < 2e-3 * np.exp(-0.25 * rate)
    assert found.attrs["extrapolation"] == pytest.approx(found.attrs["y_peak"][2] / 1.5e-3)


def test_a_source_in_another_unit_is_refused_unless_its_gain_is_stated():
    basis = basis_of(a_tree(same(SILENT), seen=[a_test(0.01)]))
    test = a_test(0.01, unit="N")
    with pytest.raises(DataError, match=r"`sweep` has its source in N, but .* per V") as caught:
        predict(basis, test)
    assert "modal_mass" in caught.value.remedy
    assert predict(basis, test, Request(gain=GAIN)).attrs["nrmse"] < 1e-3


def test_what_is_missing_is_named():
    draws = same(SILENT)
    del draws["gain"]
    with pytest.raises(DataError, match="lacks gain"):
        predict(basis_of(a_tree(draws)), a_test(0.01))
    with pytest.raises(ConfigError, match="at least 2"):
        predict(basis_of(a_tree(same(SILENT))), a_test(0.01), Request(1))
    with pytest.raises(DataError, match="no group /posterior"):
        basis_of(xr.DataTree())
    with pytest.raises(ConfigError, match="below fs/2"):
        planned_sweep(basis_of(a_tree(draws)), (10.0, 500.0), 0.1, 1.0, FS)
    with pytest.raises(ConfigError, match="`level` must be positive"):
        planned_tones(basis_of(a_tree(draws)), (10.0,), -1.0)


def test_a_study_predicts_by_name_or_by_test(tmp_path):
    test = a_test(0.01)
    campaign = Campaign("made up", tmp_path, (test,))
    nothing: Any = None  # predictions read the tree alone
    study = Study(campaign, nothing, a_tree(same(SILENT), noise={"sweep": 1e-3}, seen=[test]), {})
    by_name = study.predict("sweep")
    assert {"measured", "measured_band", "model_band", "predictive_band"} <= set(by_name.data_vars)
    xr.testing.assert_identical(by_name, study.predict(test))
    assert "predictive_band" not in study.predict(test, noise=False)
    with pytest.raises(ConfigError, match="Argument `test` must name") as caught:
        study.predict("swep")
    assert "sweep" in caught.value.remedy


def test_a_run_writes_what_predictions_read_back(tmp_path):
    test = a_test(0.01)
    data = SimpleNamespace(scatter=np.array([0.3, 1e-3]), parts=())
    found: Any = SimpleNamespace(
        main=SimpleNamespace(held={"gain": 0.5}),
        data=data,
        decay_data=SimpleNamespace(worth=0.7, shift_std=0.02),
    )
    tree = a_tree(same(SILENT))
    tree.attrs.update(basis_attrs((test,), found))
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as stored:
        basis = basis_of(stored.load())
    assert basis.held == {"gain": 0.5}
    assert basis.seen == {"sweep": ("sweep", "V", "velocity")}
    assert basis.scatter == (0.3, 1e-3)
    assert basis.decay_facts == {"worth": 0.7, "shift_std": 0.02}


def test_held_out_tests_of_a_run_say_how_far_they_reach():
    quantiles = ("quantile", "time")
    sweep = xr.Dataset(
        {"model_band": (quantiles, 0.5 * np.ones((3, 4)))},
        attrs={"fitted": 0, "response": "velocity"},
    )
    fitted = sweep.assign_attrs(fitted=1)
    held = xr.Dataset(
        {"model_magnitude": (("quantile", "freq"), np.ones((3, 2)))},
        {"freq": [10.0, 20.0]},
        {"fitted": 0, "quantity": "force", "held": "acceleration", "level": 8.0},
    )
    groups = {
        "/verification/sweep/a": sweep,
        "/verification/sweep/b": fitted,
        "/verification/curve/c": held,
    }
    mark_reach(groups, [], 2e-3, 100.0)
    assert sweep.attrs["extrapolation"] == pytest.approx(0.5 / 100.0 / 2e-3)
    assert "extrapolation" not in fitted.attrs
    assert held.attrs["extrapolation"] == pytest.approx(8.0 / (20 * np.pi) ** 2 / 2e-3)
