"""The hypotheses on a force loop alone: load cell, charge amplifier, gauge, wear of the joint."""

from collections.abc import Iterator

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual, path_of
from jbw.measurement.loops import begins_unmoved, cycles_of, of_one_amplitude
from jbw.measurement.readings.loop import basis_of, fit_loop
from jbw.measurement.spans import kept_part, span_line, start_of
from jbw.report.messages import loop_faults as messages

# A joint counts as at rest while it moves less than this fraction of the whole stroke.
STILL = 1e-3
SLIPS = 3  # number of trial times at which the gauge may have slipped
# The usual step of the motion is the median over this number of steps on either side.
NEIGHBOURS = 2


class ZeroOfLoadCell(Hypothesis):
    """The offset and the drift of a load cell's zero along the record: $c_0 + c_1 t$."""

    name = "zero of load cell"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield a wrong zero of the load cell as a possible cause of a loop fit's residual."""
        if not residual.zero.shape[1]:
            return
        found, half_range = residual.fit(*residual.zero.T), 0.5 * np.ptp(residual.loop.force)
        offset, drift = np.pad(found.beside, (2 - len(found.beside), 0)) / half_range
        yield LoopCause(found.square, messages.off_centre(float(offset), float(drift)))


def at_rest(loop: ForcedLoop) -> Reals:
    """Return the force before the motion starts, which must be zero for every law."""
    y = loop.displacement
    if not begins_unmoved(loop):
        return loop.force[:0]
    return loop.force[: int(np.argmax(np.abs(y - y[0]) > STILL * np.ptp(y)))]


def loaded(rest: Reals, force: Reals) -> Iterator[LoopCause]:
    """Yield an offset of the load cell, estimated from the force before the motion."""
    text = messages.off_centre(float(np.mean(rest) / (0.5 * np.ptp(force))), 0.0)
    yield LoopCause(len(rest) * float(np.var(rest)), text)


class HighPass(Hypothesis):
    r"""The time constant of a charge amplifier's high-pass, which subtracts $\frac1T\int F\,dt$."""

    name = "high-pass of the force"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield a high-pass filter of the force as a possible cause of a loop fit's residual."""
        force, fs = residual.loop.force, residual.loop.fs
        integral = np.append(0.0, np.cumsum(0.5 * (force[1:] + force[:-1]) / fs))
        found = residual.fit(-integral)
        rate = float(found.beside[0])
        if rate > 0:
            yield LoopCause(found.square, messages.high_passed(1 / rate))


class Slip(Hypothesis):
    """A slip of the displacement gauge, whose motion jumps while the force does not."""

    name = "slip of the gauge"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield slips of the gauge at the times at which a step of the motion is most unusual."""
        loop, record, every = residual.loop, residual.record, residual.every
        steps = np.diff(loop.displacement)
        around = np.lib.stride_tricks.sliding_window_view(steps, 2 * NEIGHBOURS + 1)
        unlike = steps[NEIGHBOURS:-NEIGHBOURS] - np.median(around, axis=1)
        before = loop.begins - start_of(record)  # A stated delay may exclude the first samples.
        skipped = round(before * record.fs) if before else 0
        for place in np.argsort(np.abs(unlike))[-SLIPS:].tolist():
            first = place + NEIGHBOURS + 1  # first sample after the slip
            motion = loop.displacement.copy()
            motion[first:] -= unlike[place]
            found = fit_loop(basis_of(motion), loop.force)
            # After the slip, the displacement has another zero.
            count, last = len(record.channels["displacement"]), skipped + first * every
            spoilt = np.arange(count) > last - every
            at, keep = before + first / loop.fs, kept_part(record, spoilt)
            text = messages.slipped(float(unlike[place]), at, keep)
            yield LoopCause(found.square, text, "displacement")


class Wear(Hypothesis):
    """The change of a joint's force by wear along its path s: $F = F_0 + (w_1 s + w_2 s^2) F$."""

    name = "wear of the joint"

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield wear, as a function of the travelled path, as a cause of a loop fit's residual."""
        loop = residual.loop
        if not (groups := of_one_amplitude(cycles_of(loop))):
            return
        path = path_of(loop)
        found = residual.fit(*(path * loop.force))
        strength = 1 / (1 - found.beside @ path)
        changes = [
            float(np.median(strength[last.samples]) / np.median(strength[second.samples]) - 1)
            for _, second, *_, last in groups
        ]
        change, cycles = max(zip(changes, groups, strict=True), key=lambda pair: abs(pair[0]))
        ends = cycles[-2].samples.start / loop.fs, cycles[-1].samples.stop / loop.fs
        keep, amplitude = span_line(*ends, loop.begins), 0.5 * cycles[-1].stroke
        text = messages.degrading(amplitude, len(cycles), abs(change), keep, falls=change < 0)
        yield LoopCause(found.square, text)
