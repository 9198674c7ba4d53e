"""A smooth restoring force beside the hysteretic one, against SciPy and golden Duffing numbers."""

from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

from jbw.errors import ModelError
from jbw.oscillator.laws.springs import Cubic, Polynomial
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.periodic import shooting
from jbw.oscillator.response import simulate
from jbw.oscillator.steady.backbone import backbone, frequency_response
from jbw.oscillator.steady.balance import imbalance, refined
from jbw.oscillator.steady.continuation import response_curve
from jbw.oscillator.steady.cycle import steady_state
from jbw.paper.coefficients import smoothing
from jbw.paper.equivalent import equivalent_acceleration
from jbw.paper.kernels import h3, third_harmonic

OMEGA_N = 2 * np.pi * 18.8
PAPER = (OMEGA_N, 0.00444, 497.4, 340.21, 32.84)
LINEAR = (OMEGA_N, 0.00444, 497.4, 0.0, 0.0)
# Stiffens by 13 % of omega_n^2 at 3 mm.
LAMBDA_3 = 2e8
FS = 256.0
TIME = np.arange(97) / FS
INPUT = 5.0 * np.sin(2 * np.pi * 15.0 * TIME) + 3.0 * np.cos(2 * np.pi * 4.0 * TIME)


def joint(law=PAPER, lambda_3=LAMBDA_3):
    return BoucWen(*law, restoring=Cubic(lambda_3))


def rates(law, force, u):
    """Right side of Eqs. (1), (2) with a force beside z."""
    omega_n, zeta, alpha, delta, gamma = law

    def field(t, x):
        y, v, z = x
        a = u(t) - 2 * zeta * omega_n * v - (omega_n**2 - alpha) * y - z - force(y)
        return [v, a, alpha * v - gamma * abs(v) * z - delta * v * abs(z)]

    return field


def component(solution, i, t):
    return solution(t)[i]


def by_scipy(law, force, u, fs):
    """States at the samples, the input joined by lines, every kink located and stepped on."""
    time = np.arange(len(u)) / fs
    field = rates(law, force, lambda t: np.interp(t, time, u))
    states = [np.zeros(3)]
    for start, stop in pairwise(time):
        now, x = start, states[-1]
        while now < stop:
            piece = solve_ivp(
                field, (now, stop), x, "DOP853", rtol=1e-13, atol=1e-16, dense_output=True
            )
            grid = np.linspace(now, stop, 9)[1:]
            kinks = [
                brentq(along, a, b, xtol=1e-16)
                for along in (partial(component, piece.sol, i) for i in (1, 2))
                for a, b in pairwise(grid)
                if along(a) * along(b) < 0.0
            ]
            end = min(kinks, default=stop)
            x = piece.sol(end) if kinks else piece.y[:, -1]
            now = end + 1e-14 if kinks else stop
        states.append(x)
    return np.array(states).T


def odd_polynomial(y):
    return 3e4 * y**2 + 1e8 * y**3


