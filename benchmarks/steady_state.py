"""How long does the periodic response at five probing tones take, and how exact is it?

    python benchmarks/steady_state.py

One table: the harmonic balance against integrating from rest until the transient has died, in C
(compiled here when a C compiler is found) and through `simulate`, and against shooting. All
alternate in one process, so the ratios hold on a shared machine; each turn is three calls, of which
the first finds the caches cold, and the least time of all counts.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.response import simulate
from jbw.oscillator.shooting import shooting
from jbw.oscillator.steady import steady_state

JOINT = BoucWen(2 * np.pi * 18.8, 0.00444, 497.40, 340.21, 32.84)
TONES = 2 * np.pi * np.array([5.0, 5.5, 6.0, 6.5, 6.75])
AMPLITUDE = 9.0
FS, NUM_SAMPLES = 1024, 65536
# The last 32 s hold whole periods of every tone.
LAST = 32 * FS
REPEATS, CALLS = 31, 3

C_SOURCE = r"""
#include <math.h>
static void rate(const double *p, double u, const double *x, double *r) {
    r[0] = x[1];
    r[1] = u - 2 * p[1] * p[0] * x[1] - (p[0] * p[0] - p[2]) * x[0] - x[2];
    r[2] = p[2] * x[1] - p[4] * fabs(x[1]) * x[2] - p[3] * x[1] * fabs(x[2]);
}
void tone(const double *p, double omega, double amplitude, int n, double fs, double *y) {
    double x[3] = {0, 0, 0}, h = 1 / fs, a[3], b[3], c[3], d[3], s[3];
    double u0 = amplitude, um, u1;
    for (int i = 0; i < n; i++) {
        y[i] = x[0];
        um = amplitude * cos(omega * (i + 0.5) * h);
        u1 = amplitude * cos(omega * (i + 1) * h);
        rate(p, u0, x, a);
        for (int j = 0; j < 3; j++) s[j] = x[j] + 0.5 * h * a[j];
        rate(p, um, s, b);
        for (int j = 0; j < 3; j++) s[j] = x[j] + 0.5 * h * b[j];
        rate(p, um, s, c);
        for (int j = 0; j < 3; j++) s[j] = x[j] + h * c[j];
        rate(p, u1, s, d);
        for (int j = 0; j < 3; j++) x[j] += h / 6 * (a[j] + 2 * b[j] + 2 * c[j] + d[j]);
        u0 = u1;
    }
}
"""


def compiled_tone(folder: Path) -> Callable[[], np.ndarray] | None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    (folder / "tone.c").write_text(C_SOURCE)
    target = folder / "tone.so"
    command = [compiler, "-O3", "-march=native", "-shared", "-fPIC", "-o", target, "tone.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    tone = ctypes.CDLL(str(target)).tone
    pointer = np.ctypeslib.ndpointer(float)
    tone.argtypes = [
        pointer,
        ctypes.c_double,
        ctypes.c_double,
        ctypes.c_int,
        ctypes.c_double,
        pointer,
    ]
    tone.restype = None
    parameters = np.array([JOINT.omega_n, JOINT.zeta, JOINT.alpha, JOINT.delta, JOINT.gamma])
    y = np.empty((TONES.size, NUM_SAMPLES))

    def run() -> np.ndarray:
        for row, omega in zip(y, TONES, strict=True):
            tone(parameters, omega, AMPLITUDE, NUM_SAMPLES, FS, row)
        return y

    return run


def harmonics_of(y: np.ndarray) -> np.ndarray:
    """Y_1 and Y_3 by Fourier's integral over the last whole periods."""
    t = np.arange(NUM_SAMPLES - LAST, NUM_SAMPLES) / FS
    orders = np.array([1, 3])
    basis = np.exp(-1j * TONES[:, None, None] * orders[:, None] * t)
    return 2.0 * np.mean(y[:, None, -LAST:] * basis, axis=-1)


def rows(folder: Path) -> dict[str, tuple[Callable[[], object], Callable[[object], np.ndarray]]]:
    t = np.arange(NUM_SAMPLES) / FS
    u = AMPLITUDE * np.cos(TONES[:, None] * t)
    shoot = jax.jit(jax.vmap(lambda omega: shooting(JOINT, omega, AMPLITUDE).harmonics))
    routes = {
        "harmonic balance, 8 harmonics": (lambda: steady_state(JOINT, TONES, AMPLITUDE), None),
        "harmonic balance, 4 harmonics": (lambda: steady_state(JOINT, TONES, AMPLITUDE, 4), None),
        "shooting": (lambda: shoot(TONES), None),
        "simulate, 64 s from rest": (lambda: simulate(JOINT, u, FS).y, harmonics_of),
    }
    run = compiled_tone(folder)
    if run is not None:
        routes["C RK4, 64 s from rest"] = (run, harmonics_of)
    return {
        name: (call, reduce or (lambda found: found[:, :2]))
        for name, (call, reduce) in routes.items()
    }


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    exact = np.asarray(steady_state(JOINT, TONES, AMPLITUDE, num_harmonics=32))[:, :2]
    with tempfile.TemporaryDirectory() as folder:
        routes = rows(Path(folder))
        times = {name: [] for name in routes}
        errors = {}
        for name, (call, reduce) in routes.items():
            found = reduce(np.asarray(call()))
            errors[name] = np.max(np.abs(found - exact) / np.abs(exact), axis=0)
        for _ in range(REPEATS):
            for name, (call, _) in routes.items():
                for _ in range(CALLS):
                    start = time.perf_counter()
                    jax.block_until_ready(call())
                    times[name].append(time.perf_counter() - start)
    least = {name: min(elapsed) for name, elapsed in times.items()}
    reference = least[list(least)[-1]]
    print(f"jax {jax.__version__}, {REPEATS} alternating turns, five tones at {AMPLITUDE:g} N/kg\n")
    print(f"| route | min, ms | / {list(least)[-1]} | error of Y_1 | error of Y_3 |")
    print("|---|---|---|---|---|")
    for name, value in least.items():
        first, third = errors[name]
        ratio = value / reference
        print(f"| {name} | {1e3 * value:.2f} | {ratio:.3f} | {first:.0e} | {third:.0e} |")


if __name__ == "__main__":
    main()
