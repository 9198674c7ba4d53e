r"""Faults as hypotheses that explain the residual of a fit, and the conditions for reporting one.

A mode is fitted first. Only if its residual exceeds noise and the law's own error are further
causes tried, one at a time, *fitted together with the mode*. A cause is named if it meets four
conditions, which are calibrated on sound records of every law (`benchmarks/outside`):

1. the fit leaves a residual: a weighted rms above 1.2, or 6 % of the response; for a steady line
   alone a line of 30 times its local median and 0.05 % of the largest response;
2. the cause explains at least 40 % of the weighted sum of squares;
3. $2 \ln L_1/L_0 - k \ln n > 25$, with n the effective number of values of a coloured residual
   and k the number of the cause's parameters;
4. it is large enough to matter, by a limit of each hypothesis.

Among causes within 20 of the best, the one with the fewest parameters is named.
"""

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault
from jbw.measurement.faults.loop_residual import LoopCause, LoopResidual
from jbw.measurement.faults.suspect import Cause, Misfit, Suspect
from jbw.measurement.readings.decay import DecayCause, DecayFits, fit_decay
from jbw.measurement.readings.slow_flow import ModeFit, filtered_share, independent_share
from jbw.measurement.readings.sweep import SweepCause, SweepFits, fit_sweep
from jbw.measurement.records import Record
from jbw.report.messages.message import FaultText

# Condition 1 has four limits: the weighted rms of the residual; a line of its spectrum relative to
# the local median; a line relative to the largest response; the residual relative to the response.
LEFT, LINE, LINE_SIZE, LEFT_SHARE = 1.2, 30.0, 5e-4, 0.06
# condition 2: largest fraction of the sum of squares that remains after the cause is fitted
EXPLAINS = 0.6
# If a cause reduces the residual sum of squares below this fraction, no other cause is tried.
ENOUGH = 0.01
ODDS = 25.0  # condition 3: smallest 2 ln(L1/L0) - k ln(n) with which a cause is named
# Two causes count as equally likely if 2 ln of their likelihood ratio is below this value.
NEARLY = 20.0
# An unexplained residual is reported above this weighted rms and this fraction of the response. Of
# 432 sound records, those with an rms above 1.3 have residuals of at most 2 % of the response, and
# the others of at most 17 %.
UNEXPLAINED, UNEXPLAINED_SHARE = 1.7, 0.08
# trial forms of how the mode depends on amplitude, in a fit of the mode together with a fault
BASES_TRIED = ("linear", "power")
# A line of a residual's spectrum is compared with the median of this number of lines around it.
AROUND = 61

Fits = DecayFits | SweepFits


class Hypothesis:
    """A kind of fault, with tests for it; a test that a subclass does not define finds nothing."""

    name: ClassVar[str]  # the name of the fault in a table

    def seen(self, fits: Fits, facts: "Facts") -> Iterator[Fault]:
        """Yield the fault if a fit of the mode alone already shows the fault."""
        yield from ()

    def causes(self, fits: Fits, basis: str) -> Iterator[DecayCause | SweepCause]:
        """Yield starting values for a common fit of this fault and a mode, if both can occur."""
        yield from ()

    def matters(self, values: Reals, fits: Fits) -> bool:
        """Return whether a fault with these parameters is physical and large enough to report."""
        raise NotImplementedError

    def fault(self, values: Reals, fits: Fits, facts: "Facts") -> FaultText:
        """Return the text of the fault to report: finding, reason and remedy."""
        raise NotImplementedError

    def spoils(self, values: Reals, fits: Fits) -> bool:
        """Return whether a fault with these parameters makes the record unusable."""
        return False

    def in_loop(self, residual: LoopResidual) -> Iterator[LoopCause]:
        """Yield the residual of a force loop after a fit of sliders together with this fault."""
        yield from ()

    def suspects(self, misfit: Misfit) -> Iterator[Suspect | Cause]:
        """Yield suspects: changes of the data that this fault causes near a fit of the joint."""
        yield from ()


class Facts(NamedTuple):
    """A record and its stated settings, needed for the text of a remedy.

    Attributes:
        record: The whole record.
        settle_s: Time at the start of the record that was not read [s].
        delay_s: Stated lag of the response [s].
        band_hz: Band that was read [Hz].
        mode: Frequency [Hz] and damping ratio of the mode that is fitted with the cause.
    """

    record: Record
    settle_s: float
    delay_s: float
    band_hz: tuple[float, float]
    mode: tuple[float, float] = (np.nan, np.nan)


class LeftOver(NamedTuple):
    """The residual of a fit of one mode to a record.

    Attributes:
        rms: Weighted root mean square; 1 for noise alone.
        line: Largest line of the spectrum over the local median.
        line_size: Amplitude of that line over the largest response.
        share: Rms of the residual, divided by the rms of the response.
    """

    rms: float
    line: float
    line_size: float
    share: float

    @property
    def has_line(self) -> bool:
        """Whether a single spectral line of the residual stands out."""
        return self.line > LINE and self.line_size > LINE_SIZE

    @property
    def is_noise(self) -> bool:
        """Whether noise explains the residual, apart from a line that may stand out."""
        return self.rms < LEFT and self.share < LEFT_SHARE


