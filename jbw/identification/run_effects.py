r"""Offsets of natural frequency and damping between the runs of a campaign.

A structure that is reassembled, warmed up or driven harder has another natural frequency. One
omega_n for all runs then gives residuals beyond noise, and intervals that are several times too
narrow. So every run's offset is estimated from the fit's residuals. If the offsets differ by more
than chance allows, each run gets a separate offset in the likelihood, with a scatter of that size.

Offsets that depend on the amplitude of the runs are no scatter: they are an error of the law. Their
trend is fitted by weighted least squares of the offsets on the size of the response. The scatter of
runs is estimated from the residual, with Student's t and two degrees of freedom fewer than runs:

$$b_r = a + s\,x_r + e_r, \qquad w_r = 1 / (\sigma_r^2 + \tau^2), \qquad
  \mathrm{se}(s)^2 = \frac{\sum_r w_r e_r^2}{(n - 2) \sum_r w_r (x_r - \bar x)^2}$$

Reference:
    DerSimonian and Laird (1986), Controlled Clinical Trials 7, 177, for tau.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from scipy import stats

from jbw.campaign.settings import Identify
from jbw.identification.accuracy import another_law, thinned
from jbw.inference.fit.costly_fit import residual_at
from jbw.inference.fit.fitting import Fit
from jbw.inference.groups.offsets import Estimate
from jbw.inference.groups.scatter import Levels, Spread, draw_offsets, scatter_grid
from jbw.inference.posterior.finding import Finding, checked
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.space.box import Box
from jbw.measurement.records import belongs_to
from jbw.observables.dataset import (
    Dataset,
    by_label,
    error_by_label,
    estimates_at,
    residual_by_label,
    stacked,
    with_directions,
)
from jbw.observables.dataset import sizes_of as sizes_of_groups
from jbw.observables.drives import plain
from jbw.observables.observable import OFFSETS, Observable, assemblies_of
from jbw.quantities import BY_NAME
from jbw.report.messages import sessions as messages

MOST_ALIKE = 1e12  # largest condition number of the correlations of one run's offsets
BY_CHANCE = 1e-3  # probability below which differences between runs count as real
# Limits of the relative standard deviations of omega_n and of zeta: smallest, largest.
LEAST, MOST = (1e-7, 1e-4), (1e-2, 0.5)
SAME_LEVEL = 1.1  # Runs whose responses have a smaller ratio than this are repeats of one level.
NO_SCATTER = 1e-12  # standard deviation for a quantity that is equal in all runs
NUM_DRAWS = 200
PLURAL = {"run": "runs", "assembly": "assemblies"}
Values = Float[np.ndarray, " run"]
FEWEST_RUNS = 5  # smallest number of runs that can show a trend
TREND_BY_CHANCE = 0.005  # largest p-value of each of the two trends, frequency and damping
QUANTITY_NAMES = {"omega_n": "natural frequency", "zeta": "damping ratio"}


@dataclass(frozen=True)
class Shifts:
    """Offsets of the runs, estimated from the residuals of a common fit."""

    runs: tuple[str, ...]
    # omega_n [rad/s] and zeta [-] of a run minus those of the fit
    offset: Float[np.ndarray, "run own"]
    std: Float[np.ndarray, "run own"]  # standard errors of `offset`
    p: float  # probability that chance causes offsets of this size


def shifts_of(best: Fit, names: tuple[str, ...], data: Dataset) -> Shifts | None:
    r"""Estimate the offsets of runs from the residuals of a fit without offsets.

    $$W_r = J_r^T J_r, \quad \hat b_r = W_r^{-1} J_r^T r, \quad
      \chi^2 = \sum_r (\hat b_r - \bar b)^T W_r (\hat b_r - \bar b)$$

    None if fewer than two runs determine their offsets.
    """
    # Each residual depends on one drive only, so that the sum over the drives is the derivative
    # with respect to the run's offset.
    columns = [[i for i, n in enumerate(names) if plain(n) == name] for name in OFFSETS]
    if not all(columns):
        return None
    residuals = by_label(best.residual, data)
    slope_of_all = np.stack([best.jacobian[:, indices].sum(axis=1) for indices in columns], axis=1)
    slopes = by_label(-slope_of_all, data)
    labels, size = data.shared_runs, len(OFFSETS)
    precision, pull = np.zeros((len(labels), size, size)), np.zeros((len(labels), size))
    for part in data.parts:
        for label, run in zip(part.groups.labels, part.groups.runs, strict=True):
            if not part.own_shifts:
                slope, number = slopes[label], labels.index(run)
                precision[number] += slope.T @ slope
                pull[number] += slope.T @ residuals[label]
    is_informed = np.array([tells_apart(matrix) for matrix in precision])
    if is_informed.sum() < 2:
        return None
    precision, pull = precision[is_informed], pull[is_informed]
    offset = np.linalg.solve(precision, pull[..., None])[..., 0]
    common = np.linalg.solve(precision.sum(axis=0), pull.sum(axis=0))
    apart = offset - common
    chi_square = float(np.einsum("ri,rij,rj->", apart, precision, apart))
    covariance = np.linalg.inv(precision)
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    dof = len(OFFSETS) * (int(is_informed.sum()) - 1)
    return Shifts(
        runs=tuple(name for name, informed in zip(labels, is_informed, strict=True) if informed),
        offset=offset,
        std=std,
        p=float(stats.chi2.sf(chi_square, dof)),
    )


def tells_apart(precision: Float[np.ndarray, "own own"]) -> bool:
    """Return whether a run determines both its frequency offset and its damping offset."""
    size = np.sqrt(np.diag(precision))
    return bool(np.all(size > 0) and np.linalg.cond(precision / np.outer(size, size)) < MOST_ALIKE)


def wanted(shifts: Shifts, settings: Identify) -> bool:
    """Return whether runs get offsets, because the campaign requires it or the data show them."""
    return settings.offsets == "runs" or (settings.offsets != "none" and shifts.p < BY_CHANCE)


def are_levels(data: Dataset) -> bool:
    """Return whether all runs are levels of one assembly: true if the campaign states no runs."""
    pairs = (
        (x, run)
        for part in data.parts
        for x, run in zip(part.groups.labels, part.groups.runs, strict=True)
    )
    return all(belongs_to(label, run) for label, run in pairs)


def scatter_of_repeats(shifts: Shifts, sizes: Mapping[str, float]) -> float | None:
    r"""Return the standard deviation of zeta between repeats of a level; 0 if chance explains it.

    $$Q = \sum_l \sum_{r \in l} \frac{(b_r - \bar b_l)^2}{\sigma_r^2}, \qquad
      \tau^2 = \frac{Q - \mathrm{dof}}{\sum_l (W_l - \sum_{r \in l} w_r^2 / W_l)}$$

    with $w_r = 1/\sigma_r^2$ and $W_l$ their sum over a level.

    Reference:
        DerSimonian and Laird (1986), Controlled Clinical Trials 7, 177, within levels.
    """
    zeta = OFFSETS.index("zeta")
    offset, std = shifts.offset[:, zeta], shifts.std[:, zeta]
    levels = [level for level in _levels_of(shifts.runs, sizes) if len(level) > 1]
    if not levels:
        return None
    dof = sum(len(level) - 1 for level in levels)
    moments = [moments_of(offset[level], std[level]) for level in levels]
    chi_square, scale = (sum(column) for column in zip(*moments, strict=True))
    if stats.chi2.sf(chi_square, dof) > BY_CHANCE:
        return 0.0
    return float(np.sqrt((chi_square - dof) / scale))


def moments_of(
    offset: Float[np.ndarray, " run"], std: Float[np.ndarray, " run"]
) -> tuple[float, float]:
    r"""Return chi-square of the runs' offsets, and its derivative with respect to their variance.

    $$Q = \sum_r w_r (b_r - \bar b)^2, \qquad W - \sum_r w_r^2 / W, \quad w_r = 1 / \sigma_r^2$$
    """
    weight = 1 / std**2
    chi_square = np.sum(weight * (offset - np.average(offset, weights=weight)) ** 2)
    return float(chi_square), float(weight.sum() - np.sum(weight**2) / weight.sum())


def _levels_of(runs: Sequence[str], sizes: Mapping[str, float]) -> list[list[int]]:
    """Return the indices of runs by level; runs with similar responses belong to one level."""
    measured = [number for number, run in enumerate(runs) if run in sizes]
    levels: list[list[int]] = []
    for number in sorted(measured, key=lambda number: sizes[runs[number]]):
        first = sizes[runs[levels[-1][0]]] if levels else 0.0
        if levels and sizes[runs[number]] <= SAME_LEVEL * first:
            levels[-1].append(number)
        else:
            levels.append([number])
    return levels


def sizes_of(data: Dataset) -> dict[str, float]:
    """Return the norm of each run's response, from the part of the data with the most runs."""
    sizes_of_parts = (sizes_of_runs(part) for part in data.parts if not part.own_shifts)
    return max(sizes_of_parts, key=len, default={})


