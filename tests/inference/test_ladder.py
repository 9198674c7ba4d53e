"""The ladder of samplers: which rung draws, in which coordinates, against quadrature by scipy.

Seeds were fixed before the first run.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from shelf import points_of
from tiers import represented_by

from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.posterior.summary import summarise
from jbw.inference.posterior.verdict import enough as is_enough
from jbw.inference.samplers.chunked_run import Until, no_checkpoint
from jbw.inference.samplers.ladder import LOOKED_AT, Sizes, climb
from jbw.inference.space.box import box
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import along_logarithms, in_box
from jbw.inference.space.ridge import along_ridge

SEEDS = (0, 1, 2)
RIDGE = box({"a": (1.0, 20.0), "b": (1.0, 30.0), "c": (-1.0, 1.0)})
STD = 1e-3  # of log(a b)
STD_C = 0.02


def left_of(theta, data):
    product = (jnp.log(theta["a"]) + jnp.log(theta["b"]) - data) / STD
    return jnp.stack([product, theta["c"] / STD_C])


def thin(theta, data):
    return -0.5 * left_of(theta, data) ** 2


def climbed(seed, log_likelihood, bounds, data, places, **options):
    target = Target(log_likelihood, bounds, data, options.pop("is_costly", False))
    sizes = {name: options.pop(name) for name in Sizes._fields if name in options}
    until = {"until": Until(is_enough, 60.0), **options}
    return climb(jax.random.key(seed), target, places, Sizes(4, **sizes), **until)


@pytest.fixture(scope="module", name="thin_places")
def _thin_places():
    """Coordinates about the fit, in an order that names the worst first."""
    fit = costly_fit(left_of, RIDGE, jnp.log(60.0), starts={"a": 6.0, "b": 8.0, "c": 0.1})
    return {
        "box": lambda: in_box(RIDGE, fit.theta, fit.covariance, 4),
        "logarithms": lambda: along_logarithms(fit.theta, fit.covariance, RIDGE, ("a", "b")),
        "ridge": lambda: along_ridge(fit.theta, fit.covariance, RIDGE),
    }


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_a_product_known_to_a_thousandth_is_drawn_in_coordinates_that_suit_it(seed, thin_places):
    tree = climbed(seed, thin, RIDGE, jnp.log(60.0), thin_places)
    assert tree.attrs["coordinates"] in ("ridge", "logarithms")
    assert "budget_spent_s" not in tree.attrs
    rows = summarise(tree, RIDGE)
    assert max(row["r_hat"] for row in rows.values()) < 1.01
    # Across the ridge, given a, the density of b is that of a log-normal: its integral is 1 / a.
    # The ends of b's box blur it by a thousandth, of no account here.
    weight = quad(lambda a: 1 / a, 2.0, 20.0)[0]
    mean = quad(lambda a: 1.0, 2.0, 20.0)[0] / weight
    sd = np.sqrt(quad(lambda a: a, 2.0, 20.0)[0] / weight - mean**2)
    row = rows["a"]
    assert abs(row["mean"] - mean) < 4 * sd / np.sqrt(row["ess_bulk"])
    # The kurtosis of 1 / a on this range is below 3.
    assert abs(row["sd"] / sd - 1) < 4 / np.sqrt(2 * row["ess_bulk"])
    product = np.log(tree["posterior"]["a"] * tree["posterior"]["b"]).values
    assert abs(product.mean() - np.log(60.0)) < 4 * STD / np.sqrt(400)
    assert abs(product.std() / STD - 1) < 4 / np.sqrt(2 * 400)


def test_a_told_number_of_draws_is_drawn_and_all_evaluations_are_counted(thin_places):
    tree = climbed(0, thin, RIDGE, jnp.log(60.0), thin_places, num_samples=250, until=None)
    assert dict(tree["posterior"].sizes) == {"chain": 4, "draw": 250}
    assert tree.attrs["sampler"] == "amis"
    # Those that only looked included, in each coordinate up to the first that suits.
    looks = 1 + list(thin_places).index(tree.attrs["coordinates"])
    assert tree.attrs["num_evaluations"] == points_of(tree.attrs["rounds"]) + looks * LOOKED_AT


PLANE = box({"x": (-4.0, 4.0), "y": (-4.0, 4.0)})
ABOUT = {"box": lambda: in_box(PLANE, {"x": 2.0, "y": 0.0}, np.diag([4e-4, 4.0]), 4)}
TURN, WIDTH = 0.4, 1e-3  # of the spiral's turns: their distance, and their width over that


def off(theta):
    """Distance to a spiral of ten turns, over that of two of them."""
    radius = jnp.sqrt(theta["x"] ** 2 + theta["y"] ** 2)
    turns = radius / TURN - jnp.arctan2(theta["y"], theta["x"]) / (2 * jnp.pi)
    return turns - jnp.round(turns)


def spiral(theta, data):
    return (-0.5 * (off(theta) / data) ** 2)[None]


def wound(rungs=None, **options):
    keep = no_checkpoint if rungs is None else rungs.append
    return climbed(0, spiral, PLANE, jnp.asarray(WIDTH), ABOUT, keep=keep, **options)


CHAINS = [(True, "elliptical_slice"), (False, "nuts")]


@pytest.mark.parametrize(("is_costly", "sampler"), represented_by(*CHAINS))
def test_a_posterior_that_no_mixture_suits_is_left_to_chains(is_costly, sampler):
    rungs = []
    tree = wound(rungs, is_costly=is_costly, num_samples=60, num_warmup=200, until=None)
    assert tree.attrs["sampler"] == sampler
    assert rungs[:2] == ["amis", sampler]
    assert tree.attrs["coordinates"] == "box"
    assert dict(tree["posterior"].sizes) == {"chain": 4, "draw": 60}
    # Many rounds before mixtures are given up, and a look at one choice of coordinates.
    assert tree.attrs["num_evaluations"] >= points_of(32) + LOOKED_AT
    # Draws lie on the spiral, whatever part of it they have seen: |z| > 5 once in 1.7 million.
    distance = off({name: tree["posterior"][name].values for name in "xy"})
    assert np.max(np.abs(distance)) < 5 * WIDTH


@pytest.mark.fault(37)
@pytest.mark.parametrize("is_costly", [True, False])
def test_a_budget_spent_by_chains_counts_what_was_spent_before_them(is_costly):
    rungs = []
    tree = wound(rungs, is_costly=is_costly, until=Until(lambda draws: False, 2.0))
    # Time enough for all rounds of weighing, but on a machine that others use.
    assert rungs[0] == "amis"
    assert tree.attrs["budget_spent_s"] >= 2.0


@pytest.mark.fault(37)
def test_a_budget_spent_by_the_first_rung_ends_the_ladder():
    rungs = []
    tree = wound(rungs, is_costly=True, until=Until(lambda draws: False, 0.0))
    assert rungs == ["amis"]
    assert tree.attrs["sampler"] == "amis"
    assert tree.attrs["rounds"] == 1
    assert tree.attrs["budget_spent_s"] == tree["timing"].attrs["wall_s"]
