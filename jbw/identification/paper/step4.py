"""Step 4 of Teloli et al.: gamma alone, with the earlier steps fixed at their means.

With one free parameter, the misfit of each level is a smooth function of gamma. A few dozen solves
at Chebyshev nodes determine it everywhere, and every sampler then uses the series.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from numpy.typing import NDArray

from jbw.campaign.settings import Identify
from jbw.identification.linear import PooledFit
from jbw.identification.step import Step, attrs, finished, means_of
from jbw.inference.fit.fitting import Fit, fit
from jbw.inference.fit.identifiability import weak_direction
from jbw.inference.posterior.finding import Finding, checked
from jbw.inference.posterior.remedies import put_bounds
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.chunked_run import Keep, Supervision, no_checkpoint
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior
from jbw.inference.space.box import Box, box
from jbw.inference.space.problem import Target
from jbw.observables.records import Records
from jbw.paper.likelihoods import gaussian_log_likelihood
from jbw.report.messages import paper_steps as messages

NAMES = ("gamma",)
NODES = 48
REACH = 3.0  # upper bound of gamma relative to delta, if the campaign states no prior
WRONG = 0.05  # largest error of the Chebyshev series within the posterior [nats]
SAMPLERS = {
    "opening_nuts": SamplingRequest("nuts", num_warmup=300, num_samples=1000),
    "opening_paper": SamplingRequest("random_walk_paper"),
}


class OpeningCurve(eqx.Module):
    r"""The squared residual of each level as a Chebyshev series in gamma.

    $$K\,|\bar v - m(\gamma)|^2 = \sum_k c_k\,T_k(s), \qquad s \in [-1, 1]$$

    over the bounds of gamma [1/m].
    """

    coefficients: Float[Array, "level node"]  # coefficients c_k of the series
    within: Float[Array, " level"]  # sum S of squared deviations between repeats
    num_values: Float[Array, " level"]  # number of values, over repeats and time
    noise_std: Float[Array, " level"]  # noise of one repeat, from the variation between repeats
    lower: Float[Array, ""]
    upper: Float[Array, ""]


def opening_curve(records: Records, held: Mapping[str, float], prior: Box) -> OpeningCurve:
    """Compute the Chebyshev series of the squared residual, by simulations at nodes of gamma."""
    s = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    gamma = prior.lower[0] + (s + 1) / 2 * (prior.upper[0] - prior.lower[0])
    values = misfits(gamma, dict(held), records)
    # The polynomials are orthogonal at these nodes; the constant term has half the weight of the
    # others. This also works under vmap.
    series = 2 / NODES * np.polynomial.chebyshev.chebvander(s, NODES - 1).T
    series[0] /= 2
    return OpeningCurve(
        coefficients=(series @ values).T,
        within=records.groups.within,
        num_values=records.groups.num_values,
        noise_std=records.groups.noise_std,
        lower=prior.lower[0],
        upper=prior.upper[0],
    )


@jax.jit
def misfits(
    gamma: Float[Array, " node"], held: Mapping[str, Array], records: Records
) -> Float[Array, "node level"]:
    """Return the squared residual of every level at several values of gamma [1/m]."""

    def misfit_at(value: Float[Array, ""]) -> Float[Array, " level"]:
        return records.squares({**held, "gamma": value}) - records.groups.within

    return jax.lax.map(misfit_at, gamma)


def misfit(gamma: Float[Array, ""], curve: OpeningCurve) -> Float[Array, " level"]:
    """Return the value of the Chebyshev series of every level, by Clenshaw's recurrence."""
    s = 2 * (gamma - curve.lower) / (curve.upper - curve.lower) - 1

    def step(carry: tuple, c: Float[Array, " level"]) -> tuple:
        b_1, b_2 = carry
        return (c + 2 * s * b_1 - b_2, b_1), None

    zero = jnp.zeros(curve.coefficients.shape[0])
    (b_1, b_2), _ = jax.lax.scan(step, (zero, zero), curve.coefficients.T[:0:-1])
    return curve.coefficients[:, 0] + s * b_1 - b_2


def log_likelihood(theta: Mapping[str, Array], curve: OpeningCurve) -> Float[Array, " level"]:
    """Return the log likelihood of each level; noise is integrated out with the prior 1/sigma.

    Reference:
        Eq. (37), on the velocity as in (41).
    """
    squares = jnp.maximum(misfit(theta["gamma"], curve), 0.0) + curve.within
    return gaussian_log_likelihood(squares, curve.num_values)


def residual(theta: Mapping[str, Array], curve: OpeningCurve) -> Float[Array, " level"]:
    """Return the root of each level's squared residual in units of its noise.

    Reference:
        Eqs. (41), (42).
    """
    return jnp.sqrt(jnp.maximum(misfit(theta["gamma"], curve), 1e-300)) / curve.noise_std


