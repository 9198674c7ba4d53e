"""What a plan is made of: tests that might be made, what is wanted, what they would tell."""

from dataclasses import dataclass, field

import numpy as np

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


@dataclass(frozen=True)
class Noise:
    """Noise of the response channel.

    Attributes:
        std: Standard deviation of a sample [m, m/s or m/s^2].
        response: displacement, velocity or acceleration.
    """

    std: float
    response: str


@dataclass(frozen=True)
class Wish:
    """What is wanted, and the limits.

    Attributes:
        wanted: Parameters to be known.
        cv: Their wished coefficient of variation [-].
        max_repeats: Most repeats of one test.
        max_displacement: Largest displacement admitted [m].
        max_input: Largest input admitted [V, N or N/kg].
        input_unit: Unit of levels: V, N or N/kg.
    """

    wanted: tuple[str, ...]
    cv: float
    max_repeats: int = 1000
    max_displacement: float = np.inf
    max_input: float = np.inf
    input_unit: str = "N/kg"


@dataclass(frozen=True)
class Expected:
    """Coefficient of variation of a parameter over the joints held possible [-].

    Attributes:
        median: At half of the joints or more.
        worst_decile: At nine joints in ten or more; the wish is judged by it.
    """

    median: float
    worst_decile: float


@dataclass(frozen=True)
class Row:
    """One candidate.

    Attributes:
        test: The test in words.
        level: Peak of the input [V, N or N/kg].
        y_peak: Predicted peak displacement [m], median over joints.
        y_peak_largest: The largest over joints [m].
        repeats: Repeats that the wish takes; None where no admitted number suffices.
        seconds_each: Measuring time of one repeat [s].
        seconds: Measuring time of all repeats [s]; None without a number of repeats.
        cv: Expected spread after these repeats, or after the most admitted, by parameter.
        information_gain: Expected of one repeat, mean over joints [nats].
        status: "ok"; "too few", where no admitted number of repeats suffices; "not feasible",
            where a joint exceeds the largest displacement or input; or "not predicted", where no
            response was found at some joint.
        notes: What stands against the test, or stays undetermined, in words.
    """

    test: str
    level: float
    y_peak: float
    y_peak_largest: float
    repeats: int | None
    seconds_each: float
    seconds: float | None
    cv: dict[str, Expected]
    information_gain: float
    status: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chosen:
    """A test of a combination.

    Attributes:
        test: The test in words.
        level: Peak of the input [V, N or N/kg].
        repeats: How many.
    """

    test: str
    level: float
    repeats: int


@dataclass(frozen=True)
class Combination:
    """Tests to make together.

    Attributes:
        tests: The tests.
        seconds: Measuring time [s].
        cv: Expected spread after all of them.
        met: Whether the wish is met.
        notes: What stays undetermined, in words.
    """

    tests: tuple[Chosen, ...]
    seconds: float
    cv: dict[str, Expected]
    met: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Candidates by measuring time, those that meet the wish within the limits first.

    Attributes:
        rows: The candidates.
        combination: Tests that meet the wish together.
        wish: What was asked.
        num_joints: Joints that every number was made at.
        before: Expected spread before any of these tests, by parameter.
        notes: What was assumed.
    """

    rows: tuple[Row, ...]
    combination: Combination
    wish: Wish
    num_joints: int
    before: dict[str, Expected]
    notes: tuple[str, ...] = field(default=())
