r"""Every record of a dataset by itself: its log likelihood, and its size as the draws predict it.

The joint posterior integrates noise and offsets out. Given a draw of them too, records are
independent, and what a record says is

$$\log p(d_j | \theta, b, \sigma) = -\frac{n_j}{2} \log 2\pi\sigma^2 - \frac{f\,Q_j}{2\sigma^2},
  \qquad Q_j = K_j\,|\bar d_j - m - J^T b|^2 + S_j + N K_j \tau^2, \qquad n_j = f N K_j$$

of N values each, of which the fraction f is independent, in K_j repeats of scatter S_j (the periods
of a multisine; else one, and none). This is what leaving out one record asks for. The repeats of a
group share one prediction m, so that one solve a draw is enough for all of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from numpy.typing import NDArray

from jbw.inference.generator import generator, parts_of
from jbw.inference.groups.scatter import draw_offsets
from jbw.inference.lanes import Solved, at_points, num_cores, seeing, solved_first
from jbw.observables.dataset import Dataset, as_arrays, estimates, solved, unnamed
from jbw.observables.drives import of_part
from jbw.observables.groups import beside_own, fractions_counted
from jbw.observables.observable import Observable, Theta, alone

SEED = "seed of the draw"  # beside the parameters, of which none is called so


class Split(NamedTuple):
    """Records of one part, rows of values as its misfit has them.

    Records that cannot be had alone stand together, as their group.
    """

    group: Int[np.ndarray, " record"]  # number of its group within the part
    repeat: Int[np.ndarray, " record"]  # from 1; 0 for a whole group
    deviation: Float[np.ndarray, "record value"]  # its mean less that of the group
    num_repeats: Float[np.ndarray, " record"]
    within: Float[np.ndarray, " record"]  # scatter about its own mean
    measured: Float[np.ndarray, "group value"]  # mean of every group


Splits = tuple[Split | None, ...]  # None for a part that is a prior, read off a record before


class OfPart(NamedTuple):
    """Records of one part: names, and a row of draws each."""

    name: list[str]
    group: list[str]  # label of the group
    run: list[str]
    repeat: list[int]
    log_likelihood: Float[np.ndarray, "draw record"]  # [nats], in the values' unit
    reference: Float[np.ndarray, " record"]  # the same about the mean of its repeats, see below
    observed: Float[np.ndarray, " record"]  # root mean square over that of the group's mean
    predicted: Float[np.ndarray, "draw record"]


class RecordTerms(NamedTuple):
    """Records of a dataset, part by part, and what stands beside them in a density."""

    parts: tuple[OfPart, ...]
    known: dict[str, Float[np.ndarray, " draw"]]  # of what was read off a record before [nats]
    offsets: Float[np.ndarray, "draw run"] | None  # log density of every run's [nats]


def records_of(
    key: Key[Array, ""],
    theta: Mapping[str, Float[np.ndarray, " draw"]],
    noise: Mapping[str, Float[np.ndarray, " draw"]],
    data: Dataset,
    splits: Splits,
) -> RecordTerms:
    """All records at every draw.

    Args:
        key: Of the offsets, the noise and the chi-square of the predicted sizes.
        theta: Draws of the parameters by name.
        noise: Draws of every group's noise by its label, in the unit of its values.
        data: What the posterior was made from.
        splits: From `splits_of`.
    """
    rows = tuple(None if split is None else _factors(split) for split in splits)
    count = len(next(iter(theta.values())))
    keys = parts_of(key, 2)
    sums = at_points(_sums, {**theta, SEED: np.arange(float(count))}, (keys[0], data, rows))
    split_parts, densities = [], {}
    for i, (part, split, part_sums) in enumerate(
        zip(data.parts, splits, sums["parts"], strict=True)
    ):
        if split is None:
            densities |= {label: part_sums[:, g] for g, label in enumerate(part.groups.labels)}
        else:
            split_parts.append(
                _of_part(jax.random.fold_in(keys[1], i), part, split, part_sums, noise)
            )
    return RecordTerms(tuple(split_parts), densities, sums.get("offsets"))


def splits_of(
    theta: Mapping[str, float], data: Dataset, alone: Sequence[Sequence[Observable]]
) -> Splits:
    """The records of every part, by the same tests reduced from their first records, second, ...

    Misfits are linear in the means: any point `theta` where the model can be solved will do.
    """
    everything = as_arrays(theta, data)
    return tuple(_split(part, of_part(everything, part), alone) for part in data.parts)


def _split(part: Any, theta: Theta, repeat_parts: Sequence[Sequence[Any]]) -> Split | None:
    if part.groups.is_prior:
        return None
    groups, measured = part.groups, np.asarray(part.compared(part.mean))
    if not np.any(np.asarray(groups.num_repeats) > 1):  # every group is one record
        group, one = np.arange(len(measured)), np.ones(len(measured))
        same, within = np.zeros_like(measured), np.asarray(groups.within)
        return Split(group, 0 * group, same, one, within, measured)
    part = _solved_at(theta, part)
    centre = np.asarray(_left(theta, alone(part)))
    splits_by_group: list[list[tuple[int, NDArray[np.float64], float, float]]] = [
        [] for _ in groups.labels
    ]
    for j, parts in enumerate(repeat_parts, start=1):
        mean, singles = np.array(part.mean), {}
        for g, label in enumerate(groups.labels):
            if (single := _single(label, float(groups.size[g]), part, parts)) is not None:
                row, singles[g] = single
                mean[g] = np.pad(row, (0, mean.shape[1] - len(row)))
        if singles:
            elsewhere = replace(part, mean=jax.device_put(mean))
            moved = np.asarray(_left(theta, alone(elsewhere))) - centre
            for g, numbers in singles.items():
                splits_by_group[g].append((j, moved[g], *numbers))
    rows = []
    for g, group_splits in enumerate(splits_by_group):
        total = float(groups.num_repeats[g])
        if len(group_splits) > 1 and sum(record_split[2] for record_split in group_splits) == total:
            rows += [(g, *record_split) for record_split in group_splits]
        else:  # a single record, or one that cannot be split
            rows.append((g, 0, np.zeros(measured.shape[1]), total, float(groups.within[g])))
    group, repeat, deviation, num_repeats, within = (
        np.asarray(column) for column in zip(*rows, strict=True)
    )
    return Split(group, repeat, deviation, num_repeats, within, measured)


def _solved_at(theta: Theta, part: Any) -> Any:
    """A part with its responses at one point, whatever its means are; or as it is."""
    point = {name: np.array([float(x)]) for name, x in theta.items()}
    if (solved_part := part.solved(point, num_cores(), writes=True)) is None:
        return part
    return replace(
        solved_part,
        solution=jax.tree.map(lambda x: jax.device_put(np.asarray(x)[0]), solved_part.solution),
    )


@eqx.filter_jit
def _left(theta: Theta, part: Observable) -> Float[Array, "group value"]:
    return beside_own(part.misfit(theta), part.groups)


def _single(
    label: str, size: float, part: Any, parts: Sequence[Any]
) -> tuple[NDArray[Any], tuple[float, float]] | None:
    """Mean, repeats and scatter of a group's record alone; None where it has other values."""
    for candidate in parts:
        groups = candidate.groups
        if type(candidate) is type(part) and label in groups.labels:
            i, row = groups.labels.index(label), np.asarray(candidate.mean)
            if row.shape[1] <= part.mean.shape[1] and float(groups.size[i]) == size:
                numbers = groups.num_repeats[i], groups.within[i]
                return row[i], (float(numbers[0]), float(numbers[1]))
    return None


