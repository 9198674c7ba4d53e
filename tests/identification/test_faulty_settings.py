"""Priors and noise that cannot be meant: refused with their inequality, or warned of."""

import numpy as np
import pytest
from pasted import pasted

import jbw
from jbw.campaign.schema import parse
from jbw.campaign.settings import Identify, law_errors
from jbw.errors import ConfigError, ModelError
from jbw.identification.accuracy import another_law, residual_finding
from jbw.identification.coordinates import joint_box
from jbw.inference.space.box import bounds_by_name
from jbw.oscillator.law import Scales
from jbw.planning.description import parse as parse_plan

CAMPAIGN = """
[[test]]
kind = "sweep"
files = "a.h5"
channels = {{ input = "u", velocity = "v" }}
[identify{table}]
{line}
"""
OMEGA_N = 118.0  # [rad/s]


def refused(line, table=".prior", check=parse):
    with pytest.raises(ConfigError) as caught:
        check(CAMPAIGN.format(line=line, table=table) if check is parse else line)
    return str(caught.value)


@pytest.mark.fault(25, 27)
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("zeta = [0.006, 0.003]", "zeta: must be [lower, upper] with lower < upper"),
        ("zeta = [0.003, 0.003]", "zeta: must be [lower, upper] with lower < upper"),
        ("zeta = [-0.003, 0.006]", "zeta: must be positive, but its lower bound is -0.003"),
        ("gain = [-1.0, 2.0]", "gain: must be positive"),
        ("omega_n = [0.0, 2.0]", "omega_n: must be positive"),
        ("alpha = [nan, 2.0]", "alpha: must be finite"),
        ("alpha = [1.0, inf]", "alpha: must be finite"),
        ("alpha = [1.0]", "alpha: must be [lower, upper]"),
        ("alpha = 1.0", "alpha: must be [lower, upper], or a distribution"),
        ("omega_n = [100.0, 130.0]\nalpha = [1.0, 1e4]", "alpha < omega_n^2 must hold everywhere"),
        ("omega_n = [100.0, 130.0]\nalpha = [1.0, 1e4]", "lower alpha's upper bound"),
    ],
)
def test_bounds_that_cannot_be_meant(line, says):
    message = refused(line)
    assert "[identify] prior" in message
    assert says in message


@pytest.mark.parametrize(
    ("laws", "line", "must"),
    [
        ("iwan4", "iwan_chi = [-1.0, 0.5]", "greater than -1, but its lower bound is -1"),
        ("iwan4", "iwan_chi = [-1.5, 0.5]", "greater than -1, but its lower bound is -1.5"),
        ("iwan4", "iwan_loss = [0.0, 50.0]", "positive, but its lower bound is 0"),
        ("iwan4", "iwan_beta = [-0.1, 1.0]", "positive, but its lower bound is -0.1"),
        ("masing_power", "power_exponent = [0.0, 1.0]", "positive, but its lower bound is 0"),
        ("bouc_wen_nu", "nu = [0.0, 1.0]", "positive, but its lower bound is 0"),
        ("gap_series", "gap_stiffness = [0.0, 1e4]", "positive, but its lower bound is 0"),
    ],
)
def test_a_prior_that_reaches_where_no_law_is(laws, line, must):
    joint = f'[joint]\nlaws = "{laws}"\n'
    with pytest.raises(ConfigError) as caught:
        parse(joint + CAMPAIGN.format(line=line, table=".prior"))
    told = str(caught.value)
    assert f"[identify] prior: {line.split()[0]}: must be {must}" in told


@pytest.mark.parametrize(
    ("laws", "line"),
    [
        ("iwan4", "iwan_beta = [0.0, 1.0]"),  # without a lump that slips last
        ("iwan4", "iwan_chi = [-0.99, 0.5]"),
        ("gap_series", "gap = [0.0, 1e-3]"),
        ("masing_power", "power_loss = [0.0, 1.0]"),
    ],
)
def test_a_prior_to_the_edge_of_a_law(laws, line):
    parse(f'[joint]\nlaws = "{laws}"\n' + CAMPAIGN.format(line=line, table=".prior"))


