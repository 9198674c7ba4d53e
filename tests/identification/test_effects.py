"""What a joint does to frequency and damping, against the closed form of a weakly open loop."""

import numpy as np
import pytest
import xarray as xr

from jbw.identification.equivalent import effects, effects_sentence, response_finding

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
    assert effects_sentence(found, y).startswith("At 1 mm, the largest fitted displacement")


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


def drawn(seed, **changes):
    """Independent draws, 1 % about the joint."""
    rng = np.random.default_rng(seed)
    return {
        name: (("chain", "draw"), values.values * (1 + 0.01 * rng.normal(size=(4, 500))))
        for name, values in posterior().isel(chain=0, draw=0, drop=True).items()
    } | changes


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_chains_that_agree_on_the_response_are_ok(seed):
    found = response_finding(xr.Dataset(drawn(seed)), {}, 1e-3)
    assert found is not None
    assert (found.code, found.status) == ("response_bands", "ok")


def test_chains_that_disagree_on_the_damping_fail():
    draws = xr.Dataset(drawn(0))
    draws["gamma"][0] *= 1.5
    found = response_finding(draws, {}, 1e-3)
    assert found is not None
    assert found.status == "failed"
    assert "damping at 0.001 m" in found.reason


def test_a_ridge_that_the_response_does_not_see_is_no_fault_of_its_bands():
    # Chains anywhere along a constant alpha*delta and alpha*gamma: the parameters do not mix, the
    # response, to first order in (delta + gamma) Y, is the same.
    draws = xr.Dataset(drawn(0))
    for chain, factor in enumerate((0.5, 0.8, 1.25, 2.0)):
        draws["alpha"][chain] *= factor
        draws["delta"][chain] /= factor
        draws["gamma"][chain] /= factor
    found = response_finding(draws, {}, 1e-5)
    assert found is not None
    assert found.status == "ok"


def test_without_motion_there_is_no_response():
    assert response_finding(posterior(), {}, 0.0) is None
    assert response_finding(posterior().drop_vars("alpha"), {}, 1e-3) is None
