"""Types for a run's `summary.json`, one for each concept of the summary.

A run is read into these types once, and every reader takes attributes. A field that a file lacks
has its default; an entry without a field is kept. What was read is therefore written unchanged.
"""

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from jbw.results.stored import ByName, Number, Stored, StoredRow


class StoredBand(Stored):
    """A median and the ends of a 99 % interval."""

    low: Number = Field(default=None, alias="0.005")
    median: Number = Field(default=None, alias="0.5")
    high: Number = Field(default=None, alias="0.995")


# -- verdict ---------------------------------------------------------------------------------------
class StoredFinding(Stored):
    """The result of one check; `of` names the parameter concerned."""

    code: str = ""
    status: str = ""
    reason: str = ""
    number: Number = None
    action: str = ""
    of: str = ""


class StoredAnswer(Stored):
    """The verdict's answer to one question, such as whether the sampler has converged.

    `word` is the status, or the grade of a graded law; `because` are facts of the findings that are
    not ok, or of the first one if all are ok, then the additions of later checks, each once.
    """

    question: str = ""
    status: str = ""
    word: str = ""
    because: str = ""


class StoredVerdict(Stored):
    """A verdict; its status is empty if nothing was judged."""

    status: str = ""
    answers: dict[str, StoredAnswer] = {}
    findings: list[StoredFinding] = []

    @property
    def against(self) -> list[StoredFinding]:
        """The findings that weaken the result: those whose status is not "ok"."""
        return [finding for finding in self.findings if finding.status != "ok"]

    def answer(self, name: str) -> str:
        """Return the status of the answer to a named question; empty if there is no answer."""
        return self.answers[name].status if name in self.answers else ""


# -- posterior -------------------------------------------------------------------------------------
class StoredParameter(StoredRow):
    """Numbers of a parameter's posterior, in SI; `suffix` extends its symbol in tables."""

    map: Number = None
    mean: Number = None
    sd: Number = None
    cv: Number = None
    q005: Number = None
    q995: Number = None
    kl: Number = None
    contraction: Number = None
    ess_bulk: Number = None
    ess_tail: Number = None
    r_hat: Number = None
    unit: str = ""
    truth: Number = None
    z: Number = None
    suffix: str = Field(default="", exclude=True)

    @property
    def variation(self) -> float:
        """The absolute value of the coefficient of variation; infinite if it is unknown."""
        return float("inf") if self.cv is None else abs(self.cv)


class StoredStep(Stored):
    """A step of the identification."""

    verdict: StoredVerdict = StoredVerdict()
    parameters: ByName[StoredParameter] = {}
    statements: list[str] = []
    correlation: Mapping[str, Mapping[str, Number]] = {}
    runs: dict[str, Any] = {}
    wall_time_s: Number = None

    def known(self, what: str) -> list[float]:
        """Return one number, such as `ess_bulk`, for every parameter for which it is known."""
        numbers = (getattr(row, what) for row in self.parameters.values())
        return [number for number in numbers if number is not None]


class StoredMoments(Stored):
    """A parameter's mean and standard deviation from one procedure."""

    mean: Number = None
    sd: Number = None


class StoredRoutes(StoredRow):
    """Two estimates of a parameter: Teloli's sequential steps (`cut`) and the joint posterior."""

    cut: StoredMoments = StoredMoments()
    joint: StoredMoments = StoredMoments()
    sd_ratio: Number = None
    difference: Number = None


class StoredComparison(Stored):
    """The comparison of Teloli's sequential steps with the posterior of all parameters together."""

    parameters: ByName[StoredRoutes] = {}
    statements: list[str] = []


# -- tests -----------------------------------------------------------------------------------------
class StoredTest(Stored):
    """A test: how it was measured, how it was used, and how well it was predicted.

    `is_record` marks a record of a test that has a separate prediction.
    """

    test: str = ""
    kind: str = ""
    level: Number = None
    level_unit: str = ""
    run: str | None = None
    assembly: str | None = None
    repeats: int | None = None
    fitted: bool | int | None = None  # number of fitted repeats, or whether any repeat was fitted
    fitted_repeats: list[int] | None = None
    coverage: Number = None
    num_values: Number = None
    nrmse: Number = None
    nrmse_own_frequency: Number = None
    half_width: Number = None
    nrmse_linear: Number = None
    nrmse_cubic: Number = None
    extrapolation: Number = None
    y_peak: dict[str, float] | None = None  # largest displacement by quantile [m]
    # whether the displacement exceeds the range in which predictions are trusted
    beyond: bool = False
    withheld: bool = False
    is_record: bool = Field(default=False, exclude=True)
    rests_on: list[str] = Field(default=[], exclude=True)

    @property
    def stated(self) -> dict[str, Any]:
        """The fields that the file states, with their values."""
        return {name: getattr(self, name) for name in self.model_fields_set}


class StoredKind(Stored):
    """The prediction of one kind of test from a fit to the other kinds."""

    error: Number = None
    fitted: Number = None
    rests_on: list[str] = []


class StoredUnscored(Stored):
    """Reasons why errors for other levels or other kinds of test are unknown; empty if known."""

    levels: str = ""
    kind: str = ""


class HeldOutAnswer(Stored):
    """The result of a first fit without held-out tests, if a second fit uses all tests."""

    verdict: str = ""
    predictions: dict[str, StoredTest] = {}
    parameters: ByName[StoredParameter] = {}


