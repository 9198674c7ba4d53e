"""Sliders: golden numbers made without jbw, and a free decay."""

import numpy as np
import pytest

from jbw.freeform.sliders import (
    SliderGrid,
    grid_for,
    loss_share,
    stiffness_share,
)

HALF_WIDTHS, STRENGTHS, PEAK = np.array([1.0, 2.0, 4.0]), np.array([0.2, 0.1, 0.05]), 3.0


def play_force(y, strengths, half_widths, stiffness):
    """The sliders' force along a motion from rest, exact where the motion is piecewise linear."""
    play, force = np.zeros_like(half_widths), np.empty(len(y))
    for k, position in enumerate(y):
        play = np.clip(play, position - half_widths, position + half_widths)
        force[k] = stiffness * position - strengths @ play
    return force


def test_the_first_harmonic_of_one_slider_is_the_closed_form():
    # Reference: an independent program, to all digits that it printed.
    assert stiffness_share(2.0, 1.0) == pytest.approx(0.5, rel=1e-14)
    assert stiffness_share(1.25, 1.0) == pytest.approx(0.8576215100673531, rel=1e-14)
    assert loss_share(2.0, 1.0) == pytest.approx(0.3183098861837907, rel=1e-14)
    assert loss_share(5.0, 1.0) == pytest.approx(0.20371832715762606, rel=1e-14)
    assert stiffness_share(1.0, 3.0) == 1.0  # fully stuck
    assert loss_share(1.0, 3.0) == 0.0


def test_a_bin_of_equal_sliders_takes_what_each_of_them_lacks_of_its_stiffness():
    grid = SliderGrid(np.log([1.0, 3.0]), 1e-6)
    found = grid.softening([1.25, 0.5])
    # The same golden share; sliders of a bin are 1e-6 apart.
    assert found[0] == pytest.approx([1 - 0.8576215100673531, 0.0], abs=1e-6)
    assert found[1] == pytest.approx(0.0, abs=1e-12)  # fully stuck


def steady_cycle(samples):
    """Displacement from rest through one cycle, whose samples meet every kink."""
    up = np.linspace(0.0, PEAK, samples + 1)
    down = np.linspace(PEAK, -PEAK, 2 * samples + 1)[1:]
    return np.concatenate([up, down, -down])


def test_a_steady_loop_has_the_golden_tip_and_area():
    y = steady_cycle(300)
    force = play_force(y, STRENGTHS, HALF_WIDTHS, 1.0)
    assert force[300] == pytest.approx(2.5, rel=1e-14)
    # The force is linear between samples, so that the trapezoidal rule is exact.
    assert abs(np.trapezoid(force[300:], y[300:])) == pytest.approx(2.4, rel=1e-12)


def test_its_first_harmonic_is_the_sum_over_sliders():
    stiffness = 1.0 - STRENGTHS @ (1 - stiffness_share(PEAK, HALF_WIDTHS))
    loss = STRENGTHS @ loss_share(PEAK, HALF_WIDTHS)
    assert stiffness == pytest.approx(0.8291791405790929, rel=1e-14)
    assert loss == pytest.approx(0.08488263631567752, rel=1e-14)
    # The same by the definition: Fourier integrals over the steady loop.
    t = np.linspace(0.0, 2 * np.pi, 20_001)
    cycle = PEAK * np.cos(t)
    y = np.concatenate([np.linspace(0.0, PEAK, 50)[:-1], cycle[:-1], cycle])
    force = play_force(y, STRENGTHS, HALF_WIDTHS, 1.0)[-len(t) :]
    # The rule's error is of second order in the step at kinks of the force: 1e-7 here.
    assert np.trapezoid(force * np.cos(t), t) / np.pi / PEAK == pytest.approx(stiffness, rel=1e-6)
    assert abs(np.trapezoid(force * np.sin(t), t)) / np.pi / PEAK == pytest.approx(loss, rel=1e-6)


def test_a_free_decay_is_the_golden_one():
    """RK4 with the play held within a step, from a program apart: y and v at t = 80."""
    widths, strengths, damping, dt = np.array([0.5, 1.0]), np.array([0.1, 0.1]), 0.002, 0.005
    y, v, play = 2.0, 0.0, np.array([1.5, 1.0])

    def rate(y, v, play):
        held = np.clip(play, y - widths, y + widths)
        return v, -damping * v - y + strengths @ held

    for _ in range(16_000):
        k1 = rate(y, v, play)
        k2 = rate(y + dt / 2 * k1[0], v + dt / 2 * k1[1], play)
        k3 = rate(y + dt / 2 * k2[0], v + dt / 2 * k2[1], play)
        k4 = rate(y + dt * k3[0], v + dt * k3[1], play)
        y += dt / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
        v += dt / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
        play = np.clip(play, y - widths, y + widths)
    # A turn within a step costs the square of the step: 1e-5 of the motion.
    assert (y, v) == pytest.approx((-0.506782, -0.048510), abs=2e-5)


def test_a_power_law_of_strengths_has_the_power_of_its_loss():
    """Density d^(chi + 1) makes a loss of power chi + 2, by the integral over all sliders."""
    grid, chi = grid_for(1e-4, 2e-4), -0.4
    grid = SliderGrid(np.arange(np.log(1e-8), np.log(1e-2), grid.width), grid.width)
    edges = np.exp(np.append(grid.log_d - grid.width / 2, grid.log_d[-1] + grid.width / 2))
    loss = grid.loss([1e-4, 2e-4]) @ np.diff(edges ** (chi + 2))
    exact = 4 / np.pi * (chi + 2) * (1 / (chi + 3) - 1 / (chi + 4)) * 1e-4 ** (chi + 2)
    # Sliders of a bin are equal, the density is tilted: a bin of 15 % misses 0.4 % of the loss.
    assert loss[0] == pytest.approx(exact, rel=6e-3)
    assert np.log2(loss[1] / loss[0]) == pytest.approx(chi + 2, abs=1e-3)
