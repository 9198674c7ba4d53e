import numpy as np
import pytest

from jbw.inference.fit.identifiability import weak_direction, weak_direction_of_draws
from jbw.inference.space.box import box
from jbw.report.messages.identified import undetermined

JOINT = box({"alpha": (400.0, 600.0), "delta": (280.0, 410.0), "gamma": (20.0, 60.0)})


def posterior(logs_of, box_, num=20_000, seed=0):
    """Uniform prior draws of the box, weighted by a Gaussian on combinations of logarithms."""
    rng = np.random.default_rng(seed)
    lower, upper = np.asarray(box_.lower), np.asarray(box_.upper)
    theta = rng.uniform(lower, upper, size=(num * 20, len(lower)))
    weight = np.exp(-0.5 * np.sum(logs_of(np.log(theta / ((lower + upper) / 2))) ** 2, axis=1))
    kept = theta[rng.uniform(size=len(theta)) < weight]
    return dict(zip(box_.names, kept.T, strict=True))


def test_two_products_of_three_parameters():
    draws = posterior(lambda z: np.stack([z[:, 0] + z[:, 1], z[:, 0] + z[:, 2]], 1) / 0.02, JOINT)
    weak = weak_direction_of_draws(draws, JOINT)
    assert weak is not None
    assert weak.names == ("alpha", "delta", "gamma")
    assert weak.text == "only the products alpha*delta and alpha*gamma are determined"


def test_a_quotient_and_a_power():
    draws = posterior(lambda z: (z[:, :1] - z[:, 1:2]) / 0.01, JOINT)
    draws["gamma"] = 40 + 0.1 * np.random.default_rng(1).normal(size=len(draws["alpha"]))
    weak = weak_direction_of_draws(draws, JOINT)
    assert weak is not None
    assert weak.names == ("alpha", "delta")
    assert weak.text in (
        "only the product alpha/delta is determined",
        "only the product delta/alpha is determined",
    )


def test_a_parameter_of_which_the_data_say_nothing():
    draws = posterior(lambda z: z[:, :2] / 0.001, JOINT, num=200_000)
    weak = weak_direction_of_draws(draws, JOINT)
    assert weak is not None
    assert weak.text == undetermined(["gamma"])
    np.testing.assert_allclose(weak.ratio, 1.0, atol=0.15)


@pytest.mark.fault(28)
def test_the_theory_s_table_of_step_3():
    """CVs and correlation of section 6: `true oscillator, 6.8e-10, 8 repeats`."""
    mean = {"zeta": 0.0050, "alpha": 460.0, "delta": 350.0}
    truth = {"zeta": (0.444e-2, 0.201), "alpha": (497.4, 0.163), "delta": (340.21, 0.201)}
    bounds = box({n: (v * (1 - h), v * (1 + h)) for n, (v, h) in truth.items()})
    std = np.array([0.039, 0.082, 0.091]) * list(mean.values())
    correlation = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.994], [0.0, -0.994, 1.0]])
    weak = weak_direction(mean, correlation * np.outer(std, std), bounds)
    assert weak is not None
    assert weak.text == "only the product alpha*delta is determined"


@pytest.mark.parametrize("scale", [1e-6, 1e-2])
def test_a_narrow_posterior_has_no_weak_direction(scale):
    std = scale * np.array([200.0, 130.0, 40.0])
    correlation = np.array([[1.0, -0.999, 0.0], [-0.999, 1.0, 0.0], [0.0, 0.0, 1.0]])
    mean = {"alpha": 500.0, "delta": 340.0, "gamma": 30.0}
    assert weak_direction(mean, correlation * np.outer(std, std), JOINT) is None


def test_boxes_around_zero_speak_of_sums():
    signed = box({"offset": (-1.0, 1.0), "trend": (-2.0, 2.0)})
    covariance = np.array([[0.3, -0.6], [-0.6, 1.2001]])
    weak = weak_direction({"offset": 0.0, "trend": 0.0}, covariance, signed)
    assert weak is not None
    assert weak.text == "only the combination offset + 0.5 trend is determined"
