"""WAV: full scale is 1, so a calibration factor is needed; a truncated file is refused."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import scipy.io.wavfile

from jbw.measurement.files.tree import Contents, leaf


@contextmanager
def contents(path: Path) -> Iterator[Contents]:
    """Open a WAV file as `channel[0]`, `channel[1]`, ...: full scale of integer samples is 1."""
    with warnings.catch_warnings():
        # scipy only warns when the data chunk is cut short, and hands over half the samples.
        warnings.simplefilter("error", scipy.io.wavfile.WavFileWarning)
        warnings.filterwarnings("ignore", message=".*not understood.*")
        rate, samples = scipy.io.wavfile.read(path)
    channels = np.atleast_2d(samples.T)
    notes = {"full scale": str(samples.dtype)}
    yield Contents({"channel": leaf(_full_scale(channels))}, "WAV", fs=float(rate), notes=notes)


def _full_scale(samples: np.ndarray) -> np.ndarray:
    """Samples over full scale; 8-bit WAV is unsigned with its zero at 128."""
    if samples.dtype == np.uint8:
        return (samples.astype(np.float64) - 128) / 128
    if np.issubdtype(samples.dtype, np.integer):
        return samples / float(2 ** (8 * samples.dtype.itemsize - 1))
    return samples
