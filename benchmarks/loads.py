"""What do resonances, response curves and random vibration of 100 draws cost at three levels?

    python benchmarks/loads.py

Times are CPU seconds of this process after imports. The first call compiles.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Sequence
from time import process_time
from typing import Any

import numpy as np
from timing import Table, Target, options, show, targets

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


def cost(what: Callable[[], Any], calls: int) -> list[float]:
    """Return the CPU seconds of the first call, and the mean of those of later calls."""
    seconds = []
    for _ in range(calls + 1):
        start = process_time()
        what()
        seconds.append(process_time() - start)
    return [seconds[0], float(np.mean(seconds[1:]))]


def table(calls: int) -> tuple[Table, Table]:
    """Return a row for each law and kind of prediction, and the table of targets."""
    rows = []
    for law, (theta, levels) in LAWS.items():
        for name, what in predictions(law, theta, np.array([levels])).items():
            rows.append((law, name, *cost(what, calls)))
    columns = {"law": "", "prediction": "", "first [CPU s]": ".2f", "next [CPU s]": ".2f"}
    entries = [
        Target("first call, most [CPU s]", max(row[2] for row in rows), 4.0, 2.0),
        Target("next calls, most [CPU s]", max(row[3] for row in rows), 1.0, 0.5),
    ]
    return Table("100 draws at three levels", columns, rows), targets(entries)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table of costs."""
    chosen = options(__doc__, calls=3).parse_args(arguments)
    jbw.enable_x64()
    show(table(chosen.calls), file=chosen.json)


def predictions(
    law: str, theta: dict[str, float], level: np.ndarray
) -> dict[str, Callable[[], Any]]:
    """Return the timed predictions, for 100 draws of a law."""
    rng = np.random.default_rng(58)
    omega = 2 * np.pi * np.linspace(18.5, 20.5, 241)
    draws = {name: x * (1 + 0.01 * rng.standard_normal(100)) for name, x in theta.items()}
    motion = equivalent_motion(oscillator_of(draws, (law,)))

    def curves() -> list[Any]:
        peak = peaks(motion, level)
        return [swept(motion, peak, omega, upward=upward) for upward in (True, False)]

    def random() -> Any:
        return random_response(motion, lambda f: np.full_like(f, 0.002), np.ones((100, 1)))

    named = {"resonances": lambda: resonance(motion, level), "curves, both ways": curves}
    return named | {"random vibration": random}


if __name__ == "__main__":
    main()
