"""The data of a campaign, from all kinds of tests, with their joint likelihood.

The residual is a dictionary of rows, with the labels of groups and of the runs' offsets as keys.
Optimisers take its rows end to end; only `stacked` makes that array and only `by_label` reads it
back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.groups.offsets import Estimate, run_numbers, shrunk
from jbw.inference.groups.scatter import Levels, log_density_of_offsets
from jbw.inference.lanes import LANES, Solved, at_points, seeing, solved_first
from jbw.inference.space.stated import StatedDensities, log_over_uniform, standard_scores
from jbw.observables import remembered
from jbw.observables.drives import of_drive
from jbw.observables.groups import Row, in_units, sizes
from jbw.observables.modes import Modes
from jbw.observables.observable import OFFSETS, Observable, Theta, assemblies_of, numbers_of
from jbw.observables.observable import unnamed as nameless

# Grid of standard deviations of the natural frequency between records, relative to omega_n. The
# prior is uniform in their logarithm.
SCATTERS = np.geomspace(1e-8, 1e-2, 25)

Block = tuple[Float[Array, "_group _value"], Float[Array, "_group own _value"]]
Residual = dict[str, Float[Array, " value"]]


class Dataset(eqx.Module):
    """The data of the joint posterior, with fixed parameters, variation between runs, and priors.

    Attributes:
        parts: The reduced data of each kind of test.
        held: Values of fixed parameters, by name; all other parameters are inferred.
        scatters: Nodes of the prior for the scatter between runs of omega_n [rad/s] and zeta [-],
            and for that between assemblies, if there are any; no columns if runs have no offsets.
        scatter: Scatter that least squares assumes.
        stated: Prior densities that a campaign states in addition to the box.
    """

    parts: tuple[Observable, ...]
    held: dict[str, Float[Array, ""]]
    scatters: Float[Array, "node level_own"]
    scatter: Float[Array, " own"]
    stated: StatedDensities = StatedDensities()

    @classmethod
    def of(
        cls,
        parts: Sequence[Observable],
        held: Mapping[str, float] | None = None,
        stated: StatedDensities | None = None,
    ) -> Self:
        """Build a dataset from its parts, without run offsets; parameters in `held` are fixed."""
        fixed = {name: jax.device_put(np.float64(value)) for name, value in (held or {}).items()}
        nodes, scatter = jax.device_put(np.zeros((1, 0))), jax.device_put(np.zeros(0))
        return cls(tuple(parts), fixed, nodes, scatter, stated or StatedDensities())

    @property
    def laws(self) -> tuple[str, ...]:
        """The names of the joint's laws."""
        return self.parts[0].laws

    @property
    def modes(self) -> Modes | None:
        """The modes that move the joint; None for a single mode."""
        return self.parts[0].modes

    @property
    def labels(self) -> tuple[str, ...]:
        """The label of each data group, in the order of the likelihood's terms."""
        return tuple(label for part in self.parts for label in part.groups.labels)

    @property
    def runs(self) -> tuple[str, ...]:
        """The name of the run of each data group."""
        return tuple(run for part in self.parts for run in part.groups.runs)

    @property
    def has_offsets(self) -> bool:
        """Whether omega_n and zeta have an offset in each run."""
        return self.scatters.shape[1] > 0

    @property
    def stepped(self) -> bool:
        """Whether the likelihood integrates the equation of motion in time."""
        return any(part.stepped for part in self.parts)

    @property
    def num_offsets(self) -> int:
        """The number of offsets per run."""
        return len(OFFSETS) if self.has_offsets else 0

    @property
    def levels(self) -> Levels:
        """The run index of each data group and, if assemblies vary, each run's assembly index."""
        assemblies = assemblies_of(tuple(dict.fromkeys(self.runs)))
        if self.scatters.shape[1] == 2 * len(OFFSETS):
            return run_numbers(self.runs), assemblies
        return (run_numbers(self.runs),)

    @property
    def shared_runs(self) -> tuple[str, ...]:
        """The names, each once, of the runs whose offsets are unknowns of least squares."""
        shared = (part.groups.runs for part in self.parts if not part.own_shifts)
        return tuple(dict.fromkeys(run for runs in shared for run in runs))

    @property
    def layout(self) -> dict[str, int]:
        """The number of residuals of each data group by label, in the order of `stacked`."""
        rows = {label: part.groups.width for part in self.parts for label in part.groups.labels}
        stated = {_prior_key(name): 1 for name in self.stated.names}
        if not self.has_offsets:
            return rows | stated
        return rows | {_offsets_key(run): len(OFFSETS) for run in self.shared_runs} | stated


