r"""Steady motion under a periodic record, and shooting for a tone, by integration in time.

A period of many cycles forgets nearly all of its initial state, and is marched. A short period does
not: at small amplitude its hysteresis forgets only a few per cent per period. Newton's iteration
settles it, with the map's slope by finite differences: a few runs of the solve that is compiled
anyway. Exact tangents would be a second program, four times as long to compile.

Shooting over half a period of a tone is an alternative to harmonic balance.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from jbw.errors import ModelError
from jbw.oscillator.checks import (
    is_concrete,
    require_at_least,
    require_finite,
    require_float64,
    require_periodic,
)
from jbw.oscillator.dimensionless import dimensionless
from jbw.oscillator.laws.hysteresis import hysteresis_rate
from jbw.oscillator.newton import newton_root
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import orders

MAX_ITERATIONS = 400
# The search stops if the change of state over a period has not fallen by a tenth within this number
# of rounds.
_PATIENCE, _PROGRESS = 20, 0.9
# Relative step of the finite difference for the derivative; smaller steps are unreliable.
_DIFFERENCE = 1e-7
# Velocity [m/s] that determines the size of the finite-difference step of an oscillator at rest.
_SLOW = 1e-2
# A change of the state is round-off if it is below this fraction of the state's largest entry.
_NOTHING = 1e-14
# relative tolerance of a periodic state; over a long period, rounding is a few parts in 1e13
_TOLERANCE = 1e-12
_NEWTON_STEPS = 4  # usual number of Newton steps to a periodic state
_MAX_STEPS = 16384  # largest number of steps of integration over a period
_MAX_NEWTON = 32  # largest number of iterations of the shooting method
# Tolerance of the shooting method. It is larger than the integration's error (1e-13), which is
# amplified near a fold; the last Newton step gives the remaining digits.
_SHOOTING_TOLERANCE = 1e-8

State = Float[Array, "3"]


def steady_period(
    period: Callable[[Any], Any], guess: Any, unit: Any, *, one_by_one: bool = False
) -> tuple[Any, Float[Array, ""]]:
    """Return the periodic trajectory, which ends one period later in its initial state.

    States are pytrees of scalars, of one mode or several. A Newton step is accepted if it reduces
    the gap; otherwise one period is marched. Derivatives of the result come from the implicit
    function theorem and are exact. `unit` converts the leaves of the state to velocities; it is
    zero for counters, which grow for ever and need not return. The residual is the remaining change
    of the state relative to its largest value. Under vmap, states settle one after another if
    `one_by_one` is set.
    """
    _, tree = jax.tree.flatten(guess)
    units = jax.lax.stop_gradient(jnp.stack([jnp.asarray(x) for x in jax.tree.leaves(unit)]))

    def state(x):
        return jax.tree.unflatten(tree, list(x / jnp.where(units > 0.0, units, 1.0)))

    def packed(state):
        return units * jnp.stack([jnp.asarray(leaf) for leaf in jax.tree.leaves(state)])

    def gap(x):
        return packed(jax.tree.map(lambda leaf: leaf[-1], period(state(x)))) - x

    settle = _settle_one_by_one if one_by_one else _settle
    start = jax.lax.custom_root(gap, packed(guess), settle, _solve_linear)
    trajectory = period(state(start))
    leaves = jnp.stack(jax.tree.leaves(trajectory))
    scale = units * jnp.max(jnp.abs(leaves), axis=1)
    change = units * jnp.abs(leaves[:, -1] - leaves[:, 0])
    # Unused entries of an internal state contain round-off, which may change.
    nothing = change <= _NOTHING * jnp.max(scale)
    residual = jnp.max(jnp.where(nothing, 0.0, change) / jnp.where(nothing, 1.0, scale))
    return jax.tree.map(lambda x: x[:-1], trajectory), jax.lax.stop_gradient(residual)


def _settle_one_by_one(gap: Callable, x: Float[Array, " state"]) -> Float[Array, " state"]:
    """Find the steady state as `_settle` does, for one oscillator of a batch after another.

    Side by side, all lanes would be solved again until the last one has settled.
    """
    # The values that differ between oscillators are made arguments (`hidden`), because vmap must
    # see them.
    of_all, hidden = jax.closure_convert(gap, x)

    @jax.custom_batching.sequential_vmap
    def settled(x, *hidden):
        return _settle(lambda x: of_all(x, *hidden), x)

    return settled(x, *hidden)


def _settle(gap: Callable, x: Float[Array, " state"]) -> Float[Array, " state"]:
    r"""Find the steady state: simulate periods while that is efficient, then take Newton steps.

    Each marched period multiplies the gap by some $\rho$, and costs 1. A Newton step of n numbers
    costs n + 1, and four of them suffice: marching costs less where $\rho^{4(n + 1)}$ is the
    tolerance. The map appears in the loop only once, because a time solver is slow to compile. The
    search stops if the motion approaches no period, as with laws that feed energy into it.
    """
    pays = _TOLERANCE ** (1.0 / (_NEWTON_STEPS * (x.size + 1)))

    def unsettled(carry):
        x, rest, *_, idle, count = carry
        done = (_norm(rest) <= _TOLERANCE * _norm(x)) | jnp.isnan(_norm(rest))
        return (count < MAX_ITERATIONS) & (idle < _PATIENCE) & ~done

    def improve(carry):
        x, rest, tried, sloped, is_newton, least, idle, count = carry
        tried_gap, slope = _value_and_slope(gap, tried, sloped)
        accepted = ~is_newton | (_norm(tried_gap) < _norm(rest))
        marching = ~sloped & (_norm(tried_gap) <= pays * _norm(rest))
        x, rest = jnp.where(accepted, tried, x), jnp.where(accepted, tried_gap, rest)
        is_newton = accepted & sloped
        step = jax.lax.cond(is_newton, lambda: -_solved(slope, tried_gap), lambda: rest)
        nearer = _norm(rest) < _PROGRESS * least
        least, idle = jnp.where(nearer, _norm(rest), least), jnp.where(nearer, 0, idle + 1)
        return x, rest, x + step, ~marching, is_newton, least, idle, count + 1

    nowhere, no = jnp.full_like(x, jnp.inf), jnp.asarray(False)
    begun = x, nowhere, x, no, no, jnp.inf, 0, 0
    return jax.lax.while_loop(unsettled, improve, begun)[0]


def _value_and_slope(
    gap: Callable, x: Float[Array, " state"], sloped: Bool[Array, ""]
) -> tuple[Float[Array, " state"], Float[Array, "state state"]]:
    """Return a state's change over a period and, where `sloped`, its derivative (by differences).

    Later Newton steps correct the error of the slope.
    """
    size = _DIFFERENCE * (_norm(x) + _SLOW)
    points = jnp.concatenate([x[None], x + size * jnp.eye(x.size)])

    def more(i, values):
        return values.at[i].set(gap(points[i]))

    values = jax.lax.fori_loop(0, jnp.where(sloped, len(points), 1), more, jnp.zeros_like(points))
    return values[0], (values[1:] - values[0]).T / size


def _solve_linear(linear: Callable, y: Float[Array, " state"]) -> Float[Array, " state"]:
    """Solve a small linear system whose matrix is computed one column at a time."""
    matrix = jnp.stack([linear(column) for column in jnp.eye(y.size)], axis=1)
    return _solved(matrix, y)


def _solved(
    matrix: Float[Array, "state state"], y: Float[Array, " state"]
) -> Float[Array, " state"]:
    """Solve a small system; take the shortest solution if constant states make it singular.

    With a single memory, of a law that always relaxes, the system is regular.
    """
    if y.size <= 3:
        return jnp.linalg.solve(matrix, y)
    return jnp.linalg.pinv(matrix, rtol=_DIFFERENCE) @ y


def _norm(x: Float[Array, " state"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x))


class PeriodicOrbit(eqx.Module):
    """A periodic response to u = A cos(omega t), found by integration in time.

    Attributes:
        initial: (y [m], v [m/s], z [N/kg]) at t = 0.
        harmonics: Complex peak amplitudes of orders 1, 3, 5, ... [m].
        multipliers: Eigenvalues of the half-period map x -> -x(T/2) about the orbit [-]; the orbit
            is stable where all lie inside the unit circle.
    """

    initial: State
    harmonics: Complex[Array, " harmonic"]
    multipliers: Complex[Array, "3"]


def shooting(
    joint: BoucWen,
    omega: Scalar,
    amplitude: Scalar,
    num_harmonics: int = 8,
    *,
    initial: tuple[Scalar, Scalar, Scalar] | None = None,
    rtol: float = 1e-12,
) -> PeriodicOrbit:
    r"""Compute the periodic response to a tone by shooting over half a period.

    $$x(T/2; x_0) = -x_0, \qquad x = (y, v, z), \quad T = 2\pi/\omega$$

    The rates (1)-(2) are integrated by Dormand and Prince's eighth-order method under a tight
    tolerance, and the harmonics are integrated with them. No closed form of the hysteresis and no
    truncation enters, so the result is independent of `steady_state`. Each call solves one tone
    (use `jax.vmap` for more); the result is differentiable in forward mode.

    Args:
        joint: Bouc-Wen parameters, scalars, with nu = 1.
        omega: Angular frequency of the tone [rad/s].
        amplitude: Amplitude A of the force [N/kg]; not zero.
        num_harmonics: Number of odd harmonics to report; has no influence on the orbit.
        initial: (y, v, z) to start Newton's iteration from; the linear response if None.
        rtol: Relative tolerance of the time integration.

    Returns:
        The orbit; NaN where the iteration did not converge.

    Raises:
        ModelError: The iteration did not converge, nu is not 1, the restoring force has an
            even part, or an argument is not finite.
        ConfigError: An argument is not positive, or JAX runs in float32.

    Reference:
        Eqs. (1), (2), as printed.

    Examples:
        Integration in time and harmonic balance give the same first harmonic:

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> orbit = jbw.shooting(joint, omega=37.7, amplitude=5.0)
        >>> y = jbw.steady_state(joint, omega=37.7, amplitude=5.0)
        >>> print(f"{1e3 * abs(orbit.harmonics[0]):.4f} mm, {1e3 * abs(y[0]):.4f} mm")
        0.3999 mm, 0.3999 mm
    """
    require_periodic(joint)
    require_finite(joint, omega=omega, amplitude=amplitude)
    require_at_least("omega", omega, 0.0, open_end=True)
    require_at_least("amplitude", amplitude, 0.0, open_end=True)
    require_float64()
    orbit = _shoot(joint, omega, amplitude, initial, num_harmonics, rtol)
    if is_concrete(orbit) and bool(jnp.isnan(orbit.initial).any()):
        raise ModelError(
            f"Shooting did not converge at omega = {omega}, amplitude = {amplitude}.",
            remedy="Give an `initial` near the periodic orbit, for example the state that was "
            "found at a lower amplitude.",
        )
    return orbit


@partial(jax.jit, static_argnums=(4, 5))
def _shoot(
    joint: BoucWen,
    omega: Scalar,
    amplitude: Scalar,
    initial: tuple[Scalar, Scalar, Scalar] | None,
    num_harmonics: int,
    rtol: float,
) -> PeriodicOrbit:
    joint, omega, amplitude = jax.tree.map(
        lambda x: jnp.asarray(x, float), (joint, omega, amplitude)
    )
    unit, ratio, length = dimensionless(joint, omega, amplitude)
    # y, y' and z/alpha divided by the length; the derivative is with respect to theta = omega t.
    scale = length * jnp.stack([jnp.ones_like(omega), omega, joint.alpha])
    if initial is None:
        q = 1.0 / (1.0 - ratio**2 + 2j * unit.zeta * ratio)
        start = jnp.stack([q.real, -q.imag, q.real])
    else:
        start = jnp.stack([jnp.asarray(x, float) for x in initial]) / scale

    def mismatch(x: State, problem: tuple[BoucWen, Scalar]) -> State:
        return _half_period(x, problem, 0, rtol)[0] + x

    x, converged = newton_root(
        mismatch, jax.lax.stop_gradient(start), (unit, ratio),
        tolerance=_SHOOTING_TOLERANCE, max_steps=_MAX_NEWTON,
    )  # fmt: skip
    _, harmonics = _half_period(x, (unit, ratio), num_harmonics, rtol)
    slope = jax.jacfwd(lambda x: -_half_period(x, (unit, ratio), 0, rtol)[0])(x)
    return PeriodicOrbit(
        initial=jnp.where(converged, x, jnp.nan) * scale,
        harmonics=jnp.where(converged, length * harmonics, jnp.nan),
        multipliers=jnp.where(converged, jnp.linalg.eigvals(slope), jnp.nan),
    )


def _half_period(
    x: State, problem: tuple[BoucWen, Scalar], num_harmonics: int, rtol: float
) -> tuple[State, Complex[Array, " harmonic"]]:
    """Return the state after half a period, and the harmonics of y as integrals over it."""
    unit, ratio = problem
    unity = jnp.ones_like(ratio)
    law = BoucWen(unity, unity, unity, unit.delta, unit.gamma)
    n = orders(num_harmonics)

    def rate(theta: Any, state: tuple, _: None) -> tuple:
        (y, p, z), _, _ = state
        force = jnp.cos(theta) - (1.0 - unit.alpha) * y - unit.alpha * z
        if unit.restoring is not None:
            force = force - unit.restoring(y)
        curvature = (force - 2.0 * unit.zeta * ratio * p) / ratio**2
        motion = jnp.stack([p, curvature, hysteresis_rate(law, p, z)])
        weight = 2.0 / jnp.pi * y
        return motion, weight * jnp.cos(n * theta), -weight * jnp.sin(n * theta)

    none = jnp.zeros(num_harmonics)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        diffrax.Dopri8(),
        t0=0.0,
        t1=jnp.pi,
        dt0=None,
        y0=(x, none, none),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * jnp.max(jnp.abs(x))),
        adjoint=diffrax.ForwardMode(),
        max_steps=_MAX_STEPS,
        throw=False,
    )
    final, cosines, sines = (part[-1] for part in solution.ys)  # pyright: ignore
    return final, jax.lax.complex(cosines, sines)
