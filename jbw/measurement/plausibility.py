"""Whether a record of broad-band excitation can be what its campaign file says it is."""

import warnings

import numpy as np
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.checks import Fault
from jbw.measurement.records import INPUTS, Record
from jbw.measurement.spectra import FRF, frf, half_power_bandwidth

LOOKED_AT = 2**21  # samples; a stationary record shows its faults in them
SEGMENTS = 8  # of the spectra: coarse, but a resonance still stands out
LONGEST = 4  # windows in a record at the least, for the finest look at the resonance
FLOOR = 1e-4  # of the largest density: lines below it are outside the excitation
CLEAR = 4.0  # times the median of the band: a resonance in it
PEAKED = 10.0  # times more peaked than the response: an input that looks like a response
RESOLVED = 1.5  # times the window's own width; a narrower peak shows the window, T 2 zeta f_n < 2
LOW_COHERENCE = 0.5  # median over the lines that carry the response
MASS_FACTOR = 3.0  # between the modal mass seen and the one given; more is a wrong unit


def doubts(
    record: Record,
    band_hz: tuple[float, float] | None = None,
    *,
    delay: float = 0.0,
    per_unit: float | None = None,
) -> tuple[Fault, ...]:
    """What is doubtful in a record under broad-band excitation.

    Wrong fs or band, channels swapped, input and response that have little to do with each other,
    a record too short to resolve the damping, a response of the wrong size or sign.

    Args:
        record: A noise or multisine record.
        band_hz: Where the campaign file says that the resonance is [Hz].
        delay: Lag of the response channel behind the input channel [s].
        per_unit: Force per modal mass for one unit of the input, where the campaign knows it:
            the gain [N/kg/V], or one over the modal mass [1/kg].
    """
    source = next((role for role in INPUTS if role in record.channels), None)
    if source is None:
        return ()
    try:
        coarse, fine = (_frf(record, source, n, delay) for n in (SEGMENTS, LONGEST))
    except DataError as error:  # a record of a few samples
        return (Fault("warning", record.response, error.what, error.why, error.remedy),)
    # The first two leave no FRF whose size or width would mean anything.
    broken = _swapped(source, coarse) or _incoherent(record.response, coarse)
    if broken:
        return (broken,)
    found = (
        _outside_band(record.response, coarse, band_hz),
        _unresolved(record, fine, band_hz),
        _missized(record.response, fine, band_hz, per_unit),
    )
    return tuple(finding for finding in found if finding)


def swapped(record: Record) -> tuple[Fault, ...]:
    """The doubt that input and response of a sweep are swapped."""
    try:
        finding = _swapped(record.source, _frf(record, record.source, SEGMENTS, 0.0))
    except DataError:  # too short, or no input at some frequencies: nothing to compare
        return ()
    return (finding,) if finding else ()


def _frf(record: Record, source: str, segments: int, delay: float) -> FRF:
    u, y = (record.channels[role][:LOOKED_AT] for role in (source, record.response))
    nperseg = len(u) // segments
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # said below, in the words of a check
        return frf(u, y, record.fs, response=record.response, nperseg=nperseg, delay=delay)


def _outside_band(role: str, estimate: FRF, band_hz: tuple[float, float] | None) -> Fault | None:
    freq, density = estimate.freq, estimate.output_spectrum
    peak = float(freq[density.argmax()])
    if band_hz is None or band_hz[0] <= peak <= band_hz[1]:
        return None
    inside = density[(freq >= band_hz[0]) & (freq <= band_hz[1])]
    # A structure may have a stronger mode elsewhere, beside a clear one in the band.
    if len(inside) > SEGMENTS and inside[1:-1].max() > max(
        CLEAR * np.median(inside), *inside[[0, -1]]
    ):
        return None
    centre = sum(band_hz) / 2
    return Fault(
        "warning",
        role,
        f"The response is largest at {peak:.4g} Hz, outside `band` = [{band_hz[0]:g}, "
        f"{band_hz[1]:g}] Hz: {peak / centre:.3g} times its centre.",
        "A factor of 6.28 means rad/s, 2 half the sampling frequency, 1.024 rounded 1000 Hz.",
        "Check fs and band.",
    )


