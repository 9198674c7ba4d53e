"""Cost of predictions under other loads: 100 draws, resonances and curves of three levels.

    python benchmarks/loads.py

CPU seconds of this process after imports. The bound is 4 for the first call, which compiles, and 1
for the next ones.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

import jbw
from jbw.forced import equivalent_motion, peaks, random_response, resonance, swept
from jbw.oscillator.oscillator import oscillator_of

OMEGA_N = 2 * np.pi * 20.0
LAWS = {
    "bouc_wen": (
        {
            "omega_n": OMEGA_N, "zeta": 0.002, "alpha": 0.1 * OMEGA_N**2, "delta": 400.0,
            "gamma": 20.0,
        },
        [0.01, 0.05, 0.08],
    ),
    "iwan4": (
        {
            "omega_n": OMEGA_N, "zeta": 0.002, "iwan_stiffness": 3158.0, "iwan_loss": 1380.0,
            "iwan_chi": -0.5, "iwan_beta": 0.5,
        },
        [0.05, 0.1, 0.2],
    ),
    "jenkins_1": (
        {"omega_n": OMEGA_N, "zeta": 0.005, "stiffness_1": 790.0, "slip_1": 2e-4},
        [0.02, 0.1, 0.2],
    ),
}  # fmt: skip


def cost(what: Callable[[], Any]) -> list[float]:
    """CPU seconds of the first call, and of the mean of three more."""
    start = process_time()
    what()
    first = process_time() - start
    start = process_time()
    for _ in range(3):
        what()
    return [first, (process_time() - start) / 3]


def main() -> None:
    """Print a line a law."""
    jbw.enable_x64()
    print("law        resonance         curves, both ways  random  [CPU s: first, next]")
    for law, (theta, levels) in LAWS.items():
        costs = [cost(what) for what in predictions(law, theta, np.array([levels]))]
        print(f"{law:10s}", *(f"{first:8.2f} {after:8.2f}" for first, after in costs))


def predictions(
    law: str, theta: dict[str, float], level: np.ndarray
) -> tuple[Callable[[], Any], ...]:
    """What is measured, of 100 draws of a law."""
    rng = np.random.default_rng(58)
    omega = 2 * np.pi * np.linspace(18.5, 20.5, 241)
    draws = {name: x * (1 + 0.01 * rng.standard_normal(100)) for name, x in theta.items()}
    motion = equivalent_motion(oscillator_of(draws, (law,)))

    def curves() -> list[Any]:
        peak = peaks(motion, level)
        return [swept(motion, peak, omega, upward=upward) for upward in (True, False)]

    def random() -> Any:
        return random_response(motion, lambda f: np.full_like(f, 0.002), np.ones((100, 1)))

    return lambda: resonance(motion, level), curves, random


if __name__ == "__main__":
    main()
