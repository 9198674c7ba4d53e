"""The interface between a kind of test and the likelihood, based on a table of data groups.

Everything that the kinds share either reads the columns of that table (`jbw.observables.groups`,
`noise`), or is in `jbw.observables.dataset`, which depends on no kind. A kind of test that is
measured repeatedly needs only `reduce` and `predict`.
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
from jbw.measurement.residual_spectra import Spectrum
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
from jbw.quantities import DEFAULT_LAWS

OFFSETS = ("omega_n", "zeta")  # parameters that may differ between runs by an offset

Theta = Mapping[str, Array]
Weighted = tuple[Float[Array, "group value"], Float[Array, "group own value"]]
Laws = tuple[str, ...]
Names = Mapping[str, str]  # names of data groups or runs, by their names in compiled programs


class SteadyLines(NamedTuple):
    """First harmonics of source and displacement [m], by frequency [rad/s]; 0 means a slow loop."""

    omega: Float[np.ndarray, " line"]
    load: Complex[np.ndarray, " line"]
    motion: Complex[np.ndarray, " line"]


def _nothing() -> None:
    """Return None, because the data do not show this quantity."""


def _no_spectra(residuals: Rows) -> dict[str, Spectrum]:
    """Return no spectra, because the data have none."""
    return {}


class Shown(NamedTuple):
    """Model-free estimates from data: starting values, scales of priors, axes of figures.

    Facts that are costly, or may fail, are functions without arguments.

    Attributes:
        first_values: Starting values of omega_n [rad/s], zeta [-] and gain, as far as known.
        steady_lines: Steady motion with measured load; one line is too little for starting values.
        amplitude_curve: Frequency and damping against amplitude.
        amplitude_readings: Frequency and damping, one point per level, too coarse to start a fit
            from.
        stiffness: Force over prescribed displacement [N/m]; None if it was not prescribed.
        gain_std: Standard deviation of the starting value of the gain; infinite if unknown.
        y_peak: Largest displacement [m], for noise that of 99 % of its peaks; 0 if not measured.
        begins: Initial displacement of each free decay [m], by run.
        peaks_of_modes: Largest displacement [m] near each of several modes, if measured.
        axis: Name and unit of the horizontal axis of the values in figures.
        places: Position of each group's compared values on that axis; None for their numbers.
        spreads: Noise of every compared value relative to that of its group; None for 1.
        references: Reference of every compared value's relative error, in its unit; None for the
            root mean square of its group.
        spectra: Function from residuals to one spectrum per label, to test them for usual causes.
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
    """The reduced data of one kind of test, in the form that the likelihood needs.

    `reduce` and `predict` are required. All other methods have defaults for a mean of repeats minus
    its prediction; functions of `groups` and `noise` read the columns of the table `groups`.

    Attributes:
        kinds: Kinds of tests that `reduce` takes.
        suffix: Suffix of the name of its noise variable in a posterior, after `noise_std`.
        dimension: Dimension of that variable; empty if its noise is not a variable.
        informs: Names among omega_n, zeta and gain that the data can constrain.
        stepped: Whether a prediction steps through time, and costs accordingly.
        is_linear: Whether its starting values were read where the joint hardly slips.
        is_prescribed: Whether its displacement is prescribed, so that a force is measured [N] and
            nothing moves freely.
        own_shifts: Whether each record has its own frequency shift, which is integrated out here,
            so that records take no part in the offsets of runs.
        moved_by_runs: Whether offsets of runs change its prediction.
        several: Whether it takes tests of several modes (True), of one (False) or of both (None).
        most_misfit: Largest acceptable relative residual of a group; None for no limit.
        unread: Fields that no program reads, with the values that programs receive instead.
        reads_hz: Whether programs read the stated frequencies of the modes.
        mean: Mean of the repeats of every group, in the form of `predict`.
        groups: The table of groups.
        laws: Names of the laws of the joint; static, like all below.
        residuals: Residual terms of theta that its prediction includes: none, upper, both, auto or
            own; none if nothing drives the motion.
        drive: Source that drives the motion, one of `DRIVES`; empty if it does not matter.
        modes: Modes of the structure that share the joint, as a campaign states them
            (`jbw.observables.modes`); None for one mode.
        substeps: Solver steps between samples; None if time is not stepped.
        depth: Reversals that Masing laws remember in time; None if they need not.
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
        """Reduce tests to means and deviations of repeats, one part per group of equal sampling.

        `substeps` is the number of solver steps between samples; None for the default.
        """
        raise NotImplementedError

    def predict(self, theta: Theta) -> Any:
        """Return the prediction of each data group at given parameters, in the measured unit."""
        raise NotImplementedError

    def compared(self, values: Any) -> Float[Array, "group value"]:
        """Return values as real numbers: real parts, then imaginary parts, 0 where missing."""
        if self.groups.counted is not None:
            values = self.groups.counted * values
        if not jnp.iscomplexobj(values):
            return values
        return jnp.concatenate([values.real, values.imag], axis=1)

    def misfit(self, theta: Theta) -> Float[Array, "group value"]:
        """Return the mean minus the prediction of each data group, as real numbers."""
        return self.compared(self.mean - self.predict(theta))

    def weighted(self, theta: Theta) -> Weighted:
        """Return residuals, and derivatives with respect to run offsets, in standard errors."""
        weight = weights(self.groups)
        residual = weight[:, None] * beside_own(self.misfit(theta), self.groups)
        return residual, weight[:, None, None] * self.groups.directions

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """Estimate the run offsets from each data group, with the group's noise integrated out."""
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
        """Return each group's sum of squared residuals, and scalar products of `rows` and residual.

        Args:
            theta: The parameters.
            rows: Rows with which the residual of every group is multiplied; None for the
                directions.
            offset: Offsets of each group's run; None for zero.
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
        """Return data with costly predictions computed in advance at parameter points, or None.

        Args:
            theta: The parameters at points.
            threads: Number of threads.
            writes: Whether the misfit itself is needed, and not only its sums.
            rows: Rows that `residual_sums` will receive in addition to the directions.
        """
        return None

    def linearised(self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]) -> Self:
        """Return data with the derivatives of predictions with respect to run offsets."""
        none = np.zeros((len(self.groups.labels), len(OFFSETS), self.groups.width))
        if not self.moved_by_runs:
            return replace(self, groups=changed(self.groups, directions=none))
        # Old derivatives are left out, so that one compiled program serves all calls.
        bare = replace(self, groups=changed(self.groups, directions=none[:, :0]))
        slope = -slope_by_offsets(alone(bare).misfit, theta)
        return replace(self, groups=with_slope(self.groups, slope))

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> Self:
        """Return the data with each group's noise estimated from residuals [unit of values]."""
        return replace(self, groups=with_fitted_noise(residuals, self.groups))

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return model-free estimates from the data; some of them need omega_n [rad/s]."""
        return Shown()

    def statements(self, theta: Theta) -> list[str]:
        """Return sentences about the data at the optimum of a fit."""
        return []


class KnownReading(Observable):
    """Estimates with a covariance known before the fit, as one data group."""

    def whitened(
        self, theta: Theta
    ) -> tuple[Float[Array, "1 value"], Float[Array, "1 own value"], Any]:
        """Return residual, derivatives with respect to run offsets (both in sd), and log density.

        The term is that of the values' density [nats].
        """
        raise NotImplementedError

    def weighted(self, theta: Theta) -> Weighted:
        """Return residual and derivatives with respect to run offsets, in standard deviations."""
        return self.whitened(theta)[:2]

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """Estimate the run offsets from values with known covariance."""
        residual, directions, term = self.whitened(theta)
        estimate = known_estimate(residual, directions[:, :num_offsets])
        return estimate._replace(log_density=estimate.log_density + term)


def numbers_of(labels: Sequence[str], runs: Sequence[str]) -> tuple[Names, Names]:
    """Return a number for each name of a data group or run, in order of first appearance.

    The number of a run follows that of its assembly.
    """
    owners = {run: run.partition(OF)[0] for run in runs}
    number_of = {owner: f"#{i}" for i, owner in enumerate(dict.fromkeys(owners.values()))}
    by_run = {
        run: number_of[owner] + (f"{OF}{i}" if OF in run else "")
        for i, (run, owner) in enumerate(owners.items())
    }
    return {label: f"#{i}" for i, label in enumerate(dict.fromkeys(labels))}, by_run


def unnamed(data: Any, labels: Names, runs: Names) -> Any:
    """Return data with numbers in place of the names of groups and runs, for compiled programs.

    Units, words and numbers that no program reads are removed, so that they cause no compilation.
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
    """Return one part of a dataset, with numbers in place of the names of groups and runs."""
    return unnamed(data, *numbers_of(data.groups.labels, data.groups.runs))


def prediction(theta: Theta, data: Observable) -> Any:
    """Return the prediction of data as a function whose compiled code can be cached."""
    return data.predict(theta)


@eqx.filter_jit
def slope_by_offsets(predict: Callable[[Theta], Array], theta: Theta) -> Float[Array, "*row own"]:
    """Return a prediction's derivatives with respect to omega_n and zeta, along a last axis."""

    def shifted(offset: Float[Array, " own"]) -> Array:
        shifted_theta = {name: theta[name] + b for name, b in zip(OFFSETS, offset, strict=True)}
        return predict({**theta, **shifted_theta})

    return jax.jacfwd(shifted)(jnp.zeros(len(OFFSETS)))


def assemblies_of(runs: tuple[str, ...]) -> tuple[int, ...]:
    """Return each run's assembly index; an empty tuple unless several assemblies repeat runs."""
    owners = [run.partition(OF)[0] for run in runs]
    order = list(dict.fromkeys(owners))
    if not 1 < len(order) < len(runs):
        return ()
    return tuple(order.index(owner) for owner in owners)
