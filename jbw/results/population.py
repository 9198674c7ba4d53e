"""Types for `population.json`: what the joints of a fleet have in common and how they vary."""

from typing import Any

from jbw.results.stored import ByName, Number, Stored, StoredRow


class StoredInterval(Stored):
    """A median and the ends of a 99 % interval."""

    median: float
    q005: float
    q995: float

    @property
    def holds_zero(self) -> bool:
        """Whether the interval contains zero."""
        return self.q005 <= 0.0 <= self.q995


class StoredCoordinate(StoredRow):
    """A quantity of a fleet's joints: mean, variation of units and runs, and trends."""

    unit: str = "1"
    symbol: str = ""
    mean: StoredInterval | None = None
    scatter: StoredInterval | None = None
    run_scatter: Number = None
    slope_torque: StoredInterval | None = None
    slope_sequence: StoredInterval | None = None
    own_over_scatter: float = 0.0


class StoredSampling(Stored):
    """Diagnostics of the sampler."""

    r_hat: float = 1.0
    divergences: int = 0
    num_draws: int = 0


class StoredPopulation(Stored):
    """The variation of the joints between several units, and their dependence on torque.

    `belongs` is each unit's p-value of belonging to the others; `weighed` the Kish share of the
    draws of each unit that is represented by its draws.
    """

    units: list[str] = []
    torque: list[Number] = []
    columns: list[str] = []
    correlation: Number = None
    saturating: list[str] = []
    reference_torque: Number = None
    parameters: ByName[StoredCoordinate] = {}
    ratios: dict[str, StoredInterval] = {}
    belongs: dict[str, float] = {}
    weighed: dict[str, float] = {}
    failed: list[str] = []
    no_logarithm: dict[str, list[str]] = {}
    sampling: StoredSampling = StoredSampling()
    saturation_torque: StoredInterval | None = None
    status: str = ""
    statements: list[str] = []
    new_unit: dict[str, Any] = {}  # torque of the new unit; then an interval for each quantity

    @property
    def has_trend(self) -> bool:
        """Whether the population's model lets any quantity depend on torque."""
        return "torque" in self.columns