# -- readings without a model ----------------------------------------------------------------------
class StoredCycle(Stored):
    """A cycle of a force loop; `test` and the cycle's number `cycle` identify it in a table."""

    test: str = Field(default="", exclude=True)
    cycle: int = Field(default=0, exclude=True)
    amplitude: Number = None
    stiffness: Number = None
    work: Number = None
    damping: Number = None
    retained: Number = None
    repeated: bool = False


class StoredLoop(Stored):
    """The force loops of a test: their secant stiffness at the largest motion, and their cycles."""

    test: str = ""
    y: float = 0.0
    stiffness: float = 0.0
    unit: str = "m"  # unit of the motion
    cycles: list[StoredCycle] = []


class StoredReading(Stored):
    """A test's frequency and damping at its largest motion, without a model of the joint."""

    test: str = ""
    kind: str = ""
    drive: str | None = None
    level: Number = None
    records: int = 0
    run: str | None = None
    assembly: str | None = None
    y: float = 0.0
    frequency_hz: Number = None
    damping: Number = None
    left: Number = None
    third: Number = None
    frequency_sd: Number = None
    damping_sd: Number = None
    y_min: Number = None
    y_max: Number = None
    noise: Number = None
    coherence: Number = None


class StoredLook(Stored):
    """Frequency and damping of all records, measured without a model of the joint."""

    campaign: str = ""
    tests: list[StoredReading] = []
    loops: list[StoredLoop] = []
    unread: dict[str, str] = {}
    seen: list[str] = []
    statements: list[str] = []
    laws: list[str] = []


# -- several joints --------------------------------------------------------------------------------
class StoredMode(Stored):
    """The effect of all joints on one mode at the largest fitted motion."""

    mode: int = 0
    frequency_hz: Number = None
    shape: str = ""
    frequency_change: StoredBand = StoredBand()
    damping_added: StoredBand = StoredBand()


class StoredJoint(Stored):
    """A joint's share of the energy loss of each mode."""

    joint: str = ""
    verdict: str = ""
    loss_share: list[StoredBand | None] = []


class StoredTie(Stored):
    """The evidence for a law that all joints share, compared with separate laws."""

    laws: list[str] = []
    log_evidence_ratio: float = 0.0
    khat: float = 0.0
    is_bound: bool = False
    is_trusted: bool = False
    answer: str = ""


class StoredJoints(Stored):
    """The effects of several joints on the modes."""

    modes: list[StoredMode] = []
    joints: list[StoredJoint] = []
    tied: StoredTie | None = None


# -- identifiability -------------------------------------------------------------------------------
class StoredDirection(Stored):
    """A combination of parameters, and the factor by which the data narrow its prior."""

    combination: str = ""
    information: Number = None
    ratio: Number = None


class StoredPrecision(StoredRow):
    """The precision of a parameter or combination of parameters, estimated from the fit."""

    text: str = ""
    value: Number = None
    sd: Number = None
    relative: Number = None
    ratio: Number = None


class StoredShift(Stored):
    """The shift of a posterior mean if a bound of the prior is moved, in standard deviations."""

    shift: Number = None
    box: str = ""
    end: str = ""


class StoredProfile(Stored):
    """A profile likelihood's 99 % interval; `open` states which of its ends are not determined."""

    interval: list[float] = [0.0, 0.0]
    open: list[bool] = [True, True]


class StoredWaterfall(Stored):
    """The final costs of a fit from different starting points."""

    costs: list[Number] = []


class StoredIdentifiability(Stored):
    """The accuracy with which the data determine parameters and combinations of parameters."""

    statements: list[str] = []
    spectrum: list[StoredDirection] = []
    parameters: ByName[StoredPrecision] = {}
    combinations: ByName[StoredPrecision] = {}
    contraction: dict[str, Number] = {}
    box_sensitivity: dict[str, StoredShift] = {}
    profiles: dict[str, StoredProfile] = {}
    waterfall: StoredWaterfall = StoredWaterfall()


# -- the run ---------------------------------------------------------------------------------------
class RunSummary(Stored):
    """The content of `summary.json`."""

    campaign: str = ""
    verdict: StoredVerdict = StoredVerdict()
    main: str = ""
    steps: dict[str, StoredStep] = {}
    comparison: StoredComparison = StoredComparison()
    # rows of tests; None for runs of versions that stored no tests
    tests: list[StoredTest] | None = None
    predictions: dict[str, StoredTest] = {}
    across_kinds: dict[str, StoredKind] = {}
    unscored: StoredUnscored = StoredUnscored()
    loops: dict[str, Any] = {}
    joints: StoredJoints | None = None
    motion_unit: str = ""
    versions: dict[str, str] = {}
    sources: str = ""
    seed: int | None = None
    inputs: dict[str, str] = {}
    # values stated in the campaign: torque [N m], sequence, temperature
    assembly: dict[str, Any] = {}
    command: str = ""
    wall_time_s: Number = None
    look: StoredLook = StoredLook()
    quick: dict[str, float] | None = None  # errors of a fit without posterior draws, by data group
    exceeds_noise: bool = False  # whether the residual of a fit without posterior draws does
    opening: list[str] = []
    identifiability: StoredIdentifiability = StoredIdentifiability()
    held_out_answer: HeldOutAnswer = HeldOutAnswer()
    doubts: list[str] = []
    campaign_file: str | None = None
    campaign_sha256: str = ""

    @property
    def main_step(self) -> StoredStep:
        """The step with the main posterior; an empty step if the file has none."""
        return self.steps.get(self.main, StoredStep())

    @property
    def parameters(self) -> dict[str, StoredParameter]:
        """The parameters of the main posterior, by name."""
        return self.main_step.parameters
