"""Whether macroslip, a contact or a slip was reached, told of draws whose quantiles are known."""

import numpy as np
import pytest

from jbw.identification.reached import threshold_sentences
from jbw.oscillator.laws.iwan import Iwan4

EVEN = np.linspace(0.0, 1.0, 1001)  # its 99 % band is from 0.005 to 0.995


@pytest.mark.parametrize(
    ("y_peak", "says"),
    [
        (
            1e-3,
            "1.5 [1, 2] times the largest motion: the tests did not reach this motion, so that "
            "only the prior determines K",
        ),
        (
            1.5e-3,
            "times the largest motion: the tests may not have reached this motion, so that the "
            "prior helps to determine K_T",
        ),
        (3e-3, "0.5 [0.33, 0.67] times the largest motion: the tests reached this motion."),
    ],
)
def test_macroslip_is_told_beside_the_largest_motion(y_peak, says):
    # Segalman's F_S of a macroslip between 1 and 2 mm.
    phi, k_t, chi, beta = 1e-3 * (1.0 + EVEN), 2000.0, -0.3, 0.5
    f_s = k_t * phi * (beta + (chi + 1) / (chi + 2)) / (1 + beta)
    theta = Iwan4.of_segalman(np.full(1001, k_t), f_s, np.full(1001, chi), np.full(1001, beta))
    (said,) = threshold_sentences({**theta.parameters(), "cubic": 0.0}, y_peak, ("cubic", "iwan4"))
    assert said.startswith("iwan4: macroslip at 1.5 mm [1, 2], ")
    assert says in said


def test_a_gap_wider_than_all_motion_is_told_of_the_posterior():
    theta = {"gap_stiffness": 700.0, "gap_softening": 300.0, "gap_opening": 100.0,
             "gap": 2e-3 + 1e-3 * EVEN}  # fmt: skip
    (said,) = threshold_sentences(theta, 1e-3, ("gap_series",))
    assert (
        "contact at 2.5 mm [2, 3], 2.5 [2, 3] times the largest motion: the tests did not reach"
        in said
    )
    assert "only the prior determines the parameters that act once the gap closes" in said
    stop = {"stop_stiffness": 700.0, "stop_gap": 1e-3 + 1e-3 * EVEN}
    assert (
        "did not reach this motion, so that only the prior determines its stiffness"
        in (threshold_sentences(stop, 1e-4, ("stop",))[0])
    )


def test_each_slider_is_told():
    theta = {"stiffness_1": 300.0, "slip_1": 5e-4 + 0.0 * EVEN, "stiffness_2": 250.0,
             "slip_ratio_2": 4.2 + 0.8 * EVEN}  # fmt: skip
    (said,) = threshold_sentences(theta, 1e-3, ("jenkins_2",))
    first, second = said.split("; ")
    assert "slider 1 at 0.5 mm [0.5, 0.5], 0.5 [0.5, 0.5] times the largest motion: the" in first
    assert "the tests reached this motion" in first
    assert second.startswith("slip of slider 2 at 2.3 mm [2.1, 2.5], 2.3")
    assert threshold_sentences(theta, 0.0, ("jenkins_2",)) == []
    assert threshold_sentences({"cubic": EVEN}, 1e-3, ("cubic",)) == []
