r"""Harmonic balance of the oscillator in dimensionless form, solved by Newton's method.

Harmonics are stored as real arrays of shape (2, harmonic), or (2, joint, harmonic) for a structure:
real and imaginary parts of the odd orders 1, 3, 5, ... of y = Re sum q_n exp(j n theta).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float, Int, Shaped

from jbw.oscillator.checks import require_periodic
from jbw.oscillator.law import Law, map_laws
from jbw.oscillator.modes.balance import modal_imbalance, modal_response, modal_units
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.newton import newton_root
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.steady.waveform import num_turns, orders

Packed = Float[Array, "2 *joint harmonic"]

# Newton's last step shows the error of the previous iterate. Because convergence is quadratic, the
# returned value is accurate to round-off.
_TOLERANCE = 1e-8
_MAX_NEWTON = 16
_MAX_LOADS = 64
_LEAST_LOAD_STEP = 1e-3


def pack(q: Complex[Array, "*joint harmonic"]) -> Packed:
    """Return the real and imaginary parts of complex amplitudes."""
    return jnp.stack([q.real, q.imag])


def unpack(packed: Packed) -> Complex[Array, "*joint harmonic"]:
    """Return the complex amplitudes from their real and imaginary parts."""
    return jax.lax.complex(packed[0], packed[1])


# An oscillator or structure in dimensionless form. The motion of a structure is that of its joints,
# along an axis of joints.
Unit = Oscillator | Structure


def linear_response(joint: Unit, omega: Scalar, num_harmonics: int) -> Packed:
    r"""Return the response of the fully stuck joint, q_1 = 1/(1 - Omega^2 + 2 j zeta Omega)."""
    if isinstance(joint, Structure):
        return pack(modal_response(joint, omega, num_harmonics))
    first = np.arange(num_harmonics) == 0
    return pack(jnp.where(first, 1.0 / _dynamic_stiffness(joint, omega, np.ones(1)), 0.0))


def imbalance(
    joint: Joint,
    omega: Scalar,
    q: Complex[Array, " harmonic"],
    load: Shaped[ArrayLike, " harmonic"],
    max_turns: int = 2,
) -> Complex[Array, " harmonic"]:
    r"""Return the residual of harmonic balance for a given motion, one value per harmonic.

    $$R_n = (\omega_n^2 - n^2\omega^2 + 2j\zeta\omega_n n\omega)\,q_n + \sum r_n - u_n$$

    where r = F - K y, so that the stiffness omega_n^2 of the stuck joint is not split. Each law
    computes its own harmonics: Bouc-Wen by quadrature between the turning points and zeros of z,
    whose steady value at the turning points is solved for, not marched.
    """
    r_n = _dynamic_stiffness(joint, omega, orders(q.shape[0])) * q - load
    return reduce(add, (law.harmonics(q, max_turns, omega) for law in joint.laws), r_n)


def refined(
    joint: Joint,
    omega: Scalar,
    start: Complex[Array, " harmonic"],
    load: Complex[Array, " harmonic"],
    num_steps: int = 2,
) -> Complex[Array, " harmonic"]:
    r"""Refine a close guess of the motion, such as a measured one, by a few Newton steps.

    $$q \leftarrow q - R_q^{-1} R(q)$$

    Each step squares the error. The derivatives are those of the last step; these are the implicit
    ones if it has converged.

    Args:
        joint: The oscillator.
        omega: Angular frequency [rad/s].
        start: Guess of the odd harmonics of y [m].
        load: Odd harmonics of the force per unit mass [N/kg].
        num_steps: Number of Newton steps.

    Returns:
        Odd harmonics of y [m].

    Raises:
        ModelError: nu is not 1, or a spring has an even part.
    """
    joint = as_oscillator(joint)
    require_periodic(joint)

    def packed_imbalance(x: Float[Array, " unknown"]) -> Float[Array, " unknown"]:
        return pack(imbalance(joint, omega, unpack(x.reshape(2, -1)), load)).ravel()

    packed = newton_steps(packed_imbalance, pack(start).ravel(), num_steps).reshape(2, -1)
    return unpack(packed)


def newton_steps(
    function: Callable[[Float[Array, " unknown"]], Float[Array, " unknown"]],
    x: Float[Array, " unknown"],
    num_steps: int,
) -> Float[Array, " unknown"]:
    r"""Take a few Newton steps $x \leftarrow x - f_x^{-1} f(x)$ from a close guess.

    The derivatives are those of the last step; these are the implicit ones if it has converged. The
    slopes are computed only in the loop, without tangents of the values the function closes over,
    because they are most of the compilation.
    """
    x = jax.lax.stop_gradient(x)
    converted, closed_over = jax.closure_convert(function, x)
    constants = jax.lax.stop_gradient(closed_over)

    def with_value(x: Float[Array, " unknown"]) -> tuple[Array, Array]:
        value = converted(x, *constants)
        return value, value

    def step(_: Any, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, *_ = carry
        slope, value = jax.jacfwd(with_value, has_aux=True)(x)
        return x - jnp.linalg.solve(slope, value), x, slope

    start = x, x, jnp.zeros((x.size, x.size))
    _, before, slope = jax.lax.fori_loop(0, num_steps, step, start)
    return before - jnp.linalg.solve(slope, converted(before, *closed_over))


def residual(packed: Packed, problem: tuple[Unit, Scalar], max_turns: int) -> Packed:
    """Return the residual of dimensionless harmonic balance under the load cos(Omega theta)."""
    joint, omega = problem
    q = unpack(packed)
    if isinstance(joint, Structure):
        load = orders(q.shape[-1]) == 1
        return pack(modal_imbalance(joint, omega, q, load, max_turns))
    return pack(imbalance(joint, omega, q, orders(q.shape[0]) == 1, max_turns))


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def balance(
    joint: Unit, omega: Scalar, start: Packed, max_turns: int
) -> tuple[Packed, Float[Array, ""]]:
    """Solve harmonic balance in as few load steps as possible; return also the load reached.

    The full load is tried at once from `start`. If that fails, the load rises from the linear
    response in steps, halved on failure and doubled on success. The derivatives are implicit: they
    cost one linear solve and do not depend on the path. The load reached is 1 if the solution
    converged.
    """
    linear = linear_response(joint, omega, start.shape[-1])

    def unfinished(state: tuple) -> Array:
        load, step, _, tries = state
        return (load < 1.0) & (tries < _MAX_LOADS) & (step > _LEAST_LOAD_STEP)

    def advance(state: tuple) -> tuple:
        load, step, packed, tries = state
        next_load = jnp.minimum(load + step, 1.0)
        laws = map_laws(partial(_loaded, next_load), joint.laws)
        loaded = replace(joint, laws=laws)
        tried, ok = newton(loaded, omega, packed, max_turns)
        fallback = jnp.where(load > 0.0, packed, linear)
        return (
            jnp.where(ok, next_load, load),
            jnp.where(ok, 2.0 * step, 0.5 * step),
            jnp.where(ok, tried, fallback),
            tries + 1,
        )

    none = jnp.zeros_like(omega)
    load, _, packed, _ = jax.lax.while_loop(unfinished, advance, (none, none + 1.0, start, 0))
    return packed, load


def _loaded(load: Scalar, law: Law) -> Law:
    return law.scaled(load, 1.0)


@balance.defjvp
def _balance_jvp(max_turns: int, primals: tuple, tangents: tuple) -> tuple:
    """Return the change dq of the solution for given parameter changes, from R_q dq = -dR."""
    joint, omega, start = primals
    packed, load = balance(joint, omega, start, max_turns)
    _, change = jax.jvp(
        lambda joint, omega: residual(packed, (joint, omega), max_turns),
        (joint, omega),
        tangents[:2],
    )
    jacobian = jax.jacfwd(residual)(packed, (joint, omega), max_turns)
    size = packed.size
    step = jnp.linalg.solve(jacobian.reshape(size, size), -change.ravel())
    return (packed, load), (step.reshape(packed.shape), jnp.zeros_like(load))


def most_turns(q: Complex[Array, "*joint harmonic"]) -> Int[Array, ""]:
    """Return the largest number of turning points per period of any joint."""
    return num_turns(q) if q.ndim == 1 else jnp.max(jax.vmap(num_turns)(q))


def tone_from(
    start: Packed, unit: Unit, ratio: Array, length: Array, max_turns: int
) -> tuple[Packed, tuple[Array, Array]]:
    """Solve harmonic balance for one tone; return harmonics (NaN if invalid) and turning points."""
    packed, load = balance(unit, ratio, start, max_turns)
    q = unpack(packed)
    turns = most_turns(q)
    good = (load == 1.0) & (turns <= max_turns)
    return packed, (jnp.where(good, length * q, jnp.nan), turns)


def newton(
    joint: Unit, omega: Scalar, start: Packed, max_turns: int
) -> tuple[Packed, Bool[Array, ""]]:
    """Solve harmonic balance at full load by Newton's method, from `start`."""
    packed, converged = newton_root(
        partial(residual, max_turns=max_turns), start, (joint, omega),
        tolerance=_TOLERANCE, max_steps=_MAX_NEWTON,
    )  # fmt: skip
    return packed, converged & jnp.all(jnp.isfinite(packed))


def _dynamic_stiffness(
    joint: Joint, omega: Scalar, n: Float[np.ndarray, "..."]
) -> Complex[Array, "..."]:
    frequency = jnp.asarray(omega) * n
    return (
        jnp.asarray(joint.omega_n) ** 2 - frequency**2 + 2j * joint.zeta * joint.omega_n * frequency
    )


def dimensionless(
    oscillator: Oscillator | Structure, omega: Scalar, amplitude: Scalar
) -> tuple[Any, Array, Array]:
    r"""Return the dimensionless oscillator and frequency, and the unit of displacement [m].

    $$\Omega = \omega/\omega_n, \quad \ell = A/\omega_n^2, \quad
      F(\ell q)/A, \quad y = \ell q$$
    """
    if isinstance(oscillator, Structure):
        return modal_units(oscillator, omega, amplitude)
    stiffness = oscillator.omega_n**2
    length = jnp.asarray(amplitude / stiffness)
    laws = tuple(law.scaled(length, stiffness) for law in oscillator.laws)
    unit = Oscillator(jnp.ones_like(length), oscillator.zeta, laws)
    return unit, jnp.asarray(omega / oscillator.omega_n), length
