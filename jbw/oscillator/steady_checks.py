"""What the periodic responses refuse before they start, and report after; tracers are trusted."""

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Int

from jbw.errors import ConfigError, ModelError
from jbw.oscillator.checks import (
    parameters,
    require_at_least,
    require_closed_form,
    require_finite,
)
from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.restoring import require_odd


def require_float64() -> None:
    """Raise in a float32 session.

    Raises:
        ConfigError: JAX runs in float32.
    """
    if not jax.config.jax_enable_x64:
        raise ConfigError(
            "The periodic response needs float64, but JAX runs in float32.",
            why="Near resonance the balance cancels half of float32's digits.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )


def require_sense(
    joint: BoucWen,
    omega: ArrayLike,
    amplitude: ArrayLike,
    num_harmonics: int,
    max_turns: int,
) -> None:
    """Raise where an argument cannot be meant; trust traced ones.

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequencies [rad/s].
        amplitude: Force amplitudes [N/kg].
        num_harmonics: Number of odd harmonics.
        max_turns: Turning points of y allowed in a period.

    Raises:
        ConfigError: An argument is out of its range, or JAX runs in float32.
        ModelError: nu is not 1, the restoring force has an even part, or an argument is not
            finite.
    """
    require_closed_form(joint)
    require_odd(joint)
    require_finite(joint, omega=omega, amplitude=amplitude)
    require_float64()
    if num_harmonics < 1:
        raise ConfigError(f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.")
    if max_turns < 2 or max_turns % 2:
        raise ConfigError(f"Argument `max_turns` must be even, 2 or more, but is {max_turns}.")
    require_at_least("omega", omega, 0.0, open_end=True)
    require_at_least("amplitude", amplitude, 0.0)


def require_converged(
    joint: BoucWen,
    omega: ArrayLike,
    amplitude: ArrayLike,
    harmonics: Complex[Array, "... harmonic"],
    turns: Int[Array, "..."],
) -> None:
    """Raise with the first tone whose response was not found.

    Args:
        joint: Bouc-Wen parameters.
        omega: Angular frequencies [rad/s].
        amplitude: Force amplitudes [N/kg].
        harmonics: What was found; NaN where nothing was.
        turns: Turning points a period of what the iteration ended at.

    Raises:
        ModelError: Some response was not found.
    """
    failed = np.isnan(np.asarray(harmonics)).any(axis=-1)
    if not failed.any():
        return
    shape = failed.shape
    first = np.unravel_index(np.argmax(failed), shape)
    leaves = {"omega": omega, "amplitude": amplitude, **parameters(joint)}
    values = {
        name: float(np.broadcast_to(np.asarray(leaf), shape)[first])
        for name, leaf in leaves.items()
    }
    text = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    raise ModelError(
        f"The periodic response did not converge for {failed.sum()} of {failed.size} tones, the "
        f"first at {text} ({int(np.asarray(turns)[first])} turning points a period).",
        why="Several periodic responses may exist there, or none that turns so rarely.",
        remedy="Lower `amplitude`, follow the branch with `response_curve`, or raise `max_turns`.",
    )
