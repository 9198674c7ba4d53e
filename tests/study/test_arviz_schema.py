"""A run in ArviZ's hands as it is: what a user of ArviZ calls on `posterior.nc`, with no help."""

import arviz as az
import jax
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import jbw
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box
from jbw.study.collect import created

mpl.use("Agg")
RECORDS = ["strong, 1", "strong, 2", "pull, 1", "pull, 2"]


@pytest.fixture(scope="module")
def run(toy):
    """The toy run as it lies on disk, opened by ArviZ alone."""
    with xr.open_datatree(toy / "run" / "posterior.nc", engine="h5netcdf") as stored:
        yield stored.load()


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def test_groups_have_arviz_names_and_say_where_they_come_from(run):
    groups = (
        "posterior", "sample_stats", "log_likelihood", "log_prior", "prior", "observed_data",
        "posterior_predictive", "prior_predictive",
    )  # fmt: skip
    for name in groups:
        attrs = run[name].attrs
        assert attrs["inference_library"] == "jbw", name
        assert attrs["inference_library_version"] == jbw.__version__
        assert attrs["creation_library"] == "ArviZ"
        assert "T" in attrs["created_at"]
    assert list(run["observed_data"]["record"].values) == RECORDS
    assert list(run["observed_data"]["test"].values) == ["strong"] * 2 + ["pull"] * 2
    assert list(run["posterior"]["noise_std"]["level"].values) == ["strong"]
    draws = dict(run["posterior"].sizes)
    for name in ("log_likelihood", "posterior_predictive"):
        response = run[name]["response"]
        assert response.dims == ("chain", "draw", "record")
        assert response.sizes["draw"] == draws["draw"]


# Two loops are half of what is known of their noise: ArviZ says so, and k-hat is what it is for.
few = pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto")


@few
def test_loo_leaves_one_record_out(run):
    found = az.loo(run, pointwise=True)
    assert list(found.elpd_i["record"].values) == RECORDS
    assert list(found.pareto_k["record"].values) == RECORDS
    # N values of white noise are further from the truth than from the mean of K repeats by
    # chi-square / 2 of N / K degrees of freedom; the parameters and sigma cost a few nats more.
    for name, size, repeats in (("strong", 512, 2), ("pull", 512, 2)):
        own = found.elpd_i.sel(record=[r for r in RECORDS if r.startswith(name)])
        assert np.all(abs(own + size / (2 * repeats)) < 4 * np.sqrt(size / 2) + 20)
    az.plot_khat(found)


@few
def test_models_are_compared_by_the_records(run):
    table = az.compare({"one": run, "other": run})
    assert table["elpd_diff"].to_list() == [0.0, 0.0]
    assert table["weight"].sum() == pytest.approx(1.0)


@few
def test_observed_and_predicted_sizes_agree(run):
    az.plot_ppc_dist(run)
    az.plot_ppc_dist(run, group="prior_predictive")
    az.plot_ppc_interval(run)
    az.plot_loo_pit(run)
    pit = az.loo_pit(run)["response"]
    # Made by the law and white noise: four uniform numbers, none beyond one in two thousand.
    assert np.all((pit > 5e-4) & (pit < 1 - 5e-4))


# 1/sigma is no density to draw from: of the noise there is a posterior alone.
@pytest.mark.filterwarnings("ignore:Your data appears to have a single value or no finite")
def test_prior_and_posterior_stand_beside_each_other(run):
    az.plot_prior_posterior(run)
    prior = run["prior"].to_dataset()
    for name in ("omega_n", "zeta", "alpha", "delta", "gamma", "alpha_delta"):
        assert name in prior
    omega_n, meant = prior["omega_n"], run["posterior"]["omega_n"].attrs
    # 500 uniform draws: the mean strays by the width / sqrt(12 * 500).
    width = meant["upper"] - meant["lower"]
    middle = (meant["upper"] + meant["lower"]) / 2
    assert abs(float(omega_n.mean()) - middle) < 4 * width / np.sqrt(12 * 500)
    assert float(omega_n.min()) >= meant["lower"]
    assert float(omega_n.max()) <= meant["upper"]


def test_power_scaling_sees_the_prior_and_the_likelihood(run):
    table = az.psense_summary(run)
    # Records of little noise: the answer is the likelihood's, and hardly the prior's.
    assert np.all(table["likelihood"].astype(float) > 0.05)
    assert np.all(table["prior"].astype(float) < 0.05)
    density = run["log_prior"].to_dataset()
    meant = run["posterior"]["zeta"].attrs
    exact = -np.log(meant["upper"] - meant["lower"])
    np.testing.assert_allclose(density["zeta"], exact, rtol=1e-12)
    noise = run["posterior"]["noise_std"]
    np.testing.assert_allclose(density["noise_std"], -np.log(noise), rtol=1e-12)


def test_every_unit_of_a_run_is_read_by_pint(run):
    pint = pytest.importorskip("pint")
    registry = pint.UnitRegistry()
    units = {
        f"{node.path}/{name}": each
        for node in run.subtree
        for name, values in node.dataset.variables.items()
        for each in np.atleast_1d(values.attrs.get("units", values.attrs.get("group_units", "1")))
    }
    assert {"rad/s", "1/m", "1/s^2", "m/s", "N", "1/(m s^2)"} <= set(units.values())
    for path, unit in units.items():
        assert registry.parse_units(unit) is not None, path
        # No prefix or name that happens to be one: base dimensions of a vibration alone.
        known = {"[length]", "[mass]", "[time]", "[current]"}
        assert set(registry.parse_units(unit).dimensionality) <= known, path


def test_a_run_is_quantified_by_pint_xarray(run):
    pytest.importorskip("pint_xarray")
    quantified = run["posterior"].to_dataset().pint.quantify()
    found = (quantified["omega_n"] ** 2 / quantified["alpha_gamma"]).mean()
    assert str(found.pint.to("rad^2 m").pint.units) == "meter * radian ** 2"


def test_energies_of_nuts_are_those_arviz_looks_for():
    sd = jnp.asarray([0.1, 0.2])

    def normal(theta, data):
        return -0.5 * (jnp.stack([theta["a"], theta["b"]]) / sd) ** 2

    prior = box({"a": (-2.0, 2.0), "b": (-2.0, 2.0)})
    tree = sample(
        jax.random.key(0), normal, prior, sampler="nuts", num_warmup=200, num_samples=200,
        num_chains=2, start={"a": 0.0, "b": 0.0}, covariance=np.diag(np.asarray(sd) ** 2),
    )  # fmt: skip
    stats = created(tree["sample_stats"].to_dataset())
    tree["sample_stats"] = xr.DataTree(stats)
    assert stats["diverging"].dtype == bool
    az.plot_energy(tree)
    az.plot_trace_dist(tree)
    # A Gaussian by a well-chosen mass: energies move freely.
    assert float(np.min(az.bfmi(tree)["energy"])) > 0.5
