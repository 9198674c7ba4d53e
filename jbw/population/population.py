r"""`jbw.population_of`: the mean, the variation and the trends of a fleet's units.

Whether a unit belongs to the population is judged by the population of all other units. For a given
covariance T between units, the line of all units but k has a normal posterior in closed form, and
so has the predicted summary of unit k,

$$m_k\,|\,T, m_{-k} \sim N(x_k B_{-k},\ S_k), \qquad S_k = T + C_k + x_k P_{-k}^{-1} x_k^T, \qquad
  P_k = E\big[P(\chi^2_d > r^T S_k^{-1} r)\,\big|\,m_{-k}\big]$$

with r the deviation of the unit from its prediction. Draws of T are those from all units, each with
the weight $1/p(m_k | T, m_{-k})$, where a Pareto tail smooths the weights. If a unit may not
belong, or if that tail is too heavy, the population without it is sampled, from normal summaries:
draws of a T that one unit made large hardly reach the values of T without that unit.

All results are in numbers, as stored in `population.json`, and in sentences about them.

Reference:
    Vehtari, Gelman and Gabry (2017), Statistics and Computing 27, 1413.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from scipy.special import softmax
from scipy.stats import chi2

from jbw.errors import ConfigError, DataError
from jbw.inference.posterior.summary import QUANTILES
from jbw.inference.samplers.importance import smooth
from jbw.inference.space.box import require_float64
from jbw.oscillator.laws import laws_named
from jbw.parts import Parts, unkept
from jbw.population.coordinates import (
    Pooled,
    laws_of,
    monomials_of,
    parameters_of,
    pooled,
    unit_names,
    units_of_fleet,
)
from jbw.population.model import FULL, ROUGH, UnitPosteriors, log_weights, sampler
from jbw.population.prior import (
    TORQUE,
    WRENCH,
    CovariateDesign,
    Prior,
    design_of,
    precision_of,
    prior_of,
)
from jbw.population.trend import bent, expected, mask_of
from jbw.population.unit import GAIN
from jbw.report.messages import population as messages
from jbw.results.attributes import StoredFleet
from jbw.results.population import StoredPopulation

logger = logging.getLogger("jbw")
Report = Callable[[str], None]
HEAVY = 0.7  # Weights of draws are unreliable if their Pareto k-hat exceeds this.
# If the probability that a unit belongs to the population exceeds this, the unit is not examined
# further. A unit that is far off in one coordinate enlarges the covariance T itself, and so lies at
# chi-square = d - 1 + n, which has a probability of 0.2 or less.
BEYOND_DOUBT = 0.3
# If the probability that a unit belongs to the population is below this, the population without the
# unit is sampled again even if k-hat is small: k-hat does not show that chains have missed a tail.
DOUBTFUL = 0.05
# numbers of warm-up steps, draws and chains for a population from which one unit is omitted
LENGTHS = (500, 1000, 1)
BATCH = 20  # number of draws in one compiled computation
FEWEST = 3  # With fewer units than this, mostly the prior determines the variation between them.
# With fewer degrees of freedom than this, mostly the prior determines the interval of a trend.
FEWEST_FREE = 3
GOOD_R_HAT, FEW_DIVERGENT = 1.01, 0.002
Draws = dict[str, np.ndarray]
# A unit does not belong to the population if its p-value times the number of units is below this.
ODD = 0.01
# If a unit's own standard deviation exceeds the variation between units by this factor, a Gaussian
# replaces its posterior.
OWN = 2.0
# If the correlation of torque and tightening number exceeds this, their effects cannot be
# separated.
TOGETHER = 0.95


class Population(NamedTuple):
    """The result of `population_of`: draws of the population's parameters, and a summary.

    Attributes:
        pooled: The coordinates, with each unit's summary in them.
        design: Covariates of the units.
        prior: Priors of the population.
        draws: Draws of `line`, `tau` and `scatter`, with axes (chain, draw).
        record: All numbers as plain values, as stored in `population.json`.
    """

    pooled: Pooled
    design: CovariateDesign
    prior: Prior
    draws: dict[str, np.ndarray]
    record: dict[str, Any]

    @property
    def result(self) -> StoredPopulation:
        """The content of `record` as a typed object."""
        return StoredPopulation.read(self.record)


def population_of(
    fleet: xr.DataTree,
    *,
    parameters: Sequence[str] | None = None,
    saturating: Sequence[str] = (),
    summaries: bool = False,
    all_verdicts: bool = False,
    seed: int = 0,
    report: Report = logger.info,
    parts: Parts = unkept,
) -> Population:
    r"""Fit the population from which the units of a fleet come.

    The logarithms of units are normal about a line in ln torque and in ln of the tightening number,
    as far as these vary. A unit whose posterior is narrower than the population is represented by
    its draws with new weights; a unit whose own error is more than twice the variation between
    units by the normal summary of its posterior, since hardly any of its draws would count.

    Args:
        fleet: A fleet from `jbw.fleet_of` or `jbw.read_fleet`.
        parameters: Pooled quantities; frequency, damping and the laws' products when None.
        saturating: Coordinates that follow a saturating curve of the torque, not a power.
        summaries: Whether every unit is represented by its normal summary.
        all_verdicts: Whether to pool even if most runs failed.
        seed: Seed of the sampler.
        report: A function that is called with one sentence at every stage.
        parts: A store of the draws of all units and of all but one, so that a killed call can
            continue.

    Raises:
        ConfigError: The fleet has no quantity of that name.
        DataError: There is only one unit, most runs failed, a prior cuts a posterior, or some units
            state covariates that others do not.

    Examples:
        Three assemblies of the virtual rig, whose frequencies vary about 118.1 rad/s, are pooled:

        >>> import jbw; jbw.enable_x64()
        >>> from dataclasses import replace
        >>> asked = {"tests": ["noise_0p005V"], "repeats": 2, "fs": 128.0}
        >>> units = jbw.rig.measure_fleet("laboratory", torques=[8.0], assemblies=3, **asked)
        >>> studies = [jbw.identify(replace(unit, laws=()), quick=True) for unit in units]
        >>> population = jbw.population_of(jbw.fleet_of(studies))
        >>> print(population.pooled.names, population.record["status"])
        ('omega_n', 'zeta') ok
    """
    require_float64()
    num = fleet.sizes["unit"]
    if num < 2:
        raise DataError(
            "One unit makes no population.", remedy="Collect the runs of several units."
        )
    root = fleet.to_dataset()
    failed = _failed_units(root)
    if len(failed) > num / 2 and not all_verdicts:
        raise DataError(
            f"{len(failed)} of {num} runs failed: {', '.join(failed)}.",
            why="The result of a failed run must not be used.",
            remedy="Correct the failed runs first (jbw explain), or pool all runs anyway with "
            "--all-verdicts.",
        )
    coordinates = pooled(fleet, parameters)
    design = covariates_in(fleet)
    design = design._replace(saturates=mask_of(saturating, coordinates.names, design.columns))
    laws = laws_named(laws_of(fleet))
    products = {product.name: product.quantity.unit for law in laws for product in law.products}
    prior = prior_of(coordinates.names, products, coordinates.mean, design)
    units, key, every = units_of_fleet(fleet, coordinates), jax.random.key(seed), np.ones(num)
    if not summaries:
        report(messages.scatter_stage(num))
        rough = parts("rough", lambda: sampler(units, design, prior, ROUGH)(key, every))
        units = units._replace(weighed=own_over_scatter(coordinates, rough).max(axis=1) <= OWN)
    report(messages.sampling_stage(num, int(units.weighed.sum())))
    draws = parts("all units", lambda: sampler(units, design, prior, FULL)(key, every))
    belongs = belonging(key, units, design, prior, draws, report, parts)
    population = Population(coordinates, design, prior, draws, {})
    result = record_of(fleet, population, units, belongs)
    record = result.replaced(statements=statements(result)).plain()
    return population._replace(record=record)


def covariates_in(fleet: xr.DataTree) -> CovariateDesign:
    """Return the design of the covariates that vary between the units of a fleet."""
    root = fleet.to_dataset()
    return design_of(root["torque"].values.tolist(), root["sequence"].values.tolist())


def require_torque(design: CovariateDesign, torque: float | None) -> None:
    """Raise an error if a torque is given but the fleet has no trend with torque."""
    if torque is None:
        return
    if not torque > 0.0:
        raise ConfigError(f"A torque must be above zero, but is {torque:g} N m.")
    if TORQUE not in design.columns:
        raise DataError(
            "All units of the fleet have one torque, or state none: no trend with torque can be "
            "determined.",
            remedy="Collect units of several torques, or leave --torque out.",
        )


def belonging(
    key: Key[Array, ""],
    units: UnitPosteriors,
    design: CovariateDesign,
    prior: Prior,
    draws: dict[str, np.ndarray],
    report: Callable[[str], Any],
    parts: Parts = unkept,
) -> Float[np.ndarray, " unit"]:
    """Return each unit's p-value: whether the unit belongs to the population of all other units."""
    log_density, far = left_out(units, design, prior, draws)
    probability, doubted = np.zeros(len(units.mean)), []
    for k, unit_log_density in enumerate(log_density.T):
        weights, k_hat = smooth(-unit_log_density)
        probability[k] = np.sum(softmax(weights) * far[:, k])
        limit = BEYOND_DOUBT if k_hat > HEAVY else DOUBTFUL
        doubted += [k] if probability[k] < limit else []
    plain = units._replace(weighed=np.zeros(len(probability), bool))
    drawn = sampler(plain, design, prior, LENGTHS)
    for number, k in enumerate(doubted, start=1):
        report(messages.without_stage(number, len(doubted)))
        included = (np.arange(len(probability)) != k).astype(float)
        others = parts(f"without unit {k}", partial(drawn, key, included))
        probability[k] = np.mean(left_out(units, design, prior, others)[1][:, k])
    return probability


