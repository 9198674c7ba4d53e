r"""A response whose clock differs from the drive's clock: a lag that is constant, grows or jumps.

A response that is late by $\tau(t)$ is rotated by $e^{-i\dot\phi\tau}$ in the frame of the drive. A
constant lag is a delay; one that grows comes from two recorders with different clocks; one that
jumps comes from a block of samples that a recorder lost. Lags are in mean periods of the sweep. A
lag of half a period is a wrong sign of a channel.

A lag between channels is the same at every amplitude, whereas a joint changes the phase where it
moves. A delay must therefore be equal to that at the beginning, before the motion is large.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from jbw.measurement.channels import Complexes, Reals
from jbw.measurement.faults.hypothesis import Facts, Hypothesis, joint_fit
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual
from jbw.measurement.faults.suspect import Misfit, Suspect, as_columns
from jbw.measurement.loops import cycles_of
from jbw.measurement.readings.loop import LoopBasis, fit_loop
from jbw.measurement.readings.sweep import SweepCause, SweepFits, SweepSignal, late
from jbw.measurement.spans import kept_before
from jbw.report.messages import clock_faults as messages
from jbw.report.messages import loop_faults as loop_messages
from jbw.report.messages.message import FaultText

OTHER_SIGN = 0.45  # lag, in periods, above which the cause is a wrong sign of the channel instead
# Smallest lags, in periods, that are reported; a drift of the lag is the change over the whole
# record.
LEAST_DELAY, LEAST_DRIFT, LEAST_STEP = 0.01, 0.04, 0.05
LEAST_LOST = 1.6  # smallest reported number of lost samples
# candidate times of a jump, as fractions of the record's accumulated amplitude
PLACES = np.linspace(0.03, 0.97, 16)
SCANNED = 12  # largest number of iterations for the time of a jump between two candidate times
# Below this fraction of the largest motion, the lag is determined without an effect of the joint.
QUIET = 0.4
# FEWEST: smallest number of values of quiet motion. FAINT: weight of all other values.
FEWEST, FAINT = 24, 1e-6
OF_CYCLE = 0.125  # largest lag that is tried for a loop, as a fraction of a cycle
# largest relative difference between the lags at small motion and in the whole record; a true lag
# gives 0.06
ALIKE = 0.5


class _Lag(Hypothesis):
    """The fault that a response lags behind its drive, by a given function of time."""

    starts: tuple[tuple[float, ...], ...]

    def course(self, signal: SweepSignal, values: Reals) -> Reals:
        """Return the lag of the response at every time, in mean periods of the drive."""
        raise NotImplementedError

    def causes(self, fits: Any, basis: str) -> Iterator[SweepCause]:
        """Yield the lag as a cause of a sweep's residual, once for each set of starting values."""
        if not isinstance(fits, SweepFits) or basis != "linear":
            return
        period = fits.signal.mean_period_s

        def delayed(signal: SweepSignal, columns: Complexes, values: Reals) -> Complexes:
            return late(columns, signal.rate, self.course(signal, values) * period)

        yield from (SweepCause(np.array(start), delayed) for start in self.starts)


