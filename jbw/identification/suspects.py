"""What usually goes wrong with a test, each as columns by which it would change the data.

About a fit, by the groups' labels: a delay, another clock, a sign or a unit, an offset, clipping,
the response of modes beyond the band or of one more mode within it, runs that have a frequency
each.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.inference.posterior.remedies import put
from jbw.observables.spectra import Row, Spectrum, real_rows
from jbw.report.messages import causes as messages
from jbw.report.messages.causes import Words

DRIVEN = 0.1  # of the largest: lines of the input within which another mode is looked for
NUM_MODES, MODE_ZETAS = 96, (0.003, 0.01, 0.03)  # frequencies and dampings of another mode tried
APART = 0.05  # of the natural frequency: a mode nearer than that is the joint's own
FACTOR = "factor"  # kind of those that are a group's own
TURNED = 0.2  # about -1: a factor that is a sign
CLOSE = 0.03  # about a ratio of units: a factor that is a unit
UNITS = {
    1e-3: "thousandths", 1e3: "thousands", 1e-6: "millionths", 1e6: "millions",
    9.80665: "units of g", 1 / 9.80665: "units of g", 2 * np.pi: "rad/s for Hz",
    1 / (2 * np.pi): "rad/s for Hz", 2**0.5: "rms for peak", 0.5**0.5: "rms for peak",
    0.0254: "inches", 1 / 0.0254: "inches",
}  # fmt: skip

TEST = "[test]"  # table of the lines that a remedy names

Columns = Mapping[str, Float[np.ndarray, "value column"]]  # by the groups' labels
Spectra = Mapping[str, Spectrum]
Slopes = Mapping[str, Mapping[str, Row]]  # of what is left, by parameter and by label


class Suspect(NamedTuple):
    """Its kind, of which the best is told, columns, and words by the coefficients found of them."""

    kind: str
    columns: Columns
    words: Callable[[NDArray[np.float64]], Words]
    mode: tuple[float, float] | None = None  # omega [rad/s] and zeta of the mode that it is


def three(x: float) -> float:
    """A number of three digits."""
    return float(f"{x:.3g}")


def as_columns(*rows: Row) -> NDArray[np.float64]:
    """Rows as columns, of complex ones the real parts above the imaginary parts."""
    return real_rows(np.stack(rows, axis=1))


def suspects(spectra: Spectra, slopes: Slopes, omega_n: float) -> Iterator[Suspect]:
    """All that is tried of groups."""
    yield _delay(spectra)
    yield from _clock(spectra)
    yield from (_factor(label, spectrum) for label, spectrum in spectra.items())
    yield from _in_time(spectra)
    yield _residual_term(spectra)
    if len(spectra) > 1 and len(slopes) > 0:
        yield _own_frequency(spectra, slopes, omega_n)
    yield from modes_anywhere(spectra, omega_n)


def _delay(spectra: Spectra) -> Suspect:
    r"""All responses late by tau: $-j\omega X$."""

    def words(coefficients: NDArray[np.float64]) -> Words:
        (tau,) = coefficients
        return messages.delay(tau, put(TEST, "delay", three(tau)))

    columns = {n: as_columns(s.row(-1j * s.omega * s.predicted)) for n, s in spectra.items()}
    return Suspect("delay", columns, words)


def _clock(spectra: Spectra) -> Iterator[Suspect]:
    r"""All responses by a clock that is fast by a part: $-t\,\dot x$ for each unit of it."""
    columns = {n: as_columns(-s.stretched) for n, s in spectra.items() if s.stretched is not None}

    def words(coefficients: NDArray[np.float64]) -> Words:
        (fast,) = 1e6 * coefficients
        return messages.clock(fast, put(TEST, "clock_ppm", three(fast)))

    if columns:
        yield Suspect("clock", columns, words)


def _factor(label: str, spectrum: Spectrum) -> Suspect:
    """One group's response times a factor: its sign, its unit, another gain."""
    columns = {label: as_columns(spectrum.values - spectrum.left)}
    return Suspect(
        f"{FACTOR} of {label}",
        columns,
        lambda coefficients: factor_words(label, 1 + coefficients[0], spectrum.source_role),
    )


def factor_words(label: str, factor: float, source: str = "input") -> Words:
    """What a group is whose response over its input is so many times that of others."""
    if abs(factor + 1) < TURNED:
        return messages.turned(label, put(TEST, f"scale.{source}", -1.0))
    size = abs(factor)
    unit = next((name for f, name in UNITS.items() if abs(size / f - 1) < CLOSE), None)
    line = put(TEST, f"scale.{source}", three(factor))
    return messages.factor(label, size, unit, line, is_turned=factor < 0)


