r"""The log likelihood of single records, and their rms as the posterior draws predict it.

The joint posterior integrates noise and offsets out. Given a draw of these too, records are
independent, and the log likelihood of one record is

$$\log p(d_j | \theta, b, \sigma) = -\frac{n_j}{2} \log 2\pi\sigma^2 - \frac{f\,Q_j}{2\sigma^2},
  \qquad Q_j = K_j\,|\bar d_j - m - J^T b|^2 + S_j + N K_j \tau^2, \qquad n_j = f N K_j$$

for N values each, of which the fraction f is independent, in K_j repeats with scatter S_j (the
periods of a multisine; otherwise one repeat without scatter). Leaving out one record needs this.
The records of a group share one prediction m, so that one solve per draw serves all of them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jbw.inference.generator import generator, parts_of
from jbw.inference.groups.scatter import draw_offsets
from jbw.inference.lanes import Solved, at_points, seeing, solved_first
from jbw.observables.dataset import Dataset, estimates, solved, unnamed
from jbw.observables.drives import of_drive
from jbw.observables.groups import beside_own, fractions_counted, single_records
from jbw.observables.observable import Observable, Theta

# name under which the random seed is passed among the parameters; no parameter has this name
SEED = "seed of the draw"


class RecordRows(NamedTuple):
    """The records of one part of the dataset, arranged like its residuals, group by group.

    Attributes:
        group: Number of the group of each record within the part.
        place: Number of each record within its group, from 1.
        num_repeats: Repeats of each record.
        within: Scatter of these repeats about their mean.
        rows: For every group its mean, then the deviations of its records; zero after the last.
    """

    group: Int[np.ndarray, " record"]
    place: Int[np.ndarray, " record"]
    num_repeats: Float[np.ndarray, " record"]
    within: Float[np.ndarray, " record"]
    rows: Float[np.ndarray, "group row value"]


class OfPart(NamedTuple):
    """The records of one part of the dataset: their names, and values at each draw."""

    name: list[str]
    group: list[str]  # label of each record's data group
    run: list[str]
    repeat: list[int]
    # log likelihood of each record in the values' unit [nats]
    log_likelihood: Float[np.ndarray, "draw record"]
    # Log likelihood of each record for a Gaussian about the mean of the repeats, without a model.
    reference: Float[np.ndarray, " record"]
    # rms of each record, divided by the rms of the mean of its group
    observed: Float[np.ndarray, " record"]
    predicted: Float[np.ndarray, "draw record"]


class RecordTerms(NamedTuple):
    """The log likelihood of each record of a dataset, with the other terms of the log density."""

    parts: tuple[OfPart, ...]
    # log density of estimates from before the fit [nats]
    known: dict[str, Float[np.ndarray, " draw"]]
    offsets: Float[np.ndarray, "draw run"] | None  # log density of the offsets of each run [nats]


def records_of(
    key: Key[Array, ""],
    theta: Mapping[str, Float[np.ndarray, " draw"]],
    noise: Mapping[str, Float[np.ndarray, " draw"]],
    data: Dataset,
) -> RecordTerms:
    """Return the log likelihood and the predicted relative rms of every record at every draw.

    Args:
        key: Random key for the offsets, the noise, and the chi-square of the predicted sizes.
        theta: Draws of the parameters by name.
        noise: Draws of every group's noise by its label, in the unit of its values.
        data: Dataset from which the posterior was made.
    """
    rows = tuple(None if part.groups.is_prior else record_rows(part) for part in data.parts)
    count = len(next(iter(theta.values())))
    keys = parts_of(key, 2)
    sums = at_points(_sums, {**theta, SEED: np.arange(float(count))}, (keys[0], data, rows))
    parts, densities = [], {}
    for i, (part, records, part_sums) in enumerate(
        zip(data.parts, rows, sums["parts"], strict=True)
    ):
        if records is None:
            densities |= {label: part_sums[:, g] for g, label in enumerate(part.groups.labels)}
        else:
            key_part = jax.random.fold_in(keys[1], i)
            parts.append(_of_part(key_part, part, records, part_sums, noise))
    return RecordTerms(tuple(parts), densities, sums.get("offsets"))


def record_rows(part: Observable) -> RecordRows:
    """Return the records of one part of the dataset, arranged like that part's residuals."""
    groups, mean = part.groups, np.asarray(part.mean)[:, None]
    single = single_records(mean[:, 0], groups)
    is_record = single.num_repeats > 0
    deviation = np.where(is_record[..., None], single.mean - mean, 0.0)
    compared = jax.vmap(part.compared, 1, 1)(np.concatenate([mean, deviation], axis=1))
    rows = np.concatenate([compared[:, :1], beside_own(compared[:, 1:], groups)], axis=1)
    group, place = np.nonzero(is_record)
    num_repeats, within = (x[is_record] for x in (single.num_repeats, single.within))
    return RecordRows(group, place + 1, num_repeats, within, rows)