class Delay(_Lag):
    """A constant lag, in mean periods of the drive."""

    name = "delay of the response"
    starts = ((-0.35,), (-0.12,), (0.12,), (0.35,))

    def course(self, signal: SweepSignal, values: Reals) -> Reals:
        """Return a lag that is constant over time, in mean periods of the drive."""
        return np.full(len(signal.time), values[0])

    def matters(self, values: Reals, fits: Any) -> bool:
        """Return whether a lag is above 1 % of a period, no wrong sign, equal at small motion."""
        if not LEAST_DELAY <= abs(values[0]) <= OTHER_SIGN:
            return False
        signal = fits.signal
        count = int(np.argmax(signal.amplitude > QUIET * signal.amplitude.max()))
        if count < FEWEST:
            return True
        is_quiet = np.arange(len(signal.time)) < count
        quiet = fits._replace(weight=np.where(is_quiet, fits.weight, FAINT * fits.weight))
        cause = next(self.causes(fits, "linear"))
        starts = (cause._replace(start=np.array([lag])) for lag in (0.0, values[0]))
        ends = [end for start in starts if (end := joint_fit(quiet, "linear", start)) is not None]
        own = min(ends, key=lambda end: end.squares).theta[-1] if ends else values[0]
        return bool(abs(own - values[0]) <= ALIKE * abs(values[0]))

    def fault(self, values: Reals, fits: Any, facts: Facts) -> FaultText:
        """Return the text on a response that lags more or less than stated."""
        seconds = facts.delay_s + float(values[0]) * fits.signal.mean_period_s
        return messages.another_delay(seconds, facts.delay_s)

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield the lag of the force that fits a loop best, as a possible cause of its residual."""
        loop, whole = residual.loop, residual.basis
        if not (cycles := cycles_of(loop)):
            return
        longest = OF_CYCLE * float(np.median([one.num_samples for one in cycles]))
        # samples for which the record contains the force at the longest lag
        known = slice(0, len(loop.force) - int(np.ceil(longest)))
        # No dashpot is fitted together with a lag, because a lagging spring acts as a negative
        # dashpot.
        basis = LoopBasis(whole.losses[known, :-1], whole.springs[known])
        samples = np.arange(len(loop.force))

        def square(lag: float) -> float:
            return fit_loop(basis, np.interp(samples[known] + lag, samples, loop.force)).square

        found: Any = minimize_scalar(square, bounds=(0.0, longest), method="bounded")
        lag, share = float(found.x) / loop.fs, len(samples) / len(samples[known])
        yield LoopCause(share * found.fun, loop_messages.late(lag, residual.delay_s + lag))

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        r"""Yield columns for the change of the data by a delay of all responses: $-j\omega X$."""
        spectra = misfit.spectra.items()
        columns = {n: as_columns(s.row(-1j * s.omega * s.predicted)) for n, s in spectra}
        yield Suspect(columns, lambda tau: messages.another_delay(tau[0]))


class ClocksApart(_Lag):
    """A growing lag: the lag at mid-record and its change over the record, in mean periods."""

    name = "clocks apart"
    starts = ((-0.25, -0.5), (-0.12, -0.25), (0.12, 0.25), (0.25, 0.5))

    def course(self, signal: SweepSignal, values: Reals) -> Reals:
        """Return the lag as a straight line over time, in mean periods of the drive."""
        time = signal.time
        return values[0] + values[1] * (time - time.mean()) / np.ptp(time)

    def matters(self, values: Reals, fits: Any) -> bool:
        """Return whether the lag changes by at least 4 % of a period along the record."""
        return abs(values[0]) <= OTHER_SIGN and abs(values[1]) >= LEAST_DRIFT

    def fault(self, values: Reals, fits: Any, facts: Facts) -> FaultText:
        """Return the text on two clocks of different speed."""
        change = float(values[1]) * fits.signal.mean_period_s
        slope = change / float(np.ptp(fits.signal.time))
        return messages.another_clock(slope, abs(change))

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        r"""Yield columns for the change of the data by a fast response clock: $-t\,\dot x$."""
        courses = {n: s.stretched for n, s in misfit.spectra.items() if s.stretched is not None}
        if courses:
            columns = {name: as_columns(-course) for name, course in courses.items()}
            yield Suspect(columns, lambda fast: messages.another_clock(fast[0]))


class LostBlock(_Lag):
    """A lag that jumps from zero: size in mean periods, and time as a fraction of the record."""

    name = "lost block"

    def causes(self, fits: Any, basis: str) -> Iterator[SweepCause]:
        """Yield the jump of the lag that fits best, searched first coarsely, then finely."""
        if not isinstance(fits, SweepFits) or basis != "linear":
            return
        signal, count = fits.signal, len(fits.fits["linear"].theta)
        share = np.cumsum(np.abs(signal.z) * fits.weight)
        times = np.interp(PLACES, share / share[-1], signal.time)

        def fitted(at: float, step: float) -> tuple[float, float, float]:
            """Fit the size of a jump at a given time; return sum of squares, time, and size."""
            found = joint_fit(fits, "linear", SweepCause(np.array([step]), _stepped(float(at))))
            return (found.squares, at, float(found.theta[count])) if found else (np.inf, at, step)

        _, at, step = min(fitted(at, step) for at in times for step in (-0.25, 0.25))
        inner = int(np.searchsorted(times, at))
        ends = signal.time[0], *times[max(inner - 1, 0) : inner + 2], signal.time[-1]
        low, high = max(x for x in ends if x < at), min(x for x in ends if x > at)
        # The fit finds the time of the jump only if it starts within the filter's length of that
        # time; the scan gives such a starting value.
        found: Any = minimize_scalar(
            lambda x: fitted(x, step)[0], bounds=(low, high), options={"maxiter": SCANNED}
        )
        _, at, step = min(fitted(float(found.x), step), fitted(at, step))
        yield SweepCause(np.array([step, at / float(np.ptp(signal.time))]), _stepped(None))

    def matters(self, values: Reals, fits: Any) -> bool:
        """Return whether the jump is at least 1.6 samples and 5 % of a period."""
        signal = fits.signal
        samples = abs(values[0]) * signal.mean_period_s * signal.fs
        at = float(values[1]) * float(np.ptp(signal.time))
        is_inside = signal.time[0] < at < signal.time[-1]
        return is_inside and samples >= LEAST_LOST and abs(values[0]) >= LEAST_STEP

    def fault(self, values: Reals, fits: Any, facts: Facts) -> FaultText:
        """Return the text on a lost block; its remedy keeps the record up to the block."""
        signal = fits.signal
        at = float(values[1]) * float(np.ptp(signal.time))
        jump = float(values[0]) * signal.mean_period_s
        keep = kept_before(facts.record, at - signal.mean_period_s)
        return messages.lost_block(at, jump, keep)


def _stepped(at_s: float | None) -> Callable[[SweepSignal, Complexes, Reals], Complexes]:
    """Return a function that applies a lag which jumps at a given time [s] or at a fitted time."""

    def stepped(signal: SweepSignal, columns: Complexes, values: Reals) -> Complexes:
        place = float(values[1]) * float(np.ptp(signal.time)) if at_s is None else at_s
        after = signal.filtered_step(place)[:, None]
        moved = late(columns, signal.rate, values[0] * signal.mean_period_s)
        return columns * (1 - after) + moved * after

    return stepped
