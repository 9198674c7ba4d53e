"""Types for comparisons of finished runs: two runs, or several runs side by side."""

from pydantic import Field

from jbw.results.stored import Number, Stored

Ends = list[float]  # lower end, median and upper end of a 99 % interval


class ComparedRun(Stored):
    """One of two runs that are compared."""

    folder: str
    campaign: str = ""
    verdict: str = ""
    model_adequacy: str = ""
    largest_displacement: Number = None


class ComparedQuantity(Stored):
    """A quantity in runs A and B: its interval in each run, the interval of A - B, and P(A > B).

    `of_prior` names the runs in which the prior alone determines it. `two_modes` is stated for the
    ratio of a law's products: whether the runs are of two modes.
    """

    name: str = ""
    unit: str = ""
    amplitude: Number = None
    a: Ends
    b: Ends
    difference: Ends
    probability: float
    of_prior: list[str] = []
    two_modes: bool = False


class ComparedJoint(Stored):
    """The chi-square test of whether a joint has changed between two runs."""

    joint: str
    chi_square: float
    degrees_of_freedom: int
    p: float
    changed: bool


class RunDifference(Stored):
    """The comparison of two runs."""

    runs: dict[str, ComparedRun]
    laws: list[str]
    parameters: list[ComparedQuantity]
    backbone: list[ComparedQuantity]
    joints: list[ComparedJoint] = []
    statements: list[str] = []


class RunBeside(Stored):
    """One of several runs that are compared side by side."""

    name: str
    folder: str
    campaign: str
    verdict: str
    laws: list[str]
    torque: Number


class ReadingBeside(Stored):
    """A run's frequency [Hz] and damping ratio [%] at one amplitude [m], with 99 % intervals."""

    run: str
    amplitude: float
    frequency: Ends
    damping: Ends = Field(alias="damping ratio")


class TorqueTrend(Stored):
    """The change of a quantity per doubling of the torque; `direction` is empty if unclear."""

    name: str
    unit: str
    amplitude: float
    per_doubling: Ends
    p: float
    direction: str


class RunsSideBySide(Stored):
    """A comparison of several runs, ordered by torque."""

    runs: list[RunBeside]
    readings: list[ReadingBeside]
    trends: list[TorqueTrend]
    statements: list[str] = []
