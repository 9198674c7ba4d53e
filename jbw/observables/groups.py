"""The table of data groups, one per record, level or harmonic: noise, repeats, run offsets."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Complex, Float, Inexact

from jbw.oscillator.hold import namespace

# If columns are scaled to norm one, singular values below this are rounding errors.
SPANS = 1e-10

Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]
Rows = Mapping[str, Row]  # rows of residuals by the label of their data group
Covariance = Float[np.ndarray, "parameter parameter"]


def concrete(values: Any) -> Any:
    """Return values as a NumPy array, without compiling anything, unless JAX traces them."""
    return values if isinstance(values, Tracer) else np.asarray(values)


class SingleRecords(NamedTuple):
    """The individual records of every data group, padded with zeros to equal numbers.

    Attributes:
        mean: Mean of the repeats of each record, in the form of `Observable.mean`.
        num_repeats: Repeats of each record: the periods of a multisine, else one.
        within: Scatter of these repeats about their mean.
    """

    mean: Inexact[np.ndarray, "group record value"]
    num_repeats: Float[np.ndarray, "group record"]
    within: Float[np.ndarray, "group record"]


class Groups(eqx.Module):
    """A table of data groups; each group has one label, one run and one noise level.

    Attributes:
        within: Scatter S of the repeats: squared deviations from their mean, summed over all
            values.
        num_repeats: Number K of repeats.
        size: Number N of values of a group, as real numbers (samples, or real and imaginary parts).
        num_values: Number n of independent values of all repeats, fewer if the residual is
            coloured.
        noise_std: Noise of one repeat, for least squares.
        discrepancy: Expected mean-square misfit of the law in every value, the same in all repeats.
        directions: Derivatives of the prediction by each offset of the run; no rows without
            offsets.
        spanned: Orthonormal directions that the misfit may also contain and that are integrated
            out, such as a group's own constants (`residuals = "own"`); zero rows if there are
            fewer.
        origin: omega_n [rad/s] and zeta of each group's own run, about which its prediction is
            linear in them; no columns if it is predicted at the parameters themselves.
        counted: 1 for a compared value, 0 for others; None if the first `size` are compared.
        reference: Reference of a group's relative errors; None for the root mean square of its
            mean.
        single: Records one by one; None if every group has a single record. No program reads them.
        labels: Name of each group, all different; static, like all below.
        runs: Name of the run of each group.
        units: Unit of the values of each group.
        is_complex: Whether the values of a group are real parts, then imaginary parts.
        num_own: Number of unknowns of each group, other than noise, that its kind integrates out.
        is_prior: Whether it is one group that was read before, by which no fit is judged.
    """

    within: Float[Array, " group"]
    num_repeats: Float[Array, " group"]
    size: Float[Array, " group"]
    num_values: Float[Array, " group"]
    noise_std: Float[Array, " group"]
    discrepancy: Float[Array, " group"]
    directions: Float[Array, "group own value"]
    spanned: Float[Array, "group column value"]
    origin: Float[Array, "group of_run"]
    counted: Float[Array, "group value"] | None = None
    reference: Float[Array, " group"] | None = None
    single: SingleRecords | None = None
    labels: tuple[str, ...] = eqx.field(static=True, kw_only=True)
    runs: tuple[str, ...] = eqx.field(static=True, kw_only=True)
    units: tuple[str, ...] = eqx.field(static=True, kw_only=True)
    is_complex: bool = eqx.field(static=True, default=False)
    num_own: int = eqx.field(static=True, default=0)
    is_prior: bool = eqx.field(static=True, default=False)

    @property
    def num_taken(self) -> Float[Array, " group"]:
        """The number of fitted constants of each data group; each takes a degree of freedom."""
        rows = concrete(self.spanned)
        xp = namespace(rows)
        return xp.round(xp.sum(rows**2, axis=(1, 2)))

    @property
    def num_counted(self) -> Float[Array, " group"]:
        """The number of values of a data group, over all repeats, minus its fitted constants."""
        return concrete(self.size) * concrete(self.num_repeats) - self.num_taken

    @property
    def unit(self) -> str:
        """The unit of the values; empty if it differs between data groups."""
        return self.units[0] if len(set(self.units)) == 1 else ""

    @property
    def width(self) -> int:
        """The number of values of the longest data group, to which all other groups are padded."""
        return self.directions.shape[-1]


def repeated(
    values: Sequence[Inexact[np.ndarray, "_record ... _value"]],
    sizes: Float[np.ndarray, " group"],
    labels: Sequence[str],
    runs: Sequence[str],
    *,
    scale: Float[np.ndarray, " group"] | None = None,
    course: Sequence[Float[np.ndarray, " _value"] | float] | None = None,
    longest: int | None = None,
    spanned: Float[np.ndarray, "group column value"] | None = None,
    **columns: Any,
) -> Groups:
    r"""Return data groups of independent values; repeats give $\sigma^2 = S / (N (K - 1))$.

    Repeated labels get a number.

    Args:
        values: Every record of each group, or every repeat of each record; zero where not compared.
        sizes: Number N of compared values of each group.
        labels: Name of each group.
        runs: Name of the run of each group.
        scale: Size of each group; one hundredth of it is the first guess of the noise if there are
            no repeats. None for the root mean square.
        course: Noise of every value relative to that of its group; None for 1.
        longest: Length of the longest row, if rows contain more values than count.
        spanned: Columns that each group's misfit may also contain, in any scale.
        columns: Other columns of `Groups`, such as units.
    """
    longest = int(max(sizes, default=0)) if longest is None else longest
    records = [rows.reshape(len(rows), -1, rows.shape[-1]) for rows in values]
    means = [rows.mean(axis=(0, 1)) for rows in records]
    weights = [1.0] * len(values) if course is None else course
    rows_of_groups = zip(records, means, weights, strict=True)
    within = np.array([np.sum(np.abs((x - mean) / c) ** 2) for x, mean, c in rows_of_groups])
    num_repeats = np.array([float(rows.shape[0] * rows.shape[1]) for rows in records])
    if scale is None:
        scale = np.sqrt(np.array([np.sum(np.abs(mean) ** 2) for mean in means]) / sizes)
    degrees = sizes * (num_repeats - 1)
    is_repeated = degrees > 0
    noise = np.sqrt(
        np.where(is_repeated, within / np.where(is_repeated, degrees, 1), (0.01 * scale) ** 2)
    )
    own_directions = (
        np.zeros((len(labels), 0, longest)) if spanned is None else _orthonormal(spanned)
    )
    # Each constant of a data group takes one degree of freedom.
    num_taken = np.round(np.sum(own_directions**2, axis=(1, 2)))
    arrays = {
        "within": within,
        "num_repeats": num_repeats,
        "size": np.asarray(sizes, float),
        "num_values": np.asarray(sizes, float) * num_repeats - num_taken,
        "noise_std": noise,
        "discrepancy": np.zeros(len(labels)),
        "directions": np.zeros((len(labels), 0, longest)),
        "spanned": own_directions,
        "origin": np.zeros((len(labels), 0)),
    }
    others: dict[str, Any] = {"units": ("",) * len(labels)} | columns
    arrays = jax.device_put(arrays)
    return Groups(
        **arrays, single=_single(records), labels=_distinct(labels), runs=tuple(runs), **others
    )


def _single(
    records: Sequence[Inexact[np.ndarray, "_record _repeat _value"]],
) -> SingleRecords | None:
    shape = len(records), max(map(len, records), default=1)
    if shape[1] == 1:
        return None
    mean = np.zeros((*shape, max(rows.shape[2] for rows in records)), records[0].dtype)
    num_repeats, within = np.zeros(shape), np.zeros(shape)
    for i, rows in enumerate(records):
        own = rows.mean(axis=1)
        mean[i, : len(own), : own.shape[1]] = own
        num_repeats[i, : len(own)] = rows.shape[1]
        within[i, : len(own)] = np.sum(np.abs(rows - own[:, None]) ** 2, axis=(1, 2))
    return SingleRecords(mean, num_repeats, within)


def read_before(label: str, run: str, size: int, num_repeats: int = 1) -> Groups:
    """Return a table with one data group whose covariance is known before any fit."""
    values, sizes = [np.zeros((num_repeats, size))], np.array([float(size)])
    groups = repeated(values, sizes, (label,), (run,), is_prior=True)
    return changed(groups, noise_std=np.ones(1))


def single_records(mean: Inexact[np.ndarray, "group value"], groups: Groups) -> SingleRecords:
    """Return the individual records of every data group; the means if none are stored."""
    if groups.single is not None:
        return groups.single
    counts = (np.asarray(x)[:, None] for x in (groups.num_repeats, groups.within))
    return SingleRecords(mean[:, None], *counts)


def changed(groups: Groups, **columns: Any) -> Groups:
    """Return the table of data groups with some columns replaced, as arrays on the device."""
    # `jnp.asarray` would compile a program for every shape.
    arrays = {n: jax.device_put(x) if isinstance(x, np.ndarray) else x for n, x in columns.items()}
    return replace(groups, **arrays)


def weights(groups: Groups) -> Float[Array, " group"]:
    r"""Return means' inverse standard errors, $\sqrt{n / N} / \sigma$; n = N K for white noise."""
    size, repeats, counted, noise_std = map(
        concrete, (groups.size, groups.num_repeats, groups.num_values, groups.noise_std)
    )
    return (counted / (size - groups.num_taken / repeats)) ** 0.5 / noise_std


