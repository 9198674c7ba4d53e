"""An observable of groups of data that are measured repeatedly: what all such share."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from jbw.inference.generator import generator
from jbw.inference.groups.offsets import Estimate, estimate
from jbw.observables.misfit import independent_fractions, shared_misfit
from jbw.observables.observable import (
    EXCLUDED,
    SILENT,
    Covariance,
    Drawn,
    Draws,
    Numbers,
    Observable,
    Row,
    Rows,
    Theta,
    Weighted,
    alone,
    slope_by_offsets,
)
from jbw.observables.repeats import RepeatedGroups, concrete


class Repeated(Observable):
    """An observable of repeated groups, each with one unknown noise: the shared statistics.

    A subclass has the fields `repeats` and `mean`, and `reduce`, `predict` and `misfit`; one whose
    values are complex says so, and one that does not compare all values, which.
    """

    mean: eqx.AbstractVar[Array]
    repeats: eqx.AbstractVar[RepeatedGroups]

    def misfit(self, theta: Theta) -> Float[Array, "group value"]:
        """Means less predictions; real parts then imaginary parts, zero behind the last value."""
        raise NotImplementedError

    @property
    def is_complex(self) -> bool:
        """Whether the values of a group are real parts, then imaginary parts."""
        return False

    def compared(self, group: int) -> slice | Bool[np.ndarray, " value"]:
        """Which values of a group's row are compared, of complex ones which of their pairs."""
        return slice(int(np.asarray(self.repeats.size)[group]) // (2 if self.is_complex else 1))

    def coordinate(self, group: int) -> tuple[str, str, Float[np.ndarray, " value"]]:
        """What the compared values of a group stand over: name, unit, places; here, numbers."""
        count = np.asarray(self.mean)[group][self.compared(group)].size
        return "number", "1", np.arange(1.0, count + 1.0)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each group."""
        return self.repeats.labels

    @property
    def runs(self) -> tuple[str, ...]:
        """Name of the run of each group."""
        return self.repeats.runs

    def unnamed(self, numbers: Numbers) -> Self:
        """The data as programs see them: their groups and runs have `numbers` for names."""
        labels = tuple(numbers.labels[label] for label in self.labels)
        runs = tuple(numbers.runs[run] for run in self.runs)
        groups = replace(self.repeats, labels=labels, runs=runs)
        return replace(super().unnamed(numbers), repeats=groups)

    @property
    def width(self) -> int:
        """Values of the widest group."""
        return self.repeats.directions.shape[-1]

    @property
    def weight(self) -> Float[Array, " group"]:
        r"""One over a mean's standard error, $\sqrt{n / N} / \sigma$; n is N K if independent."""
        groups = self.repeats
        size, repeats, counted, noise_std = map(
            concrete, (groups.size, groups.num_repeats, groups.num_values, groups.noise_std)
        )
        return (counted / (size - groups.num_taken / repeats)) ** 0.5 / noise_std

    def weighted(self, theta: Theta) -> Weighted:
        """Residuals and directions in standard errors of a mean."""
        weight = self.weight
        residual, directions = self.residual(theta)
        return weight[:, None] * residual, weight[:, None, None] * directions

    def residual(self, theta: Theta) -> Weighted:
        """Misfit and directions, in the unit of the values."""
        return self.beside_own(self.misfit(theta)), self.repeats.directions

    def beside_own(
        self, rows: Float[Array, "group *own value"]
    ) -> Float[Array, "group *own value"]:
        """Rows of every group without what lies along its own constants, which nothing tells."""
        columns = self.repeats.spanned
        if not columns.shape[1]:
            return rows
        along = jnp.einsum("gcv,g...v->g...c", columns, rows)
        return rows - jnp.einsum("gcv,g...c->g...v", columns, along)

    def measured_rows(self) -> Float[Array, "group value"]:
        """Means, of complex values the real parts, then the imaginary parts."""
        if not jnp.iscomplexobj(self.mean):
            return self.mean
        return jnp.concatenate([self.mean.real, self.mean.imag], axis=1)

    def estimate(self, theta: Theta, num_offsets: int) -> Estimate:
        """What each group says of its offsets, its noise integrated out under 1/sigma."""
        repeats = self.repeats
        scatter = repeats.within + repeats.size * repeats.num_repeats * repeats.discrepancy
        square, along = self.own_sums(theta)
        return estimate(
            square, along, scatter, repeats.num_repeats, repeats.num_values, repeats.directions
        )

    def own_sums(self, theta: Theta) -> tuple[Float[Array, " group"], Float[Array, "group own"]]:
        """Squares of the misfit of every group, and its products with the directions."""
        return self.residual_sums(theta, self.repeats.directions)

    def in_units(self, rows: Mapping[str, Float[np.ndarray, " value"]]) -> dict[str, Row]:
        """Rows of the residual in the unit of the values, complex where the values are."""
        weight, labelled = np.asarray(self.weight), {}
        for i, label in enumerate(self.labels):
            row: Row = np.asarray(rows[label]) / weight[i]
            if self.is_complex:
                real, imaginary = np.split(row, 2)
                row = real + 1j * imaginary
            labelled[label] = row[self.compared(i)]
        return labelled

    def sizes(self) -> dict[str, float]:
        """Root of the sum of squares of the mean of each group, zero behind its last value."""
        return dict(zip(self.labels, np.linalg.norm(self.mean, axis=1).tolist(), strict=True))

    def repeatability(self) -> dict[str, float]:
        """Scatter of single repeats of each group, over the size of their mean."""
        degrees = np.maximum(np.asarray(self.repeats.num_repeats) - 1, 1)
        scatter = np.sqrt(np.asarray(self.repeats.within) / degrees)
        by_label, sizes = dict(zip(self.labels, scatter, strict=True)), self.sizes()
        return {label: float(by_label[label]) / sizes[label] for label in self.noise_known()}

    def mean_repeatability(self) -> dict[str, float]:
        """Scatter of the mean of K repeats, that of a single one over the root of K."""
        count = dict(zip(self.labels, np.asarray(self.repeats.num_repeats).tolist(), strict=True))
        return {label: x / count[label] ** 0.5 for label, x in self.repeatability().items()}

    def noise_known(self) -> dict[str, float]:
        """Number of values of each group that was repeated."""
        count, size = (np.asarray(x) for x in (self.repeats.num_repeats, self.repeats.size))
        return {label: float(size[i]) for i, label in enumerate(self.labels) if count[i] > 1}

    def linearised(self, theta: Theta, offsets: Mapping[str, Float[np.ndarray, " own"]]) -> Self:
        """The data with the change of every prediction by the offsets of its run, at one point."""
        return self.with_directions(-slope_by_offsets(alone(self).misfit, theta))

    def with_directions(self, slope: Float[Any, "group value own"]) -> Self:
        """The data with derivatives of the predictions by the offsets."""
        xp: Any = np if isinstance(slope, np.ndarray) else jnp
        return self.with_repeats(directions=self.beside_own(xp.moveaxis(slope, -1, 1)))

    def with_repeats(self, **changes: Any) -> Self:
        """The data with some of the repeats' arrays changed; NumPy's are put on the device."""
        arrays = {name: _on_device(values) for name, values in changes.items()}
        return replace(self, repeats=replace(self.repeats, **arrays))

    def evenly(self) -> Self:
        """Groups that count by their relative errors, whatever their noise and offsets."""
        size = np.array(list(self.sizes().values()))
        return self.with_repeats(
            noise_std=np.where(size > 0, size, 1.0),
            num_values=self.repeats.size,
            directions=np.asarray(self.repeats.directions)[:, :0],
        )

    def with_discrepancy(self, residuals: Rows) -> Self:
        """The data with what the law leaves of them, one share of the response for all groups."""
        sizes = np.array(list(self.sizes().values()))
        return self.with_repeats(discrepancy=shared_misfit(self.repeats, sizes, residuals))

    def with_fitted_noise(self, theta: Theta, residuals: Rows) -> Self:
        r"""The data with the noise that a fit leaves, $\sigma^2 = Q / (N K - q) + \tau^2$."""
        repeats = self.repeats
        squares = np.array([np.sum(np.abs(residuals[label]) ** 2) for label in repeats.labels])
        total = np.asarray(repeats.num_repeats) * squares + np.asarray(repeats.within)
        square = total / np.asarray(repeats.num_counted) + np.asarray(repeats.discrepancy)
        return self.with_repeats(noise_std=np.sqrt(square))

    def effective_fractions(
        self, residuals: Rows, columns: Sequence[Rows], covariance: Covariance
    ) -> dict[str, float]:
        """Fraction of independent values where the law leaves more than noise of the groups."""
        return independent_fractions(self.repeats, residuals, columns, covariance)

    def with_effective_values(self, fractions: Mapping[str, float]) -> Self:
        """The data that count for as many values as are independent."""
        repeats = self.repeats
        fraction = np.array([fractions.get(label, 1.0) for label in repeats.labels])
        return self.with_repeats(num_values=fraction * np.asarray(repeats.num_counted))

    def fractions_counted(self) -> dict[str, float]:
        """Fraction of the values of each group that the likelihood counts."""
        repeats = self.repeats
        fraction = np.asarray(repeats.num_values) / np.asarray(repeats.num_counted)
        return dict(zip(repeats.labels, fraction.tolist(), strict=True))

    def without(self, run: str) -> Self:
        """The data with one run's groups excluded, of the same shapes."""
        loud = np.array([EXCLUDED if name == run else 1.0 for name in self.runs])
        return self.with_repeats(noise_std=np.asarray(self.repeats.noise_std) * loud)

    def silenced(self, run: str) -> Self:
        """The data in which one run's groups have next to no values, of the same shapes."""
        pairs = zip(self.labels, self.runs, strict=True)
        fractions = {label: SILENT for label, name in pairs if name == run}
        return self.with_effective_values({**self.fractions_counted(), **fractions})

    def draw_noise(
        self, key: Key[Array, ""], theta: Drawn, terms: Mapping[str, Draws], num_offsets: int
    ) -> dict[str, Draws]:
        r"""One exact draw of each group's noise for every draw of the parameters.

        $$\sigma^2 \mid \theta \sim \frac{n}{NK}\,Q(\theta) / \chi^2_{n - q}, \qquad
          \log p = -\tfrac n2 \log Q$$

        Q, of all N K values, is read off the stored terms of the log likelihood: no other solve.
        """
        repeats = self.repeats
        rows = np.stack([terms[label] for label in self.labels], axis=-1)
        count = np.asarray(repeats.num_values)
        chi_square = generator(key).chisquare(count - num_offsets, rows.shape)
        fraction = count / np.asarray(repeats.num_counted)
        noise = np.sqrt(fraction * np.exp(-2 * rows / count) / chi_square)
        return {label: noise[..., i] for i, label in enumerate(self.labels)}


def _on_device(values: Any) -> Any:
    """An array of JAX; `jnp.asarray` would compile a program for every shape."""
    return jax.device_put(values) if isinstance(values, np.ndarray) else values
