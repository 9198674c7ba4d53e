r"""`jbw.population_of`: what a fleet says of its units, of their scatter and of their trends.

Whether a unit belongs with the others is judged by the population that those alone have. Under a
scatter T the line of all units but k is normal in closed form, and so is where it expects the
summary of unit k,

$$m_k\,|\,T, m_{-k} \sim N(x_k B_{-k},\ S_k), \qquad S_k = T + C_k + x_k P_{-k}^{-1} x_k^T, \qquad
  P_k = E\big[P(\chi^2_d > r^T S_k^{-1} r)\,\big|\,m_{-k}\big]$$

with r the unit's distance from there. Draws of T are those of all units, each weighed by
$1/p(m_k | T, m_{-k})$, the weights smoothed by a Pareto tail. For a unit that may be another, and
where that tail is too heavy, the population without it is sampled, of normal summaries: draws of a
scatter that one unit made large hardly reach what it is without.

Reference:
    Vehtari, Gelman and Gabry (2017), Statistics and Computing 27, 1413.
"""

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from scipy.special import softmax
from scipy.stats import chi2

from jbw.errors import ConfigError, DataError
from jbw.inference.samplers.importance import smooth
from jbw.inference.space.box import require_float64
from jbw.oscillator.laws import laws_named
from jbw.population.coordinates import Pooled, laws_of, pooled, units_of_fleet
from jbw.population.model import FULL, ROUGH, UnitPosteriors, sampler
from jbw.population.prior import (
    TORQUE,
    CovariateDesign,
    Prior,
    design_of,
    precision_of,
    prior_of,
)
from jbw.population.record import OWN, Pooling, own_over_scatter, record_of, statements
from jbw.population.trend import bent, mask_of
from jbw.report.messages import population as messages

logger = logging.getLogger("jbw")
Report = Callable[[str], None]
HEAVY = 0.7  # Pareto's k-hat, from which weights are not to be trusted
# From which probability a unit is beyond doubt: in the scatter that it made large itself, one that
# is far off in one coordinate lies at chi-square = d - 1 + n, 0.2 and less.
BEYOND_DOUBT = 0.3
# Up to which one is sampled anew whatever k-hat says: chains that missed the tail do not show it.
DOUBTFUL = 0.05
LENGTHS = (500, 1000, 1)  # of a population without a unit
BATCH = 20  # draws side by side


class Population(NamedTuple):
    """What `population_of` finds.

    Attributes:
        pooled: The coordinates and each unit's summary in them.
        design: Covariates.
        prior: Priors.
        draws: `line`, `tau` and `scatter`, axes (chain, draw).
        record: All numbers as plain values, as `population.json` holds them.
    """

    pooled: Pooled
    design: CovariateDesign
    prior: Prior
    draws: dict[str, np.ndarray]
    record: dict[str, Any]


