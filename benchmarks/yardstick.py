"""The C loops with which all solvers are compared; they need a C compiler."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).with_suffix(".c")
FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")
WIDTH = 16
REFERENCE_STEPS = 1024

_ARRAY = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
_LONG, _DOUBLE, _INT = ctypes.c_long, ctypes.c_double, ctypes.c_int


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled loops, or None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "yardstick.so")
        subprocess.run([compiler, *FLAGS, str(SOURCE), "-o", target, "-lm"], check=True)
        loops = ctypes.CDLL(target)
    loops.rk4.argtypes = [_ARRAY, _ARRAY, _LONG, _DOUBLE, _INT, _ARRAY]
    loops.rk4_lanes.argtypes = loops.rk4.argtypes
    loops.rk4_tone.argtypes = [_ARRAY, _DOUBLE, _DOUBLE, _LONG, _DOUBLE, _ARRAY]
    return loops


def rk4(parameters: Sequence[float], u: np.ndarray, fs: float, steps: int) -> np.ndarray:
    """Return the velocity at the samples of u, with `steps` RK4 steps per sample [m/s]."""
    v = np.empty(u.size)
    _loops().rk4(np.asarray(parameters, float), u, u.size, fs, steps, v)
    return v


def rk4_lanes(parameters: np.ndarray, u: np.ndarray, fs: float, steps: int) -> np.ndarray:
    """Return the velocity (time, WIDTH) for WIDTH parameter sets (5, WIDTH) at once [m/s]."""
    v = np.empty((u.size, WIDTH))
    _loops().rk4_lanes(parameters, u, u.size, fs, steps, v)
    return v


def rk4_tone(
    parameters: Sequence[float], omega: float, amplitude: float, num_samples: int, fs: float
) -> np.ndarray:
    """Return the displacement from rest under a tone, with one RK4 step per sample [m]."""
    y = np.empty(num_samples)
    _loops().rk4_tone(np.asarray(parameters, float), omega, amplitude, num_samples, fs, y)
    return y


def reference(parameters: Sequence[float], u: np.ndarray, fs: float) -> np.ndarray:
    """Return a velocity with an error of about 1e-10 [m/s], which falls as 1/steps^2."""
    return rk4(parameters, u, fs, REFERENCE_STEPS)


def _loops() -> ctypes.CDLL:
    loops = library()
    if loops is None:
        raise RuntimeError("The yardstick needs a C compiler, but neither gcc nor cc was found.")
    return loops
