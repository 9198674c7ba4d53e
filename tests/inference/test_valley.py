"""A valley that winds through the box: where the others follow one parameter, against quadrature.

Seeds were fixed before the first run.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from shelf import points_of
from test_ladder import climbed
from tiers import represented_by

from jbw.identification import evidence
from jbw.identification.evidence import Candidate
from jbw.identification.prepare import Fitted
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.fit.valley import about_valley
from jbw.inference.posterior.summary import summarise
from jbw.inference.samplers import amis
from jbw.inference.samplers.ladder import LOOKED_AT, choose
from jbw.inference.space.box import box
from jbw.inference.space.problem import Target, problem_of
from jbw.inference.space.reparametrisation import in_box
from jbw.observables import dataset

SEEDS = (0, 1, 2)
BOX = box({"a": (1.0, 60.0), "b": (-3.0, 3.0), "c": (-2.0, 2.0)})
MIDDLE, WIDE = np.log(8.0), 0.7  # of log a
STD_B, STD_C = 0.0005, 0.005


def left_of(theta, data):
    """b and c follow log a along curves, c within less where a is large."""
    q = jnp.log(theta["a"])
    return jnp.stack(
        [
            (q - data) / WIDE,
            (theta["b"] - jnp.sin(3.0 * q) * 0.05) / STD_B,
            (theta["c"] - 0.3 * (q - data) ** 2) * theta["a"] / (8.0 * STD_C),
        ]
    )


def winding(theta, data):
    return -0.5 * left_of(theta, data) ** 2


@pytest.fixture(scope="module", name="fit")
def _fit():
    return costly_fit(left_of, BOX, MIDDLE, starts={"a": 7.0, "b": -0.2, "c": 0.0})


def straight(fit):
    return in_box(BOX, fit.theta, fit.covariance, 4)


def curved(fit):
    return about_valley(left_of, BOX, MIDDLE, fit)


def expectation(of):
    """Integral over a of what b and c leave, a normal density's over them: 2 pi std_b std_c."""

    def density(a):
        inner = 2 * np.pi * STD_B * STD_C * 8.0 / a
        return of(a) * inner * np.exp(-0.5 * ((np.log(a) - MIDDLE) / WIDE) ** 2)

    return quad(density, 1.0, 60.0, points=[4.0, 8.0, 16.0], limit=200)[0]


LOG_Z = np.log(expectation(lambda a: 1.0) / (59.0 * 6.0 * 4.0))  # over the volume of the box


def test_points_about_the_floor_are_worth_more_than_about_the_fit(fit):
    places = {"box": straight(fit), "valley": curved(fit)}
    problems = [problem_of(winding, BOX, MIDDLE, place) for place in places.values()]
    for seed in SEEDS:
        # About the fit they know one bend of the valley, and no more.
        box_, valley = (amis.look(jax.random.key(seed), one, 512) for one in problems)
        assert valley > 150 > 100 > box_


def test_the_valley_is_looked_at_where_few_points_count(fit):
    # By weights alone a part of a valley may look like all of it.
    places = {"box": lambda: straight(fit), "valley": lambda: curved(fit)}
    name, _, looked_at = choose(jax.random.key(0), Target(winding, BOX, MIDDLE), places)
    assert (name, looked_at) == ("valley", 2 * LOOKED_AT)


CENTRE, STDS = {"a": 30.0, "b": 0.0, "c": 0.0}, np.array([1.0, 0.01, 0.01])


def normal(theta, data):
    off = [(theta[name] - CENTRE[name]) / std for name, std in zip(BOX.names, data, strict=True)]
    return -0.5 * jnp.stack(off) ** 2


def never():
    raise AssertionError("the valley was made")


@pytest.mark.parametrize(("wider", "looks"), [(1.0, 1), (1.4, 1), (2.0, 2)])
def test_others_are_looked_at_where_fewer_than_half_of_the_points_count(wider, looks):
    # Of points s times as wide a part of sqrt(2 s^2 - 1) / s^2 counts, a dimension: of three 1,
    # 0.67 and 0.29. Those drawn have heavier tails, at the cost of a tenth.
    about = in_box(BOX, CENTRE, np.diag((wider * STDS) ** 2), 4)
    narrow = in_box(BOX, CENTRE, np.diag(STDS**2), 4)
    places = {"box": lambda: about, "valley": never if looks == 1 else lambda: narrow}
    name, _, looked_at = choose(jax.random.key(0), Target(normal, BOX, STDS), places)
    assert (name, looked_at) == (list(places)[looks - 1], looks * LOOKED_AT)


