"""Hysteresis map and steady loop against golden numbers, 40-digit references and invariances."""

import warnings

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.laws.hysteresis import hysteresis_map, hysteresis_rate, steady_loop
from jbw.oscillator.oscillator import BoucWen

ALPHA, DELTA, GAMMA = 497.40, 340.21, 32.84


def joint(alpha=ALPHA, delta=DELTA, gamma=GAMMA, nu=1.0):
    return BoucWen(118.12, 0.00444, alpha, delta, gamma, nu=nu)


def mp_phi(c, x):
    return x if c == 0 else (1 - mp.exp(-c * x)) / c


def mp_loop(alpha, delta, gamma, y_peak, harmonics=True):
    """The steady loop from its two matching conditions, with 40 digits and nothing of jbw."""
    with mp.workdps(40):
        alpha, delta, gamma, y_peak = (mp.mpf(x) for x in (alpha, delta, gamma, y_peak))
        a, b = delta - gamma, delta + gamma
        # Loading from -y_0 and unloading to y_0 meet at the tip (Y, z_max).
        lower, upper = -y_peak, y_peak
        for _ in range(135):
            y_open = (lower + upper) / 2
            if mp_phi(b, y_peak + y_open) < mp_phi(a, y_peak - y_open):
                lower = y_open
            else:
                upper = y_open

        def unloading(y):
            return alpha * (mp_phi(a, y - y_open) if y > y_open else -mp_phi(b, y_open - y))

        area = mp.quad(unloading, [-y_peak, y_open, y_peak])
        loop = {
            "y_open": y_open,
            "z_max": alpha * mp_phi(b, y_peak + y_open),
            # Up along -Z(-y), down along Z(y): the even part of Z counts twice.
            "energy": -2 * area,
        }
        turn = mp.acos(y_open / y_peak)
        for n in (1, 3) if harmonics else ():
            z_n = mp.quad(
                lambda t, n=n: unloading(y_peak * mp.cos(t)) * mp.exp(-1j * n * t),
                [0, turn / 2, turn, (turn + mp.pi) / 2, mp.pi],
            )
            loop[f"z_{n}"] = 2 / mp.pi * z_n
        return loop


# --- rate ---------------------------------------------------------------------------------------


def test_rate_of_nu_1_is_equation_2():
    # By hand: 497.4*0.1 - 32.84*0.1*0.5 - 340.21*0.1*0.5, and with v, z < 0 the mirrored value.
    expected = 49.74 - 1.642 - 17.0105
    np.testing.assert_allclose(hysteresis_rate(joint(), 0.1, 0.5), expected, rtol=1e-15)
    np.testing.assert_allclose(hysteresis_rate(joint(), -0.1, -0.5), -expected, rtol=1e-15)
    np.testing.assert_allclose(hysteresis_rate(joint(), -0.1, 0.5), -49.74 - 1.642 + 17.0105)


def test_rate_of_nu_2_gives_the_hyperbolic_tangent():
    # On loading from zero dz/dy = alpha - b z^2, so z = sqrt(alpha/b) tanh(sqrt(alpha b) y).
    smooth = joint(delta=200.0, gamma=120.0, nu=2.0)
    y, v = np.linspace(0, 8e-3, 9), 0.3
    root = np.sqrt(ALPHA * 320.0)
    z = np.sqrt(ALPHA / 320.0) * np.tanh(root * y)
    slope = ALPHA / np.cosh(root * y) ** 2
    np.testing.assert_allclose(hysteresis_rate(smooth, v, z), v * slope, rtol=1e-13, atol=1e-10)


@pytest.mark.parametrize("nu", [0.7, 1.0, 1.5, 2.0, 3.0])
def test_rate_has_finite_derivatives_at_rest(nu):
    def rate(delta, gamma, v, z):
        return hysteresis_rate(joint(ALPHA, delta, gamma, nu), v, z)

    # At v = z = 0 only alpha v has a slope: the terms with |z|^nu are products of two zeros.
    slopes = jax.grad(rate, argnums=(0, 1, 2, 3))(DELTA, GAMMA, 0.0, 0.0)
    np.testing.assert_array_equal(slopes, (0.0, 0.0, ALPHA, 0.0))


