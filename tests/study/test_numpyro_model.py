"""The joint posterior as a plain NumPyro model: its density, its samplers, and what runs on it."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro.infer import MCMC, SVI, Predictive, Trace_ELBO, autoguide, init_to_value
from numpyro.infer.util import log_density
from scipy import stats
from toy_campaign import PLAIN, TRUTH, write_toy

import jbw
from jbw.errors import ConfigError
from jbw.inference.density import density_of
from jbw.inference.space.stated import StatedDensities
from jbw.study.numpyro_model import model_of

NAMES = {"omega_n", "zeta", "alpha", "delta", "gamma"}
# About as wide as the data's own knowledge, and beside its centre: both matter.
STATED = {"alpha": {"Normal": [3003.0, 3.0]}, "zeta": {"LogNormal": [np.log(0.01), 0.002]}}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return jbw.load_campaign(write_toy(tmp_path_factory.mktemp("toy"), PLAIN))


@pytest.fixture(scope="module")
def model(campaign):
    return jbw.numpyro_model(campaign, responses=True)


@pytest.fixture(scope="module")
def walked(model):
    walk = MCMC(
        model.random_walk(None),
        num_warmup=2000,
        num_samples=20000,
        num_chains=4,
        chain_method="vectorized",
        progress_bar=False,
    )
    walk.run(jax.random.key(1))
    return {name: np.asarray(values) for name, values in walk.get_samples().items()}


def density_at(model, point):
    return float(log_density(model, (), {}, point)[0])


def test_sites_are_the_parameters_and_what_follows_from_them(model):
    sites = log_density(model, (), {}, model.start)[1]
    latent = {name for name, site in sites.items() if site["type"] == "sample"} - {"log_likelihood"}
    assert latent == NAMES
    assert float(sites["alpha_delta"]["value"]) == model.start["alpha"] * model.start["delta"]
    assert sites["response of strong"]["value"].shape == (512,)


def test_a_point_off_the_fit_costs_likelihood(model):
    moved = {**model.start, "zeta": model.start["zeta"] * 1.05}
    assert density_at(model, moved) < density_at(model, model.start) - 10.0


def test_a_stated_density_adds_what_scipy_says(model):
    densities = StatedDensities.of({name: density_of(each) for name, each in STATED.items()})
    bare = model.problem.data
    fit = SimpleNamespace(theta=model.optimum, covariance=model.covariance)
    fitted = SimpleNamespace(fit=fit, box=model.box, data=replace(bare, stated=densities))
    point = {**model.start, "alpha": 3001.0, "zeta": 0.01002}
    boxes = [model.prior[name] for name in STATED]
    uniform = sum(-np.log(float(prior.high - prior.low)) for prior in boxes)
    normal = stats.norm(3003.0, 3.0).logpdf(3001.0)
    log_normal = stats.lognorm(0.002, scale=0.01).logpdf(0.01002)
    expected = density_at(model, point) - uniform + normal + log_normal
    assert density_at(model_of(fitted), point) == pytest.approx(expected, abs=1e-9)


@pytest.mark.release  # test_comparing.py compares samplers
def test_the_paper_walk_and_nuts_draw_from_the_same_posterior(model, walked):
    nuts = MCMC(model.nuts(), num_warmup=200, num_samples=1000, num_chains=1, progress_bar=False)
    nuts.run(jax.random.key(0))
    drawn = nuts.get_samples()
    assert drawn["alpha_gamma"].shape == (1000,)
    for name in NAMES:
        std = np.std(walked[name])
        # Of about 500 effective draws of either: four standard errors of a difference of means.
        assert abs(np.mean(drawn[name]) - np.mean(walked[name])) < 4 * np.sqrt(2 / 500) * std
        assert np.std(drawn[name]) == pytest.approx(std, rel=4 * np.sqrt(1 / 500))
        assert abs(np.mean(walked[name]) - TRUTH[name]) < 4 * std


@pytest.mark.release  # below `identify` takes one
def test_draws_under_a_stated_prior_are_those_of_the_box_weighed_by_it(campaign, walked):
    """Importance weights by SciPy's densities of draws under boxes, which cover these priors."""
    weight = stats.norm(3003.0, 3.0).pdf(walked["alpha"])
    weight *= stats.lognorm(0.002, scale=0.01).pdf(walked["zeta"])
    weight /= np.sum(weight)
    stated = jbw.numpyro_model(campaign, prior=STATED)
    nuts = MCMC(stated.nuts(), num_warmup=200, num_samples=1000, num_chains=1, progress_bar=False)
    nuts.run(jax.random.key(0))
    effective = 1 / np.sum(weight**2) / 40  # of a walk whose draws hang together over tens of steps
    for name, draws in nuts.get_samples().items():
        if name not in NAMES:
            continue
        mean = np.sum(weight * walked[name])
        std = np.sqrt(np.sum(weight * (walked[name] - mean) ** 2))
        error = std * np.sqrt(1 / effective + 1 / 400)
        assert abs(np.mean(draws) - mean) < 4 * error
        assert np.std(draws) == pytest.approx(std, rel=4 * np.sqrt(0.5 / effective + 0.5 / 400))


