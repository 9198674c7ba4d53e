"""Kinds of test beside noise, tones, steps and sweeps: periodic, free, pulled, held; in newtons."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jbw import BoucWen, ConfigError
from jbw.rig import LABORATORY, MIXED, SLIDERS, TRUTH, measure
from jbw.rig.generator import Multisine, Sweep
from jbw.rig.integrator import GRID, respond
from jbw.rig.prescribed_motion import Growth, Held, holding_force, pulled
from jbw.rig.presets import MODAL_MASS, RESONANCE_HZ, Plan, pull_plan

FS = 1024.0
CURVE = Plan("curve_1p00mm", "frf", Held(RESONANCE_HZ, 1e-3, dwell=4.0), repeats=2)
QUIET = {"noise_std": 0.0, "input_noise_std": 0.0, "force_noise_std": 0.0}


def rig_of(*plans):
    return replace(MIXED, plans=plans)


def multisine(**fields):
    options = {"level": 0.2, "period": 2.0, "low_hz": 10.0, "high_hz": 30.0, "periods": 4}
    return Multisine(**{**options, "settle": 40.0, **fields})


# Multisine


def test_a_multisine_repeats_its_period_and_holds_its_lines():
    excitation = multisine()
    (test,) = measure(rig_of(Plan("m", "multisine", excitation, 2)), **QUIET).tests
    assert test.periods == 4
    force = test.records[0].channels["force"]
    periods = force.reshape(4, 2048)
    # Steps of the converter, 32 N * 2^-23.
    np.testing.assert_allclose(periods - periods[0], 0, atol=8e-6)
    assert np.sqrt(np.mean(force**2)) == pytest.approx(0.2, rel=1e-5)
    lines = np.abs(np.fft.rfft(periods[0])) * 2 / 2048
    band = np.arange(20, 60)
    # 0.2 N rms over 40 lines.
    np.testing.assert_allclose(lines[band], 0.2 * np.sqrt(2 / 40), rtol=1e-4)
    assert np.delete(lines, band).max() < 1e-6
    np.testing.assert_array_equal(force, test.records[1].channels["force"])


def test_a_multisines_response_is_steady():
    (test,) = measure(rig_of(Plan("m", "multisine", multisine(), 1)), **QUIET).tests
    periods = test.records[0].channels["velocity"].reshape(4, 2048)
    # 40 s forget the start to exp(-0.52 * 40) = 1e-9 of it; the joint is slower at small
    # amplitude but never less damped than zeta omega_n.
    assert np.abs(periods[-1] - periods[0]).max() < 1e-5 * np.abs(periods).max()


def test_a_multisine_that_lags_is_its_delayed_self():
    delay = 0.3e-3
    plan = Plan("m", "multisine", multisine(), 1)
    prompt, late = (measure(rig_of(plan), delay=d, **QUIET) for d in (0.0, delay))
    v, lagged = (c.tests[0].records[0].channels["velocity"] for c in (prompt, late))
    omega = 2 * np.pi * np.fft.rfftfreq(v.size, 1 / FS)
    shifted = np.fft.irfft(np.fft.rfft(v) * np.exp(-1j * omega * delay), v.size)
    np.testing.assert_allclose(lagged, shifted, atol=2e-5 * np.abs(v).max())


# Free decay


def test_a_decay_holds_the_velocity_alone_and_falls_as_the_joint_damps():
    burst = Sweep(18.8, 18.8, 0.3, burst=4.0, fade=0.1, duration=8.0, settle=4.0)
    joint = BoucWen(TRUTH.omega_n, TRUTH.zeta, TRUTH.alpha, 0.0, 0.0)  # a linear one
    campaign = measure(rig_of(Plan("d", "decay", burst, 2)), joint=joint, **QUIET)
    record = campaign.tests[0].records[0]
    assert list(record.channels) == ["velocity"]
    assert campaign.demands == {}
    v = record.channels["velocity"]
    t = np.arange(v.size) / FS
    damped = TRUTH.omega_n * np.sqrt(1 - TRUTH.zeta**2)
    decay = np.exp(-TRUTH.zeta * TRUTH.omega_n * t)
    waves = np.stack([decay * np.cos(damped * t), decay * np.sin(damped * t)], axis=1)
    fitted = waves @ np.linalg.lstsq(waves, v)[0]
    # Converter steps of 2.4e-7 m/s, and Runge-Kutta's error.
    np.testing.assert_allclose(v, fitted, atol=1e-6 * np.abs(v).max() + 3e-7)


# Prescribed displacement


def test_a_pulled_loop_has_the_force_of_an_adaptive_integrator():
    growth = Growth(1.0, 4e-3, duration=3.0)
    y, force = pulled(TRUTH, growth, FS)

    def rate(t, z):
        v = growth.level / 3.0 * (np.sin(2 * np.pi * t) + 2 * np.pi * t * np.cos(2 * np.pi * t))
        return TRUTH.alpha * v - TRUTH.gamma * abs(v) * z - TRUTH.delta * v * abs(z)

    t = np.arange(y.size) / FS
    np.testing.assert_allclose(y, growth.level * t / 3.0 * np.sin(2 * np.pi * t), atol=1e-18)
    solved = solve_ivp(rate, (0, t[-1]), [0.0], "DOP853", t, rtol=1e-11, atol=1e-13, max_step=1e-3)
    np.testing.assert_allclose(force - TRUTH.k * y, solved.y[0], atol=1e-6)


def test_sliders_are_pulled_along_their_closed_form():
    growth = Growth(1.0, 6e-3, duration=1.0)
    y, force = pulled(SLIDERS, growth, FS)
    springs, slips = np.array([200.0, 200.0, 100.0]), np.array([0.3e-3, 1.2e-3, 4.0e-3])
    k = SLIDERS.omega_n**2 - springs.sum()
    # To the first turn every slider is a spring that stops at its slip, then turns by twice that.
    turn = int(np.argmax(y[: y.size // 2]))
    loading = springs * np.minimum(y[:turn, None], slips)
    np.testing.assert_allclose(force[:turn], k * y[:turn] + loading.sum(axis=1), atol=1e-12)
    back = springs * np.maximum(np.minimum(y[turn], slips) - (y[turn] - y[turn:600, None]), -slips)
    # Where y turns between two steps, a slider that slips is late by what y moves in a step there.
    np.testing.assert_allclose(force[turn:600], k * y[turn:600] + back.sum(axis=1), atol=1e-4)


def test_a_loop_is_recorded_in_newtons():
    (test,) = measure(rig_of(pull_plan(4e-3)), **QUIET).tests
    record = test.records[0]
    assert record.units == {"displacement": "m", "restoring_force": "N"}
    y, force = pulled(TRUTH, pull_plan(4e-3).excitation, FS)
    # Half a step of the converters: 1 nm and 31 uN.
    np.testing.assert_allclose(record.channels["displacement"], y, atol=1e-9)
    np.testing.assert_allclose(record.channels["restoring_force"], MODAL_MASS * force, atol=4e-5)


def test_noise_of_a_loop_is_that_of_its_force():
    clean, noisy = (
        measure(rig_of(pull_plan(4e-3)), force_noise_std=s).tests[0].records[1].channels
        for s in (0.0, 0.02)
    )
    np.testing.assert_array_equal(clean["displacement"], noisy["displacement"])
    error = noisy["restoring_force"] - clean["restoring_force"]
    # 6,144 values: the rms is known to 0.9 %.
    assert np.std(error) == pytest.approx(0.02, rel=0.04)


# Held response


def test_the_force_that_holds_a_response_holds_it_on_the_bench():
    held = Held((18.25, 18.75), 2e-3, dwell=4.0)
    for frequency, force in zip(held.frequencies_hz, holding_force(TRUTH, held), strict=True):

        def volts(i, j, f=frequency, force=force):
            return np.abs(force) * np.cos(2 * np.pi * f * np.arange(i, j) / (GRID * FS))

        count = 48 * 1024
        y, _, _ = respond(TRUTH, volts, count, FS)
        t = np.arange(count - 16_384, count) / FS
        fundamental = 2 * np.mean(y[-16_384:] * np.exp(-2j * np.pi * frequency * t))
        # Found: 2e-6, what is left of the transient after 32 s.
        assert fundamental == pytest.approx(2e-3 * np.exp(-1j * np.angle(force)), rel=1e-5)


def test_a_curve_is_recorded_with_the_noise_of_a_fitted_sine():
    clean, noisy = (
        measure(rig_of(CURVE), repeats=64, force_noise_std=s).tests[0] for s in (0.0, 0.02)
    )
    first = clean.records[0].channels
    expected = MODAL_MASS * holding_force(TRUTH, CURVE.excitation)
    np.testing.assert_allclose(first["force"] * np.exp(-1j * first["phase"]), expected, rtol=1e-12)
    np.testing.assert_array_equal(first["displacement"], 1e-3)
    forces = [r.channels["force"] * np.exp(-1j * r.channels["phase"]) for r in noisy.records]
    error = np.stack(forces) - expected
    std = 0.02 * np.sqrt(2 / 4096)
    # 576 values of each part: their rms is known to 3 %.
    assert np.std(error.real) == pytest.approx(std, rel=0.12)
    assert np.std(error.imag) == pytest.approx(std, rel=0.12)


def test_a_rig_in_volts_refuses_what_is_measured_in_newtons():
    with pytest.raises(ConfigError, match="`pull_4p00mm` measures newtons"):
        measure(replace(LABORATORY, plans=(pull_plan(4e-3),)))


# The mixed campaign


def test_mixed_holds_every_kind_that_its_description_names():
    kinds = {plan.kind for plan in MIXED.plans}
    assert kinds == {"noise", "tones", "stepped", "sweep", "decay", "loop"}
    assert len({plan.excitation.level for plan in MIXED.plans if plan.kind == "tones"}) == 3
    names = [plan.name for plan in MIXED.plans]
    assert not any(a != b and b.startswith(f"{a}_") for a in names for b in names)


def test_force_is_recorded_and_moves_the_modal_mass():
    """A tone far below resonance, where the joint is a spring of k + Z_1/Y."""
    (name,) = [plan.name for plan in MIXED.plans if plan.name.startswith("tone_5p50Hz_6")]
    joint = BoucWen(TRUTH.omega_n, 0.05, TRUTH.alpha, 0.0, 0.0)
    (test,) = measure("mixed", tests=[name], joint=joint, repeats=1, **QUIET).tests
    record, omega = test.records[0], 2 * np.pi * 5.5
    assert record.units == {"force": "N", "velocity": "m/s"}
    t = np.arange(record.num_samples) / FS
    wave = 2 * np.exp(-1j * omega * t) / record.num_samples
    force, velocity = wave @ record.channels["force"], wave @ record.channels["velocity"]
    assert force == pytest.approx(6.0, rel=1e-6)
    h = 1j * omega / (joint.omega_n**2 - omega**2 + 2j * 0.05 * joint.omega_n * omega)
    assert velocity == pytest.approx(h * 6.0 / MODAL_MASS, rel=1e-5)
