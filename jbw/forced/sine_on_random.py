r"""Random vibration with a superposed sine, by averaging a mode's energy while the sine acts.

The motion is $R\cos\omega t + S\cos\Omega t$, with the slowly varying amplitude R of the
mode and the amplitude S of the sine. Along this path the force of the joint has the equivalent
stiffness and loss K and D of the mode, which depend on R and S, and those of the sine, $K_s$ and
$D_s$. The first two determine the distribution of R, as without the sine; the mean of the others
over this distribution determines S:

$$(\langle K_s\rangle - \Omega^2 + j\,(c\,\Omega + \langle D_s\rangle))\,S = A$$

Both are repeated until S is steady. The frequencies are taken as a ratio of integers without common
harmonics, so that the path is closed.
"""

from dataclasses import dataclass, replace
from functools import partial
from math import gcd

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.forced.equivalent import EquivalentMotion, Values
from jbw.forced.random import Density, RandomResponse, random_response
from jbw.forced.table import LoopTable
from jbw.oscillator.oscillator import Oscillator

NODES = 48  # number of amplitudes of the mode in the table
SPAN = (1e-3, 100.0)  # amplitudes of the mode, relative to its rms with a stuck joint
SAMPLES = 64  # smallest number of samples in a cycle of either frequency
# closed path: smallest and largest number of cycles of the mode, and also of the sine; smallest sum
# of both numbers
FEWEST, MOST, LEAST_SUM = 3, 21, 15
LEAST_SINE = 1e-2  # smallest computed sine, relative to the rms with a stuck joint
# relative change of S at which its iteration ends, and largest number of iterations
CLOSE, MOST_ROUNDS = 1e-7, 40
APART = 10.0  # smallest distance of the sine from the mode, in half-power widths
ORDERS = (1, 3)  # harmonics of the sine that must not drive the mode
INSTEAD = "Simulate the motion by `jbw.simulate` with samples of the force."


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionBesideSine(EquivalentMotion):
    """The random motion of a mode with a superposed sine; a table gives stiffness and loss."""

    table: LoopTable

    @property
    def is_by_backbone(self) -> bool:
        """Whether stiffness K as a function of amplitude suffices to describe free vibration."""
        return True

    def values(self, y: Values, omega: Values) -> tuple[Values, Values]:
        """Return stiffness K and loss D at amplitudes y of the mode, under the superposed sine."""
        loops = self.table.loops(y)
        return loops.stiffness, loops.loss


@dataclass(frozen=True, eq=False)
class SineOnRandom:
    """The random motion and the sine's motion of every draw.

    Attributes:
        random: The random part, by amplitude levels.
        sine: Displacement at the sine's frequency, with its phase relative to the force, of shape
            (draw, 1) [m].
    """

    random: RandomResponse
    sine: NDArray[np.complex128]


def sine_on_random(
    motion: EquivalentMotion, density: Density, share: Values, level: Values, omega: float
) -> SineOnRandom:
    """Return the stationary motion of a joint under a random force and a sine.

    Args:
        motion: The draws of a joint with one mode.
        density: As for `random_response`.
        share: As for `random_response`.
        level: Force amplitude of the sine, of shape (draw, 1) [N/kg].
        omega: Frequency of the sine [rad/s].

    Raises:
        ModelError: The sine or its third harmonic is within ten half-power widths of the mode, its
            amplitude has no steady value, or as for `random_response`.
    """
    _require_slow(motion)
    single = replace(motion, num_harmonics=1)
    at_rest = density(motion.omega_n / (2.0 * np.pi)) * share**2
    viscous = np.maximum(motion.viscous, 1e-4 * motion.omega_n)
    scale = np.sqrt(np.maximum(at_rest, 1e-300) / (4.0 * viscous)) / motion.omega_n
    r = scale * np.geomspace(*SPAN, NODES)
    turns = closed_path(omega / float(np.median(motion.omega_n)))
    s = level / np.abs(motion.omega_n**2 - omega**2 + 1j * motion.viscous * omega)
    for _ in range(MOST_ROUNDS):
        # A sine that is too weak to matter is followed at a larger amplitude, which round-off does
        # not affect.
        of_mode, of_sine = _tables(single, r, np.maximum(s, LEAST_SINE * scale), turns)
        beside = MotionBesideSine(single.joint, table=of_mode)
        found = random_response(beside, density, share)
        loops = of_sine.loops(found.y)
        stiffness, loss = (
            np.sum(found.weight * part, -1, keepdims=True) for part in (loops.stiffness, loops.loss)
        )
        ratio = stiffness - omega**2 + 1j * (motion.viscous * omega + loss)
        before, s = s, level / np.abs(ratio)
        if np.all(np.abs(s / before - 1.0) < CLOSE):
            _require_apart(found, omega)
            return SineOnRandom(found, np.asarray(level / ratio, complex))
    raise ModelError(
        "The amplitude of the sine during the random motion must become steady, but still changes "
        f"by {float(np.max(np.abs(s / before - 1.0))):.2g} after {MOST_ROUNDS} iterations.",
        why="The response curve of the sine may fold at the given level.",
        remedy=INSTEAD,
    )


