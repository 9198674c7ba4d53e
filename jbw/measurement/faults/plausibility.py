"""Checks whether a driven record can be what its campaign file states.

If input and response are exchanged, the input has the resonance.
"""

import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals, lines_within
from jbw.measurement.faults.clipping import offset
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import Cause, Misfit, stiffness
from jbw.measurement.faults.unlike_gains import turned_over
from jbw.measurement.records import INPUTS, Record
from jbw.measurement.spectra import FRF, frf, half_power_bandwidth, stands_out
from jbw.report.messages import gain_faults as gain_messages
from jbw.report.messages import record_faults as messages
from jbw.report.messages import response_faults

# number of samples that are examined; the faults of a stationary record show in them
LOOKED_AT = 2**21
LONGEST = 4  # number of segments for the finest resolution of the resonance
CLEAR = 4.0  # A peak in the band is a resonance if it exceeds the band's median by this factor.
RESOLVED = 1.5  # smallest width 2 zeta f_n of a resolved peak, in window widths 1 / T
LOW_COHERENCE = 0.5  # smallest median coherence of the lines with response
MASS_FACTOR = 3.0  # largest factor between estimated and stated modal mass; more means a wrong unit
SEGMENTS = 8  # number of segments: few, but enough for a resonance to stand out of the spectra
FLOOR = 1e-4  # Lines below this fraction of the largest density are outside the excitation.
# An input whose spectrum is more peaked than the response's by this factor looks like a response.
PEAKED = 10.0
# A record that should start from rest moves if it begins above this fraction of its usual
# amplitude.
MOVING = 0.3
# smallest fraction of the first period's power that a single tone must explain; wide-band noise
# stays below this fraction
COHERENT = 0.8


def doubts(
    record: Record,
    band_hz: tuple[float, float] | None,
    delay: float,
    per_unit: float | None,
    *,
    signed: bool = True,
) -> Iterator[Fault]:
    """Yield warnings on a noise or multisine record: fs, band, channels, length, size, sign.

    Args:
        record: The record.
        band_hz: Stated band [Hz]; None for all lines.
        delay: Stated lag of the response [s].
        per_unit: Force per modal mass for one unit of the input: a gain [N/kg/V] or 1/m [1/kg].
        signed: Whether the sign of the gain is checked; a lag changes it.
    """
    if not any(role in record.channels for role in INPUTS):
        return
    try:
        coarse, fine = (_frf(record, n, delay) for n in (SEGMENTS, LONGEST))
    except DataError as error:  # The record has only a few samples.
        yield doubt(record.response, error.what, error.why, error.remedy)
        return
    # With one of these two faults, the FRF's magnitude and width mean nothing.
    broken = [*peaked_input(record.source, coarse), *_incoherent(record.response, coarse)]
    if broken:
        yield broken[0]
        return
    yield from _outside_band(record.response, coarse, band_hz)
    lines = carried(fine) & lines_within(fine.freq, band_hz or (0.0, np.inf))
    freq, h = fine.freq[lines], fine.h[lines]
    if len(freq) >= SEGMENTS and stands_out(h):
        yield from _unresolved(record, fine.resolution_hz, freq, h)
        yield from _missized(record.response, freq, h, signed and band_hz is not None, per_unit)


def swapped(record: Record) -> Iterator[Fault]:
    """Yield a warning if input and response of a sweep are exchanged."""
    try:
        estimate = _frf(record, SEGMENTS, 0.0)
    # Nothing can be compared, because the record is too short or lacks input at some frequencies.
    except DataError:
        return
    yield from peaked_input(record.source, estimate)


