"""Normal populations in closed form: golden numbers, SciPy's densities, coverage of new units."""

import json
from pathlib import Path

import numpy as np
import pytest
from normal_populations import (
    line,
    moments,
    new_unit,
    probability_below,
    scattered,
    shrunken,
)
from scipy.stats import multivariate_normal

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_population.json").read_text())[
    "population"
]
CLOSED, QUADRATURE = 1e-12, 1e-9  # as the file states its numbers, the second after its own 1e-10


def column(values):
    return np.asarray(values)[:, None]


def squares(values):
    return np.square(values)[:, None, None]


def test_units_about_a_mean_of_known_scatter():
    case = GOLDEN["normal_normal_known_tau"]
    mean, sd = case["prior_mu"]
    scatter, x = np.array([[case["tau"] ** 2]]), np.ones((6, 1))
    trend_line = line(
        column(case["m"]), squares(case["s"]), x, scatter, np.array([mean]), np.array([[sd**2]])
    )
    np.testing.assert_allclose(
        [trend_line.mean[0], np.sqrt(trend_line.cov[0, 0])], case["posterior_mu"], rtol=CLOSED
    )
    np.testing.assert_allclose(trend_line.log_marginal, case["log_marginal"], rtol=CLOSED)
    centre, cov = new_unit(trend_line, np.ones(1), scatter)
    np.testing.assert_allclose(
        [centre[0], np.sqrt(cov[0, 0])], case["new_assembly_mean_sd"], rtol=CLOSED
    )


def test_a_unit_shrinks_to_the_population_as_its_own_golden_posterior():
    """mu is integrated out: a unit's prior is N(mu of the other five, tau^2 + its variance)."""
    case = GOLDEN["normal_normal_known_tau"]
    mean, sd = case["prior_mu"]
    scatter = np.array([[case["tau"] ** 2]])
    for k, expected in enumerate(case["unit_posteriors_mean_sd"]):
        others = [i for i in range(6) if i != k]
        trend_line = line(
            column(case["m"])[others], squares(case["s"])[others], np.ones((5, 1)), scatter,
            np.array([mean]), np.array([[sd**2]]),
        )  # fmt: skip
        centre, cov = new_unit(trend_line, np.ones(1), scatter)
        unit_mean, unit_cov = shrunken(np.array([case["m"][k]]), squares(case["s"])[k], centre, cov)
        np.testing.assert_allclose([unit_mean[0], np.sqrt(unit_cov[0, 0])], expected, rtol=1e-11)


def test_the_scatter_is_integrated_over_its_half_normal_prior():
    golden = GOLDEN["normal_normal_known_tau"]
    case, (mean, sd) = GOLDEN["normal_normal_half_normal_tau"], golden["prior_mu"]
    posterior = scattered(
        np.array(golden["m"]), np.array(golden["s"]), np.ones((6, 1)), np.array([mean]),
        np.array([[sd**2]]), case["prior_tau_scale"],
    )  # fmt: skip
    np.testing.assert_allclose(posterior.log_evidence, case["log_evidence"], rtol=QUADRATURE)
    np.testing.assert_allclose(moments(posterior), case["tau_mean_sd"], rtol=QUADRATURE)
    centre, spread = moments(posterior, np.ones(1))
    np.testing.assert_allclose([centre, spread], case["new_assembly_mean_sd"], rtol=QUADRATURE)
    mu = np.sum(posterior.weight * posterior.mean[:, 0])
    variance = np.sum(
        posterior.weight * (posterior.cov[:, 0, 0] + (posterior.mean[:, 0] - mu) ** 2)
    )
    np.testing.assert_allclose([mu, np.sqrt(variance)], case["mu_mean_sd"], rtol=QUADRATURE)


def test_a_line_in_the_logarithm_of_torque():
    case = GOLDEN["torque_regression"]
    torque, reference = np.array(case["torque"]), case["reference_torque"]
    x = np.column_stack([np.ones(12), np.log(torque / reference)])
    scatter = np.array([[case["tau"] ** 2]])
    trend_line = line(
        column(case["y"]), squares(case["s"]), x, scatter, np.array(case["prior_mean"]),
        np.array(case["prior_cov"]),
    )  # fmt: skip
    np.testing.assert_allclose(trend_line.mean, case["posterior_mean"], rtol=CLOSED)
    np.testing.assert_allclose(trend_line.cov, case["posterior_cov"], rtol=1e-11)
    np.testing.assert_allclose(trend_line.log_marginal, case["log_marginal"], rtol=1e-11)
    at = np.array([1.0, np.log(case["new_torque"] / reference)])
    centre, cov = new_unit(trend_line, at, scatter)
    np.testing.assert_allclose(
        [centre[0], np.sqrt(cov[0, 0])], case["new_assembly_mean_sd"], rtol=CLOSED
    )


def test_four_coordinates_at_once():
    case = GOLDEN["multivariate_known_Tau"]
    scatter = np.array(case["Tau"])
    m, c = np.array(case["m"]), np.array(case["C"])
    trend_line = line(m, c, np.ones((5, 1)), scatter, np.zeros(4), 4.0 * np.eye(4))
    np.testing.assert_allclose(trend_line.mean, case["posterior_mean"], rtol=1e-11)
    # Entries that nearly cancel are 1e-5 of the largest.
    np.testing.assert_allclose(trend_line.cov, case["posterior_cov"], rtol=1e-10, atol=1e-17)
    _, cov = new_unit(trend_line, np.ones(1), scatter)
    np.testing.assert_allclose(cov, case["new_assembly_cov"], rtol=1e-10, atol=1e-17)
    # The marginal density by SciPy, all units in one normal vector.
    joint_covariance = np.kron(np.ones((5, 5)), 4.0 * np.eye(4))
    for k in range(5):
        joint_covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] += scatter + c[k]
    expected = multivariate_normal(np.zeros(20), joint_covariance).logpdf(m.ravel())
    np.testing.assert_allclose(trend_line.log_marginal, expected, rtol=1e-12)


@pytest.mark.parametrize("num", [3, 5, 10])
def test_intervals_hold_the_new_unit_as_often_as_they_say(num):
    """2,000 populations of scatters that their prior says; 0.2 % is the counting error of 99 %."""
    rng = np.random.default_rng(num)
    count, scale = 2000, 0.5
    tau = scale * np.abs(rng.standard_normal(count))
    s = rng.uniform(0.05, 0.2, (count, num))
    y = tau[:, None] * rng.standard_normal((count, num)) + s * rng.standard_normal((count, num))
    ones = np.ones(1)
    posterior = scattered(y, s, np.ones((num, 1)), 0 * ones, 25.0 * np.eye(1), scale, num_nodes=100)
    below = probability_below(posterior, ones, tau * rng.standard_normal(count))
    inside = np.mean(np.abs(below - 0.5) < 0.495)
    assert 0.984 <= inside <= 0.995
