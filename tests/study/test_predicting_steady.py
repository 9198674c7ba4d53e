"""Predictions of steady motion, loops and decays, against answers made without jbw."""

import numpy as np
import pytest
import xarray as xr
from decays import OMEGA_N as DECAY_OMEGA_N
from decays import TRUTH as DECAY_TRUTH
from decays import decay_test
from dialect import unreadable_units
from made_runs import (
    FS,
    GAIN,
    JOINT,
    OMEGA_N,
    SILENT,
    UNITS,
    ZETA,
    Z,
    a_test,
    a_tree,
    integrated,
    same,
    spread,
)

from jbw.measurement.records import Record, Test
from jbw.verification.planned import planned_tones
from jbw.verification.predict import Request, predict
from jbw.verification.predicted import REPEATS, UNKNOWN
from jbw.verification.predictive_basis import basis_of


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
    assert unreadable_units(xr.DataTree(found)) == {}
    wide = found["model_magnitude"].values
    np.testing.assert_allclose(wide[2] - wide[1], Z * 0.01 * velocity, rtol=0.05)
    turned = np.angle(1j * receptance(omega))
    np.testing.assert_allclose(found["model_phase"][1], turned, atol=1e-4)
    assert found.attrs["y_peak"][1] == pytest.approx(np.max(velocity / omega), rel=1e-4)


def test_planned_tones_of_a_turned_channel_are_turned():
    """Odd harmonics, all of them, half a period later; the first of a joint that slips, too."""
    freq = (15.0, 18.0)
    runs = (basis_of(a_tree(same(JOINT, gain=gain))) for gain in (GAIN, -GAIN))
    plain, turned = (predict(basis, planned_tones(basis, freq, 0.02)) for basis in runs)
    for name in ("model_magnitude", "model_magnitude_3"):
        np.testing.assert_allclose(turned[name], plain[name], rtol=1e-12)
    for name in ("model_phase", "model_phase_3"):
        apart = np.exp(1j * (turned[name] - plain[name]))
        np.testing.assert_allclose(apart, -1.0, atol=1e-12)


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
    assert len(set(found["record"].values.tolist())) == 2  # by name
    assert found["nrmse_of_record"].dims == ("record",)
    assert unreadable_units(xr.DataTree(found)) == {}
    # White noise of 1e-5 m/s through the band is 2e-5 of the first swings; the initial state is
    # read from half a second, 10 periods, with the second mode 60 dB down.
    assert found.attrs["nrmse"] < 2e-3
    assert found.attrs["noise"] == UNKNOWN
    assert "predictive_band" not in found
    # From 2 mm and from hypot(0.3 mm, 0.2 m/s / omega_n) = 1.6 mm; a quarter second later, less.
    rate = DECAY_TRUTH["zeta"] * DECAY_OMEGA_N
    assert 1.5e-3 < found.attrs["y_peak"][1] < 2e-3 * np.exp(-0.25 * rate)
    assert found.attrs["extrapolation"] == pytest.approx(found.attrs["y_peak"][2] / 1.5e-3)