def already_moving(record: Record, band: Sequence[float] | None, settle: float) -> Iterator[Fault]:
    """Yield a warning if a record that should start from rest moves in its first period."""
    x, fs = record.channels[record.response], record.fs
    if constant := list(offset(record)):
        yield from constant
        return
    # Pad with zeros, because the filter would otherwise mix the end with the start.
    x = np.concatenate([x, np.zeros_like(x)])
    freq, spectrum = np.fft.rfftfreq(len(x), 1 / fs), np.fft.rfft(x)
    spectrum[~lines_within(freq, band or (0.0, fs)) | (freq == 0)] = 0
    x = np.fft.irfft(spectrum, len(x))[: len(x) // 2]
    phase = 2 * np.pi * freq[np.argmax(np.abs(spectrum))] / fs * np.arange(len(x))
    first = max(int(np.searchsorted(phase, 2 * np.pi)), 8)
    basis = np.stack([np.cos(phase[:first]), np.sin(phase[:first])], axis=-1)
    tone = np.linalg.lstsq(basis, x[:first])[0]
    size, usual = float(np.hypot(*tone)), float(np.sqrt(2.0) * np.std(x))
    is_tone = np.sum((basis @ tone) ** 2) > COHERENT * np.sum(x[:first] ** 2)
    if settle == 0.0 and is_tone and size > MOVING * usual:
        yield doubt(record.response, *response_faults.already_moving(size / usual))


def _frf(record: Record, segments: int, delay: float) -> FRF:
    u, y = (record.channels[role][:LOOKED_AT] for role in (record.source, record.response))
    nperseg = len(u) // segments
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Other checks report what `frf` warns of.
        return frf(u, y, record.fs, response=record.response, nperseg=nperseg, delay=delay)


def _incoherent(role: str, estimate: FRF) -> Iterator[Fault]:
    lines = carried(estimate)
    coherence = float(np.median(estimate.coherence[lines])) if lines.any() else 1.0
    if coherence < LOW_COHERENCE:
        yield doubt(role, *messages.incoherent(coherence))


def _outside_band(role: str, estimate: FRF, band_hz: tuple[float, float] | None) -> Iterator[Fault]:
    freq, density = estimate.freq, estimate.output_spectrum
    peak = float(freq[density.argmax()])
    if band_hz is None or lines_within(np.array(peak), band_hz):
        return
    inside = density[lines_within(freq, band_hz)]
    # A structure may have a stronger mode outside the band, in addition to a clear one inside.
    if len(inside) > SEGMENTS and inside[1:-1].max() > max(
        CLEAR * np.median(inside), *inside[[0, -1]]
    ):
        return
    yield doubt(role, *messages.outside_band(peak, *band_hz, 2 * peak / sum(band_hz)))


def _unresolved(record: Record, resolution_hz: float, freq: Reals, h: Complexes) -> Iterator[Fault]:
    """Yield a warning if the longest window cannot resolve the half-power width 2 zeta f_n."""
    width, peak = half_power_bandwidth(freq, h), float(freq[np.abs(h).argmax()])
    lasts = record.num_samples / record.fs
    if width <= RESOLVED * resolution_hz:
        yield doubt(record.response, *messages.unresolved(peak, width, lasts, resolution_hz))


def _missized(
    role: str, freq: Reals, h: Complexes, signed: bool, per_unit: float | None
) -> Iterator[Fault]:
    """Yield a warning if force per modal mass, 2/pi int Re[j omega H] d omega, is not as stated."""
    omega = 2 * np.pi * freq
    seen = 2 / np.pi * float(np.trapezoid(np.real(1j * omega * h), omega))
    ratio = 1.0 if per_unit is None else seen / per_unit
    # Without a band, the strongest peak may be another mode, with the opposite sign.
    if seen < 0 and signed:
        yield turned_over(role, seen)
    elif not 1 / MASS_FACTOR < ratio < MASS_FACTOR:
        yield doubt(role, *gain_messages.other_size(ratio))


class SwappedChannels(Hypothesis):
    """The fault that input and response of a test are exchanged."""

    name = "swapped channels"

    def suspects(self, misfit: Misfit) -> Iterator[Cause]:
        """Yield, for each test, the share of the misfit that exchanged channels would explain."""
        for label in misfit.missed:
            spectrum, norm = misfit.spectra[label], np.linalg.norm
            modelled = spectrum.factor * spectrum.measured / stiffness(misfit.theta, spectrum.omega)
            along = np.vdot(modelled, spectrum.source).real / np.vdot(modelled, modelled).real
            residual = norm(spectrum.source - along * modelled) / norm(spectrum.source)
            if along != 0:
                explained = 1 - (residual / misfit.error(label)) ** 2
                yield Cause(messages.swapped(f" of {label}"), float(explained), label)


def peaked_input(source: str, estimate: FRF) -> Iterator[Fault]:
    """Yield a warning if an input's spectrum is far more peaked than the response's spectrum."""
    lines = carried(estimate)
    if lines.sum() < SEGMENTS:
        return
    spectra = (estimate.input_spectrum[lines], estimate.output_spectrum[lines])
    of_input, of_response = (float(x.max() / np.median(x)) for x in spectra)
    if of_input >= PEAKED * of_response:
        yield doubt(source, *messages.swapped(ratio=of_input / of_response))


def carried(estimate: FRF) -> NDArray[np.bool_]:
    """Return a mask of the lines at which both input and response have power."""
    force, response = estimate.input_spectrum, estimate.output_spectrum
    return (force > FLOOR * force.max()) & (response > FLOOR * response.max())