def beside_own(
    rows: Float[Array, "group *own value"], groups: Groups
) -> Float[Array, "group *own value"]:
    """Remove from each data group's arrays the part that its own fitted constants can explain."""
    columns = groups.spanned
    if not columns.shape[1]:
        return rows
    along = jnp.einsum("gcv,g...v->g...c", columns, rows)
    return rows - jnp.einsum("gcv,g...c->g...v", columns, along)


def with_slope(groups: Groups, slope: Float[Any, "group value own"]) -> Groups:
    """Return the data groups with derivatives of predictions with respect to run offsets."""
    xp = namespace(slope)
    return changed(groups, directions=beside_own(xp.moveaxis(slope, -1, 1), groups))


def compared(groups: Groups, group: int) -> slice | Bool[np.ndarray, " value"]:
    """Return the slice or mask of a group's compared values; a complex value counts once."""
    if groups.counted is not None:
        return np.asarray(groups.counted)[group] > 0
    return slice(int(np.asarray(groups.size)[group]) // (2 if groups.is_complex else 1))


def in_units(rows: Mapping[str, Float[np.ndarray, " value"]], groups: Groups) -> dict[str, Row]:
    """Convert weighted residuals to the unit of the values, and to complex numbers where needed."""
    weight, labelled = np.asarray(weights(groups)), {}
    for i, label in enumerate(groups.labels):
        row: Row = np.asarray(rows[label]) / weight[i]
        if groups.is_complex:
            half = len(row) // 2
            row = row[:half] + 1j * row[half : 2 * half]
        labelled[label] = row[compared(groups, i)]
    return labelled


def sizes(mean: Inexact[Any, "group value"], groups: Groups) -> Float[np.ndarray, " group"]:
    """Return the norm of each data group's mean, or of the reference value of its errors."""
    if groups.reference is None:
        return np.linalg.norm(np.asarray(mean), axis=1)
    return np.asarray(groups.reference) * np.sqrt(np.asarray(groups.size))


def with_fitted_noise(residuals: Rows, groups: Groups) -> Groups:
    r"""Return groups with noise from a fit's residuals, $\sigma^2 = Q / (N K - q) + \tau^2$."""
    squares = np.array([np.sum(np.abs(residuals[label]) ** 2) for label in groups.labels])
    total = np.asarray(groups.num_repeats) * squares + np.asarray(groups.within)
    square = total / np.asarray(groups.num_counted) + np.asarray(groups.discrepancy)
    return changed(groups, noise_std=np.sqrt(square))


def with_effective_values(fractions: Mapping[str, float], groups: Groups) -> Groups:
    """Return data groups with given numbers of independent values; by default all values count."""
    fraction = np.array([fractions.get(label, 1.0) for label in groups.labels])
    return changed(groups, num_values=fraction * np.asarray(groups.num_counted))


def fractions_counted(groups: Groups) -> dict[str, float]:
    """Return the fraction of each data group's values that the likelihood counts."""
    fraction = np.asarray(groups.num_values) / np.asarray(groups.num_counted)
    return dict(zip(groups.labels, fraction.tolist(), strict=True))


def _orthonormal(
    columns: Float[np.ndarray, "group column value"],
) -> Float[np.ndarray, "group column value"]:
    """Return an orthonormal basis of each group's columns; zeros replace dependent columns."""
    size = np.linalg.norm(columns, axis=-1, keepdims=True)
    _, weight, rows = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return rows * (weight > SPANS)[..., None]


def filled(rows: Sequence[np.ndarray], mode: Literal["constant", "edge"] = "constant") -> Array:
    """Stack arrays of unequal length; pad with zeros, or with the last value in mode `edge`."""
    longest = max(map(len, rows))
    return jnp.asarray(np.stack([np.pad(row, (0, longest - len(row)), mode) for row in rows]))


def _distinct(labels: Sequence[str]) -> tuple[str, ...]:
    """Make labels distinct by appending a number to repeated labels."""
    counts = [labels[: i + 1].count(label) for i, label in enumerate(labels)]
    pairs = zip(labels, counts, strict=True)
    return tuple(label if count == 1 else f"{label} ({count})" for label, count in pairs)
