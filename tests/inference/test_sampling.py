"""Samplers against answers that do not come from a sampler: the prior, quadrature, Gaussians."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from compiling import kept_code
from scipy.stats import kstest
from tiers import represented_by

from jbw.errors import ConfigError, ModelError
from jbw.inference.posterior.summary import diagnose
from jbw.inference.samplers.chunked_run import Supervision
from jbw.inference.samplers.sampling import SamplingRequest, draw_posterior, sample
from jbw.inference.space.box import box
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import in_box

SEEDS = (0, 1, 2)
BOX = box({"b": (-3.0, 1.0), "a": (-2.0, 2.0)})  # names not in the order of the alphabet
TRACES = []
# A Gaussian about as wide as the ridge, which elliptical slices are drawn about.
ABOUT = {"start": {"a": 0.4, "b": -0.4}, "covariance": np.diag([0.3, 0.2])}


def banana(theta, data):
    """Independent terms of a curved ridge; flat when the weight is 0."""
    TRACES.append(1)
    a, b = theta["a"], theta["b"]
    bend = jnp.stack([a - 0.4, 2.0 * (b + a**2)])
    return -0.5 * data["weight"] * bend**2


def draw(seed, weight, sampler="nuts", **options):
    about = ABOUT if sampler == "elliptical_slice" else {}
    options = {"num_warmup": 600, "num_samples": 1500, **about, **options}
    data = {"weight": jnp.asarray(weight)}
    return sample(jax.random.key(seed), banana, BOX, data, sampler=sampler, **options)


def banana_by_quadrature(weight):
    a, b = np.meshgrid(np.linspace(-2, 2, 801), np.linspace(-3, 1, 801), indexing="ij")
    log_p = -0.5 * weight * ((a - 0.4) ** 2 + 4 * (b + a**2) ** 2)
    p = np.exp(log_p)
    return {n: _moments(v, p / p.sum()) for n, v in (("a", a), ("b", b))}


def _moments(value, p):
    mean = np.sum(value * p)
    return mean, np.sqrt(np.sum((value - mean) ** 2 * p))


@pytest.mark.release  # as test_sampler_contract.py asks of every sampler
@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", ["nuts", "random_walk", "elliptical_slice"])
def test_without_data_the_prior_comes_back(sampler, seed):
    tree = draw(seed, 0.0, sampler)
    for i, name in enumerate(BOX.names):
        values = tree["posterior"][name].values
        every = int(np.ceil(values.size / diagnose(values)["ess_bulk"]))
        lower, upper = float(BOX.lower[i]), float(BOX.upper[i])
        x = (values[:, :: 2 * every].ravel() - lower) / (upper - lower)
        assert kstest(x, "uniform").pvalue > 1e-4


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", ["nuts", "random_walk", "elliptical_slice"])
def test_banana_agrees_with_quadrature(sampler, seed):
    tree = draw(seed, 6.0, sampler)
    for name, (mean, sd) in banana_by_quadrature(6.0).items():
        values = tree["posterior"][name].values
        ess = diagnose(values)["ess_bulk"]
        assert abs(values.mean() - mean) < 4 * sd / np.sqrt(ess)
        # The relative error of a standard deviation is sqrt(kurtosis / 4 ess) <= sqrt(2 / ess).
        assert abs(values.std() / sd - 1) < 4 * np.sqrt(2 / ess)


def test_other_data_and_bounds_run_without_compiling_again():
    draw(0, 6.0)
    before = len(TRACES)
    wider = box({"b": (-4.0, 1.0), "a": (-2.0, 3.0)})
    sample(
        jax.random.key(5),
        banana,
        wider,
        {"weight": jnp.asarray(2.0)},
        num_warmup=600,
        num_samples=400,
    )
    assert len(TRACES) == before


@pytest.mark.release  # test_sampler_contract.py asks it of all
@pytest.mark.fault(55)
@pytest.mark.parametrize("sampler", ["nuts", "random_walk", "elliptical_slice"])
def test_equal_keys_give_equal_draws_and_other_keys_other_draws(sampler):
    first, again, other = (draw(seed, 6.0, sampler)["posterior"]["a"].values for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.fixture(scope="module", name="tight")
def _tight():
    """A correlated Gaussian in 7 dimensions, 1e-6 of the box wide, units of all sizes."""
    rng = np.random.default_rng(0)
    names = tuple(f"p{i}" for i in range(7))
    lower, width = np.arange(1.0, 8.0), 10.0 ** np.arange(-2, 5)
    mixing = rng.normal(size=(7, 7))
    correlation = mixing @ mixing.T + 0.05 * np.eye(7)
    std = np.sqrt(np.diag(correlation))
    correlation /= np.outer(std, std)
    mean = lower + width * rng.uniform(0.2, 0.8, 7)
    bounds = box({n: (lo, lo + w) for n, lo, w in zip(names, lower, width, strict=True)})
    return bounds, mean, 1e-6 * width, correlation


def tight_gaussian(theta, data):
    mean, std, precision = data
    r = (jnp.stack([theta[f"p{i}"] for i in range(7)]) - mean) / std
    return -0.5 * r @ precision @ r


@pytest.mark.parametrize(("sampler", "most"), [("nuts", 8), ("elliptical_slice", 4.5)])
def test_a_posterior_of_a_millionth_of_the_box_is_sampled_well(tight, sampler, most):
    bounds, mean, std, correlation = tight
    tree = sample(
        jax.random.key(0),
        tight_gaussian,
        bounds,
        (mean, std, np.linalg.inv(correlation)),
        sampler=sampler,
        num_warmup=100,
        num_samples=500,
        start=dict(zip(bounds.names, mean, strict=True)),
        covariance=correlation * np.outer(std, std),
    )
    assert float(tree["sample_stats"]["n_steps"].mean()) < most
    for i, name in enumerate(bounds.names):
        values = tree["posterior"][name].values
        row = diagnose(values)
        assert row["ess_bulk"] > 0.8 * values.size
        assert row["r_hat"] < 1.015  # 500 draws scatter it by a few thousandths about 1
        assert abs(values.mean() - mean[i]) < 4 * std[i] / np.sqrt(row["ess_bulk"])
        assert abs(values.std() / std[i] - 1) < 4 / np.sqrt(2 * row["ess_tail"])


def one_sided(theta, data):
    """Impossible to solve in the upper half of the box."""
    x = theta["x"]
    return jnp.where(x < 0.5, -x, jnp.nan)


@pytest.mark.fault(34)
@pytest.mark.parametrize("sampler", ["nuts", "random_walk"])
def test_failed_solves_are_counted_and_never_drawn(sampler):
    tree = sample(
        jax.random.key(0),
        one_sided,
        box({"x": (0.0, 1.0)}),
        sampler=sampler,
        num_warmup=200,
        num_samples=500,
    )
    assert float(tree["posterior"]["x"].max()) < 0.5
    counted = tree["sample_stats"]["diverging" if sampler == "nuts" else "failed"]
    assert 0.01 < float(counted.mean()) < 0.9


def with_gain(theta, data):
    known = -0.5 * jnp.square((theta["gain"] - 15.0) / 0.2)  # from an earlier step
    return jnp.stack([-0.5 * jnp.square((theta["gain"] - data) / 0.5), known])


def test_an_earlier_step_enters_as_a_term_and_the_container_keeps_everything(tmp_path):
    bounds = box({"gain": (10.0, 20.0)})
    key = jax.random.key(3)
    seen = []
    tree = sample(
        key,
        with_gain,
        bounds,
        jnp.asarray(16.0),
        num_warmup=300,
        num_samples=500,
        chain_method="vectorized",
        attrs={"gain": {"units": "N/kg/V", "long_name": "shaker gain"}},
        progress=seen.append,
    )
    precision = 1 / 0.5**2 + 1 / 0.2**2
    mean = (16.0 / 0.5**2 + 15.0 / 0.2**2) / precision
    values = tree["posterior"]["gain"]
    ess = diagnose(values.values)["ess_bulk"]
    assert abs(float(values.mean()) - mean) < 4 / np.sqrt(precision * ess)
    assert values.attrs == {
        "lower": 10.0,
        "upper": 20.0,
        "units": "N/kg/V",
        "long_name": "shaker gain",
    }
    known = -0.5 * ((values - 15.0) / 0.2) ** 2
    likelihood = -0.5 * ((values - 16.0) / 0.5) ** 2
    np.testing.assert_allclose(tree["log_prior"]["log_prior"], -np.log(10.0), rtol=1e-12)
    np.testing.assert_allclose(tree["log_likelihood"]["terms"][..., 0], likelihood, rtol=1e-12)
    np.testing.assert_allclose(tree["log_likelihood"]["terms"][..., 1], known, rtol=1e-12)
    lp = likelihood + known - np.log(10.0)
    np.testing.assert_allclose(tree["sample_stats"]["lp"], lp, rtol=1e-12)
    assert (seen[-1].done, seen[-1].total, seen[-1].left_s) == (800, 800, 0.0)
    assert [one.done for one in seen] == sorted(one.done for one in seen)
    np.testing.assert_array_equal(seen[-1].draws["gain"], values)
    assert seen[-1].divergences.shape == (4,)
    assert seen[0].draws == {}
    assert tree.attrs["seed"] == np.asarray(jax.random.key_data(key)).tolist()
    assert "wall_s" in tree["timing"].attrs
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as stored:
        np.testing.assert_array_equal(stored["posterior"]["gain"], values)


@pytest.mark.fault(39)
def test_starts_that_cannot_be_meant_are_refused():
    with pytest.raises(ConfigError, match="must name b, a"):
        draw(0, 6.0, start={"a": 0.0, "c": 0.0})
    with pytest.raises(ConfigError, match="Start of `b`"):
        draw(0, 6.0, start={"a": 0.0, "b": 2.0})
    with pytest.raises(ConfigError, match="`covariance` needs `start`"):
        draw(0, 6.0, covariance=np.eye(2))
    with pytest.raises(ConfigError, match="positive definite"):
        draw(0, 6.0, start={"a": 0.0, "b": 0.0}, covariance=np.ones((2, 2)))
    with pytest.raises(ConfigError, match="one of nuts"):
        draw(0, 6.0, sampler="gibbs")
    with pytest.raises(ConfigError, match="one of sequential"):
        draw(0, 6.0, chain_method="lockstep")
    with pytest.raises(ConfigError, match="`num_chains`"):
        draw(0, 6.0, num_chains=0)


def test_a_sampler_takes_its_options_as_keywords_or_in_a_mapping():
    short = {"num_warmup": 50, "num_samples": 40}
    keywords = draw(0, 6.0, **short, target_accept=0.9, max_tree_depth=3)
    options = {"target_accept": 0.9, "max_tree_depth": 3}
    mapping = draw(0, 6.0, **short, options=options)
    np.testing.assert_array_equal(keywords["posterior"]["a"], mapping["posterior"]["a"])
    assert (keywords.attrs["target_accept"], keywords.attrs["max_tree_depth"]) == (0.9, 3)
    # A keyword beside the mapping is the nearer word; what the mapping alone says stays.
    both = draw(0, 6.0, **short, options=options | {"target_accept": 0.5}, target_accept=0.9)
    np.testing.assert_array_equal(both["posterior"]["a"], mapping["posterior"]["a"])
    # Samplers share one mapping, whatever of it each of them has.
    shared = draw(0, 6.0, "random_walk", **short, options={"adapt_mass": True})
    plain = draw(0, 6.0, "random_walk", **short)
    np.testing.assert_array_equal(shared["posterior"]["a"], plain["posterior"]["a"])


@pytest.mark.fault(39)
@pytest.mark.parametrize(
    ("sampler", "keyword", "meant"),
    [
        ("nuts", "num_sample", "num_samples"),
        ("nuts", "covarance", "covariance"),
        ("nuts", "target_acept", "target_accept"),
        ("random_walk", "stepsize", "step_size"),
        ("importance", "atrs", "attrs"),
    ],
)
def test_a_keyword_that_nobody_has_is_refused_with_the_nearest_one(sampler, keyword, meant):
    with pytest.raises(ConfigError, match=f"`{keyword}` does not exist") as caught:
        draw(0, 6.0, sampler, **{keyword: 1})
    assert caught.value.remedy.startswith(f"Did you mean `{meant}`? ")
    assert sampler in caught.value.what
    offered = caught.value.remedy.partition("The arguments are ")[2].rstrip(".").split(", ")
    assert {"start", "num_warmup", "chain_method", "options", "progress", meant} <= set(offered)
    assert len(offered) == len(set(offered))


def test_an_option_of_another_sampler_is_refused_as_a_keyword():
    with pytest.raises(ConfigError, match="nor the sampler random_walk has it"):
        draw(0, 6.0, "random_walk", adapt_mass=True)


@pytest.mark.parametrize("sampler", ["nuts", "elliptical_slice", "amis"])
def test_the_engine_draws_what_the_call_draws(sampler):
    data, steps = {"weight": jnp.asarray(6.0)}, []
    units = {"a": {"units": "m"}}
    called = sample(
        jax.random.key(2), banana, BOX, data, sampler=sampler, num_warmup=30, num_samples=50,
        num_chains=2, **ABOUT, attrs=units, progress=steps.append,
    )  # fmt: skip
    so_far = []
    drawn = draw_posterior(
        jax.random.key(2), Target(banana, BOX, data),
        SamplingRequest(sampler, num_warmup=30, num_samples=50, num_chains=2),
        in_box(BOX, ABOUT["start"], ABOUT["covariance"], 2),
        supervision=Supervision(progress=so_far.append), attrs=units,
    )  # fmt: skip
    for group in ("posterior", "sample_stats", "log_likelihood", "log_prior"):
        xr.testing.assert_identical(drawn[group].to_dataset(), called[group].to_dataset())
    assert drawn.attrs == called.attrs
    assert drawn["posterior"]["a"].attrs["units"] == "m"
    assert len(so_far) == len(steps) > 0


def test_nan_in_the_data_is_one_clear_sentence():
    with pytest.raises(ModelError, match="not finite at the start of 4 of 4 chains"):
        draw(0, float("nan"))


@pytest.mark.fault(35)
def test_a_float32_session_is_refused():
    with jax.enable_x64(False), pytest.raises(ConfigError, match="float64") as caught:
        draw(0, 6.0)
    assert "enable_x64" in caught.value.remedy


def test_parallel_without_devices_warns_and_runs_in_turn():
    with pytest.warns(UserWarning, match="one after the other"):
        parallel = draw(0, 6.0, chain_method="parallel")
    np.testing.assert_array_equal(parallel["posterior"]["a"], draw(0, 6.0)["posterior"]["a"])


TWO_DEVICES = """
import sys; sys.path[:0] = sys.argv[1:]
import jax; jax.config.update("jax_enable_x64", True)
import numpy as np
from test_sampling import draw
runs = [draw(0, 6.0, "random_walk", num_samples=200, chain_method=m)
        for m in ("parallel", "sequential")]