def _in_time(spectra: Spectra) -> Iterator[Suspect]:
    """Samples with a constant offset each record, or cut off at the largest one."""
    sampled = {
        label: spectrum
        for label, spectrum in spectra.items()
        if not np.iscomplexobj(spectrum.values)
    }
    if not sampled:
        return
    constants = {
        label: np.tile(unit, (len(spectrum.values), 1))
        for (label, spectrum), unit in zip(sampled.items(), np.eye(len(sampled)), strict=True)
    }
    yield Suspect(
        "offset",
        constants,
        lambda coefficients: messages.offset(
            coefficients[np.argmax(np.abs(coefficients))], put(TEST, "remove_mean", True)
        ),
    )
    cut = {}
    for label, spectrum in sampled.items():
        model, most = spectrum.values - spectrum.left, np.max(np.abs(spectrum.values))
        if np.max(np.abs(model)) > most:
            cut[label] = as_columns(np.clip(model, -most, most) - model)
    if cut:
        yield Suspect("clipping", cut, lambda coefficients: messages.clipping(list(cut)))


def _residual_term(spectra: Spectra) -> Suspect:
    r"""Modes below and above the band: $X = (R - M / \omega^2)\,U$, as a displacement."""
    columns = {}
    for label, spectrum in spectra.items():
        stiff = spectrum.factor * spectrum.source
        mass = np.divide(
            -stiff, spectrum.omega**2, out=np.zeros_like(stiff), where=spectrum.omega > 0
        )
        columns[label] = as_columns(spectrum.row(stiff), spectrum.row(mass))

    return Suspect(
        "residual term",
        columns,
        lambda coefficients: messages.residual_term(
            coefficients[0], put(TEST, "residuals", "both")
        ),
    )


def _own_frequency(spectra: Spectra, slopes: Slopes, omega_n: float) -> Suspect:
    """Every group with changes of its own of what runs may differ in."""
    columns, wide = {}, len(spectra) * len(slopes)
    for place, label in enumerate(spectra):
        group_columns = as_columns(*(-slope[label] for slope in slopes.values()))
        columns[label] = np.zeros((len(group_columns), wide))
        columns[label][:, place * len(slopes) : (place + 1) * len(slopes)] = group_columns
    first = next(iter(slopes))

    def words(coefficients: NDArray[np.float64]) -> Words:
        spread = np.std(coefficients[:: len(slopes)]) / (omega_n if first == "omega_n" else 1.0)
        return messages.natural_frequencies(float(spread), put(TEST, "run", "day 1"))

    return Suspect("own frequency", columns, words)


def modes_anywhere(spectra: Spectra, omega_n: float) -> Iterator[Suspect]:
    """One more mode anywhere in what is driven, but for the joint's own place."""
    lines = [s.omega[np.abs(s.source) > DRIVEN * np.abs(s.source).max()] for s in spectra.values()]
    driven = np.concatenate([line[line > 0] for line in lines])
    if not len(driven):
        return
    frequencies = np.geomspace(driven.min(), driven.max(), NUM_MODES)
    for omega in frequencies[np.abs(frequencies / omega_n - 1) > APART]:
        # The band as far as between both, which leaves the joint's own.
        middle = np.sqrt(omega * omega_n)
        ends = (driven.min(), middle) if omega > omega_n else (middle, driven.max())
        band = [three(end / (2 * np.pi)) for end in ends]
        yield from modes_at(spectra, [omega], f" {put(TEST, 'band', band)}")


def modes_at(spectra: Spectra, places: Iterable[float], remedy: str = "") -> Iterator[Suspect]:
    """One more mode at any of some frequencies [rad/s], of any of the usual dampings."""
    for omega in places:
        yield from (_mode(spectra, float(omega), zeta, remedy) for zeta in MODE_ZETAS)


def _mode(spectra: Spectra, omega: float, zeta: float, remedy: str) -> Suspect:
    r"""$X = a\,U / (\omega_2^2 - \omega^2 + 2j\zeta_2\omega_2\omega)$."""
    columns = {}
    for label, spectrum in spectra.items():
        below = omega**2 - spectrum.omega**2 + 2j * zeta * omega * spectrum.omega
        columns[label] = as_columns(spectrum.row(spectrum.factor * spectrum.source / below))
    hz = omega / (2 * np.pi)
    return Suspect(
        "mode",
        columns,
        lambda coefficients: messages.further_mode(hz, remedy),
        (omega, zeta),
    )
