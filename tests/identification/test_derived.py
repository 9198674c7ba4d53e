"""What a fit explains of groups that were repeated, and what follows from the draws."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
import xarray as xr

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.joint import with_derived
from jbw.identification.prepare import explained
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import log_likelihood

FS, OMEGA_N = 256.0, 60.0
NUM = 200
TERMS = ("chain", "draw", "term")


def pull(name, repeats, noise):
    """A joint without slip on a displacement that grows: force omega_n^2 y."""
    rng = np.random.default_rng(repeats)
    t = np.arange(512) / FS
    y = 1e-3 * t * np.sin(2 * np.pi * t)
    units = {"displacement": "m", "restoring_force": "N"}
    forces = (OMEGA_N**2 * y + noise * rng.standard_normal(t.size) for _ in range(repeats))
    records = tuple(
        Record(FS, {"displacement": y, "restoring_force": force}, units) for force in forces
    )
    return Test("loop", records, name, level=1e-3)


@pytest.fixture(scope="module")
def data():
    tests = (pull("often", 3, 0.05), pull("once", 1, 0.05))
    return assemble(measured(tests, Identify(), gain=1.0))


THETA = {"omega_n": OMEGA_N, "zeta": 0.01, "alpha": 1000.0, "delta": 1e-3, "gamma": 1e-3}


def test_a_fit_explains_groups_that_were_repeated_and_no_others(data):
    sizes = dict(data.layout)
    rows = {label: np.full(size, 2.0 if label == "often" else 7.0) for label, size in sizes.items()}
    residual = np.concatenate([rows[label] for label in sizes])
    first = SimpleNamespace(residual=residual, x=np.zeros(5))
    chi_square, degrees = explained(first, data)
    assert chi_square == pytest.approx(4.0 * sizes["often"])
    # Every sample of the displacement is a value of one group, less five fitted parameters.
    assert degrees == 512 - 5


def test_products_and_noise_follow_from_the_draws(data):
    rng = np.random.default_rng(0)
    shape = (2, NUM)
    draws = {name: np.full(shape, value) for name, value in THETA.items()}
    for name in ("alpha", "delta", "gamma"):
        draws[name] = draws[name] * np.exp(0.1 * rng.standard_normal(shape))
    terms = jax.vmap(jax.vmap(lambda theta: log_likelihood({**theta, "gain": 1.0}, data)))(draws)
    posterior = xr.Dataset({name: (("chain", "draw"), values) for name, values in draws.items()})
    groups = {"/posterior": posterior, "/log_likelihood": xr.Dataset({"terms": (TERMS, terms)})}
    tree = xr.DataTree.from_dict(groups)
    found = with_derived(jax.random.key(0), tree, data)["posterior"].to_dataset()
    for name, factor in (("alpha_delta", "delta"), ("alpha_gamma", "gamma")):
        np.testing.assert_allclose(found[name], draws["alpha"] * draws[factor], rtol=1e-12)
        assert found[name].attrs["units"] == "1/(m s^2)"
    noise = found["noise_std_loop"]
    assert list(found["loop"].values) == ["often", "once"]
    assert noise.attrs["units"] == "N"
    # The posterior of a standard deviation known by 3 * 512 values is as narrow as 1 / sqrt(3072)
    # about that of the records; slip of a millionth of the force adds nothing.
    often = noise.sel(loop="often")
    assert float(often.mean()) == pytest.approx(0.05, rel=0.06)
    assert float(often.std()) < 0.06 * 0.05