def closed_path(ratio: float) -> tuple[int, int]:
    """Return the cycles of mode and sine in the closed path nearest to a given frequency ratio."""
    pairs = [
        (mode, sine)
        for mode in range(FEWEST, MOST + 1)
        for sine in range(FEWEST, MOST + 1)
        if gcd(mode, sine) == 1 and mode + sine >= LEAST_SUM
    ]
    return min(pairs, key=lambda pair: (abs(np.log(pair[1] / pair[0] / ratio)), sum(pair)))


def _tables(
    motion: EquivalentMotion, r: Values, s: Values, turns: tuple[int, int]
) -> tuple[LoopTable, LoopTable]:
    """Return stiffness and loss over the amplitude R, for the mode's motion and for the sine's."""
    parts = np.moveaxis(np.asarray(_two_tones(motion.joint, r, s, turns)), -1, 0)
    log_y, none = np.log(r), np.zeros_like(r)
    viscous = none + motion.viscous
    tables = []
    for pair in (parts[:2], parts[2:]):
        three = np.stack([*pair, viscous])
        slopes = np.gradient(three, axis=2, edge_order=2) / (log_y[:, 1:2] - log_y[:, :1])
        tables.append(LoopTable(log_y, three, slopes))
    return tables[0], tables[1]


@partial(jax.jit, static_argnames="turns")
def _two_tones(
    joint: Oscillator,
    r: Float[Array, "draw node"],
    s: Float[Array, "draw one"],
    turns: tuple[int, int],
) -> Float[Array, "draw node 4"]:
    """Return stiffness and loss for the mode's motion and for the sine's, along a path of both."""
    of_mode, of_sine = turns
    # All cycles of one frequency have the same number of samples, so that sampling errors of one
    # frequency do not affect the result for the other frequency.
    count = of_mode * of_sine * -(-SAMPLES // min(turns))
    angle = 2.0 * np.pi * np.arange(2 * count) / count
    phases = of_mode * angle, of_sine * angle

    def loops(joint: Oscillator, r: Array, s: Array) -> Array:
        # The path begins at its largest excursion. The first pass over it sets the joint's memory.
        path = r * jnp.cos(phases[0]) + s * jnp.cos(phases[1])
        force = joint.force_along(path, from_tip=True)[count:]
        pairs = zip(phases, (r, s), strict=True)
        found = [
            2.0 * jnp.mean(force * jnp.exp(-1j * phase[count:])) / size for phase, size in pairs
        ]
        return jnp.stack([part for z in found for part in (z.real, z.imag)])

    of_draw = jax.vmap(loops, (None, 0, None))
    return jax.vmap(lambda joint, r, s: of_draw(joint, r, s[0]))(joint, r, s)


def _require_slow(motion: EquivalentMotion) -> None:
    laws = motion.joint.laws
    if motion.has_further_modes or motion.feels_rate or any(law.is_even for law in laws):  # pyright: ignore[reportAttributeAccessIssue]
        raise ModelError(
            "A sine on random vibration needs a model of one mode whose joint has no force that "
            "depends on the speed or on the square of the displacement.",
            why="The joint's force is followed along a slow path of both motions.",
            remedy=INSTEAD,
        )


def _require_apart(found: RandomResponse, omega: float) -> None:
    frequency = 2.0 * np.pi * found.frequency_hz
    width = 2.0 * found.damping * frequency
    for order in ORDERS:
        distance = float(np.median(np.abs(order * omega - frequency) / width))
        if distance < APART:
            times = "" if order == 1 else f"{order} times "
            raise ModelError(
                f"A sine on random vibration must be at least {APART:g} half-power widths from the "
                f"mode, but {times}{omega / (2.0 * np.pi):.4g} Hz is {distance:.2g} widths from "
                f"{float(np.median(found.frequency_hz)):.4g} Hz.",
                why="The random motion of the mode is averaged over the phase of the sine.",
                remedy=INSTEAD,
            )
