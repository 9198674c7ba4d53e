r"""The elements of a plan: candidate tests, wanted accuracy, and expected information.

The accuracy of a fleet study (several assemblies at several torques) can be computed before any
measurement from the numbers of assemblies and torques alone. With n units at ln torques t around
their mean, in units of the scatter tau, and for records with negligible errors:

$$\mathrm{sd}\,b_1 = \Big(\sum (t - \bar t)^2\Big)^{-1/2}, \qquad
  b_1 \pm t_{n-2}\,\mathrm{sd}\,b_1, \qquad y_{new} \pm t_{n-2}\sqrt{1 + 1/n}$$
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from jbw.errors import ConfigError

FADE_PERIODS = 8  # length of the fade-out at the end of a burst, in periods of the last frequency
MOST_FADED = 0.1  # largest fraction of a burst during which it is faded out
DESIGNS = ((3, 1), (3, 2), (3, 3), (4, 2), (5, 1), (5, 3))
LEVEL = 0.995  # probability of the upper end of a 99 % interval


@dataclass(frozen=True)
class PlannedSweep:
    """A linear sweep from rest, recorded during its burst and the following free decay."""

    level: float  # peak of the input [V, N or N/kg]
    start_hz: float
    stop_hz: float
    rate: float  # rate of the sweep [Hz/s]
    rest: float  # duration of the free decay after the burst; at its end the joint is at rest [s]
    fs: float  # sampling frequency [Hz]

    @property
    def burst(self) -> float:
        """The duration of the sweep [s]."""
        return (self.stop_hz - self.start_hz) / self.rate

    @property
    def fade(self) -> float:
        """The duration of the fade-out at the end of the burst [s]."""
        return min(FADE_PERIODS / self.stop_hz, MOST_FADED * self.burst)

    @property
    def highest_hz(self) -> float:
        """The highest frequency of the test, which is the last one of the sweep [Hz]."""
        return self.stop_hz

    @property
    def num_samples(self) -> int:
        """The number of samples of one record."""
        return round(self.seconds * self.fs)

    @property
    def seconds(self) -> float:
        """The measuring time of one repeat [s]."""
        return self.burst + self.rest

    def __str__(self) -> str:
        return f"sweep {self.start_hz:.4g}-{self.stop_hz:.4g} Hz, {self.rate:.3g} Hz/s"


@dataclass(frozen=True)
class PlannedTones:
    """Steady tones, each in a separate record."""

    level: float  # peak of the input [V, N or N/kg]
    frequencies_hz: tuple[float, ...]
    dwell: float  # duration of each step [s]
    settle: float  # first part of each step, which is discarded [s]
    fs: float  # sampling frequency [Hz]

    @property
    def highest_hz(self) -> float:
        """The highest used frequency, which is the third harmonic of the highest tone [Hz]."""
        return 3 * max(self.frequencies_hz)

    @property
    def num_samples(self) -> int:
        """The number of samples that are used at each frequency."""
        return round((self.dwell - self.settle) * self.fs)

    @property
    def seconds(self) -> float:
        """The measuring time of one repeat [s]."""
        return self.dwell * len(self.frequencies_hz)

    def __str__(self) -> str:
        listed = " ".join(f"{frequency:.3g}" for frequency in self.frequencies_hz)
        return f"tones {listed} Hz, {self.dwell:.3g} s each"


@dataclass(frozen=True)
class PlannedBackbone:
    """Points at phase resonance with a controlled amplitude, one amplitude after another."""

    level: float  # largest peak of the input: the median over the drawn joints [V, N or N/kg]
    amplitudes: tuple[float, ...]  # amplitudes of the displacement [m]
    dwell: float  # duration of each step [s]
    settle: float  # first part of each step, in which the controller locks [s]
    fs: float  # sampling frequency [Hz]
    natural_hz: float  # natural frequency, to which all frequencies of the test are close [Hz]

    @property
    def num_samples(self) -> int:
        """The number of samples that are used at each point."""
        return round((self.dwell - self.settle) * self.fs)

    @property
    def seconds(self) -> float:
        """The measuring time of one repeat [s]."""
        return self.dwell * len(self.amplitudes)

    @property
    def highest_hz(self) -> float:
        """The highest used frequency [Hz]: the natural frequency, because no harmonic is used."""
        return self.natural_hz

    def __str__(self) -> str:
        low, high = (1e3 * x for x in (min(self.amplitudes), max(self.amplitudes)))
        count = len(self.amplitudes)
        return f"backbone {low:.3g}-{high:.3g} mm, {count} points of {self.dwell:.3g} s"


@dataclass(frozen=True)
class PlannedSteppedSine(PlannedTones):
    """A stepped sine: one record with one frequency after another."""

    def __str__(self) -> str:
        low, high = min(self.frequencies_hz), max(self.frequencies_hz)
        count = len(self.frequencies_hz)
        return f"stepped {low:.4g}-{high:.4g} Hz, {count} steps of {self.dwell:.3g} s"


Candidate = PlannedSweep | PlannedTones | PlannedBackbone


@dataclass(frozen=True)
class ResponseNoise:
    """The noise of the response channel."""

    std: float  # standard deviation of a sample [m, m/s or m/s^2]
    response: str  # displacement, velocity or acceleration


@dataclass(frozen=True)
class Wish:
    """The wanted parameters with their accuracy, and the limits of the tests."""

    wanted: tuple[str, ...]  # parameters to be determined
    cv: float  # wanted coefficient of variation of each wanted parameter
    max_repeats: int = 1000  # largest number of repeats of one test
    max_displacement: float = np.inf  # largest displacement [m]
    max_input: float = np.inf  # largest peak of the input [V, N or N/kg]
    input_unit: str = "N/kg"  # unit of the input: V, N or N/kg


@dataclass(frozen=True)
class Expected:
    """The expected coefficient of variation of a parameter, over the drawn joints [-]."""

    median: float  # value that half of the joints do not exceed
    # value that nine joints in ten do not exceed, to which the wanted accuracy applies
    worst_decile: float


@dataclass(frozen=True)
class CandidateRow:
    """The row of a candidate test; its status is ok, too few, not feasible or not predicted."""

    test: str  # description of the test
    level: float  # peak of the input [V, N or N/kg]
    y_peak: float  # predicted peak displacement: the median over the drawn joints [m]
    y_peak_largest: float  # predicted peak displacement: the largest of all drawn joints [m]
    # number of repeats that give the wanted accuracy; None if it exceeds the limit
    repeats: int | None
    seconds_each: float  # measuring time of one repeat [s]
    seconds: float | None  # measuring time of all repeats [s]
    # CV of each parameter after these repeats, or after the largest allowed number
    cv: dict[str, Expected]
    # expected information gain of one repeat: the mean over the drawn joints [nats]
    information_gain: float
    status: str
    # reasons against the test, and parameters that it does not determine
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chosen:
    """A test in a combination of tests, with its number of repeats."""

    test: str  # description of the test
    level: float  # peak of the input [V, N or N/kg]
    repeats: int


@dataclass(frozen=True)
class Combination:
    """A set of tests that are to be performed together."""

    tests: tuple[Chosen, ...]
    seconds: float  # measuring time of all tests [s]
    cv: dict[str, Expected]  # CV of each parameter after all tests
    met: bool  # whether the wanted accuracy is reached
    notes: tuple[str, ...] = ()  # notes on parameters that the tests do not determine


@dataclass(frozen=True)
class MeasurementPlan:
    """A plan: candidate tests, and a combination of them that gives the wanted accuracy."""

    rows: tuple[CandidateRow, ...]
    combination: Combination  # set of tests that together give the wanted accuracy
    wish: Wish
    num_joints: int  # number of drawn joints, over which all medians and deciles are taken
    before: dict[str, Expected]  # CV of each parameter before the planned tests
    notes: tuple[str, ...] = ()  # assumptions of the plan


class FleetDesign(NamedTuple):
    """The accuracy expected of a fleet of units, relative to the standard deviation between units.

    Attributes:
        levels: Number of torques, evenly spaced in the logarithm.
        assemblies: Number of assemblies at each torque.
        slope_sd: Standard deviation of the slope on ln torque.
        slope: Half-width of the slope's 99 % interval.
        new_unit: Half-width of the 99 % interval of a new assembly at the middle torque.
    """

    levels: int
    assemblies: int
    slope_sd: float
    slope: float
    new_unit: float


def fleet_designs(
    torque: tuple[float, float], designs: Iterable[tuple[int, int]] = DESIGNS
) -> list[FleetDesign]:
    """Return the accuracy expected of fleets of units with torques between two limits [N m].

    Raises:
        ConfigError: The torques are no range, or a design has fewer than three units.
    """
    low, high = torque
    if not 0.0 < low < high < np.inf:
        raise ConfigError(
            f"The torques must be positive and rise, but are {low:g} to {high:g} N m."
        )
    return [_design(np.log(low), np.log(high), *size) for size in designs]


def _design(low: float, high: float, levels: int, assemblies: int) -> FleetDesign:
    num = levels * assemblies
    if levels < 2 or num < 3:
        raise ConfigError(
            f"A design needs at least two torques and three units, but has {levels} x {assemblies}."
        )
    at = np.repeat(np.linspace(low, high, levels), assemblies)
    slope_sd = float(1.0 / np.sqrt(np.sum((at - at.mean()) ** 2)))
    times = float(student.ppf(LEVEL, num - 2))
    return FleetDesign(
        levels, assemblies, slope_sd, times * slope_sd, times * float(np.sqrt(1.0 + 1.0 / num))
    )
