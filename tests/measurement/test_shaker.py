"""A shaker's attachment: a made one given back, its errors, and an F-16's by measured records."""

from dataclasses import asdict

import measured_data
import numpy as np
import pytest

from jbw.errors import DataError
from jbw.identification.modal import fit_modes
from jbw.measurement.shaker import NAMES, fit_attachment
from jbw.measurement.transients import record_frf
from jbw.oscillator.attachment import Attachment, attached

FS, NUM, BAND = 256.0, 256 * 64, (5.0, 60.0)
TRUTH = {"gain": -440.0, "delay": 2e-4, "mass": 0.3, "damping": 25.0, "stiffness": 6e3}
DATA = measured_data.DATA / "f16_gvt_sinesweep"


def driven(rng, noise=0.0, order=2):
    """Voltage, force and motion of two modes with an attachment, by whole periods of noise."""
    jw = 2j * np.pi * np.fft.rfftfreq(NUM, 1 / FS)
    v = np.fft.rfft(rng.standard_normal(NUM))
    modes = [(118.0, 0.01, 0.9), (200.0, 0.01, 0.6)]
    receptance = sum(p**2 / (w**2 + jw**2 + 2 * z * w * jw) for w, z, p in modes)
    dynamic = TRUTH["stiffness"] + jw * TRUTH["damping"] + jw**2 * TRUTH["mass"]
    force = TRUTH["gain"] * (1 - jw * TRUTH["delay"]) * v / (1 + dynamic * receptance)
    signals = (np.fft.irfft(one, NUM) for one in (v, force, jw**order * receptance * force))
    voltage, given, moved = signals
    return voltage, given + noise * np.std(given) * rng.standard_normal(NUM), moved


@pytest.mark.parametrize(
    ("order", "kind"), [*enumerate(["displacement", "velocity", "acceleration"])]
)
def test_a_made_shaker_is_given_back(order, kind):
    records = driven(np.random.default_rng(1), order=order)
    found = fit_attachment(*records, FS, BAND, kind=kind)
    # Round-off over five columns, the stiffness' share of the force the smallest.
    for name, value in TRUTH.items():
        assert asdict(found)[name] == pytest.approx(value, rel=1e-8)
    assert found.leftover < 1e-10
    assert found.leftover_gain > 0.1


def test_errors_are_those_of_many_records():
    rng, z = np.random.default_rng(2), []
    for _ in range(60):
        found = fit_attachment(*driven(rng, noise=0.1), FS, BAND)
        z.append([(asdict(found)[n] - TRUTH[n]) / s for n, s in zip(NAMES, found.std, strict=True)])
    # 60 records: the deviation of z is known to 9 %, its mean to 0.13.
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.5)
    assert np.all((np.std(z, axis=0) > 0.7) & (np.std(z, axis=0) < 1.3))


def test_bad_input_is_named():
    voltage, force, moved = driven(np.random.default_rng(3))
    with pytest.raises(DataError, match="`voltage` is constant"):
        fit_attachment(0 * voltage, force, moved, FS, BAND)
    with pytest.raises(DataError, match="must contain 3 lines or more for 5 unknowns"):
        fit_attachment(voltage, force, moved, FS, (10.0, 10.02))
    with pytest.raises(DataError, match="`force`"):
        fit_attachment(voltage, force * np.nan, moved, FS, BAND)


def test_the_voltage_driven_modes_of_a_wing_are_predicted():
    path = DATA / "F16Data_SineSw_Level1.npz"
    if not path.is_file():
        pytest.skip(f"{path.name} is not in {DATA}; set JBW_DATA to the folder of the data")
    with np.load(path) as held:
        force, voltage, acceleration = (
            np.asarray(held[name], float) for name in ("Force", "Voltage", "Acceleration")
        )
        fs = float(held["Fs"].ravel()[0])
    force, voltage = force.ravel(), voltage.ravel()
    shaker = fit_attachment(voltage, force, acceleration[0], fs, (3.0, 11.0))
    # Fitted elsewhere, over the same band: 442 N/V, -2.9 kg, 34 N s/m, 6055 N/m, 3.9 to 5.9 % left.
    expected = [442, -2.9, 34, 6055]
    found = [abs(shaker.gain), shaker.mass, shaker.damping, shaker.stiffness]
    np.testing.assert_allclose(found, expected, rtol=0.03)
    assert 0.039 < shaker.leftover < 0.06
    assert 0.11 < shaker.leftover_gain < 0.17
    added = Attachment(shaker.mass, shaker.damping, shaker.stiffness)
    by_force, by_voltage = (
        fit_modes(
            [record_frf(u, one, fs, (6.0, 8.0), response="acceleration") for one in acceleration],
            [6.7, 7.3], (6.0, 8.0),
        )
        for u in (force, voltage)
    )  # fmt: skip
    # The residue at the drive point, per newton, is the shape's square there.
    shape = np.sqrt(by_force.residues[:, 0])
    assert shape[1] ** 2 == pytest.approx(1.69e-3, rel=0.03)
    omega, _ = attached(by_force.omega, by_force.zeta, shape, added)
    np.testing.assert_allclose(omega, by_voltage.omega, rtol=2e-3)
    # Of oscillators with a Bouc-Wen joint, fitted elsewhere to all levels: by the force 7.359 Hz
    # and 0.083 %, by the voltage 7.394 Hz and 0.140 %. (The damping of the linear fits above is the
    # joint's own at this level, and no measure of the shaker's.)
    alone, damped = attached([2 * np.pi * 7.359], [0.083e-2], shape[1:], added)
    assert alone[0] / (2 * np.pi) == pytest.approx(7.394, rel=2e-3)
    assert damped[0] == pytest.approx(0.140e-2, rel=0.15)
