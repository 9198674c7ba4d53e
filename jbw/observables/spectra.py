r"""The residuals of records and harmonics, and the spectra that their usual causes act on.

A delay, another mode or the input's way around the mode are products in the frequency domain; a
record in time and a curve of harmonics differ by how they come from there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Inexact

Spectral = Complex[np.ndarray, " line"]
Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]


def real_rows(table: Inexact[np.ndarray, "value column"]) -> Float[np.ndarray, "part column"]:
    """Return the real parts above the imaginary parts; what is real stays as it is."""
    values: Any = table
    return np.concatenate([values.real, values.imag]) if np.iscomplexobj(values) else values


class Spectrum(NamedTuple):
    """One group's measured values, what a fit leaves of them, and the spectra behind them.

    Attributes:
        values: The mean measured, samples or lines.
        residual: Residual of the fit.
        omega: Frequencies of the lines [rad/s].
        measured: Of the response.
        predicted: Of the response, by the fit.
        source: Of the input; zero where it has no such harmonic.
        factor: From displacement to the response: one, j omega or its square.
        row: From a spectrum to what is compared.
        stretched: Time times the rate of the response: what a clock that is fast by a part takes
            from it for each unit of that part; None of what has no time.
        source_role: Channel of the input in a campaign: input or force.
    """

    values: Row
    residual: Row
    omega: Float[np.ndarray, " line"]
    measured: Spectral
    predicted: Spectral
    source: Spectral
    factor: Spectral
    row: Callable[[Spectral], Row]
    stretched: Row | None = None
    source_role: str = "input"


def of_samples(
    mean: Float[np.ndarray, " time"],
    residual: Float[np.ndarray, " time"],
    source: Float[np.ndarray, " time"],
    fs: float,
    order: int,
    *,
    periodic: bool,
) -> Spectrum:
    """Return a record in time, at rest before and after unless it is one period."""
    length = len(mean)
    padded = length if periodic else 2 * length
    measured, predicted, driven = (np.fft.rfft(x, padded) for x in (mean, mean - residual, source))
    omega = 2 * np.pi * np.fft.rfftfreq(padded, 1 / fs)

    def row(spectrum: Spectral) -> Row:
        return np.fft.irfft(spectrum, padded)[:length]

    factor = (1j * omega) ** order
    time = np.arange(length) / fs
    stretched = None if periodic else time * row(1j * omega * predicted)
    return Spectrum(mean, residual, omega, measured, predicted, driven, factor, row, stretched)


def of_lines(
    values: Spectral,
    residual: Spectral,
    omega: Float[np.ndarray, " line"],
    source: Spectral,
    factor: Spectral,
    stretched: Row | None = None,
) -> Spectrum:
    """Return the lines of a spectrum, or harmonics at some frequencies."""
    return Spectrum(
        values, residual, omega, values, values - residual, source, factor,
        lambda spectrum: spectrum, stretched,
    )  # fmt: skip
