"""Without data, samplers that start from the prior give it back; the others: test_sampling.py."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest
from tiers import represented_by

from jbw.inference.posterior.summary import diagnose
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box

BOX = box({"b": (-3.0, 1.0), "a": (2.0, 50.0)})


def flat(theta, data):
    return 0.0 * theta["a"] * theta["b"] * data


@pytest.mark.release  # test_sampler_contract.py asks it of every sampler
@pytest.mark.parametrize("seed", represented_by(0, 1, 2))
@pytest.mark.parametrize("sampler", ["tempered_smc", "nested"])
def test_without_data_the_prior_comes_back(sampler, seed):
    tree = sample(jax.random.key(seed), flat, BOX, jnp.zeros(1), sampler=sampler, num_samples=1000)
    # An evidence of one: nothing was learnt.
    assert abs(tree.attrs["log_evidence"]) < 4 * tree.attrs["log_evidence_error"] + 1e-9
    for i, name in enumerate(BOX.names):
        values = tree["posterior"][name].values
        every = int(np.ceil(values.size / diagnose(values)["ess_bulk"]))
        lower, upper = float(BOX.lower[i]), float(BOX.upper[i])
        x = (values[:, :: 2 * every].ravel() - lower) / (upper - lower)
        assert kstest(x, "uniform").pvalue > 1e-4
