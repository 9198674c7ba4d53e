"""`jbw.numpyro_model`: the joint posterior of a campaign as a plain NumPyro model."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jbw.campaign.document import refuse
from jbw.campaign.joints import require_one_joint
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify, law_errors
from jbw.identification.assemble import measured_in
from jbw.identification.prepare import Fitted, fit_joint
from jbw.identification.procedure import Report
from jbw.inference.numpyro_model import NumpyroModel
from jbw.inference.space.box import require_float64
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.inference.space.stated import StatedDensities, distributions_of
from jbw.observables.dataset import Dataset, log_likelihood
from jbw.observables.drives import of_drive
from jbw.oscillator.laws import laws_named

logger = logging.getLogger("jbw")


def numpyro_model(
    campaign: Campaign,
    *,
    prior: Mapping[str, Any] | None = None,
    responses: bool = False,
    seed: int | None = None,
    report: Report = logger.info,
) -> NumpyroModel:
    """Return a campaign's joint posterior as a NumPyro model, with data weights from a fit.

    Latent sites are the sampled parameters in SI, uniform within their bounds unless a density is
    stated. The factor `log_likelihood` is marginal over noise and session offsets. Deterministic
    sites are the parameters and products of the laws that are not sampled.

    Args:
        campaign: A campaign from `jbw.load_campaign` or the virtual rig.
        prior: Priors by name that replace the campaign's: bounds (lower, upper), a distribution of
            NumPyro, or a table such as {"LogNormal": [-5.4, 0.3]}; in SI.
        responses: Whether the predicted response of every fitted test is a deterministic site,
            `response of TEST`, in the unit of its values.
        seed: Seed of the fit's starts; when None that of the campaign.
        report: A function that is called with one sentence at every stage.

    Returns:
        The model, for `MCMC(model.nuts())`, `MCMC(model.random_walk())`, `Predictive(model, ...)`
        and SVI.

    Raises:
        ConfigError: The session is in float32, a prior is invalid, or the laws lack its parameter.
        DataError: The joint cannot be fitted to the tests.

    Examples:
        A calibration of the gain to 1 % is stated as its prior:

        >>> import jbw; jbw.enable_x64()
        >>> import numpyro.distributions as dist
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> model = jbw.numpyro_model(campaign, prior={"gain": dist.Normal(15.0, 0.15)})
        >>> print(model)
        NumpyroModel(omega_n, zeta, alpha, delta, gamma, gain)
    """
    require_float64()
    require_one_joint(campaign.joints, "A NumPyro model")
    if prior:
        campaign = _with_prior(campaign, prior)
    key = jax.random.key(campaign.settings.seed if seed is None else seed)
    return model_of(fit_joint(key, measured_in(campaign, report), report), responses=responses)


def model_of(fitted: Fitted, *, responses: bool = False) -> NumpyroModel:
    """Return the posterior for a fit's data as a NumPyro model."""
    fit, box, data = fitted.fit, fitted.box, fitted.data
    # The NumPyro sites already contain the stated prior densities, which must not be counted twice.
    unstated = replace(data, stated=StatedDensities())

    def derived(theta: Mapping[str, Any]) -> dict[str, Any]:
        sites = _of_laws(theta, data)
        return sites | _predicted(theta, data) if responses else sites

    return NumpyroModel(
        prior=distributions_of(box, data.stated),
        log_likelihood=lambda theta: jnp.sum(log_likelihood(theta, unstated)),
        derived=derived,
        problem=problem_of(log_likelihood, box, data, in_box(box, fit.theta, fit.covariance, 1)),
        optimum=fit.theta,
        covariance=fit.covariance,
        uniform=tuple(name for name in box.names if name not in data.stated.names),
    )


def _of_laws(theta: Mapping[str, Any], data: Dataset) -> dict[str, Any]:
    """Return those parameters and products of the laws that follow from the sampled parameters."""
    every = {**data.held, **theta}
    values: dict[str, Any] = {}
    for law in laws_named(data.laws):
        parameters = law.build(every).parameters()
        products = {p.quantity.name: p.of({**every, **parameters}) for p in law.products}
        values |= {**parameters, **products}
    return {name: value for name, value in values.items() if name not in theta}


def _predicted(theta: Mapping[str, Any], data: Dataset) -> dict[str, Any]:
    every = {**data.held, **theta}
    return {
        f"response of {label}": rows
        for part in data.parts
        for label, rows in zip(
            part.groups.labels, part.predict(of_drive(every, part.drive)), strict=True
        )
    }


def _with_prior(campaign: Campaign, prior: Mapping[str, Any]) -> Campaign:
    """Return the campaign with some priors replaced, each checked as in a campaign file."""
    # Only the new priors are checked: Python code may have made settings that a file rejects.
    checked = Identify.of({"prior": {**campaign.settings.prior, **prior}})
    settings = campaign.settings.model_copy(update={"prior": checked.prior})
    modes = 1 if campaign.structure is None else len(campaign.structure.modes)
    kinds = [test.kind for test in campaign.tests]
    refuse("Argument `prior`", law_errors(campaign.laws, settings.prior, modes, kinds))
    return replace(campaign, settings=settings)
