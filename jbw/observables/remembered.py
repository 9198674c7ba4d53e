"""Loops within loops of records: whether the laws remember enough of them, and more room if not."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jbw.observables.observable import alone
from jbw.observables.samples import motion_under
from jbw.oscillator.deepening import MOST
from jbw.oscillator.hold import HeldInput
from jbw.oscillator.laws.reversals import SIZE
from jbw.report.messages import observed as messages

Records = Any  # with a source, which calls these functions


def guesses(theta: Mapping[str, Array], data: Records) -> Float[Array, " level"]:
    """How often the force of each level may have been a guess."""
    return _guesses(theta, alone(data))


@eqx.filter_jit
def _guesses(theta: Mapping[str, Array], data: Records) -> Float[Array, " level"]:
    """The same, compiled."""

    def one(source: HeldInput) -> Array:
        return motion_under(theta, source, data.fs, **data.solving).guesses

    return jax.lax.map(one, data.held)


def room(theta: Mapping[str, Array], data: Records) -> int:
    """Reversals that the motion at a point asks for, as powers of two of the usual number."""
    depth = SIZE
    while depth < MOST and np.any(np.asarray(guesses(theta, data.with_depth(depth))) > 0):
        depth *= 2
    return depth


def told(theta: Mapping[str, Array], data: Records) -> list[str]:
    """Where the motion comes back to reversals that a law has given up, in words."""
    counts = np.asarray(guesses(theta, data))
    return [
        messages.too_deep(label, int(count))
        for label, count in zip(data.labels, counts, strict=True)
        if count > 0
    ]