@pytest.mark.release  # its sites and densities are above
def test_predictive_and_guides_run_on_it(model):
    before = Predictive(model, num_samples=5)(jax.random.key(0))
    assert before["response of pull"].shape == (5, 512)
    guide = autoguide.AutoMultivariateNormal(
        model, init_loc_fn=init_to_value(values=model.start), init_scale=1e-3
    )
    svi = SVI(model, guide, numpyro.optim.Adam(1e-3), Trace_ELBO())
    losses = svi.run(jax.random.key(0), 200, progress_bar=False).losses
    assert np.median(losses[-50:]) < np.median(losses[:50])  # each is of one draw


def test_a_prior_replaces_that_of_a_campaign_without_held_out_tests(tmp_path, monkeypatch):
    """The example of howto/priors.md; what is fitted is the campaign that has the prior."""
    text = PLAIN.replace('hold_out = ["weak"]\n', "") + "[identify.prior]\nzeta = [0.001, 0.1]\n"
    campaign = jbw.load_campaign(write_toy(tmp_path, text))
    asked = []

    def measured_in(campaign, report):
        asked.append(campaign)
        raise LookupError

    monkeypatch.setattr("jbw.study.numpyro_model.measured_in", measured_in)
    with pytest.raises(LookupError):
        jbw.numpyro_model(campaign, prior={**STATED, "gamma": dist.LogNormal(5.0, 0.1)})
    ((name, (low, high)),) = campaign.settings.prior.items()
    assert (name, low, high) == ("zeta", 0.001, 0.1)
    prior = {name: density.build() for name, density in asked[0].settings.prior.items()}
    assert (prior["alpha"].loc, prior["alpha"].scale) == (3003.0, 3.0)
    assert (prior["gamma"].loc, prior["zeta"].scale) == pytest.approx((5.0, 0.002))
    none = {"prior": {}}
    assert asked[0].settings.model_copy(update=none) == campaign.settings.model_copy(update=none)


@pytest.mark.parametrize(
    ("prior", "says"),
    [
        ({"alpha": {"Normal": [3000.0]}, "kappa": [0.0, 1.0]}, "kappa: unknown parameter"),
        ({"zeta": dist.Normal(0.01, 0.01)}, "must be positive.*TruncatedNormal takes an end `low`"),
        ({"zeta": "narrow"}, "must be .lower, upper., or a distribution"),
        ({"alpha_delta": {"LogNormal": [14.0, 0.1]}}, "alpha_delta"),
    ],
)
def test_a_prior_that_is_none_is_refused(campaign, prior, says):
    with pytest.raises(ConfigError, match=says):
        jbw.numpyro_model(campaign, prior=prior)


def test_identify_takes_a_density_from_the_campaign_file(tmp_path):
    """Known far better than the data know it, zeta has its prior for a posterior."""
    known = "\n[identify.prior]\nzeta = { LogNormal = [-4.60517, 1e-5] }\n"
    text = PLAIN.replace("num_samples = 100", "num_samples = 1000") + known
    study = jbw.identify(jbw.load_campaign(write_toy(tmp_path, text)))
    zeta = study.posterior["posterior"]["zeta"]
    assert zeta.attrs["prior"] == "{ LogNormal = [-4.60517, 1e-05] }"
    logs = np.log(zeta.values)
    # Standard errors of 1000 effective draws or more, fourfold.
    assert abs(np.mean(logs) + 4.60517) < 4e-5 / np.sqrt(1000) + 0.02e-5
    assert np.std(logs) == pytest.approx(1e-5, rel=4 / np.sqrt(2000))
    group = study.posterior["log_prior"].to_dataset()["zeta"].values
    reference = stats.lognorm(1e-5, scale=np.exp(-4.60517)).logpdf(zeta.values)
    np.testing.assert_allclose(group, reference, rtol=1e-6)
    known = study.posterior["identifiability"].to_dataset().sel(parameter="zeta")
    # Of the density, and not of the box; 1000 draws leave a twentieth.
    assert float(known["parameter_contraction"]) == pytest.approx(0.0, abs=0.15)
    assert float(known["parameter_ratio"]) == pytest.approx(1.0, abs=1e-2)
