"""The Gaussian about a fit, against Student's t distribution and a posterior by its definition."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy import stats

from jbw.identification import laplace
from jbw.identification.laplace import gaussians_about
from jbw.inference.space.box import box


class Part:
    """Runs that each read omega_n and zeta directly, with independent errors."""

    own_shifts = False

    def __init__(self, runs):
        self.groups = SimpleNamespace(runs=runs, labels=runs)


class Data(dict):
    """As much of a dataset as the Gaussians ask for."""

    def __init__(self, runs, scatters):
        super().__init__()
        self.parts, self.runs, self.shared_runs = (Part(runs),), runs, runs
        self.scatters, self.scatter, self.has_offsets = scatters, np.ones(2), True


@pytest.fixture
def two_numbers(monkeypatch):
    """`gaussians_about` of runs whose readings of (omega_n, zeta) about zero have known errors."""

    def about(readings, errors, scatters):
        runs = tuple(f"run {i}" for i in range(len(readings)))
        data = Data(runs, np.asarray(scatters))
        slopes = np.tile(np.diag(1 / np.asarray(errors)), (len(readings), 1))
        rows = -(np.asarray(readings) / errors).ravel()
        monkeypatch.setattr(laplace, "replace", lambda data, **_: data)
        monkeypatch.setattr(laplace, "evaluator", lambda *_: lambda s, which: (rows, slopes)[which])
        monkeypatch.setattr(laplace, "to_search", lambda x, box: x)
        monkeypatch.setattr(laplace, "from_search", lambda s, box: (s, np.ones(2)))
        monkeypatch.setattr(
            laplace,
            "by_label",
            lambda array, data: dict(zip(runs, np.split(array, len(runs)), strict=True)),
        )
        box = type("Box", (), {"names": ("omega_n", "zeta"), "lower": np.zeros(2)})()
        # Unit width, so that the box's own precision of 12 is nothing beside these readings.
        box.upper = np.ones(2)
        fit = type("Fit", (), {"x": np.zeros(2), "covariance": np.eye(2)})()
        ready = type("Ready", (), {"fit": fit, "box": box, "data": data})()
        return gaussians_about(ready)

    return about


def test_three_runs_of_unknown_scatter_have_the_tails_of_student(two_numbers):
    """mu of x_i ~ N(mu, s^2), s under 1/s: t with two degrees of freedom, known exactly."""
    readings = np.array([[-0.02, 0.0], [0.005, 0.0], [0.015, 0.0]])
    # A log-uniform grid from far below to far above the scatter seen, fine enough to integrate by;
    # nothing scatters in zeta, and readings are exact beside the scatter.
    scatters = [(s, 1e-9) for s in np.geomspace(1e-4, 3.0, 400)]
    found = two_numbers(readings, (1e-6, 1e-3), scatters)
    share = np.array([each.share for each in found])
    mean = np.array([each.mean[0] for each in found])
    sd = np.sqrt([each.covariance[0, 0] for each in found])
    student = stats.t(2, readings[:, 0].mean(), readings[:, 0].std(ddof=1) / np.sqrt(3))
    for level in (0.05, 0.25, 0.5, 0.75, 0.95):
        mixture = float(share @ stats.norm.cdf((student.ppf(level) - mean) / sd))
        # The grid ends at a scatter of 3, and the box of unit width has a precision of its own.
        assert mixture == pytest.approx(level, abs=2e-3)


def test_without_scatter_the_readings_are_pooled(two_numbers):
    readings = np.array([[0.01, 0.002], [0.03, 0.004]])
    (found,) = two_numbers(readings, (1e-3, 1e-4), [(1e-9, 1e-9)])
    assert found.share == pytest.approx(1.0)
    # The precision of the box, 12, beside 2e6: 1e-5 of the answer.
    np.testing.assert_allclose(found.mean, readings.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(np.diag(found.covariance), np.array([1e-6, 1e-8]) / 2, rtol=1e-5)


def test_a_fit_without_offsets_is_its_own_gaussian():
    data = type("Data", (), {"has_offsets": False})()
    box = type("Box", (), {"names": ("omega_n", "zeta")})()
    fit = type("Fit", (), {"covariance": np.diag([4.0, 9.0])})()
    (found,) = gaussians_about(type("Ready", (), {"fit": fit, "box": box, "data": data})())
    np.testing.assert_array_equal(found.covariance, np.diag([4.0, 9.0]))
    assert found.share == 1.0


def test_draws_about_a_fit_at_a_bound_move_the_other_parameters_with_it(monkeypatch):
    """A Gaussian whose mean lies 5 sd below the bound of `share`, which omega_n goes with."""
    mean, covariance = np.array([-2.0, -0.5]), np.array([[1.0, 0.099], [0.099, 0.01]])
    about = [laplace.Gaussian(1.0, mean, covariance)]
    monkeypatch.setattr(laplace, "gaussians_about", lambda ready: about)
    prior = box({"omega_n": (50.0, 200.0), "share": (0.0, 1.0)})
    theta = {"omega_n": 100.0, "share": 0.0}
    fit = type("Fit", (), {"theta": theta, "covariance": covariance})()
    ready = type("Ready", (), {"fit": fit, "box": prior})()
    _, drawn = laplace.laplace_draws(jax.random.key(0), ready)
    assert {name: values[0] for name, values in drawn.items()} == pytest.approx(theta)
    share = stats.truncnorm(5.0, np.inf, loc=-0.5, scale=0.1)
    # Five standard errors of 4000 draws; omega_n is 100 exp(d / 100) for d of the Gaussian, which
    # adds d^2 / 200 = 0.05 to it.
    assert drawn["share"].mean() == pytest.approx(share.mean(), abs=5 * share.std() / 63)
    expected = 100 + mean[0] + 9.9 * (share.mean() - mean[1])
    assert drawn["omega_n"].mean() == pytest.approx(expected, abs=5 * 0.25 / 63 + 0.06)
    assert drawn["share"].min() >= 0.0
