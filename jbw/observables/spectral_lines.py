"""Records compared in a band: the lines of their spectra, where other modes do not matter."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import DataError

Lines = tuple[int, int]  # the first line of a spectrum that counts, and the one after the last


def lines_of(band_hz: Sequence[float], length: int, fs: float) -> Lines | None:
    """First line of a record's spectrum in a band, and the one after the last; None without a band.

    Args:
        band_hz: Lowest and highest frequency [Hz], or nothing.
        length: Samples of the record.
        fs: Sampling frequency [Hz].

    Raises:
        DataError: If the band holds no line.
    """
    if not band_hz:
        return None
    first, last = np.ceil(band_hz[0] * length / fs), np.floor(band_hz[1] * length / fs)
    lines = max(int(first), 1), min(int(last), (length - 1) // 2) + 1
    if lines[1] <= lines[0]:
        raise DataError(
            f"Key `band` must hold a line of the records' spectra, which lie {fs / length:.3g} Hz "
            f"apart up to {fs / 2:g} Hz, but is {list(band_hz)}.",
            remedy="Widen the band, or leave it out.",
        )
    return lines


def in_band(samples: np.ndarray, lines: Lines | None) -> np.ndarray:
    """Samples along the last axis with nothing left but some lines of their spectrum."""
    if lines is None:
        return samples
    spectrum = np.fft.rfft(samples)
    kept = np.zeros_like(spectrum)
    kept[..., lines[0] : lines[1]] = spectrum[..., lines[0] : lines[1]]
    return np.fft.irfft(kept, samples.shape[-1])


def noise_share(lines: Lines | None, length: int) -> float:
    """Share of white noise that is left in some lines of its spectrum, as a standard deviation."""
    return 1.0 if lines is None else float(np.sqrt(2 * (lines[1] - lines[0]) / length))


def values_of(
    samples: Float[Array, "*batch time"], lines: Lines | None
) -> Float[Array, "*batch value"]:
    r"""What is compared of samples: themselves, or the lines of a band, of the same sum of squares.

    $$\sqrt{2/N}\,(\mathrm{Re}\,X_n, \mathrm{Im}\,X_n)$$
    """
    if lines is None:
        return samples
    spectrum = jnp.fft.rfft(samples)[..., lines[0] : lines[1]]
    scale = np.sqrt(2 / samples.shape[-1])
    return scale * jnp.concatenate([spectrum.real, spectrum.imag], axis=-1)