def best_of(fits: Fits) -> ModeFit:
    """Return the fit with the smallest residual among fits with different amplitude powers."""
    return min(fits.fits.values(), key=lambda fit: fit.squares)


def remainder(fits: Fits) -> LeftOver:
    """Return the residual of a record after the best fit of one mode."""
    best, signal = best_of(fits), fits.signal
    turned = best.residual
    if isinstance(fits, SweepFits):  # In the frame of the drive, a steady line rotates.
        frame = fits.signal.phase - 2 * np.pi * fits.signal.centre_hz * fits.signal.time
        turned = turned * np.exp(1j * frame)
    power = np.abs(np.fft.fft(turned * fits.weight)) ** 2
    local = median_filter(power, min(AROUND, len(power) | 1), mode="wrap") / np.log(2)
    over = power / (local + 0.02 * power.mean() + 1e-300)
    at = int(np.argmax(over))
    size = abs(np.fft.fft(turned)[at]) / len(turned) / np.abs(signal.z).max()
    share = float(np.linalg.norm(best.residual) / np.linalg.norm(signal.z))
    rms = float(np.sqrt(best.squares / len(signal.z)))
    return LeftOver(rms, float(over[at]), float(size), share)


def named_cause(
    fits: Fits, hypotheses: Sequence[Hypothesis]
) -> tuple[Hypothesis, Reals, tuple[float, float]] | None:
    """Return the fault that explains the residual of a fitted mode; None if no fault does.

    Its parameters follow, and frequency [Hz] and damping ratio of the linear mode that is fitted
    with it, as after a remedy.
    """
    nothing = best_of(fits)
    enough = min(LEFT**2 * len(fits.signal.z), ENOUGH * nothing.squares)
    tried, rivals = [], 0
    modes = {}  # the fitted mode for each kind of fault, by its name
    for hypothesis in hypotheses:
        found = list(_joint_fits(fits, hypothesis))
        if found:
            modes[hypothesis.name] = _mode(fits, found[0][1])
        tried += [(hypothesis, *row) for row in found if hypothesis.matters(row[0], fits)]
        rivals += len(found) > 0
        # Kinds of fault are in order of their number of parameters. If one fault leaves only noise,
        # no further one is tried.
        if rivals > 1 and any(fitted.squares < enough for _, _, fitted in tried):
            break
    if not tried:
        return None
    closest = min(tried, key=lambda row: row[2].squares)[2]
    signal = fits.signal
    # A spectrum with few lines cannot show how coloured it is, but the effect of the filter is
    # known.
    of_filter = filtered_share(signal.taps, round(signal.step_s * signal.fs))
    share = min(independent_share(closest.residual * fits.weight), of_filter)
    count = 2 * len(signal.z) * share

    def score(fitted: ModeFit) -> float:
        return count * np.log(max(fitted.squares, 1e-300)) + len(fitted.theta) * np.log(count)

    zero = min(score(fitted) for fitted in fits.fits.values())
    odds = [zero - score(fitted) for _, _, fitted in tried]
    alike = [i for i in range(len(tried)) if odds[i] > max(odds) - NEARLY]
    chosen = min(alike, key=lambda i: (len(tried[i][1]), -odds[i]))
    hypothesis, values, fitted = tried[chosen]
    if odds[chosen] > ODDS and fitted.squares < EXPLAINS * nothing.squares:
        return hypothesis, values, modes[hypothesis.name]
    return None


def _mode(fits: Fits, linear: ModeFit) -> tuple[float, float]:
    """Return the frequency [Hz] and damping ratio of a fitted linear mode."""
    sigma, turn = linear.theta[fits.FIRST : fits.FIRST + 2] * fits.scale
    pole = complex(-sigma, turn + 2 * np.pi * fits.signal.centre_hz)
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)


def _joint_fits(fits: Fits, hypothesis: Hypothesis) -> Iterator[tuple[Reals, ModeFit]]:
    """Yield fits of a mode together with a fault: first a linear mode, then one with a power law.

    The fit with a power law also starts from the result of the fit with a linear mode.
    """
    ended: list[DecayCause | SweepCause] = []
    for basis in BASES_TRIED:
        if basis not in fits.fits:
            continue
        count = len(fits.fits[basis].theta)
        ends = [
            (fitted, cause)
            for cause in (*hypothesis.causes(fits, basis), *ended)
            if (fitted := joint_fit(fits, basis, cause)) is not None
        ]
        if ends:
            fitted, cause = min(ends, key=lambda row: row[0].squares)
            ended = [cause._replace(start=fitted.theta[count:])]
            yield fitted.theta[count:], fitted


def joint_fit(fits: Fits, basis: str, cause: DecayCause | SweepCause) -> ModeFit | None:
    """Fit a mode together with a fault; return None if the fit fails numerically."""
    fit: Any = fit_decay if isinstance(fits, DecayFits) else fit_sweep
    try:
        return fit(fits.signal, basis, fits.fits[basis].theta, fits.scale, fits.weight, cause)
    except (ValueError, np.linalg.LinAlgError):
        return None
