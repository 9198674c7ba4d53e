"""Identification of the mass, damping and stiffness that a shaker adds to a structure."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jbw.errors import DataError
from jbw.identification.modal import ModalFit, fit_modes
from jbw.measurement.records import Record, Test, steady
from jbw.measurement.shaker import ShakerFit, fit_attachment
from jbw.measurement.spectra import frf
from jbw.measurement.transients import record_frf
from jbw.oscillator.attachment import Attachment, attached
from jbw.report.messages import instruments as messages

ROLES = ("input", "force", "drive_point")
# The band is extended on each side by this multiple of its width, because only a wide band
# separates mass, stiffness, delay and damping.
WIDER = 1.5
OCTAVE = 2.0
# A spectral line is not driven if it is below this fraction of the voltage's largest line.
DRIVEN = 0.05


@dataclass(frozen=True)
class ShakerReading:
    """The identified shaker of a test, with the modes in its band with and without the shaker."""

    shaker: ShakerFit
    modes: ModalFit  # modes without the shaker, from the FRF of force to drive point
    omega: Float[np.ndarray, " mode"]  # predicted frequencies with the shaker [rad/s]
    zeta: Float[np.ndarray, " mode"]


def tells_shaker(test: Test) -> bool:
    """Return whether a test has the voltage, force and drive point that identify its shaker."""
    return bool(test.records) and set(ROLES) <= set(test.records[0].channels)


def read_shaker(test: Test, modes: int = 1) -> ShakerReading:
    """Identify the shaker from a test's first record, and predict the modes with it.

    The test's band contains the modes. For the attachment, the band is extended on either side by
    three halves of its width, at most an octave, where the voltage drives it. The record counts
    from `settle` on.

    Raises:
        DataError: There is no band, `settle` leaves no record, or the drive point moves against the
            force in a mode.
    """
    if test.band_hz is None:
        raise DataError(
            f"Test {test.name} must have a `band`, so that its shaker can be identified, but has "
            "none.",
            remedy=f"State in test {test.name} a `band` that contains the modes.",
        )
    periodic = steady(test)
    record = _after(test.records[0], test.settle) if periodic is None else periodic[0].records[0]
    voltage, force, moved = (record.channels[role] for role in ROLES)
    if test.traits.is_broadband and periodic is None:
        voltage, force, moved = map(_faded, (voltage, force, moved))
    wide = _driven(voltage, record.fs, test.band_hz)
    shaker = fit_attachment(voltage, force, moved, record.fs, wide)
    size = None if periodic is None else periodic[1]
    fit = _modes(test, record, size, test.band_hz, modes)
    squares = fit.residues[:, 0]  # squared mode shape at the drive point
    if np.any(squares <= 0):
        raise DataError(
            f"Test {test.name} must show a drive point that moves with the force, but at "
            f"{fit.omega[np.argmin(squares)] / (2 * np.pi):.4g} Hz the drive point moves against "
            "the force.",
            remedy="Check the polarity and the positions of the sensors of `force` and "
            "`drive_point`.",
        )
    added = Attachment(shaker.mass, shaker.damping, shaker.stiffness)
    omega, zeta = attached(fit.omega, fit.zeta, np.sqrt(squares), added)
    return ShakerReading(shaker, fit, omega, zeta)


def _after(record: Record, settle: float) -> Record:
    """Return a record without its initial settling time."""
    start = round(settle * record.fs)
    if start >= record.num_samples:
        raise DataError(
            f"Key `settle` must leave a part of the record, but {settle:g} s is all of it.",
            remedy="Shorten `settle`.",
        )
    return replace(record, channels={role: x[start:] for role, x in record.channels.items()})


def _faded(motion: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """Return a record multiplied by a Hann window, because it begins and ends in motion.

    The relations between voltage, force and motion change little within a spectral line, so the
    window changes all of them alike. Without the window, each would leak separately.
    """
    return np.hanning(len(motion)) * (motion - motion.mean())


def _modes(
    test: Test, record: Record, size: int | None, band: tuple[float, float], modes: int
) -> ModalFit:
    """Fit the modes of a band to the FRF from the force to the drive point."""
    force, moved = record.channels["force"], record.channels["drive_point"]
    if test.traits.is_broadband:
        window = "hann" if size is None else "boxcar"
        how = {"response": "acceleration", "window": window, "nperseg": size}
        return fit_modes(frf(force, moved, record.fs, **how), modes, band)
    estimate = record_frf(force, moved, record.fs, band, response="acceleration")
    return fit_modes(estimate, modes, band)


def _driven(
    voltage: Float[np.ndarray, " time"], fs: float, band: tuple[float, float]
) -> tuple[float, float]:
    """Return the band, widened by 1.5 times its width on each side, but only where voltage acts.

    The band is widened by at most an octave, because noise of a sensor at low frequencies is a
    large displacement.
    """
    reach = WIDER * (band[1] - band[0])
    freq = np.fft.rfftfreq(len(voltage), 1 / fs)
    size = np.abs(np.fft.rfft(voltage - voltage.mean()))  # This removes the offset of an amplifier.
    driven = freq[size > DRIVEN * size.max()]
    if not len(driven):  # A constant channel drives nothing; the fit reports this.
        return band
    low = max(band[0] - reach, band[0] / OCTAVE, driven[0])
    high = min(band[1] + reach, band[1] * OCTAVE, driven[-1])
    return float(min(low, band[0])), float(max(high, band[1]))


def shaker_sentence(name: str, found: ShakerReading) -> str:
    """Return the sentence on the shaker identified from a test."""
    shaker, turn = found.shaker, 2 * np.pi
    moved = ", ".join(
        messages.mode_moves((w / turn, z), (v / turn, y))
        for w, z, v, y in zip(
            found.modes.omega, found.modes.zeta, found.omega, found.zeta, strict=True
        )
    )
    attachment = shaker.mass, shaker.damping, shaker.stiffness
    residual = shaker.leftover, shaker.leftover_gain
    return messages.shaker_reading(name, shaker.gain, attachment, residual, moved)