CASES = {
    "duffing": (LINEAR, Cubic(LAMBDA_3), lambda y: LAMBDA_3 * y**3),
    "softening": (PAPER, Cubic(-LAMBDA_3), lambda y: -LAMBDA_3 * y**3),
    "stiffening": (PAPER, Cubic(LAMBDA_3), lambda y: LAMBDA_3 * y**3),
    "polynomial": (PAPER, Polynomial((3e4, 1e8)), odd_polynomial),
    "function": (PAPER, lambda y: 2.0 * jnp.sinh(400.0 * y), lambda y: 2.0 * np.sinh(400.0 * y)),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow
def test_response_is_of_order_4_and_that_of_scipy(name):
    law, restoring, force = CASES[name]
    exact = by_scipy(law, force, INPUT, FS)
    scale = np.max(np.abs(exact), axis=1)[:, None]
    errors = []
    for substeps in (2, 4, 16):
        r = simulate(BoucWen(*law, restoring=restoring), INPUT, FS, substeps=substeps)
        errors.append(np.max(np.abs(np.stack([r.y, r.v, r.z]) - exact) / scale))
    # Halving the step divides the error by 16; a kink near a step's end makes it 12 at times.
    assert errors[0] < 3e-5
    assert errors[0] > 10.0 * errors[1]
    assert errors[1] > 120.0 * errors[2]
    assert errors[2] < 1e-8
    y, v, z = exact
    wanted = INPUT - 2 * law[1] * law[0] * v - (law[0] ** 2 - law[2]) * y - z - force(y)
    np.testing.assert_allclose(r.a, wanted, rtol=0, atol=1e-6 * np.max(np.abs(wanted)))


def test_duffing_harmonics_match_golden(golden):
    for case in golden["cubic_equivalent_steady"]["cases"]:
        law = (case["omega0"], case["zeta"], 500.0, 0.0, 0.0)
        found = steady_state(joint(law, case["lambda3"]), case["w"], case["A"], num_harmonics=10)
        wanted = [complex(*case[name]) for name in ("Y1", "Y3", "Y5")]
        # The golden numbers' own accuracy: 1e-11, and 1e-9 for the fifth order.
        np.testing.assert_allclose(found[:2], wanted[:2], rtol=2e-11)
        np.testing.assert_allclose(found[2], wanted[2], rtol=2e-9)


def scipy_harmonics(law, force, omega, amplitude, start):
    """Orders 1, 3, 5 by half-period shooting with a tight SciPy integration."""
    field = rates(law, force, lambda t: amplitude * np.cos(omega * t))
    half = np.pi / omega

    def run(x, dense=False):
        return solve_ivp(field, (0, half), x, "DOP853", rtol=1e-11, atol=1e-15, dense_output=dense)

    unit = np.array([1.0, omega, law[2]])
    found = root(lambda x: run(x * unit).y[:, -1] / unit + x, np.asarray(start) / unit, tol=1e-13)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    theta = 0.5 * np.pi * (nodes + 1.0)
    y = run(found.x * unit, dense=True).sol(theta / omega)[0]
    return np.array([np.sum(weights * y * np.exp(-1j * n * theta)) for n in (1, 3, 5)])


@pytest.mark.slow
@pytest.mark.parametrize(("lambda_3", "amplitude"), [(LAMBDA_3, 5.0), (-LAMBDA_3, 2.0)])
def test_steady_state_is_that_of_shooting_and_of_scipy(lambda_3, amplitude):
    omega = 0.9 * OMEGA_N
    balanced = np.asarray(
        steady_state(joint(lambda_3=lambda_3), omega, amplitude, num_harmonics=12)
    )
    orbit = shooting(joint(lambda_3=lambda_3), omega, amplitude)
    # What twelve harmonics leave out.
    np.testing.assert_allclose(orbit.harmonics[:3], balanced[:3], rtol=1e-6)
    np.testing.assert_allclose(orbit.harmonics[0], balanced[0], rtol=1e-9)
    scipy = scipy_harmonics(PAPER, lambda y: lambda_3 * y**3, omega, amplitude, orbit.initial)
    # SciPy steps over the kinks; its error there is about 1e-9 of Y_1.
    np.testing.assert_allclose(balanced[:3], scipy, rtol=0, atol=1e-8 * np.abs(scipy[0]))


@pytest.mark.slow
def test_periodic_record_is_the_steady_state():
    fs, period = 1024.0, 64
    u = 5.0 * np.cos(2 * np.pi * np.arange(period) / period)
    response = simulate(joint(), u, fs, hold="band_limited", periodic=True, substeps=4)
    found = 2.0 * np.fft.rfft(response.y)[[1, 3]] / period
    wanted = np.asarray(steady_state(joint(), 2 * np.pi * fs / period, 5.0))[:2]
    # The step's error, 1e-9 of Y_1.
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-8 * np.abs(wanted[0]))


