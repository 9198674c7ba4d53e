import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.infer import MCMC, NUTS
from numpyro.infer.util import log_density

from jbw.errors import ConfigError
from jbw.inference.box import box
from jbw.inference.model import box_model, in_unit_box, uniform_start

BOX = box({"zeta": (0.0, 2.0), "alpha": (1.0, 5.0)})


def gaussian(theta, data):
    return -0.5 * jnp.square(jnp.stack([theta["zeta"], theta["alpha"]]) - data)


def test_density_is_likelihood_prior_and_the_box():
    model = box_model(gaussian, BOX, log_prior=lambda theta: -3.0 * theta["zeta"])
    theta = {"zeta": jnp.asarray(0.5), "alpha": jnp.asarray(4.0)}
    got, trace = log_density(model, (jnp.array([1.0, 2.0]),), {}, theta)
    np.testing.assert_allclose(got, -0.5 * (0.25 + 4.0) - 1.5 - np.log(2.0 * 4.0), rtol=1e-14)
    assert {"zeta", "alpha"} < set(trace)


@pytest.mark.parametrize("value", [jnp.nan, jnp.inf, -jnp.inf])
def test_a_failed_solve_is_impossible_not_an_error(value):
    model = box_model(lambda theta, data: jnp.array([0.0, value]), BOX)
    theta = {"zeta": jnp.asarray(0.5), "alpha": jnp.asarray(4.0)}
    assert log_density(model, (None,), {}, theta)[0] == -jnp.inf


def test_unit_box_places_every_site():
    x = {"zeta": jnp.asarray(0.25), "alpha": jnp.asarray(0.5)}
    model = in_unit_box(box_model(gaussian, BOX), x)
    _, trace = log_density(model, (jnp.zeros(2),), {}, {})
    assert float(trace["zeta"]["value"]) == 0.5
    assert float(trace["alpha"]["value"]) == 3.0


def test_an_unbounded_site_is_refused_by_name():
    import numpyro
    import numpyro.distributions as dist

    with pytest.raises(ConfigError, match="`free`"):
        uniform_start(jax.random.key(0), lambda: numpyro.sample("free", dist.Normal()), (), {})


@pytest.mark.slow
def test_the_model_runs_under_plain_numpyro():
    mcmc = MCMC(NUTS(box_model(gaussian, BOX)), num_warmup=300, num_samples=500, progress_bar=False)
    mcmc.run(jax.random.key(0), jnp.array([1.0, 3.0]))
    # The target is symmetric about the data; 500 draws of sd < 0.9 have a mean good to 0.2.
    assert abs(float(mcmc.get_samples()["alpha"].mean()) - 3.0) < 0.2
