"""What is the motion of modes under random forces, and of one under a sine too, without jbw?

    python benchmarks/random_modes.py --json tests/golden_random_modes.json

The force is Gaussian with a flat spectrum in a band, drawn by its Fourier transform in blocks, plus
a sine; `random_modes.c` integrates modes with Bouc-Wen joints. Standard errors are those of the
mean over blocks. Linear modes check the procedure against Miles' closed form.
"""

import ctypes
import json
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from timing import options

SOURCE = Path(__file__).with_suffix(".c")
FS, BLOCK, BLOCKS = 2048.0, 2**20, 24
TAU = 2 * np.pi
TWO_JOINTS = {
    "hz": [20.0, 47.0], "zeta": [0.004, 0.005], "h": [[1.0, -0.8], [0.6, 0.9]], "b": [1.0, 0.9],
    "c": [1.0, 0.7], "joints": [[1200.0, 300.0, 60.0], [2500.0, 200.0, 90.0]],
}  # fmt: skip
ONE_MODE = {
    "hz": [20.0], "zeta": [0.002], "h": [[1.0]], "b": [1.0], "c": [1.0],
    "joints": [[0.1 * (TAU * 20.0) ** 2, 400.0, 20.0]],
}  # fmt: skip
# structure, band [Hz], density [(m/s^2)^2/Hz], amplitude [m/s^2] and frequency [Hz] of the sine
CASES = {
    "linear": ({**TWO_JOINTS, "joints": [[0.0, 1.0, 1.0]] * 2}, (12.0, 75.0), 0.01, 0.0, 30.0),
    "first mode": (TWO_JOINTS, (12.0, 28.0), 0.3, 0.0, 30.0),
    "second mode": (TWO_JOINTS, (36.0, 60.0), 10.0, 0.0, 30.0),
    "both modes, weak": (TWO_JOINTS, (12.0, 75.0), 1e-4, 0.0, 30.0),
    "both modes, strong": (TWO_JOINTS, (12.0, 75.0), 0.3, 0.0, 30.0),
    "sine below": (ONE_MODE, (5.0, 80.0), 2e-3, 5.0, 13.1),
    "sine below, strong": (ONE_MODE, (5.0, 80.0), 2e-3, 20.0, 13.1),
    "sine above": (ONE_MODE, (5.0, 80.0), 2e-3, 20.0, 31.7),
    "no sine": (ONE_MODE, (5.0, 80.0), 2e-3, 0.0, 13.1),
}


def library():
    target = str(Path(tempfile.mkdtemp()) / "random_modes.so")
    command = ["cc", "-O3", "-march=native", "-shared", "-fPIC", str(SOURCE), "-o", target, "-lm"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(target).motion


def force(rng, band, density):
    """Return a periodic block of a force with a given density in a band."""
    freq = np.fft.rfftfreq(BLOCK, 1 / FS)
    inside = (freq >= band[0]) & (freq <= band[1])
    # A line of one-sided density G has the mean square G fs / N.
    parts = rng.standard_normal((2, freq.size)) * np.sqrt(density * FS / BLOCK / 2)
    spectrum = np.where(inside, parts[0] + 1j * parts[1], 0.0) * BLOCK / np.sqrt(2)
    return np.fft.irfft(spectrum, BLOCK)


def monte_carlo(motion, case, seed, blocks):
    structure, band, density, amplitude, hz = CASES[case]
    omega = TAU * np.array(structure["hz"])
    h = np.array(structure["h"])
    arrays = [omega**2, 2 * np.array(structure["zeta"]) * omega, np.array(structure["b"]), h,
              np.array(structure["joints"]), np.array(structure["c"])]  # fmt: skip
    state, rng, rows = np.zeros(2 * omega.size + len(h)), np.random.default_rng(seed), []
    pointer = ctypes.POINTER(ctypes.c_double)
    turn, t, last = TAU * hz / FS, np.arange(BLOCK + 1), force(rng, band, density)
    for block in range(blocks + 1):
        ahead, sums = force(rng, band, density), np.zeros(5)
        phase = (turn * BLOCK * block) % TAU
        u = np.append(last, ahead[0]) + amplitude * np.cos(phase + turn * t)
        last, places = ahead, [np.ascontiguousarray(x, float) for x in (*arrays, u)]
        motion(ctypes.c_long(omega.size), ctypes.c_long(len(h)),
               *(x.ctypes.data_as(pointer) for x in places), ctypes.c_long(BLOCK),
               ctypes.c_double(1 / FS), ctypes.c_double(turn), ctypes.c_double(phase),
               state.ctypes.data_as(pointer), sums.ctypes.data_as(pointer))  # fmt: skip
        if block:  # The first block contains the transient.
            rows.append(sums / BLOCK)
    rows = np.array(rows)
    mean, error = rows.mean(0), rows.std(0, ddof=1) / np.sqrt(blocks)
    sine = 2 * abs(mean[3] - 1j * mean[4]) if amplitude else 0.0
    random = np.sqrt(mean[1] - mean[0] ** 2 - 0.5 * sine**2)
    return {
        "structure": structure, "band_hz": band, "density": density, "amplitude": amplitude,
        "sine_hz": hz, "rms_y": [random, error[1] / (2 * random)],
        "sine_y": [sine, 2 * float(np.hypot(*error[3:]))], "seconds": blocks * BLOCK / FS,
    }  # fmt: skip


def main():
    parser = options(__doc__, calls=BLOCKS)
    parser.add_argument("--cases", default=",".join(CASES), help="some of " + "; ".join(CASES))
    chosen = parser.parse_args()
    motion, found = library(), {}
    names = [name for name in CASES if name in chosen.cases]
    for i, case in enumerate(names):
        start = time.process_time()
        found[case] = monte_carlo(motion, case, [58, i], chosen.calls)
        print(case, found[case]["rms_y"], found[case]["sine_y"], end=" ")
        print(f"{time.process_time() - start:.0f} s", flush=True)
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
