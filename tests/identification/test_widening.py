"""Boxes that draws lean on are widened once, by what each parameter is and not by its unit."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from parts import part_of

from jbw.campaign.settings import law_errors
from jbw.identification import widening
from jbw.identification.prepare import Fitted
from jbw.inference.space.box import bounds_by_name, box
from jbw.oscillator.law import Scales
from jbw.oscillator.laws import law_named

OMEGA_N = 118.0  # [rad/s]
SHARES = {"alpha", "nu_stiffness", "iwan_stiffness", "exponential_alpha"} | {
    f"stiffness_{i}" for i in (1, 2, 3)
}


def data_of(law, *peaks):
    """Data of records of displacements [m], as far as a box is concerned."""
    sizes = {str(i): peak for i, peak in enumerate(peaks)}
    part = part_of(sizes, y_peak=max(peaks, default=0.0))
    return SimpleNamespace(laws=(law,), held={}, modes=None, parts=(part,))


def leant(law, name, side, monkeypatch, stated=()):
    """Bounds after a posterior of which half of the draws of one parameter lie at a bound."""
    bounds = law_named(law).prior(Scales(OMEGA_N, 0.004, 1e-3))
    rng, draws = np.random.default_rng(0), {}
    for each, (low, high) in bounds.items():
        unit = 0.4 + 0.2 * rng.random((4, 500))
        if each == name:
            unit[:, ::2] = {"upper": 1.0, "lower": 0.0}[side]
        draws[each] = (("chain", "draw"), low + unit * (high - low))
    tree = xr.DataTree.from_dict({"posterior": xr.Dataset(draws)})
    monkeypatch.setattr(widening, "refit", lambda fit, *of: fit)
    ready = Fitted(SimpleNamespace(theta={}), box(bounds), data_of(law))
    found = widening.widened(tree, ready, stated)
    return bounds[name], None if found is None else bounds_by_name(found.box)[name]


@pytest.mark.parametrize(
    ("law", "name"),
    [
        ("bouc_wen_nu", "nu_softening"),
        ("bouc_wen_nu", "nu_opening"),
        ("iwan4", "iwan_loss"),
        ("iwan4", "iwan_beta"),
        ("masing_power", "power_loss"),
        ("gap_series", "gap_stiffness"),
        ("stop", "stop_stiffness"),
        ("jenkins_3", "slip_ratio_2"),
        ("bouc_wen", "delta"),
    ],
)
def test_an_upper_bound_that_draws_lean_on_moves_away_by_the_width(law, name, monkeypatch):
    (low, high), wide = leant(law, name, "upper", monkeypatch)
    np.testing.assert_allclose(wide, (low, high + (high - low)))
    assert leant(law, name, "upper", monkeypatch, stated={name})[1] is None


@pytest.mark.parametrize(
    ("law", "name"),
    [(law, name) for law in ("bouc_wen", "bouc_wen_nu", "iwan4", "masing_exponential", "jenkins_3")
     for name in law_named(law).names() if name in SHARES],
)  # fmt: skip
def test_a_share_of_the_stiffness_ends_where_the_joint_alone_holds(law, name, monkeypatch):
    assert leant(law, name, "upper", monkeypatch)[1] is None


@pytest.mark.parametrize(
    ("law", "name", "least"),
    [("iwan4", "iwan_chi", -1.0), ("bouc_wen_nu", "nu", 0.0), ("iwan4", "iwan_loss", 0.0)],
)
def test_a_lower_bound_moves_no_further_than_the_law_reaches(law, name, least, monkeypatch):
    (low, high), wide = leant(law, name, "lower", monkeypatch)
    # A tenth of the distance is left.
    np.testing.assert_allclose(wide, (least + 0.1 * (low - least), high))


@pytest.mark.parametrize(
    ("law", "name", "is_part"),
    [
        ("gap_series", "gap_stiffness", False),
        ("stop", "stop_stiffness", False),
        ("masing_power", "power_loss", False),
        ("iwan4", "iwan_loss", False),
        ("iwan4", "iwan_stiffness", True),
        ("jenkins_3", "stiffness_3", True),
    ],
)
def test_only_a_part_of_the_stiffness_must_stay_below_the_whole(law, name, is_part):
    told = law_errors((law,), {"omega_n": (100.0, 130.0), name: (1.0, 2e4)})
    assert bool(told) == is_part
    assert not is_part or f"{name} < omega_n^2 must hold everywhere" in told[0]


def reached(law, name, side, peaks, monkeypatch, stated=()):
    """Bounds of a parameter before and after a fit that ends at one of them."""
    bounds = law_named(law).prior(Scales(OMEGA_N, 0.004, max(peaks)))
    theta = {n: low + 0.5 * (high - low) for n, (low, high) in bounds.items()}
    fit = SimpleNamespace(
        theta=theta | {"omega_n": OMEGA_N, "zeta": 0.004}, at_bound={name: side}
    )  # fmt: skip
    monkeypatch.setattr(widening, "refit", lambda fit, *of: fit)
    ready = Fitted(fit, box(bounds), data_of(law, *peaks))
    found = widening.widened_by_fit(ready, stated)
    return bounds[name], None if found is None else (bounds_by_name(found.box)[name], found)


def test_a_bound_that_a_fit_reaches_moves_away_and_is_reported(monkeypatch):
    (low, high), (wide, found) = reached("bouc_wen", "delta", "upper", [1e-3], monkeypatch)
    assert wide == pytest.approx((low, high + (high - low)))
    assert f"delta to [{wide[0]:.3g}, {wide[1]:.3g}]" in found.statements[0]
    assert reached("bouc_wen", "delta", "upper", [1e-3], monkeypatch, {"delta"})[1] is None


def test_a_stronger_record_does_not_choose_the_widened_box(monkeypatch):
    """The weakest record alone allows a delta of 20 / 1 mm, whatever stronger ones allow."""
    alone, _ = reached("bouc_wen", "delta", "upper", [1e-3], monkeypatch)
    first, (wide, _) = reached("bouc_wen", "delta", "upper", [1e-3, 1e-2], monkeypatch)
    assert first[1] < alone[1]  # the default box shrinks
    assert wide[1] >= alone[1]


def test_a_lower_bound_of_zero_is_no_bound_that_a_fit_reaches(monkeypatch):
    assert reached("bouc_wen", "gamma", "lower", [1e-3], monkeypatch)[1] is None
    (low, high), (wide, _) = reached("bouc_wen_nu", "nu", "lower", [1e-3], monkeypatch)
    assert wide[0] < low
    assert wide[1] == high
