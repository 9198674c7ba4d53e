"""The interface of a kind of test to a likelihood: one class of few methods on a group table.

What all kinds share reads the columns of that table (`jbw.observables.groups`, `noise`), or is in
`jbw.observables.dataset`, which knows no kind. `reduce` and `predict` are a kind of test that is
measured repeatedly.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.inference.groups.offsets import Estimate, estimate, known_estimate
from jbw.measurement.records import OF, Test
from jbw.measurement.resonances import AmplitudeCurve
from jbw.observables.groups import (
    Groups,
    Rows,
    beside_own,
    changed,
    weights,
    with_fitted_noise,
    with_slope,
)
from jbw.observables.spectra import Spectrum
from jbw.quantities import DEFAULT_LAWS

OFFSETS = ("omega_n", "zeta")  # of a run, where it has its own

Theta = Mapping[str, Array]
Weighted = tuple[Float[Array, "group value"], Float[Array, "group own value"]]
Laws = tuple[str, ...]
Names = Mapping[str, str]  # what programs call a group or a run, by its name


class SteadyLines(NamedTuple):
    """First harmonics of load and displacement [m] at frequencies [rad/s]; at 0 of a slow loop."""

    omega: Float[np.ndarray, " line"]
    load: Complex[np.ndarray, " line"]
    motion: Complex[np.ndarray, " line"]


def _nothing() -> None:
    """Return None: the data do not show it."""


def _no_spectra(residuals: Rows) -> dict[str, Spectrum]:
    """Return no spectrum: the data have none."""
    return {}


class Shown(NamedTuple):
    """The model-free facts of data: starting values of fits, scales of priors, axes of figures.

    What costs, or may fail, is a function without arguments.

    Attributes:
        first_values: Starting values of omega_n [rad/s], zeta [-] and gain; those that are known.
        steady_lines: Steady motion whose load was measured; one line is too little for a start.
        amplitude_curve: Frequency and damping against amplitude.
        amplitude_readings: Frequency and damping, too coarse to start a fit from: a point a level.
        stiffness: Force over prescribed displacement [N/m]; None where it was not prescribed.
        gain_std: Standard deviation of the starting value of the gain; infinite if not known.
        y_peak: Largest displacement [m], in noise that of 99 % of its peaks; 0 if not measured.
        begins: Displacement that each free decay begins with [m], by run.
        peaks_of_modes: Largest displacement [m] about each of several modes, where measured.
        axis: Name and unit of what values stand over in figures.
        places: Where the compared values of each group stand on it; None for their numbers.
        spreads: Noise of every compared value over that of its group; None for one.
        references: What the errors of every compared value are relative to, in its unit; None for
            the root mean square of its group.
        spectra: What residuals by label are tried against usual causes by; a spectrum a label.
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
    axis: tuple[str, str] = ("number", "1")
    places: Sequence[Float[np.ndarray, " value"]] | None = None
    spreads: Sequence[Float[np.ndarray, " value"]] | None = None
    references: Sequence[Float[np.ndarray, " value"]] | None = None
    spectra: Callable[[Rows], dict[str, Spectrum]] = _no_spectra


