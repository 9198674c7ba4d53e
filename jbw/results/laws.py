"""The content of `laws.json` as types: laws of the joint compared on one campaign."""

from typing import Any

from pydantic import Field

from jbw.results.stored import ByName, Number, Stored, StoredRow


class StoredLaw(StoredRow):
    """One law: its fit, its scores, its evidence, and its answer compared with the best law.

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
        """The largest error of a kind of test that is predicted from the other kinds."""
        return max((self.error_across or {}).values(), default=None)


class OffsetChange(Stored):
    """Mean and standard deviation of a parameter, with and without offsets of sessions."""

    with_offsets: float = Field(alias="with")
    with_sd: float
    without: float
    without_sd: float


class StoredSharedRuns(Stored):
    """The best law without offsets of the sessions; `error` has both errors, with and without."""

    parameters: dict[str, OffsetChange]
    error: list[float]
    errors: dict[str, float]  # error of every law without offsets


class StoredFreeLaw(Stored):
    """The log evidence of laws from frequency and damping alone, minus the largest one, by law."""

    log_evidence_difference: dict[str, float]


class StoredLaws(Stored):
    """The stored comparison of laws of the joint on one campaign."""

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
        """Return the names of the laws with a given answer, such as worse than the best law."""
        return [name for name, row in self.laws.items() if row.answer == answer]
