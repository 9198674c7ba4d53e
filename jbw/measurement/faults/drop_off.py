"""A drive that drops to its own noise at the resonance, where the structure moves most easily."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter1d

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Facts, Fits, Hypothesis
from jbw.measurement.readings.sweep import SweepFits, SweepSignal
from jbw.report.messages import clock_faults as messages

FALLS = 0.5  # A drive drops off if it falls to this fraction of its median.
# ratio of noise to the smallest drive, above which the damping has an error of some percent
NOISY = 0.05
# roughness of a drive (its deviation from a smooth course over its median) that separates sweeps
# (0.01) from noise (0.5)
RANDOM = 0.3
SMOOTHED = 0.02  # width of the smoothing window, as a fraction of the number of values


class DropOff(Hypothesis):
    """The fault that a drive's amplitude falls to its noise at the resonance."""

    name = "drop-off of the drive"

    def seen(self, fits: Fits, facts: Facts) -> Iterator[Fault]:
        """Yield a warning if the drive of a sweep falls to its noise."""
        if isinstance(fits, SweepFits) and (dropped := drop_off(fits.signal)) is not None:
            yield doubt(facts.record.source, *messages.drop_off(*dropped))


def drop_off(signal: SweepSignal) -> tuple[float, float] | None:
    """Return min / median of a sweep's drive, and noise / drive; None if the drive is adequate."""
    smooth, rough = drive_course(signal)
    least = float(smooth.min())
    noise = rough / least
    return (least, noise) if least <= FALLS and noise >= NOISY else None


def drive_course(signal: SweepSignal) -> tuple[Reals, float]:
    """Return a drive's smoothed amplitude relative to its median, and the rms deviation from it."""
    size = np.abs(signal.u)
    # The width is at most a quarter of the number of values.
    width = max(min(max(int(SMOOTHED * len(size)), 5), len(size) // 4), 1)
    smooth = uniform_filter1d(size, width, mode="nearest")
    inner = slice(width, -width) if len(size) > 2 * width else slice(None)
    usual = float(np.median(smooth[inner]))
    rough = float(np.sqrt(np.mean((size - smooth)[inner] ** 2)))
    return smooth[inner] / usual, rough / usual
