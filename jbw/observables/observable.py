"""What a kind of test is to a likelihood: one protocol, one file and one class a kind.

What all share is in `jbw.observables.dataset`, which knows no kind. A new kind of test that is
measured repeatedly is `reduce` and `predict` alone, by `jbw.observables.repeated`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Key

from jbw.inference.groups.offsets import Estimate
from jbw.measurement.records import OF, Test
from jbw.measurement.resonances import AmplitudeCurve
from jbw.observables.decay_drift import LeftOutDecay
from jbw.observables.spectra import Spectrum
from jbw.quantities import DEFAULT_LAWS

OFFSETS = ("omega_n", "zeta")  # of a run, where it has its own
SILENT = 1e-12  # of the values of a group that counts for nothing
EXCLUDED = 1e6  # times its noise: a group that says nothing any more, and keeps its shape

Theta = Mapping[str, Array]
Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]
Rows = Mapping[str, Row]  # by the groups' labels
Weighted = tuple[Float[Array, "group value"], Float[Array, "group own value"]]
Covariance = Float[np.ndarray, "parameter parameter"]
Draws = Float[np.ndarray, "chain draw"]
Drawn = Mapping[str, Float[np.ndarray, "..."]]  # parameters by name, and what was held
Laws = tuple[str, ...]


class SteadyLines(NamedTuple):
    """First harmonics of load and displacement [m] at frequencies [rad/s]; at 0 of a slow loop."""

    omega: Float[np.ndarray, " line"]
    load: Complex[np.ndarray, " line"]
    motion: Complex[np.ndarray, " line"]


def _nothing() -> None:
    """Return None: the data do not show it."""


class Shown(NamedTuple):
    """What data show without a model: starting values of fits, scales of priors, axes of figures.

    What costs, or may fail, is a function without arguments.

    Attributes:
        first_values: Starting values of omega_n [rad/s], zeta [-] and gain; those that are known.
        steady_lines: Steady motion whose load was measured; one line is too little for a start.
        amplitude_curve: Frequency and damping against amplitude.
        amplitude_readings: Frequency and damping, too coarse to start a fit from: a point a level.
        stiffness: Force over prescribed displacement [N/m]; None where it was not prescribed.
        gain_std: Standard deviation of the starting value of the gain; infinite if not known.
        y_peak: Largest displacement [m], of noise its rms; 0 where it was not measured.
        begins: Displacement that each free decay begins with [m], by run.
        peaks_of_modes: Largest displacement [m] about each of several modes, where measured.
    """

    first_values: Callable[[], dict[str, float]] = dict
    steady_lines: Callable[[], SteadyLines | None] = _nothing
    amplitude_curve: Callable[[], AmplitudeCurve | None] = _nothing
    amplitude_readings: Callable[[], AmplitudeCurve | None] = _nothing
    stiffness: Callable[[], float | None] = _nothing
    gain_std: float = float("inf")
    y_peak: float = 0.0
    begins: Mapping[str, float] = {}
    peaks_of_modes: tuple[float, ...] = ()


class Numbers(NamedTuple):
    """Numbers that stand for the names of groups and of runs: equal ones for equal names."""

    labels: Mapping[str, str]
    runs: Mapping[str, str]


class Observable(eqx.Module):
    """Reduced data of one kind of test, with what a likelihood asks of it.

    Groups are what has one label, one run and one noise: a test, one harmonic of it, a record.
    Every subclass has `reduce`, `labels`, `runs`, `width`, `predict`, `weighted` and `estimate`,
    and overrides of the rest what it knows.

    Attributes:
        kinds: Kinds of tests that `reduce` takes.
        suffix: Of the variable of its noise in a posterior, `noise_std` and this.
        dimension: Of that variable.
        informs: What of omega_n, zeta and gain the data can tell.
        stepped: Whether a prediction steps through time, and costs accordingly.
        is_linear: Whether its first values were read where the joint hardly slips.
        is_prescribed: Whether its displacement is prescribed, so that a force is measured [N] and
            nothing moves freely.
        own_shifts: Whether its records shift on their own account, integrated out here, so that
            they take no part in the offsets of runs.
        several: Whether it takes tests of several modes (True), of one (False) or of either (None).
        most_misfit: What a fit may leave of a group, over the group; None for anything.
        laws: Names of the laws of the joint; static.
        residuals: Which residual terms its prediction takes, of those that theta has: none, upper,
            both, auto or own; static. None where nothing drives the motion.
        drive: What drives it, one of `DRIVES`; static. Empty where that does not matter.
        modes: Modes of the structure that meet in the joint, as a campaign states them
            (`jbw.observables.modes`); static. None of one mode.
    """

    kinds: ClassVar[tuple[str, ...]] = ()
    suffix: ClassVar[str] = ""
    dimension: ClassVar[str] = ""
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n", "zeta", "gain"})
    stepped: ClassVar[bool] = False
    is_linear: ClassVar[bool] = False
    is_prescribed: ClassVar[bool] = False
    own_shifts: ClassVar[bool] = False
    several: ClassVar[bool | None] = None
    most_misfit: ClassVar[float | None] = None

    laws: Laws = eqx.field(static=True, kw_only=True, default=DEFAULT_LAWS)
    residuals: str = eqx.field(static=True, kw_only=True, default="none")
    drive: str = eqx.field(static=True, kw_only=True, default="")
    modes: Any = eqx.field(static=True, kw_only=True, default=None)

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple[Self, ...]:
        """Sufficient statistics of tests of its kinds, in as many parts as their forms ask for.

        `substeps` are those of the solver between samples; None for its own.
        """
        raise NotImplementedError

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each group, no two alike."""
        raise NotImplementedError

    @property
    def runs(self) -> tuple[str, ...]:
        """Name of the run of each group."""
        raise NotImplementedError

    @property
    def width(self) -> int:
        """Values of a group's row, those that fill it up included."""
        raise NotImplementedError

    @property
    def unit(self) -> str:
        """Unit of the values; empty where groups differ, or where a kind does not say it."""
        return ""

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of the values of each group."""
        return (self.unit,) * len(self.labels)

    def unnamed(self, numbers: "Numbers") -> Self:
        """The data as programs see them: their groups and runs have `numbers` for names.

        Nor has it words, or numbers that no program reads but is compiled for.
        """
        modes = self.modes
        return self if modes is None else replace(self, modes=modes._replace(numbers=()))

    def predict(self, theta: Theta) -> Any:
        """What the parameters predict, a row a group, in the unit of the measured values."""
        raise NotImplementedError

    def weighted(self, theta: Theta) -> Weighted:
        """Residuals of every group, and directions of its run's offsets, in standard errors."""
        raise NotImplementedError

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """What every group says of the offsets of its run, its noise integrated out."""
        raise NotImplementedError

    def scatter_terms(self, theta: Theta, found: Estimate) -> Float[Array, " term"]:
        """Terms of the log likelihood besides those of `estimate`, where runs have no offsets."""
        return jnp.zeros(0)

    def residual(self, theta: Theta) -> Weighted:
        """Every group's mean less its prediction, and this one's change by the run's offsets."""
        raise NotImplementedError

    def residual_sums(
        self,
        theta: Theta,
        rows: Float[Array, "group row value"],
        offset: Float[Array, "group own"] | None = None,
    ) -> tuple[Float[Array, " group"], Float[Array, "group row"]]:
        """Squares of the misfit of every group at the offsets of its run, and its products.

        Args:
            theta: The parameters.
            rows: What the misfit of every group is multiplied with.
            offset: Offsets of each group's run; None for none.
        """
        misfit, directions = self.residual(theta)
        if offset is not None and directions.shape[1]:
            misfit = misfit - jnp.einsum("gi,gin->gn", offset, directions)
        return jnp.sum(misfit**2, axis=-1), jnp.einsum("grn,gn->gr", rows, misfit)

    def measured_rows(self) -> Float[Array, "group value"] | None:
        """Every group's mean as `residual` takes it; None where it was read off a mean before."""
        return None

    def in_units(self, rows: Mapping[str, Float[np.ndarray, " value"]]) -> dict[str, Row]:
        """Rows by label, or derivatives, in the values' unit, of groups that a fit is judged by."""
        return {}

    def spectra(self, residuals: Rows) -> dict[str, Spectrum]:
        """Groups of `in_units` whose misfit can be tried against its usual causes, by label."""
        return {}

    def sizes(self) -> dict[str, float]:
        """Root of the sum of squares of the mean of each group, of those of `in_units`."""
        return {}

    def repeatability(self) -> dict[str, float]:
        """Scatter of single repeats of each group, over the size of their mean; by label."""
        return {}

    def mean_repeatability(self) -> dict[str, float]:
        """Scatter of the mean of the repeats of each group, over the size of that; by label."""
        return {}

    def noise_known(self) -> dict[str, float]:
        """Number of values of each group whose noise the repeats tell, by label."""
        return {}

    def solved(
        self,
        theta: Mapping[str, Float[np.ndarray, " point"]],
        threads: int,
        *,
        writes: bool,
        rows: Float[np.ndarray, "group row value"] | None = None,
    ) -> Self | None:
        """The data that hold what costs most of a prediction at points; None where nothing does.

        Args:
            theta: The parameters at points.
            threads: So many at once.
            writes: Whether the misfit itself is asked for, and not its sums alone.
            rows: What `residual_sums` will be asked for, beside the directions.
        """
        return None

    def linearised(
        self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]
    ) -> "Observable":
        """The data with the change of every prediction by its run's offsets, about those known."""
        return self

    def with_discrepancy(self, residuals: Rows) -> "Observable":
        """The data with what the law is expected to leave of them, by what a fit leaves."""
        return self

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> "Observable":
        """The data with the noise of every group that a fit leaves, by `in_units`."""
        return self

    def effective_fractions(
        self, residuals: Rows, columns: Sequence[Rows], covariance: Covariance
    ) -> dict[str, float]:
        """Fraction of independent values where below one, by what a fit leaves; by label."""
        return {}

    def with_effective_values(self, fractions: Mapping[str, float]) -> "Observable":
        """The data that count for as many values as are independent, all where not named."""
        return self

    def fractions_counted(self) -> dict[str, float]:
        """Fraction of the values of each group that the likelihood counts."""
        return {}

    def without(self, run: str) -> "Observable":
        """The data with one run's groups excluded, of the same shapes."""
        return self

    def silenced(self, run: str) -> "Observable":
        """The data in which one run counts for nothing, in the likelihood too."""
        return self

    def draw_noise(
        self, key: Key[Array, ""], theta: Drawn, terms: Mapping[str, Draws], num_offsets: int
    ) -> dict[str, Draws]:
        """One draw of each group's noise for every draw of theta and its likelihood's terms."""
        return {}

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return what the data show without a model, by omega_n [rad/s] where that is asked for."""
        return Shown()

    def drift(self, theta: Theta, run: str) -> LeftOutDecay | None:
        """How a free decay drifts from its prediction by its beginning; None of other kinds."""
        return None

    def evenly(self) -> "Observable | None":
        """The data with every group counted by its relative error; None where meaningless."""
        return None

    def halved(self) -> "Observable | None":
        """The data with twice as many steps of the solver; None where nothing is stepped."""
        return None

    def remembering(self, theta: Theta) -> "Observable":
        """The data with as much memory of the laws as the motion at a point asks for."""
        return self

    def statements(self, theta: Theta) -> list[str]:
        """What is to be said of the data at the optimum, a sentence each."""
        return []


def numbers_of(labels: Sequence[str], runs: Sequence[str]) -> Numbers:
    """Numbers in the order in which names come, those of runs behind those of their assemblies."""
    owners = {run: run.partition(OF)[0] for run in runs}
    number_of = {owner: f"#{i}" for i, owner in enumerate(dict.fromkeys(owners.values()))}
    by_run = {
        run: number_of[owner] + (f"{OF}{i}" if OF in run else "")
        for i, (run, owner) in enumerate(owners.items())
    }
    return Numbers({label: f"#{i}" for i, label in enumerate(dict.fromkeys(labels))}, by_run)


def alone(data: Any) -> Any:
    """Data of one observable as programs see them, of which nothing else has the names."""
    return data.unnamed(numbers_of(data.labels, data.runs))


def prediction(theta: Theta, data: Observable) -> Any:
    """What the parameters predict of data, as a function that compiled code may be kept for."""
    return data.predict(theta)


@eqx.filter_jit
def slope_by_offsets(predict: Callable[[Theta], Array], theta: Theta) -> Float[Array, "*row own"]:
    """Derivative of a prediction by the offsets of omega_n and zeta, along a last axis."""

    def shifted(offset: Float[Array, " own"]) -> Array:
        shifted_theta = {name: theta[name] + b for name, b in zip(OFFSETS, offset, strict=True)}
        return predict({**theta, **shifted_theta})

    return jax.jacfwd(shifted)(jnp.zeros(len(OFFSETS)))


def assemblies_of(runs: tuple[str, ...]) -> tuple[int, ...]:
    """Number of each run's assembly; nothing unless there are several, one with several runs."""
    owners = [run.partition(OF)[0] for run in runs]
    order = list(dict.fromkeys(owners))
    if not 1 < len(order) < len(runs):
        return ()
    return tuple(order.index(owner) for owner in owners)
