"""What is the random response of slipping joints, computed by Monte Carlo without jbw?

    python benchmarks/random_motion.py --json tests/golden_random.json

The force is Gaussian with a flat spectrum between 5 and 80 Hz, drawn by its Fourier transform at
640 Hz in blocks of 32,768 periods; `random_motion.c` integrates. Standard errors are those of the
mean over blocks. A linear joint checks the procedure against its closed form.
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
FS, BLOCK, BLOCKS = 640.0, 2**20, 64
BAND = (5.0, 80.0)
OMEGA_N = 2 * np.pi * 20.0
K_T, F_S, CHI, BETA = 0.2 * OMEGA_N**2, 2.0, -0.5, 0.5
PHI_MAX = F_S * (1 + BETA) / (K_T * (BETA + (CHI + 1) / (CHI + 2)))
LOST = K_T * PHI_MAX ** -(1 + CHI) / ((1 + BETA) * (2 + CHI))
# number of the law in C, damping ratio, parameters, stiffness at rest, levels [(m/s^2)^2/Hz]
LAWS = {
    "linear": (1, 0.01, (0.0, 1.0), 0.0, (0.01,)),
    "bouc_wen": (
        0, 0.002, (0.1 * OMEGA_N**2, 400.0, 20.0), 0.1 * OMEGA_N**2, (1e-4, 2e-3, 3e-2),
    ),
    "jenkins": (
        1, 0.005, (0.05 * OMEGA_N**2, 2e-4), 0.05 * OMEGA_N**2, (1e-3, 1e-2, 1e-1),
    ),
    "iwan4": (2, 0.002, (K_T, CHI, PHI_MAX, LOST, F_S), K_T, (1e-3, 2e-2, 2e-1)),
}  # fmt: skip


def library():
    folder = tempfile.mkdtemp()
    target = str(Path(folder) / "random_motion.so")
    command = ["cc", "-O3", "-march=native", "-shared", "-fPIC", str(SOURCE), "-o", target, "-lm"]
    subprocess.run(command, check=True)
    array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    motion = ctypes.CDLL(target).motion
    double, long = ctypes.c_double, ctypes.c_long
    motion.argtypes = [long, array, double, double, array, long, double, array, array]
    return motion


def force(rng, psd):
    """Return a periodic block of a force, extended at both ends by its own samples."""
    freq = np.fft.rfftfreq(BLOCK, 1 / FS)
    inside = (freq >= BAND[0]) & (freq <= BAND[1])
    # A line of one-sided density G has the mean square G fs / N.
    parts = rng.standard_normal((2, freq.size)) * np.sqrt(psd * FS / BLOCK / 2)
    spectrum = np.where(inside, parts[0] + 1j * parts[1], 0.0) * BLOCK / np.sqrt(2)
    u = np.fft.irfft(spectrum, BLOCK)
    return np.concatenate([u[-1:], u, u[:2]])


def monte_carlo(motion, law, psd, seed, blocks):
    number, zeta, parameters, stiffness, _ = LAWS[law]
    rng, state, means = np.random.default_rng(seed), np.zeros(4), []
    k, c = OMEGA_N**2 - stiffness, 2 * zeta * OMEGA_N
    for block in range(blocks + 1):
        sums = np.zeros(3)
        u = force(rng, psd)
        motion(number, np.array(parameters), k, c, u, BLOCK, 1 / FS, state, sums)
        if block:  # The first block contains the transient.
            means.append(sums / BLOCK)
    means = np.array(means)
    mean, error = means.mean(0), means.std(0, ddof=1) / np.sqrt(blocks)
    rms = np.sqrt(mean[:2])
    return {
        "psd": psd,
        "rms_y": [rms[0], error[0] / (2 * rms[0])],
        "rms_v": [rms[1], error[1] / (2 * rms[1])],
        "kurtosis_y": mean[2] / mean[0] ** 2,
        "periods": blocks * BLOCK * 20.0 / FS,
    }


def main():
    parser = options(__doc__, calls=BLOCKS)
    parser.add_argument("--laws", default=",".join(LAWS), help="some of " + ", ".join(LAWS))
    chosen = parser.parse_args()
    motion, found = library(), {}
    for law in chosen.laws.split(","):
        found[law] = []
        for i, psd in enumerate(LAWS[law][-1]):
            start = time.process_time()
            found[law].append(monte_carlo(motion, law, psd, [58, i], chosen.calls))
            print(law, found[law][-1], f"{time.process_time() - start:.0f} s", flush=True)
    if "linear" in found:
        found["linear"][0]["closed_form"] = closed_form()
    found["band_hz"] = BAND
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(found, indent=1) + "\n")


def closed_form():
    """Return the rms displacement of a linear joint in the band, by the trapezium rule."""
    zeta, (psd,) = LAWS["linear"][1], LAWS["linear"][4]
    freq = np.linspace(*BAND, 2**21)
    x = 2 * np.pi * freq
    gain = 1 / ((OMEGA_N**2 - x**2) ** 2 + (2 * zeta * OMEGA_N * x) ** 2)
    return float(np.sqrt(psd * np.trapezoid(gain, freq)))


if __name__ == "__main__":
    main()
