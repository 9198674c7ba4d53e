"""Paths and smoothing polynomials against golden numbers and the conditions that define them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.laws.hysteresis import steady_loop
from jbw.oscillator.oscillator import BoucWen
from jbw.paper.coefficients import (
    Smoothing,
    branch,
    loading_force,
    smoothed_force,
    smoothing,
    smoothing_error,
    unloading_force,
)

STRONG = pytest.mark.filterwarnings("ignore:The smoothing holds for weak hysteresis")
ALPHA, DELTA, GAMMA = 497.40, 340.21, 32.84
VARIANTS = {
    "least_squares": "unloading_c_exponential_L2",
    "chebyshev": "unloading_c_exponential_chebyshev",
    "taylor_least_squares": "unloading_c_taylor_L2",
}


def joint(alpha=ALPHA, delta=DELTA, gamma=GAMMA, nu=1.0):
    return BoucWen(118.12, 0.00444, alpha, delta, gamma, nu=nu)


def law_of(case):
    return joint(case["alpha"], case["delta"], case["gamma"])


def coefficients(polynomial):
    return np.array([float(getattr(polynomial, f"lambda_{n}")) for n in range(4)])


def terms(case):
    """Size of each coefficient's term at y = Y over alpha Y."""
    return case["Y"] ** np.arange(4) / (case["alpha"] * case["Y"])


# --- paths --------------------------------------------------------------------------------------


def test_paths_golden(golden):
    for case in golden["branches_eq3_6"]["cases"]:
        law = law_of(case)
        for path in (1, 2, 3, 4):
            exact = branch(law, case["y"], case["y0"], path)
            cubic = branch(law, case["y"], case["y0"], path, order=3)
            # 1 ulp golden; two more for the compiled arithmetic.
            np.testing.assert_allclose(exact, case[f"Z{path}"], rtol=7e-16)
            np.testing.assert_allclose(cubic, case[f"T3_Z{path}"], rtol=7e-16)


@pytest.mark.parametrize(
    ("path", "sign_v", "sign_z"), [(1, -1, 1), (2, -1, -1), (3, 1, -1), (4, 1, 1)]
)
def test_paths_solve_equation_2(path, sign_v, sign_z):
    y_open = 5e-5
    zero = y_open if sign_v < 0 else -y_open
    end = zero + 2e-3 * sign_z

    def slope(y, z):
        return ALPHA - GAMMA * sign_v * z - DELTA * sign_z * z

    exact = solve_ivp(slope, (zero, end), [0.0], method="DOP853", rtol=1e-12, atol=1e-15).y[0, -1]
    np.testing.assert_allclose(branch(joint(), end, y_open, path), exact, rtol=1e-11)


def test_taylor_paths_converge_to_the_closed_form():
    # |c x| = 0.76: the remainder after order 20 is below 0.76^20 / 21! = 1e-22.
    y = np.linspace(-2e-3, 2e-3, 5)
    for path in (1, 2, 3, 4):
        np.testing.assert_allclose(
            branch(joint(), y, 4e-5, path, order=20), branch(joint(), y, 4e-5, path), rtol=1e-14
        )


def test_paths_are_straight_where_the_rate_vanishes():
    y, y_open = 1.3e-3, 2e-4
    line = ALPHA * (y - y_open)
    np.testing.assert_allclose(branch(joint(gamma=DELTA), y, y_open, 1), line, rtol=1e-15)
    np.testing.assert_allclose(branch(joint(gamma=-DELTA), y, y_open, 2), line, rtol=1e-15)


# --- coefficients -------------------------------------------------------------------------------


