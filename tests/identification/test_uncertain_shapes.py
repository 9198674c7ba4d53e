"""Shapes of a model that are uncertain: which factors are inferred, and what they recover."""

from dataclasses import replace

import numpy as np
import pytest
import two_bolts
import xarray as xr
from pasted import lines_of
from scipy import stats

from jbw.campaign.load import load_with_doubts
from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.coordinates import box_of
from jbw.identification.evidence import tried_under
from jbw.identification.joint_answers import joints_group, joints_words
from jbw.identification.joint_modes import joint_modes
from jbw.identification.laplace import fit_alone
from jbw.identification.uncertain_shapes import first_factors, home_modes, shape_factors
from jbw.inference.space.box import bounds_by_name
from jbw.observables.drives import told_by
from jbw.oscillator.modes.parameters import structure_of
from jbw.quantities import motion_factor, motion_factors_in
from jbw.verification.predictive_basis import thin

TIED = ("bouc_wen@bolt_1=bolt_2",)
FACTORS = {"motion_factor_2@bolt_1": 1.08, "motion_factor_2@bolt_2": 0.93}
# Of each bolt (row) in each mode (column), as the names above say.
TRUE_FACTORS = np.array([[1.0, 1.08], [1.0, 0.93]])
RARE = 1e-4  # probability that a test of a right fit fails


def quietly(_):
    pass


@pytest.fixture(scope="module")
def stuck():
    """Sweeps of bolts in full stick, which cost nothing."""
    return two_bolts.campaign(bolts=None, uncertain=True)


@pytest.fixture(scope="module")
def seen(stuck):
    return measured_in(stuck, quietly)


@pytest.fixture(scope="module")
def data(seen):
    return assemble(seen)


def test_each_law_has_one_joint_and_mode_that_keep_the_motion_of_the_model(data):
    # Shares of both bolts are 19 and 20 % in mode 1, and 0.1 and 3 % in mode 2.
    homes = {"bolt_1": ("bolt_1", 1), "bolt_2": ("bolt_2", 1)}
    assert home_modes(data.modes, two_bolts.LAWS) == homes
    assert shape_factors(data.modes, two_bolts.LAWS) == tuple(FACTORS)
    # Joints that share a law share its units too: between them the motion is uncertain.
    assert home_modes(data.modes, TIED) == dict.fromkeys(two_bolts.LABELS, ("bolt_2", 1))
    assert shape_factors(data.modes, TIED) == (
        "motion_factor_1@bolt_1", "motion_factor_2@bolt_1", "motion_factor_2@bolt_2",
    )  # fmt: skip
    # A joint without a law sticks, whatever it moves.
    assert shape_factors(data.modes, two_bolts.LAWS[:1]) == ("motion_factor_2@bolt_1",)
    assert shape_factors(data.modes._replace(uncertain=False), two_bolts.LAWS) == ()
    # One mode is the home of both: what it tells of a factor, the law takes up.
    first = data.modes._replace(hz=data.modes.hz[:1])
    assert shape_factors(first, two_bolts.LAWS) == ()
    assert shape_factors(first, TIED) == ("motion_factor_1@bolt_1",)


def test_factors_are_sampled_about_one(seen, data):
    known = first_factors(data) | told_by(data.parts, data.held)
    bounds = bounds_by_name(box_of(seen.settings, data, known))
    assert set(bounds) == {*two_bolts.truth(), *FACTORS}
    assert first_factors(data) == dict.fromkeys(FACTORS, 1.0)
    for name in FACTORS:
        # Of ln f ~ N(0, 0.1^2), five standard deviations to either side.
        np.testing.assert_allclose(np.log(bounds[name]), [-0.5, 0.5], rtol=1e-6)
    assert data.stated.names == tuple(FACTORS)


def test_a_campaign_states_another_prior_of_a_factor(stuck):
    prior = {"motion_factor_2@bolt_2": (0.95, 1.05)}
    seen = measured_in(replace(stuck, settings=Identify.of({"prior": prior})), quietly)
    data = assemble(seen)
    bounds = bounds_by_name(box_of(seen.settings, data, told_by(data.parts, data.held)))
    assert bounds["motion_factor_2@bolt_2"] == (0.95, 1.05)
    assert data.stated.names == ("motion_factor_2@bolt_1",)


