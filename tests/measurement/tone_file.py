"""A steady tone as two channels of a file, and a function that expects its refusal."""

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.measurement.files.read import read

FS = 1024.0
N = 3000
T = np.arange(N) / FS
DRIVE = np.sin(2 * np.pi * 5.1 * T + 1.0)
LASER = 0.3 * np.cos(2 * np.pi * 5.1 * T)
ROLES = {"input": "shaker", "velocity": "laser"}
UNITS = {"input": "V", "velocity": "m/s"}
UNITS_V = {"velocity": "m/s"}


def refused(path, *args, error=DataError, **kwargs):
    """Return the error of reading a file, with its text and remedy."""
    with pytest.raises(error) as caught:
        read(path, *args, **kwargs)
    return caught.value
