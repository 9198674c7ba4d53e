"""The joint from free decays: what softens and what dissipates, from records without a force."""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Key

from jbw.identification.decay_accuracy import (
    frequency_scatter,
    residual_finding,
    shape_finding,
    solver_finding,
)
from jbw.identification.decay_fit import decay_box, fit_decay
from jbw.identification.decay_reading import first_reading
from jbw.identification.effects import effects, effects_sentence, response_finding
from jbw.identification.step import ATTRS, Step, finished
from jbw.inference.fitting import Fit
from jbw.inference.keeping import Keep, nowhere
from jbw.inference.sampling import sample
from jbw.measurement.records import Test
from jbw.observables.decay import Decays, reduce
from jbw.observables.decay_likelihood import (
    draw_noise_std,
    log_likelihood,
    matches,
)
from jbw.observables.joint import joint_of

NAMES = ("omega_n", "zeta", "softening", "opening", "share")


def decay_step(
    key: Key[Array, ""],
    test: Test,
    settings: Mapping[str, Any],
    name: str = "joint",
    *,
    keep: Keep = nowhere,
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
        keep: Where the chains outlive the process.

    Returns:
        The step, and the data with the noise, scatter and worth that the fit found.
    """
    started = perf_counter()
    keys = jax.random.split(key, 3)
    data = reduce(test, substeps=settings.get("substeps", 1))
    reading = first_reading(test)
    prior = decay_box(settings, reading)
    best, data = fit_decay(keys[0], data, prior, reading)
    if settings.get("model_error") == "none":
        data = replace(data, worth=jnp.ones(()))
    tree = sample(
        keys[1],
        log_likelihood,
        prior,
        data,
        num_warmup=settings.get("num_warmup", 200),
        num_samples=settings.get("num_samples", 500),
        num_chains=settings.get("num_chains", 4),
        chain_method="parallel" if jax.device_count() > 1 else "sequential",
        start=best.theta,
        # Each value is worth less than one, so the fit knows less than it thinks.
        covariance=best.covariance / float(data.worth),
        # The fit's optimum often lies at the share's bound, where the correlations are others.
        adapt_mass=True,
        target_accept=0.9,
        attrs=ATTRS,
        kept=keep(name),
    )
    posterior = with_joint(keys[2], tree, data)
    draws = posterior["posterior"].to_dataset()
    findings = [residual_finding(best.theta, data), shape_finding(best.theta, data)]
    if (error := solver_finding(draws, data)) is not None:
        findings.append(error)
    words = statements(draws, best, data)
    y_peak = float(data.y_start)
    if (bands := response_finding(draws, {}, y_peak)) is not None:
        findings.append(bands)
    if (found := effects(draws, {}, y_peak)) is not None:
        words.append(effects_sentence(found, y_peak))
    return finished(
        name, posterior, prior, best, started,
        findings=findings, statements=words, chi_square=best.chi_square,
    ), data  # fmt: skip


def with_joint(key: Key[Array, ""], tree: xr.DataTree, data: Decays) -> xr.DataTree:
    """The posterior with alpha, delta, gamma and the noise of every record beside it."""
    posterior = tree["posterior"].to_dataset()
    theta = {name: jnp.asarray(posterior[name].values) for name in NAMES}
    joint = joint_of(theta)
    derived: dict[str, Any] = {
        name: (("chain", "draw"), np.asarray(getattr(joint, name)), ATTRS[name])
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
