r"""Periodic response of the joint to a tone, by harmonic balance."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact, Int, Real

from jbw.errors import ModelError
from jbw.oscillator import closed_path, folded_path
from jbw.oscillator.checks import is_concrete, require_closed_form, require_finite
from jbw.oscillator.harmonic_balance import dimensionless, linear_response, load, solve, unpack
from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.waveform import num_turns, synthesis

# Turning points a period that the eager call admits when two do not suffice.
_MANY_TURNS = 10


def steady_state(
    joint: BoucWen,
    omega: Real[ArrayLike, "..."],
    amplitude: Real[ArrayLike, "..."],
    num_harmonics: int = 8,
    *,
    max_turns: int = 2,
) -> Complex[Array, "... harmonic"]:
    r"""Odd harmonics Y_1, Y_3, Y_5, ... of the periodic response to u = A cos(omega t).

    $$(k - n^2\omega^2 + 2j\zeta\omega_n n\omega)\,Y_n + Z_n(Y) = A\,\delta_{n1}, \qquad
      y = \mathrm{Re}\sum_n Y_n e^{jn\omega t}$$

    The even harmonics vanish, the joint being odd. z is exact between its turning points, and its
    periodicity is solved for. What the harmonics left out cost (Y_1, Y_3), relatively: 8e-6 and
    3e-4 with 2 harmonics, 1e-6 and 3e-6 with 4, 4e-8 and 6e-8 with 8, at the paper's parameters
    between 5 and 19 Hz.

    Newton's iteration starts from the sticking joint; where it fails the load is raised in steps.
    Where several periodic responses exist (a joint that softens faster than it dissipates) one of
    them is returned; `response_curve` follows them all. Derivatives by every parameter, `omega`
    and `amplitude` are implicit, under jit, vmap, grad and jvp.

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        omega: Angular frequency of the tone [rad/s].
        amplitude: Amplitude A of the force [N/kg].
        num_harmonics: Number of odd harmonics.
        max_turns: Turning points of y allowed in a period, even. An eager call that meets more
            than 2 tries again with 10; under `jit` the result is NaN beyond `max_turns`.

    Returns:
        Complex peak amplitudes of orders 1, 3, ..., 2 num_harmonics - 1 [m], along a new last
        axis behind the broadcast shape of `joint`, `omega` and `amplitude`; NaN where the
        iteration did not converge.

    Raises:
        ModelError: Some response did not converge, nu is not 1, an argument is not finite or
            `omega` not positive, or JAX runs in float32.

    Reference:
        In place of Eqs. (19)-(31), which hold for weak nonlinearity.
    """
    _require_sense(joint, omega, amplitude, num_harmonics, max_turns)
    harmonics, turns = _steady(joint, omega, amplitude, num_harmonics, max_turns)
    if not is_concrete(joint, omega, amplitude):
        return harmonics
    if max_turns == 2 and np.any(np.asarray(turns) > 2):
        harmonics, turns = _steady(joint, omega, amplitude, num_harmonics, _MANY_TURNS)
    _require_converged(joint, omega, amplitude, harmonics, turns)
    return harmonics


def steady_cycle(
    joint: BoucWen,
    harmonics: Inexact[ArrayLike, "... harmonic"],
    omega: Real[ArrayLike, "..."],
    num_points: int = 256,
    *,
    max_turns: int = 2,
) -> tuple[Float[Array, "time"], *tuple[Float[Array, "... time"], ...]]:
    r"""One period of the motion with the given harmonics, and of its hysteretic force.

    $$y = \mathrm{Re}\sum_n Y_n e^{jn\theta}, \quad v = \omega\,y', \quad a = \omega^2 y''$$

    z is the exact steady force along y, closed over the period.

    Args:
        joint: Bouc-Wen parameters with nu = 1.
        harmonics: Complex peak amplitudes of orders 1, 3, 5, ... [m], as of `steady_state`.
        omega: Angular frequency of the tone [rad/s].
        num_points: Number of equally spaced phases.
        max_turns: Turning points of y in a period, at most.

    Returns:
        theta [rad], y [m], v [m/s], a [m/s^2], z [N/kg]; theta starts at 0 and the other axes
        lie before time.

    Raises:
        ModelError: nu is not 1.
    """
    require_closed_form(joint)
    theta = 2.0 * jnp.pi * jnp.arange(num_points) / num_points
    harmonics = jnp.asarray(harmonics, complex)
    leaves = (joint.alpha, joint.delta, joint.gamma, omega)
    shape = jnp.broadcast_shapes(harmonics.shape[:-1], *(jnp.shape(leaf) for leaf in leaves))
    flat = [jnp.broadcast_to(jnp.asarray(leaf, float), shape).ravel() for leaf in leaves]
    q = jnp.broadcast_to(harmonics, (*shape, harmonics.shape[-1])).reshape(-1, harmonics.shape[-1])

    def cycle(alpha: Array, delta: Array, gamma: Array, omega: Array, q: Array) -> tuple:
        motion = (omega**m * synthesis(q, theta, m) for m in range(3))
        if max_turns == 2:
            z = closed_path.force_over_period(q, theta, delta, gamma)
        else:
            z = folded_path.force_over_period(q, theta, delta, gamma, max_turns)
        return (*motion, alpha * z)

    parts = jax.vmap(cycle)(*flat, q)
    return theta, *(part.reshape(*shape, num_points) for part in parts)


@partial(jax.jit, static_argnums=(3, 4))
def _steady(
    joint: BoucWen, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int, max_turns: int
) -> tuple[Complex[Array, "... harmonic"], Int[Array, "..."]]:
    """Harmonics of a batch and the turning points a period; NaN where they are not the answer."""
    leaves = jax.tree.leaves((joint, omega, amplitude))
    leaves = jnp.broadcast_arrays(*(jnp.asarray(leaf, float) for leaf in leaves))

    def one(*leaves: Array) -> tuple[Array, Array]:
        *parameters, omega, amplitude = leaves
        unit, ratio, length = dimensionless(BoucWen(*parameters), omega, amplitude)
        start = load(unit, ratio, linear_response(unit, ratio, num_harmonics), max_turns)
        packed, converged = solve(unit, ratio, start, max_turns)
        q = unpack(packed)
        turns = num_turns(q)
        return jnp.where(converged & (turns <= max_turns), length * q, jnp.nan), turns

    harmonics, turns = jax.vmap(one)(*(leaf.ravel() for leaf in leaves))
    shape = leaves[0].shape
    return harmonics.reshape(*shape, num_harmonics), turns.reshape(shape)


def _require_sense(
    joint: BoucWen,
    omega: ArrayLike,
    amplitude: ArrayLike,
    num_harmonics: int,
    max_turns: int,
) -> None:
    """Refuse arguments that cannot be meant; trust traced ones."""
    require_closed_form(joint)
    require_finite(joint, omega=omega, amplitude=amplitude)
    if not jax.config.jax_enable_x64:
        raise ModelError(
            "The harmonic balance needs float64, but JAX runs in float32.",
            why="Near resonance the balance cancels half of float32's digits.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )
    if num_harmonics < 1:
        raise ModelError(f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.")
    if max_turns < 2 or max_turns % 2:
        raise ModelError(f"Argument `max_turns` must be even, 2 or more, but is {max_turns}.")
    for name, value in (("omega", omega), ("amplitude", amplitude)):
        least = -np.inf if not is_concrete(value) else float(np.min(value))
        if is_concrete(value) and (least < 0.0 or (name == "omega" and least == 0.0)):
            raise ModelError(f"Argument `{name}` must be positive, but it is {least:g}.")


def _require_converged(
    joint: BoucWen,
    omega: ArrayLike,
    amplitude: ArrayLike,
    harmonics: Complex[Array, "... harmonic"],
    turns: Int[Array, "..."],
) -> None:
    """Raise with the first tone whose response was not found."""
    failed = np.isnan(np.asarray(harmonics)).any(axis=-1)
    if not failed.any():
        return
    shape = failed.shape
    first = np.unravel_index(np.argmax(failed), shape)
    leaves = {"omega": omega, "amplitude": amplitude, **joint.__dict__}
    values = {
        name: float(np.broadcast_to(np.asarray(leaf), shape)[first])
        for name, leaf in leaves.items()
        if name != "nu"
    }
    text = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    raise ModelError(
        f"The periodic response did not converge for {failed.sum()} of {failed.size} tones, the "
        f"first at {text} ({int(np.asarray(turns)[first])} turning points a period).",
        why="Several periodic responses may exist there, or none that turns so rarely.",
        remedy="Lower `amplitude`, follow the branch with `response_curve`, or raise `max_turns`.",
    )