class DeviationRows(NamedTuple):
    """What the misfits of a part's groups are multiplied with.

    Attributes:
        group: Number of each record's group.
        place: Where the record's own deviation stands among the rows of its group.
        rows: Of every group its mean, then the deviations of its records; zero behind the last.
    """

    group: Int[np.ndarray, " record"]
    place: Int[np.ndarray, " record"]
    rows: Float[np.ndarray, "group row value"]


def _factors(split: Split) -> DeviationRows:
    """A split's rows, group by group."""
    place = np.array([np.sum(split.group[:i] == g) + 1 for i, g in enumerate(split.group)])
    rows = np.zeros((len(split.measured), 1 + int(np.max(place)), split.measured.shape[1]))
    rows[:, 0] = split.measured
    rows[split.group, place] = split.deviation
    return DeviationRows(split.group, place, rows)


def _solved(
    theta: Mapping[str, np.ndarray],
    task: tuple[Key[Array, ""], Dataset, tuple[Any, ...]],
    threads: int,
) -> Solved | None:
    """The sums of every part at draws, with the rows that its records ask for."""
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
    """What programs see of the task: a dataset without names."""
    key, data, rows = task
    return key, unnamed(data), rows


@seeing(_seen)
@solved_first(_solved)
def _sums(theta: Theta, task: tuple[Key[Array, ""], Dataset, tuple[Any, ...]]) -> dict[str, Any]:
    """What every part is asked at one draw, by one solve, each run's offsets drawn beside it."""
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
            parts.append(_known(of_part(everything, part), part, b))
            continue
        square, products = part.residual_sums(of_part(everything, part), part_rows.rows, b)
        cross = products[part_rows.group, part_rows.place]
        parts.append(
            {
                "square": square[part_rows.group],
                "cross": cross,
                "along": products[part_rows.group, 0],
            }
        )
    return {**sums, "parts": parts}


