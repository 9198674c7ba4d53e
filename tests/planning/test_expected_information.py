"""Information of candidate tests against an independent oscillator, closed forms and scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from jbw.inference.space.box import box
from jbw.planning.beliefs import Beliefs
from jbw.planning.making import (
    covariance,
    information_gain,
    modes,
    repeats_needed,
    spread,
    worst_decile,
)
from jbw.planning.plan import PlannedSteppedSine, PlannedSweep, PlannedTones, ResponseNoise
from jbw.planning.prospects import peak_displacements, prospects

JOINT = dict(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.21, gamma=32.84)
LINEAR = dict(omega_n=60.0, zeta=0.01, alpha=400.0, delta=1e-9, gamma=1e-9)
VELOCITY = ResponseNoise(50e-6, "velocity")
SWEEP = PlannedSweep(level=0.05, start_hz=5.0, stop_hz=15.0, rate=2.0, rest=2.0, fs=512.0)


def beliefs_at(theta, gain, names):
    """One joint, of which some parameters are inferred and next to nothing is known."""
    return Beliefs(
        joints={name: np.array([value]) for name, value in {**theta, "gain": gain}.items()},
        names=names,
        scale=np.array([[theta[name] for name in names]]),
        precision=1e-6 * np.eye(len(names)),
        box=box({name: (theta[name] / 2, 2 * theta[name]) for name in names}),
    )


def chirp(t, test):
    """A linear sweep that falls by half a cosine over its last part, then silence."""
    rate = (test.stop_hz - test.start_hz) / test.burst
    remaining = test.burst - t
    fade = np.where(remaining < test.fade, 0.5 - 0.5 * np.cos(np.pi * remaining / test.fade), 1.0)
    wave = np.sin(2 * np.pi * (test.start_hz * t + 0.5 * rate * t**2))
    return test.level * np.where(remaining > 0, fade * wave, 0.0)


def linear_velocity(omega_n, zeta, gain, test, finer=8):
    t = np.arange(finer * test.num_samples) / (finer * test.fs)
    system = ([gain, 0.0], [1.0, 2 * zeta * omega_n, omega_n**2])
    return lsim(system, chirp(t, test), t)[1][::finer]


@pytest.mark.slow
def test_bound_of_a_linear_oscillator_in_a_sweep():
    prospect = prospects([SWEEP], beliefs_at(LINEAR, 15.0, ("omega_n", "zeta")), VELOCITY)[0]
    columns = []
    for name in ("omega_n", "zeta"):
        ends = []
        for step in (1e-4, -1e-4):
            moved = {**LINEAR, name: LINEAR[name] * (1 + step)}
            ends.append(linear_velocity(moved["omega_n"], moved["zeta"], 15.0, SWEEP))
        columns.append((ends[0] - ends[1]) / 2e-4)
    slope = np.stack(columns, axis=1) / VELOCITY.std
    # lsim draws lines between samples an eighth apart: 1e-4 of the response; differences 1e-6.
    np.testing.assert_allclose(prospect.information[0], slope.T @ slope, rtol=1e-3)
    y = np.cumsum(linear_velocity(60.0, 0.01, 15.0, SWEEP)) / SWEEP.fs
    assert prospect.y_peak[0] == pytest.approx(np.abs(y).max(), rel=0.01)  # a sum for an integral


@pytest.mark.slow
def test_what_fills_up_a_record_tells_nothing():
    longer = PlannedSweep(level=0.05, start_hz=5.0, stop_hz=15.0, rate=1.5, rest=2.0, fs=512.0)
    beliefs = beliefs_at(LINEAR, 15.0, ("omega_n", "zeta"))
    sweep_alone = prospects([SWEEP], beliefs, VELOCITY)[0]
    filled = prospects([SWEEP, longer], beliefs, VELOCITY)[0]
    # The transform behind the band-limited hold sees another length: 1e-5 of the input at its end.
    np.testing.assert_allclose(filled.information, sweep_alone.information, rtol=1e-4)


def test_bound_of_a_linear_oscillator_in_a_stepped_sine():
    r"""F = sum N/(2 sigma^2) 2 Re(conj dV dV'): amplitudes of a tone in white noise."""
    hz = (9.0, 9.4, 9.6, 10.0)
    test = PlannedSteppedSine(level=0.02, frequencies_hz=hz, dwell=4.0, settle=2.0, fs=512.0)
    prospect = prospects([test], beliefs_at(LINEAR, 15.0, ("omega_n", "zeta")), VELOCITY)[0]
    w, (n, z) = 2 * np.pi * np.array(hz), (60.0, 0.01)
    y = 15.0 * 0.02 / (n**2 - w**2 + 2j * z * n * w)
    by_n = -(y**2) / 0.3 * (2 * n + 2j * z * w) * n
    by_z = -(y**2) / 0.3 * (2j * n * w) * z
    slope = 1j * w * np.stack([by_n, by_z])
    expected = 1024 / (2 * VELOCITY.std**2) * (slope.conj() @ slope.T).real
    # The joint sticks, delta y = 1e-11. Differences of h = 1e-5 err by (h / zeta)^2 / 6, 2e-7, of
    # J's rows, which are nearly at right angles: their product is 1e-4 of their sizes.
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(prospect.information[0] / size, expected / size, rtol=0, atol=1e-6)
    assert prospect.y_peak[0] == pytest.approx(np.abs(y).max(), rel=1e-3)  # 256 phases a period


def bouc_wen(theta, u):
    """Right-hand side of the general law with nu = 1."""
    n, z, alpha, delta, gamma = theta.values()

    def slope(t, state):
        y, v, force = state
        rate = alpha * v - gamma * abs(v) * force - delta * v * abs(force)
        return v, u(t) - 2 * z * n * v - (n**2 - alpha) * y - force, rate

    return slope


def test_peak_displacement_in_a_strong_sweep():
    test = PlannedSweep(level=0.10, start_hz=12.0, stop_hz=26.0, rate=3.5, rest=0.5, fs=1024.0)
    theta = JOINT
    y_peak = peak_displacements(test, beliefs_at(theta, 15.0, ("omega_n",)))[0]
    slope = bouc_wen(theta, lambda t: 15.0 * float(chirp(np.float64(t), test)))
    t = np.arange(test.num_samples) / test.fs
    solved = solve_ivp(
        slope, (0.0, t[-1]), np.zeros(3), t_eval=t, rtol=1e-7, atol=1e-10, max_step=0.004
    )
    # One exact step a sample: 1e-6 of the motion; scipy 1e-5 at the kinks.
    assert y_peak == pytest.approx(np.abs(solved.y[0]).max(), rel=1e-4)
    assert y_peak > 3e-3  # delta y beyond one: the joint slides


def test_peak_displacement_of_tones():
    test = PlannedTones(
        level=0.6, frequencies_hz=(4.5, 5.0, 5.5, 6.0), dwell=4.0, settle=2.0, fs=512.0
    )
    theta = {**JOINT, "zeta": 0.02}  # settles sooner, for scipy
    prospect = prospects([test], beliefs_at(theta, 15.0, ("omega_n", "zeta")), VELOCITY)[0]
    slope = bouc_wen(theta, lambda t: 9.0 * np.cos(2 * np.pi * 6.0 * t))
    t = np.linspace(5.0, 6.0, 2000)
    solved = solve_ivp(slope, (0.0, 6.0), np.zeros(3), t_eval=t, rtol=1e-8, atol=1e-11)
    # exp(-zeta omega_n 5 s) = 7e-6 is left of the transient; four harmonics are good to 3e-6.
    assert prospect.y_peak[0] == pytest.approx(np.abs(solved.y[0]).max(), rel=1e-3)


def test_the_law_of_repeats():
    information = np.array([[[40.0, 10.0], [10.0, 90.0]]])
    eigenmodes = modes(1e-12 * np.eye(2), information)
    once = np.sqrt(np.diag(np.linalg.inv(information[0])))
    for repeats in (1, 4, 25):
        # The prior of 1e-12 is a part in 1e11 of what is told.
        np.testing.assert_allclose(
            spread(eigenmodes, repeats)[0], once / np.sqrt(repeats), rtol=1e-9
        )


def test_repeats_needed_in_closed_form():
    prior, information, cv = 100.0, 7.0, 0.01
    eigenmodes = modes(np.array([[prior]]), np.array([[[information]]]))
    expected = int(np.ceil((1 / cv**2 - prior) / information))
    assert repeats_needed(eigenmodes, [0], cv, 10_000) == expected
    assert repeats_needed(eigenmodes, [0], cv, expected - 1) is None


def test_a_direction_that_nothing_tells_of_is_never_known():
    v = np.array([1.0, 1.0]) / np.sqrt(2)  # log of a product
    eigenmodes = modes(np.eye(2), 1e9 * np.outer(v, v)[None])
    assert repeats_needed(eigenmodes, [0], 0.05, 10**6) is None
    # What is left is the prior across the product, half of it along each parameter.
    assert spread(eigenmodes, 1e6)[0, 0] == pytest.approx(np.sqrt(0.5))


def test_gain_is_the_mutual_information_of_a_linear_gaussian_problem():
    r"""I = H(theta) + H(data) - H(theta, data) of y = A theta + e, by the joint covariance."""
    rng = np.random.default_rng(3)
    slope, prior = rng.normal(size=(7, 3)), np.diag([0.5, 2.0, 1.0])
    prior[0, 1] = prior[1, 0] = 0.4
    data = slope @ prior @ slope.T + np.eye(7)
    both = np.block([[prior, prior @ slope.T], [slope @ prior, data]])
    entropies = [0.5 * np.linalg.slogdet(m)[1] for m in (prior, data, both)]
    expected = entropies[0] + entropies[1] - entropies[2]
    information = slope.T @ slope
    assert information_gain(np.linalg.inv(prior), information) == pytest.approx(expected, rel=1e-10)
    # About some parameters alone: the same with the others left out of the joint covariance.
    some = [0, 2]
    chosen = some + list(range(3, 10))
    part = prior[np.ix_(some, some)], data, both[np.ix_(chosen, chosen)]
    entropies = [0.5 * np.linalg.slogdet(m)[1] for m in part]
    expected = entropies[0] + entropies[1] - entropies[2]
    assert information_gain(np.linalg.inv(prior), information, some) == pytest.approx(
        expected, rel=1e-10
    )


def test_covariance_of_parameters_known_very_differently():
    scale = np.diag([1.0, 1e6, 1e-3])
    correlation = np.array([[1.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.0]])
    expected = np.linalg.inv(scale) @ np.linalg.inv(correlation) @ np.linalg.inv(scale)
    np.testing.assert_allclose(covariance(scale @ correlation @ scale), expected, rtol=1e-12)


def test_the_worst_decile_counts_what_was_never_found():
    assert worst_decile(np.append(np.arange(9.0), np.inf)) == 8.0
    assert worst_decile(np.append(np.arange(8.0), [np.inf, np.inf])) == np.inf


@pytest.mark.release  # bounds in closed form are above
def test_predicted_spread_is_that_of_fits_to_noisy_records():
    import jax
    import jax.numpy as jnp
    from scipy.optimize import least_squares

    from jbw.observables.samples import band_limited, response_to

    test = PlannedSweep(level=0.06, start_hz=12.0, stop_hz=26.0, rate=2.8, rest=3.0, fs=512.0)
    theta, noise = JOINT, ResponseNoise(5e-4, "velocity")
    names = tuple(theta)
    prospect = prospects([test], beliefs_at(theta, 15.0, names), noise)[0]
    predicted = np.sqrt(np.diag(np.linalg.inv(prospect.information[0])))
    source = band_limited(chirp(np.arange(test.num_samples) / test.fs, test))

    @jax.jit
    def velocity(x):
        changed = {name: theta[name] * jnp.exp(d) for name, d in zip(names, x, strict=True)}
        return response_to({**changed, "gain": 15.0}, source, test.fs, substeps=2)

    slope = jax.jit(jax.jacfwd(velocity))
    clean, rng = np.asarray(velocity(np.zeros(5))), np.random.default_rng(0)
    fits = []
    for _ in range(40):
        noisy = clean + noise.std * rng.normal(size=clean.shape)
        fit = least_squares(
            lambda x, d=noisy: velocity(x) - d, np.zeros(5), jac=slope, x_scale=predicted
        )
        fits.append(fit.x)
    assert predicted[2] == pytest.approx(0.05, rel=0.7)  # of a size that is asked for
    # The spread of 40 fits is known to 1/sqrt(80) = 11 %, three of which are admitted.
    np.testing.assert_allclose(np.std(fits, axis=0), predicted, rtol=0.34)