def left_out(
    units: UnitPosteriors, design: CovariateDesign, prior: Prior, draws: dict[str, np.ndarray]
) -> tuple[Float[np.ndarray, "draw unit"], Float[np.ndarray, "draw unit"]]:
    """Return each unit's log density and tail probability in the other units' population."""
    m, c = jnp.asarray(units.mean), jnp.asarray(units.cov)
    d = m.shape[1]
    before = jnp.asarray(precision_of(prior, design))
    at_zero = jnp.asarray(np.ravel(prior.mean / prior.sd**2))

    def of_draw(drawn: dict[str, Array]) -> tuple[Array, Array]:
        rows = _design_rows(design, d, drawn.get("u"))
        apart = drawn["scatter"] + c
        weighed = jnp.swapaxes(rows, 1, 2) @ jnp.linalg.inv(apart)
        tells, pull = weighed @ rows, jnp.einsum("kij,kj->ki", weighed, m)
        # Subtract the unit's own contribution from the sums over all units, because the trend line
        # of a unit must not depend on the unit itself.
        others = jnp.linalg.inv(before + tells.sum(0) - tells)
        line = jnp.einsum("kij,kj->ki", others, at_zero + pull.sum(0) - pull)
        off = m - jnp.einsum("kij,kj->ki", rows, line)
        spread = apart + rows @ others @ jnp.swapaxes(rows, 1, 2)
        squares = jnp.einsum("ki,ki->k", off, jnp.linalg.solve(spread, off[..., None])[..., 0])
        return -0.5 * (squares + jnp.linalg.slogdet(spread)[1]), squares

    flat = {n: v.reshape(-1, *v.shape[2:]) for n, v in draws.items() if n in ("scatter", "u")}
    log_density, squares = jax.jit(
        lambda all_draws: jax.lax.map(of_draw, all_draws, batch_size=BATCH)
    )({name: jnp.asarray(values) for name, values in flat.items()})
    return np.asarray(log_density), chi2.sf(np.asarray(squares), d)


