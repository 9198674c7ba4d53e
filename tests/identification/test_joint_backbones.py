"""Modes of a structure with two bolts at an amplitude, by draws that all are the truth."""

from types import SimpleNamespace

import numpy as np
import pytest
import two_bolts
import xarray as xr
from sustained import sustained

import jbw
from jbw.identification.assemble import assemble, measured_in
from jbw.identification.joint_answers import (
    _is_known,
    backbones_group,
    joints_finding,
    joints_group,
    joints_words,
)
from jbw.identification.joint_modes import LEVELS, ModeNumbers, _with_free_shape, joint_modes

CHOSEN = [1, 3, 7]  # a quarter, half and all of the largest amplitude


def posterior_of(theta):
    """Draws of a posterior without a width."""
    return xr.Dataset({name: (("chain", "draw"), np.full((1, 3), x)) for name, x in theta.items()})


@pytest.fixture(scope="module")
def data():
    return assemble(measured_in(two_bolts.campaign(), lambda _: None))


@pytest.fixture(scope="module")
def modes(data):
    found = joint_modes(posterior_of(two_bolts.truth()), data)
    assert found is not None
    assert found.is_free.all()
    return found


@pytest.fixture(scope="module")
def exact(modes):
    """The first mode by scipy at `CHOSEN`."""
    model = two_bolts.reduced(two_bolts.BOLTS)
    return sustained(model, two_bolts.BOLTS, modes.amplitude[0, CHOSEN], 0)


@pytest.mark.slow
def test_the_medians_have_the_backbone_of_the_truth_and_so_have_bands_without_a_width(data, modes):
    group = backbones_group(data, modes)
    structure = two_bolts.reduced(two_bolts.BOLTS).structure()
    for i in range(2):
        of_mode = group.isel(mode=i)
        amplitude = of_mode["displacement"].values / abs(np.ravel(structure.c)[i])
        np.testing.assert_allclose(amplitude / amplitude[-1], LEVELS)
        exact = jbw.backbone(structure, amplitude, mode=i, num_harmonics=3)
        hz = np.asarray(exact.omega) / (2 * np.pi)
        np.testing.assert_allclose(of_mode["frequency_at_medians"], hz, rtol=1e-9)
        np.testing.assert_allclose(of_mode["damping_at_medians"], exact.zeta, rtol=1e-7)
        shapes = np.abs(exact.shape)[:, :2]
        np.testing.assert_allclose(of_mode["shape"], shapes, rtol=1e-5, atol=1e-9)
        for band, curve in (("frequency_hz", hz), ("damping", exact.zeta)):
            for end in of_mode[band].values.T:
                np.testing.assert_allclose(end, curve, rtol=1e-7)


@pytest.mark.release  # bands are by scipy below
def test_a_mode_at_an_amplitude_is_what_scipy_has_by_an_error_that_falls_with_its_square(
    modes, exact
):
    """Remainders over the stiffness, and so the change of shape, are of the order of a.

    What harmonics beyond the fifth, or the shape of full stick, leave out of frequency and damping
    is such a change times another: of the order of a squared.
    """
    square = LEVELS[CHOSEN] ** 2
    omega, zeta = (np.array([getattr(x, name) for x in exact]) for name in ("omega", "zeta"))
    free_omega, free_zeta = modes.free.omega[0, CHOSEN, 0], modes.free.zeta[0, CHOSEN, 0]
    assert np.all(np.abs(free_omega / omega - 1) < 1e-4 * square)
    assert np.all(np.abs(free_zeta / zeta - 1) < 1e-2 * square)
    stuck = modes.at_medians
    # Rayleigh's quotient of another shape than its own is above the first mode's.
    above, below = stuck.omega[0, CHOSEN] / omega - 1, 1 - stuck.zeta[0, CHOSEN] / zeta
    assert np.all((above > 0) & (above < 0.02 * square))
    assert np.all((below > 0) & (below < square))