# --- map ----------------------------------------------------------------------------------------


def test_map_golden(golden):
    for case in golden["hysteresis_map"]["cases"]:
        law = joint(case["alpha"], case["delta"], case["gamma"])
        z = hysteresis_map(law, case["Z0"], case["dy"])
        # 1 ulp golden; two more for the compiled exponential and the product.
        np.testing.assert_allclose(z, case["Z1"], rtol=7e-16, err_msg=str(case))


@pytest.mark.parametrize(
    ("delta", "gamma"), [(340.21, 32.84), (32.84, 340.21), (340.21, -100.0), (-50.0, 90.0)]
)
def test_map_solves_equation_2(delta, gamma):
    for z_0, dy in [(0.6, -4e-3), (-0.6, -4e-3), (-0.6, 4e-3), (0.3, 2e-3)]:

        def slope(y, z, up=dy > 0):
            return ALPHA - gamma * (z if up else -z) - delta * np.abs(z)

        path = solve_ivp(slope, (0, dy), [z_0], method="DOP853", rtol=1e-12, atol=1e-14)
        # The integrator steps over the kink at z = 0; its error there is about 1e-10.
        z = hysteresis_map(joint(ALPHA, delta, gamma), z_0, dy)
        np.testing.assert_allclose(z, path.y[0, -1], rtol=0, atol=2e-9)


laws = st.builds(
    joint,
    alpha=st.floats(1.0, 1e5),
    delta=st.floats(0.0, 1e3),
    gamma=st.floats(1.0, 1e3),
)
fractions = st.floats(-0.9, 0.9)
moves = st.floats(-3.0, 3.0)


def at(law, fraction, move):
    """A start within the bound and a move, scaled to the law: z_0, dy and the bound."""
    rate = law.delta + law.gamma
    return fraction * law.alpha / rate, move / rate, law.alpha / rate


def moved(law, z, dy):
    return float(hysteresis_map(law, z, dy))


# Rounding of z_0 grows by at most exp(3) along such a move: 20 * a few ulp of the bound.
ATOL = 1e-14


@given(laws, fractions, moves)
@settings(max_examples=60, deadline=None)
def test_map_is_odd_and_bounded(law, fraction, move):
    z, dy, bound = at(law, fraction, move)
    image = moved(law, z, dy)
    assert moved(law, -z, -dy) == pytest.approx(-image, abs=ATOL * bound)
    assert abs(image) <= bound * (1 + ATOL)


