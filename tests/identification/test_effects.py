"""What a joint does to frequency and damping, against the closed form of a weakly open loop."""

import numpy as np
import pytest
import xarray as xr

from jbw.identification.effects import effects, effects_sentence

OMEGA_N, ZETA, ALPHA, DELTA, GAMMA = 500.0, 0.01, 5e4, 3.0, 2.0


def posterior(**changes):
    theta = {"omega_n": OMEGA_N, "zeta": ZETA, "alpha": ALPHA, "delta": DELTA, "gamma": GAMMA}
    dims = ("chain", "draw")
    return xr.Dataset({n: (dims, np.full((2, 5), v)) for n, v in {**theta, **changes}.items()})


def test_a_weak_joint_softens_and_dissipates_as_its_rate_says():
    # dz/dy = alpha - (gamma + delta sign) z, to first order in delta Y and gamma Y: the loop's
    # energy is 4/3 alpha gamma Y^3, its first harmonic loses 8/(3 pi) alpha delta Y^2 / 2.
    y = 1e-3
    found = effects(posterior(), {}, y)
    assert found is not None
    zeta_added = 4 / 3 * ALPHA * GAMMA * y**3 / (2 * np.pi * OMEGA_N**2 * y**2)
    softening = ALPHA * DELTA * y * 4 / (3 * np.pi) / OMEGA_N**2 / 2
    # Second order: (delta + gamma) Y = 0.5 %.
    np.testing.assert_allclose(found.damping, zeta_added / ZETA, rtol=0.02)
    np.testing.assert_allclose(found.frequency, -softening, rtol=0.02)
    assert effects_sentence(found, y).startswith("At 0.001 m, the largest displacement fitted")


def test_held_parameters_count_and_no_damping_has_no_share():
    one = effects(posterior().drop_vars("zeta"), {"zeta": 2 * ZETA}, 1e-3)
    both = effects(posterior(), {}, 1e-3)
    assert one is not None
    assert both is not None
    np.testing.assert_allclose(one.damping, both.damping / 2, rtol=1e-12)
    assert effects(posterior().drop_vars("zeta"), {"zeta": 0.0}, 1e-3) is None


@pytest.mark.parametrize("y", [1e-4, 1e-2])
def test_effects_grow_with_the_amplitude(y):
    small, large = (effects(posterior(), {}, size) for size in (y, 2 * y))
    assert small is not None
    assert large is not None
    assert np.all(large.damping > small.damping)
    assert np.all(large.frequency < small.frequency)
