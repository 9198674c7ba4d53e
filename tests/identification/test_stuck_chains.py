"""What is said where a sampler does not suit the posterior."""

import numpy as np
import pytest
import xarray as xr

from jbw.identification.checks import stuck
from jbw.inference.posterior.verdict import verdict
from jbw.inference.space.box import box

PRIOR = box({"zeta": (0.0, 1.0)})


def chains(apart, sampler):
    rng = np.random.default_rng(0)
    values = 0.5 + 0.01 * rng.standard_normal((4, 400)) + apart * np.arange(4)[:, None]
    tree = xr.DataTree.from_dict(
        {
            "posterior": xr.Dataset({"zeta": (("chain", "draw"), values)}),
            "sample_stats": xr.Dataset({"n_steps": (("chain", "draw"), np.ones((4, 400)))}),
        }
    )
    tree.attrs["sampler"] = sampler
    return tree


@pytest.mark.parametrize(
    ("apart", "sampler", "told"),
    [(0.05, "elliptical_slice", True), (0.0, "elliptical_slice", False), (0.05, "nuts", False)],
)
def test_slices_that_do_not_mix_point_to_nuts(apart, sampler, told):
    tree = chains(apart, sampler)
    words = stuck(tree, verdict(tree, PRIOR).findings)
    assert bool(words) is told
    assert all('sampler = "nuts"' in sentence for sentence in words)
