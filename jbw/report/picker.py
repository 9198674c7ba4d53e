"""A page to choose the band and the modes on the spectra of a campaign's tests."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from jbw.errors import DataError, printable
from jbw.measurement.records import Test
from jbw.measurement.shown_spectra import Peak, ShownSpectrum, peaks_of, shown, spectrum_of
from jbw.report.page import ENVIRONMENT

DIGITS = 5  # of a frequency and of a size on the page


def render_picker(campaign: str, tests: Sequence[Test]) -> str:
    """Return the page as HTML: one file, nothing from a network; names are escaped.

    Args:
        campaign: Its name.
        tests: Of the campaign.

    Raises:
        DataError: No test has a spectrum.
    """
    spectrum_by_test = {test.name: spectrum_of(test) for test in tests}
    spectra = {
        name: spectrum for name, spectrum in spectrum_by_test.items() if spectrum is not None
    }
    if not spectra:
        raise DataError(
            "No test of the campaign has a spectrum to choose a band on.",
            remedy="Leave out --html: force loops have no band.",
        )
    peaks = peaks_of(spectra)
    data = json.dumps(picker_data(tests, spectra, peaks), allow_nan=False)
    return ENVIRONMENT.get_template("picker.html").render(
        campaign=printable(campaign),
        peaks=peaks,
        # JSON within a script: no letter of it ends the script.
        data=Markup(data.replace("<", "\\u003c")),
    )


def picker_data(
    tests: Sequence[Test], spectra: Mapping[str, ShownSpectrum], peaks: Sequence[Peak]
) -> dict[str, Any]:
    """What the page draws: spectra by test with the band that is stated, and the peaks."""
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
