"""The box of the products: about the fit, as far and as signed as the campaign's own bounds."""

import pytest

from jbw.campaign.settings import Identify
from jbw.identification.coordinates import coordinate_box
from jbw.inference.space.box import box
from jbw.oscillator.laws.bouc_wen import SHARE, BoucWenLaw

THETA = {"omega_n": 100.0, "zeta": 0.01, "alpha": 2000.0, "delta": -30.0, "gamma": 10.0}
BOUNDS = {
    "omega_n": (90.0, 110.0),
    "zeta": (0.001, 0.1),
    "alpha": (100.0, 5000.0),
    "delta": (0.0, 100.0),
    "gamma": (0.0, 100.0),
}


PRODUCTS = BoucWenLaw.coordinates["products"]


def product_box(prior, theta, settings):
    return coordinate_box(prior, theta, settings, BoucWenLaw, PRODUCTS)


def bounds_of(prior):
    pairs = zip(prior.lower.tolist(), prior.upper.tolist(), strict=True)
    return dict(zip(prior.names, pairs, strict=True))


def test_products_of_a_fit():
    found = PRODUCTS.from_parameters(THETA)
    assert found["share"] == pytest.approx(0.2)
    assert found["softening"] == pytest.approx(-6.0)
    assert found["opening"] == pytest.approx(2.0)


def test_softening_is_signed_where_delta_may_be_negative():
    found = bounds_of(product_box(box(BOUNDS), THETA, Identify()))
    assert found["softening"] == (0.0, pytest.approx(24.0))
    assert found["share"] == pytest.approx(SHARE)
    assert list(found) == ["omega_n", "zeta", "softening", "opening", "share"]
    signed = bounds_of(product_box(box({**BOUNDS, "delta": (-100.0, 100.0)}), THETA, Identify()))
    assert signed["softening"] == pytest.approx((-24.0, 24.0))
    assert signed["opening"] == pytest.approx((0.0, 24.0))


def test_stated_bounds_on_alpha_bound_its_share():
    given = Identify(prior={"alpha": (100.0, 5000.0)})
    assert bounds_of(product_box(box(BOUNDS), THETA, given))["share"] == pytest.approx((0.01, 0.5))
