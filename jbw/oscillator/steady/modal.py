"""The periodic response of a structure of several modes with joints."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from jbw.errors import ModelError
from jbw.oscillator.checks import is_concrete, require_sense
from jbw.oscillator.modes.balance import StructureHarmonics, modal_units, modes_of, of_one_joint
from jbw.oscillator.modes.structure import Structure, admitted, by_joint
from jbw.oscillator.steady.balance import linear_response, tone_from

_MANY_TURNS = 10


def modal_tones(
    structure: Structure,
    omega: ArrayLike,
    amplitude: ArrayLike,
    num_harmonics: int,
    max_turns: int,
    *,
    swept: bool,
) -> StructureHarmonics:
    """Return the harmonics of every tone; in a sweep, each solution starts from the previous tone.

    Raises:
        ModelError, ConfigError: As for `steady_state`.
    """
    structure = admitted(structure)
    require_sense(structure, omega, amplitude, num_harmonics, max_turns)
    omega, amplitude = jnp.asarray(omega, float), jnp.asarray(amplitude, float)
    rows = by_joint(structure)
    solve = partial(_solved, rows, omega, amplitude, num_harmonics, swept=swept)
    harmonics, turns = solve(max_turns)
    is_one_joint = jnp.ndim(structure.h) == 1
    if not is_concrete(structure, omega, amplitude, harmonics):
        return of_one_joint(harmonics) if is_one_joint else harmonics
    if max_turns == 2 and np.any(np.asarray(turns) > 2):
        harmonics, turns = solve(_MANY_TURNS)
    failed = np.isnan(np.asarray(harmonics.x)).any(axis=(-2, -1))
    if failed.any():
        first = np.unravel_index(np.argmax(failed), failed.shape)
        tones = np.broadcast_to(np.asarray(omega), failed.shape)
        raise ModelError(
            f"The periodic response did not converge for {failed.sum()} of {failed.size} tones, "
            f"the first at omega = {tones[first]:g} ({int(np.asarray(turns)[first])} turning "
            "points of a joint per period).",
            why="At these tones several periodic responses may exist, or none with at most "
            "`max_turns` turning points per period.",
            remedy="Lower `amplitude`, follow the branch with `response_curve`, or raise "
            "`max_turns`.",
        )
    return of_one_joint(harmonics) if is_one_joint else harmonics


@partial(jax.jit, static_argnums=(3, 4), static_argnames=("swept",))
def _solved(
    structure: Structure,
    omega: Array,
    amplitude: Array,
    num_harmonics: int,
    max_turns: int,
    *,
    swept: bool,
) -> tuple[StructureHarmonics, Array]:
    """Return harmonics and joints' turning points for each tone; NaN where invalid."""
    if swept:
        level = partial(_sweep, structure, omega, num_harmonics, max_turns)
        flat = jax.vmap(level)(amplitude.ravel())
        shape = amplitude.shape
    else:
        omega, amplitude = jnp.broadcast_arrays(omega, amplitude)
        tone = partial(_tone, structure, num_harmonics, max_turns)
        flat = jax.vmap(tone)(omega.ravel(), amplitude.ravel())
        shape = omega.shape
    return jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), flat)


def _tone(
    structure, num_harmonics, max_turns, omega, amplitude
) -> tuple[StructureHarmonics, Array]:
    unit, ratio, length = modal_units(structure, omega, amplitude)
    start = linear_response(unit, ratio, num_harmonics)
    x, turns = tone_from(start, unit, ratio, length, max_turns)[1]
    return modes_of(structure, omega, amplitude, x, max_turns), turns


def _sweep(structure, omega, num_harmonics, max_turns, amplitude):
    unit, ratio, length = modal_units(structure, omega, amplitude)

    def tone(before, ratio):
        return tone_from(before, unit, ratio, length, max_turns)

    start = linear_response(unit, ratio[0], num_harmonics)
    _, (x, turns) = jax.lax.scan(tone, start, ratio)
    harmonics_at = jax.vmap(lambda omega, x: modes_of(structure, omega, amplitude, x, max_turns))
    return harmonics_at(omega, x), turns
