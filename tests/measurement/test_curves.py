"""Response curves and forced loops read off records."""

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.curves import displacement_of, forced_loop, response_curve
from jbw.measurement.records import Record

FREQ = np.linspace(79.0, 81.0, 41)
OMEGA = 2 * np.pi * FREQ


def accelerance(mass=1.9, f_n=80.1, zeta=2e-3):
    """Acceleration per force of one mode, in closed form."""
    omega_n = 2 * np.pi * f_n
    return -(OMEGA**2) / mass / (omega_n**2 - OMEGA**2 + 2j * zeta * omega_n * OMEGA)


def test_curve_of_a_mode_under_response_control():
    h = accelerance()
    force = 5.0 / np.abs(h)  # the controller holds 5 m/s^2
    channels = {
        "frequency": FREQ,
        "force": force,
        "acceleration": np.full(41, 5.0),
        "phase": np.angle(h),
    }
    units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
    curve = response_curve(Record(float("nan"), channels, units, "level 5", {"sha256": "x"}))
    np.testing.assert_allclose(curve.response / curve.source, h, rtol=1e-14)
    np.testing.assert_allclose(
        displacement_of(curve) / curve.source, h / (1j * OMEGA) ** 2, rtol=1e-13
    )
    assert (curve.source_kind, curve.response_kind) == ("force", "acceleration")


@pytest.mark.parametrize("role", ["restoring_force", "force"])
def test_loop_of_a_record(role):
    y, f = np.sin(OMEGA), np.cos(OMEGA)
    loop = forced_loop(Record(1024.0, {"displacement": y, role: f}, {}, "a"))
    np.testing.assert_array_equal(loop.displacement, y)
    np.testing.assert_array_equal(loop.force, f)
    assert loop.fs == 1024.0


def test_missing_channel_is_named():
    record = Record(1024.0, {"displacement": FREQ}, {}, "a.npz")
    with pytest.raises(DataError, match=r"a\.npz: a forced loop needs a channel `restoring_force"):
        forced_loop(record)
    with pytest.raises(DataError, match="needs a channel `frequency`, but the record has disp"):
        response_curve(record)
