r"""Faults of a force loop as hypotheses on the residual of a fit by sliders and springs.

A load cell whose zero is off and drifts adds $c_0 + c_1 t$. A joint that wears along its path s
has the force $F = F_0 + (w_1 s + w_2 s^2) F$, with $F_0$ the force of the unworn joint. A delayed
force fits if it is read later. A force behind a charge amplifier of time constant T leaves
$-\frac1T \int F\,\mathrm{d}t$. Behind a displacement gauge that slips once, the motion differs. A
cause is named if sliders leave more than 1 % of the rms of the force beyond noise, and the cause
explains 85 % of the squares of that residual. Effects that a campaign states, a drifting zero or a
wearing law, are fitted together with the sliders from the beginning.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from jbw.measurement.channels import Reals, noise_of
from jbw.measurement.checks.faults import Fault, doubt
from jbw.measurement.curves import ForcedLoop, forced_loop
from jbw.measurement.loops import begins_unmoved, cycles_of, of_one_amplitude
from jbw.measurement.readings.loop import MOST_SAMPLES, Columns, LoopBasis, basis_of, fit_loop
from jbw.measurement.records import LOAD_CELLS, Record
from jbw.measurement.spans import kept_part, span_line, start_of
from jbw.report.messages import loop_faults as messages

LEFT = 0.01  # largest residual beyond noise of a sound loop, over the rms of the force
OFF = 0.02  # largest force before the motion, over the rms of the force
NOISE = 1.2  # factor on the squares of noise that sliders leave by chance
EXPLAINS = 0.85  # share of the residual beyond noise that a cause must explain
OF_CYCLE = 0.125  # largest lag that is tried, of a cycle
SLIPS = 3  # number of places at which a gauge may have slipped
NEIGHBOURS = 2  # steps of a motion to either side, whose median is the usual step
FEWEST = 64  # fewest samples of a loop
STILL = 1e-3  # share of the whole stroke within which a joint counts as at rest
WEARING = ("bwbn", "bwbn_pinching")  # laws under which every cycle changes the joint


class Cause(NamedTuple):
    """The sum of squares of a force that a cause does not explain, and the fault to report."""

    square: float
    fault: Fault


def loop_causes(
    record: Record, delay: float, load_cell: str = "exact", laws: Sequence[str] = ()
) -> Iterator[Fault]:
    """Yield a fault of the load cell's zero, and the one cause of the remaining residual of a loop.

    Args:
        record: A record of kind `loop`.
        delay: Stated lag of its force [s].
        load_cell: Stated behaviour of the zero of the load cell.
        laws: Stated laws of the joint.
    """
    whole = forced_loop(record, delay)
    every = -(-len(whole.force) // MOST_SAMPLES)
    loop = ForcedLoop(
        whole.fs / every, whole.displacement[::every], whole.force[::every], whole.begins
    )
    force = loop.force
    if len(force) < FEWEST or not np.ptp(loop.displacement) or not np.ptp(force):
        return
    bare, zero = _bases(loop, load_cell, laws)
    basis = LoopBasis(bare.losses, np.column_stack([bare.springs, zero]))
    found = [*_named(force, force, fit_loop(bare, force).square, _off_zero(loop, bare, zero))]
    if not found and load_cell == "exact":
        rest = _at_rest(whole)
        loaded = _loaded(rest, whole.force)
        found = [*_named(whole.force, rest, float(rest @ rest), loaded, OFF)]
    yield from found

    def others() -> Iterator[Cause | None]:
        yield _late(loop, basis, delay)
        yield _high_passed(loop, basis)
        yield _worn(loop, basis)
        yield from _slipped(loop, record, every)

    yield from _named(force, force, fit_loop(basis, force).square, others())


def _named(
    force: Reals, part: Reals, square: float, tried: Iterable[Cause | None], least: float = LEFT
) -> Iterator[Fault]:
    """Yield the best of the tried causes of a residual, if it explains enough of it."""
    noise = noise_of(force) ** 2 * len(part)
    if square - NOISE * noise < least**2 * len(part) * np.var(force) or len(part) < FEWEST:
        return
    most = noise + (1 - EXPLAINS) * (square - noise)
    causes = [cause for cause in tried if cause is not None and cause.square < most]
    if causes:
        yield min(causes, key=lambda cause: cause.square).fault


def _bases(loop: ForcedLoop, load_cell: str, laws: Sequence[str]) -> tuple[LoopBasis, Columns]:
    """Return the columns of the stated effects, and of unstated parts of the load cell's zero."""
    y, basis = loop.displacement, basis_of(loop.displacement)
    known = LOAD_CELLS.index(load_cell)
    if not begins_unmoved(y):
        known = max(known, 1)  # stuck sliders there add a constant of their own
    springs, zero = np.split(basis.springs, [basis.springs.shape[1] - 2 + known], axis=1)
    if set(laws) & set(WEARING):
        springs = np.column_stack([springs, *(_path_of(loop) * loop.force)])
    return LoopBasis(basis.losses, springs), zero


