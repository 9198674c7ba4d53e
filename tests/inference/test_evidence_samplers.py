"""Every sampler on one contract, and against closed forms and quadrature by scipy.

Seeds were fixed before the first run. Numbers agree within four standard errors: a chance of 6e-5
a number for a normal error.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.stats import multivariate_normal, norm, truncnorm
from tiers import represented_by

from jbw.errors import ConfigError, ModelError
from jbw.inference.posterior.summary import diagnose
from jbw.inference.posterior.verdict import verdict
from jbw.inference.samplers.register import SAMPLERS
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box

SEEDS = (0, 1, 2)
EVIDENCE = ("importance", "amis", "tempered_smc", "nested", "quadrature")
# Nested sampling takes seconds to compile for every new density: where a density is asked for once
# more in another way, it waits for a release.
slow_nested = pytest.param("nested", marks=pytest.mark.slow)
late_nested = pytest.param("nested", marks=pytest.mark.release)
WITHOUT_START = ["tempered_smc", slow_nested, "quadrature"]
PLANE = box({"b": (-3.0, 1.0), "a": (-2.0, 2.0)})  # names not in the order of the alphabet
ABOUT = {"start": {"a": 0.4, "b": -0.4}, "covariance": np.diag([0.3, 0.2])}


def banana(theta, data):
    a, b = theta["a"], theta["b"]
    return -0.5 * data * jnp.stack([a - 0.4, 2.0 * (b + a**2)]) ** 2


def _banana_moment(f):
    def density(b, a):
        return f(a, b) * np.exp(-3.0 * ((a - 0.4) ** 2 + 4 * (b + a**2) ** 2))

    return dblquad(density, -2, 2, -3, 1, epsabs=1e-11, epsrel=1e-10)[0]


@pytest.fixture(scope="module", name="truth")
def _truth():
    """log evidence, and mean and sd of each parameter, by scipy."""
    whole = _banana_moment(lambda a, b: 1.0)
    moments = {}
    for name, pick in (("a", lambda a, b: a), ("b", lambda a, b: b)):
        mean = _banana_moment(pick) / whole
        square = _banana_moment(lambda a, b, pick=pick: pick(a, b) ** 2) / whole
        moments[name] = mean, np.sqrt(square - mean**2)
    return np.log(whole / 16), moments


def draw(sampler, seed, log_likelihood=banana, bounds=PLANE, data=6.0, **options):
    options = {"num_samples": 1000, "num_warmup": 300, **options}
    key = jax.random.key(seed)
    return sample(key, log_likelihood, bounds, jnp.asarray(data), sampler=sampler, **options)


LONG = ("nested", "tempered_smc")  # to compile


def within(values, mean, sd):
    """Whether mean and sd of draws are within four Monte Carlo standard errors of the truth."""
    row = diagnose(values)
    ess = min(row["ess_bulk"], row["ess_tail"])
    assert abs(values.mean() - mean) < 4 * sd / np.sqrt(ess)
    # The relative error of a standard deviation is sqrt((kurtosis - 1) / 4 ess), here <= 1.2.
    assert abs(values.std() / sd - 1) < 4 * np.sqrt(1.5 / ess)


@pytest.mark.parametrize(
    "sampler",
    [
        late_nested if one == "nested"  # test_sampler_contract.py draws by it twice
        else pytest.param(one, marks=pytest.mark.slow) if one in LONG
        else one
        for one in SAMPLERS
    ],
)  # fmt: skip
def test_every_sampler_leaves_the_same_tree(sampler, tmp_path):
    known = {} if sampler in ("nested", "tempered_smc") else ABOUT
    first, again, other = (draw(sampler, seed, **known) for seed in (3, 3, 4))
    posterior = first["posterior"].to_dataset()
    assert list(posterior) == ["b", "a"]
    assert dict(posterior.sizes) == {"chain": 4, "draw": 1000}
    for i, name in enumerate(PLANE.names):
        values = posterior[name]
        assert values.dtype == np.float64
        assert np.all(np.isfinite(values))
        lower, upper = float(PLANE.lower[i]), float(PLANE.upper[i])
        assert values.attrs == {"lower": lower, "upper": upper}
        assert lower <= float(values.min()) < float(values.max()) <= upper
        np.testing.assert_array_equal(values, again["posterior"][name])
        assert not np.array_equal(values, other["posterior"][name])
    assert {"posterior", "sample_stats", "log_likelihood", "log_prior", "timing"} <= set(
        first.children
    )
    lp = first["log_likelihood"]["terms"].sum("term") + first["log_prior"]["log_prior"]
    np.testing.assert_allclose(first["sample_stats"]["lp"], lp, rtol=1e-12)
    a, b = posterior["a"], posterior["b"]
    exact = -3.0 * ((a - 0.4) ** 2 + 4 * (b + a**2) ** 2) - np.log(16)
    np.testing.assert_allclose(lp, exact, rtol=1e-10)
    assert first.attrs["sampler"] == sampler
    # Rounds stop where they are enough; every other sampler looks at least once a draw.
    assert first.attrs["num_evaluations"] >= (1024 if sampler == "amis" else 4000)
    assert ("log_evidence" in first.attrs) == (sampler in EVIDENCE)
    first.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", EVIDENCE)
def test_banana_and_its_evidence(sampler, seed, truth):
    log_evidence, moments = truth
    tree = draw(sampler, seed, **(ABOUT if SAMPLERS[sampler].needs_fit else {}))
    for name, (mean, sd) in moments.items():
        within(tree["posterior"][name].values, mean, sd)
    error = tree.attrs["log_evidence_error"]
    # Quadrature knows the evidence better than scipy's tolerance of 1e-10.
    assert abs(tree.attrs["log_evidence"] - log_evidence) < 4 * error + 1e-8
    assert error < 0.1


@pytest.mark.parametrize("sampler", [late_nested, "tempered_smc"])
def test_about_a_laplace_approximation_the_same_comes_out(sampler, truth):
    log_evidence, moments = truth
    tree = draw(sampler, 0, **ABOUT)
    for name, (mean, sd) in moments.items():
        within(tree["posterior"][name].values, mean, sd)
    assert abs(tree.attrs["log_evidence"] - log_evidence) < 4 * tree.attrs["log_evidence_error"]


def test_a_factor_of_two_dropped_from_the_likelihood_is_seen(truth):
    _, moments = truth
    halved = draw("quadrature", 0, data=3.0)["posterior"]["b"].values
    with pytest.raises(AssertionError):
        within(halved, *moments["b"])


def linear(theta, data):
    """Values of unit noise about the line p + q s, and a normal prior of both, normalised."""
    s = jnp.linspace(-1.0, 1.0, 8)
    r = data - (theta["p"] + theta["q"] * s)
    prior = -0.5 * (theta["p"] ** 2 + (theta["q"] / 2) ** 2) - jnp.log(2 * jnp.pi * 2)
    return jnp.append(-0.5 * r**2 - 0.5 * jnp.log(2 * jnp.pi), prior)


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", ["importance", "tempered_smc", late_nested, "quadrature"])
def test_evidence_of_a_conjugate_linear_model(sampler, seed):
    """The marginal of the data is normal in closed form; the box is 40 sd wide, its bounds far."""
    half = 40.0
    bounds = box({"p": (-half, half), "q": (-half, half)})
    design = np.stack([np.ones(8), np.linspace(-1, 1, 8)], axis=1)
    values = design @ [0.7, -1.2] + np.random.default_rng(0).normal(size=8)
    prior = np.diag([1.0, 4.0])
    marginal = multivariate_normal(np.zeros(8), np.eye(8) + design @ prior @ design.T)
    # The box adds its own uniform density to the prior.
    exact = marginal.logpdf(values) - 2 * np.log(2 * half)
    covariance = np.linalg.inv(design.T @ design + np.linalg.inv(prior))
    mean = dict(zip(("p", "q"), covariance @ design.T @ values, strict=True))
    known = {"start": mean, "covariance": covariance} if sampler == "importance" else {}
    tree = draw(sampler, seed, linear, bounds, values, **known)
    assert abs(tree.attrs["log_evidence"] - exact) < 4 * tree.attrs["log_evidence_error"] + 1e-9
    for name, sd in zip(("p", "q"), np.sqrt(np.diag(covariance)), strict=True):
        within(tree["posterior"][name].values, mean[name], sd)


def two_hills(theta, data):
    """Normal densities of weights 0.3 and 0.7, widths 0.25 and 0.5, eight apart."""
    x, y = theta["x"], theta["y"]
    one = jnp.log(0.3) - 0.5 * ((x + 4) ** 2 + y**2) / 0.25**2 - 2 * jnp.log(0.25)
    two = jnp.log(0.7) - 0.5 * ((x - 4) ** 2 + y**2) / 0.5**2 - 2 * jnp.log(0.5)
    return jnp.logaddexp(one, two) - jnp.log(2 * jnp.pi)


@pytest.mark.fault(29)
@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", WITHOUT_START)
def test_two_modes_keep_their_weights(sampler, seed):
    bounds = box({"x": (-10.0, 10.0), "y": (-10.0, 10.0)})
    tree = draw(sampler, seed, two_hills, bounds, 0.0)
    assert abs(tree.attrs["log_evidence"] + np.log(400)) < (
        4 * tree.attrs["log_evidence_error"] + 1e-8
    )
    left = np.mean(tree["posterior"]["x"].values < 0, axis=1)
    # Runs cannot cross between the hills: the share of each run is one independent number. Two
    # thirds of its scatter is what 1000 particles that are worth some 200 would have.
    assert abs(np.mean(left) - 0.3) < 4 * np.sqrt(0.3 * 0.7 / 200 / 4)


def lopsided(theta, data):
    """An exponential decay from a bound, times a logarithm that is steep at the other."""
    x = theta["x"]
    return -data * x + 3 * jnp.log1p(-x)


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize("sampler", ["tempered_smc", late_nested, "quadrature"])
def test_an_asymmetric_density_on_a_bound(sampler, seed):
    """Wrong signs of a temperature or of a direction pass where a density is symmetric."""
    moments = [
        quad(lambda x, k=k: x**k * np.exp(-8 * x) * (1 - x) ** 3, 0, 1, epsabs=1e-14)[0]
        for k in range(3)
    ]
    mean = moments[1] / moments[0]
    sd = np.sqrt(moments[2] / moments[0] - mean**2)
    tree = draw(sampler, seed, lopsided, box({"x": (0.0, 1.0)}), 8.0)
    # The kurtosis of an exponential is nine: sqrt((9 - 1) / 4 ess).
    values = tree["posterior"]["x"].values
    ess = min(diagnose(values)["ess_bulk"], diagnose(values)["ess_tail"])
    assert abs(values.mean() - mean) < 4 * sd / np.sqrt(ess)
    assert abs(values.std() / sd - 1) < 4 * np.sqrt(2 / ess)
    found, error = (tree.attrs[n] for n in ("log_evidence", "log_evidence_error"))
    assert abs(found - np.log(moments[0])) < 4 * error + 1e-9


def cut_off(theta, data):
    return -0.5 * (theta["x"] - 1.3) ** 2


@pytest.mark.parametrize("sampler", ["importance", "tempered_smc", late_nested, "quadrature"])
def test_a_normal_that_the_box_cuts_off(sampler):
    """Half of the mass lies beyond the upper bound at 1."""
    law = truncnorm(-3.3, -0.3, loc=1.3)
    known = {"start": {"x": 0.9}, "covariance": np.eye(1)} if sampler == "importance" else {}
    tree = draw(sampler, 0, cut_off, box({"x": (-2.0, 1.0)}), 0.0, **known)
    within(tree["posterior"]["x"].values, law.mean(), law.std())
    if sampler == "quadrature":
        exact = tree["exact"].to_dataset()
        np.testing.assert_allclose(exact["mean"], law.mean(), rtol=1e-8)
        np.testing.assert_allclose(exact["sd"], law.std(), rtol=1e-7)
        quantiles = law.ppf(exact["probability"])
        np.testing.assert_allclose(exact["quantiles"][0], quantiles, atol=1e-6)


def impossible(theta, data):
    return jnp.where(theta["x"] < 0.5, -theta["x"], jnp.nan)


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["tempered_smc", "nested"])
def test_failed_solves_are_never_drawn_and_take_their_share_of_the_evidence(sampler):
    tree = draw(sampler, 0, impossible, box({"x": (0.0, 1.0)}), 0.0)
    assert float(tree["posterior"]["x"].max()) < 0.5
    exact = np.log(1 - np.exp(-0.5))
    assert abs(tree.attrs["log_evidence"] - exact) < 4 * tree.attrs["log_evidence_error"]


@pytest.mark.parametrize("sampler", [late_nested if s == "nested" else s for s in EVIDENCE])
def test_nan_in_the_data_is_said(sampler):
    known = ABOUT if SAMPLERS[sampler].needs_fit else {}
    with pytest.raises(ModelError, match="not finite at any evaluated point"):
        draw(sampler, 0, data=np.nan, **known)


def narrow(theta, data):
    r = jnp.stack([theta[name] for name in "xyz"]) - data[0]
    return -0.5 * r @ data[1:] @ r


@pytest.mark.slow
def test_quadrature_finds_a_correlated_posterior_of_a_hundred_thousandth_of_the_box():
    mixing = np.random.default_rng(0).normal(size=(3, 3))
    covariance = 1e-10 * mixing @ mixing.T
    mean = np.array([0.3, 0.61, 0.9])
    data = np.vstack([mean, np.linalg.inv(covariance)])
    tree = draw("quadrature", 0, narrow, box({name: (0.0, 1.0) for name in "xyz"}), data)
    exact, sd = tree["exact"].to_dataset(), np.sqrt(np.diag(covariance))
    log_evidence = 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    # The stated error is 1e-7; rounding of the precision's inverse is a thousandth of it.
    np.testing.assert_allclose(tree.attrs["log_evidence"], log_evidence, atol=1e-7)
    np.testing.assert_allclose((exact["mean"] - mean) / sd, 0, atol=1e-7)
    np.testing.assert_allclose(exact["sd"] / sd, 1, atol=1e-7)
    for i, name in enumerate("xyz"):
        within(tree["posterior"][name].values, mean[i], sd[i])


@pytest.mark.slow
def test_quadrature_of_four_parameters_of_which_one_is_hardly_known():
    """The last refinement that fits changes the evidence by 5e-5; it is exact to 1e-7."""
    bounds = box({name: (0.0, 1.0) for name in "wxyz"})

    def density(theta, data):
        r = jnp.stack([theta[name] for name in "wxyz"]) - 0.4
        return -0.5 * (r / jnp.array([0.01, 0.02, 0.03, 0.5])) ** 2

    tree = draw("quadrature", 0, density, bounds)
    inside = norm.cdf(1.2) - norm.cdf(-0.8)
    exact = np.log(inside * (2 * np.pi) ** 2 * 0.01 * 0.02 * 0.03 * 0.5)
    assert abs(tree.attrs["log_evidence"] - exact) < 1e-7
    assert tree.attrs["quadrature_error"] < 1e-4


def verdict_on(tree, bounds=PLANE):
    return {one.code: one for one in verdict(tree, bounds).findings}


def test_weights_that_cannot_be_trusted_fail_the_verdict():
    """A Laplace approximation far too narrow in one direction leaves heavy weights."""
    narrow = {"start": ABOUT["start"], "covariance": np.diag([0.3, 2e-3])}
    found = verdict_on(draw("importance", 0, **narrow))
    assert found["khat"].status == "failed"
    assert found["khat"].number > 0.7
    assert "nuts" in found["khat"].action
    assert found["ess_weights"].status == "failed"
    found = verdict_on(draw("importance", 0, **ABOUT))
    assert found["khat"].status == found["ess_weights"].status == "ok"


def test_quadrature_of_five_parameters_is_refused():
    bounds = box({name: (0.0, 1.0) for name in "abcde"})
    with pytest.raises(ConfigError, match="at most 4 parameters"):
        draw("quadrature", 0, lambda theta, data: -theta["a"], bounds)


def test_importance_needs_something_to_draw_about():
    with pytest.raises(ConfigError, match="`covariance` must be given"):
        draw("importance", 0)