def test_stock_solver_includes_the_force():
    fast = simulate(joint(), INPUT, FS, substeps=16)

    def held(t):
        return jnp.interp(t, TIME, INPUT)

    stock = simulate(joint(), held, FS, num_samples=TIME.size)
    # The stock solver's tolerance, 1e-9 a step, and its kinks.
    scale = float(np.max(np.abs(fast.y)))
    np.testing.assert_allclose(stock.y, fast.y, rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(stock.a, fast.a, rtol=0, atol=1e-5 * np.max(np.abs(fast.a)))


def central(function, x, step):
    """Fourth-order difference."""
    near, far = (np.asarray(function(x + n * step) - function(x - n * step)) for n in (1, 2))
    return (8.0 * near - far) / (12.0 * step)


@pytest.mark.release  # the steady state has them, below; test_law_contract.py the cubic
@pytest.mark.parametrize("law", [PAPER, LINEAR], ids=["hysteretic", "duffing"])
def test_derivatives_of_the_response(law):
    def last(lambda_3):
        return simulate(joint(law, lambda_3), INPUT, FS, substeps=8).v[-1]

    @jax.jit
    def both_modes(lambda_3):
        return jax.jacfwd(last)(lambda_3), jax.grad(last)(lambda_3)

    wanted = central(last, LAMBDA_3, 2e-4 * LAMBDA_3)
    forward, backward = both_modes(LAMBDA_3)
    np.testing.assert_allclose(forward, backward, rtol=1e-10)
    # Differences of the converged solve: their error, and that of 50 steps a period.
    np.testing.assert_allclose(backward, wanted, rtol=1e-5)


@pytest.mark.slow
def test_derivatives_of_the_steady_state():
    def first(lambda_3):
        return jnp.abs(steady_state(joint(lambda_3=lambda_3), 0.9 * OMEGA_N, 5.0, 4)[0])

    program = jax.jit(jax.value_and_grad(first))
    wanted = central(lambda x: program(x)[0], LAMBDA_3, 1e-3 * LAMBDA_3)
    np.testing.assert_allclose(program(LAMBDA_3)[1], wanted, rtol=1e-8)


@pytest.mark.release  # a force beside, as lanes of other laws
def test_lanes_are_the_single_responses():
    lambda_3 = jnp.array([-LAMBDA_3, 0.0, LAMBDA_3])
    batch = simulate(joint(lambda_3=lambda_3), INPUT, FS, substeps=2)
    tones = steady_state(joint(lambda_3=lambda_3), 0.9 * OMEGA_N, 5.0, 4)
    swept = frequency_response(joint(lambda_3=lambda_3), jnp.array([0.9 * OMEGA_N]), 5.0, 4)
    np.testing.assert_allclose(swept[:, 0], tones, rtol=0, atol=1e-12 * np.abs(tones).max())
    for i, value in enumerate(lambda_3):
        alone = simulate(joint(lambda_3=value), INPUT, FS, substeps=2)  # as of order 4 above
        np.testing.assert_allclose(batch.y[i], alone.y, rtol=0, atol=1e-12 * np.abs(alone.y).max())
        tone = steady_state(joint(lambda_3=value), 0.9 * OMEGA_N, 5.0, 4)
        np.testing.assert_allclose(tones[i], tone, rtol=0, atol=1e-12 * np.abs(tone[0]))


@pytest.mark.slow
def test_zero_force_is_the_papers_model():
    paper, zero = BoucWen(*PAPER), joint(lambda_3=0.0)
    for name in ("y", "v", "z", "a"):
        with_it, without = (
            getattr(simulate(j, INPUT, FS, substeps=2), name) for j in (zero, paper)
        )
        np.testing.assert_allclose(with_it, without, rtol=0, atol=1e-14 * np.abs(without).max())
    with_it, without = (steady_state(j, 0.9 * OMEGA_N, 5.0, 4) for j in (zero, paper))
    np.testing.assert_allclose(with_it, without, rtol=0, atol=1e-14 * np.abs(without[0]))
    with_it, without = (backbone(j, np.array([0.0, 1e-3])) for j in (zero, paper))
    np.testing.assert_allclose(with_it.omega, without.omega, rtol=1e-15)


def test_backbone_of_the_duffing_oscillator():
    y_peak = np.array([0.0, 1e-4, 3e-3])
    line = backbone(joint(LINEAR), y_peak)
    # The describing function of a cube is 3/4.
    np.testing.assert_allclose(line.omega**2, OMEGA_N**2 + 0.75 * LAMBDA_3 * y_peak**2, rtol=1e-14)


def test_backbone_is_the_phase_resonance_of_the_balance():
    line = backbone(joint(), 2e-3)
    # y lags the force by 90 degrees.
    left = imbalance(joint(), line.omega, jnp.array([-2e-3j]), jnp.array([line.amplitude]))
    np.testing.assert_allclose(left, 0.0, atol=1e-12 * OMEGA_N**2 * 2e-3)


@pytest.mark.release  # test_backbone.py has curves and folds
def test_curve_of_a_stiffening_joint_leans_to_the_right():
    strong = joint(lambda_3=2e9)
    curve = response_curve(strong, 0.9 * OMEGA_N, 1.25 * OMEGA_N, 0.3, 4)
    peak = np.argmax(np.abs(curve.harmonics[:, 0]))
    line = backbone(strong, np.abs(curve.harmonics[peak, 0]))
    assert curve.omega[peak] > 1.05 * OMEGA_N
    # The peak lies on the backbone, to the curve's spacing.
    np.testing.assert_allclose(curve.omega[peak], line.omega, rtol=1e-2)
    assert not np.all(curve.onward)
    on = np.flatnonzero(curve.onward)[3]
    tone = steady_state(strong, curve.omega[on], 0.3, 4)
    np.testing.assert_allclose(curve.harmonics[on], tone, rtol=0, atol=1e-9 * np.abs(tone[0]))


@pytest.mark.release  # the steady state is refined by it
def test_refined_includes_the_force():
    omega = 0.9 * OMEGA_N
    tone = steady_state(joint(), omega, 5.0, 4)
    load = jnp.zeros(4, complex).at[0].set(5.0)
    found = refined(joint(), omega, 1.001 * tone, load, num_steps=3)
    np.testing.assert_allclose(found, tone, rtol=0, atol=1e-12 * np.abs(tone[0]))


@pytest.mark.slow
def test_rest_is_an_ordinary_point():
    def first(amplitude):
        return steady_state(joint(), 0.9 * OMEGA_N, amplitude, 4)[0].real

    assert first(0.0) == 0.0
    # The linear response; what 1e-6 N/kg adds to it by hysteresis is 1e-8 of it.
    np.testing.assert_allclose(jax.jacfwd(first)(0.0), first(1e-6) / 1e-6, rtol=1e-7)


def test_equivalent_system_keeps_the_force():
    coefficients = smoothing(BoucWen(*PAPER), 1e-3)
    with_it, without = (
        equivalent_acceleration(j, coefficients, 1e-3, 0.1, 2.0) for j in (joint(), BoucWen(*PAPER))
    )
    np.testing.assert_allclose(without - with_it, LAMBDA_3 * 1e-9, rtol=1e-10)


def test_even_forces_are_refused_where_odd_orders_are_meant():
    even = BoucWen(*PAPER, restoring=Polynomial((3e4, 1e8)))
    other = BoucWen(*PAPER, restoring=lambda y: 3e4 * y * y)
    for bad in (even, other):
        for call in (
            lambda j: steady_state(j, 100.0, 1.0),
            lambda j: shooting(j, 100.0, 1.0),
            lambda j: backbone(j, 1e-3),
            lambda j: response_curve(j, 100.0, 110.0, 1.0),
            lambda j: frequency_response(j, jnp.array([100.0]), 1.0),
        ):
            with pytest.raises(ModelError, match="`restoring` must be an odd force"):
                call(bad)


def test_a_traced_even_coefficient_is_refused_and_an_absent_one_is_not():
    def first(c_2, c_3):
        restoring = Polynomial((c_2, c_3))
        return steady_state(BoucWen(*PAPER, restoring=restoring), 100.0, 5.0)

    with pytest.raises(ModelError, match="c_2 may act"):
        jax.eval_shape(first, 0.0, LAMBDA_3)
    assert jax.eval_shape(lambda c_3: first(None, c_3), LAMBDA_3).shape == (8,)
    assert jax.eval_shape(lambda c_3: first(0.0, c_3), LAMBDA_3).shape == (8,)


def test_polynomial_and_function_are_the_same_force_as_the_cube():
    q, load = jnp.array([1e-3 - 2e-4j, 1e-5j]), jnp.array([5.0, 0.0])
    wanted = imbalance(joint(), 100.0, q, load)
    for restoring in (
        Polynomial((None, LAMBDA_3)),
        Polynomial(np.array([0.0, LAMBDA_3])),
        lambda y: LAMBDA_3 * y * y * y,
    ):
        found = imbalance(BoucWen(*PAPER, restoring=restoring), 100.0, q, load)
        np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_kernels_of_the_paper_refuse_the_force():
    with pytest.raises(ModelError, match="`restoring` must be None for `h3`"):
        h3(joint(), 50.0, 1e-3)
    with pytest.raises(ModelError, match="`restoring` must be None for `third_harmonic`"):
        third_harmonic(joint(), 50.0, 1e-3)


def test_errors_name_the_forces_parameters():
    with pytest.raises(ModelError, match=r"`restoring\.lambda_3` must be finite"):
        steady_state(joint(lambda_3=np.nan), 100.0, 1.0)
    with pytest.raises(ModelError, match=r"restoring\.lambda_3 = -1e\+08"):
        steady_state(joint(lambda_3=-1e8), 0.6 * OMEGA_N, 100.0, 4)
    with pytest.raises(ModelError, match=r"diverges .* restoring"):
        simulate(joint(lambda_3=-1e13), INPUT, FS)


def test_record_keeps_its_old_form():
    old = BoucWen(*PAPER, 2.0)
    assert old.nu == 2.0
    assert old.restoring is None
    assert len(jax.tree.leaves(old)) == 5
    doubled = jax.tree.map(lambda x: 2.0 * x, joint())
    assert doubled.restoring.lambda_3 == 2.0 * LAMBDA_3
