"""Masing's law of a given virgin curve, against closed forms and SciPy; what it refuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import jbw
from jbw.errors import ConfigError
from jbw.oscillator.laws import LAWS
from jbw.oscillator.laws.iwan import MasingExponential

ALPHA, B = 500.0, 370.0
X = np.linspace(0.0, 8e-3, 200)
FORCE = ALPHA / B * -np.expm1(-B * X)
KIND = jbw.laws.given_backbone("lap_joint", X, FORCE)
CHIRP_T = np.arange(2048) / 512
CHIRP = 4.0 * np.sin(2 * np.pi * (5.0 * CHIRP_T + 4.0 * CHIRP_T**2))


def test_points_of_the_exponential_move_as_the_exponential():
    """The pieces' slope errs by (B h)^2 / 12 = 2e-5 of it, which thirty cycles pile up."""
    given, exact = (
        jbw.simulate(jbw.Oscillator(118.0, 0.004, (law,)), CHIRP, 512.0)
        for law in (KIND(1.0, 1.0), MasingExponential(ALPHA, B))
    )
    assert np.max(np.abs(given.v - exact.v)) < 1e-3 * np.max(np.abs(exact.v))
    assert np.max(np.abs(exact.z)) > 0.5 * ALPHA / B  # well into its curve


@pytest.mark.parametrize("y_peak", [1e-4, 1e-3, 7e-3, 2e-2])
def test_the_loop_loses_what_the_curve_says(y_peak):
    r"""$E = 8\int_0^Y F - 4 Y F(Y)$ by SciPy's own integral of it, straight past the end."""
    curve = PchipInterpolator(X, FORCE)
    scale, reach = 1.3, 0.8

    def force(x):
        way, end = x / reach, X[-1]
        return scale * (curve(min(way, end)) + curve(end, 1) * max(way - end, 0.0))

    way, end = y_peak / reach, X[-1]
    beyond = max(way - end, 0.0)
    below = curve.antiderivative()(min(way, end))
    area = scale * reach * (below + beyond * (curve(end) + 0.5 * beyond * curve(end, 1)))
    energy = 8.0 * area - 4.0 * y_peak * force(y_peak)
    found = KIND(scale, reach).loop(jnp.asarray(y_peak))
    # 8 A - 4 Y F cancels where Y is small: rounding over a loss of 1e-3 of either.
    np.testing.assert_allclose(found.damping, energy / (np.pi * y_peak**2), rtol=1e-9)
    np.testing.assert_allclose(KIND(scale, reach).backbone(y_peak), force(y_peak), rtol=1e-12)


def test_scales_have_the_slopes_that_differences_give():
    def loss(scales):
        oscillator = jbw.Oscillator(118.0, 0.004, (KIND(scales[0], scales[1]),))
        return jnp.sum(jbw.simulate(oscillator, CHIRP, 512.0, substeps=4).v ** 2)

    at, step = jnp.array([1.1, 0.9]), 1e-5
    found = jax.grad(loss)(at)
    for i in range(2):
        ahead, back = (loss(at.at[i].add(sign * step)) for sign in (1.0, -1.0))
        # Differences' truncation (1e-10) and rounding (1e-11) in a loss whose slope is of its size.
        np.testing.assert_allclose(found[i], (ahead - back) / (2 * step), rtol=1e-6)


def test_a_campaign_may_name_it_once_it_is_registered():
    try:
        jbw.laws.register(KIND)
        assert jbw.laws.law_named("lap_joint") is KIND
        assert KIND.names() == ("lap_joint_force", "lap_joint_displacement")
        assert KIND.build(KIND(1.2, 0.7).parameters()) == KIND(1.2, 0.7)
    finally:
        LAWS.pop("lap_joint", None)


@pytest.mark.parametrize(
    ("x", "force", "said"),
    [
        ([0.0, 1.0], [0.0, 1.0], "at least 3 displacements"),
        ([0.0, 1.0, 2.0], [0.0, 1.0], "as many forces"),
        ([0.0, 1.0, 2.0], [0.0, np.nan, 1.5], "finite"),
        ([0.1, 1.0, 2.0], [0.0, 1.0, 1.5], r"begin at \(0, 0\)"),
        ([0.0, 2.0, 1.0], [0.0, 1.0, 1.5], "increasing"),
        ([0.0, 1.0, 2.0], [0.0, 1.0, 0.5], "never fall"),
        ([0.0, 1.0, 2.0], [0.0, 1.0, 2.5], "must not rise, as it does at 1 m"),
    ],
)
def test_curves_of_no_sliders_are_refused(x, force, said):
    with pytest.raises(ConfigError, match=said):
        jbw.laws.given_backbone("lap_joint", x, force)


def test_a_name_is_a_word():
    with pytest.raises(ConfigError, match="must be a word"):
        jbw.laws.given_backbone("lap joint", X, FORCE)
