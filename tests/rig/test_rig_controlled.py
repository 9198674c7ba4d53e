"""The rig's controlled tests: a linear joint in closed form, errors, and files read back."""

from dataclasses import replace

import numpy as np
import pytest

from jbw import BoucWen, rig
from jbw.campaign.load import load_campaign
from jbw.rig import prescribed_motion
from jbw.rig.prescribed_motion import held_points, locked_points

LEVELS = (3e-4, 1e-3, 3e-3)
# Of a joint that hardly slips: a linear oscillator, in closed form.
LINEAR = BoucWen(rig.TRUTH.omega_n, rig.TRUTH.zeta, 497.4, 1e-6, 1e-7)


def measured(excitation, kind="backbone", repeats=1, **options):
    preset = replace(rig.CONTROLLED, plans=(rig.Plan("points", kind, excitation, repeats),))
    return rig.measure(preset, **options)


@pytest.mark.parametrize("degrees", [-90.0, -60.0, -120.0])
def test_locked_points_of_a_linear_joint(degrees):
    phase = np.full(3, np.radians(degrees))
    frequency, force = locked_points(LINEAR, rig.Locked(LEVELS), phase)
    omega, y = 2 * np.pi * frequency, np.array(LEVELS)
    n, z = LINEAR.omega_n, LINEAR.zeta
    response = 1 / (n**2 - omega**2 + 2j * z * n * omega)
    np.testing.assert_allclose(np.angle(response), phase, rtol=1e-6)
    np.testing.assert_allclose(force * np.abs(response), y, rtol=1e-6)


def test_the_exciters_third_harmonic_moves_the_joint_a_little():
    """Far above its resonance: a hundredth of the force moves it by 1e-2 F / (8 omega^2)."""
    points = rig.s_curve(18.5, LEVELS)
    plain, distorted = (held_points(rig.TRUTH, points, d) for d in (0.0, 1e-2))
    change = np.abs(distorted / plain - 1)
    assert np.all((change > 1e-9) & (change < 1e-4))
    np.testing.assert_allclose(held_points(LINEAR, points, 1e-2), held_points(LINEAR, points))


def test_a_controller_holds_its_phase_as_well_as_it_says(monkeypatch):
    """Three thousand points in closed form: the deviation of their phase to 4 standard errors.

    What force that takes is nothing of the phase: it is sought coarsely.
    """
    for name, count in (("ROUNDS", 1), ("PERIODS", 2), ("RISE", 1), ("POINTS", 32)):
        monkeypatch.setattr(prescribed_motion, name, count)
    locked = rig.Locked((1e-3,) * 3000, phase_error=0.5, amplitude_noise=1e-5)
    phase = np.degrees(measured(locked).tests[0].records[0].channels["phase"])
    assert phase.mean() == pytest.approx(-90.0, abs=4 * 0.5 / np.sqrt(3000))
    assert phase.std() == pytest.approx(0.5, rel=4 / np.sqrt(6000))


def test_they_are_written_and_read_back(tmp_path):
    preset = replace(
        rig.CONTROLLED,
        plans=(
            rig.Plan("phase_60", "backbone", rig.Locked(LEVELS, phase=-60.0), 2),
            rig.Plan("s_curve", "curve", rig.s_curve(18.5, LEVELS), 2),
        ),
    )
    campaign = rig.measure(preset, seed=3)
    path = rig.write(campaign, tmp_path / "rig")
    loaded = load_campaign(path)
    for test, loaded_test in zip(campaign.tests, loaded.tests, strict=True):
        assert (loaded_test.kind, loaded_test.locked_phase) == (test.kind, test.locked_phase)
        assert loaded_test.amplitude_std == test.amplitude_std > 0
        for record, other in zip(test.records, loaded_test.records, strict=True):
            for role, values in record.channels.items():
                np.testing.assert_array_equal(other.channels[role], values)