def test_a_structure_moves_its_joints_by_the_factors(data):
    theta = {**data.held, **two_bolts.truth(), **FACTORS}
    structure = structure_of(theta, two_bolts.LAWS)
    model = two_bolts.reduced(factors=TRUE_FACTORS)
    np.testing.assert_allclose(structure.h, model.H, rtol=1e-15)
    np.testing.assert_allclose(structure.p, model.H.T, rtol=1e-15)
    # Residual modes keep the motion of the model.
    plain = two_bolts.reduced()
    np.testing.assert_array_equal(
        np.asarray(structure.h)[:, plain.num_kept :], plain.H[:, plain.num_kept :]
    )


def without_residual_motion(data):
    """Data of a model whose residual modes, which have no factors, move no joint."""
    residual = {
        f"motion_{mode}@{label}": 0.0 for mode in range(3, 10) for label in two_bolts.LABELS
    }
    numbers = dict(data.modes.numbers)
    numbers |= {name: x for name, x in residual.items() if name in numbers}
    held = data.held | {name: x for name, x in numbers.items() if name in data.held}
    modes = data.modes._replace(numbers=tuple(numbers.items()))
    parts = tuple(replace(part, modes=modes) for part in data.parts)
    return replace(data, parts=parts, held=held)


@pytest.mark.slow
def test_shares_of_joints_are_by_the_motion_of_every_draw(data):
    """A factor s in all modes changes nothing where the law is alpha/s^2, delta/s, gamma/s."""
    s = np.array([[0.9, 1.0, 1.2]])
    truth = two_bolts.truth()
    powers = {"alpha": -2, "delta": -1, "gamma": -1}
    draws = {name: np.full_like(s, value) for name, value in truth.items()}
    draws |= {f"{n}@bolt_2": truth[f"{n}@bolt_2"] * s**power for n, power in powers.items()}
    draws |= {f"motion_factor_{mode}@bolt_2": s for mode in (1, 2)}
    posterior = xr.Dataset({name: (("chain", "draw"), x) for name, x in draws.items()})
    data = without_residual_motion(data)
    modes = joint_modes(posterior, data)
    assert modes is not None
    group = joints_group(posterior, data, modes)
    for name in ("loss_share", "softening_share", "frequency_change", "damping_added"):
        low, middle, high = np.moveaxis(group[name].values, -1, 0)
        np.testing.assert_allclose(low, high, rtol=1e-9)
        np.testing.assert_allclose(low, middle, rtol=1e-9)
    low, middle, high = np.quantile(s, [0.005, 0.5, 0.995])
    np.testing.assert_allclose(
        group["motion_factor"].sel(joint="bolt_2"), [[low, middle, high]] * 2, rtol=1e-12
    )
    np.testing.assert_array_equal(group["motion_factor"].sel(joint="bolt_1"), 1.0)
    words = joints_words(group)
    said = f"Mode 2 moves bolt_2 1 [{low:.3g}, {high:.3g}] times as much as the matrices predict."
    assert said in words
    assert not any("moves bolt_1" in sentence for sentence in words)
    # A joint that moves more in one mode takes more of its losses.
    more = {"motion_factor_1@bolt_2": (("chain", "draw"), 1.1 * s)}
    posterior = posterior.assign(more)
    modes = joint_modes(posterior, data)
    assert modes is not None
    moved = joints_group(posterior, data, modes)
    share = moved["loss_share"].sel(joint="bolt_2", mode=1, quantile=0.5)
    assert float(share) > 1.05 * float(group["loss_share"].sel(share.coords))


def test_other_laws_have_the_priors_of_their_own_factors(seen, data):
    for laws, names in (
        ((), ()),
        (("cubic@bolt_2",), ("motion_factor_2@bolt_2",)),
        (TIED, ("motion_factor_1@bolt_1", *FACTORS)),
    ):
        tried, settings = tried_under(laws, data, "", seen.settings)
        assert tried.laws == laws
        assert tried.stated.names == names
        assert tuple(motion_factors_in(settings.prior)) == names
    with pytest.raises(ConfigError, match="is a damper"):
        tried_under(("quadratic_damping@bolt_1",), data, "", seen.settings)


