"""Typed attributes of the groups of `posterior.nc`: of a posterior, and of a predicted test."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Json

from jbw.results.stored import Number, Stored

NAN = float("nan")


class Attributes(Stored):
    """The attributes of a group of `posterior.nc`, as xarray returns them."""

    @classmethod
    def of(cls, group: Any) -> Self:
        """Return the attributes of a dataset or of a group of a tree."""
        return cls.of_mapping(group.attrs)

    @classmethod
    def of_mapping(cls, attrs: Mapping[Any, Any]) -> Self:
        """Return attributes given by name; arrays and NumPy's numbers become plain values."""
        plain = {
            str(name): value.tolist() if hasattr(value, "tolist") else value
            for name, value in attrs.items()
        }
        return cls.read(plain)


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


class DecayConstants(Stored):
    """The constants of the posterior of free decays.

    Attributes:
        worth: Share of the samples that count as independent.
        shift_std: Standard deviation of the frequency shift of a record [rad/s].
        substeps: Steps between samples; 0 for the default.
    """

    worth: float = 1.0
    shift_std: Number = None
    substeps: int = 0


class DrawnPosterior(Attributes):
    """The attributes of a run's posterior: the sampler, and the settings for predictions.

    Attributes:
        sampler: Name of the sampler; empty if an earlier version wrote the run.
        laws: Names of the joint's laws.
        held: Values of fixed parameters.
        tests: Facts about each test of the campaign, by name.
        decay: Constants of the posterior of the free decays.
        lacking: Units without some parameter, in a population.
        points: Additional measured points.
        rivals: Laws that the fitted tests do not exclude, and that may slip fully at larger
            amplitudes; empty if the campaign states its laws.
        scatter: Scatter of omega_n [rad/s] and zeta between runs.
        y_peak: Largest measured displacement [m]; 0 if unknown.
        khat: Shape of the tail of the importance weights.
        ess_weights: Effective sample size of the importance weights.
    """

    sampler: str = ""
    coordinates: str = ""
    num_evaluations: int = 0
    num_samples: int = 0
    laws: Json[tuple[str, ...]] | None = None
    held: Json[dict[str, float]] = {}
    tests: Json[dict[str, dict[str, Any]]] = {}
    decay: Json[DecayConstants] = DecayConstants()
    lacking: Json[tuple[Any, ...]] = ()
    points: Json[tuple[str, ...]] = ()
    rivals: Json[tuple[str, ...]] = ()
    scatter: Annotated[tuple[float, ...], BeforeValidator(_as_list)] = ()
    substeps: int | None = None
    y_peak: float | None = None
    khat: Number = None
    ess_weights: Number = None
    log_evidence: Number = None
    log_evidence_error: Number = None
    quadrature_error: Number = None
    inverse_temperature: Number = None
    budget_spent_s: Number = None
    num_warmup: int | None = None


class StoredVariable(Attributes):
    """The attributes of a variable: unit, meaning, symbol, and prior bounds if it was sampled."""

    units: str = ""
    long_name: str = ""
    symbol: str = ""
    lower: Number = None
    upper: Number = None

    @property
    def bounds(self) -> tuple[float, float] | None:
        """The prior bounds of a sampled parameter; None for any other variable."""
        return None if self.lower is None or self.upper is None else (self.lower, self.upper)


class StoredAssembly(Attributes):
    """The attributes of the joints of an assembly.

    Attributes:
        units: Unit of length of the model.
        holds_joints: Whether the matrices contain the joints' stiffness.
        highest_node: Largest number of a node.
    """

    units: str = ""
    holds_joints: bool = False
    highest_node: int = 0


class StoredErrors(Attributes):
    """The attributes of held-out errors: whether each run has a separate natural frequency."""

    own_frequency: bool = False


class StoredLineFit(Attributes):
    """The attributes of Step 2: pooled natural frequency [rad/s] and damping ratio."""

    pooled_omega_n: Number = None
    pooled_zeta: Number = None


class StoredBackbone(Attributes):
    """The attributes of a backbone; `y_fitted` is the largest fitted displacement [m]."""

    y_fitted: float = NAN


class StoredDiscrepancy(Attributes):
    """The attributes of a model discrepancy.

    Attributes:
        y_low: Smallest fitted displacement [m].
        y_high: Largest fitted displacement [m].
        hidden_in_noise: Whether the discrepancy is not distinguishable from noise.
        noise_by_repeats: Whether repeats determine the noise.
        omega_n: Natural frequency [rad/s].
        zeta: Damping ratio.
        num_runs: Number of fitted runs.
    """

    y_low: float = NAN
    y_high: float = NAN
    hidden_in_noise: bool = False
    noise_by_repeats: bool = True
    omega_n: float = NAN
    zeta: float = NAN
    num_runs: int = 0


class StoredFleet(Attributes):
    """The attributes of a fleet of runs.

    Attributes:
        format: Version of the file's layout.
        laws: Names of the joints' laws.
        units: Unit of each parameter, by name.
        symbols: Symbol of each parameter, by name.
        left_out: Units that do not determine a parameter, by its name.
    """

    format: int = 0
    laws: Json[tuple[str, ...]] = ()
    units: Json[dict[str, str]] = {}
    symbols: Json[dict[str, str]] = {}
    left_out: Json[dict[str, list[str]]] = {}


class PredictedTest(Attributes):
    """The attributes of a test's comparison with its prediction.

    Attributes:
        group: Name of the group of such tests.
        test: Name of the test.
        axis: Name of the coordinate of the values of a further kind of test.
        fitted: Number of fitted records, 0 for a held-out test; None if the run does not state it.
        seen: Whether the shown records were fitted.
        seen_s: Length of the part of a record from which its initial state was estimated [s].
        nrmse: Error of the prediction relative to the measurement.
        nrmse_linear: Error of the best linear oscillator.
        nrmse_cubic: Error of the best oscillator with a cubic spring.
        scatter: Scatter of the test's repeats, relative to their mean.
        discrepancy: Whether the band contains the model discrepancy.
        extrapolation: Largest displacement divided by the largest fitted one.
        withheld: Whether the band was withheld, because the motion is too large for it.
        noise: Source of the assumed noise.
    """

    group: str = ""
    test: str = ""
    kind: str = ""
    response: str = "response"
    quantity: str | None = None
    axis: str = ""
    level: Number = None
    level_unit: str = ""
    fitted: int | None = None
    seen: bool = True
    seen_s: float = 0.0
    tone_hz: Number = None
    nrmse: float = NAN
    nrmse_linear: float = NAN
    nrmse_cubic: float = NAN
    scatter: float = NAN
    coverage: float = NAN
    half_width: float = NAN
    num_values: float = 0.0
    discrepancy: float = NAN
    extrapolation: Number = None
    withheld: bool = False
    noise: str = ""

    @property
    def is_fitted(self) -> bool:
        """Whether the test was fitted; True for runs that do not state it."""
        return self.fitted is None or self.fitted > 0