def _known(theta: Theta, part: Observable, offset: Array | None) -> Float[Array, " group"]:
    """Log density of groups whose covariance is known, at their run's offsets."""
    free = part.estimate(theta, 0).log_density
    if offset is None:
        return free
    residual, directions = part.weighted(theta)
    moved = residual - jnp.einsum("gi,gin->gn", offset, directions)
    return free + 0.5 * (jnp.sum(residual**2, axis=1) - jnp.sum(moved**2, axis=1))


def _of_part(
    key: Key[Array, ""],
    part: Observable,
    split: Split,
    sums: Mapping[str, Float[np.ndarray, "draw record"]],
    noise: Mapping[str, Float[np.ndarray, " draw"]],
) -> OfPart:
    """Records of a part from what it was asked at the draws."""
    groups, group, count = part.groups, split.group, split.num_repeats
    size, discrepancy = (np.asarray(x)[group] for x in (groups.size, groups.discrepancy))
    counted = fractions_counted(groups)
    fraction = np.array([counted[groups.labels[g]] for g in group])
    std = np.stack([noise[groups.labels[g]] for g in group], axis=-1)
    spread = np.sum(split.deviation**2, axis=1)
    squares = count * (sums["square"] + 2 * sums["cross"] + spread) + split.within
    squares += size * count * discrepancy
    log_likelihood = -fraction * (
        size * count / 2 * np.log(2 * np.pi * std**2) + squares / (2 * std**2)
    )
    norm = np.sum(split.measured**2, axis=1)
    # What no model knows, at the scatter of the repeats: a density has a unit, and a ratio none.
    # Alone, a record has no scatter: its size stands in.
    num_repeats, within = (np.asarray(x)[group] for x in (groups.num_repeats, groups.within))
    within = np.where(num_repeats > 1, within, norm[group])
    total = np.maximum(num_repeats - 1, 1)
    variance = within / (size * total)
    square_sum = count * spread + split.within
    reference = -fraction * (
        size * count / 2 * np.log(2 * np.pi * variance) + square_sum / (2 * variance)
    )
    own_norm = np.sum((split.measured[group] + split.deviation) ** 2, axis=1)
    observed = np.sqrt(own_norm / norm[group])
    # Noise along the prediction and across it: N - 1 directions more.
    model = np.maximum(norm[group] - 2 * sums["along"] + sums["square"], 0.0)
    rng, mean_std = generator(key), std / np.sqrt(count)
    ahead = np.sqrt(model) + mean_std * rng.standard_normal(model.shape)
    across = rng.chisquare(np.maximum(size - 1, 1), model.shape)
    predicted = np.sqrt((ahead**2 + mean_std**2 * across) / norm[group])
    labels = [groups.labels[g] for g in group]
    repeat = split.repeat.tolist()
    names = [label if j == 0 else f"{label}, {j}" for label, j in zip(labels, repeat, strict=True)]
    runs = [groups.runs[g] for g in group]
    return OfPart(names, labels, runs, repeat, log_likelihood, reference, observed, predicted)
