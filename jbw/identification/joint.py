"""Step 4 with all parameters set to update: the joint posterior from the sweeps."""

from collections.abc import Mapping
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.identification.accuracy import residual_findings, solver_finding
from jbw.identification.linear import PooledFit
from jbw.identification.opening import OpeningData, draw_noise_std, log_likelihood, residual
from jbw.identification.priors import joint_box
from jbw.identification.step import ATTRS, Step, finished
from jbw.inference.box import Box, from_unit
from jbw.inference.fitting import Fit, fit
from jbw.inference.quadratic import driven_by_quadratic, quadratic
from jbw.inference.sampling import sample
from jbw.inference.verdict import verdict

NUM_SCREENED = 32  # points of the box whose cost is looked at
NUM_STARTS = 3  # of them fitted
EXPLAINED = 5.0  # chi-square a degree of freedom below which a fit explains the data
MAX_STEPS = 60
PRODUCTS = {
    "alpha_delta": ("alpha", "delta", "softening at small amplitude, alpha * delta"),
    "alpha_gamma": ("alpha", "gamma", "opening at small amplitude, alpha * gamma"),
}


def joint_step(
    key: Key,
    data: OpeningData,
    linear: PooledFit,
    earlier: Mapping[str, Step],
    settings: Mapping[str, Any],
) -> Step:
    """Joint posterior of all parameters of the joint, the gain and the noise, from the sweeps.

    Args:
        key: Random key.
        data: The sweeps, nothing held but a gain that the campaign states.
        linear: Step 2.
        earlier: The paper's steps, when they were run.
        settings: The campaign's [identify] table.

    Returns:
        The step "joint"; its posterior holds `noise_std` by level and the products alpha*delta and
        alpha*gamma besides the parameters.

    Reference:
        Eq. (37), with every parameter set to update.
    """
    started = perf_counter()
    keys = jax.random.split(key, 3)
    known = None if "gain" in data.held else (linear.gain, float(data.gain_std))
    omega = linear.omega_n
    y_peak = float(jnp.max(jnp.abs(data.records.mean))) / omega ** _order(data)
    prior = joint_box(settings, omega, linear.zeta, known, y_peak)
    best = fit_joint(keys[0], data, prior, linear, earlier)
    posterior = sample_joint(keys[1], data, prior, best, settings)
    findings = [*residual_findings(best.theta, data)]
    findings.append(solver_finding(posterior["posterior"].to_dataset(), data))
    complete = with_derived(keys[2], posterior, data)
    return finished(
        "joint",
        complete,
        prior,
        best,
        started,
        findings=findings,
        held={n: float(v) for n, v in data.held.items()},
    )


def fit_joint(
    key: Key,
    data: OpeningData,
    prior: Box,
    linear: PooledFit,
    earlier: Mapping[str, Step],
) -> Fit:
    """Least squares over all parameters, from the earlier steps.

    Where that fit does not explain the data, also from the best of many points all over the box:
    their costs are looked at first, for a solve costs far less than a fit.
    """
    known = {"omega_n": linear.omega_n, "zeta": linear.zeta, "gain": linear.gain}
    for step in ("third_order_nuts", "opening_nuts"):
        if step in earlier:
            group = earlier[step].posterior["posterior"]
            known |= {str(n): float(v.mean()) for n, v in group.data_vars.items()}
    middle = from_unit(jnp.full(len(prior.names), 0.5), prior)
    start = {name: known.get(name, float(middle[name])) for name in prior.names}
    first = fit(residual, prior, data, starts=_inside(start, prior), max_steps=MAX_STEPS)
    chi_square, dof = first.chi_square
    if chi_square < EXPLAINED * dof:
        return first
    points = from_unit(jax.random.uniform(key, (NUM_SCREENED, len(prior.names))), prior)
    for name in {"omega_n", "gain"} & set(points):  # Step 2 knows them far better than the box
        points[name] = jnp.full(NUM_SCREENED, known[name])
    order = np.argsort(np.asarray(_costs(points, data)))[:NUM_STARTS]
    starts = {name: np.asarray(values)[order] for name, values in points.items()}
    second = fit(residual, prior, data, starts=_inside(starts, prior), max_steps=MAX_STEPS)
    return min(first, second, key=lambda one: one.cost)


def _inside(starts: Mapping[str, Any], prior: Box) -> dict[str, np.ndarray]:
    return {
        name: np.clip(starts[name], prior.lower[i], prior.upper[i])
        for i, name in enumerate(prior.names)
    }


@jax.jit
def _costs(points: Mapping[str, Array], data: OpeningData) -> Float[Array, " point"]:
    costs = jax.lax.map(lambda theta: jnp.sum(residual(theta, data) ** 2), dict(points))
    return jnp.where(jnp.isfinite(costs), costs, jnp.inf)


def sample_joint(
    key: Key, data: OpeningData, prior: Box, best: Fit, settings: Mapping[str, Any]
) -> xr.DataTree:
    """NUTS in the coordinate whitened by the fit's covariance.

    Trajectories follow the gradient of the Laplace approximation, which costs nothing, and are
    weighed by the exact likelihood; where the posterior is too far from Gaussian for that, the
    model's own gradient takes over.
    """
    options = {
        "num_warmup": settings.get("num_warmup", 100),
        "num_samples": settings.get("num_samples", 500),
        "num_chains": settings.get("num_chains", 4),
        "chain_method": "parallel" if jax.device_count() > 1 else "sequential",
        "start": best.theta,
        "covariance": best.covariance,
        "attrs": ATTRS,
    }
    cheap = driven_by_quadratic(log_likelihood)
    tree = sample(key, cheap, prior, quadratic(data, best), **options)
    if verdict(tree, prior).status == "ok":
        return tree
    return sample(key, log_likelihood, prior, data, **options)


def with_derived(key: Key, tree: xr.DataTree, data: OpeningData) -> xr.DataTree:
    """The posterior with the noise of each level and the two products beside its parameters."""
    posterior = tree["posterior"].to_dataset()
    terms = tree["log_likelihood"].to_dataset()["terms"].values
    noise = draw_noise_std(key, terms, data)
    unit = {"displacement": "m", "velocity": "m s-1", "acceleration": "m s-2"}
    derived: dict[str, Any] = {
        "noise_std": (
            ("chain", "draw", "level"),
            noise,
            {"units": unit[data.records.response], "long_name": "noise of one repeat"},
        )
    }
    for name, (first, second, long_name) in PRODUCTS.items():
        product = (posterior[first] * posterior[second]).values
        attrs = {"units": "m-1 s-2", "long_name": long_name}
        derived[name] = (("chain", "draw"), product, attrs)
    groups = {name: node.to_dataset() for name, node in tree.children.items()}
    complete = xr.DataTree.from_dict({**groups, "posterior": posterior.assign(derived)})
    complete.attrs.update(tree.attrs)
    return complete


def _order(data: OpeningData) -> int:
    return ("displacement", "velocity", "acceleration").index(data.records.response)
