"""How many solver steps a fit takes, where draws by its covariance have left the posterior."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest

from jbw.identification import prepare
from jbw.identification.accuracy import SHIFT
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import box

BOX = box({"x": (-100.0, 100.0), "y": (-1e4, 1e4)})
STD = np.array([3.0, 0.01])  # of x along a valley, y = BEND x^2, and of y across it
# Of one step: what it moves the mean of x by, in standard deviations. Thirty-two draws tell it to
# 12 %: the steps at which it falls below half of what is allowed lie far from that half.
ERROR = 0.32


@dataclass(frozen=True)
class Steps:
    """Stands for a dataset whose solver errs with the square of its step."""

    substeps: int
    bend: float
    stepped: bool = True


def across(theta, data):
    return (theta["y"] - data.bend * theta["x"] ** 2) / STD[1]


def log_likelihood(_, theta, data):
    return np.stack([-0.5 * (theta["x"] / STD[0]) ** 2, -0.5 * across(theta, data) ** 2], axis=1)


def change(theta, data):
    """Of halving the step: along the valley a shift of the mean, beside it a part of the misfit."""
    return (ERROR * theta["x"] / STD[0] + 0.01 * across(theta, data) ** 2) / data.substeps**2


@pytest.mark.parametrize("bend", [0.0, 1.0])
def test_a_bent_posterior_takes_no_more_solver_steps_than_a_straight_one(monkeypatch, bend):
    monkeypatch.setattr(prepare, "at_points", log_likelihood)
    monkeypatch.setattr(prepare, "solver_change", change)
    monkeypatch.setattr(prepare.dataset, "remembering", lambda theta, data: data)
    monkeypatch.setattr(prepare.dataset, "halved", lambda data: Steps(2 * data.substeps, data.bend))
    none = np.zeros(1)
    at = {"x": 0.0, "y": 0.0}
    best = Fit(at, np.full(2, 0.5), 0.0, np.diag(STD**2), {}, None, none, none, np.zeros((1, 2)))
    found = prepare.refined(jax.random.key(0), Steps(1, bend), BOX, best)
    # 0.32, 0.08, 0.02: the first below half of what the verdict allows, by three deviations.
    assert ERROR / 4 > 1.5 * prepare.AMPLE * SHIFT > 3 * ERROR / 16
    assert found.substeps == 4