@STRONG
@pytest.mark.parametrize("variant", VARIANTS)
def test_smoothing_golden(golden, variant):
    for case in golden["lambda"]["cases"]:
        expected = np.array(case[VARIANTS[variant]]) * [-1, 1, 1, 1]
        found = coefficients(smoothing(law_of(case), case["Y"], variant))
        # Golden is good to 1e-13 of the largest term (closed form) or 1e-14.
        error = np.abs(found - expected) * terms(case)
        assert np.all(error <= 1e-14 * max(1.0, np.max(np.abs(expected) * terms(case)))), case
        if variant != "taylor_least_squares" and abs(case["gamma"]) > 1:
            # lambda_3 keeps its own digits at small amplitude, where it is 1e-2 of the line.
            np.testing.assert_allclose(found[3], expected[3], rtol=1e-13)


@STRONG
def test_printed_equations_golden(golden):
    for case in golden["lambda"]["cases"]:
        for variant, key in [
            ("printed", "paper_eq10_13_raw"),
            ("printed_closed", "paper_eq24_25"),
        ]:
            found = coefficients(smoothing(law_of(case), case["Y"], variant))
            error = np.abs(found - np.array(case[key])) * terms(case)
            # Rounding of a few terms, the largest of them (delta Y)^2/6 = 8 at 20 mm.
            assert np.all(error < 1e-14 * max(1.0, np.max(np.abs(case[key]) * terms(case)))), case


@STRONG
def test_closed_loop_golden(golden):
    for case in golden["lambda"]["cases"]:
        found = smoothing(law_of(case), case["Y"], "taylor_least_squares", y_open=0.0)
        expected = np.array(case["taylor_L2_with_y0_zero"]) * [-1, 1, 1, 1]
        error = np.abs(coefficients(found) - expected) * terms(case)
        assert np.all(error < 1e-14 * max(1.0, np.max(np.abs(expected) * terms(case))))


@pytest.mark.parametrize(
    ("variant", "order", "weight"),
    [
        ("least_squares", None, lambda s: 1.0),
        ("taylor_least_squares", 3, lambda s: 1.0),
        ("chebyshev", None, lambda s: 1.0 / np.sqrt(1.0 - s**2)),
    ],
)
@pytest.mark.parametrize("gamma", [GAMMA, -120.0, DELTA])
def test_the_error_is_orthogonal_to_every_cubic(variant, order, weight, gamma):
    # The defining property of Eq. (9)'s minimiser, for a threshold off the steady loop too.
    law, y_peak, y_open = joint(gamma=gamma), 2.4e-3, 3.1e-4
    polynomial = smoothing(law, y_peak, variant, y_open)
    scale = ALPHA * y_peak

    nodes, w = np.polynomial.legendre.leggauss(40)
    turn = np.arccos(y_open / y_peak)
    residual = np.zeros(4)
    for low, high in ((0.0, turn), (turn, np.pi)):
        # In theta = arccos(y/Y) every weight is smooth: ds = sin(theta) dtheta.
        theta = low + 0.5 * (high - low) * (nodes + 1.0)
        s = np.cos(theta)
        z = np.asarray(branch(law, s * y_peak, y_open, 1 if low == 0.0 else 2, order))
        error = (z - np.asarray(smoothed_force(polynomial, s * y_peak, -1.0))) / scale
        measure = 0.5 * (high - low) * w * np.sin(theta) * weight(s)
        residual += [np.sum(measure * error * s**n) for n in range(4)]
    # The fit's error is 1e-2; its projections must vanish to rounding.
    np.testing.assert_allclose(residual, 0.0, atol=1e-14)


@STRONG
def test_chebyshev_keeps_the_cosine_harmonics():
    for y_peak in (1e-4, 8e-4, 4.8e-3, 2e-2):
        loop, polynomial = steady_loop(joint(), y_peak), smoothing(joint(), y_peak, "chebyshev")
        third = polynomial.lambda_3 * y_peak**3 / 4
        first = polynomial.lambda_1 * y_peak + 3 * third
        np.testing.assert_allclose(first, loop.z_1.real, rtol=1e-13)
        np.testing.assert_allclose(third, loop.z_3.real, rtol=1e-13)


