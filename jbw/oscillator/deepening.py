"""Repeated solutions with more remembered load reversals, for motions that need them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np

from jbw.oscillator.checks import is_concrete
from jbw.oscillator.law import laws_in, map_laws
from jbw.oscillator.laws.reversals import with_room
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator

# largest number of remembered reversals; noise with a thousand turning points needs about twenty
MOST = 160
# number of remembered reversals to begin with if several modes move: loops are nested more deeply
OF_SEVERAL_MODES = 24


class Guessing(Protocol):
    """A response with the number of times that a law remembered too few load reversals."""

    @property
    def guesses(self) -> Any:
        """The number of times per record that a law remembered too few load reversals."""
        ...


def deep_enough[Model: Oscillator | Structure, Solved: Guessing](
    solve: Callable[[Model, Any], Solved], joint: Model, initial: Any
) -> Solved:
    """Solve, and double the number of remembered load reversals until it suffices or stops helping.

    `solve` takes the model and its initial state, whose last part is the laws' memories.
    """
    if isinstance(joint, Structure) and jnp.size(joint.omega_n) > 1:
        joint, initial = with_places(joint, initial, OF_SEVERAL_MODES)
    response = solve(joint, initial)
    while forgot(joint, response.guesses):
        depth = 2 * max(law.depth for law in laws_in(joint.laws))
        joint, initial = with_places(joint, initial, depth)
        deeper = solve(joint, initial)
        if not np.sum(deeper.guesses) < np.sum(response.guesses):
            break
        response = deeper
    return response


def forgot(joint: Oscillator | Structure, guesses: object) -> bool:
    """Return whether a law dropped load reversals that the motion needed later."""
    if not (is_concrete(guesses) and np.any(np.asarray(guesses))):
        return False
    return any(0 < law.depth < MOST for law in laws_in(joint.laws))


def with_places[Model: Oscillator | Structure](
    joint: Model, start: Any, depth: int
) -> tuple[Model, Any]:
    """Return a model and its state, with storage for `depth` load reversals in every law."""
    *motion, memory = start

    def short(law: Any) -> bool:
        return 0 < law.depth < depth

    def deeper(law: Any) -> Any:
        return replace(law, depth=depth) if short(law) else law

    def roomier(law: Any, law_memory: Any) -> Any:
        return with_room(law_memory, depth) if short(law) else law_memory

    memory = map_laws(roomier, joint.laws, memory)
    return replace(joint, laws=map_laws(deeper, joint.laws)), (*motion, memory)


def with_depth[Model: Oscillator | Structure](joint: Model, depth: int | None) -> Model:
    """Return the model whose Masing laws remember `depth` load reversals; None changes nothing."""
    if depth is None:
        return joint

    def remembering(law: Any) -> Any:
        return replace(law, depth=depth) if law.depth else law

    return replace(joint, laws=map_laws(remembering, joint.laws))
