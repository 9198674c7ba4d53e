"""Groups of repeated data: their bookkeeping, and rows of unequal lengths side by side."""

from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

SPANS = 1e-10  # of columns of size one: a direction that is none but for rounding


def concrete(values: Any) -> Any:
    """An array as NumPy's where nothing is traced: then there is no program to compile."""
    return values if isinstance(values, Tracer) else np.asarray(values)


class RepeatedGroups(eqx.Module):
    """Groups of repeated data, each with a noise of its own.

    Attributes:
        within: Scatter S of the repeats about their mean, summed over repeats and values.
        num_repeats: Repeats K.
        size: Values N of a group: real numbers (samples, or real and imaginary parts).
        num_values: Independent values n of all repeats, fewer where the residual is coloured.
        noise_std: Noise of one repeat, for least squares.
        discrepancy: Mean square that the law is expected to leave of every value, in all repeats.
        directions: Change of the prediction by each offset of the run; no offsets, no rows.
        spanned: Orthonormal directions of what the misfit may hold besides, integrated out: of a
            constant of each group's own (`residuals = "own"`); zero rows where there are fewer.
    """

    within: Float[Array, " group"]
    num_repeats: Float[Array, " group"]
    size: Float[Array, " group"]
    num_values: Float[Array, " group"]
    noise_std: Float[Array, " group"]
    discrepancy: Float[Array, " group"]
    directions: Float[Array, "group own value"]
    spanned: Float[Array, "group column value"]
    labels: tuple[str, ...] = eqx.field(static=True)
    runs: tuple[str, ...] = eqx.field(static=True)

    @property
    def num_taken(self) -> Float[Array, " group"]:
        """Values that the directions of each group's own take, one each."""
        rows = concrete(self.spanned)
        xp: Any = np if isinstance(rows, np.ndarray) else jnp
        return xp.round(xp.sum(rows**2, axis=(1, 2)))

    @property
    def num_counted(self) -> Float[Array, " group"]:
        """Values of all repeats of each group, less those that are taken."""
        return concrete(self.size) * concrete(self.num_repeats) - self.num_taken


def repeats(
    within: Float[np.ndarray, " group"],
    num_repeats: Float[np.ndarray, " group"],
    sizes: Float[np.ndarray, " group"],
    labels: Sequence[str],
    runs: Sequence[str],
    scale: Float[np.ndarray, " group"],
    *,
    longest: int | None = None,
    spanned: Float[np.ndarray, "group column value"] | None = None,
) -> RepeatedGroups:
    r"""Bookkeeping of groups of independent values of noise $\sigma^2 = S / (N (K - 1))$.

    Until a fit tells it, a single repeat's noise is guessed as one hundredth of the root mean
    square, the `scale`. Labels that come again get a number. `spanned` are columns of each group
    that its misfit may hold besides, in any scale. `longest` is the length of the longest group's
    row, where more values stand in it than count.
    """
    longest = int(max(sizes)) if longest is None else longest
    degrees = sizes * (num_repeats - 1)
    repeated = degrees > 0
    noise = np.sqrt(
        np.where(repeated, within / np.where(repeated, degrees, 1), (0.01 * scale) ** 2)
    )
    own_directions = (
        np.zeros((len(labels), 0, longest)) if spanned is None else _orthonormal(spanned)
    )
    # Values that the directions of each group's own take, one each.
    num_taken = np.round(np.sum(own_directions**2, axis=(1, 2)))
    none = np.zeros(len(labels))
    arrays = {
        "within": np.asarray(within),
        "num_repeats": np.asarray(num_repeats, float),
        "size": np.asarray(sizes, float),
        "num_values": np.asarray(sizes, float) * num_repeats - num_taken,
        "noise_std": noise,
        "discrepancy": none,
        "directions": np.zeros((len(labels), 0, longest)),
        "spanned": own_directions,
    }
    return RepeatedGroups(
        **jax.device_put(arrays),
        labels=_distinct(labels),
        runs=tuple(runs),
    )


def _orthonormal(
    columns: Float[np.ndarray, "group column value"],
) -> Float[np.ndarray, "group column value"]:
    """Orthonormal rows of the same span, and zeros for those that are not needed."""
    size = np.linalg.norm(columns, axis=-1, keepdims=True)
    _, weight, rows = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return rows * (weight > SPANS)[..., None]


def filled(rows: Sequence[np.ndarray], mode: Literal["constant", "edge"] = "constant") -> Array:
    """Rows side by side, zero behind their last value, or that value itself by mode edge."""
    longest = max(map(len, rows))
    return jnp.asarray(np.stack([np.pad(row, (0, longest - len(row)), mode) for row in rows]))


def _distinct(labels: Sequence[str]) -> tuple[str, ...]:
    """Labels of which no two are alike: those that come again have a number behind them."""
    counts = [labels[: i + 1].count(label) for i, label in enumerate(labels)]
    pairs = zip(labels, counts, strict=True)
    return tuple(label if count == 1 else f"{label} ({count})" for label, count in pairs)