def box_of(**prior):
    return joint_box(Identify(prior=prior), Scales(OMEGA_N, 0.004, 1e-3), None)


@pytest.mark.fault(27)
def test_more_stiffness_in_the_joint_than_there_is_in_all():
    with pytest.raises(ConfigError, match=r"alpha < omega_n\^2 must hold") as caught:
        box_of(alpha=(100.0, 2e4))
    assert "20000" in caught.value.what
    assert "Step 2 estimates omega_n^2 = 13924" in caught.value.what
    assert "[identify.prior]" in caught.value.remedy


def test_stiffnesses_of_laws_are_parts_of_one_whole():
    scales, laws = Scales(OMEGA_N, 0.004, 1e-3), ("bouc_wen", "iwan4", "cubic")
    whole = OMEGA_N**2
    bounds = bounds_by_name(joint_box(Identify(), scales, None, laws))
    # Of 0.9 each by itself: together no more than one of them alone.
    assert bounds["alpha"] == pytest.approx((5e-4 * whole, 0.45 * whole))
    assert bounds["iwan_stiffness"] == pytest.approx((5e-4 * whole, 0.45 * whole))
    stated = Identify(prior={"iwan_stiffness": (10.0, 0.8 * whole)})
    bounds = bounds_by_name(joint_box(stated, scales, None, laws))
    assert bounds["iwan_stiffness"] == pytest.approx((10.0, 0.8 * whole))
    assert bounds["alpha"] == pytest.approx((5e-4 * whole, 0.2 * whole))
    alone = bounds_by_name(joint_box(Identify(), scales, None, ("bouc_wen", "cubic")))
    assert alone["alpha"] == pytest.approx((5e-4 * whole, 0.9 * whole))


@pytest.mark.fault(27)
def test_stated_stiffnesses_that_exceed_the_whole_together_are_refused_by_name():
    prior = {"alpha": (10.0, 8e3), "iwan_stiffness": (10.0, 7e3)}
    with pytest.raises(ConfigError, match="the priors of `alpha`, `iwan_stiffness`") as caught:
        joint_box(Identify(prior=prior), Scales(OMEGA_N, 0.004, 1e-3), None, ("bouc_wen", "iwan4"))
    assert "Step 2 estimates as 13924" in caught.value.what
    assert "allow a sum of 15000" in caught.value.what
    three = {f"stiffness_{i}": (10.0, 5e3) for i in (1, 2, 3)}
    with pytest.raises(
        ConfigError, match="the priors of `stiffness_1`, `stiffness_2`, `stiffness_3`"
    ):
        joint_box(Identify(prior=three), Scales(OMEGA_N, 0.004, 1e-3), None, ("jenkins_3",))
    told = law_errors(("bouc_wen", "iwan4"), {"omega_n": (118.0, 120.0), **prior})
    assert "alpha + iwan_stiffness < omega_n^2 must hold everywhere" in told[0]
    sliders = {"omega_n": (100.0, 130.0)} | {f"stiffness_{i}": (1.0, 4e3) for i in (1, 2, 3)}
    assert "stiffness_1 + stiffness_2 + stiffness_3 <" in law_errors(("jenkins_3",), sliders)[0]


def test_laws_that_no_motion_tells_apart_are_warned_of():
    with pytest.warns(UserWarning, match="`iwan4` and `masing_power` cannot be distinguished"):
        joint_box(Identify(), Scales(OMEGA_N, 0.004, 1e-3), None, ("iwan4", "masing_power"))


