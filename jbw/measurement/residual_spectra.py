r"""Spectra of records and of harmonics, in which causes of residuals are tested.

A delay, another mode, or an input that bypasses the mode is a product in the frequency domain.
Records in time and curves of harmonics differ in how they are computed from there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Inexact

Spectral = Complex[np.ndarray, " line"]
Row = Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]


def real_rows(table: Inexact[np.ndarray, "value column"]) -> Float[np.ndarray, "part column"]:
    """Return a complex table as real parts above imaginary parts; a real table is unchanged."""
    values: Any = table
    return np.concatenate([values.real, values.imag]) if np.iscomplexobj(values) else values


class Spectrum(NamedTuple):
    """Measured values and residual of a fit for one data group, with their spectra.

    Attributes:
        values: Measured mean, as samples or lines.
        residual: Residual of the fit.
        omega: Frequencies of the lines [rad/s].
        measured: Spectrum of the measured response.
        predicted: Spectrum of the response predicted by the fit.
        source: Spectrum of the input; zero if it has no such harmonic.
        factor: Factor from displacement to the response: one, j omega or its square.
        row: Function from a spectrum to the compared values.
        stretched: Time times the rate of the response: how much a clock that is too fast by a
            fraction takes from the response, per unit of that fraction; None without a time axis.
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
    """Return the spectra of a time record that begins and ends at rest, or that is one period."""
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
    """Return the spectra of a data group that consists of spectral lines or harmonics."""
    return Spectrum(
        values, residual, omega, values, values - residual, source, factor,
        lambda spectrum: spectrum, stretched,
    )  # fmt: skip
