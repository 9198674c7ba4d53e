"""Default candidate tests: sweeps, tones and steps at levels that make the joint slip."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import jax.numpy as jnp
import numpy as np
from pydantic import model_validator

from jbw.campaign.document import FileTable, key
from jbw.campaign.values import NonNegative, Numbers, Positive, Span
from jbw.errors import ConfigError
from jbw.oscillator.laws import quantities_of
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import Backbone as Resonances
from jbw.oscillator.steady.backbone import backbone
from jbw.planning.beliefs import Beliefs, modes_of
from jbw.planning.plan import (
    Candidate,
    PlannedBackbone,
    PlannedSteppedSine,
    PlannedSweep,
    PlannedTones,
)
from jbw.planning.prospects import peak_displacements
from jbw.report.messages import planning

# displacements that the levels are to reach, relative to the largest displacement
SHARES = (0.2, 0.45, 0.9)
SPAN = (0.5, 1.5)  # frequency range of a sweep, relative to the natural frequency
PERIODS = (200, 800)  # number of periods in a sweep, at its average frequency
# tones that measure the third-order kernel, as in Teloli et al., relative to omega_n / 3
THIRDS = (0.80, 0.88, 0.96, 1.04, 1.08)
NUM_STEPS = 15
# number of points of a backbone, and ratio of its smallest to its largest amplitude
NUM_POINTS, LEAST_SHARE = 14, 0.03
BANDWIDTHS = 4  # width that a stepped sine covers on each side of the resonances, in bandwidths
READ_PERIODS = 100  # used length of each tone, in natural periods
DECAY = np.log(1000.0)  # required decay of a transient before the next measurement, in nepers
# number of corrections of a sweep's level; each reduces the error of its peak several times
NUM_TRIES = 3
PER_PERIOD = 40  # smallest number of samples per period
DIGITS = 3


class SweepTable(FileTable):
    """The [sweep] table of a plan file."""

    levels: Numbers | None = key(None, "peaks of the input [V, N or N/kg]")
    span: Span | None = key(None, "first and last frequency [Hz]")
    rates: Numbers | None = key(None, "sweep rates [Hz/s]")
    rest: NonNegative | None = key(None, "free decay recorded after the burst [s]")


class DwellingTable(FileTable):
    """The keys that the tables of all tests with several steady points share."""

    dwell: Positive | None = key(None, "duration of each step [s]")
    settle: NonNegative | None = key(None, "discarded time at the start of each step [s]")

    @model_validator(mode="after")
    def _settles(self) -> Self:
        settle = self.settle or 0.0
        if self.dwell is not None and settle >= self.dwell:
            raise ValueError(
                f"settle: must be shorter than dwell ({self.dwell:g} s), but is {settle:g}."
            )
        return self


class TonesTable(DwellingTable):
    """The [tones] table of a plan file."""

    levels: Numbers | None = key(None, "peaks of the input [V, N or N/kg]")
    frequencies: Numbers | None = key(None, "frequencies of the tones, each measured alone [Hz]")


class SteppedTable(TonesTable):
    """The [stepped] table of a plan file."""

    frequencies: Numbers | None = key(None, "step frequencies, ordered [Hz]")


class BackboneTable(DwellingTable):
    """The [backbone] table of a plan file."""

    amplitudes: Numbers | None = key(None, "displacement peaks, ordered [m]")


READ = {
    PlannedSweep: planning.LAST_FREQUENCY,
    PlannedTones: planning.THIRD_HARMONIC,
    PlannedSteppedSine: planning.THIRD_HARMONIC,
    PlannedBackbone: planning.NATURAL_FREQUENCY,
}
# Values that a table does not state follow from the drawn joints.
Grid = SweepTable | TonesTable | BackboneTable
GRIDS: dict[str, type[Grid]] = {
    "sweep": SweepTable,
    "tones": TonesTable,
    "stepped": SteppedTable,
    "backbone": BackboneTable,
}
USUAL = (
    "sweep",
    "tones",
    "stepped",
)  # kinds of test if none is stated; backbones are left out, because they need a controller


@dataclass(frozen=True)
class Reach:
    """The limits of the tests: sampling frequency, displacement and input."""

    fs: float  # sampling frequency [Hz]
    max_displacement: float  # largest displacement [m], by which levels are chosen
    max_input: float = np.inf  # largest peak of the input [V, N or N/kg]

    @property
    def goals(self) -> list[float]:
        """The displacements [m] at which the levels of a test aim."""
        return [share * self.max_displacement for share in SHARES]


def sampling_for(natural_hz: float) -> float:
    """Return a sampling frequency [Hz]: a power of two with at least forty samples per period."""
    return float(2 ** np.ceil(np.log2(PER_PERIOD * natural_hz)))


def displacement_for(beliefs: Beliefs) -> float:
    """Return the displacement [m] at which the joint slides, from its laws (such as 1/delta)."""
    for quantity in quantities_of(beliefs.laws):
        if quantity.unit in ("m", "1/m"):
            value = float(np.abs(np.median(beliefs.joints[quantity.name])))
            return value if quantity.unit == "m" else 1 / value
    raise ConfigError(
        f"Key `max_displacement` must be given: {', '.join(beliefs.laws)} does not determine where "
        "the joint slides."
    )


def propose(grids: Mapping[str, Grid], beliefs: Beliefs, reach: Reach) -> list[Candidate]:
    """Return candidate tests of all kinds, by default at fractions of the largest displacement."""
    makers = {"sweep": _sweeps, "tones": _tones, "stepped": _steps, "backbone": _backbones}
    _require_one_mode(grids, beliefs)
    candidates = [
        candidate
        for kind, grid in grids.items()
        for candidate in makers[kind](grid, beliefs, reach)
    ]
    for candidate in candidates:
        highest, what = candidate.highest_hz, READ[type(candidate)]
        if 2 * highest >= candidate.fs:
            raise ConfigError(
                f"Key `fs` must be more than twice {what}, {highest:g} Hz, "
                f"but is {candidate.fs:g} Hz.",
                remedy=f"Sample at {sampling_for(highest):g} Hz, or lower the frequencies.",
            )
    return candidates


def default_grids(beliefs: Beliefs) -> dict[str, Grid]:
    """Return the default kinds of test that can be planned for the structure's number of modes."""
    kinds = ("sweep",) if len(modes_of(beliefs.joints)) > 1 else USUAL
    return {kind: GRIDS[kind]() for kind in kinds}