def _offsets_key(run: str) -> str:
    return f"offsets of {run}"


def _prior_key(name: str) -> str:
    return f"prior of {name}"


def unnamed(data: Dataset) -> Dataset:
    """Return the dataset with numbers instead of names of groups and runs, for compiled programs.

    A program that another campaign compiled then serves this one, if laws, shapes and settings are
    equal.
    """
    numbers = numbers_of(data.labels, data.runs)
    stated = replace(data.stated, texts=())
    return replace(data, parts=tuple(nameless(x, *numbers) for x in data.parts), stated=stated)


def solved(
    theta: Mapping[str, Float[np.ndarray, " point"]],
    data: Dataset,
    threads: int,
    *,
    writes: bool,
    # for each part of the dataset, arrays by which its residuals are multiplied and summed
    rows: Sequence[Float[np.ndarray, "_ _ _"] | None] | None = None,
) -> Solved | None:
    """Compute a dataset's costly predictions at parameter points in advance; None if impossible.

    This combines `Observable.solved` of all parts, each with its own `rows`.
    """
    size = len(next(iter(theta.values())))
    held = {name: np.full(size, float(value)) for name, value in data.held.items()}
    everything = {**held, **theta}
    of_parts = zip(data.parts, rows or [None] * len(data.parts), strict=True)
    parts = [
        part.solved(of_drive(everything, part.drive), threads, writes=writes, rows=part_rows)
        for part, part_rows in of_parts
    ]
    solved_parts = [i for i, part in enumerate(parts) if part is not None]
    if not solved_parts:
        return None
    pairs = zip(parts, data.parts, strict=True)
    complete = replace(data, parts=tuple(old if new is None else new for new, old in pairs))
    is_solved = eqx.tree_at(
        lambda tree: [tree.parts[i].solution for i in solved_parts],
        jax.tree.map(lambda _: False, complete),
        replace_fn=lambda solution: jax.tree.map(lambda _: True, solution),
    )
    solutions, rest = eqx.partition(complete, is_solved)
    return rest, solutions


@seeing(unnamed)
@solved_first(partial(solved, writes=False))
def log_likelihood(theta: Theta, data: Dataset) -> Float[Array, " term"]:
    """Return the log likelihood, eqs. (36), (37): one term per data group, then those of offsets.

    The noise of every group and the offsets are integrated out; the result is up to a constant
    [nats]. The last terms are the prior densities that a campaign states, each relative to the
    uniform density of the box.
    """
    everything = {**data.held, **theta}
    stated = log_over_uniform(everything, data.stated)
    if data.has_offsets:
        offset_estimates = estimates(everything, data)
        offsets = log_density_of_offsets(offset_estimates, data.levels, data.scatters)
        return jnp.concatenate([offset_estimates.log_density, jnp.atleast_1d(offsets), stated])
    of_parts = [part.estimate(of_drive(everything, part.drive), 0) for part in data.parts]
    pairs = zip(data.parts, of_parts, strict=True)
    shifts = [_density_of_shifts(everything, found) for part, found in pairs if part.own_shifts]
    return jnp.concatenate([*(found.log_density for found in of_parts), *shifts, stated])


def _density_of_shifts(theta: Theta, found: Estimate) -> Float[Array, "1"]:
    r"""Return the log density of records' frequency shifts, integrated over their unknown variance.

    It is $\log \int p(s) \prod_i N(\hat\delta_i; 0, s^2 + e_i^2)\,ds$.

    Factors that the estimates already contain are omitted.
    """
    each_its_own = tuple(range(len(found.log_density)))
    scatters = SCATTERS[:, None] * theta["omega_n"]
    return log_density_of_offsets(found, (each_its_own,), scatters)[None]


