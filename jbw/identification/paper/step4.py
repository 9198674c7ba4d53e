"""Step 4 by the paper's cut: gamma alone, the earlier steps held at their means."""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.campaign.settings import Identify
from jbw.identification.linear import PooledFit
from jbw.identification.paper.opening import (
    OpeningCurve,
    as_arrays,
    log_likelihood,
    misfit,
    misfits,
    opening_curve,
    residual,
)
from jbw.identification.priors import stated
from jbw.identification.step import Step, attrs, finished
from jbw.inference.fit.fitting import Fit, fit
from jbw.inference.fit.identifiability import weak_direction
from jbw.inference.posterior.verdict import Finding
from jbw.inference.samplers.checkpointing import Keep, nowhere
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import Box, box
from jbw.observables.records import Records

REACH = 3.0  # of delta: where gamma is looked for when the campaign states no prior
WRONG = 0.05  # nats: what the series may be wrong by where the posterior lies
SAMPLERS = {
    "opening_nuts": {"sampler": "nuts", "num_warmup": 300, "num_samples": 1000},
    "opening_paper": {"sampler": "random_walk_paper"},
}


class OpeningFit(NamedTuple):
    """The initial fit of Step 4.

    Attributes:
        curve: The likelihood's series.
        fit: Least squares in the box.
        box: Prior of gamma.
        held: omega_n, zeta, alpha, delta and gain.
    """

    curve: OpeningCurve
    fit: Fit
    box: Box
    held: dict[str, float]


def fit_opening(
    key: Key,
    records: Records,
    linear: PooledFit,
    means: Mapping[str, float],
    settings: Identify,
) -> OpeningFit:
    """The initial fit of gamma, everything else held, and its likelihood as a series.

    Args:
        key: Random key of the starts.
        records: The reduced sweeps.
        linear: Step 2: omega_n and gain.
        means: Step 3: zeta, alpha and delta.
        settings: The campaign's [identify] table.
    """
    held = {"omega_n": linear.omega_n, "gain": linear.gain, **means}
    prior = box({"gamma": stated(settings).get("gamma", (0.0, REACH * means["delta"]))})
    curve = opening_curve(records, held, prior)
    found = fit(residual, prior, curve, starts=8, key=key)
    return OpeningFit(curve, with_curvature(found, prior, curve), prior, held)


def with_curvature(found: Fit, prior: Box, curve: OpeningCurve) -> Fit:
    r"""The fit with what the likelihood's curvature knows of gamma.

    $$\frac1{\sigma_\gamma^2} = -\frac{d^2}{d\gamma^2} \log p$$

    The root of a misfit has no slope at its minimum, from which least squares would know nothing;
    and what the earlier steps got wrong counts as noise, which is integrated out.

    Args:
        found: The fit.
        prior: Box of gamma.
        curve: The likelihood's series.
    """

    def cost(gamma: Float[Array, ""]) -> Float[Array, ""]:
        return -jnp.sum(log_likelihood({"gamma": gamma}, curve))

    width = float(prior.upper[0] - prior.lower[0])
    information = max(float(jax.hessian(cost)(jnp.asarray(found.theta["gamma"]))), 0.0)
    # As of all fits: what is known worse than the box has the box's variance.
    covariance = np.array([[1 / max(information, 12 / width**2)]])
    return replace(
        found,
        covariance=covariance,
        weak=weak_direction(found.theta, covariance, prior),
        jacobian=np.sqrt([[information]]),
    )


def opening_steps(
    key: Key,
    records: Records,
    linear: PooledFit,
    third_order: Step,
    settings: Identify,
    *,
    keep: Keep = nowhere,
) -> dict[str, Step]:
    """Posterior of gamma by NUTS and by the paper's walk, everything else held.

    Args:
        key: Random key.
        records: The reduced sweeps.
        linear: Step 2: omega_n and gain.
        third_order: Step 3: zeta, alpha and delta, taken at their means.
        settings: The campaign's [identify] table.
        keep: Where the chains outlive the process.

    Returns:
        The steps "opening_nuts" and "opening_paper".

    Reference:
        Eqs. (37), (41), (42).
    """
    started = perf_counter()
    group = third_order.posterior["posterior"]
    means = {str(n): float(v.mean()) for n, v in group.data_vars.items()}
    fit_key, *keys = jax.random.split(key, 3)
    curve, best, prior, held = fit_opening(fit_key, records, linear, means, settings)
    chi_square = (2 * best.cost, records.mean.size)
    said = (
        "Gamma is conditional on the means of Steps 2 and 3: their errors are in it, "
        "not in its interval.",
    )
    steps = {}
    for one, (name, options) in zip(keys, SAMPLERS.items(), strict=True):
        tree = sample(
            one, log_likelihood, prior, curve,
            num_chains=settings.num_chains, chain_method="vectorized", attrs=attrs(),
            kept=keep(name), **options,
        )  # fmt: skip
        found = [_series_finding(tree["posterior"].to_dataset(), curve, held, records)]
        steps[name] = finished(
            name, tree, prior, best, started,
            findings=found, statements=said, held=held, chi_square=chi_square,
        )  # fmt: skip
        started = perf_counter()
    return steps


def _series_finding(
    posterior: xr.Dataset, curve: OpeningCurve, held: Mapping[str, float], records: Records
) -> Finding:
    """Whether the series is right where the posterior lies, by solves between its nodes."""
    gamma = jnp.asarray(np.quantile(posterior["gamma"].values, np.linspace(0.05, 0.95, 8)))
    exact = misfits(gamma, as_arrays(held), records)
    series = jax.vmap(lambda value: misfit(value, curve))(gamma)
    both = [-curve.num_values / 2 * jnp.log(part + curve.within) for part in (exact, series)]
    error = np.asarray(jnp.sum(both[0] - both[1], axis=-1))
    worst = float(np.ptp(error))
    ok = worst < WRONG
    return Finding(
        "series",
        "ok" if ok else "failed",
        f"The Chebyshev series of the log likelihood is wrong by {worst:.2g} nats over the "
        f"posterior; it must be below {WRONG:g}.",
        worst,
        "" if ok else "Narrow the prior of gamma.",
    )