@STRONG
def test_uniform_fit_overestimates_the_third_harmonic():
    # Theory section 3: by (35/384)/(4/(15 pi)) as Y -> 0, 1.084 at 0.8 mm and 1.109 at 4.8 mm.
    limit = 35 / 384 / (4 / (15 * np.pi))
    # The limit is approached as delta Y = 3e-5; the other two are quoted to three decimals.
    for y_peak, ratio, digits in [(1e-7, limit, 1e-4), (8e-4, 1.084, 1e-3), (4.8e-3, 1.109, 1e-3)]:
        third = smoothing(joint(), y_peak).lambda_3 * y_peak**3 / 4
        found = third / steady_loop(joint(), y_peak).z_3.real
        np.testing.assert_allclose(found, ratio, atol=digits)


def test_smoothed_loop_dissipates():
    # By hand, the area of the smoothed loop is 4 Y lambda_0 - 4/3 lambda_2 Y^3.
    y_peak = 8e-4
    polynomial = smoothing(joint(), y_peak)

    def gap(y):
        return float(smoothed_force(polynomial, y, 1.0) - smoothed_force(polynomial, y, -1.0))

    area = quad(gap, -y_peak, y_peak)[0]
    by_hand = 4 * y_peak * polynomial.lambda_0 - 4 / 3 * polynomial.lambda_2 * y_peak**3
    np.testing.assert_allclose(area, by_hand, rtol=1e-12)
    # The uniform fit keeps the integral of the unloading path, so the area is exact.
    np.testing.assert_allclose(area, steady_loop(joint(), y_peak).energy, rtol=1e-11)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("gamma", [GAMMA, DELTA, 0.0])
@pytest.mark.slow
def test_smoothing_gradients(variant, gamma):
    x = np.array([ALPHA, DELTA, gamma, 2.4e-3])
    steps = 1e-3 * np.array([ALPHA, DELTA, DELTA, 2.4e-3])

    def values(shift):
        """Coefficients in units of their terms at y = Y, shifted by so many steps."""
        alpha, delta, gamma, y_peak = x + shift * steps
        polynomial = smoothing(joint(alpha, delta, gamma), y_peak, variant)
        leaves = jnp.stack([getattr(polynomial, f"lambda_{n}") for n in range(4)])
        return leaves * x[3] ** np.arange(4) / (ALPHA * x[3])

    forward = np.asarray(jax.jacfwd(values)(np.zeros(4)))
    # Both modes run the same formulas; rounding of terms of size 1e-3.
    np.testing.assert_allclose(jax.jacrev(values)(np.zeros(4)), forward, rtol=0, atol=1e-16)
    for i, unit in enumerate(np.eye(4)):
        outer, inner = (np.asarray(values(k * unit) - values(-k * unit)) for k in (2.0, 1.0))
        # Differences of fourth order over 1e-3 of each parameter: 1e-12 of the value.
        np.testing.assert_allclose(forward[:, i], (8 * inner - outer) / 12, rtol=0, atol=1e-12)


@STRONG
def test_smoothing_broadcasts_under_jit_and_vmap():
    y_peak = jnp.array([1e-4, 8e-4, 4.8e-3])
    laws = joint(delta=jnp.array([[340.21], [0.0]]))
    together = smoothing(laws, y_peak)
    alone = jax.vmap(lambda d: smoothing(joint(delta=d), y_peak))(laws.delta[:, 0])
    assert together.lambda_3.shape == (2, 3)
    for one, other in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_smoothed_force_switches_on_the_velocity():
    polynomial = Smoothing(lambda_0=0.5, lambda_1=2.0, lambda_2=3.0, lambda_3=-1.0)
    # By hand at y = 2: unloading -0.5 + 4 + 12 - 8, loading 0.5 + 4 - 12 - 8, mean at rest.
    np.testing.assert_array_equal(smoothed_force(polynomial, 2.0, -1e-9), 7.5)
    np.testing.assert_array_equal(smoothed_force(polynomial, 2.0, 1e-9), -15.5)
    np.testing.assert_array_equal(smoothed_force(polynomial, 2.0, 0.0), -4.0)