def _require_one_mode(grids: Mapping[str, Grid], beliefs: Beliefs) -> None:
    """Raise a ConfigError if steady tones are planned but several modes move the joint."""
    others = [kind for kind in grids if kind != "sweep"]
    if others and len(modes_of(beliefs.joints)) > 1:
        raise ConfigError(
            f"[{others[0]}]: tests with steady tones can be planned only for a structure with one "
            "mode, but the run has several modes.",
            remedy="Plan sweeps about every mode.",
        )


def _sweeps(grid: SweepTable, beliefs: Beliefs, reach: Reach) -> list[PlannedSweep]:
    """Return sweeps around every mode, at levels that give equal motions of the joint."""
    modes = modes_of(beliefs.joints)
    centres = [float(np.median(mode.omega) / (2 * np.pi)) for mode in modes]
    spans = [grid.span] if grid.span else [_span_about(centre, centres) for centre in centres]
    rest = _decay(beliefs) if grid.rest is None else grid.rest
    sweeps: list[PlannedSweep] = []
    for mode, natural, (low, high) in zip(modes, centres, spans, strict=False):
        rates = grid.rates or tuple(_rounded(natural * (high - low) / n) for n in PERIODS)
        shapes = [PlannedSweep(1.0, low, high, rate, rest, reach.fs) for rate in rates]
        goals = [y / float(np.median(mode.h)) for y in reach.goals]
        starts = list(zip(_steady_levels(beliefs, reach), goals, strict=True))
        sweeps += [
            replace(shape, level=level)
            for shape in shapes
            for level in grid.levels
            or _within([_aimed(shape, start, y, beliefs) for start, y in starts], reach)
        ]
    return sweeps


def _span_about(natural: float, every: Sequence[float]) -> tuple[float, float]:
    """Return the frequency range of a sweep around a mode [Hz], halfway to other modes at most."""
    low, high = (share * natural for share in SPAN)
    middles = [0.5 * (natural + other) for other in every if other != natural]
    low = max([low, *(x for x in middles if x < natural)])
    return _rounded(low), _rounded(min([high, *(x for x in middles if x > natural)]))


def _aimed(shape: PlannedSweep, level: float, y: float, beliefs: Beliefs) -> float:
    """Return the level at which a sweep moves the most responsive of the drawn joints by y."""
    for _ in range(NUM_TRIES):
        peaks = peak_displacements(replace(shape, level=level), beliefs)
        bounded = peaks[np.isfinite(peaks)]
        if not bounded.size:
            return level
        level *= y / float(bounded.max())
    return level