def test_predictions_take_the_factors_of_the_draws():
    names = {*two_bolts.truth(), *FACTORS, "noise_std", "gain"}
    posterior = xr.Dataset({name: (("chain", "draw"), np.ones((1, 4))) for name in names})
    assert FACTORS.keys() <= thin(posterior, 2, laws=two_bolts.LAWS).keys()


def test_factors_are_named_among_other_parameters():
    found = motion_factors_in([*two_bolts.truth(), *FACTORS, "motion_2@bolt_1"])
    assert found == {name: motion_factor(2, name.split("@")[1]) for name in FACTORS}


def test_a_prior_of_a_factor_that_is_not_inferred_is_refused(stuck):
    prior = {"motion_factor_1@bolt_1": (0.9, 1.1)}
    with pytest.raises(ConfigError, match="is not one of the inferred factors") as caught:
        measured_in(replace(stuck, settings=Identify.of({"prior": prior})), quietly)
    assert "motion_factor_2@bolt_1, motion_factor_2@bolt_2" in caught.value.what
    assert caught.value.remedy == "Leave the prior of `motion_factor_1@bolt_1` out."


def test_a_prior_of_a_factor_needs_uncertain_shapes_and_the_remedy_cures(tmp_path):
    path = two_bolts.written(tmp_path, bolts=None)
    prior = '[identify]\nprior = { "motion_factor_2@bolt_2" = [0.9, 1.1] }\n'
    text = path.read_text().replace("[identify]\n", prior, 1)
    path.write_text(text)
    with pytest.raises(ConfigError, match="needs uncertain mode shapes") as caught:
        measured_in(load_with_doubts(path)[0], quietly)
    ((table, line),) = lines_of(caught.value.remedy)
    path.write_text(text.replace(f"[{table}]\n", f"[{table}]\n{line}\n", 1))
    assert (
        "motion_factor_2@bolt_2" in measured_in(load_with_doubts(path)[0], quietly).settings.prior
    )


def standardised(fit, truth):
    """Squared distance of the truth from a fit, in its covariance."""
    away = np.array([fit.theta[name] - value for name, value in truth.items()])
    order = [list(fit.theta).index(name) for name in truth]
    return float(away @ np.linalg.solve(fit.covariance[np.ix_(order, order)], away))


@pytest.mark.release  # what its fit is made of is tested above
def test_bolts_that_move_by_other_factors_are_found_by_uncertain_shapes_alone():
    """Mode 2 moves the bolts by 8 % more and 7 % less than the matrices say."""
    campaign = two_bolts.campaign(factors=TRUE_FACTORS)
    truth = two_bolts.truth()
    by_model = fit_alone(measured_in(campaign, quietly), seed=0, report=quietly).joint.fitted.fit
    # The laws take up what the shapes lack: the fit is good, and its intervals miss the truth.
    chi_square, degrees = by_model.chi_square
    assert chi_square < stats.chi2.isf(RARE, degrees)
    assert standardised(by_model, truth) > 10 * stats.chi2.isf(RARE, len(truth))
    campaign = replace(campaign, joints=replace(campaign.joints, uncertain=True))
    found = fit_alone(measured_in(campaign, quietly), seed=0, report=quietly)
    fit = found.joint.fitted.fit
    assert standardised(fit, truth | FACTORS) < stats.chi2.isf(RARE, len(fit.theta))
    # The second bolt alone damps mode 2, and its factor is known to a per cent.
    std = np.sqrt(np.diag(fit.covariance))[list(fit.theta).index("motion_factor_2@bolt_2")]
    assert std < 0.02
    draws = found.joint.tree["posterior"]["motion_factor_2@bolt_2"]
    assert draws.attrs["long_name"] == "motion of bolt_2 in mode 2 relative to the structural model"
