"""Types for `laws.json`: the laws of the joint that were compared on one campaign."""

from typing import Any

from pydantic import Field

from jbw.results.stored import ByName, Number, Stored, StoredRow


class StoredLaw(StoredRow):
    """One compared law: its fit, scores and evidence, and how it compares with the best law.

    `error_left_out` is that of left-out runs; `elpd_doubt` is the possible error of the log score
    [nats]; `hopeless` laws are judged by their fits alone.
    """

    laws: list[str] = []
    meet: str | None = None
    num_parameters: int = 0
    error: float = 0.0
    error_left_out: Number = None
    error_highest: Number = None
    error_across: dict[str, float] | None = None
    elpd: Number = None
    khat: Number = None
    elpd_doubt: Number = None
    log_likelihood: float = 0.0
    hopeless: bool = False
    log_evidence: Number = None
    log_evidence_error: Number = None
    log_evidence_wide: Number = None
    khat_evidence: Number = None
    at_bound: list[str] = []
    widened: list[str] = []
    reached: list[str] = []
    parameters: dict[str, Any] = {}
    elpd_difference: Number = None
    elpd_difference_se: Number = None
    weight: Number = None
    log_evidence_difference: Number = None
    answer: str = ""
    error_held_out: Number = None
    error_beyond: Number = None

    @property
    def error_of_worst_kind(self) -> Number:
        """The largest error among kinds of test, each predicted from a fit to the other kinds."""
        return max((self.error_across or {}).values(), default=None)


class OffsetChange(Stored):
    """A parameter's mean and standard deviation, estimated with and without offsets of sessions."""

    with_offsets: float = Field(alias="with")
    with_sd: float
    without: float
    without_sd: float


class StoredSharedRuns(Stored):
    """The best law, fitted with offsets of sessions and without; `error` has both errors."""

    parameters: dict[str, OffsetChange]
    error: list[float]
    errors: dict[str, float]  # error of each law, fitted without offsets


class StoredFreeLaw(Stored):
    """Log evidence of each law from frequency and damping alone, relative to the largest value."""

    log_evidence_difference: dict[str, float]


class StoredLaws(Stored):
    """A stored comparison of the joint's laws on one campaign."""

    campaign: str = ""
    diagnosis: dict[str, Any] | None = None
    runs: list[str] = []
    highest: str | None = None
    floor: Number = None
    line: Number = None
    lines: dict[str, float] = {}
    laws: ByName[StoredLaw] = {}
    refused: dict[str, str] = {}
    shared_runs: StoredSharedRuns | None = None
    free_law: StoredFreeLaw | None = None
    gap_sliders: Any = None
    statements: list[str] = []

    def answered(self, answer: str) -> list[str]:
        """Return the names of the laws with a given answer, such as "worse than the best law"."""
        return [name for name, row in self.laws.items() if row.answer == answer]