def estimates(theta: Theta, data: Dataset) -> Estimate:
    """Estimate each run's offsets from each of the run's data groups, at given parameters."""
    part_estimates = [
        part.estimate(of_drive(theta, part.drive), data.num_offsets) for part in data.parts
    ]
    return Estimate(*(jnp.concatenate(rows) for rows in zip(*part_estimates, strict=True)))


def estimates_at(
    theta: Mapping[str, Float[np.ndarray, " point"]], data: Dataset, *, lanes: int = LANES
) -> Estimate:
    """Return the estimated run offsets at many parameter points; the first axis is the point."""
    return at_points(_estimates, theta, data, lanes=lanes)


@seeing(unnamed)
@solved_first(partial(solved, writes=False))
def _estimates(theta: Theta, data: Dataset) -> Estimate:
    return estimates({**data.held, **theta}, data)


def residual(theta: Theta, data: Dataset) -> Residual:
    """Return normalised residuals by label, eqs. (38), (41), (42), with optimal run offsets.

    Rows `offsets of RUN` are each run's offsets divided by their scatter; rows `prior of NAME` are
    the standard normal scores of stated priors.
    """
    everything = {**data.held, **theta}
    rows, offsets = _offsets_taken_out(_weighted(everything, data), data)
    labelled = {
        label: row
        for part, block in zip(data.parts, rows, strict=True)
        for label, row in zip(part.groups.labels, block, strict=True)
    }
    scores = standard_scores(everything, data.stated)
    return (
        labelled
        | {_offsets_key(run): row for run, row in offsets.items()}
        | {_prior_key(name): score for name, score in scores.items()}
    )


def _weighted(theta: Theta, data: Dataset) -> list[Block]:
    return [part.weighted(of_drive(theta, part.drive)) for part in data.parts]


def _offsets_taken_out(
    blocks: Sequence[Block], data: Dataset
) -> tuple[list[Float[Array, "_group _value"]], dict[str, Float[Array, " own"]]]:
    """Return residuals without the runs' optimal offsets, and the scaled offsets."""
    rows = [block[0] for block in blocks]
    shared = [i for i, part in enumerate(data.parts) if not part.own_shifts]
    if not (data.has_offsets and shared):
        return rows, {}
    numbers = run_numbers(tuple(run for i in shared for run in data.parts[i].groups.runs))
    shrunk_rows, offsets = shrunk(
        [rows[i] for i in shared], [blocks[i][1] for i in shared], numbers, data.scatter
    )
    for i, block in zip(shared, shrunk_rows, strict=True):
        rows[i] = block
    return rows, dict(zip(data.shared_runs, offsets, strict=True))


@seeing(unnamed)
@solved_first(partial(solved, writes=True))
def stacked(theta: Theta, data: Dataset) -> Float[Array, " values"]:
    """Return all residuals as one array, as least squares needs them."""
    rows = residual(theta, data)
    return jnp.concatenate([rows[key] for key in data.layout])


def by_label(
    rows: Float[np.ndarray, " values ..."], data: Dataset
) -> dict[str, Float[np.ndarray, " value ..."]]:
    """Split a residual or Jacobian of all data groups into one array per data group, by label."""
    ends = np.cumsum(list(data.layout.values()))[:-1]
    return dict(zip(data.layout, np.split(np.asarray(rows), ends), strict=True))


def halved(data: Dataset) -> Dataset | None:
    """Return the dataset with half the time step; None if no prediction is integrated over time."""
    # Without a joint law, a step of any length is exact.
    finer = [part.laws and part.substeps for part in data.parts]
    if not any(finer):
        return None
    pairs = zip(data.parts, finer, strict=True)
    return replace(data, parts=tuple(replace(x, substeps=2 * n) if n else x for x, n in pairs))