def population_of(
    fleet: xr.DataTree,
    *,
    parameters: Sequence[str] | None = None,
    saturating: Sequence[str] = (),
    summaries: bool = False,
    all_verdicts: bool = False,
    seed: int = 0,
    report: Report = logger.info,
) -> Population:
    r"""The population that the units of a fleet come from.

    Units scatter normally, in logarithms, about a line in ln torque and in ln of the number of the
    tightening, as far as these vary. A unit that knows itself better than the population does is
    its draws, weighed anew; one whose own error is more than twice the scatter is the normal
    summary of its posterior, for hardly a draw would count.

    Args:
        fleet: From `jbw.fleet_of` or `jbw.read_fleet`.
        parameters: What is pooled; frequency, damping and the laws' products when None.
        saturating: Coordinates that follow a saturating curve of the torque, not a power.
        summaries: Take the normal summary of every unit.
        all_verdicts: Pool though most runs failed.
        seed: Of the sampler.
        report: Called with one sentence at every stage.

    Raises:
        ConfigError: A name that the fleet does not have.
        DataError: One unit alone, most runs failed, a prior that cuts a posterior, or covariates
            that some units state and others do not.
    """
    require_float64()
    num = fleet.sizes["unit"]
    if num < 2:
        raise DataError("One unit makes no population.", remedy="Collect the runs of several.")
    root = fleet.to_dataset()
    failed = [str(name) for name in root["unit"].values[root["verdict"].values == "failed"]]
    if len(failed) > num / 2 and not all_verdicts:
        raise DataError(
            f"{len(failed)} of {num} runs failed: {', '.join(failed)}.",
            why="What a failed run says of its unit must not be used.",
            remedy="Mend them first (jbw explain), or pool them all the same with --all-verdicts.",
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
        rough = sampler(units, design, prior, ROUGH)(key, every)
        units = units._replace(weighed=own_over_scatter(coordinates, rough).max(axis=1) <= OWN)
    report(messages.sampling_stage(num, int(units.weighed.sum())))
    draws = sampler(units, design, prior, FULL)(key, every)
    belongs = belonging(key, units, design, prior, draws, report)
    record = record_of(fleet, Pooling(coordinates, units, design, prior, draws), belongs)
    record["statements"] = statements(record)
    return Population(coordinates, design, prior, draws, record)


def covariates_in(fleet: xr.DataTree) -> CovariateDesign:
    """Covariates that vary between the units of a fleet."""
    root = fleet.to_dataset()
    return design_of(root["torque"].values.tolist(), root["sequence"].values.tolist())


def require_torque(design: CovariateDesign, torque: float | None) -> None:
    """Refuse a torque that no trend is known for."""
    if torque is None:
        return
    if not torque > 0.0:
        raise ConfigError(f"A torque must be above zero, but is {torque:g} N m.")
    if TORQUE not in design.columns:
        raise DataError(
            "All units of the fleet have one torque, or state none: no trend with it is known.",
            remedy="Collect units of several torques, or leave --torque out.",
        )


def belonging(
    key: Key[Array, ""],
    units: UnitPosteriors,
    design: CovariateDesign,
    prior: Prior,
    draws: dict[str, np.ndarray],
    report: Callable[[str], Any],
) -> Float[np.ndarray, " unit"]:
    """Probability that a unit of the others' population lies as far from its line as each does."""
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
        others = drawn(key, (np.arange(len(probability)) != k).astype(float))
        probability[k] = np.mean(left_out(units, design, prior, others)[1][:, k])
    return probability


def left_out(
    units: UnitPosteriors, design: CovariateDesign, prior: Prior, draws: dict[str, np.ndarray]
) -> tuple[Float[np.ndarray, "draw unit"], Float[np.ndarray, "draw unit"]]:
    """Of every unit by the others, draw by draw of T: its log density, and P of one as far off."""
    m, c = jnp.asarray(units.mean), jnp.asarray(units.cov)
    d = m.shape[1]
    before = jnp.asarray(precision_of(prior, design))
    at_zero = jnp.asarray(np.ravel(prior.mean / prior.sd**2))

    def of_draw(drawn: dict[str, Array]) -> tuple[Array, Array]:
        rows = _rows(design, d, drawn.get("u"))
        weighed = jnp.swapaxes(rows, 1, 2) @ jnp.linalg.inv(drawn["scatter"] + c)
        tells, pull = weighed @ rows, jnp.einsum("kij,kj->ki", weighed, m)
        # What all tell, less what the unit does: its line without it.
        others = jnp.linalg.inv(before + tells.sum(0) - tells)
        line = jnp.einsum("kij,kj->ki", others, at_zero + pull.sum(0) - pull)
        off = m - jnp.einsum("kij,kj->ki", rows, line)
        spread = drawn["scatter"] + c + rows @ others @ jnp.swapaxes(rows, 1, 2)
        squares = jnp.einsum("ki,ki->k", off, jnp.linalg.solve(spread, off[..., None])[..., 0])
        return -0.5 * (squares + jnp.linalg.slogdet(spread)[1]), squares

    flat = {n: v.reshape(-1, *v.shape[2:]) for n, v in draws.items() if n in ("scatter", "u")}
    log_density, squares = jax.jit(
        lambda all_draws: jax.lax.map(of_draw, all_draws, batch_size=BATCH)
    )({name: jnp.asarray(values) for name, values in flat.items()})
    return np.asarray(log_density), chi2.sf(np.asarray(squares), d)


def _rows(design: CovariateDesign, d: int, u: Array | None) -> Float[Array, "unit d coefficient"]:
    """The coordinates of every unit as a product with the line, coordinate by coordinate."""
    x = jnp.repeat(jnp.asarray(design.x)[:, None], d, axis=1)
    if u is not None:
        j = design.columns.index(TORQUE)
        x = x.at[..., j].add(bent(design.x[:, j], u)[:, None] * design.saturates)
    return jnp.einsum("kip,ij->kijp", x, jnp.eye(d)).reshape(len(x), d, -1)