@pytest.mark.slow
def test_joints_do_to_a_mode_what_scipy_has_in_the_shape_that_they_leave_it(data, modes, exact):
    """Three harmonics leave out 0.9 % of the added damping and 0.1 % of the change of frequency."""
    group = joints_group(posterior_of(two_bolts.truth()), data, modes)
    first, by_scipy = group.sel(mode=1, quantile=0.5), exact[-1]
    added = float(np.sum(by_scipy.damping))
    change = by_scipy.omega / two_bolts.truth()["omega_n"] - 1
    assert float(first["damping_added"]) == pytest.approx(added, rel=0.015)
    assert float(first["frequency_change"]) == pytest.approx(change, rel=3e-3)
    np.testing.assert_allclose(first["loss_share"], by_scipy.damping / added, atol=5e-3)
    np.testing.assert_allclose(first["energy_share_at_motion"], by_scipy.energy, atol=2e-3)
    # The shape of full stick has three quarters of the losses: 1.3 % of damping for 1.85 %.
    assert modes.at_medians.added[0, -1] < 0.8 * added
    assert bool(first["shape_is_free"])
    assert "with the mode shape at this motion" in joints_words(group)[0]


@pytest.mark.slow
def test_draws_have_the_free_shape_of_their_own_parameters(data):
    """Draws as wide as of tests with 1 % of noise, against the periodic motion of three of them.

    Frequencies are known far better than the rest. So they must be: near full slip the modes' shape
    hangs on what little stiffness the joints leave.
    """
    rng, truth = np.random.default_rng(1), two_bolts.truth()
    width = {n: 2e-4 if n.startswith("omega") else 5e-3 for n in truth}
    draws = {n: x * np.exp(width[n] * rng.standard_normal((1, 400))) for n, x in truth.items()}
    posterior = xr.Dataset({name: (("chain", "draw"), x) for name, x in draws.items()})
    found = joint_modes(posterior, data)
    assert found is not None
    for i in (1, 2, 399):
        bolts = [
            tuple(draws[f"{name}@{label}"][0, i] for name in ("alpha", "delta", "gamma"))
            for label in two_bolts.LABELS
        ]
        structure = two_bolts.reduced(bolts).structure()
        omega = np.array(structure.omega_n)
        zeta = np.array(structure.zeta)
        omega[:2] = draws["omega_n"][0, i], draws["omega_2"][0, i]
        zeta[:2] = draws["zeta"][0, i], draws["zeta_2"][0, i]
        own = jbw.Structure(
            omega, zeta, structure.h, structure.p, structure.b, structure.c, structure.laws
        )
        curve = jbw.backbone(own, found.amplitude[0], mode=0, num_harmonics=3)
        # Linear in the logarithms: what is left is of second order, and grows with the slip.
        np.testing.assert_allclose(found.free.omega[0, :, i], curve.omega, rtol=3e-4)
        np.testing.assert_allclose(found.free.zeta[0, :, i], curve.zeta, rtol=3e-3)


def test_losses_of_all_joints_add_the_ratio_of_a_viscous_damper():
    """A damper c has the loss c omega, and the ratio c / (2 omega): over two joints."""
    omega = np.full((1, 1), 200.0)
    losses = np.array([0.3, 0.7])[:, None, None] * 4.0 * omega
    numbers = ModeNumbers(omega, 0.0 * omega, losses, losses, losses)
    assert numbers.added == pytest.approx(4.0 / (2 * 200.0), rel=1e-14)


def test_a_third_harmonic_loses_three_times_as_often_in_a_cycle():
    """By the definitions: of force r and motion x the loss is sum n Im r conj(x), over the mass."""
    q = np.zeros((1, 1, 2), complex)  # level mode harmonic
    q[..., 0] = 2.0
    x, r = np.array([[[1.0, 0.5j]]]), np.array([[[0.2j, 0.3]]])
    one = SimpleNamespace(omega=np.array([10.0]), zeta=np.zeros(1), q=q, x=x, r=r)
    numbers = _with_free_shape([one], np.array([5.0]))
    assert numbers.losses.item() == pytest.approx((0.2 - 3 * 0.3 * 0.5) / 4.0, rel=1e-14)
    assert numbers.softening.item() == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize(("spread", "known"), [(1.5, True), (3.0, False)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_share_is_identified_within_a_factor_of_two(spread, known, sign):
    draws = sign * np.geomspace(1.0, spread, 2001)
    assert _is_known(draws) == known


def test_joints_that_are_not_identified_are_named_in_a_finding():
    names = ["bolt_1", "bolt_2"]
    for are_known, status in (([True, True], "ok"), ([False, False], "usable")):
        group = xr.Dataset({"identified": ("joint", are_known)}, {"joint": names})
        finding = joints_finding(group)
        assert finding is not None
        assert finding.status == status
    assert "bolt_1, bolt_2" in finding.reason


def test_a_structure_of_one_joint_has_none():
    class OneJoint:
        modes = None

    assert joint_modes(xr.Dataset(), OneJoint()) is None
