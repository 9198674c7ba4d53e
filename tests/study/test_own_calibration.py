"""`jbw.sbc` of a posterior of one's own: a conjugate normal, whose posterior is known; slips."""

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
import pytest
from scipy import stats

import jbw
from jbw.errors import ConfigError
from jbw.inference.calibration.replications import own_model
from jbw.inference.samplers.chains import draws_of
from jbw.inference.space.problem import problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.lab.calibration import suited
from jbw.lab.models import CalibratedStep

PRIOR = {"mu": dist.Normal(2.0, 3.0)}
COUNT, SIGMA = 5, 2.0


def simulate(key, theta):
    return theta["mu"] + SIGMA * jax.random.normal(key, (COUNT,))


def log_likelihood(theta, data, sigma=SIGMA):
    return -0.5 * ((data - theta["mu"]) / sigma) ** 2


@pytest.mark.parametrize(
    ("prior", "reference"),
    [
        (dist.Normal(2.0, 3.0), stats.norm(2.0, 3.0)),
        (dist.LogNormal(0.5, 0.7), stats.lognorm(0.7, scale=np.exp(0.5))),
        (dist.Gamma(2.5, 4.0), stats.gamma(2.5, scale=0.25)),
        (dist.Beta(2.0, 5.0), stats.beta(2.0, 5.0)),
        (dist.InverseGamma(3.0, 2.0), stats.invgamma(3.0, scale=2.0)),
        (dist.Uniform(-1.0, 2.0), stats.uniform(-1.0, 3.0)),
    ],
    ids=lambda one: type(one).__name__ if isinstance(one, dist.Distribution) else "",
)
def test_quantiles_are_those_of_the_prior_with_their_slope(prior, reference):
    """SciPy's; one over its density."""
    model = own_model(lambda key, theta: theta["x"], lambda theta, data: theta["x"], {"x": prior})
    u = np.array([0.001, 0.2, 0.5, 0.97])
    found, slope = jax.vmap(jax.value_and_grad(lambda u: model.log_likelihood({"x": u}, None)))(u)
    expected = reference.ppf(u)
    # Of JAX's incomplete gamma and beta functions.
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(slope, 1.0 / reference.pdf(expected), rtol=1e-5)


@pytest.mark.slow  # some seconds of draws
def test_a_conjugate_normal_is_drawn_as_its_formula_says_and_calibrated():
    step = CalibratedStep(own_model(simulate, log_likelihood, PRIOR), 100, "nuts")
    model, sampler, options = suited(step, "nuts")
    data = jnp.array([1.0, 4.0, -1.0, 0.5, 3.5])
    problem = problem_of(model.log_likelihood, model.box, data, in_box(model.box, None, None, 1))
    drawn = draws_of(sampler, jax.random.key(0), problem, options)
    mu = np.ravel(stats.norm(2.0, 3.0).ppf(drawn.theta["mu"]))
    precision = 1 / 9 + COUNT / SIGMA**2
    mean, sd = (2.0 / 9 + float(data.sum()) / SIGMA**2) / precision, precision**-0.5
    # Some thousand draws: five standard errors of the mean, and of the sd.
    assert np.mean(mu) == pytest.approx(mean, abs=5 * sd / np.sqrt(500))
    assert np.std(mu) == pytest.approx(sd, rel=5 / np.sqrt(1000))
    told = []
    found = jbw.sbc(
        simulate=simulate, log_likelihood=log_likelihood, prior=PRIOR, num_replications=200,
        sampler="quadrature", report=told.append,
    )  # fmt: skip
    assert found.calibration.verdict.status == "ok"
    assert found.record["step"] == "own"
    assert told[-1] == "own: 200 of 200 replications"
    assert found.calibration.names == ("mu", "log_likelihood")
    # Noise taken for half of what it is: intervals half as wide hold 80 of 100.
    slip = jbw.sbc(
        simulate=simulate, log_likelihood=lambda t, d: log_likelihood(t, d, SIGMA / 2),
        prior=PRIOR, num_replications=200, sampler="quadrature",
    )  # fmt: skip
    assert slip.calibration.verdict.status == "failed"
    share = slip.calibration.coverage["mu"][0]
    expected = 2 * stats.norm.cdf(2.576 / 2) - 1  # but for the prior, which is wide
    assert share == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / 200) + 0.02)


def test_what_is_no_prior_is_refused():
    functions = {"simulate": simulate, "log_likelihood": log_likelihood}
    for prior, says in (
        ({"mu": (0.0, 1.0)}, "NumPyro distribution of one number"),
        ({"mu": dist.Normal(jnp.zeros(2), 1.0)}, "NumPyro distribution of one number"),
        ({"mu": dist.Poisson(2.0)}, "is discrete"),
        ([dist.Normal(0.0, 1.0)], "the name of every parameter"),
        ({}, "at least one parameter"),
        ({"mu": dist.VonMises(0.0, 1.0)}, "must have quantiles"),
    ):
        with pytest.raises(ConfigError, match=says):
            jbw.sbc(**functions, prior=prior)
    with pytest.raises(ConfigError, match="all three"):
        jbw.sbc(simulate=simulate, prior=PRIOR)
    with pytest.raises(ConfigError, match="`step` must be one of linear"):
        jbw.sbc(step="own")
