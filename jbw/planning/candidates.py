"""Tests that might be made: what is played, at which level, how long one repeat takes."""

from dataclasses import dataclass

FADE_PERIODS = 8  # of the last frequency, over which a burst fades out
MOST_FADED = 0.1  # of a burst


@dataclass(frozen=True)
class Sweep:
    """A linear sweep from rest, recorded through its burst and the free decay behind it.

    Attributes:
        level: Peak of the input [V, N or N/kg].
        start_hz: First frequency [Hz].
        stop_hz: Last frequency [Hz].
        rate: Sweep rate [Hz/s].
        rest: Free decay behind the burst, recorded too; the joint is at rest at its end [s].
        fs: Sampling frequency [Hz].
    """

    level: float
    start_hz: float
    stop_hz: float
    rate: float
    rest: float
    fs: float

    @property
    def burst(self) -> float:
        """Length of the sweep [s]."""
        return (self.stop_hz - self.start_hz) / self.rate

    @property
    def fade(self) -> float:
        """Length of the fade, the last part of the burst [s]."""
        return min(FADE_PERIODS / self.stop_hz, MOST_FADED * self.burst)

    @property
    def num_samples(self) -> int:
        """Samples of one record."""
        return round((self.burst + self.rest) * self.fs)

    @property
    def seconds(self) -> float:
        """Measuring time of one repeat [s]."""
        return self.burst + self.rest

    def __str__(self) -> str:
        span = f"{self.start_hz:.4g}-{self.stop_hz:.4g} Hz"
        return f"sweep {span}, {self.rate:.3g} Hz/s"


@dataclass(frozen=True)
class Tones:
    """Steady tones, each alone in a record of its own.

    Attributes:
        level: Peak of the input [V, N or N/kg].
        frequencies_hz: Their frequencies [Hz].
        dwell: Time on each of them [s].
        settle: Of that, the first part, which is discarded [s].
        fs: Sampling frequency [Hz].
    """

    level: float
    frequencies_hz: tuple[float, ...]
    dwell: float
    settle: float
    fs: float

    @property
    def num_samples(self) -> int:
        """Samples that are read of each frequency."""
        return round((self.dwell - self.settle) * self.fs)

    @property
    def seconds(self) -> float:
        """Measuring time of one repeat [s]."""
        return self.dwell * len(self.frequencies_hz)

    def __str__(self) -> str:
        return f"tones {_listed(self.frequencies_hz)} Hz, {self.dwell:.3g} s each"


@dataclass(frozen=True)
class Stepped(Tones):
    """A stepped sine: the frequencies in turn, in one record."""

    def __str__(self) -> str:
        low, high = min(self.frequencies_hz), max(self.frequencies_hz)
        count = len(self.frequencies_hz)
        return f"stepped {low:.4g}-{high:.4g} Hz, {count} steps of {self.dwell:.3g} s"


Candidate = Sweep | Tones


def _listed(frequencies: tuple[float, ...]) -> str:
    return " ".join(f"{frequency:.3g}" for frequency in frequencies)