def sizes_of_runs(part: Observable) -> dict[str, float]:
    """Return the norm of each run's response in one part of the data."""
    runs = dict(zip(part.groups.labels, part.groups.runs, strict=True))
    sizes: dict[str, list[float]] = {}
    for label, size in sizes_of_groups(part).items():
        sizes.setdefault(runs[label], []).append(size)
    return {run: float(np.mean(run_sizes)) for run, run_sizes in sizes.items()}


def damping_scatter(best: Fit, shifts: Shifts, data: Dataset) -> float | None:
    """Return zeta's relative sd between levels, estimated from repeats; None if runs are stated."""
    if not are_levels(data):
        return None
    repeats = scatter_of_repeats(shifts, sizes_of(data)) or 0.0
    return max(repeats / _centre(best)[1], NO_SCATTER)


def _centre(best: Fit) -> Float[np.ndarray, " own"]:
    """Return omega_n and zeta of a fit; if it has several drives, those of the first drive."""
    theta = {plain(name): value for name, value in reversed(best.theta.items())}
    return np.array([theta[name] for name in OFFSETS])


def with_offsets(best: Fit, shifts: Shifts, data: Dataset, median: float | None = None) -> Dataset:
    """Return the dataset with separate offsets for each run, as unknowns of least squares.

    In a fit without offsets, errors of omega_n hide differences of zeta, and the weights follow the
    misfit: their scatter can be estimated only if both are free (`with_scatter`). `median` is that
    of the prior of the scatter of omega_n, over omega_n; None for a wide prior. If runs are levels
    of one assembly, zeta scatters by an amount that is known beforehand (`damping_scatter`).
    """
    centre = _centre(best)
    of_levels = damping_scatter(best, shifts, data)
    ranges = (LEAST, MOST) if of_levels is None else ((end[0], of_levels) for end in (LEAST, MOST))
    least, most = (tuple(np.array(end) * centre) for end in ranges)
    offsets = dict(zip(shifts.runs, shifts.offset, strict=True))
    median_scatter = None if median is None else median * float(centre[0])
    nested = bool(assemblies_of(tuple(dict.fromkeys(data.runs))))
    return replace(
        with_directions(best.theta, data, offsets),
        scatters=jax.device_put(
            scatter_grid(least, most, assemblies=nested, medians=(median_scatter, None))
        ),
        scatter=jax.device_put(np.array(most)),
    )


