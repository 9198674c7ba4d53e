"""More room for the reversals that Masing's laws remember, where a motion asks for it."""

from dataclasses import replace

import numpy as np

from jbw.oscillator.checks import is_concrete
from jbw.oscillator.laws.masing import Masing
from jbw.oscillator.laws.reversals import with_room
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.step import State

MOST = 160  # reversals: noise of a thousand turns holds some twenty at once


def forgot(joint: Oscillator, guesses: object) -> bool:
    """Whether a law gave up reversals that the motion came back to, and more room is to be had."""
    if not (is_concrete(guesses) and np.any(np.asarray(guesses))):
        return False
    return any(isinstance(law, Masing) and law.depth < MOST for law in joint.laws)


def deeper(joint: Oscillator, start: State) -> tuple[Oscillator, State]:
    """The same oscillator and its state with twice the room."""
    depth = 2 * max(law.depth for law in joint.laws if isinstance(law, Masing))
    y, v, memory = start
    memory = tuple(
        with_room(own, depth) if isinstance(law, Masing) else own
        for law, own in zip(joint.laws, memory, strict=True)
    )
    return with_depth(joint, depth), (y, v, memory)


def with_depth[Model: Oscillator | Structure](joint: Model, depth: int | None) -> Model:
    """The model whose laws of Masing's kind remember so many reversals; None for the usual."""
    if depth is None:
        return joint
    own = (replace(law, depth=depth) if isinstance(law, Masing) else law for law in joint.laws)
    return replace(joint, laws=tuple(own))
