"""Answers do not depend on the units of time, length and mass, on signs, on order or on names.

What the rig records is taken as it is, faster or slower, larger, heavier, turned, in another order
and under other names: numbers change by the factor of their unit, and nothing else does.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from same_answers import differences
from scaled_campaigns import (
    AT_TRUTH,
    PLANS,
    Scale,
    campaign_in,
    measured,
    renamed,
    reordered,
    with_names_back,
    write_campaign,
)
from tiers import standing_for_all

from jbw.campaign.check import as_json, check_campaign
from jbw.identification.assemble import assemble, measured_in
from jbw.observables.dataset import log_likelihood, stacked
from jbw.study.look import look

KINDS = [plan.name for plan in PLANS]
# Of time, from 0.2 mHz to 19 MHz; of length, of mass; turned; and all of them at once.
SCALES = {
    "1000 times faster": Scale(time=1e-3),
    "50 times slower": Scale(time=50.0),
    "100000 times slower": Scale(time=1e5),
    "2^20 times faster": Scale(time=2.0**-20),
    "2^16 times slower": Scale(time=2.0**16),
    "1000 times smaller": Scale(length=1e-3),
    "1000 times heavier": Scale(mass=1e3),
    "turned": Scale(sign=-1.0),
    "all at once": Scale(time=3e-3, length=7e-3, mass=2e4, sign=-1.0),
}
IN_TIERS = {"2^20 times faster", "all at once"}
# Rounding of sums and transforms; none where all factors are powers of two.
ROUNDED, EXACT = 1e-9, 1e-12
# Readings are searched for until their squares fall by less than 1e-8, which round-off moves: by a
# part of 1e-5 where it is the same in both, by a tenth of their errors, 1e-3, where it is not.
SEARCHED, NEARLY = 1e-5, 1e-3


# An end of the range of time, and all factors at once; each by itself before a release.
@pytest.fixture(params=standing_for_all(SCALES, *IN_TIERS))
def scale(request):
    return SCALES[request.param]


def allowed(scale):
    return EXACT if scale.is_exact else ROUNDED


def seen(campaign):
    return look(campaign, report=lambda _: None).record.plain()


def checked(campaign, folder):
    return as_json(check_campaign(write_campaign(campaign, folder)))


def believable(scale):
    """The scale, so small that no channel is more than a joint survives: a guess at units.

    `check` doubts motions of half a metre and 20 m/s, which are mostly in millimetres; that is the
    one thing it asks of a record which has a size.
    """
    return replace(scale, length=scale.length * min(1.0, scale.time, 0.1 / scale.length))


def unlike(found, expected, scale):
    """What differs between two looks; where round-off does, in the readings and the laws alone.

    Ends of an interval of the power lie on a grid, of which round-off may choose the next.
    """
    if scale.is_exact:
        return differences(found, expected, scale, SEARCHED)
    assert found["laws"] == expected["laws"]
    return differences(found["tests"], expected["tests"], scale, NEARLY, ("tests",))


@pytest.mark.parametrize("kind", KINDS)
def test_a_look_at_an_image_sees_the_same(kind, scale):
    campaign = measured(kind)
    assert unlike(seen(campaign_in(campaign, scale)), seen(campaign), scale) == []


def test_a_look_at_a_whole_campaign_sees_the_same(scale):
    """Readings of all tests together: what is nonlinear, from where on, by which power."""
    campaign = measured()
    assert unlike(seen(campaign_in(campaign, scale)), seen(campaign), scale) == []


def test_a_check_of_an_image_finds_the_same(scale, tmp_path):
    campaign, scale = measured(), believable(scale)
    found = checked(campaign_in(campaign, scale), tmp_path / "image")
    assert differences(found, checked(campaign, tmp_path / "itself"), scale, allowed(scale)) == []


def in_order(answer):
    """An answer whose rows and sentences are by test, in the order of their names and words."""
    ordered = {key: sorted(answer[key]) for key in ("seen", "statements")}
    rows = {key: sorted(answer[key], key=lambda row: row["test"]) for key in ("tests", "loops")}
    return {**answer, **ordered, **rows}


def test_a_look_does_not_depend_on_the_order_of_tests_and_files():
    campaign = measured()
    found, expected = (in_order(seen(one)) for one in (reordered(campaign), campaign))
    # Sums over repeats in another order.
    assert differences(found, expected, Scale(), SEARCHED) == []


def test_a_look_and_a_check_do_not_depend_on_names(tmp_path):
    campaign = measured()
    expected = json.loads(json.dumps(seen(campaign)))
    assert with_names_back(seen(renamed(campaign))) == expected
    found, expected = (
        checked(one, tmp_path / str(i)) for i, one in enumerate((renamed(campaign), campaign))
    )
    assert with_names_back(found) == json.loads(json.dumps(expected))


def reduced(kind, scale):
    campaign = campaign_in(measured(kind), scale)
    return assemble(measured_in(campaign, lambda _: None))


ELSEWHERE = {name: 1.001 * value for name, value in AT_TRUTH.items()}


@pytest.mark.parametrize("kind", ["ringing", "pulled", "held_curve", "sweep_weak"])
def test_the_likelihood_of_an_image_is_the_same(kind, scale):
    """Its residuals; and its logarithm up to the constant that the unit of a density brings."""
    data, image = reduced(kind, Scale()), reduced(kind, scale)

    def of(function, data, theta):
        return np.asarray(function({name: np.asarray(x) for name, x in theta.items()}, data))

    here, there = scale.parameters(AT_TRUTH), scale.parameters(ELSEWHERE)
    # A turned response has a turned residual.
    residual, expected = (
        np.abs(of(stacked, one, at)) for one, at in ((image, here), (data, AT_TRUTH))
    )
    np.testing.assert_allclose(residual, expected, atol=ROUNDED * expected.max(), rtol=0)
    rise = of(log_likelihood, image, there) - of(log_likelihood, image, here)
    wanted = of(log_likelihood, data, ELSEWHERE) - of(log_likelihood, data, AT_TRUTH)
    assert rise.sum() == pytest.approx(wanted.sum(), rel=ROUNDED)


def test_the_comparison_sees_what_is_not_scaled():
    campaign, scale = measured("pulled"), Scale(length=2.0)
    answer = seen(campaign)
    assert any("loops/0/y" in said for said in differences(answer, answer, scale, ROUNDED))
    assert differences({"new": 1.0}, {"new": 1.0}, scale, ROUNDED) == [
        "new: state its unit in tests/study/same_answers.py"
    ]
    text = "from 0.05 to 3.5 mm at 20 Hz"
    assert differences({"t": "from 100 to 7000 um at 20 Hz"}, {"t": text}, scale, ROUNDED) == []
    assert differences({"t": "from 100 to 7200 um at 20 Hz"}, {"t": text}, scale, ROUNDED) != []
    assert differences({"t": "from 100 to 7000 um at 23 Hz"}, {"t": text}, scale, ROUNDED) != []