def own_frequency_alone(data: Dataset) -> Dataset:
    """Return the dataset with a natural frequency for each run, and one damping ratio for all.

    It is used to score a law on a run: a separate damping ratio of the run would hide errors of the
    law.
    """
    if not data.has_offsets:
        return data
    scatter = np.array(data.scatter)
    scatter[OFFSETS.index("zeta")] *= NO_SCATTER
    return replace(data, scatter=jax.device_put(scatter))


def errors_with_own_frequency(fit: Fit, prior: Box, data: Dataset) -> dict[str, float]:
    """Return the relative errors of all data groups if each run has its own natural frequency."""
    scored = own_frequency_alone(data)
    residual = residual_by_label(residual_at(stacked, fit.x, prior, scored), scored)
    return error_by_label(residual, scored)


def with_scatter(key: Key[Array, ""], best: Fit, data: Dataset) -> Dataset:
    """Return the dataset with the standard deviations between runs, estimated from a fit.

    This is the root mean square of the scatter's density, because the likelihood integrates over
    it.
    """
    theta = {name: np.array([value]) for name, value in best.theta.items()}
    estimate = estimates_at(theta, data)  # This uses the program that was compiled for the draws.
    repeated = jax.tree.map(lambda x: np.repeat(x, NUM_DRAWS, axis=0), estimate)
    scatters = np.asarray(_drawn(jax.random.split(key, NUM_DRAWS), repeated, data).scatter)
    scatter = np.sqrt(np.mean(scatters[:, : len(OFFSETS)] ** 2, axis=0))
    return replace(data, scatter=jax.device_put(scatter))