def test_a_law_whose_weights_are_rough_is_weighed_along_the_valley_too(fit, monkeypatch):
    monkeypatch.setattr(dataset, "log_likelihood", winding)
    monkeypatch.setattr(dataset, "stacked", left_of)
    monkeypatch.setattr(evidence, "with_derived", lambda key, tree, data: tree)
    # As if points about the fit had looked better; and too few of them to learn otherwise.
    monkeypatch.setattr(evidence, "choose", lambda *of: ("straight", None, LOOKED_AT))
    monkeypatch.setattr(evidence, "MOST_ROUNDS", 4)
    tree, _ = evidence.posterior(jax.random.key(0), Candidate((), Fitted(fit, BOX, MIDDLE)))
    assert tree.attrs["coordinates"] == "valley"
    assert tree.attrs["num_evaluations"] == 2 * points_of(4) + LOOKED_AT
    assert abs(tree.attrs["log_evidence"] - LOG_Z) < 4 * tree.attrs["log_evidence_error"]


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_a_winding_posterior_is_drawn_along_its_valley(seed, fit):
    tree = climbed(
        seed, winding, BOX, MIDDLE, {"box": lambda: straight(fit)},
        costly_parametrisations={"valley": lambda: curved(fit)},
    )  # fmt: skip
    assert tree.attrs["sampler"] == "amis"
    assert tree.attrs["coordinates"] == "valley"
    assert abs(tree.attrs["log_evidence"] - LOG_Z) < 4 * tree.attrs["log_evidence_error"]
    mean = expectation(lambda a: a) / expectation(lambda a: 1.0)
    sd = np.sqrt(expectation(lambda a: a**2) / expectation(lambda a: 1.0) - mean**2)
    row = summarise(tree, BOX)["a"]
    assert abs(row["mean"] - mean) < 4 * sd / np.sqrt(row["ess_bulk"])


def test_a_parameter_that_turns_back_is_not_followed():
    # b goes up and down as a grows: along b, a is known by half a turn alone.
    narrow = box({"a": (1.0, 60.0), "b": (-0.06, 0.06), "c": (-2.0, 2.0)})
    best = costly_fit(left_of, narrow, MIDDLE, starts={"a": 7.0, "b": -0.01, "c": 0.0})
    place = about_valley(left_of, narrow, MIDDLE, best)
    assert place is None or place.outer.parts[0].held == 0


def test_a_fit_at_a_wall_has_a_valley_on_one_side(fit):
    bounds = box({"a": (1.0, 60.0), "b": (-3.0, 3.0), "c": (-2.0, 2.0)})
    beyond = np.log(90.0)
    at_wall = costly_fit(left_of, bounds, beyond, starts={"a": 50.0, "b": 0.0, "c": 0.1})
    assert at_wall.at_bound == {"a": "upper"}
    problem = problem_of(winding, bounds, beyond, about_valley(left_of, bounds, beyond, at_wall))
    assert amis.look(jax.random.key(0), problem, 512) > 20


def test_what_a_floor_does_where_the_data_rule_it_out_does_not_matter():
    def walled(theta, data):
        """Below log a = 1 chi-square rises to 100 at 0.9, from where the floor is 20 steep."""
        past, further = (jnp.maximum(end - jnp.log(theta["a"]), 0.0) for end in (1.0, 0.9))
        return left_of(theta, data) - jnp.stack([100.0 * past, 20.0 * further / STD_B, 0.0])

    best = costly_fit(walled, BOX, MIDDLE, starts={"a": 7.0, "b": -0.2, "c": 0.0})
    place = about_valley(walled, BOX, MIDDLE, best)
    assert place is not None
    assert place.outer.parts[0].held == 0
    problem = problem_of(lambda t, d: -0.5 * walled(t, d) ** 2, BOX, MIDDLE, place)
    assert amis.look(jax.random.key(0), problem, 512) > 100
