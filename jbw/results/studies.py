"""Types for `compare.json` and `sbc.json`: comparisons of samplers, and calibrations of a step."""

from pydantic import Field

from jbw.results.stored import ByName, Number, Stored, StoredRow


class SampledParameter(Stored):
    """One sampler's estimates of a parameter, with Monte Carlo errors and distances z.

    `parameter` and `sampler` name it in a table.
    """

    parameter: str = Field(default="", exclude=True)
    sampler: str = Field(default="", exclude=True)
    mean: Number = None
    sd: Number = None
    mcse_mean: Number = None


class StoredSampler(StoredRow):
    """A sampler's cost, evidence and verdict, with its estimates of each parameter."""

    ess_per_s_cold: Number = None
    ess_per_s_warm: Number = None
    log_evidence: Number = None
    log_evidence_error: Number = None
    verdict: str = ""
    failed: list[str] = []
    parameters: dict[str, SampledParameter] = {}


class StoredSamplers(Stored):
    """A comparison of samplers; `refused` states why each of the other samplers cannot sample."""

    campaign: str = ""
    posterior: str = ""
    parameters: list[str] = []
    reference: str | None = None
    samplers: ByName[StoredSampler] = {}
    refused: dict[str, str] = {}


class StoredCoverage(StoredRow):
    """The uniformity of a quantity's ranks, and the coverage of its 99 % intervals."""

    p_ecdf: float
    p_chi_square: float
    coverage_99: float
    coverage_99_lower: float
    coverage_99_upper: float


class StoredCalibration(Stored):
    """A calibration, by simulation, of one step of the identification."""

    step: str
    sampler: str | None = None
    replications: int
    failed: int
    quantities: ByName[StoredCoverage]
