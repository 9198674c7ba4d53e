"""Tests and repeats that differ from the others in gain, natural frequency or damping.

The gain is the ratio of response to drive, with its sign.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jbw.measurement.channels import Reals
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.faults.hypothesis import Hypothesis
from jbw.measurement.faults.suspect import (
    Cause,
    Misfit,
    Suspect,
    as_columns,
    is_driven,
    stiffness,
)
from jbw.measurement.residual_spectra import Spectrum
from jbw.measurement.resonances import oscillator_through
from jbw.report.messages import causes
from jbw.report.messages import gain_faults as messages
from jbw.report.messages.message import FaultText

# largest distance of a gain from -1; -1 is the gain for a base's acceleration
BASE = 0.1
# largest ratio of a gain to the median gain, because no joint changes a modal mass by more
LARGER = 1.5
TURNED = 0.2  # distance from -1 within which a factor means a reversed sign
CLOSE = 0.03  # relative tolerance with which a factor counts as the ratio of two units
UNITS = {
    1e-3: "thousandths", 1e3: "thousands", 1e-6: "millionths", 1e6: "millions",
    9.80665: "units of g", 1 / 9.80665: "units of g", 2 * np.pi: "rad/s for Hz",
    1 / (2 * np.pi): "rad/s for Hz", 2**0.5: "rms for peak", 0.5**0.5: "rms for peak",
    0.0254: "inches", 1 / 0.0254: "inches",
}  # fmt: skip
NEAR_PEAK = 0.3  # Lines above this fraction of the largest response belong to the resonance.
# smallest number of lines near a resonance from which one group's gain is determined
LEAST_LINES = 6
FAR_OFF = 3.0  # ratio of gains that only a wrong unit or sign explains; softening does not reach it


class UnlikeGain(Hypothesis):
    """The fault that one test's gain differs from the others' by a sign, unit or factor."""

    name = "sign or gain"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect | Cause]:
        """Yield the test whose gain differs from all others; if none does, every test's factor.

        A step from a fit that is far from all tests is unreliable.
        """
        apart = list(_apart(misfit))
        yield from apart or (_factor(label, s) for label, s in misfit.spectra.items())


def _factor(label: str, spectrum: Spectrum) -> Suspect:
    columns = {label: as_columns(spectrum.values - spectrum.residual)}
    source = spectrum.source_role
    return Suspect(columns, lambda more: unlike(1 + more[0], source, label), label)


def unlike(factor: float, source: str, test: str = "") -> FaultText:
    """Return the text on a test or repeat whose gain is `factor` times the gain of the others."""
    if abs(factor + 1) < TURNED:
        return messages.other_sign(source, test)
    close = (pair for pair in UNITS.items() if abs(abs(factor) / pair[0] - 1) < CLOSE)
    scale, unit = next(close, (abs(factor), ""))
    return messages.other_gain(factor, float(np.copysign(scale, factor)), source, unit, test)


def _apart(misfit: Misfit) -> Iterator[Cause]:
    """Yield the data group whose separate gain differs from the other gains in sign or size."""
    fits = {n: pair for n, s in misfit.spectra.items() if (pair := _alone(s)) is not None}
    missed = [label for label in misfit.missed if label in fits]
    if len(fits) < 2 or not missed:
        return
    # Each gain is compared with the median of the others in sign and size. With only two, it cannot
    # be determined which is wrong.
    ratios = {
        label: gain / np.median([other for n, (other, _) in fits.items() if n != label])
        for label, (gain, _) in fits.items()
    }
    label = max(ratios, key=lambda n: abs(np.log(abs(ratios[n]))) + FAR_OFF * (ratios[n] < 0))
    if 1 / FAR_OFF < ratios[label] < FAR_OFF:
        return
    errors = sum(misfit.error(n) ** 2 for n in missed)
    explained = 1 - sum(fits[n][1] ** 2 for n in missed) / errors
    text = unlike(float(ratios[label]), misfit.spectra[label].source_role, label)
    yield Cause(text, float(explained), label)


def _alone(spectrum: Spectrum) -> tuple[float, float] | None:
    """Fit a linear oscillator to one data group; return its gain and the relative residual."""
    factor, measured = spectrum.factor, spectrum.measured
    x = np.divide(measured, factor, out=np.zeros_like(factor), where=factor != 0)
    driven = is_driven(spectrum)
    near = driven & (np.abs(x) > NEAR_PEAK * np.abs(x[driven]).max(initial=0.0))
    if near.sum() < LEAST_LINES:
        return None
    mode = oscillator_through(spectrum.omega[near], spectrum.source[near], x[near])
    modelled = mode["gain"] * factor * spectrum.source / stiffness(mode, spectrum.omega)
    return mode["gain"], float(np.linalg.norm(measured - modelled) / np.linalg.norm(measured))


def unlike_gains(
    gains: Sequence[tuple[str, float]], role: str, source: str
) -> Iterator[tuple[str, Fault]]:
    """Yield repeats by name, each with a warning that a channel has a wrong sign or unit.

    A force that is measured at the mode's own point drives it with a positive gain, one over a
    modal mass.

    Args:
        gains: Name of each repeat and gain of its mode; NaN if none was read.
        role: Role of the response.
        source: Role of the drive.
    """
    known = [(name, gain) for name, gain in gains if np.isfinite(gain) and gain != 0.0]
    if not known:
        return
    if all(gain < 0 for _, gain in known):
        yield from ((name, turned_over(role, gain)) for name, gain in known)
        return
    size = float(np.median([abs(gain) for _, gain in known]))
    signs = [np.sign(gain) for _, gain in known]
    usual = np.sign(sum(signs)) or signs[0]
    for name, gain in known:
        ratio = abs(gain) / size
        if np.sign(gain) != usual:
            yield name, doubt(role, *unlike(-1.0, source))
        elif not 1 / LARGER < ratio < LARGER:
            yield name, doubt(role, *unlike(ratio, source))


def unlike_tests(
    gains: Mapping[str, Sequence[tuple[str, float]]], role: str, source: str
) -> Iterator[tuple[str, Fault]]:
    """Yield tests of one mode by name, each with a warning that its gain differs from the others'.

    Of two tests, the second is named, because it cannot be determined which of them is wrong.

    Args:
        gains: Name of each test, with name and gain of each of its repeats.
        role: Role of the response, which is the same in all tests.
        source: Role of the drive, which is the same in all tests.
    """
    sizes = {test: float(np.nanmedian([abs(x) for _, x in pairs])) for test, pairs in gains.items()}
    sizes = {test: size for test, size in sizes.items() if size > 0}
    if len(sizes) < 2:
        return
    usual = float(np.median(list(sizes.values()))) if len(sizes) > 2 else next(iter(sizes.values()))
    for test, size in sizes.items():
        if not 1 / LARGER < size / usual < LARGER:
            yield test, doubt(role, *unlike(size / usual, source, test))


def turned_over(role: str, gain: float) -> Fault:
    """Return a warning that the response moves against its drive, as the negative gain shows."""
    is_base = role == "acceleration" and abs(gain + 1) < BASE
    return doubt(role, *(messages.base_motion(gain) if is_base else messages.negative_gain(role)))


class OwnFrequencies(Hypothesis):
    """The fault that each test has a separate natural frequency and damping ratio."""

    name = "natural frequency of tests"

    def suspects(self, misfit: Misfit) -> Iterator[Suspect]:
        """Yield the change of the data if each test has a separate frequency and damping."""
        slopes, count = misfit.slopes, len(misfit.slopes)
        if len(misfit.spectra) < 2 or not slopes:
            return
        columns = {}
        for place, label in enumerate(misfit.spectra):
            own = as_columns(*(-slope[label] for slope in slopes.values()))
            others = count * place, count * (len(misfit.spectra) - 1 - place)
            columns[label] = np.pad(own, ((0, 0), others))
        unit = misfit.theta["omega_n"] if "omega_n" in slopes else 1.0

        def text(offsets: Reals) -> FaultText:
            return causes.natural_frequencies(float(np.std(offsets[::count]) / unit))

        yield Suspect(columns, text)