def _solved(
    theta: Mapping[str, np.ndarray],
    task: tuple[Key[Array, ""], Dataset, tuple[Any, ...]],
    threads: int,
) -> Solved | None:
    """Return the residual sums of every dataset part, computed in advance at all draws."""
    key, data, rows = task
    point = {name: values for name, values in theta.items() if name != SEED}
    asked = [None if part_rows is None else part_rows.rows for part_rows in rows]
    if (solution := solved(point, data, threads, writes=False, rows=asked)) is None:
        return None
    nothing = jax.tree.map(lambda _: None, rows)
    return (key, solution[0], rows), (None, solution[1], nothing)


def _seen(
    task: tuple[Key[Array, ""], Dataset, tuple[Any, ...]],
) -> tuple[Key[Array, ""], Dataset, tuple[Any, ...]]:
    key, data, rows = task
    return key, unnamed(data), rows


@seeing(_seen)
@solved_first(_solved)
def _sums(theta: Theta, task: tuple[Key[Array, ""], Dataset, tuple[Any, ...]]) -> dict[str, Any]:
    """Return the residual sums of each dataset part at one draw, with random run offsets."""
    key, data, rows = task
    everything = {**data.held, **{name: x for name, x in theta.items() if name != SEED}}
    sums: dict[str, Any] = {}
    offset = None
    if data.has_offsets:
        own_key = jax.random.fold_in(key, theta[SEED].astype(int))
        spread = draw_offsets(own_key, estimates(everything, data), data.levels, data.scatters)
        offset = spread.offset
        std = spread.scatter[: offset.shape[1]]
        sums["offsets"] = jnp.sum(jax.scipy.stats.norm.logpdf(offset, 0.0, std), axis=1)
    order = list(dict.fromkeys(data.runs))
    parts = []
    for part, part_rows in zip(data.parts, rows, strict=True):
        numbers = np.array([order.index(run) for run in part.groups.runs])
        b = None if offset is None else offset[numbers]
        if part_rows is None:
            parts.append(_known(of_drive(everything, part.drive), part, b))
            continue
        square, products = part.residual_sums(of_drive(everything, part.drive), part_rows.rows, b)
        cross = products[part_rows.group, part_rows.place]
        parts.append((square[part_rows.group], cross, products[part_rows.group, 0]))
    return {**sums, "parts": parts}


def _known(theta: Theta, part: Observable, offset: Array | None) -> Float[Array, " group"]:
    """Return the log density of data groups with known covariance, for given offsets of runs."""
    free = part.estimate(theta, 0).log_density
    if offset is None:
        return free
    residual, directions = part.weighted(theta)
    moved = residual - jnp.einsum("gi,gin->gn", offset, directions)
    return free + 0.5 * (jnp.sum(residual**2, axis=1) - jnp.sum(moved**2, axis=1))


def _of_part(
    key: Key[Array, ""],
    part: Observable,
    records: RecordRows,
    sums: Sequence[Float[np.ndarray, "draw record"]],
    noise: Mapping[str, Float[np.ndarray, " draw"]],
) -> OfPart:
    """Return the log likelihood of each record in a part of the dataset, at each posterior draw."""
    groups, group, count = part.groups, records.group, records.num_repeats
    measured, deviation = records.rows[:, 0], records.rows[group, records.place]
    size, discrepancy = (np.asarray(x)[group] for x in (groups.size, groups.discrepancy))
    counted = fractions_counted(groups)
    fraction = np.array([counted[groups.labels[g]] for g in group])
    std = np.stack([noise[groups.labels[g]] for g in group], axis=-1)
    spread = np.sum(deviation**2, axis=1)
    square, cross, along = sums
    squares = count * (square + 2 * cross + spread) + records.within
    squares += size * count * discrepancy
    log_likelihood = -fraction * (
        size * count / 2 * np.log(2 * np.pi * std**2) + squares / (2 * std**2)
    )
    norm = np.sum(measured**2, axis=1)
    # The reference is a model-free density. Its variance is that between the repeats or, for a
    # single record, the mean square of the record. The ratio of the densities then has no unit.
    num_repeats, within = (np.asarray(x)[group] for x in (groups.num_repeats, groups.within))
    within = np.where(num_repeats > 1, within, norm[group])
    total = np.maximum(num_repeats - 1, 1)
    variance = within / (size * total)
    square_sum = count * spread + records.within
    reference = -fraction * (
        size * count / 2 * np.log(2 * np.pi * variance) + square_sum / (2 * variance)
    )
    own_norm = np.sum((measured[group] + deviation) ** 2, axis=1)
    observed = np.sqrt(own_norm / norm[group])
    # Noise has one component along the prediction, and N - 1 components orthogonal to it.
    model = np.maximum(norm[group] - 2 * along + square, 0.0)
    rng, mean_std = generator(key), std / np.sqrt(count)
    ahead = np.sqrt(model) + mean_std * rng.standard_normal(model.shape)
    across = rng.chisquare(np.maximum(size - 1, 1), model.shape)
    predicted = np.sqrt((ahead**2 + mean_std**2 * across) / norm[group])
    labels = [groups.labels[g] for g in group]
    repeat = np.where(np.bincount(group)[group] > 1, records.place, 0).tolist()
    names = [label if j == 0 else f"{label}, {j}" for label, j in zip(labels, repeat, strict=True)]
    runs = [groups.runs[g] for g in group]
    return OfPart(names, labels, runs, repeat, log_likelihood, reference, observed, predicted)
