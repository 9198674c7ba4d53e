r"""Harmonics by order along one sweep: the response demodulated by multiples of the source's phase.

$$u = A \cos\phi(t), \qquad
  y \approx \mathrm{Re} \sum_{n=1}^{N} Y_n(t)\, e^{jn\phi(t)}$$

The source's phase phi is that of its analytic signal, so that a sweep may be linear, exponential or
any other, and up or down; each order is fitted in windows of a few periods, linear within, all
orders at once. It is Farina's and Novak's separation of a sweep's orders without its demand for an
exponential one; like theirs it holds where the response follows the sweep.

Reference:
    Farina (2000), 108th AES Convention, 5093; Novak, Lotton and Simon (2015), Journal of the Audio
    Engineering Society 63, 786.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike, NDArray
from scipy.signal import hilbert

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import Reals, channel, same_length, sampling

PERIODS = 10.0  # of the source in a window
SPACING = 0.5  # of a window: from one to the next
QUIET = 0.02  # of the source's largest amplitude: below, nothing is driven
FEWEST = 4  # windows
MOST_STRAY = 0.1  # of a sweep's source from one tone with its harmonics, within a window


class SweptHarmonics(NamedTuple):
    """Harmonics at the frequencies that a sweep passes, in the order of time."""

    freq: Reals  # of the source [Hz]
    source: Complex[np.ndarray, "order window"]  # of the source by itself; order 1 its amplitude
    response: Complex[np.ndarray, "order window"]  # complex peaks, phase from n times the source's
    std: Reals  # of a real component of the response's harmonics, by what the fit leaves


def swept_harmonics(
    u: ArrayLike, y: ArrayLike, fs: float, *, num_orders: int = 5, periods: float = PERIODS
) -> SweptHarmonics:
    """Harmonics of a response along a sweep, by windows of so many periods of the source.

    A harmonic below the noise comes out as the noise, which `std` tells. Orders above half the
    sampling frequency are NaN there.

    Args:
        u: Source, shape (time,) or (repeat, time), whose mean is taken.
        y: Response, of the same shape.
        fs: Sampling frequency [Hz].
        num_orders: Highest order.
        periods: Length of a window; fewer follow a resonance better, more tell noise better.

    Raises:
        DataError: NaN, unequal shapes, a dead source, too short a sweep, or a source that is none.
        ConfigError: An option that cannot be meant.
    """
    u, y, fs = channel(u, "u"), channel(y, "y"), sampling(fs)
    same_length(u=u, y=y)
    if num_orders < 1 or periods < 3:
        raise ConfigError(
            f"Arguments `num_orders` and `periods` must be at least 1 and 3, but are {num_orders} "
            f"and {periods:g}."
        )
    u, y = np.atleast_2d(u).mean(axis=0), np.atleast_2d(y).mean(axis=0)
    if np.ptp(u) == 0:
        raise DataError("Channel `u` is constant.", why="A dead source excites nothing.")
    signal = np.asarray(hilbert(u - u.mean()))
    phase = np.unwrap(np.angle(signal))
    if phase[-1] < phase[0]:
        phase = -phase
    windows = _windows(np.abs(signal), phase, periods)
    if len(windows) < FEWEST:
        raise DataError(
            f"A sweep must hold {FEWEST} windows of {periods:g} periods, but holds {len(windows)}.",
            remedy="Sweep more slowly, or shorten `periods`.",
        )
    rows = [_fitted(phase[w], u[w], y[w], fs, num_orders) for w in windows]
    freq, source, response, std, strays = (np.array(x) for x in zip(*rows, strict=True))
    if (stray := float(np.median(strays))) > MOST_STRAY:
        raise DataError(
            f"The source is no sweep: its amplitude strays by {stray:.0%} within {periods:g} "
            "periods.",
            why="Noise and multisines have no phase whose multiples were harmonics.",
        )
    return SweptHarmonics(freq, source.T, response.T, std)


def _windows(amplitude: Reals, phase: Reals, periods: float) -> list[slice]:
    """Windows of equal turns of the source where it drives anything, overlapping by half."""
    loud = np.flatnonzero(amplitude > QUIET * amplitude.max())
    turns = np.maximum.accumulate(phase) / (2 * np.pi)
    first, last = float(turns[loud[0]]), float(turns[loud[-1]])
    starts = np.arange(first, last - periods, SPACING * periods)
    ends = np.searchsorted(turns, np.stack([starts, starts + periods]))
    return [slice(int(a), int(b)) for a, b in ends.T]


def _fitted(
    phase: Reals, u: Reals, y: Reals, fs: float, num_orders: int
) -> tuple[float, NDArray[np.complex128], NDArray[np.complex128], float, float]:
    """Frequency [Hz], harmonics of both, standard deviation of the response's, source's rest."""
    x = np.linspace(-1.0, 1.0, len(phase))
    hz = float(np.polyfit(x, phase, 1)[0]) / (np.pi * (len(phase) - 1) / fs)
    shown = [n for n in range(1, num_orders + 1) if n * hz < 0.45 * fs]
    waves = [f(n * phase) for n in shown for f in (np.cos, np.sin)]
    # Amplitudes may change within a window as a parabola, and a drift may lie beneath.
    basis = np.column_stack([w * x**k for k in range(3) for w in waves] + [x**0, x])
    weight = np.cos(np.pi * x / 2)[:, None]
    # Normal equations: columns of like size, far from dependent, and many windows.
    rows = weight * basis
    both = np.linalg.solve(rows.T @ rows, rows.T @ (weight * np.column_stack([u, y])))
    residual = y - basis @ both[:, 1]
    stray = float(np.std(u - basis @ both[:, 0]) / np.std(u))
    degrees = max(len(y) - basis.shape[1], 1)
    std = float(np.sqrt(np.sum(residual**2) / degrees * 2 / (len(y) / 2)))
    amplitudes = np.full((2, num_orders), np.nan, complex)
    for i, n in enumerate(shown):
        amplitudes[:, n - 1] = both[2 * i] - 1j * both[2 * i + 1]
    # From the source's own fundamental, whatever its phase by the analytic signal.
    turn = np.exp(-1j * np.arange(1, num_orders + 1) * np.angle(amplitudes[0, 0]))
    return hz, amplitudes[0] * turn, amplitudes[1] * turn, std, stray


def largest_share(found: SweptHarmonics, order: int) -> tuple[float, float, float]:
    """Largest harmonic of an order over the largest fundamental, its noise, and where [Hz].

    What the source's own harmonic may make of itself is taken off: its share times the largest
    response over the source.
    """
    size = np.abs(found.response[0])
    row, source = np.abs(found.response[order - 1]), np.abs(found.source[order - 1])
    passed = np.max(size / np.abs(found.source[0])) * source
    excess: Float[np.ndarray, " window"] = np.where(np.isfinite(row), row - passed, -np.inf)
    i = int(np.argmax(excess))
    return max(float(excess[i] / size.max()), 0.0), float(found.std[i] / size.max()), found.freq[i]