def _at_rest(loop: ForcedLoop) -> Reals:
    """Return the force before the motion starts, which should be zero for every law."""
    y = loop.displacement
    if not begins_unmoved(y):
        return loop.force[:0]
    return loop.force[: int(np.argmax(np.abs(y - y[0]) > STILL * np.ptp(y)))]


def _loaded(rest: Reals, force: Reals) -> Iterator[Cause]:
    """Yield the cause of a load cell with zero offset, from the force before the motion."""
    text = messages.off_centre(float(np.mean(rest) / (0.5 * np.ptp(force))), 0.0)
    yield Cause(len(rest) * float(np.var(rest)), doubt("restoring_force", *text))


def _off_zero(loop: ForcedLoop, basis: LoopBasis, zero: Columns) -> Iterator[Cause]:
    """Yield the cause of a load cell with zero offset and drift, fitted with the loop's law."""
    if not zero.shape[1]:
        return
    found = fit_loop(basis, loop.force, [*zero.T])
    offset, drift = np.pad(found.beside, (2 - len(found.beside), 0)) / (0.5 * np.ptp(loop.force))
    text = messages.off_centre(float(offset), float(drift))
    yield Cause(found.square, doubt("restoring_force", *text))


def _path_of(loop: ForcedLoop) -> Columns:
    """Return the relative path of the motion and its square, one row each."""
    path = np.append(0.0, np.cumsum(np.abs(np.diff(loop.displacement))))
    return np.stack([path / path[-1], (path / path[-1]) ** 2])


def _worn(loop: ForcedLoop, basis: LoopBasis) -> Cause | None:
    """Return the cause of a force that changes along its path, from cycles of one amplitude."""
    if not (groups := of_one_amplitude(cycles_of(loop))):
        return None
    path = _path_of(loop)
    found = fit_loop(basis, loop.force, [*(path * loop.force)])
    strength = 1 / (1 - found.beside @ path)
    changes = [
        float(np.median(strength[last.samples]) / np.median(strength[second.samples]) - 1)
        for _, second, *_, last in groups
    ]
    change, cycles = max(zip(changes, groups, strict=True), key=lambda pair: abs(pair[0]))
    ends = cycles[-2].samples.start / loop.fs, cycles[-1].samples.stop / loop.fs
    keep = span_line(*ends, loop.begins)
    text = messages.degrading(
        0.5 * cycles[-1].stroke, len(cycles), abs(change), keep, falls=change < 0
    )
    return Cause(found.square, doubt("restoring_force", *text))


def _late(loop: ForcedLoop, whole: LoopBasis, stated: float) -> Cause | None:
    """Return the cause of a force that lags the displacement, at the best-fitting lag."""
    if not (cycles := cycles_of(loop)):
        return None
    longest = OF_CYCLE * float(np.median([one.num_samples for one in cycles]))
    # Samples whose force at the longest lag is in the record.
    known = slice(0, len(loop.force) - int(np.ceil(longest)))
    # With a lag, a dashpot is redundant: a lagging spring acts as a negative dashpot.
    basis = LoopBasis(whole.losses[known, :-1], whole.springs[known])
    samples = np.arange(len(loop.force))

    def square(lag: float) -> float:
        return fit_loop(basis, np.interp(samples[known] + lag, samples, loop.force)).square

    found: Any = minimize_scalar(square, bounds=(0.0, longest), method="bounded")
    lag = float(found.x) / loop.fs
    share = len(samples) / len(samples[known])
    return Cause(share * found.fun, doubt("restoring_force", *messages.late(lag, stated + lag)))


def _high_passed(loop: ForcedLoop, basis: LoopBasis) -> Cause | None:
    """Return the cause of a force behind the high-pass filter of a charge amplifier."""
    mean = 0.5 * (loop.force[1:] + loop.force[:-1]) / loop.fs
    integral = np.concatenate([[0.0], np.cumsum(mean)])
    found = fit_loop(basis, loop.force, [-integral])
    rate = float(found.beside[0])
    if not rate > 0:
        return None
    return Cause(found.square, doubt("restoring_force", *messages.high_passed(1 / rate)))


def _slipped(loop: ForcedLoop, record: Record, every: int) -> Iterator[Cause]:
    """Yield causes of a slipping gauge, at the motion steps that differ most from neighbours."""
    steps = np.diff(loop.displacement)
    around = np.lib.stride_tricks.sliding_window_view(steps, 2 * NEIGHBOURS + 1)
    unlike = steps[NEIGHBOURS:-NEIGHBOURS] - np.median(around, axis=1)
    before = loop.begins - start_of(record)  # a stated delay may skip the first samples
    skipped = round(before * record.fs) if before else 0
    for place in np.argsort(np.abs(unlike))[-SLIPS:].tolist():
        first = place + NEIGHBOURS + 1  # first sample after the slip
        motion = loop.displacement.copy()
        motion[first:] -= unlike[place]
        found = fit_loop(basis_of(motion), loop.force)
        spoilt = np.zeros(len(record.channels["displacement"]), bool)
        last = skipped + first * every
        spoilt[last - every + 1 : last + 1] = True
        at = before + first / loop.fs
        text = messages.slipped(float(unlike[place]), at, kept_part(record, spoilt))
        yield Cause(found.square, doubt("displacement", *text))
