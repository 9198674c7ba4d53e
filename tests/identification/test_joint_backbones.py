"""Backbones of the modes of a structure with two bolts, by draws that all are the truth."""

import numpy as np
import pytest
import two_bolts
import xarray as xr

import jbw
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.joint_answers import BACKBONE_LEVELS, backbones_group


def posterior_of(theta):
    """Draws of a posterior without a width."""
    return xr.Dataset({name: (("chain", "draw"), np.full((1, 3), x)) for name, x in theta.items()})


@pytest.mark.slow
def test_the_medians_have_the_backbone_of_the_truth_and_bands_lie_about_it():
    data = assemble(measured_in(two_bolts.campaign(), lambda _: None))
    group = backbones_group(posterior_of(two_bolts.truth()), data)
    assert group is not None
    structure = two_bolts.reduced(two_bolts.BOLTS).structure()
    for i in range(2):
        of_mode = group.isel(mode=i)
        amplitude = of_mode["displacement"].values / abs(np.ravel(structure.c)[i])
        np.testing.assert_allclose(amplitude / amplitude[-1], BACKBONE_LEVELS)
        exact = jbw.backbone(structure, amplitude, mode=i, num_harmonics=3)
        hz = np.asarray(exact.omega) / (2 * np.pi)
        np.testing.assert_allclose(of_mode["frequency_at_medians"], hz, rtol=1e-9)
        np.testing.assert_allclose(of_mode["damping_at_medians"], exact.zeta, rtol=1e-7)
        shapes = np.abs(exact.shape)[:, :2]
        np.testing.assert_allclose(of_mode["shape"], shapes, rtol=1e-5, atol=1e-9)
        low, middle, high = of_mode["frequency_hz"].values.T
        np.testing.assert_array_equal(low, high)
        if i == 0:  # Rayleigh's quotient of another shape than its own is above the first mode's
            assert np.all(middle > hz)


def test_a_structure_of_one_joint_has_none():
    class OneJoint:
        modes = None

    assert backbones_group(xr.Dataset(), OneJoint()) is None