def _drawn(keys: Key[Array, " draw"], estimate: Estimate, data: Dataset) -> Spread:
    """Draw all runs' offsets, and the standard deviations between runs, for each random key."""
    return _spreads(keys, jax.device_put(estimate), data.levels, data.scatters)


@eqx.filter_jit
def _spreads(
    keys: Key[Array, " draw"],
    estimate: Estimate,
    levels: Levels,
    scatters: Float[Array, "node level_own"],
) -> Spread:
    def spread_of(pair: tuple[Array, Estimate]) -> Spread:
        return draw_offsets(*pair, levels, scatters)

    return jax.lax.map(spread_of, (keys, estimate))


def sentence_of(shifts: Shifts, of_levels: float | None = None) -> str:
    """Return the sentence on differences between runs, with their variation between levels."""
    apart = shifts.offset[:, 0] - shifts.offset[:, 0].mean()
    offsets_hz = dict(zip(shifts.runs, (apart / (2 * np.pi)).tolist(), strict=True))
    return messages.differ(float(shifts.p), offsets_hz, _has_offsets(of_levels))


def _has_offsets(of_levels: float | None) -> str:
    if of_levels is None:
        return messages.OF_EACH_RUN
    return messages.SHARED_DAMPING if of_levels <= NO_SCATTER else messages.of_each_level(of_levels)


