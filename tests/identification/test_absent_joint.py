"""A structure without a joint is answered by its fit: single records are left out."""

import jax
import numpy as np
import pytest

from jbw.identification.checks import Checks
from jbw.identification.first_fit import points_at, steps_about
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.inference.space.box import box


@pytest.mark.parametrize(("status", "unseen"), [("failed", True), ("ok", False)])
def test_single_records_are_left_out_where_no_joint_is_seen(status, unseen):
    finding = Finding("no_joint", status, "A fit without the joint raises chi-square.", np.nan)
    assert Checks((finding,), (), (), {}, 0.0).sees_no_joint is unseen
    chains = Finding("r_hat", "failed", "High.", 1.2)
    assert not Checks((chains,), (), (), {}, 0.0).sees_no_joint


def _fit(theta, covariance):
    none = np.zeros(0)
    return Fit(theta, none, 0.0, covariance, {}, None, none, none, np.zeros((0, len(theta))))


def test_points_about_a_fit_have_its_covariance_and_stay_in_the_box():
    covariance = np.array([[4.0, -1.2], [-1.2, 1.0]])
    best = _fit({"omega_n": 100.0, "zeta": 3.0}, covariance)
    steps = steps_about(jax.random.key(3), best, 20_001)
    np.testing.assert_array_equal(steps[0], 0.0)
    # A variance of 20000 draws is known to 1 %: five times that.
    np.testing.assert_allclose(np.cov(steps.T), covariance, atol=0.2)
    points = points_at(steps, best, box({"omega_n": (99.0, 200.0), "zeta": (0.0, 10.0)}))
    assert points["omega_n"][0] == 100.0
    assert points["omega_n"].min() == 99.0