values = [run["posterior"]["a"].values for run in runs]
assert jax.device_count() == 2
np.testing.assert_allclose(*values, rtol=1e-9)
"""


@pytest.mark.slow
def test_chains_on_two_devices_are_the_chains_on_one():
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", TWO_DEVICES, *map(str, Path(__file__).parents[:2])]
    done = subprocess.run(
        command, env=os.environ | kept_code() | flags, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def where_it_is_possible(theta, data):
    """A standard normal of a that has no value beyond one standard deviation."""
    return jnp.where(jnp.abs(theta["a"]) < 1, -0.5 * theta["a"] ** 2, jnp.nan)


def test_an_elliptical_slice_never_takes_a_point_without_a_likelihood():
    bounds = box({"a": (-10.0, 10.0)})
    about = {"start": {"a": 0.0}, "covariance": np.eye(1), "sampler": "elliptical_slice"}
    tree = sample(jax.random.key(0), where_it_is_possible, bounds, **about)
    values = tree["posterior"]["a"].values
    assert np.max(np.abs(values)) < 1
    # The standard deviation of a normal cut off at one of its own is 0.5396 (closed form).
    ess = diagnose(values)["ess_tail"]
    assert abs(values.std() / 0.5396 - 1) < 4 / np.sqrt(2 * ess)


def test_an_elliptical_slice_needs_something_to_draw_about():
    with pytest.raises(ConfigError, match="`covariance` must be given"):
        sample(jax.random.key(0), banana, BOX, sampler="elliptical_slice")
