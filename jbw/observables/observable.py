"""What a kind of test is to a likelihood: one protocol, one file and one class a kind.

A class reduces its tests, predicts them from the parameters of the joint, and compares. All that
is common is in `jbw.observables.dataset`, which knows no kind; the statistics of groups that are
measured repeatedly are in `jbw.observables.repeated`, so that a new kind of such a test is `reduce`
and `predict` alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Complex, Float, Key

from jbw.inference.groups.offsets import Estimate
from jbw.measurement.records import Test

OFFSETS = ("omega_n", "zeta")  # of a run, where it has its own
Theta = Mapping[str, Array]
Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]


def prediction(theta: Theta, data: "Observable") -> Any:
    """What the parameters predict of data, as a function that compiled code may be kept for."""
    return data.predict(theta)


class AmplitudeCurve(NamedTuple):
    """Equivalent frequency and damping against amplitude, as read off data.

    Attributes:
        y: Amplitude of the displacement [m].
        omega: Frequency [rad/s].
        zeta: Damping ratio [-].
    """

    y: Float[np.ndarray, " point"]
    omega: Float[np.ndarray, " point"]
    zeta: Float[np.ndarray, " point"]


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
        own_shifts: Whether its records shift on their own account, integrated out here, so that
            they take no part in the offsets of runs.
        most_misfit: What a fit may leave of a group, over the group; None for anything.
        laws: Names of the laws of the joint; static.
    """

    kinds: ClassVar[tuple[str, ...]] = ()
    suffix: ClassVar[str] = ""
    dimension: ClassVar[str] = ""
    informs: ClassVar[frozenset[str]] = frozenset({"omega_n", "zeta", "gain"})
    stepped: ClassVar[bool] = False
    is_linear: ClassVar[bool] = False
    own_shifts: ClassVar[bool] = False
    most_misfit: ClassVar[float | None] = None

    laws: tuple[str, ...] = eqx.field(static=True, kw_only=True, default=("bouc_wen",))

    @classmethod
    def reduce(
        cls,
        tests: Sequence[Test],
        *,
        laws: tuple[str, ...] = ("bouc_wen",),
        substeps: int | None = None,
    ) -> tuple[Self, ...]:
        """Sufficient statistics of tests, in as many parts as their forms ask for.

        Args:
            tests: Tests of its kinds.
            laws: Names of the laws of the joint.
            substeps: Steps of the solver between samples; None for its own.
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
        """Unit of the values; empty where groups differ."""
        return ""

    def predict(self, theta: Theta) -> Any:
        """What the parameters predict, a row a group, in the unit of the measured values."""
        raise NotImplementedError

    def weighted(
        self, theta: Theta
    ) -> tuple[Float[Array, "group value"], Float[Array, "group own value"]]:
        """Residuals of every group, and directions of its run's offsets, in standard errors."""
        raise NotImplementedError

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """What every group says of the offsets of its run, its noise integrated out.

        Args:
            theta: The parameters.
            num_offsets: Offsets of a run; none where runs have none.
        """
        raise NotImplementedError

    def scatter_terms(self, theta: Theta, found: Estimate) -> Float[Array, " term"]:
        """Terms of the log likelihood besides the groups', where runs have no offsets.

        Args:
            theta: The parameters.
            found: From `estimate`.
        """
        return jnp.zeros(0)

    def compare(self, theta: Theta) -> dict[str, Array]:
        """Residual of every group in standard errors, by its label."""
        return dict(zip(self.labels, self.weighted(theta)[0], strict=True))

    def in_units(self, rows: Mapping[str, Float[np.ndarray, " value"]]) -> dict[str, Row]:
        """Rows of `compare` in the unit of the values, without what fills them up.

        Args:
            rows: Residuals, or their derivatives, by label.

        Returns:
            Rows of those groups that a fit's misfit is judged by; complex where the values are.
        """
        return {}

    def sizes(self) -> dict[str, float]:
        """Root of the sum of squares of the mean of each group, of those of `in_units`."""
        return {}

    def noise_known(self) -> dict[str, float]:
        """Number of values of each group whose noise the repeats tell, by label."""
        return {}

    def linearised(
        self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]
    ) -> "Observable":
        """The data with the change of every prediction by the offsets of its run, at one point.

        Args:
            theta: Where to linearise.
            offsets: Offsets of the runs as they are known, by name.
        """
        return self

    def with_fitted_noise(self, theta: Theta, left: Mapping[str, Row]) -> "Observable":
        """The data with the noise that a fit leaves in every group.

        Args:
            theta: The fit.
            left: What it leaves, from `in_units`.
        """
        return self

    def effective_fractions(
        self,
        left: Mapping[str, Row],
        columns: Sequence[Mapping[str, Row]],
        covariance: Float[np.ndarray, "parameter parameter"],
    ) -> dict[str, float]:
        """Fraction of the values of each group that count as independent, where less than one.

        Args:
            left: What a fit leaves, by label.
            columns: The same of its residual's derivatives, parameter by parameter.
            covariance: Of the fit.
        """
        return {}

    def with_effective_values(self, fractions: Mapping[str, float]) -> "Observable":
        """The data that count for as many values as are independent.

        Args:
            fractions: By label; one where not named.
        """
        return self

    def fractions_counted(self) -> dict[str, float]:
        """Fraction of the values of each group that the likelihood counts."""
        return {}

    def without(self, run: str) -> "Observable":
        """The data with one run's groups excluded, of the same shapes."""
        return self

    def draw_noise(
        self,
        key: Key[Array, ""],
        theta: Mapping[str, Float[np.ndarray, "..."]],
        terms: Mapping[str, Float[np.ndarray, "chain draw"]],
        num_offsets: int,
    ) -> dict[str, Float[np.ndarray, "chain draw"]]:
        """One draw of each group's noise for every draw of the parameters, by label.

        Args:
            key: Random key.
            theta: Draws of all parameters.
            terms: Terms of their log likelihood, by label.
            num_offsets: Offsets of a run.
        """
        return {}

    def first_values(self) -> dict[str, float]:
        """First values of omega_n [rad/s], zeta [-] and gain, no model run; nothing if unknown."""
        return {}

    def amplitude_curve(self) -> AmplitudeCurve | None:
        """Frequency and damping against amplitude where data show them without a model."""
        return None

    def gain_std(self) -> float:
        """Standard deviation of the first value of the gain; infinite where it is not known."""
        return float("inf")

    def y_peak(self, omega_n: float) -> float:
        """Largest displacement that was measured [m]; of noise, of which the rms is known, that.

        Args:
            omega_n: Natural frequency, where a velocity or an acceleration was measured [rad/s].
        """
        return 0.0

    def stiffness(self, gain: float) -> float | None:
        """Force over displacement, per unit mass [1/s^2], where a displacement was prescribed."""
        return None

    def evenly(self) -> "Observable | None":
        """The data with every group counted by its relative error; None where meaningless."""
        return None

    def halved(self) -> "Observable | None":
        """The data with twice as many steps of the solver; None where nothing is stepped."""
        return None

    def statements(self, theta: Theta) -> list[str]:
        """What is to be said of the data at the optimum, a sentence each."""
        return []

    def to_dataset(self, predicted: Any = None) -> dict[str, xr.Dataset]:
        """What was measured of every group with its coordinate, and what draws predict.

        Args:
            predicted: Results of `predict`, the draws along a first axis; the measured values
                alone without.

        Returns:
            By label, `measured`, and `predicted` with the dimension `draw` in front.
        """
        raise NotImplementedError