def _design_rows(
    design: CovariateDesign, d: int, u: Array | None
) -> Float[Array, "unit d coefficient"]:
    """Return the matrix from the trend line's coefficients to each unit's expected coordinates."""
    x = jnp.repeat(jnp.asarray(design.x)[:, None], d, axis=1)
    if u is not None:
        j = design.columns.index(TORQUE)
        x = x.at[..., j].add(bent(design.x[:, j], u)[:, None] * design.saturates)
    return jnp.einsum("kip,ij->kijp", x, jnp.eye(d)).reshape(len(x), d, -1)


def record_of(
    fleet: xr.DataTree,
    population: Population,
    units: UnitPosteriors,
    belongs: Float[np.ndarray, " unit"],
) -> StoredPopulation:
    """Return all results of a population as a record.

    `belongs` is the result of `belonging`.
    """
    pooled, design, prior, draws, _ = population
    root, names = fleet.to_dataset(), unit_names(fleet)
    torque = root["torque"].values.tolist()
    record = {
        "units": names,
        "torque": [value if np.isfinite(value) else None for value in torque],
        "columns": list(design.columns),
        "correlation": _correlation(design),
        "saturating": [n for n, bent in zip(pooled.names, design.saturates, strict=True) if bent],
        "reference_torque": None if np.isnan(design.reference) else design.reference,
        "parameters": _rows(fleet, pooled, design, draws),
        "ratios": _ratios(fleet, pooled, design, prior, draws),
        "belongs": dict(zip(names, map(float, belongs), strict=True)),
        "weighed": _shares(units, design, draws, names),
        "failed": _failed_units(root),
        "no_logarithm": _no_logarithm(fleet),
        "sampling": _sampling(draws),
    }
    if "u" in draws:
        record["saturation_torque"] = interval(design.reference * draws["u"])
    result = StoredPopulation.read(record)
    return result.replaced(status=status_of(result))


