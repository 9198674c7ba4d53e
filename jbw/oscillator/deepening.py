"""More room for the reversals that Masing's laws remember, where a motion asks for it."""

from dataclasses import replace

import numpy as np

from jbw.oscillator.checks import is_concrete
from jbw.oscillator.laws.reversals import with_room
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.step import State

MOST = 160  # reversals: noise of a thousand turns holds some twenty at once


def forgot(joint: Oscillator, guesses: object) -> bool:
    """Whether a law gave up reversals that the motion came back to, and more room is to be had."""
    if not (is_concrete(guesses) and np.any(np.asarray(guesses))):
        return False
    return any(law.stacks and law.depth < MOST for law in joint.laws)


def deeper(joint: Oscillator, start: State) -> tuple[Oscillator, State]:
    """The same oscillator and its state with twice the room."""
    laws = tuple(law.deepened() if law.stacks else law for law in joint.laws)
    y, v, memory = start
    memory = tuple(
        with_room(own, law.depth) if law.stacks else own
        for law, own in zip(laws, memory, strict=True)
    )
    return replace(joint, laws=laws), (y, v, memory)