class Observable(eqx.Module):
    """Reduced data of one kind of test, with what a likelihood asks of it.

    `reduce` and `predict` are required. All else has a body that serves a mean of repeats less its
    prediction; functions of `groups` and `noise` read the columns of the table `groups`.

    Attributes:
        kinds: Kinds of tests that `reduce` takes.
        suffix: Of the variable of its noise in a posterior, `noise_std` and this.
        dimension: Of that variable; empty where its noise is no variable.
        informs: What of omega_n, zeta and gain the data can tell.
        stepped: Whether a prediction steps through time, and costs accordingly.
        is_linear: Whether its first values were read where the joint hardly slips.
        is_prescribed: Whether its displacement is prescribed, so that a force is measured [N] and
            nothing moves freely.
        own_shifts: Whether its records shift on their own account, integrated out here, so that
            they take no part in the offsets of runs.
        moved_by_runs: Whether offsets of runs change its prediction.
        several: Whether it takes tests of several modes (True), of one (False) or of either (None).
        most_misfit: What a fit may leave of a group, over the group; None for anything.
        unread: Fields that no program reads, with the values that programs see.
        reads_hz: Whether programs read the stated frequencies of the modes.
        mean: Mean of the repeats of every group, as `predict` predicts it.
        groups: The table of groups.
        laws: Names of the laws of the joint; static as all below.
        residuals: Which residual terms its prediction takes, of those that theta has: none, upper,
            both, auto or own. None where nothing drives the motion.
        drive: What drives it, one of `DRIVES`. Empty where that does not matter.
        modes: Modes of the structure that meet in the joint, as a campaign states them
            (`jbw.observables.modes`). None of one mode.
        substeps: Steps of the solver between samples; None where time is not stepped.
        depth: Reversals that laws of Masing's kind remember in time; None where they need not.
    """

    kinds: ClassVar[tuple[str, ...]] = ()
    suffix: ClassVar[str] = ""
    dimension: ClassVar[str] = ""
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n", "zeta", "gain"})
    stepped: ClassVar[bool] = False
    is_linear: ClassVar[bool] = False
    is_prescribed: ClassVar[bool] = False
    own_shifts: ClassVar[bool] = False
    moved_by_runs: ClassVar[bool] = True
    several: ClassVar[bool | None] = None
    most_misfit: ClassVar[float | None] = None
    unread: ClassVar[Mapping[str, Any]] = {}
    reads_hz: ClassVar[bool] = True

    mean: Array = eqx.field(kw_only=True)
    groups: Groups = eqx.field(kw_only=True)
    laws: Laws = eqx.field(static=True, kw_only=True, default=DEFAULT_LAWS)
    residuals: str = eqx.field(static=True, kw_only=True, default="none")
    drive: str = eqx.field(static=True, kw_only=True, default="")
    modes: Any = eqx.field(static=True, kw_only=True, default=None)
    substeps: Any = eqx.field(static=True, kw_only=True, default=None)
    depth: Any = eqx.field(static=True, kw_only=True, default=None)

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple[Self, ...]:
        """Return sufficient statistics of tests, in as many parts as their forms ask for.

        `substeps` are those of the solver between samples; None for its own.
        """
        raise NotImplementedError

    def predict(self, theta: Theta) -> Any:
        """Return what the parameters predict, a row a group, in the unit of the measured values."""
        raise NotImplementedError

    def compared(self, values: Any) -> Float[Array, "group value"]:
        """Return values as they are compared: real parts, then imaginary parts; 0 for no value."""
        if self.groups.counted is not None:
            values = self.groups.counted * values
        if not jnp.iscomplexobj(values):
            return values
        return jnp.concatenate([values.real, values.imag], axis=1)

    def misfit(self, theta: Theta) -> Float[Array, "group value"]:
        """Return means less predictions as they are compared."""
        return self.compared(self.mean - self.predict(theta))

    def weighted(self, theta: Theta) -> Weighted:
        """Return residuals, and directions of the run's offsets, in standard errors of a mean."""
        weight = weights(self.groups)
        residual = weight[:, None] * beside_own(self.misfit(theta), self.groups)
        return residual, weight[:, None, None] * self.groups.directions

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """Return what each group says of its run's offsets, its noise integrated out."""
        groups = self.groups
        scatter = groups.within + groups.size * groups.num_repeats * groups.discrepancy
        square, along = self.residual_sums(theta)
        counts = groups.num_repeats, groups.num_values
        return estimate(square, along, scatter, *counts, groups.directions)

    def residual_sums(
        self,
        theta: Theta,
        rows: Float[Array, "group row value"] | None = None,
        offset: Float[Array, "group own"] | None = None,
    ) -> tuple[Float[Array, " group"], Float[Array, "group row"]]:
        """Return squares of the residual of every group, and its products with rows.

        Args:
            theta: The parameters.
            rows: What the residual of every group is multiplied with; None for the directions.
            offset: Offsets of each group's run; None for none.
        """
        residual, directions = beside_own(self.misfit(theta), self.groups), self.groups.directions
        if offset is not None and directions.shape[1]:
            residual = residual - jnp.einsum("gi,gin->gn", offset, directions)
        rows = directions if rows is None else rows
        return jnp.sum(residual**2, axis=-1), jnp.einsum("grn,gn->gr", rows, residual)

    def solved(
        self,
        theta: Mapping[str, Float[np.ndarray, " point"]],
        threads: int,
        *,
        writes: bool,
        rows: Float[np.ndarray, "group row value"] | None = None,
    ) -> Self | None:
        """Return data that hold what costs most of a prediction at points; None if nothing does.

        Args:
            theta: The parameters at points.
            threads: So many at once.
            writes: Whether the misfit itself is asked for, and not its sums alone.
            rows: What `residual_sums` will be asked for, beside the directions.
        """
        return None

    def linearised(self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]) -> Self:
        """Return data with the change of every prediction by its run's offsets, about known."""
        none = np.zeros((len(self.groups.labels), len(OFFSETS), self.groups.width))
        if not self.moved_by_runs:
            return replace(self, groups=changed(self.groups, directions=none))
        bare = replace(self, groups=changed(self.groups, directions=none[:, :0]))  # one program
        slope = -slope_by_offsets(alone(bare).misfit, theta)
        return replace(self, groups=with_slope(self.groups, slope))

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> Self:
        """Return data with the noise of every group that a fit leaves, by `in_units`."""
        return replace(self, groups=with_fitted_noise(residuals, self.groups))

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return what the data show without a model, by omega_n [rad/s] where that is asked for."""
        return Shown()

    def statements(self, theta: Theta) -> list[str]:
        """Return what is to be said of the data at the optimum, a sentence each."""
        return []


class KnownReading(Observable):
    """Values that were read before, of one group and of known covariance: a prior density."""

    def whitened(
        self, theta: Theta
    ) -> tuple[Float[Array, "1 value"], Float[Array, "1 own value"], Any]:
        """Return residual and directions in standard deviations, and what the density has besides.

        The last is a term of the log density of the values [nats].
        """
        raise NotImplementedError

    def weighted(self, theta: Theta) -> Weighted:
        """Return residual and directions of the offsets, in standard deviations."""
        return self.whitened(theta)[:2]

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """Return what the reading says of its run's offsets, its covariance known."""
        residual, directions, term = self.whitened(theta)
        estimate = known_estimate(residual, directions[:, :num_offsets])
        return estimate._replace(log_density=estimate.log_density + term)