def own_over_scatter(pooled: Pooled, draws: Draws) -> Float[np.ndarray, "unit d"]:
    """Return each unit's own standard deviation divided by the variation between units."""
    unit_sd = np.sqrt(np.diagonal(pooled.cov, axis1=1, axis2=2))
    return unit_sd / np.median(draws["tau"], axis=(0, 1))


def interval(values: np.ndarray) -> dict[str, float]:
    """Return the median and the ends of the 99 % interval of draws."""
    low, median, high = np.quantile(values, QUANTILES)
    return {"median": float(median), "q005": float(low), "q995": float(high)}


def _rows(
    fleet: xr.DataTree, pooled: Pooled, design: CovariateDesign, draws: Draws
) -> dict[str, dict[str, Any]]:
    """Return a population's table, one row per coordinate: mean, variation and exponents."""
    stored = StoredFleet.of(fleet)
    units, symbols = stored.units, stored.symbols
    line, tau = draws["line"], draws["tau"]
    ratio = own_over_scatter(pooled, draws).max(axis=0)
    rows = {}
    for i, name in enumerate(pooled.names):
        runs = fleet.to_dataset()["run_scatter"].sel(parameter=name).values
        runs = runs[np.isfinite(runs)]
        rows[name] = {
            "unit": units.get(name, "1"),
            "symbol": symbols.get(name, name),
            "mean": interval(np.exp(line[..., i, 0])),
            "scatter": interval(tau[..., i]),
            "run_scatter": float(np.sqrt(np.mean(runs**2))) if len(runs) else None,
            **{
                f"slope_{column}": interval(line[..., i, j])
                for j, column in enumerate(design.columns)
                if j
            },
            "own_over_scatter": float(ratio[i]),
        }
    return rows


def _ratios(
    fleet: xr.DataTree, pooled: Pooled, design: CovariateDesign, prior: Prior, draws: Draws
) -> dict[str, dict[str, float]]:
    """Return the exponents of torque in ratios of two products, such as gamma/delta."""
    if TORQUE not in design.columns:
        return {}
    slope = draws["line"][..., design.columns.index(TORQUE)]
    monomials = monomials_of(laws_of(fleet))
    rows = {}
    for i, j in prior.same_unit:
        below, above = (monomials[pooled.names[index]] for index in (i, j))
        text = "/".join(
            "*".join(name for name in factors if factors[name] != other.get(name))
            for factors, other in ((above, below), (below, above))
        )
        rows[text] = interval(slope[..., j] - slope[..., i])
    return rows


def _shares(
    units: UnitPosteriors, design: CovariateDesign, draws: Draws, names: list[str]
) -> dict[str, float]:
    r"""Return the effective fraction of each unit's weighted draws, $(\sum w)^2 / (S \sum w^2)$.

    The weights are those under the median of the population.
    """
    which = np.flatnonzero(units.weighed)
    line, scatter = (np.median(draws[name], axis=(0, 1)) for name in ("line", "scatter"))
    bent = np.median(draws["u"]) if "u" in draws else None
    means = expected(line, design.x, design, bent)
    w = np.asarray(log_weights(units, which, means, np.linalg.cholesky(scatter)))
    w = np.exp(w - w.max(axis=1, keepdims=True))
    share = w.sum(axis=1) ** 2 / (w.shape[1] * (w**2).sum(axis=1))
    return dict(zip(np.array(names)[which].tolist(), share.tolist(), strict=True))


def _correlation(design: CovariateDesign) -> float | None:
    """Return the correlation of ln torque and ln tightening number between units, if both vary."""
    if len(design.columns) < 3:
        return None
    return float(np.corrcoef(design.x[:, 1], design.x[:, 2])[0, 1])


def _failed_units(root: xr.Dataset) -> list[str]:
    """Return the names of the units whose runs failed."""
    return root["unit"].values[root["verdict"].values == "failed"].astype(str).tolist()


def _no_logarithm(fleet: xr.DataTree) -> dict[str, list[str]]:
    """Return parameters that are unknown or not positive in some units, with these units."""
    lacking = StoredFleet.of(fleet).left_out
    return {n: lacking[n] for n in parameters_of(fleet) if n in lacking and n != GAIN}