@pytest.mark.fault(27)
def test_signs_that_real_joints_need_are_warned_of_and_growth_is_refused():
    with pytest.warns(UserWarning, match=r"gamma \+ delta fall to -200") as caught:
        box_of(delta=(100.0, 400.0), gamma=(-300.0, 50.0))
    assert "lower bound of gamma above -delta" in str(caught[0].message)
    growing = jbw.BoucWen(omega_n=OMEGA_N, zeta=0.005, alpha=500.0, delta=100.0, gamma=-500.0)
    push = 20.0 * np.sin(60.0 * np.arange(512) / 512)
    with (
        pytest.warns(UserWarning, match=r"delta \+ gamma > 0"),
        pytest.raises(ModelError, match="diverges at sample") as caught,
    ):
        jbw.simulate(growing, push, 512.0)
    assert "delta = 100.0, gamma = -500.0" in caught.value.what
    assert caught.value.remedy


def test_more_opening_than_softening_is_taken_as_it_is(recwarn):
    box_of(delta=(10.0, 20.0), gamma=(10.0, 400.0))
    assert not recwarn.list


PLAN = "[plan]\nnatural_hz = 20.0\ndelta = [100.0, 300.0]\n"


@pytest.mark.fault(30)
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("noise = 0.0", "[plan] noise: must be positive, but is 0.0"),
        ("noise = -1.0", "[plan] noise: must be positive, but is -1.0"),
        ("noise = nan", "[plan] noise: must be finite"),
        ("", "[plan] noise: missing; standard deviation of a sample of the response"),
    ],
)
def test_noise_of_a_plan_is_positive_and_there(line, says):
    assert says in refused(PLAN + line, check=parse_plan)


@pytest.mark.fault(30)
def test_noise_of_a_campaign_is_learnt_from_its_records_and_not_given():
    assert "noise_std: unknown key" in refused("noise_std = 0.0", table="")


def left_after(correlation, n=4000):
    """What a fit leaves: an AR(1) process."""
    rng, row = np.random.default_rng(0), np.zeros(n)
    for i in range(1, n):
        row[i] = correlation * row[i - 1] + rng.normal()
    return row


@pytest.mark.fault(33)
def test_autocorrelated_residuals_fail_with_their_correlation_and_worth():
    rows = {"white": left_after(0.0), "coloured": left_after(0.9)}
    worth, error = {"white": 1.0, "coloured": 0.053}, {"white": 0.01, "coloured": 0.02}
    found = residual_finding(rows, worth, error, ("bouc_wen",))
    assert found is not None
    assert found.status == "failed"
    # Of 4000 values, to three standard errors of sqrt((1 - 0.81) / 4000).
    assert abs(found.number - 0.9) < 0.021
    values = {"coloured": 1, "count": 2, "test": "coloured", "error": 0.02, "counted": 0.053}
    assert values.items() <= found.values.items()
    assert pasted(found.action).laws == ("bouc_wen", "cubic")
    assert another_law(("bouc_wen", "cubic")) == "Try other laws: jbw laws."
    alone = residual_finding({"white": rows["white"]}, worth, error)
    assert alone is not None
    assert alone.status == "ok"


@pytest.mark.fault(33, 36)
def test_residuals_that_are_no_numbers_are_not_white():
    rows = {"white": left_after(0.0), "broken": np.full(100, np.nan)}
    found = residual_finding(rows, {"white": 1.0, "broken": 1.0}, {"white": 0.01, "broken": 0.01})
    assert found is not None
    assert found.status == "failed"
    assert "broken" in found.reason


@pytest.mark.parametrize(
    ("bounds", "says"),
    [((2e-3, 3e-3), "begins at 0.002 m"), ((1e-4, 3e-3), "reaches 0.003 m")],
)
@pytest.mark.parametrize(("law", "gap"), [("gap_series", "gap"), ("stop", "stop_gap")])
def test_a_gap_that_no_motion_crosses_is_warned_of(law, gap, bounds, says):
    told = f"prior of {gap} {says}, but the largest motion is 0.001 m"
    with pytest.warns(UserWarning, match=told):
        joint_box(Identify(prior={gap: bounds}), Scales(OMEGA_N, 0.004, 1e-3), None, (law,))
    joint_box(Identify(), Scales(OMEGA_N, 0.004, 1e-3), None, (law,))  # its own is within
