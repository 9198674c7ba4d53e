"""Weights and their tails, where there is hardly one."""

import numpy as np

from jbw.inference.samplers.weighed_points import weights_of


def test_copies_of_one_heavy_draw_are_no_tail():
    found = weights_of(np.concatenate([-30.0 - np.arange(200.0), np.zeros(100)]))
    assert found.khat == np.inf
    np.testing.assert_allclose(found.effective, 100.0)


def test_draws_of_one_weight_are_all_worth_one():
    found = weights_of(np.full(300, -5.0))
    assert found.khat == 0.0
    np.testing.assert_allclose(found.effective, 300.0)
    np.testing.assert_allclose(found.weights, 1 / 300)
