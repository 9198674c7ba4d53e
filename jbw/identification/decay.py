"""The joint from free decays: what softens and what dissipates, from records without a force."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from time import perf_counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Key
from scipy.optimize import OptimizeResult, least_squares

from jbw.identification.decay_accuracy import (
    frequency_scatter,
    residual_finding,
    shape_finding,
    solver_finding,
    worth_of,
)
from jbw.identification.decay_reading import FirstReading, first_reading
from jbw.identification.priors import stated
from jbw.identification.step import ATTRS, Step, finished
from jbw.inference.box import Box, box, from_unit, to_unit
from jbw.inference.fitting import START_MARGIN, Fit, describe_optimum
from jbw.inference.sampling import sample
from jbw.measurement.records import Test
from jbw.observables.decay import Decays, reduce
from jbw.observables.decay_likelihood import (
    draw_noise_std,
    log_likelihood,
    matches,
    residual,
    shift_errors,
)
from jbw.observables.decay_model import joint_of

NAMES = ("omega_n", "zeta", "softening", "opening", "share")
NUM_STARTS = 3
MOST_EVALUATIONS = 30  # of a start
SHARE = (0.002, 0.9)  # of the stiffness: from a joint that hardly carries to nearly all of it
DECAY_ATTRS = {
    **ATTRS,
    "softening": {"units": "m-1", "long_name": "softening, alpha * delta / omega_n^2"},
    "opening": {"units": "m-1", "long_name": "opening, alpha * gamma / omega_n^2"},
    "share": {"units": "1", "long_name": "joint's share of the stiffness, alpha / omega_n^2"},
}


def decay_step(
    key: Key[Array, ""], test: Test, settings: Mapping[str, Any], name: str = "joint"
) -> tuple[Step, Decays]:
    """Posterior of the joint from the decays of a test.

    Weakly nonlinear decays know the joint only by alpha delta and alpha gamma over omega_n^2; so
    these are sampled, uniform in their box, and so is alpha's share of the stiffness, which the
    data leave where the prior has it. alpha, delta and gamma follow from the three.

    Args:
        key: Random key.
        test: The decays to fit.
        settings: The campaign's [identify] table.
        name: Name of the step.

    Returns:
        The step, and the data with the noise, scatter and worth that the fit found.
    """
    started = perf_counter()
    keys = jax.random.split(key, 3)
    data = reduce(test, substeps=settings.get("substeps", 1))
    reading = first_reading(test)
    prior = decay_box(settings, reading)
    best, data = fit_decay(keys[0], data, prior, reading)
    tree = sample(
        keys[1],
        log_likelihood,
        prior,
        data,
        num_warmup=settings.get("num_warmup", 100),
        num_samples=settings.get("num_samples", 500),
        num_chains=settings.get("num_chains", 4),
        chain_method="parallel" if jax.device_count() > 1 else "sequential",
        start=best.theta,
        # Each value is worth less than one, so the fit knows less than it thinks.
        covariance=best.covariance / float(data.worth),
        attrs=DECAY_ATTRS,
    )
    posterior = with_joint(keys[2], tree, data)
    draws = posterior["posterior"].to_dataset()
    findings = [residual_finding(best.theta, data), shape_finding(best.theta, data)]
    findings.append(solver_finding(draws, data))
    words = statements(draws, best, data)
    return finished(
        name, posterior, prior, best, started, findings=findings, statements=words
    ), data


def decay_box(settings: Mapping[str, Any], reading: FirstReading) -> Box:
    """Box about the first reading; a campaign's bounds on alpha, delta, gamma are carried over.

    Args:
        settings: The campaign's [identify] table.
        reading: Frequency and damping against amplitude.

    Returns:
        The box of omega_n, zeta, softening, opening and share.
    """
    floor = 0.01 / reading.y_peak  # a joint that does next to nothing
    bounds = {
        "omega_n": (0.99 * reading.omega_n, 1.01 * reading.omega_n),
        "zeta": (0.02 * reading.zeta_range[0], 2.0 * reading.zeta_range[1]),
        "softening": (0.0, 4.0 * max(reading.softening, floor)),
        "opening": (0.0, 4.0 * max(reading.opening, floor)),
        "share": SHARE,
    }
    given = stated(settings)
    for known in ("omega_n", "zeta"):
        bounds[known] = given.get(known, bounds[known])
    omega_n = bounds["omega_n"]
    if "alpha" in given:
        bounds["share"] = (given["alpha"][0] / omega_n[1] ** 2, given["alpha"][1] / omega_n[0] ** 2)
    for product, factor in (("softening", "delta"), ("opening", "gamma")):
        if factor in given:
            low, high = given[factor]
            bounds[product] = (bounds["share"][0] * low, bounds["share"][1] * high)
    return box(bounds)


def fit_decay(
    key: Key[Array, ""], data: Decays, prior: Box, reading: FirstReading
) -> tuple[Fit, Decays]:
    """Least squares from the reading and many shares, twice: the first one finds the noise.

    Args:
        key: Random key of the starts.
        data: The reduced decays.
        prior: The box.
        reading: Where to start.

    Returns:
        The fit, and the data with the noise of every record, the scatter of their frequencies and
        the worth of a value, as the first fit leaves them.
    """
    drawn = from_unit(jax.random.uniform(key, (NUM_STARTS, len(NAMES))), prior)
    starts = {
        "omega_n": np.full(NUM_STARTS, reading.omega_n),
        "zeta": np.full(NUM_STARTS, reading.zeta),
        "softening": np.full(NUM_STARTS, reading.softening),
        "opening": np.full(NUM_STARTS, reading.opening),
        "share": np.asarray(drawn["share"]),
    }
    inside = {
        name: np.clip(starts[name], prior.lower[i], prior.upper[i])
        for i, name in enumerate(prior.names)
    }
    first = best_fit(data, prior, inside)
    data = scaled(first.theta, data)
    return best_fit(data, prior, inside), data


def best_fit(data: Decays, prior: Box, starts: Mapping[str, np.ndarray]) -> Fit:
    """Least squares in the box from several starts, one after the other.

    A trust region of scipy on one compiled function: a handful of evaluations from a good start.
    """
    x_starts = np.clip(np.asarray(to_unit(starts, prior)), START_MARGIN, 1 - START_MARGIN)

    @lru_cache(maxsize=1)  # scipy asks for the residual and then for the Jacobian at one point
    def at(x: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        jacobian, left = _linearise(jnp.asarray(x), prior, data)
        return np.asarray(left), np.asarray(jacobian)

    def linearised(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return at(tuple(x.tolist()))

    def one(x: np.ndarray) -> OptimizeResult:
        return least_squares(
            lambda x: linearised(x)[0],
            x,
            lambda x: linearised(x)[1],
            bounds=(0.0, 1.0),
            x_scale="jac",
            max_nfev=MOST_EVALUATIONS,
            ftol=1e-8,
        )

    found = [one(x) for x in x_starts]
    costs = np.array([each.cost for each in found])
    best = found[int(np.argmin(costs))]
    left, jacobian = linearised(best.x)
    return describe_optimum(best.x, left, jacobian, prior, costs, bool(best.success))


@eqx.filter_jit
def _linearise(x: Array, prior: Box, data: Decays) -> tuple[Array, Array]:
    """Jacobian with respect to x and residual, in one pass."""

    def both(x: Array) -> tuple[Array, Array]:
        left = residual(from_unit(x, prior), data)
        return left, left

    return jax.jacfwd(both, has_aux=True)(x)


def scaled(theta: Mapping[str, float], data: Decays) -> Decays:
    """The data with the noise, the scatter and the worth that a fit leaves."""
    found = jax.jit(matches)({name: jnp.asarray(v) for name, v in theta.items()}, data)
    size = data.envelope.shape[1]
    noise = jnp.sqrt(found.misfit / (2 * size - 3))
    worth = worth_of(np.asarray(found.residual))
    errors = float(jnp.sqrt(jnp.mean(shift_errors(found, data) ** 2)))
    scatter = max(float(jnp.sqrt(jnp.mean(found.entry.shift**2))), errors)
    return replace(
        data,
        noise_std=noise,
        worth=jnp.asarray(worth),
        shift_std=jnp.asarray(scatter * np.sqrt(worth)),
    )


def with_joint(key: Key[Array, ""], tree: xr.DataTree, data: Decays) -> xr.DataTree:
    """The posterior with alpha, delta, gamma and the noise of every record beside it."""
    posterior = tree["posterior"].to_dataset()
    theta = {name: jnp.asarray(posterior[name].values) for name in NAMES}
    joint = joint_of(theta)
    derived: dict[str, Any] = {
        name: (("chain", "draw"), np.asarray(getattr(joint, name)), DECAY_ATTRS[name])
        for name in ("alpha", "delta", "gamma")
    }
    flat = {name: values.ravel() for name, values in theta.items()}
    noise = _draw_noise(jax.random.split(key, flat["zeta"].size), flat, data)
    shape = (*posterior["zeta"].shape, -1)
    unit = {"displacement": "m", "velocity": "m s-1", "acceleration": "m s-2"}[data.response]
    derived["noise_std"] = (
        ("chain", "draw", "record"),
        np.asarray(noise).reshape(shape),
        {"units": unit, "long_name": "noise of a record in the band, misfit included"},
    )
    groups = {name: node.to_dataset() for name, node in tree.children.items()}
    complete = xr.DataTree.from_dict({**groups, "posterior": posterior.assign(derived)})
    complete.attrs.update(tree.attrs)
    return complete


@eqx.filter_jit
def _draw_noise(keys: Array, theta: Mapping[str, Array], data: Decays) -> Array:
    def one(pair: tuple[Array, dict[str, Array]]) -> Array:
        return draw_noise_std(pair[0], matches(pair[1], data), data)

    return jax.lax.map(one, (keys, dict(theta)), batch_size=8)


def statements(posterior: xr.Dataset, best: Fit, data: Decays) -> list[str]:
    """What free decays identify and what they do not, with numbers."""
    low, mid, high = (
        {name: float(posterior[name].quantile(q)) for name in NAMES} for q in (0.005, 0.5, 0.995)
    )
    scatter = frequency_scatter(best.theta, data) / (2 * np.pi)
    return [
        "Free decays determine the joint by two numbers, "
        + " and ".join(
            f"{product} = alpha*{factor}/omega_n^2 = {mid[product]:.4g} 1/m "
            f"[{low[product]:.4g}, {high[product]:.4g}]"
            for product, factor in (("softening", "delta"), ("opening", "gamma"))
        )
        + ", beside omega_n and zeta.",
        "alpha, delta and gamma by themselves follow the prior of the joint's share of the "
        f"stiffness, alpha/omega_n^2, of which the decays say only that it exceeds "
        f"{low['share']:.2g}.",
        f"The natural frequencies of the {data.envelope.shape[0]} records scatter by "
        f"{scatter:.2g} Hz, which the interval of omega_n includes.",
        f"Residuals are correlated: {float(data.worth):.0%} of the "
        f"{data.envelope.shape[1]} values of a record are counted as independent.",
    ]
