"""How does the cost of an effective draw grow with the numbers of parameters and of data?

There are two families with a known posterior: a linear model of d parameters with correlated
columns, whose posterior is normal; and Step 3, a thin ridge from wall to wall, with the noise of
one repeat and of hundreds. Every sampler has the settings of `jbw compare`. The unit of cost is one
evaluation of the log likelihood; a gradient counts as one evaluation.

    python benchmarks/samplers_growth.py [--calls 1] [--json FILE]
"""

import os
import warnings
from typing import Any

# Two host devices let two chains run side by side; JAX reads this once, when it starts.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=2")

import jax
import jax.numpy as jnp
import numpy as np
from cold_start import kernel_at_five_tones
from timing import Table, options, show

from jbw.identification.paper import kernel
from jbw.identification.procedure import Posterior
from jbw.inference.fit.fitting import fit
from jbw.inference.space.box import box
from jbw.lab.samplers import compare

DIMENSIONS = (2, 4, 8, 16)
NOISES = (1e-1, 1e-2, 1e-3)  # noise of one repeat relative to |H3|
SAMPLERS = ("nuts", "elliptical_slice", "random_walk", "tempered_smc", "nested")
CORRELATION = 0.9  # correlation of neighbouring columns of the linear model
VALUES = 200
COLUMNS = {
    "family": "",
    "sampler": "",
    "evaluations / ESS": ".3g",
    "ESS / s": ".3g",
    "R-hat": ".3f",
}


def linear(theta: dict[str, Any], data: Any) -> Any:
    """Return the residual of a linear model, in units of the noise."""
    design, values = data
    return design @ jnp.stack([theta[name] for name in sorted(theta)]) - values


def linear_terms(theta: dict[str, Any], data: Any) -> Any:
    """Return the log likelihood of the linear model, one term per value [nats]."""
    return -0.5 * linear(theta, data) ** 2


def linear_posterior(d: int) -> Posterior:
    """Return the posterior of a linear model of d parameters with correlated columns."""
    rng = np.random.default_rng(d)
    index = np.arange(d)
    root = np.linalg.cholesky(CORRELATION ** np.abs(index[:, None] - index))
    design = rng.normal(size=(VALUES, d)) @ root.T
    truth = np.full(d, 0.5)
    data = jnp.asarray(design), jnp.asarray(design @ truth + rng.normal(size=VALUES))
    prior = box({f"theta_{i:02d}": (-4.0, 5.0) for i in range(d)})
    best = fit(linear, prior, data, starts=4, key=jax.random.key(0))
    return Posterior("linear", linear_terms, prior, data, best, stepped=False)


def ridge_posterior(noise: float) -> Posterior:
    """Return the posterior of Step 3 with a given noise in one repeat of eight."""
    data = kernel.KernelData(
        **{name: jnp.asarray(one) for name, one in kernel_at_five_tones(noise).items()}
    )
    prior = box({"zeta": (0.00352, 0.00528), "alpha": (424.31, 589.61), "delta": (272.80, 409.92)})
    best = fit(kernel.residual, prior, data, starts=16, key=jax.random.key(0))
    return Posterior("third_order", kernel.log_likelihood, prior, data, best, stepped=False)


def rows_of(family: str, posterior: Posterior) -> list[tuple[Any, ...]]:
    """Return rows on the cost of each sampler for one posterior."""
    found = compare(posterior, samplers=SAMPLERS).record
    rows = []
    for name in SAMPLERS:
        one = found["samplers"].get(name)
        if one is None:
            rows.append((family, name, None, None, None))
            continue
        hats = [row["r_hat"] for row in one["parameters"].values() if row["r_hat"] is not None]
        cost = None if not one["ess"] else one["num_evaluations"] / one["ess"]
        rows.append((family, name, cost, one["ess_per_s_warm"], max(hats, default=None)))
    return rows


def main() -> None:
    arguments = options(__doc__, calls=1).parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    by_dimension = [
        row for d in DIMENSIONS for row in rows_of(f"{d} parameters", linear_posterior(d))
    ]
    by_data = [
        row
        for noise in NOISES
        for row in rows_of(f"ridge, noise {100 * noise:g} %", ridge_posterior(noise))
    ]
    tables = [
        Table("A normal posterior, by parameters", COLUMNS, by_dimension),
        Table("Step 3, by the noise of the kernel", COLUMNS, by_data),
    ]
    show(tables, ("numpyro", "blackjax"), arguments.json)


if __name__ == "__main__":
    main()