def test_motion_beyond_a_weak_one_is_warned_of_with_delta_y():
    with pytest.warns(UserWarning, match=r"delta\*y_peak = 1\.63"):
        smoothing(joint(), 4.8e-3)


def test_branch_forces_are_the_polynomials_of_7_and_8():
    polynomial = Smoothing(lambda_0=0.5, lambda_1=2.0, lambda_2=3.0, lambda_3=-1.0)
    # By hand at y = 2.
    assert float(unloading_force(polynomial, 2.0)) == -0.5 + 4.0 + 12.0 - 8.0
    assert float(loading_force(polynomial, 2.0)) == 0.5 + 4.0 - 12.0 - 8.0
    assert float(loading_force(polynomial, 2.0)) == -float(unloading_force(polynomial, -2.0))


def test_smooth_switching_joins_the_branches():
    polynomial = Smoothing(lambda_0=0.5, lambda_1=2.0, lambda_2=3.0, lambda_3=-1.0)
    between = smoothed_force(polynomial, 2.0, 0.1, width=0.2)
    # By hand: the mean of the branches, -4, and tanh(1/2) of half their distance, -11.5.
    assert float(between) == pytest.approx(-4.0 - 11.5 * np.tanh(0.5), rel=1e-14)
    slope = jax.grad(lambda v: smoothed_force(polynomial, 2.0, v, width=0.2))(0.0)
    assert float(slope) == pytest.approx(-11.5 / 0.2, rel=1e-14)


def test_least_squares_minimise_equation_9():
    law, y_peak = joint(), 8e-4
    y_open = float(steady_loop(law, y_peak).y_open)
    polynomial = smoothing(law, y_peak)
    cubic = coefficients(polynomial) * [-1, 1, 1, 1]

    def square(y, path):
        z = ALPHA * (1 - np.exp(-(DELTA - GAMMA) * (y - y_open))) / (DELTA - GAMMA)
        if path == 2:
            z = -ALPHA * (1 - np.exp(-(DELTA + GAMMA) * (y_open - y))) / (DELTA + GAMMA)
        return (z - np.polynomial.polynomial.polyval(y, cubic)) ** 2

    by_quadrature = quad(square, -y_peak, y_open, args=(2,), epsabs=0)[0]
    by_quadrature += quad(square, y_open, y_peak, args=(1,), epsabs=0)[0]
    found = smoothing_error(law, polynomial, y_peak)
    # The integrand is the square of a difference of 1e-2 of the force: it loses four digits.
    np.testing.assert_allclose(found, by_quadrature, rtol=1e-10)
    slope = jax.grad(lambda p: smoothing_error(law, p, y_peak))(polynomial)
    # Moved by a thousandth of its size, each coefficient changes J by less than rounding of J.
    for leaf, change in zip(jax.tree.leaves(polynomial), jax.tree.leaves(slope), strict=True):
        assert abs(float(change * leaf) * 1e-3) < 1e-9 * float(found)


def test_smoothing_doors():
    with pytest.raises(ConfigError, match='`variant` must be one of "least_squares", "chebyshev"'):
        smoothing(joint(), 1e-3, "best")
    with pytest.raises(ConfigError, match="`y_peak` must be greater than 0"):
        smoothing(joint(), 0.0)
    with pytest.raises(ModelError, match="`y_open` must lie between"):
        smoothing(joint(), 1e-3, y_open=2e-3)
    with pytest.raises(ModelError, match=r"nu = 1\.2"):
        smoothing(joint(nu=1.2), 1e-3)
    with pytest.raises(ConfigError, match="`path` must be 1, 2, 3 or 4"):
        branch(joint(), 0.0, 0.0, 5)
    with pytest.raises(ConfigError, match="`order` must be at least 1"):
        branch(joint(), 0.0, 0.0, 1, order=0)