def fit_opening(
    key: Key, records: Records, linear: PooledFit, means: Mapping[str, float], settings: Identify
) -> tuple[OpeningCurve, Fit, Box, dict[str, float]]:
    """Fit gamma initially, given the results of Step 2 and the `means` of Step 3.

    Returns:
        Chebyshev series of the residual as a function of gamma, fit, prior of gamma, and the fixed
        omega_n, zeta, alpha, delta and gain.
    """
    held = {"omega_n": linear.omega_n, "gain": linear.gain, **means}
    prior = box({"gamma": settings.prior.get("gamma", (0.0, REACH * means["delta"]))})
    curve = opening_curve(records, held, prior)
    best = fit(residual, prior, curve, starts=8, key=key)
    return curve, with_curvature(best, prior, curve), prior, held


def with_curvature(found: Fit, prior: Box, curve: OpeningCurve) -> Fit:
    r"""Return the fit of gamma, with a covariance from the likelihood's second derivative.

    $$\frac1{\sigma_\gamma^2} = -\frac{d^2}{d\gamma^2} \log p$$

    The root of a misfit has no slope at its minimum, so least squares alone give no information
    there. Errors of the earlier steps count as noise, which is integrated out.
    """

    def cost(gamma: Float[Array, ""]) -> Float[Array, ""]:
        return -jnp.sum(log_likelihood({"gamma": gamma}, curve))

    width = float(prior.upper[0] - prior.lower[0])
    levels = len(found.residual)
    information = max(float(jax.hessian(cost)(jnp.asarray(found.theta["gamma"]))), 0.0)
    # As in all fits, the variance is at most that of the prior.
    covariance = np.array([[1 / max(information, 12 / width**2)]])
    return replace(
        found,
        covariance=covariance,
        weak=weak_direction(found.theta, covariance, prior),
        # The Jacobian has one row per level, like the residual. Each level gets an equal part of
        # the information.
        jacobian=np.full((levels, 1), np.sqrt(information / levels)),
    )


def opening_steps(
    key: Key,
    records: Records,
    linear: PooledFit,
    third_order: Step,
    settings: Identify,
    *,
    keep: Keep = no_checkpoint,
    statements: Sequence[str] = (),
) -> dict[str, Step]:
    """Sample gamma by NUTS and by the original random walk; fix the results of Steps 2 and 3.

    `statements` are put before those of each step.

    Reference:
        Eqs. (37), (41), (42).
    """
    started = perf_counter()
    fit_key, *keys = jax.random.split(key, 3)
    means = means_of(third_order.posterior)
    curve, best, prior, held = fit_opening(fit_key, records, linear, means, settings)
    chi_square = (2 * best.cost, records.mean.size)
    steps = {}
    target = Target(log_likelihood, prior, curve)
    for draw_key, (name, request) in zip(keys, SAMPLERS.items(), strict=True):
        request = request._replace(num_chains=settings.num_chains, chain_method="vectorized")
        supervision = Supervision(kept=keep(name))
        tree = draw_posterior(draw_key, target, request, supervision=supervision, attrs=attrs())
        finding = _series_finding(posterior_draws(tree), curve, held, records)
        steps[name] = finished(
            name, tree, prior, best, started,
            findings=(*verdict(tree, prior, chi_square=chi_square).findings, finding),
            statements=(*statements, messages.CONDITIONAL), held=held,
        )  # fmt: skip
        started = perf_counter()
    return steps


def of_draws(
    step: Step, quantity: Callable[[dict[str, NDArray[np.float64]]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Interpolate a smooth quantity to all draws of gamma, shape (chain, draw)."""
    gamma = np.asarray(posterior_draws(step.posterior)["gamma"])
    grid = np.linspace(gamma.min(), gamma.max(), 9)
    draws = {n: np.full(9, v) for n, v in step.held.items()} | {"gamma": grid}
    return np.polynomial.Polynomial.fit(grid, quantity(draws), 4)(gamma)


def _series_finding(
    posterior: xr.Dataset, curve: OpeningCurve, held: Mapping[str, float], records: Records
) -> Finding:
    """Return the finding on the accuracy of the Chebyshev series within the posterior."""
    draws = posterior["gamma"].values
    gamma = jnp.asarray(np.quantile(draws, np.linspace(0.05, 0.95, 8)))
    exact = misfits(gamma, dict(held), records)
    series = jax.vmap(lambda value: misfit(value, curve))(gamma)
    likelihoods = [
        gaussian_log_likelihood(part + curve.within, curve.num_values) for part in (exact, series)
    ]
    error = np.asarray(jnp.sum(likelihoods[0] - likelihoods[1], axis=-1))
    worst = float(np.ptp(error))
    low, high = (float(end) for end in np.quantile(draws, (0.0, 1.0)))
    values, remedy = {"error": worst, "limit": WRONG}, {"line": put_bounds("gamma", (low, high))}
    return checked("series", worst < WRONG, values, worst, remedy)
