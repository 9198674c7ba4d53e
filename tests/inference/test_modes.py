"""Two modes are seen, weighed where that can be done, and never averaged in silence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pasted import pasted
from scipy.stats import norm
from scipy.stats import t as student_t
from tiers import represented_by

from jbw.inference.posterior.finding import answers
from jbw.inference.posterior.verdict import deepest_split, modes_findings, verdict
from jbw.inference.samplers.sampling import sample
from jbw.inference.space.box import box

SEEDS = (0, 1, 2)
WEIGHT, WIDTH, PLACES = 0.3, 0.04, (0.3, 0.7)
BOX = box({"alpha": (0.0, 1.0)})


def mixture(seed, weight=WEIGHT, shape=(4, 1000)):
    """Independent draws of two normals, the first with the weight."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(size=shape) < weight
    return np.where(first, *(rng.normal(place, WIDTH, shape) for place in PLACES))


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: rng.normal(size=(4, 400)),
        lambda rng: rng.uniform(size=(4, 400)),
        lambda rng: rng.exponential(size=(4, 400)),
        lambda rng: rng.standard_t(3, size=(4, 400)),
        # A chain with an autocorrelation time of twenty draws: it has eighty effective ones.
        lambda rng: (
            np.repeat(rng.normal(size=(4, 20)), 20, axis=1) + 1e-3 * rng.normal(size=(4, 400))
        ),
    ],
    ids=["normal", "uniform", "exponential", "student", "sticky"],
)
def test_one_mode_is_not_split(draw, seed):
    assert deepest_split({"x": draw(np.random.default_rng(seed))}) is None


@pytest.mark.fault(29)
@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_two_modes_are_weighed_within_their_error(seed):
    split = deepest_split(
        {"plain": np.random.default_rng(9).normal(size=(4, 1000)), "x": mixture(seed)}
    )
    assert split.name == "x"
    # The error of a share of 4000 independent draws is sqrt(w (1 - w) / 4000).
    assert split.error == pytest.approx(np.sqrt(WEIGHT * (1 - WEIGHT) / 4000), rel=0.2)
    assert abs(split.weight - WEIGHT) < 4 * split.error
    np.testing.assert_allclose([split.below, split.above], PLACES, atol=WIDTH)


@pytest.mark.fault(29)
def test_chains_that_do_not_cross_have_no_weights():
    apart = np.sort(mixture(0).ravel()).reshape(4, 1000)
    (finding,) = modes_findings({"x": apart})
    assert (finding.code, finding.status) == ("crossing", "failed")
    assert pasted(finding.action).settings.sampler == "tempered_smc"


def test_a_tail_is_no_mode():
    assert deepest_split({"x": mixture(0, weight=0.005)}) is None


def test_points_that_repeat_by_weight_make_no_modes_of_a_heavy_tail():
    """A few far points of large weights stand alone: 8 of 40 when every draw counted as one."""
    alarms = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        points = 1.2 * rng.standard_normal(4000)
        weights = student_t.pdf(points, 3) / norm.pdf(points, scale=1.2)
        draws = rng.choice(points, (4, 1000), p=weights / weights.sum())
        alarms += deepest_split({"x": draws}) is not None
    assert alarms <= 2


def _two_normals(theta, data):
    squares = [-0.5 * ((theta["alpha"] - place) / WIDTH) ** 2 for place in PLACES]
    return jnp.logaddexp(squares[0] + jnp.log(WEIGHT), squares[1] + jnp.log(1 - WEIGHT))


@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_samplers_with_the_evidence_weigh_modes(seed):
    tree = sample(
        jax.random.key(seed), _two_normals, BOX, sampler="tempered_smc", num_samples=1000,
    )  # fmt: skip
    found = verdict(tree, BOX)
    finding = next(one for one in found.findings if one.code == "modes")
    assert found.status == "failed"
    # The computation did what it could; it is the data that leave two answers.
    told = dict(answers(found.findings))
    assert (told["sampling"].status, told["knowledge"].status) == ("ok", "failed")
    split = deepest_split({"alpha": tree["posterior"]["alpha"].values})
    assert abs(split.weight - WEIGHT) < 4 * split.error
    assert finding.values["weight"] + finding.values["rest"] == pytest.approx(1.0)


@pytest.mark.fault(29)
def test_chains_stuck_in_either_mode_are_never_averaged_in_silence():
    start = {"alpha": np.array([PLACES[0], PLACES[0], PLACES[1], PLACES[1]])}
    tree = sample(
        jax.random.key(0), _two_normals, BOX, start=start, num_warmup=200, num_samples=500
    )
    found = verdict(tree, BOX)
    assert found.status == "failed"
    assert next(one for one in found.findings if one.code == "crossing").status == "failed"
    assert dict(answers(found.findings))["sampling"].status == "failed"
