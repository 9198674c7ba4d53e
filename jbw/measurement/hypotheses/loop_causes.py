r"""Faults of a force loop as hypotheses on what sliders and springs leave of it.

A force that is late fits where it is read later; one behind a charge amplifier of time constant T
leaves $-\frac1T \int F\,\mathrm{d}t$; behind a gauge that slips once the motion is another. A
cause is named where sliders leave more than 1 % of the rms of the force beyond noise, and it takes
85 % of the squares of that. Of 390 sound loops of `benchmarks/outside` none is accused so.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from jbw.measurement.channels import noise_of
from jbw.measurement.checks.faults import Fault, doubt
from jbw.measurement.curves import ForcedLoop, forced_loop
from jbw.measurement.loops import cycles_of
from jbw.measurement.readings.loop import MOST_SAMPLES, LoopBasis, basis_of, fit_loop
from jbw.measurement.records import Record
from jbw.measurement.spans import kept_part
from jbw.report.messages import loop_faults as messages

LEFT = 0.01  # of the rms of the force, beyond noise: what no sound loop leaves
NOISE = 1.2  # times its square: what sliders leave of it by chance
EXPLAINS = 0.85  # of what is left beyond noise, by a cause
OF_CYCLE = 0.125  # longest lag that is tried
SLIPS = 3  # places at which a gauge may have slipped
NEIGHBOURS = 2  # steps of a motion to either side, whose median is the usual one
FEWEST = 64  # samples


class Cause(NamedTuple):
    """What a cause leaves of a force, and what is said of it."""

    square: float
    fault: Fault


def loop_causes(record: Record, delay: float) -> Iterator[Fault]:
    """Yield the one cause of what sliders and springs leave of a loop, if any.

    Args:
        record: Of kind `loop`.
        delay: Stated lag of its force [s].
    """
    whole = forced_loop(record, delay)
    every = -(-len(whole.force) // MOST_SAMPLES)
    loop = ForcedLoop(
        whole.fs / every, whole.displacement[::every], whole.force[::every], whole.begins
    )
    force = loop.force
    if len(force) < FEWEST or not np.ptp(loop.displacement) or not np.ptp(force):
        return
    noise = noise_of(force) ** 2 * len(force)
    basis = basis_of(loop.displacement)
    square = fit_loop(basis, force).square
    if square - NOISE * noise < LEFT**2 * len(force) * np.var(force):
        return
    most = noise + (1 - EXPLAINS) * (square - noise)
    tried = _late(loop, basis, delay), _high_passed(loop, basis), *_slipped(loop, record, every)
    causes = [cause for cause in tried if cause is not None and cause.square < most]
    if causes:
        yield min(causes, key=lambda cause: cause.square).fault


def _late(loop: ForcedLoop, whole: LoopBasis, stated: float) -> Cause | None:
    """A force that lags the displacement, by the lag that leaves least of the force ahead of it."""
    if not (cycles := cycles_of(loop)):
        return None
    longest = OF_CYCLE * float(np.median([one.num_samples for one in cycles]))
    known = slice(0, len(loop.force) - int(np.ceil(longest)))  # whose force is in the record
    # Beside a lag a dashpot tells nothing: of a spring it is its opposite.
    basis = LoopBasis(whole.losses[known, :-1], whole.springs[known])
    samples = np.arange(len(loop.force))

    def square(lag: float) -> float:
        return fit_loop(basis, np.interp(samples[known] + lag, samples, loop.force)).square

    found: Any = minimize_scalar(square, bounds=(0.0, longest), method="bounded")
    lag = float(found.x) / loop.fs
    share = len(samples) / len(samples[known])
    return Cause(share * found.fun, doubt("restoring_force", *messages.late(lag, stated + lag)))


def _high_passed(loop: ForcedLoop, basis: LoopBasis) -> Cause | None:
    """A force behind the high-pass of a charge amplifier."""
    mean = 0.5 * (loop.force[1:] + loop.force[:-1]) / loop.fs
    integral = np.concatenate([[0.0], np.cumsum(mean)])
    found = fit_loop(basis, loop.force, [-integral])
    rate = float(found.beside[0])
    if not rate > 0:
        return None
    return Cause(found.square, doubt("restoring_force", *messages.high_passed(1 / rate)))


def _slipped(loop: ForcedLoop, record: Record, every: int) -> Iterator[Cause]:
    """A gauge that slips, at each of the steps of the motion that are least like those around."""
    steps = np.diff(loop.displacement)
    around = np.lib.stride_tricks.sliding_window_view(steps, 2 * NEIGHBOURS + 1)
    unlike = steps[NEIGHBOURS:-NEIGHBOURS] - np.median(around, axis=1)
    for place in np.argsort(np.abs(unlike))[-SLIPS:].tolist():
        first = place + NEIGHBOURS + 1  # sample behind the slip
        motion = loop.displacement.copy()
        motion[first:] -= unlike[place]
        found = fit_loop(basis_of(motion), loop.force)
        spoilt = np.zeros(len(record.channels["displacement"]), bool)
        spoilt[first * every] = True
        text = messages.slipped(float(unlike[place]), first / loop.fs, kept_part(record, spoilt))
        yield Cause(found.square, doubt("displacement", *text))