def numbers_of(labels: Sequence[str], runs: Sequence[str]) -> tuple[Names, Names]:
    """Return numbers by the names of groups and of runs, in the order in which names come.

    Those of runs stand behind those of their assemblies.
    """
    owners = {run: run.partition(OF)[0] for run in runs}
    number_of = {owner: f"#{i}" for i, owner in enumerate(dict.fromkeys(owners.values()))}
    by_run = {
        run: number_of[owner] + (f"{OF}{i}" if OF in run else "")
        for i, (run, owner) in enumerate(owners.items())
    }
    return {label: f"#{i}" for i, label in enumerate(dict.fromkeys(labels))}, by_run


def unnamed(data: Any, labels: Names, runs: Names) -> Any:
    """Return data of one kind as programs see them: groups and runs have numbers for names.

    Nor has it units, words, or numbers that no program reads but is compiled for.
    """
    groups = replace(
        data.groups,
        labels=tuple(labels[label] for label in data.groups.labels),
        runs=tuple(runs[run] for run in data.groups.runs),
        units=(),
        single=None,
    )
    modes = data.modes
    if modes is not None:
        hz = modes.hz if data.reads_hz else (0.0,) * len(modes.hz)
        modes = modes._replace(numbers=(), hz=hz)
    return replace(data, groups=groups, modes=modes, **data.unread)


def alone(data: Any) -> Any:
    """Return the data of a single observable with numbers in place of names."""
    return unnamed(data, *numbers_of(data.groups.labels, data.groups.runs))


def prediction(theta: Theta, data: Observable) -> Any:
    """Return the prediction of data as a function for which compiled code can be cached."""
    return data.predict(theta)


@eqx.filter_jit
def slope_by_offsets(predict: Callable[[Theta], Array], theta: Theta) -> Float[Array, "*row own"]:
    """Return a prediction's derivative by the offsets of omega_n and zeta, on a last axis."""

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
