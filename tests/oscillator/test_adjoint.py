"""Derivatives of the time response: golden gradients, both modes, lanes, higher order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiers import represented_by

from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.response import simulate
from tests.conftest import GOLDEN

SWEEPS = GOLDEN["sweep"]["cases"]
HOLD = {"foh": "first", "zoh": "zero", "analytic": "band_limited"}
NAMES = ("omega_n", "zeta", "alpha", "delta", "gamma")
FS = 512.0


def as_joint(values):
    return BoucWen(**{name: jnp.asarray(values[name], float) for name in NAMES})


def pull(joint, u, fs, weight_y, weight_v, hold, substeps):
    """Gradient of sum(weight_y y + weight_v v) in the order of NAMES, and the velocity."""

    def motion(joint):
        r = simulate(joint, u, fs, hold=hold, substeps=substeps)
        return r.y, r.v

    (_, v), back = jax.vjp(motion, joint)
    (gradient,) = back((weight_y, weight_v))
    return jnp.stack([getattr(gradient, name) for name in NAMES]), v


pull = jax.jit(pull, static_argnames=("hold", "substeps"))


def golden_gradient_errors(case, substeps):
    """Relative errors of the four golden gradients, number by number."""
    t = np.arange(case["N"] + 1) / case["fs"]
    u = case["A"] * np.sin(2 * np.pi * (case["f0"] * t + case["rate_hz_per_s"] * t**2 / 2))
    joint, truth = as_joint(case["params"]), as_joint(case["params_data"])
    hold, none = HOLD[case["input"]], np.zeros(len(t))

    def pulled(joint, weights):
        return pull(joint, u, case["fs"], *weights, hold=hold, substeps=substeps)

    v, v_data = (pulled(each, (none, none))[1] for each in (joint, truth))
    end, middle = none.copy(), none.copy()
    end[-1] = middle[case["index"][8]] = 1.0
    weights = {
        "gradJ1": (none, v),
        "gradJ2": (none, v - v_data),
        "dv_end": (none, end),
        "dy_mid": (middle, none),
    }
    errors = {}
    for name, pair in weights.items():
        gradient = np.asarray(pulled(joint, pair)[0])
        errors[name] = np.abs(gradient / np.array(case[name]) - 1.0)
    return errors


def label(case):
    return f"{case['input']}-{case['A']:g}"


@pytest.mark.parametrize("case", represented_by(*SWEEPS[:3]), ids=label)
def test_golden_gradients_at_four_substeps(case):
    for name, error in golden_gradient_errors(case, 4).items():
        # dJ1/d(omega_n) is what two large contributions leave of each other.
        assert error.max() < 1e-5, (name, error)
        assert np.median(error) < 1e-6, (name, error)


@pytest.mark.release  # golden gradients at four substeps are in this file
@pytest.mark.parametrize(  # one of each hold
    "case", represented_by(SWEEPS[1], *SWEEPS[3:5]), ids=label
)
def test_golden_gradients_converge_with_order_4(case):
    substeps = (1, 2, 4)
    errors = [
        np.concatenate(list(golden_gradient_errors(case, m).values())) for m in substeps
    ]  # fmt: skip
    # The median of 20 numbers: single ones cross zero on their way. (From 8 substeps on the golden
    # gradients, good to 1e-9, are no nearer to the truth.)
    order = -np.polyfit(np.log(substeps), np.log(np.median(errors, axis=1)), 1)[0]
    assert 3.5 < order < 4.5, (order, errors)
    assert np.max(errors[-1]) < 1e-5


@pytest.fixture(scope="module")
def setting():
    n = np.arange(300)
    u = jnp.asarray(30.0 * np.sin(0.25 * n + 3e-4 * n**2))
    return as_joint(SWEEPS[0]["params"]), u, tuple(jnp.asarray(x) for x in (1e-3, -0.02, 0.3))


def response(joint, u, initial):
    r = simulate(joint, u, FS, initial=initial, substeps=2)
    return jnp.stack([r.y * 100.0, r.v, r.z, 0.01 * r.a])


@pytest.mark.slow
def test_forward_and_reverse_agree(setting):
    weight = jnp.asarray(np.random.default_rng(0).normal(size=(4, 300)))
    direction = jax.tree.map(
        lambda x: 0.1 * x * jnp.cos(jnp.arange(x.size)).reshape(x.shape), setting
    )

    @jax.jit
    def both(setting, direction):
        f = lambda *args: jnp.sum(weight * response(*args))  # noqa: E731
        _, forward = jax.jvp(f, setting, direction)
        gradient = jax.grad(f, argnums=(0, 1, 2))(*setting)
        products = jax.tree.map(lambda g, d: jnp.sum(g * d), gradient, direction)
        return forward, sum(jax.tree.leaves(products))

    forward, reverse = both(setting, direction)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-10)


@pytest.mark.slow
def test_derivatives_match_differences_of_the_same_steps(setting):
    direction = jax.tree.map(
        lambda x: 0.1 * x * jnp.cos(jnp.arange(x.size)).reshape(x.shape), setting
    )
    _, tangent = jax.jit(lambda s, d: jax.jvp(response, s, d))(setting, direction)
    run = jax.jit(response)

    def shifted(h):
        return run(*jax.tree.map(lambda x, d: x + h * d, setting, direction))

    h = 1e-5
    difference = (shifted(h) - shifted(-h)) / (2 * h)
    # Steps whose kink moves into the next one make the discrete map bend: about 1e-6.
    scale = np.abs(tangent).max(axis=1, keepdims=True)
    assert np.abs((difference - tangent) / scale).max() < 2e-5


def last_velocity(theta, u, initial):
    return simulate(BoucWen(*theta), u, FS, initial=initial).v[-1]


gradient_of_last = jax.jit(jax.grad(last_velocity))


@pytest.mark.release  # both modes agree above, by any weights
def test_jacfwd_equals_jacrev(setting):
    joint, u, initial = setting
    theta = jnp.stack([getattr(joint, name) for name in NAMES])
    forward = jax.jit(jax.jacfwd(last_velocity))(theta, u, initial)
    reverse = gradient_of_last(theta, u, initial)
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)


@pytest.mark.slow
def test_lanes_equal_a_loop(setting):
    joint, u, initial = setting
    theta = jnp.stack([getattr(joint, name) for name in NAMES])
    thetas = theta * (1 + 0.02 * jnp.arange(3)[:, None] * jnp.array([1.0, -1.0, 1.0, 2.0, -3.0]))
    lanes = jax.jit(jax.vmap(jax.grad(last_velocity), in_axes=(0, None, None)))
    for lane, theta in zip(lanes(thetas, u, initial), thetas, strict=True):
        # Lanes and single solve differ in the order of their roundings.
        np.testing.assert_allclose(lane, gradient_of_last(theta, u, initial), rtol=1e-9)


@pytest.mark.slow
def test_hessian_matches_differences_of_gradients():
    """On a quiet stretch without kinks, where second derivatives exist."""
    u = jnp.asarray(3.0 * np.linspace(0.0, 1.0, 12))
    base = as_joint(SWEEPS[0]["params"])

    def end(delta, gamma):
        joint = BoucWen(base.omega_n, base.zeta, base.alpha, delta, gamma)
        return simulate(joint, u, FS, initial=(1e-4, 0.01, 0.05)).z[-1]

    @jax.jit
    def slopes(delta, gamma):
        return jax.grad(end)(delta, gamma), jax.hessian(end, argnums=(0, 1))(delta, gamma)

    _, hessian = slopes(base.delta, base.gamma)
    h = 0.05
    ahead, behind = (slopes(base.delta + s * h, base.gamma)[0] for s in (1, -1))
    difference = (ahead - behind) / (2 * h)
    assert float(hessian[0][0]) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.slow
def test_gradient_of_a_periodic_response_is_implicit():
    num = 64
    shape = jnp.asarray(np.cos(2 * np.pi * np.arange(num) / num))
    joint = as_joint(SWEEPS[0]["params"])

    def peak(amplitude, zeta):
        one = BoucWen(joint.omega_n, zeta, joint.alpha, joint.delta, joint.gamma)
        r = simulate(one, amplitude * shape, num * 17.0, hold="band_limited", periodic=True)
        return 1e3 * r.y[5]

    value, reverse = jax.jit(jax.value_and_grad(peak, argnums=(0, 1)))(2.0, 0.00444)
    run, h = jax.jit(peak), 1e-4
    difference = (run(2.0 + h, 0.00444) - run(2.0 - h, 0.00444)) / (2 * h)
    assert np.isfinite(value)
    assert float(reverse[0]) == pytest.approx(float(difference), rel=1e-6)
    h = 1e-6
    difference = (run(2.0, 0.00444 + h) - run(2.0, 0.00444 - h)) / (2 * h)
    assert float(reverse[1]) == pytest.approx(float(difference), rel=1e-5)


def test_rest_has_finite_derivatives():
    joint = as_joint(SWEEPS[0]["params"])
    gradient = jax.jit(
        jax.grad(lambda u: jnp.sum(simulate(joint, u, FS).y))
    )(jnp.zeros(50))  # fmt: skip
    assert np.all(np.isfinite(gradient))
    assert np.all(np.asarray(gradient[:-1]) > 0.0)
