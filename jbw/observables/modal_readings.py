"""Frequency, damping and gains of several modes from spectra of driven records, before any fit."""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.optimize import least_squares

from jbw.measurement.channels import lines_within
from jbw.observables.modes import FIRST, Modes, Reals

DRIVEN = 0.1  # Spectral lines above this fraction of the largest one give starting values.
FEWEST = 6  # smallest number of spectral lines that determine a mode's frequency
# Fraction of a mode's search range that its lines must cover. A harmonic of a shaker's force covers
# less.
SPANNED = 0.5
# smallest, assumed and largest damping ratio of starting values
LEAST_ZETA, USUAL_ZETA, MOST_ZETA = 1e-4, 5e-3, 0.2


class MotionSpectra(NamedTuple):
    """The spectra of one test: of its source, and of the displacement at each measured point."""

    omega: Float[np.ndarray, " line"]  # frequencies of the lines [rad/s]
    source: Complex[np.ndarray, " line"]
    seen: dict[str, Complex[np.ndarray, " line"]]


def read_modes(modes: Modes, motions: Sequence[MotionSpectra]) -> dict[str, float]:
    """Return each driven mode's frequency, damping and gains, from the first test that drives it.

    A motion that passes through the mode is preferred. The reading at each point is a gain, not yet
    a ratio. Modes that one motion drives are fitted together, because the flank of one lies under
    the peak of its neighbour.
    """
    readings: dict[str, float] = {}
    every = (FIRST, *(names[:3] for names in modes.names))
    for spanned, motion in product((SPANNED, 0.0), motions):
        near = _near(motion, modes.windows_hz, spanned)
        pairs = [(i, point) for i in near for point in motion.seen]
        named = {(i, p): modes.seen[p][i] if p else every[i][2] for i, p in pairs}
        if all(name in readings for name in named.values()):
            continue
        near_any = np.any(list(near.values()), axis=0)
        seen = {point: y[near_any] for point, y in motion.seen.items()}
        lines = MotionSpectra(motion.omega[near_any], motion.source[near_any], seen)
        poles, gains = _poles_and_gains(lines, [modes.windows_hz[i] for i in near])
        for i, pole, row in zip(near, poles, gains.T, strict=True):
            if every[i][0] not in readings:
                readings |= dict(zip(every[i], pole, strict=False))
            for point, gain in zip(seen, row, strict=True):
                readings.setdefault(named[i, point], float(gain))
    return readings


def _near(
    motion: MotionSpectra, windows_hz: Sequence[tuple[float, float]], spanned: float
) -> dict[int, Bool[np.ndarray, " line"]]:
    """Return each mode's driven spectral lines in its search range, if they cover enough of it."""
    loud, near_modes = np.abs(motion.source) > DRIVEN * np.abs(motion.source).max(), {}
    for i, window in enumerate(windows_hz):
        near_mode = loud & lines_within(motion.omega / (2 * np.pi), window)
        width = 2 * np.pi * (window[1] - window[0])
        if np.sum(near_mode) >= FEWEST and np.ptp(motion.omega[near_mode]) >= spanned * width:
            near_modes[i] = near_mode
    return near_modes


def _poles_and_gains(
    lines: MotionSpectra, windows_hz: Sequence[tuple[float, float]]
) -> tuple[Float[np.ndarray, "mode two"], Float[np.ndarray, "point mode"]]:
    r"""Fit the poles of modes by least squares; gains and residual terms are linear unknowns.

    $$Y_o = \Big(\sum_i \frac{R_{oi}}{\omega_i^2 - \omega^2 + 2j\zeta_i\omega_i\omega} + U_o
      + \frac{L_o}{\omega^2}\Big) U$$
    """
    omega, source = lines.omega, lines.source
    seen = np.array(list(lines.seen.values()))
    norms = np.linalg.norm(seen, axis=1)
    target = _parts(seen / norms[:, None])
    low, high = 2 * np.pi * np.array(windows_hz).T

    def poles_of(x: Reals) -> Reals:
        place, log_zeta = x.reshape(2, -1)
        return np.stack([low + place * (high - low), np.exp(log_zeta)], axis=1)

    def best(x: Reals) -> tuple[Reals, Reals]:
        """Solve for gains and residual terms at given poles; return them with the residual."""
        natural, zeta = poles_of(x).T[..., None]
        modal = 1 / (natural**2 - omega**2 + 2j * zeta * natural * omega)
        columns = _parts(np.array([*modal, np.ones_like(omega), 1 / omega**2]) * source)
        size = np.linalg.norm(columns, axis=1)[:, None]
        coefficients = np.linalg.lstsq((columns / size).T, target.T)[0]
        return coefficients / size, (target - coefficients.T @ (columns / size)).ravel()

    count = len(windows_hz)
    start = np.repeat([0.5, np.log(USUAL_ZETA)], count)
    ends = np.repeat([0.0, np.log(LEAST_ZETA)], count), np.repeat([1.0, np.log(MOST_ZETA)], count)
    scale = np.repeat([0.03, 1.0], count)
    x = least_squares(lambda x: best(x)[1], start, bounds=ends, x_scale=scale).x
    return poles_of(x), best(x)[0][:count].T * norms[:, None]


def _parts(rows: Complex[np.ndarray, "row line"]) -> Float[np.ndarray, "row parts"]:
    return np.concatenate([np.real(rows), np.imag(rows)], axis=1)


def band_peak(
    x: Float[np.ndarray, "level time"], fs: float, order: int, band_hz: tuple[float, float]
) -> float:
    """Return the largest displacement [m] in a band, from responses of a given derivative order."""
    freq = np.fft.rfftfreq(x.shape[1], 1 / fs)
    in_band = (freq > 0) & lines_within(freq, band_hz)
    factor = np.where(in_band, (2j * np.pi * np.where(in_band, freq, 1.0)) ** -order, 0.0)
    return float(np.max(np.abs(np.fft.irfft(factor * np.fft.rfft(x), x.shape[1]))))


def lines_of_motions(
    levels: Iterable[tuple[int, str, Float[np.ndarray, " time"], Float[np.ndarray, " time"]]],
    fs: float,
    order: int,
) -> list[MotionSpectra]:
    """Return the spectra of each test, weakest first, from (test number, point, source, response).

    Responses are derivatives of displacement of this order. A motion that is observed at several
    points appears as several levels.
    """
    motions: dict[int, tuple[Reals, dict[str, Reals]]] = {}
    for number, point, source, x in sorted(levels, key=lambda level: np.mean(level[3] ** 2)):
        motions.setdefault(number, (source, {}))[1].setdefault(point, x)
    motion_lines = []
    for source, seen in motions.values():
        omega = 2 * np.pi * np.fft.rfftfreq(len(source), 1 / fs)[1:]
        factor = (1j * omega) ** order
        rows = {point: np.fft.rfft(x)[1:] / factor for point, x in seen.items()}
        motion_lines.append(MotionSpectra(omega, np.fft.rfft(source)[1:], rows))
    return motion_lines
