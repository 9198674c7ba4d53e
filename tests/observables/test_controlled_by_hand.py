"""Controlled points by hand: what a damped neighbour adds, and whose noise a value has."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jbw.observables import controlled
from jbw.observables.controlled import ControlledPoints


@pytest.fixture(autouse=True)
def _all_values_are_compared(monkeypatch):
    monkeypatch.setattr(controlled, "compared", lambda *_: slice(None))


def test_a_damped_neighbour_s_motion_is_taken_out_with_its_own_phase():
    """Of a measured motion Y the joint's is Y less a g F / (w_2^2 - w^2 + 2 j z w_2 w)."""
    theta = {"gain": 0.5, "neighbour_1_omega": 110.0, "neighbour_1_zeta": 0.05,
             "neighbour_1_share": 0.8}  # fmt: skip
    theta = {name: jnp.asarray(value) for name, value in theta.items()}
    omega, y, phase, load = (jnp.array([[x]]) for x in (100.0, 2e-3, -1.2, 3.0))
    data = SimpleNamespace(
        residuals="auto", unit_of_source="N", is_locked=True, omega=omega, load=load
    )
    size, angle = ControlledPoints._of_joint(data, theta, y, phase)
    neighbour = 0.8 * 0.5 * 3.0 / (110.0**2 - 100.0**2 + 2j * 0.05 * 110.0 * 100.0)
    own = 2e-3 * np.exp(-1.2j) - neighbour
    assert size.item() == pytest.approx(abs(own), rel=1e-12)
    assert angle.item() == pytest.approx(np.angle(own), rel=1e-12)


def test_a_frequency_has_its_own_noise_and_what_goes_with_the_force():
    """Errors s_i n_i of its own, beside m s_F n_F of the force, over the noise n_i of the group."""
    data = SimpleNamespace(
        _force_of_test=np.array([0, 0]),
        scale=np.array([[2.0], [3.0]]), mixed=np.array([[0.0], [0.4]]),
        groups=SimpleNamespace(noise_std=np.array([0.5, 0.1])),
    )  # fmt: skip
    own, with_force = 3.0 * 0.1, 0.4 * 2.0 * 0.5
    found = ControlledPoints.spread(data, 1)
    assert found * 0.1 == pytest.approx([np.hypot(own, with_force)], rel=1e-14)


def test_a_frequency_s_size_is_the_half_width_of_its_resonance():
    """The damping ratio g F / (2 w^2 Y) times the frequency w / 2 pi."""
    omega, y, load = (np.array([[x]]) for x in (120.0, 1e-3, 0.6))
    data = SimpleNamespace(
        groups=SimpleNamespace(reference=[1.0]),
        rows=(SimpleNamespace(quantity="frequency", test=0),),
        unit_of_source="N", omega=omega, amplitude=y, load=load,
    )  # fmt: skip
    zeta = 0.5 * 0.6 / (2 * 120.0**2 * 1e-3)
    found = ControlledPoints._sizes(data, {"gain": 0.5})
    assert np.asarray(found) == pytest.approx([zeta * 120.0 / (2 * np.pi)], rel=1e-12)