def _sampling(draws: Draws) -> dict[str, float]:
    from numpyro.diagnostics import effective_sample_size, split_gelman_rubin

    tau, line = draws["tau"], draws["line"]
    values = np.concatenate(
        [tau, line.reshape(*line.shape[:2], -1)]
        + [draws[name][..., None] for name in ("u",) if name in draws],
        axis=-1,
    )
    return {
        "r_hat": float(np.max(split_gelman_rubin(values))),
        "ess": float(np.min(effective_sample_size(values))),
        "divergences": int(draws["diverging"].sum()),
        "num_draws": int(tau.shape[0] * tau.shape[1]),
    }


def status_of(record: StoredPopulation) -> str:
    """Return `ok`, `failed` if sampling failed, or `not assessed` if there are too few units."""
    sampling, num, columns = record.sampling, len(record.units), len(record.columns)
    if num < FEWEST or (columns > 1 and num - columns < FEWEST_FREE):
        return "not assessed"
    good = sampling.r_hat < GOOD_R_HAT
    few = sampling.divergences <= FEW_DIVERGENT * sampling.num_draws
    return "ok" if good and few else "failed"


def statements(record: StoredPopulation) -> list[str]:
    """Return the sentences on a population: its reliability first, then its results."""
    topics = (
        _few_units, _failed, _confounded, _without_logarithm, _trends, _ratio_trends, _runs, _odd,
        _stands, _weak, _saturates, _wrench,
    )  # fmt: skip
    return [sentence for topic in topics for sentence in topic(record)]


def _few_units(record: StoredPopulation) -> Iterator[str]:
    num, columns = len(record.units), record.columns
    free = num - len(columns)
    if record.status == "not assessed":
        yield messages.mostly_prior(num, free, trend=len(columns) > 1)
    elif free < FEWEST_FREE:
        yield messages.wide_intervals(num, free)
    if record.status == "failed":
        yield messages.not_converged(record.sampling.r_hat, record.sampling.divergences)


def _failed(record: StoredPopulation) -> Iterator[str]:
    if record.failed:
        yield messages.failed_runs(record.failed, len(record.units))


def _confounded(record: StoredPopulation) -> Iterator[str]:
    if record.correlation is not None and abs(record.correlation) > TOGETHER:
        yield messages.confounded(record.correlation)


def _without_logarithm(record: StoredPopulation) -> Iterator[str]:
    for name, units in record.no_logarithm.items():
        yield messages.no_logarithm(name, units)


def _trends(record: StoredPopulation) -> Iterator[str]:
    for name, row in record.parameters.items():
        slope = row.slope_torque
        if slope is not None and not slope.holds_zero:
            yield messages.trend(name, slope.plain(), rises=slope.q005 > 0)


def _ratio_trends(record: StoredPopulation) -> Iterator[str]:
    for name, slope in record.ratios.items():
        yield messages.ratio_trend(name, slope.plain(), depends=not slope.holds_zero)


def _runs(record: StoredPopulation) -> Iterator[str]:
    scattering = [
        (name, row.run_scatter, row.scatter.median)
        for name, row in record.parameters.items()
        if row.run_scatter is not None and row.scatter is not None
    ]
    if scattering:
        yield messages.scatter(scattering)


def _odd(record: StoredPopulation) -> Iterator[str]:
    limit = ODD / len(record.units)
    if odd := [name for name, p in record.belongs.items() if p < limit]:
        yield messages.outliers(odd)


def _stands(record: StoredPopulation) -> Iterator[str]:
    num, weighed = len(record.units), record.weighed
    if weighed:
        yield messages.weighed(len(weighed), num, min(weighed.values()))
    if rest := [name for name in record.units if name not in weighed]:
        yield messages.approximated(rest)


def _weak(record: StoredPopulation) -> Iterator[str]:
    weak = [name for name, row in record.parameters.items() if row.own_over_scatter > OWN]
    if weak:
        yield messages.weak(weak, OWN)


def _saturates(record: StoredPopulation) -> Iterator[str]:
    if record.saturation_torque is not None:
        yield messages.saturates(record.saturating, record.saturation_torque.plain())


def _wrench(record: StoredPopulation) -> Iterator[str]:
    """Yield the sentence on how errors of the stated torques affect a trend."""
    slopes = ((name, row.slope_torque) for name, row in record.parameters.items())
    medians = {name: abs(slope.median) for name, slope in slopes if slope is not None}
    if not record.has_trend or not medians:
        return
    name = max(medians, key=medians.__getitem__)
    attenuation = WRENCH**2 / (np.var(np.log(np.array(record.torque, float))) + WRENCH**2)
    yield messages.wrench(name, WRENCH, WRENCH * medians[name], float(attenuation))