@given(laws, fractions, moves, st.floats(0.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_map_of_two_moves_is_the_map_of_their_sum(law, fraction, move, share):
    z, dy, bound = at(law, fraction, move)
    halfway = moved(law, z, share * dy)
    image = moved(law, halfway, dy - share * dy)
    assert image == pytest.approx(moved(law, z, dy), abs=3 * ATOL * bound)


@given(laws, fractions, moves, st.floats(0.01, 100.0), st.floats(0.01, 100.0))
@settings(max_examples=60, deadline=None)
def test_map_scales_with_amplitude_and_time(law, fraction, move, s, c):
    z, dy, bound = at(law, fraction, move)
    scaled = joint(law.alpha / c**2, law.delta / s, law.gamma / s)
    image = moved(scaled, s * z / c**2, s * dy)
    expected = s / c**2 * moved(law, z, dy)
    assert image == pytest.approx(expected, abs=ATOL * bound * s / c**2)


@given(st.floats(-10.0, 10.0), st.floats(-1.0, 1.0))
@settings(max_examples=30, deadline=None)
def test_map_without_hysteresis_is_a_spring(z, dy):
    image = moved(joint(delta=0.0, gamma=0.0), z, dy)
    assert image == pytest.approx(z + ALPHA * dy, rel=1e-14, abs=1e-12)


@pytest.mark.parametrize(
    ("delta", "gamma"),
    [(340.21, 32.84), (340.21, 340.21), (340.21, -340.21), (0.0, 32.84), (0.0, 0.0), (50.0, 0.0)],
)
@pytest.mark.parametrize(
    ("z", "dy"), [(0.4, -2e-3), (0.4, -5e-4), (-0.4, 2e-3), (0.0, 1e-3), (0.3, 0.0), (0.0, 0.0)]
)
def test_map_gradients_forward_and_reverse(delta, gamma, z, dy):
    def image(x):
        return hysteresis_map(joint(x[0], x[1], x[2]), x[3], x[4])

    x = jnp.array([ALPHA, delta, gamma, z, dy])
    reverse = np.asarray(jax.grad(image)(x))
    np.testing.assert_allclose(jax.jacfwd(image)(x), reverse, rtol=1e-12, atol=1e-14)

    def exact(x):
        with mp.workdps(40):
            alpha, d, g, z, dy = x
            s = -1 if dy < 0 else 1
            z, distance = s * z, s * dy
            if z < 0:
                c = g - d
                reach = -z / alpha if c == 0 else mp.log(1 - c * z / alpha) / c
                if distance <= reach:
                    return s * (z + (alpha - c * z) * mp_phi(c, distance))
                z, distance = mp.mpf(0), distance - reach
            return s * (z + (alpha - (g + d) * z) * mp_phi(g + d, distance))

    for i in range(5):
        with mp.workdps(40):
            point = [mp.mpf(float(v)) for v in x]
            h = mp.mpf(10) ** -13
            # dy = 0 and z = 0 are kinks in some of the arguments: one side, that of loading.
            left = 0 if i >= 3 and float(x[i]) == 0.0 else h
            up, down = list(point), list(point)
            up[i], down[i] = point[i] + h, point[i] - left
            slope = float((exact(up) - exact(down)) / (h + left))
        # The one-sided quotient is good to about 1e-10 of the second derivative.
        np.testing.assert_allclose(reverse[i], slope, rtol=2e-9, atol=1e-13)


def test_map_broadcasts_under_jit_and_vmap():
    laws = joint(delta=jnp.array([[300.0], [340.0]]))
    z, dy = jnp.array([-0.3, 0.0, 0.3]), -1e-3
    together = hysteresis_map(laws, z, dy)
    alone = jax.vmap(lambda d: jax.jit(hysteresis_map)(joint(delta=d), z, dy))(laws.delta[:, 0])
    assert together.shape == (2, 3)
    np.testing.assert_allclose(together, alone, rtol=1e-15)


def test_map_doors():
    with pytest.raises(ModelError, match=r"nu = 1\.5"):
        hysteresis_map(joint(nu=1.5), 0.0, 1e-3)
    with pytest.raises(ModelError, match="`gamma` must be finite, but it is nan"):
        hysteresis_map(joint(gamma=np.nan), 0.0, 1e-3)
    with pytest.raises(ModelError, match="`dy` must be finite, but it is inf"):
        hysteresis_map(joint(), 0.0, np.array([0.0, np.inf]))
    with pytest.raises(ModelError, match="`nu` must be greater than 0"):
        hysteresis_rate(joint(nu=0.0), 0.0, 0.0)


def test_map_warns_only_where_z_is_unbounded():
    with pytest.warns(UserWarning, match=r"\|z\| = 2, above alpha/\(delta - gamma\)"):
        hysteresis_map(joint(), 2.0, -1e-3)
    with pytest.warns(UserWarning, match="delta \\+ gamma >= 0"):
        hysteresis_map(joint(delta=-100.0), 0.0, 1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hysteresis_map(joint(), 2.0, 1e-3)  # relaxes back to its bound
        jax.jit(hysteresis_map)(joint(), 2.0, -1e-3)  # never under tracing
        jax.vmap(lambda z: hysteresis_map(joint(), z, -1e-3))(jnp.array([2.0]))


# --- steady loop --------------------------------------------------------------------------------


def test_loop_golden(golden):
    for case in golden["steady_loop"]["cases"]:
        law, y_peak = joint(case["alpha"], case["delta"], case["gamma"]), case["Y"]
        loop = steady_loop(law, y_peak)
        # Golden is good to 2e-14; the scale keeps gamma = 0 in, where y_open and energy vanish.
        for name, key in [
            ("y_open", "y0"),
            ("z_max", "Zmax"),
            ("energy", "E_cycle"),
            ("k_eq", "k_eq"),
            ("c_eq_omega", "c_eq_times_omega"),
            ("secant_stiffness", "secant_stiffness"),
        ]:
            np.testing.assert_allclose(getattr(loop, name), case[key], rtol=2e-14, err_msg=key)
        for n in (1, 3, 5):
            z_n = complex(getattr(loop, f"z_{n}"))
            expected = complex(*case[f"Z{n}"])
            assert abs(z_n - expected) < 1e-15 * case["alpha"] * y_peak, (n, case)


@pytest.mark.parametrize(
    ("d", "g"),
    [(1e-6, 1e-7), (20.0, 2.0), (20.0, 1e-6), (10.0, 10.1), (0.3, 20.0), (-3.0, 1.0), (-8.0, -9.0)],
)
def test_loop_over_its_whole_range(d, g):
    # In units of Y, up to delta Y = 20, three times the strongest sweep; delta < 0 hardens.
    loop = steady_loop(joint(1.0, d, g), 1.0)
    exact = mp_loop(1.0, d, g, 1.0)
    for name in ("y_open", "z_max"):
        np.testing.assert_allclose(getattr(loop, name), float(exact[name]), rtol=2e-14)
    # The reference integrates the closed loop, which cancels: 40 digits leave enough.
    np.testing.assert_allclose(loop.energy, float(exact["energy"]), rtol=2e-14)
    for name in ("z_1", "z_3"):
        size = max(1.0, float(loop.z_max))
        assert abs(complex(getattr(loop, name)) - complex(exact[name])) < 3e-15 * size


def test_loop_small_amplitude_series():
    # Theory to the order given; what is left out is (delta Y)^2 = 1e-7 relative.
    y = 1e-6
    loop = steady_loop(joint(), y)
    z_3 = -4 / (15 * np.pi) * ALPHA * (DELTA + 1j * GAMMA) * y**2
    z_3 += ALPHA * ((DELTA**2 + GAMMA**2) / 24 - 2j * DELTA * GAMMA / (9 * np.pi)) * y**3
    np.testing.assert_allclose(loop.y_open, GAMMA * y**2 / 2 * (1 + DELTA * y / 3), rtol=1e-6)
    np.testing.assert_allclose(loop.energy, 4 / 3 * ALPHA * GAMMA * y**3, rtol=1e-6)
    np.testing.assert_allclose(loop.z_3, z_3, rtol=1e-6)


def test_loop_of_no_amplitude_is_a_spring():
    loop = steady_loop(joint(), 0.0)
    np.testing.assert_array_equal([loop.y_open, loop.z_max, loop.energy], 0.0)
    np.testing.assert_array_equal([loop.k_eq, loop.secant_stiffness], ALPHA)

    def force(y):
        loop = steady_loop(joint(), y)
        return loop.z_max, loop.z_3

    @jax.jit
    def derivatives(y):
        return jax.jacfwd(force)(y), jax.jacfwd(jax.jacfwd(force))(y)

    # Series: z_max = alpha (Y - delta Y^2/2), Z_3 = O(Y^2).
    slope, bend = derivatives(0.0)
    np.testing.assert_allclose(slope, (ALPHA, 0.0), rtol=1e-14)
    curvature = -8 / (15 * np.pi) * ALPHA * (DELTA + 1j * GAMMA)
    np.testing.assert_allclose(bend, (-ALPHA * DELTA, curvature), rtol=1e-12)


def test_loop_opening_closes_the_map():
    # From the tip to y_open the exact map must reach zero, and over a cycle return to the tip.
    for y_peak in (1e-4, 8e-4, 4.8e-3, 2e-2):
        loop = steady_loop(joint(), y_peak)
        z = hysteresis_map(joint(), loop.z_max, loop.y_open - y_peak)
        assert abs(z) < 1e-14
        bottom = hysteresis_map(joint(), loop.z_max, -2 * y_peak)
        np.testing.assert_allclose(bottom, -loop.z_max, rtol=1e-13)


NAMES = ("y_open", "z_max", "energy", "z_1", "z_3")


@jax.jit
def loop_gradients(x):
    """Derivatives of a loop forward, and of its opening and energy in reverse."""

    def values(x):
        loop = steady_loop(joint(x[0], x[1], x[2]), x[3])
        return {name: getattr(loop, name) for name in NAMES}

    def two(x):
        found = values(x)
        return found["y_open"], found["energy"]

    return jax.jacfwd(values)(x), jax.jacrev(two)(x)


@pytest.mark.parametrize(
    ("delta", "gamma", "y_peak"),
    [
        (340.21, 32.84, 8e-4),
        (340.21, 32.84, 2e-2),
        (340.21, 340.21, 2.4e-3),
        (340.21, -340.21, 2.4e-3),
        (0.0, 32.84, 2.4e-3),
        (340.21, 0.0, 2.4e-3),
    ],
)
@pytest.mark.slow
def test_loop_gradients(delta, gamma, y_peak):
    x = (ALPHA, delta, gamma, y_peak)
    forward, reverse = loop_gradients(jnp.array(x))
    for name, row in zip(("y_open", "energy"), reverse, strict=True):
        np.testing.assert_allclose(row, forward[name], rtol=1e-11, atol=1e-18)
    for i in range(4):
        with mp.workdps(40):
            h = mp.mpf(10) ** -12 * (1 if i < 3 else y_peak)
            up, down = (mp_loop(*(v + s * h * (i == j) for j, v in enumerate(x))) for s in (1, -1))
        scale = abs(x[i]) or 1.0
        for name in NAMES:
            slope = complex((up[name] - down[name]) / (2 * h))
            # 1e-11: quadrature error of derivatives, which are rougher than the values.
            # Where gamma = 0, y_open and energy vanish, in the reference up to 1e-35.
            size = abs(complex(up[name])) + abs(slope) * scale + 1e-20
            assert abs(complex(forward[name][i]) - slope) * scale < 1e-11 * size, (name, i)


@pytest.mark.release  # first derivatives are in this file
def test_loop_second_derivative_across_gamma_zero():
    # Series: z_max = ... + (delta^2 - 2 gamma^2) Y^3/6, so d2/dgamma2 = -2/3 alpha Y^3 (1 + ...).
    def z_max(gamma):
        return steady_loop(joint(gamma=gamma), 2.4e-3).z_max

    curvature = jax.jit(jax.grad(jax.grad(z_max)))(0.0)
    with mp.workdps(40):
        h = mp.mpf(10) ** -8
        z = [mp_loop(ALPHA, DELTA, g, 2.4e-3, harmonics=False)["z_max"] for g in (-h, 0, h)]
        expected = float((z[0] - 2 * z[1] + z[2]) / h**2)
    # The second difference is good to h^2 = 1e-16 of the fourth derivative.
    np.testing.assert_allclose(curvature, expected, rtol=1e-9)


def test_loop_broadcasts_under_jit_and_vmap():
    y_peak = jnp.array([0.0, 8e-4, 4.8e-3])
    laws = joint(gamma=jnp.array([[32.84], [0.0]]))
    together = steady_loop(laws, y_peak)
    alone = jax.vmap(lambda g: jax.jit(steady_loop)(joint(gamma=g), y_peak))(laws.gamma[:, 0])
    assert together.z_3.shape == (2, 3)
    for one, other in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-18)


def test_loop_doors():
    with pytest.raises(ModelError, match="nu = 2"):
        steady_loop(joint(nu=2.0), 1e-3)
    with pytest.raises(ConfigError, match=r"`y_peak` must be at least 0, but it is -0\.001"):
        steady_loop(joint(), np.array([1e-3, -1e-3]))
    with pytest.raises(ModelError, match="`y_peak` must be finite"):
        steady_loop(joint(), np.nan)
    with pytest.warns(UserWarning, match="unit of the displacement"):
        steady_loop(joint(), 0.8)
