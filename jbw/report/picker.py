"""The page for choosing band and modes, with the spectra of a campaign's tests."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from markupsafe import Markup
from scipy.signal import find_peaks

from jbw.errors import DataError, printable
from jbw.measurement.records import Record, Test
from jbw.measurement.resonances import swept
from jbw.report.page import ENVIRONMENT

# number of spectral lines shown for a test, the largest of each interval of frequencies
NUM_SHOWN = 1500
# number of neighbouring lines whose mean power is shown for a line, since single lines vary
# strongly
NEAR_LINES = 9
# A peak must exceed its surroundings by this number of decades: the mean power of nine lines of
# noise varies by a third, and its extremes over thousands of lines are up to 0.6 decades apart.
STANDS_OUT = 0.8
LEAST = 1e-4  # Smaller peaks, relative to the largest value of a spectrum, count as noise.
MOST_PEAKS = 8
APART = 0.05  # Peaks of several tests that are relatively closer than this belong to one mode.
# half width of a peak's band relative to its frequency; the band ends half-way to its neighbours at
# the latest
ABOUT = 0.15
SLOWEST = 3.0  # smallest number of periods in a record; a slower line may be a drift
DIGITS = 5  # number of digits of a frequency and of a value on the page

Lines = Float[np.ndarray, " line"]


class ShownSpectrum(NamedTuple):
    """A measured response against frequency, divided by the source if the test has one."""

    freq_hz: Lines
    size: Lines


class Peak(NamedTuple):
    """A peak of a spectrum, and a band around it that contains no other peak."""

    freq_hz: float
    band_hz: tuple[float, float]
    tests: tuple[str, ...]  # names of the tests in which the peak is clear


def render_picker(campaign: str, tests: Sequence[Test]) -> str:
    """Return the page as one HTML file that needs no network; names are escaped.

    Args:
        campaign: Name of the campaign.
        tests: Tests of the campaign.

    Raises:
        DataError: No test has a spectrum.
    """
    spectrum_by_test = {test.name: spectrum_of(test) for test in tests}
    spectra = {
        name: spectrum for name, spectrum in spectrum_by_test.items() if spectrum is not None
    }
    if not spectra:
        raise DataError(
            "No test of the campaign has a spectrum in which a band can be chosen.",
            remedy="Leave out --html: force loops have no band.",
        )
    peaks = peaks_of(spectra)
    data = json.dumps(picker_data(tests, spectra, peaks), allow_nan=False)
    return ENVIRONMENT.get_template("picker.html").render(
        campaign=printable(campaign),
        peaks=peaks,
        # JSON in a script element must not contain a character that ends the element.
        data=Markup(data.replace("<", "\\u003c")),
    )


def picker_data(
    tests: Sequence[Test], spectra: Mapping[str, ShownSpectrum], peaks: Sequence[Peak]
) -> dict[str, Any]:
    """Return the data of the page for choosing bands: spectra, stated bands and peaks."""
    return {
        "tests": [
            {
                "name": printable(test.name),
                "kind": test.kind,
                "band": None if test.band_hz is None else list(test.band_hz),
                "driven": test.traits.is_driven or test.traits.is_curve,
                "freq": _rounded(drawn.freq_hz),
                "size": _rounded(drawn.size),
            }
            for test in tests
            if test.name in spectra
            for drawn in [shown(spectra[test.name])]
        ],
        "peaks": [{"freq": round(peak.freq_hz, 4), "band": list(peak.band_hz)} for peak in peaks],
    }


def _rounded(values: Any) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def spectrum_of(test: Test) -> ShownSpectrum | None:
    """Return a test's response spectrum, from its repeats' mean power; None for tones and loops.

    A measured response curve is returned itself. For a driven test the spectrum is the ratio to the
    source, in the frequency range of the source.
    """
    if test.traits.is_controlled:
        return None
    if test.traits.is_curve:
        return _of_curves(test)
    if test.traits.is_prescribed or test.traits.is_steady:
        return None
    spectra = [_powers(record, is_driven=test.traits.is_driven) for record in test.records]
    freq = spectra[0][0]
    response, source = (
        np.mean([np.interp(freq, spectrum[0], spectrum[i]) for spectrum in spectra], axis=0)
        for i in (1, 2)
    )
    is_shown = freq * test.records[0].num_samples / test.records[0].fs >= SLOWEST
    if test.traits.is_driven:
        is_shown &= swept(source) & (source > 0)
    if not is_shown.any():
        return None
    return ShownSpectrum(freq[is_shown], np.sqrt(response[is_shown] / source[is_shown]))


def peaks_of(spectra: dict[str, ShownSpectrum]) -> list[Peak]:
    """Return the clear peaks of the spectra, from low to high, each with a separate band."""
    peaks: list[tuple[float, float, str]] = []
    for name, (freq, size) in spectra.items():
        log = np.log10(np.maximum(size, size.max() * 1e-12))
        indices, properties = find_peaks(
            log, height=log.max() + np.log10(LEAST), prominence=STANDS_OUT
        )
        peaks += [
            (float(freq[i]), float(rise), name)
            for i, rise in zip(indices, properties["prominences"], strict=True)
        ]
    modes = sorted(_together(peaks), key=lambda mode: -max(peak[1] for peak in mode))[:MOST_PEAKS]
    centres = sorted((float(np.median([peak[0] for peak in mode])), mode) for mode in modes)
    ends = [0.0, *(centre for centre, _ in centres), np.inf]
    return [
        Peak(centre, _band(before, centre, after), tuple(dict.fromkeys(peak[2] for peak in mode)))
        for before, (centre, mode), after in zip(ends, centres, ends[2:], strict=False)
    ]


def _together(
    peaks: Sequence[tuple[float, float, str]],
) -> Iterator[list[tuple[float, float, str]]]:
    """Yield groups of spectral peaks that belong to one mode."""
    mode: list[tuple[float, float, str]] = []
    for peak in sorted(peaks):
        if mode and peak[0] > (1 + APART) * mode[-1][0]:
            yield mode
            mode = []
        mode.append(peak)
    if mode:
        yield mode


def _band(before: float, centre: float, after: float) -> tuple[float, float]:
    """Return a band [Hz] around a peak, to three digits, at most half-way to its neighbours."""
    low = max((1 - ABOUT) * centre, 0.5 * (before + centre))
    high = min((1 + ABOUT) * centre, 0.5 * (centre + after))
    return float(f"{low:.3g}"), float(f"{high:.3g}")


def _powers(record: Record, *, is_driven: bool) -> tuple[Lines, Lines, Lines]:
    """Return a record's frequencies [Hz], and the power of response and source at each frequency.

    Without a source its power is 1.
    """
    freq = np.fft.rfftfreq(record.num_samples, 1 / record.fs)[1:]
    response = _power(record.channels[record.response])
    source = _power(record.channels[record.source]) if is_driven else np.ones_like(freq)
    return freq, response, source


def _power(samples: Float[np.ndarray, " time"]) -> Lines:
    """Return the power spectrum of samples, averaged over neighbouring spectral lines.

    Missing samples are replaced by zero.
    """
    x = np.where(np.isfinite(samples), samples - np.nanmean(samples), 0.0)
    squares = np.abs(np.fft.rfft(x)[1:]) ** 2 * (2.0 / len(x)) ** 2
    return np.convolve(squares, np.ones(NEAR_LINES) / NEAR_LINES, "same")


def _of_curves(test: Test) -> ShownSpectrum:
    first = test.records[0]
    freq = np.asarray(first.channels["frequency"], float)
    size = np.mean([np.abs(record.channels[record.response]) for record in test.records], axis=0)
    order = np.argsort(freq)
    is_usable = np.isfinite(size[order]) & (freq[order] > 0)
    return ShownSpectrum(freq[order][is_usable], size[order][is_usable])


def shown(spectrum: ShownSpectrum) -> ShownSpectrum:
    """Reduce a spectrum for display: keep the largest line of each interval of frequencies."""
    width = -(-len(spectrum.size) // NUM_SHOWN)
    starts = range(0, len(spectrum.size), width)
    largest = [start + int(np.argmax(spectrum.size[start : start + width])) for start in starts]
    return ShownSpectrum(spectrum.freq_hz[largest], spectrum.size[largest])