def runs_dataset(
    key: Key[Array, ""], posterior: xr.Dataset, names: tuple[str, ...], data: Dataset
) -> xr.Dataset | None:
    """Draw omega_n and zeta of every run, with their standard deviation; None without offsets.

    omega_n and zeta of the posterior are means of the population. One offset per run applies to all
    drives, each of which has separate values of a run. For each draw of the parameters, the scatter
    and the offsets are drawn from their density given the data: `spread_omega_n` and `spread_zeta`
    over runs, with the suffix `_assembly` over assemblies if there are any.
    """
    if not data.has_offsets:
        return None
    theta = thinned(posterior, names, NUM_DRAWS)
    num_draws = len(theta[names[0]])
    spread_draws = _drawn(jax.random.split(key, num_draws), estimates_at(theta, data), data)
    spread_draws = jax.tree.map(np.asarray, spread_draws)
    runs = list(dict.fromkeys(data.runs))
    centre = {**data.held, **theta}
    variables = {}
    for i, name in enumerate(OFFSETS):
        for offset_name in (parameter for parameter in centre if plain(parameter) == name):
            values_by_run = np.asarray(spread_draws.offset[:, :, i]) + np.reshape(
                centre[offset_name], (-1, 1)
            )
            attrs = {**BY_NAME[offset_name].attrs, "long_name": f"{offset_name} of each run"}
            variables[offset_name] = (("draw", "run"), values_by_run, attrs)
        unit = BY_NAME[name].unit
        for level, over in enumerate(list(PLURAL)[: spread_draws.scatter.shape[1] // len(OFFSETS)]):
            suffix = "" if over == "run" else f"_{over}"
            spread = np.asarray(spread_draws.scatter[:, len(OFFSETS) * level + i])
            attrs = {"units": unit, "long_name": f"sd of {name} over {PLURAL[over]}"}
            variables[f"spread_{name}{suffix}"] = ("draw", spread, attrs)
    return xr.Dataset(variables, {"run": runs, "draw": np.arange(num_draws)})


def runs_summary(runs: xr.Dataset) -> dict[str, dict[str, dict[str, float]]]:
    """Return mean, sd and 99 % interval of omega_n and zeta of each run."""
    rows = {}
    for name, values in runs.data_vars.items():
        by_run = (
            {"": values} if values.ndim == 1 else {r: values.sel(run=r) for r in runs.run.values}
        )
        rows[str(name)] = {str(key): _row(draws.values) for key, draws in by_run.items()}
    return rows


def _row(draws: Float[np.ndarray, " draw"]) -> dict[str, float]:
    numbers = (draws.mean(), draws.std(ddof=1), *np.quantile(draws, QUANTILES))
    return dict(zip(("mean", "sd", "q005", "median", "q995"), map(float, numbers), strict=True))


def runs_sentence(runs: xr.Dataset) -> str:
    """Return the sentence on the variation of omega_n between runs."""
    scatters = []
    for over, plural in PLURAL.items():
        name = "spread_omega_n" + ("" if over == "run" else f"_{over}")
        if name in runs:
            low, middle, high = np.quantile(runs[name].values, QUANTILES) / (2 * np.pi)
            scatters.append(messages.scatter((low, middle, high), plural))
    return messages.population_mean(scatters)


def slope_of(x: Values, offset: Values, std: Values) -> tuple[float, float, float]:
    """Fit a slope by weighted least squares to offsets that vary beyond their errors.

    With equal errors it is the ordinary least-squares slope. The result is the slope, its standard
    error, and the probability of such a slope by chance.
    """
    chi_square, scale = moments_of(offset, std)
    # the variance between runs beyond their standard errors
    variance = max(0.0, (chi_square - (len(offset) - 1)) / scale)
    weight = 1 / (std**2 + variance)
    middle = np.average(x, weights=weight)
    spread = np.sum(weight * (x - middle) ** 2)
    value = float(np.sum(weight * (x - middle) * offset) / spread)
    residual = offset - np.average(offset, weights=weight) - value * (x - middle)
    dof = len(x) - 2
    error = float(np.sqrt(np.sum(weight * residual**2) / dof / spread))
    return value, error, float(2 * stats.t.sf(abs(value) / error, dof))


def trend_finding(shifts: Shifts, data: Dataset) -> Finding | None:
    """Return the finding on whether run offsets depend on amplitude; None with too few runs."""
    sizes = sizes_of(data)
    indices = [i for i, name in enumerate(shifts.runs) if name in sizes]
    x = np.array([sizes[shifts.runs[i]] for i in indices])
    if len(indices) < FEWEST_RUNS or np.ptp(x) <= 0:
        return None
    # the slope is then the change from the smallest to the largest amplitude
    x = (x - x.min()) / np.ptp(x)
    slopes = {
        name: slope_of(x, shifts.offset[indices, i], shifts.std[indices, i])
        for i, name in enumerate(OFFSETS)
    }
    name = min(slopes, key=lambda name: slopes[name][-1])
    slope, error, p = slopes[name]
    scale, unit = (1 / (2 * np.pi), "Hz") if name == "omega_n" else (100.0, "% of critical damping")
    values = {
        "quantity": QUANTITY_NAMES[name], "count": len(indices), "change": scale * slope,
        "std": scale * error, "unit": unit, "p": p,
    }  # fmt: skip
    remedy = {"another_law": another_law(data.laws)}
    return checked("level_trend", p >= TREND_BY_CHANCE, values, p, remedy)
