"""Do intervals of a population contain a new unit as often as stated, sampled by NUTS?

    python benchmarks/populations.py [--units 3 5 10] [--number 100] [--json FILE]

Populations come from the model itself: variations and correlations from their priors, units whose
own errors are 0.1 to 0.5 of the scale of variation in each of four coordinates. The NUTS of
`population_of` samples all of them, from normal summaries; an unmeasured unit is then drawn from
the truth, and its place in the predicted distribution is found.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpyro.diagnostics import split_gelman_rubin
from numpyro.infer.hmc import hmc
from numpyro.infer.util import initialize_model
from scipy.special import ndtr
from scipy.stats import beta
from timing import Table, options, show

import jbw
from jbw.population.model import ACCEPTED, EVEN, FULL, UnitPosteriors, named_draws, population_model
from jbw.population.prior import CovariateDesign, prior_of

NAMES = ("omega_n", "zeta", "alpha_delta", "alpha_gamma")
PRODUCTS = {"alpha_delta": "1/(m s^2)", "alpha_gamma": "1/(m s^2)"}
OWN = (0.1, 0.5)  # a unit's own error relative to the scale of variation
COVERAGE = {
    "units": "d", "populations": "d", "90 %": ".3f", "[99 %]": "", "99 %": ".3f", "[99 %] ": "",
    "divergent, %": ".3f", "most in one, %": ".2f", "R-hat > 1.01": "d",
}  # fmt: skip
Sampled = Callable[[Any, UnitPosteriors], tuple[dict[str, np.ndarray], np.ndarray]]


class Truth(NamedTuple):
    """A true population: its units with their own errors, and an unmeasured unit."""

    units: UnitPosteriors
    new: np.ndarray


def made(rng: np.random.Generator, num: int, scale: np.ndarray) -> Truth:
    """Draw one population from its priors."""
    d, key = len(scale), jax.random.key(int(rng.integers(2**31)))
    tau = scale * np.abs(rng.standard_normal(d))
    root = np.asarray(dist.LKJCholesky(d, EVEN).sample(key)) * tau[:, None]
    own = scale * rng.uniform(*OWN, (num, d))
    true = rng.standard_normal((num + 1, d)) @ root.T
    seen = true[:num] + own * rng.standard_normal((num, d))
    cov = own[:, :, None] ** 2 * np.eye(d)
    none = np.zeros((num, 0, d)), np.zeros((num, 0)), np.zeros(num, bool)
    return Truth(UnitPosteriors(seen, cov, *none), true[num])


def sampler_of(num: int, accepted: float) -> Sampled:
    """Return a function that draws any population with `num` units, compiled only once."""
    design = CovariateDesign(("mean",), np.ones((num, 1)), np.nan)
    before = prior_of(NAMES, PRODUCTS, np.zeros((num, len(NAMES))), design)

    def model(mean: Any, cov: Any) -> None:
        none = np.zeros((num, 0, len(NAMES))), np.zeros((num, 0)), np.zeros(num, bool)
        prior = before._replace(mean=mean.mean(0)[:, None])
        population_model(UnitPosteriors(mean, cov, *none), design, prior, np.ones(num))

    def args(units: UnitPosteriors) -> tuple[Any, Any]:
        return jnp.asarray(units.mean), jnp.asarray(units.cov)

    example = args(made(np.random.default_rng(0), num, before.tau).units)
    known = initialize_model(jax.random.key(0), model, model_args=example, dynamic_args=True)
    begin, move = hmc(potential_fn_gen=known.potential_fn, algo="NUTS")
    warmup, samples, chains = FULL

    @jax.jit
    def chain(key: Any, *known_of: Any) -> tuple[dict[str, Any], Any]:
        keys = jax.random.split(key)
        leaves, shape = jax.tree.flatten(known.param_info.z)
        start = [jax.random.uniform(keys[0], one.shape, one.dtype, -1.0, 1.0) for one in leaves]
        state = begin(
            jax.tree.unflatten(shape, start), num_warmup=warmup, target_accept_prob=accepted,
            dense_mass=True, model_args=known_of, rng_key=keys[1],
        )  # fmt: skip

        def step(state: Any, _: None) -> tuple[Any, Any]:
            state = move(state, known_of)
            return state, (state.z, state.diverging)

        _, (z, diverging) = jax.lax.scan(step, state, None, warmup + samples)
        z = jax.tree.map(lambda one: one[warmup:], z)
        return jax.vmap(known.postprocess_fn(*known_of))(z), diverging[warmup:]

    def drawn(key: Any, units: UnitPosteriors) -> tuple[dict[str, np.ndarray], np.ndarray]:
        found = [chain(one, *args(units)) for one in jax.random.split(key, chains)]
        sites, diverging = jax.tree.map(lambda *each: np.stack(each), *found)
        return named_draws(sites), diverging

    return drawn


def places(drawn: dict[str, np.ndarray], new: np.ndarray) -> np.ndarray:
    """Return, by coordinate, the predicted probability of values below the new unit's."""
    line, tau = (drawn[name].reshape(-1, len(new)) for name in ("line", "tau"))
    return ndtr((new - line) / tau).mean(axis=0)


def populations(num: int, count: int, accepted: float, seed: int = 0) -> Iterator[tuple]:
    """Yield, per population, ranks of new units, share of divergent draws, and R-hat."""
    rng, drawn = np.random.default_rng(seed), sampler_of(num, accepted)
    one = CovariateDesign(("mean",), np.ones((1, 1)), np.nan)
    scale = prior_of(NAMES, PRODUCTS, np.zeros((1, len(NAMES))), one).tau
    for number in range(count):
        truth = made(rng, num, scale)
        found, diverging = drawn(jax.random.key(number), truth.units)
        values = np.concatenate([found["tau"], found["line"][..., 0]], axis=-1)
        yield places(found, truth.new), diverging.mean(), np.max(split_gelman_rubin(values))


def held(below: np.ndarray, level: float) -> tuple[float, str]:
    """Return the share of intervals that contain the new unit, with binomial 99 % limits.

    Coordinates of one population are not independent; the limits count populations only.
    """
    inside = np.abs(below - 0.5) < level / 2
    share, count = inside.mean(), len(below)
    hits = share * count
    low, high = beta.ppf(0.005, hits, count - hits + 1), beta.ppf(0.995, hits + 1, count - hits)
    return float(share), f"{np.nan_to_num(low):.3f} to {np.nan_to_num(high, nan=1.0):.3f}"


def coverage(units: Sequence[int], count: int, accepted: float) -> Table:
    """Return a table of coverage, one row per number of units."""
    rows = []
    for num in units:
        below, diverging, r_hat = map(
            np.array, zip(*populations(num, count, accepted), strict=True)
        )
        ninety, most = held(below, 0.90), held(below, 0.99)
        rows.append((num, count, *ninety, *most, 100 * diverging.mean(), 100 * diverging.max(),
                     int(np.sum(r_hat > 1.01))))  # fmt: skip
    return Table(f"New units within intervals of NUTS, four coordinates, {accepted:g} accepted",
                 COVERAGE, rows)  # fmt: skip


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--units", type=int, nargs="+", default=[3, 5, 10])
    parser.add_argument("--number", type=int, default=100, help="of populations of each size")
    parser.add_argument("--accepted", type=float, default=ACCEPTED, help="of NUTS's moves")
    arguments = parser.parse_args()
    jbw.enable_x64()
    numpyro.enable_x64()
    table = coverage(arguments.units, arguments.number, arguments.accepted)
    show([table], ("numpyro",), arguments.json)


if __name__ == "__main__":
    main()
