"""Time response against golden numbers, scipy, closed forms and the exact invariances."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from jbw.errors import ConfigError, DataError, ModelError
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.response import simulate
from tests.conftest import GOLDEN

SWEEPS = GOLDEN["sweep"]["cases"]
HOLD = {"foh": "first", "zoh": "zero", "analytic": "band_limited"}
PAPER = {
    "omega_n": 2 * np.pi * 18.8,
    "zeta": 0.00444,
    "alpha": 497.4,
    "delta": 340.21,
    "gamma": 32.84,
}
FS = 512.0


def label(case):
    return f"{case['input']}-{case['A']:g}"


def chirp(case, t):
    return case["A"] * np.sin(2 * np.pi * (case["f0"] * t + case["rate_hz_per_s"] * t**2 / 2))


def golden_errors(case, response):
    index = np.array(case["index"])
    motion = (response.y, response.v, response.z)
    return [
        np.max(np.abs(np.asarray(x)[index] - np.array(case[name]))) / peak
        for x, name, peak in zip(motion, "yvZ", case["peak"], strict=True)
    ]


run = jax.jit(simulate, static_argnames=("hold", "substeps", "periodic"))


@pytest.fixture(scope="module")
def burst():
    """A strong burst with silence before and after it."""
    t = np.arange(400) / FS
    return 12.0 * np.sin(2 * np.pi * (5 * t + 15 * t**2)) * np.exp(-(((t - 0.4) / 0.2) ** 4))


@pytest.mark.parametrize("case", SWEEPS, ids=label)
def test_golden_sweep(case):
    u = chirp(case, np.arange(case["N"] + 1) / case["fs"])
    joint = BoucWen(**case["params"])
    coarse, fine = (
        golden_errors(case, run(joint, u, case["fs"], hold=HOLD[case["input"]], substeps=m))
        for m in (1, 4)
    )
    # Order 4: 4^4 = 256 times nearer. The reconstructed chirp keeps (omega h)^6/46080 at 40 Hz,
    # 5e-9 of the input at the end of the band.
    assert max(coarse) < 5e-6
    assert max(fine) < 2e-8


@pytest.mark.slow
@pytest.mark.parametrize("case", SWEEPS, ids=label)
def test_golden_sweep_to_the_last_digits(case):
    if case["input"] == "analytic":
        pytest.skip("the chirp between the samples is reconstructed, not known")
    u = chirp(case, np.arange(case["N"] + 1) / case["fs"])
    response = run(BoucWen(**case["params"]), u, case["fs"], hold=HOLD[case["input"]], substeps=48)
    # Order 4 from 5e-10 at 8 substeps to 4e-13; the rounding of 8e5 steps leaves some 1e-12.
    assert max(golden_errors(case, response)) < 2e-11


def test_golden_sweep_by_a_stock_solver():
    case = SWEEPS[-1]
    u = chirp(case, np.arange(case["N"] + 1) / case["fs"])
    response = run_stock(BoucWen(**case["params"]), u)
    # Tsit5 knows nothing of the kinks: order 2, worst in z.
    assert max(golden_errors(case, response)) < 3e-4


@jax.jit
def run_stock(joint, u):
    return simulate(joint, u, SWEEPS[-1]["fs"], solver=diffrax.Tsit5(), substeps=4)


def test_callable_input_meets_the_reconstructed_record():
    case = SWEEPS[-1]
    joint = BoucWen(**case["params"])
    omega = lambda t: 2 * jnp.pi * (12.0 * t + 3.0 * t**2)  # noqa: E731
    exact = simulate(joint, lambda t: 5.0 * jnp.sin(omega(t)), 1024.0, num_samples=600)
    u = 5.0 * np.sin(omega(np.arange(600) / 1024))
    sampled = simulate(joint, u, 1024.0, hold="band_limited", substeps=4)
    # What is left is the unknown outside of the record's edges (the input starts with full slope).
    assert np.abs(exact.v - sampled.v).max() < 2e-6 * np.abs(exact.v).max()


def event_located(joint, u, fs, substeps):
    """DOP853 from sample to sample under a first-order hold, restarted at each kink."""

    def rate(t, x, n, sv, sz):
        y, v, z = x
        force = u[n] + (u[n + 1] - u[n]) * (t * fs)
        dz = joint.alpha * v - (joint.gamma * sv + joint.delta * sz) * v * z
        return [v, force - 2 * joint.zeta * joint.omega_n * v - joint.k * y - z, dz]

    turning = lambda t, x, *_: x[1]  # noqa: E731
    zero = lambda t, x, *_: x[2]  # noqa: E731
    turning.terminal = zero.terminal = True
    states = [np.zeros(3)]
    for n in range(len(u) - 1):
        x, t, end = states[-1], 0.0, 1 / fs
        while t < end:
            # Signs just after t, so that an event at t itself is not met again.
            probe = x + 1e-7 * end * np.array(rate(t, x, n, 1, 1))
            sv, sz = (1.0 if probe[1] >= 0 else -1.0), (1.0 if probe[2] >= 0 else -1.0)
            turning.direction, zero.direction = -sv, -sz
            sol = scipy.integrate.solve_ivp(
                rate, (t, end), x, "DOP853", args=(n, sv, sz), events=(turning, zero),
                rtol=1e-12, atol=1e-16, first_step=(end - t) / 4,
            )  # fmt: skip
            t, x = sol.t[-1], sol.y[:, -1]
        states.append(x)
    return np.array(states).T


@pytest.mark.release  # golden sweeps are in this file
def test_state_converges_with_order_4_through_the_kinks():
    fs, n = 512.0, np.arange(160)
    u = 40.0 * np.sin(2 * np.pi * 21 * n / fs) + 15.0 * np.sin(2 * np.pi * 33 * n / fs + 1)
    joint = BoucWen(**PAPER)
    reference = event_located(joint, u, fs, 1)
    errors = []
    for m in (2, 4, 8, 16):
        r = run(joint, u, fs, substeps=m)
        x = np.array([r.y, r.v, r.z])
        errors.append(np.sqrt(np.mean(((x - reference) / np.abs(reference).max(1)[:, None]) ** 2)))
    order = -np.polyfit(np.log([2, 4, 8, 16]), np.log(errors), 1)[0]
    assert 3.7 < order < 4.5, errors


@pytest.mark.parametrize("zeta", [0.0, 0.02, 1.0, 1.5])
def test_linear_limit_is_exact(zeta):
    u = np.random.default_rng(1).normal(size=300)
    joint = BoucWen(100.0, zeta, 3000.0, 0.0, 0.0)
    r = run(joint, u, FS)
    system = ([[0, 1], [-1e4, -200 * zeta]], [[0], [1]], np.eye(2), np.zeros((2, 1)))
    _, x, _ = scipy.signal.lsim(system, u, np.arange(300) / FS, interp=True)
    assert np.abs(r.y - x[:, 0]).max() < 1e-12 * np.abs(x[:, 0]).max()
    assert np.abs(r.v - x[:, 1]).max() < 1e-12 * np.abs(x[:, 1]).max()
    assert np.abs(r.z - 3000.0 * r.y).max() < 1e-12 * np.abs(r.z).max()


def test_zero_hold_keeps_each_sample_for_one_interval():
    u = np.random.default_rng(2).normal(size=300)
    r = run(BoucWen(100.0, 0.02, 3000.0, 0.0, 0.0), u, FS, hold="zero")
    system = ([[0, 1], [-1e4, -4.0]], [[0], [1]], np.eye(2), np.zeros((2, 1)))
    _, x, _ = scipy.signal.lsim(system, u, np.arange(300) / FS, interp=False)
    assert np.abs(r.y - x[:, 0]).max() < 1e-12 * np.abs(x[:, 0]).max()


def test_free_decay_from_an_initial_state():
    joint, start = BoucWen(**PAPER), (4e-3, 0.1, 0.5)

    def rate(t, x):
        y, v, z = x
        dv = -2 * joint.zeta * joint.omega_n * v - joint.k * y - z
        dz = joint.alpha * v - joint.gamma * abs(v) * z - joint.delta * v * abs(z)
        return [v, dv, dz]

    r = run(joint, np.zeros(300), FS, initial=start, substeps=4)
    ref = scipy.integrate.solve_ivp(
        rate, (0, 299 / FS), start, "DOP853", t_eval=np.arange(300) / FS, rtol=1e-11, atol=1e-14
    )
    assert (r.y[0], r.v[0], r.z[0]) == start
    assert r.t[0] == 0.0
    # DOP853 at this tolerance steps over kinks: about 1e-8.
    for x, expected in zip((r.y, r.v, r.z), ref.y, strict=True):
        assert np.abs(x - expected).max() < 1e-7 * np.abs(expected).max()


def test_general_exponent_against_scipy():
    joint = BoucWen(100.0, 0.01, 5000.0, 2e4, 1e4, nu=2.0)
    u = 30.0 * np.sin(2 * np.pi * 12 * np.arange(200) / FS)

    def rate(t, x):
        y, v, z = x
        n = min(int(t * FS), 198)
        force = u[n] + (u[n + 1] - u[n]) * (t * FS - n)
        dz = joint.alpha * v - (joint.gamma * abs(v) * abs(z) * z + joint.delta * v * z * z)
        return [v, force - 2 * joint.zeta * joint.omega_n * v - joint.k * y - z, dz]

    ref = scipy.integrate.solve_ivp(
        rate, (0, 199 / FS), [0, 0, 0], "DOP853", t_eval=np.arange(200) / FS,
        rtol=1e-10, atol=1e-13, max_step=1 / FS,
    )  # fmt: skip
    r = simulate(joint, u, FS)
    assert np.abs(r.z - ref.y[2]).max() < 1e-6 * np.abs(ref.y[2]).max()


def test_acceleration_closes_the_equation_of_motion(burst):
    joint = BoucWen(**PAPER)
    r = run(joint, burst, FS)
    force = joint.k * r.y + r.z
    np.testing.assert_allclose(
        r.a + 2 * joint.zeta * joint.omega_n * r.v + force, burst, atol=1e-12 * np.abs(force).max()
    )


def test_energy_balance():
    joint, fs = BoucWen(**PAPER), 8192.0
    t = np.arange(2401) / fs
    u = 12.0 * np.sin(2 * np.pi * 17 * t)
    r = run(joint, u, fs, hold="band_limited")
    power = np.stack([u * r.v, 2 * joint.zeta * joint.omega_n * r.v**2, r.z * r.v])
    work, viscous, joint_work = scipy.integrate.simpson(power, x=t)
    stored = 0.5 * r.v[-1] ** 2 + 0.5 * joint.k * r.y[-1] ** 2
    # Simpson's rule on the samples, over kinks and with an odd end.
    assert work - viscous - joint_work == pytest.approx(float(stored), rel=1e-6)


def test_force_stays_below_its_limit(burst):
    joint = BoucWen(**PAPER)
    r = run(joint, 20.0 * burst, FS, substeps=8)
    limit = joint.alpha / (joint.delta + joint.gamma)
    assert 0.95 * limit < np.abs(r.z).max() <= limit * (1 + 1e-12)


SCALE = st.floats(0.2, 5.0)
PROPERTY = settings(max_examples=15, deadline=None)


@PROPERTY
@given(st.floats(0.1, 30.0))
def test_response_is_odd(amplitude):
    u = amplitude * np.sin(0.3 * np.arange(400) + 0.0008 * np.arange(400) ** 2)
    up, down = run(BoucWen(**PAPER), u, FS), run(BoucWen(**PAPER), -u, FS)
    assert np.abs(up.y + down.y).max() < 1e-13 * np.abs(up.y).max()


@PROPERTY
@given(s=SCALE)
def test_amplitude_scales_out(burst_scale, s):
    u = burst_scale
    one = run(BoucWen(**PAPER), u, FS)
    joint = BoucWen(**PAPER | {"delta": PAPER["delta"] / s, "gamma": PAPER["gamma"] / s})
    other = run(joint, s * u, FS)
    # Rounding, spread by the oscillator over 400 steps.
    assert np.abs(other.y - s * one.y).max() < 1e-11 * np.abs(other.y).max()
    assert np.abs(other.z - s * one.z).max() < 1e-11 * np.abs(other.z).max()


@PROPERTY
@given(c=SCALE)
def test_time_scales_out(burst_scale, c):
    u = burst_scale
    one = run(BoucWen(**PAPER), u, FS)
    changed = {"omega_n": PAPER["omega_n"] / c, "alpha": PAPER["alpha"] / c**2}
    other = run(BoucWen(**PAPER | changed), u / c**2, FS / c)
    assert np.abs(other.y - one.y).max() < 1e-11 * np.abs(one.y).max()
    assert np.abs(other.v * c - one.v).max() < 1e-11 * np.abs(one.v).max()


@PROPERTY
@given(alpha=st.floats(1.0, 1e4))
def test_joint_without_hysteresis_is_linear_for_every_alpha(burst_scale, alpha):
    u = burst_scale
    joint = BoucWen(**PAPER | {"alpha": alpha, "delta": 0.0, "gamma": 0.0})
    one = run(BoucWen(**PAPER | {"alpha": 1.0, "delta": 0.0, "gamma": 0.0}), u, FS)
    assert np.abs(run(joint, u, FS).y - one.y).max() < 1e-11 * np.abs(one.y).max()


@pytest.fixture(scope="module")
def burst_scale(burst):
    return burst


PERIODIC = GOLDEN["true_oscillator_steady"]["cases"]


@pytest.mark.parametrize("case", PERIODIC, ids=lambda c: f"{c['A']:g}-{c['f_hz']:g}Hz")
def test_periodic_record_gives_the_golden_steady_state(case):
    num = 256
    joint = BoucWen(**{name: case[name] for name in PAPER})
    u = case["A"] * np.cos(2 * np.pi * np.arange(num) / num)
    r = run(joint, u, num * case["f_hz"], hold="band_limited", substeps=2, periodic=True)
    spectrum = 2 * np.fft.fft(r.y) / num
    # Order 4 at 512 steps a period: 1e-9; the third harmonic is 1e-3 of the first and kinks alias
    # a little into it.
    assert abs(spectrum[1] - complex(*case["Y1"])) < 1e-8 * abs(complex(*case["Y1"]))
    assert abs(spectrum[3] - complex(*case["Y3"])) < 1e-8 * abs(complex(*case["Y1"]))
    assert float(r.residual) < 1e-10


def test_batches_broadcast_and_match_vmap(burst):
    zeta = np.array([0.002, 0.004, 0.008])
    joint = BoucWen(**PAPER | {"zeta": zeta})
    levels = np.stack([burst, 0.1 * burst])[:, None, :]
    r = run(joint, levels, FS)
    assert r.y.shape == (2, 3, 400)
    one = run(BoucWen(**PAPER | {"zeta": zeta[2]}), levels[1, 0], FS)
    # Lanes and single solve differ in the order of their roundings.
    assert np.abs(r.y[1, 2] - one.y).max() < 1e-12 * np.abs(one.y).max()
    lanes = jax.vmap(lambda zeta: run(BoucWen(**PAPER | {"zeta": zeta}), burst, FS).v)(zeta)
    assert np.abs(lanes - r.v[0]).max() < 1e-12 * np.abs(lanes).max()


def test_community_benchmark_parameters_stay_bounded():
    """Outside of the bounded region for all inputs, but not for this one (delta + gamma < 0)."""
    joint = BoucWen(np.sqrt(5e4), 10 / 4 / np.sqrt(5e4), 25000.0, -1100.0, 800.0)
    u = 25.0 * np.sin(2 * np.pi * 20 * np.arange(600) / 750)
    assert np.all(np.isfinite(run(joint, u, 750.0).y))


@pytest.mark.filterwarnings("ignore:The joint is bounded")
def test_divergence_is_data_under_jit_and_an_error_outside():
    joint = BoucWen(100.0, 0.0, 9000.0, -3000.0, 100.0)
    u = 300.0 * np.sin(100.0 * np.arange(400) / FS)
    assert not np.all(np.isfinite(run(joint, u, FS).y))
    with pytest.raises(ModelError, match=r"diverges at sample \d+ for alpha = 9000.0, delta"):
        simulate(joint, u, FS)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"hold": "second"}, ConfigError, "`hold` must be one of first, zero, band_limited"),
        ({"fs": -1.0}, ConfigError, "`fs` must be a positive"),
        ({"substeps": 0}, ConfigError, "`substeps` must be an integer >= 1"),
        ({"substeps": 1.5}, ConfigError, "`substeps`"),
        ({"u": np.ones(1)}, DataError, "at least 2 samples"),
        ({"u": np.array([0.0, np.nan, 1.0])}, DataError, r"u\[1\] is nan"),
        ({"u": lambda t: t}, ConfigError, "needs `num_samples`"),
        ({"num_samples": 7}, DataError, "`num_samples` is 7, but `u` has 5"),
        ({"initial": (0.0,)}, ConfigError, r"must be \(y, v, z\)"),
        ({"initial": (0.0, 0.0, 2.0)}, ModelError, "Initial z = 2.0"),
        ({"initial": (np.inf, 0.0, 0.0)}, DataError, "`initial` must be finite"),
    ],
)  # fmt: skip
def test_bad_input_is_named(change, error, words):
    arguments = {"u": np.zeros(5), "fs": FS} | change
    with pytest.raises(error, match=words):
        simulate(BoucWen(**PAPER), **arguments)


@pytest.mark.fault(35)
def test_float32_session_is_refused():
    with jax.enable_x64(False), pytest.raises(ConfigError, match="enable_x64"):
        simulate(BoucWen(**PAPER), np.zeros(5), FS)
