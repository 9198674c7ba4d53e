"""All records at once: its density by SciPy, and its population by quadrature."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from normal_populations import moments, scattered
from numpyro.infer.util import log_density
from scipy.stats import halfnorm, norm

import jbw
from jbw.errors import ConfigError, DataError
from jbw.inference.space.box import box
from jbw.population import one_stage as module
from jbw.population.coordinates import Pooled
from jbw.population.one_stage import joint_model, measured_units, one_stage
from jbw.population.population import Population
from jbw.population.prior import CovariateDesign, Prior
from jbw.results.run import RunSummary

S = np.array([0.05, 0.1, 0.1, 0.2, 0.15])  # each unit's own error of ln zeta
Y = np.log(0.01) + np.array([-0.3, 0.1, 0.25, 0.0, -0.1])
LOWER, UPPER, SCALE, ANYWHERE = 1e-3, 0.2, 0.3, 5.0


def normal(theta, data):
    return jnp.atleast_1d(-0.5 * ((jnp.log(theta["zeta"]) - data.y) / data.s) ** 2)


@pytest.fixture
def units(monkeypatch):
    """Five units of one parameter whose likelihood is normal in its logarithm, and two stages."""
    monkeypatch.setattr(module, "log_likelihood", normal)
    rng, studies = np.random.default_rng(0), []
    for y, s in zip(Y, S, strict=True):
        draws = xr.Dataset({"zeta": (("chain", "draw"), np.exp(rng.normal(y, s, (1, 400))))})
        main = SimpleNamespace(
            box=box({"zeta": (LOWER, UPPER)}),
            posterior=xr.DataTree.from_dict({"/posterior": draws}),
        )
        data = SimpleNamespace(y=y, s=s, laws=())
        studies.append(SimpleNamespace(
            identification=SimpleNamespace(data=data, main=main),
            result=RunSummary(campaign="unit"),
        ))  # fmt: skip
    pooled = Pooled(
        ("zeta",), Y[:, None], S[:, None, None] ** 2, np.array([[0.0, 1.0]]), ("omega_n", "zeta"),
        np.zeros((0, 2)),
    )  # fmt: skip
    prior = Prior(np.array([[Y.mean()]]), np.array([[ANYWHERE]]), np.array([SCALE]))
    design = CovariateDesign(("mean",), np.ones((5, 1)), np.nan)
    return studies, Population(pooled, design, prior, {}, {"units": list("abcde")})


def test_its_density_is_that_of_the_records_times_the_population_s(units):
    studies, population = units
    wholes = measured_units(studies, population)
    rng = np.random.default_rng(1)

    def point():
        z = {f"z_{k}": rng.standard_normal(1) for k in range(5)}
        return {**z, "offset": np.array([[rng.normal()]]), "tau": np.array([rng.uniform(0.1, 0.4)])}

    def ours(at):
        return float(log_density(joint_model, (wholes, population), {}, at)[0])

    def theirs(at):
        """In z, whose logit of the place of ln zeta in its box is flat in ln zeta."""
        line, tau = Y.mean() + SCALE * at["offset"][0, 0], at["tau"][0]
        total = norm(0.0, ANYWHERE / SCALE).logpdf(at["offset"][0, 0])
        total += halfnorm(scale=SCALE).logpdf(tau)
        for k, study in enumerate(wholes):
            x = study.mean[0] + study.root[0, 0] * at[f"z_{k}"][0]
            place = 1.0 / (1.0 + np.exp(-x))
            log = np.log(LOWER) + np.log(UPPER / LOWER) * place
            total += np.log(place * (1.0 - place)) + norm(Y[k], S[k]).logpdf(log)
            total += norm(line, tau).logpdf(log)
        return total

    points = [point() for _ in range(4)]
    densities, expected = ([density(at) for at in points] for density in (ours, theirs))
    np.testing.assert_allclose(np.diff(densities), np.diff(expected), rtol=1e-10, atol=1e-10)


@pytest.mark.slow  # compiles NUTS
def test_its_population_is_that_of_the_quadrature(units):
    studies, population = units
    drawn = one_stage(studies, population)
    exact = scattered(
        Y, S, np.ones((5, 1)), population.prior.mean[0], np.array([[ANYWHERE**2]]), SCALE
    )
    mean, sd = moments(exact)
    # 1,000 draws, some 200 of which count: four of their standard errors.
    assert abs(drawn["tau"].mean() - mean) < 4 * sd / np.sqrt(200)
    centre = np.sum(exact.weight * exact.mean[:, 0])
    spread = np.sqrt(np.sum(exact.weight * exact.cov[:, 0, 0]))
    assert abs(drawn["line"].mean() - centre) < 4 * spread / np.sqrt(200)
    assert drawn["diverging"].mean() < 0.01


def test_units_that_it_cannot_take_are_named(units):
    studies, population = units
    with pytest.raises(ConfigError, match=r"must contain the 5 units.*but contains 4"):
        jbw.one_stage(studies[:4], population)
    saved = SimpleNamespace(identification=None, result=RunSummary(campaign="beam"))
    with pytest.raises(DataError, match="The result of beam contains no likelihood of its records"):
        jbw.one_stage([saved, *studies[1:]], population)
    more = population._replace(pooled=population.pooled._replace(powers=np.array([[1.0, 1.0]])))
    with pytest.raises(DataError, match="do not determine all of zeta"):
        jbw.one_stage(studies, more)