def _tones(grid: TonesTable, beliefs: Beliefs, reach: Reach) -> list[PlannedTones]:
    third = _natural(beliefs) / 3
    frequencies = grid.frequencies or tuple(_rounded(share * third) for share in THIRDS)
    # Far below its resonance, the structure responds like a spring to a force.
    omega_n, gain = beliefs.omega_n, beliefs.gain
    per_metre = float(np.min(np.abs(omega_n**2 - (2 * np.pi * max(frequencies)) ** 2) / gain))
    levels = grid.levels or _within([per_metre * y for y in reach.goals], reach)
    settle, dwell = _times(grid, beliefs)
    return [PlannedTones(level, frequencies, dwell, settle, reach.fs) for level in levels]


def _steps(grid: TonesTable, beliefs: Beliefs, reach: Reach) -> list[PlannedSteppedSine]:
    frequencies = grid.frequencies or _about_resonance(beliefs, reach)
    levels = grid.levels or _within(_steady_levels(beliefs, reach), reach)
    settle, dwell = _times(grid, beliefs)
    return [PlannedSteppedSine(level, frequencies, dwell, settle, reach.fs) for level in levels]


def _backbones(grid: BackboneTable, beliefs: Beliefs, reach: Reach) -> list[PlannedBackbone]:
    """Return backbone tests up to the largest displacement.

    By default, transients decay to a thousandth, and then 100 periods are evaluated.
    """
    lowest = LEAST_SHARE * reach.max_displacement
    usual = tuple(_rounded(y) for y in np.geomspace(lowest, reach.max_displacement, NUM_POINTS))
    amplitudes = grid.amplitudes or usual
    natural, gain = _natural(beliefs), beliefs.gain
    settle = _decay(beliefs) if grid.settle is None else grid.settle
    dwell = settle + _rounded(READ_PERIODS / natural) if grid.dwell is None else grid.dwell
    level = float(np.median(_resonance(beliefs, max(amplitudes)).amplitude / gain))
    if level > reach.max_input:
        within_reach = [
            y for y in amplitudes
            if np.median(_resonance(beliefs, y).amplitude / gain) <= reach.max_input
        ]  # fmt: skip
        if not within_reach:
            return []
        amplitudes = tuple(within_reach)
        level = float(np.median(_resonance(beliefs, max(within_reach)).amplitude / gain))
    return [PlannedBackbone(_rounded(level), amplitudes, dwell, settle, reach.fs, natural)]


def _about_resonance(beliefs: Beliefs, reach: Reach) -> tuple[float, ...]:
    """Return frequencies [Hz] of a stepped sine that cover the resonances of all drawn joints.

    The lowest resonance is that at the largest displacement, the highest that of small motion.
    """
    sliding = _resonance(beliefs, reach.max_displacement).omega
    sticking = beliefs.omega_n
    width = BANDWIDTHS * float(np.max(beliefs.joints["zeta"] * sticking))
    ends = min(sliding.min(), sticking.min()) - width, max(sliding.max(), sticking.max()) + width
    return tuple(_rounded(w / (2 * np.pi), 5) for w in np.linspace(*ends, NUM_STEPS))


def _steady_levels(beliefs: Beliefs, reach: Reach) -> list[float]:
    """Return input levels that move the most responsive drawn joint to the wanted displacements."""
    return [float(np.min(_resonance(beliefs, y).amplitude / beliefs.gain)) for y in reach.goals]


def _resonance(beliefs: Beliefs, y: float) -> Resonances:
    theta = {name: jnp.asarray(values) for name, values in beliefs.joints.items()}
    return backbone(oscillator_of(theta, beliefs.laws), jnp.asarray(y))


def _within(levels: Sequence[float], reach: Reach) -> tuple[float, ...]:
    """Return levels, rounded and limited to the largest input."""
    return tuple(sorted({min(_rounded(level), reach.max_input) for level in levels}))


def _times(grid: TonesTable, beliefs: Beliefs) -> tuple[float, float]:
    """Return the settling time and the dwell time of each tone [s]."""
    settle = _decay(beliefs) if grid.settle is None else grid.settle
    read = READ_PERIODS / _natural(beliefs)
    dwell = settle + max(_rounded(read), read) if grid.dwell is None else grid.dwell
    if not settle < dwell:
        raise ConfigError(
            f"[plan] dwell: must be longer than settle ({settle:g} s), but is {dwell:g} s.",
            why="A tone is measured only after the settling time, in which free motion decays.",
            remedy="Lengthen dwell, or state a shorter settle.",
        )
    return settle, dwell


def _decay(beliefs: Beliefs) -> float:
    """Return the time [s] in which the least damped of the drawn joints decays to a thousandth."""
    return _rounded(float(np.max(DECAY / (beliefs.joints["zeta"] * beliefs.omega_n))))


def _natural(beliefs: Beliefs) -> float:
    return float(np.median(beliefs.omega_n) / (2 * np.pi))


def _rounded(value: float, digits: int = DIGITS) -> float:
    return float(f"{value:.{digits}g}")
