"""NumPyro's NUTS on a likelihood through `simulate`: both modes of AD, both ways of chains."""

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro.infer import MCMC, NUTS

from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.response import simulate

FS, NOISE = 256.0, 0.02
INPUT = jnp.asarray(10.0 * np.sin(2 * np.pi * 17 * np.arange(96) / FS))


def velocity(zeta, delta):
    joint = BoucWen(2 * np.pi * 18.8, zeta, 497.4, delta, 32.84)
    return simulate(joint, INPUT, FS, substeps=2).v


def model(data):
    zeta = numpyro.sample("zeta", dist.Uniform(0.0, 0.1))
    delta = numpyro.sample("delta", dist.Uniform(100.0, 600.0))
    numpyro.sample("v", dist.Normal(velocity(zeta, delta), NOISE), obs=data)


@pytest.mark.release  # test_numpyro_model.py has NUTS on records, test_adjoint.py both modes
def test_modes_and_chain_methods_give_one_posterior():
    truth = velocity(0.03, 340.0)
    data = truth + NOISE * np.random.default_rng(0).normal(size=truth.shape)
    posteriors = {}
    for forward in (False, True):
        for method in ("sequential", "vectorized"):
            kernel = NUTS(model, forward_mode_differentiation=forward, max_tree_depth=5)
            mcmc = MCMC(
                kernel, num_warmup=100, num_samples=100, num_chains=2,
                chain_method=method, progress_bar=False,
            )  # fmt: skip
            mcmc.run(jax.random.key(1), data)
            assert not np.any(mcmc.get_extra_fields()["diverging"])
            posteriors[forward, method] = mcmc.get_samples()
    for name in ("zeta", "delta"):
        draws = {key: np.asarray(posterior[name]) for key, posterior in posteriors.items()}
        reference = draws[False, "sequential"]
        for key, other in draws.items():
            # Two means of 200 draws, of which about 80 count: 0.16 sd; four times that.
            gap = abs(other.mean() - reference.mean()) / reference.std()
            assert gap < 0.64, (name, key, gap)
            assert 0.7 < other.std() / reference.std() < 1.4, (name, key)
