"""The laws' memory of load reversals: whether it suffices for a record, and how to extend it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jbw.observables.observable import Observable, alone
from jbw.observables.samples import motion_under
from jbw.oscillator.deepening import MOST
from jbw.oscillator.hold import HeldInput
from jbw.oscillator.laws.reversals import SIZE
from jbw.oscillator.oscillator import oscillator_of
from jbw.report.messages import observed as messages

# Measured records. The type is not imported, because its module imports the functions of this one.
Records = Any


def guesses(theta: Mapping[str, Array], data: Observable) -> Float[Array, " level"]:
    """Return, per level, the number of times that the laws remembered too few load reversals."""
    return _guesses(theta, alone(data))


@eqx.filter_jit
def _guesses(theta: Mapping[str, Array], data: Records) -> Float[Array, " level"]:
    def one(source: HeldInput) -> Array:
        return motion_under(theta, source, data.fs, **data.solving).guesses

    return jax.lax.map(one, data.held)


def remembering[Data: Observable](theta: Mapping[str, Array], data: Data) -> Data:
    """Return data whose laws remember all load reversals of the motion at a parameter point.

    The memory grows by powers of two from the usual number. Data whose laws have no stack of
    reversals are returned unchanged.
    """
    if not _stacks(theta, data):
        return data
    deep = replace(data, depth=SIZE)
    while deep.depth < MOST and np.any(np.asarray(guesses(theta, deep)) > 0):
        deep = replace(deep, depth=2 * deep.depth)
    return data if deep.depth == data.depth else deep


def told(theta: Mapping[str, Array], data: Observable) -> list[str]:
    """Return messages on levels with more load reversals than a law can remember."""
    if not _stacks(theta, data):
        return []
    counts = np.asarray(guesses(theta, data))
    return [
        messages.too_deep(label, int(count))
        for label, count in zip(data.groups.labels, counts, strict=True)
        if count > 0
    ]


def _stacks(theta: Mapping[str, Array], data: Observable) -> bool:
    """Return whether a law stores a stack of load reversals in time integration."""
    is_deep = data.depth is not None
    return is_deep and any(law.depth for law in oscillator_of(theta, data.laws).laws)