def _carried(estimate: FRF) -> NDArray[np.bool_]:
    """Lines at which both channels hold something."""
    force, response = estimate.input_spectrum, estimate.output_spectrum
    return (force > FLOOR * force.max()) & (response > FLOOR * response.max())


def _swapped(source: str, estimate: FRF) -> Fault | None:
    lines = _carried(estimate)
    if lines.sum() < SEGMENTS:
        return None
    spectra = (estimate.input_spectrum[lines], estimate.output_spectrum[lines])
    sharp = [float(x.max() / np.median(x)) for x in spectra]
    if sharp[0] < PEAKED * sharp[1]:
        return None
    return Fault(
        "warning",
        source,
        f"The input's spectrum is {sharp[0] / sharp[1]:.3g} times more peaked than the response's.",
        "That is how the FRF looks when input and response are swapped.",
        "Check which channel is which.",
    )


def _incoherent(role: str, estimate: FRF) -> Fault | None:
    lines = _carried(estimate)
    coherence = float(np.median(estimate.coherence[lines])) if lines.any() else 1.0
    if coherence >= LOW_COHERENCE:
        return None
    return Fault(
        "warning",
        role,
        f"The coherence with the input is {coherence:.2f} in the median of the excited lines.",
        "Little of this response comes from this input.",
        "Check that the channels belong together, and narrow band to where they do.",
    )


def _unresolved(record: Record, estimate: FRF, band_hz: tuple[float, float] | None) -> Fault | None:
    """A half-power width 2 zeta f_n that the longest useful window cannot tell from none."""
    freq, h = _inside(estimate, band_hz)
    if len(freq) < SEGMENTS or not _stands_out(h):
        return None
    width, peak = half_power_bandwidth(freq, h), float(freq[np.abs(h).argmax()])
    if width > RESOLVED * estimate.resolution_hz:
        return None
    lasts = record.num_samples / record.fs
    return Fault(
        "warning",
        record.response,
        f"The resonance at {peak:.4g} Hz is seen {width:.3g} Hz wide, hardly more than a record of "
        f"{lasts:.4g} s resolves ({estimate.resolution_hz:.3g} Hz).",
        "Its damping is then an upper bound, not a number.",
        f"Measure longer: {4 * lasts:.4g} s resolve {estimate.resolution_hz / 4:.3g} Hz.",
    )


def _missized(
    role: str, estimate: FRF, band_hz: tuple[float, float] | None, per_unit: float | None
) -> Fault | None:
    r"""Force per modal mass as the response shows it, whatever the damping, beside the given one.

    $$g = \frac{2}{\pi} \int \mathrm{Re}[j \omega H(\omega)]\,d\omega$$
    """
    freq, h = _inside(estimate, band_hz)
    if len(freq) < SEGMENTS or not _stands_out(h):
        return None
    omega = 2 * np.pi * freq
    seen = 2 / np.pi * float(np.trapezoid(np.real(1j * omega * h), omega))
    if seen < 0 and band_hz is not None:  # without a band another mode may have the other sign
        return Fault(
            "warning",
            role,
            "At its resonance the response moves against the input: the gain is negative.",
            "The polarity of one channel is turned, or the response was taken the other way round.",
            f"Turn it: scale = {{ {role} = -1.0 }}.",
        )
    ratio = 1.0 if per_unit is None else seen / per_unit
    if 1 / MASS_FACTOR < ratio < MASS_FACTOR:
        return None
    return Fault(
        "warning",
        role,
        f"At its resonance the response is {ratio:.3g} times what the campaign's gain or modal "
        "mass makes of the input.",
        "A factor of 1000 is a metre for a millimetre, 9.81 a g for m/s^2, 4.45 lbf for N.",
        "Check both units, and gain or modal_mass.",
    )


def _inside(
    estimate: FRF, band_hz: tuple[float, float] | None
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    low, high = band_hz or (0.0, np.inf)
    lines = _carried(estimate) & (estimate.freq >= low) & (estimate.freq <= high)
    return estimate.freq[lines], estimate.h[lines]


def _stands_out(h: NDArray[np.complex128]) -> bool:
    """Whether there is a peak to judge; a flat or noisy estimate has none."""
    power = np.abs(h) ** 2
    return bool(power.max() > 10 * np.median(power))
