r"""Where a measured record enters the decay of the model: its initial state.

The motion of a free joint forgets how it began but for its amplitude and phase: whatever the
impact, it soon runs along one and the same decay, which a weaker impact enters later. So the model
is simulated once, from above the strongest record, and every record is found on it: its initial
state is the place at which it enters (its amplitude) and a rotation (its phase).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

NUM_REFINEMENTS = 3  # Gauss-Newton steps to a record's place on the decay


class Entry(NamedTuple):
    """Where a record lies on the decay: its initial state, and its own natural frequency.

    Attributes:
        place: Place of its first value, in steps.
        phase: Rotation [rad].
        shift: Of its natural frequency [rad/s].
    """

    place: Float[Array, "..."]
    phase: Float[Array, "..."]
    shift: Float[Array, "..."]


class Match(NamedTuple):
    """A record matched to the decay by least squares.

    Attributes:
        entry: Where it lies.
        misfit: Sum of squared moduli of what is left.
        residual: What is left.
        precision: Normal matrix of log amplitude, phase and shift, for noise of unit variance.
        rate: Change of the log amplitude by the place, at the entry.
    """

    entry: Entry
    misfit: Float[Array, ""]
    residual: Complex[Array, " sample"]
    precision: Float[Array, "own own"]
    rate: Float[Array, ""]


def along(
    decay: Complex[Array, " step"], place: Float[Array, " time"]
) -> tuple[Complex[Array, " time"], Complex[Array, " time"]]:
    """The decay and its slope between its steps, by cubics; by straight lines beyond its ends.

    Args:
        decay: From `decay.decay_of`.
        place: Where to look, in steps.

    Returns:
        Logarithm of the envelope, and its derivative by the place.
    """
    whole = jax.lax.stop_gradient(jnp.floor(place))
    f = place - whole
    index = whole.astype(int)[:, None] + jnp.arange(-1, 3)
    inside = jnp.clip(index, 0, len(decay) - 1)
    ends = jnp.where(index < 0, decay[1] - decay[0], decay[-1] - decay[-2])
    values = decay[inside] + (index - inside) * ends
    weights = jnp.stack(
        [
            -f * (f - 1) * (f - 2) / 6,
            (f + 1) * (f - 1) * (f - 2) / 2,
            -(f + 1) * f * (f - 2) / 2,
            (f + 1) * f * (f - 1) / 6,
        ],
        axis=-1,
    )
    slopes = jnp.stack(
        [
            -(3 * f**2 - 6 * f + 2) / 6,
            (3 * f**2 - 4 * f - 1) / 2,
            -(3 * f**2 - 2 * f - 2) / 2,
            (3 * f**2 - 1) / 6,
        ],
        axis=-1,
    )
    return jnp.sum(weights * values, axis=-1), jnp.sum(slopes * values, axis=-1)


def follow(
    decay: Complex[Array, " step"], entry: Entry, steps: Float[Array, " time"], step_s: float
) -> tuple[Complex[Array, " time"], Complex[Array, " time"]]:
    """Envelope of a record that enters the decay, and the slope of its logarithm by the place.

    Args:
        decay: From `decay.decay_of`.
        entry: Where the record enters.
        steps: Steps since its first value.
        step_s: Time of a step [s].
    """
    log, slope = along(decay, entry.place + steps)
    return jnp.exp(log + 1j * (entry.phase + entry.shift * step_s * steps)), slope


def match(
    decay: Complex[Array, " step"], envelope: Complex[Array, " sample"], step_s: float
) -> Match:
    """Least-squares initial state and frequency of a record on the decay.

    Args:
        decay: From `decay.decay_of`.
        envelope: The record's.
        step_s: Time of a step [s].
    """
    steps = jnp.arange(len(envelope), dtype=float)
    entry = jax.lax.stop_gradient(_first_entry(decay, envelope, steps, step_s))
    for _ in range(NUM_REFINEMENTS):
        # At the optimum an earlier step has no influence: only the last one carries derivatives.
        entry = jax.lax.stop_gradient(entry)
        _, precision, gradient, rate = _normal(decay, envelope, entry, steps, step_s)
        gain = jnp.linalg.solve(precision, gradient)
        entry = Entry(entry.place + gain[0] / rate, entry.phase + gain[1], entry.shift + gain[2])
    residual, precision, _, rate = _normal(decay, envelope, entry, steps, step_s)
    misfit = jnp.sum(jnp.square(residual.real) + jnp.square(residual.imag))
    return Match(entry, misfit, residual, precision, rate)


def _first_entry(
    decay: Complex[Array, " step"],
    envelope: Complex[Array, " sample"],
    steps: Float[Array, " sample"],
    step_s: float,
) -> Entry:
    """Entry by the amplitude a quarter into the record, then by the turn that is left."""
    quarter = len(envelope) // 4
    size = jnp.mean(jnp.log(jnp.abs(envelope[max(quarter - 3, 0) : quarter + 4])))
    grid = jnp.arange(len(decay), dtype=float)
    place = jnp.interp(-size, -decay.real, grid) - quarter
    log, _ = along(decay, place + steps)
    ratio = envelope * jnp.exp(jnp.conj(log))  # its phase is what the model lacks
    turn = jnp.angle(jnp.sum(ratio[1:] * jnp.conj(ratio[:-1])))
    phase = jnp.angle(jnp.sum(ratio * jnp.exp(-1j * turn * steps)))
    return Entry(place, phase, turn / step_s)


def _normal(
    decay: Complex[Array, " step"],
    envelope: Complex[Array, " sample"],
    entry: Entry,
    steps: Float[Array, " sample"],
    step_s: float,
) -> tuple[Complex[Array, " sample"], Float[Array, "own own"], Float[Array, " own"], Array]:
    """Residual, normal matrix and gradient by log amplitude, phase and shift, and the rate."""
    model, slope = follow(decay, entry, steps, step_s)
    residual = envelope - model
    rate = slope[0].real
    ones = jnp.ones_like(model)
    columns = model * jnp.stack([slope / rate, 1j * ones, 1j * step_s * steps * ones])
    precision = (jnp.conj(columns) @ columns.T).real
    gradient = (jnp.conj(columns) @ residual).real
    return residual, precision, gradient, rate