def remembering(theta: Mapping[str, float], data: Dataset) -> Dataset:
    """Return the dataset with enough memory for all load reversals at a parameter point."""
    everything = as_arrays(theta, data)
    parts = tuple(remembered.remembering(everything, part) for part in data.parts)
    same = all(new is old for new, old in zip(parts, data.parts, strict=True))
    return data if same else replace(data, parts=parts)


def largest_displacement(data: Dataset, omega_n: float) -> float:
    """Return the largest measured displacement of a dataset [m]."""
    return max((part.shown(omega_n).y_peak for part in data.parts), default=0.0)


def smallest_displacement(data: Dataset, omega_n: float) -> float:
    """Return the largest displacement [m] of the weakest data group; 0 if unknown.

    In each kind, the largest displacement belongs to the group with the strongest response and is
    scaled by the sizes of the responses.
    """
    peaks = []
    for part in data.parts:
        if part.groups.is_prior:
            continue
        sizes = [size for size in sizes_of(part).values() if size > 0]
        if sizes and (peak := part.shown(omega_n).y_peak) > 0:
            peaks.append(peak * min(sizes) / max(sizes))
    return float(min(peaks, default=0.0))


def best_offsets(theta: Mapping[str, float], data: Dataset) -> dict[str, np.ndarray]:
    """Return the optimal offsets of omega_n and zeta for each run that has offsets."""
    point = {name: np.array([float(value)]) for name, value in theta.items()}
    scaled, scatter = at_points(_scaled_offsets, point, data, lanes=1), np.asarray(data.scatter)
    return {run: rows[0] * scatter for run, rows in zip(data.shared_runs, scaled, strict=True)}


@seeing(unnamed)
@solved_first(partial(solved, writes=True))
def _scaled_offsets(theta: Theta, data: Dataset) -> list[Float[Array, " own"]]:
    """Return each run's optimal offsets in standard deviations, in the order of the runs."""
    return list(_offsets_taken_out(_weighted({**data.held, **theta}, data), data)[1].values())


def with_directions(
    theta: Mapping[str, float],
    data: Dataset,
    offsets: Mapping[str, Float[np.ndarray, " own"]] | None = None,
) -> Dataset:
    """Return the dataset with its predictions' derivatives with respect to each run's offsets."""
    everything = as_arrays(theta, data)
    parts = tuple(
        p if p.own_shifts else p.linearised(of_drive(everything, p.drive), offsets or {})
        for p in data.parts
    )
    return replace(data, parts=parts)


def as_arrays(theta: Mapping[str, float], data: Dataset) -> dict[str, Array]:
    """Return all parameters, also fixed ones, as arrays, so that programs do not contain values."""
    return {**data.held, **jax.device_put({n: np.asarray(x, float) for n, x in theta.items()})}


def residual_by_label(rows: Float[np.ndarray, " values"], data: Dataset) -> dict[str, Row]:
    """Return a residual, or a Jacobian's column, by data group and in the unit of its values."""
    labelled = by_label(rows, data)
    rows_by_part = [in_units(labelled, part.groups) for part in measured_parts(data)]
    return {label: row for part_rows in rows_by_part for label, row in part_rows.items()}


def measured_parts(data: Dataset) -> list[Observable]:
    """Return those parts of the dataset that are records; omit prior estimates."""
    return [part for part in data.parts if not part.groups.is_prior]


def sizes_of(part: Observable) -> dict[str, float]:
    """Return the norm of each data group's mean in one part of the dataset, by label."""
    return dict(zip(part.groups.labels, sizes(part.mean, part.groups).tolist(), strict=True))


def size_by_label(data: Dataset) -> dict[str, float]:
    """Return the norm of each measured data group's mean, by label."""
    return {x: size for part in measured_parts(data) for x, size in sizes_of(part).items()}


def error_by_label(residuals: Mapping[str, Row], data: Dataset) -> dict[str, float]:
    """Return each data group's relative error: norm of its residual / norm of its mean."""
    sizes = size_by_label(data)
    return {label: float(np.linalg.norm(residuals[label])) / size for label, size in sizes.items()}
