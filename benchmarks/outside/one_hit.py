"""Does one hammer blow predict what a shaker test at the same amplitude shows?

    python -m benchmarks.outside.one_hit [--campaigns 20] [--seed N] [--law LAW ...] [--out FILE]

One decay of a mode with a joint and its modal mass are all that jbw gets; no law is stated. Force
levels are those whose resonance has about 80, 40 and 20 % of the hit's displacement. Frequency and
height of each are compared with the plant's steady state, simulated under that force. One harmonic
gives the force alone, as the height that it gives is up to 0.7 % off:

    A(Y) = min over w of Y |K(Y) - w^2 + j (c w + D(Y))|

The table has, by law, how often both are near enough (5 % of the height, 0.05 % of the frequency),
how often 99 % intervals contain the truth to the accuracy of the plant, and how wide they are: the
mean half width over 2.58 times the rms error, one of a calibrated Gaussian.
"""

import json
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from .by_law import judge_each
from .campaigns import Campaign, Member
from .files import TIMES, write_campaign
from .plants import Rng, kappa
from .records import Choice, Drawn, Specimen, decay, recorded, specimen
from .simulator import STEPS_A_PERIOD, Plant, march

SHARES = (0.8, 0.4, 0.2)  # amplitudes relative to the blow's largest displacement
DAMPING = (2e-3, 0.03)
NOISE = (1e-4, 0.01)
# relative errors that are as small as between shaker tests of two days
NEAR_HEIGHT, NEAR_HZ = 0.05, 5e-4
TIME_CONSTANTS = 14  # time until the motion is steady to 1e-6, in time constants
# Relative errors of the simulated plant: from its steps, and from sliders in place of a continuous
# law.
FLOORS = {"frequency": 2e-5, "displacement": 1e-3}
QUANTITIES = tuple(FLOORS)


def hit(rng: Rng, law: str) -> tuple[Specimen, Drawn]:
    """Draw a structure with a strong law, and its decay after a blow."""
    while True:
        try:
            one = specimen(rng, "decay", Choice(law=law, strong=True, zeta=DAMPING, noise=NOISE))
            return one, recorded(rng, decay(rng, one))
        except FloatingPointError:
            continue


def true_resonance(plant: Plant, y: float) -> tuple[float, float, float]:
    """Return force, frequency and height of the resonance at a first harmonic of about y.

    The force is that of one harmonic; frequency and height are simulated under it.
    """
    stiffness = kappa(plant, y)
    c, x = 2 * plant.zeta * plant.omega_n, stiffness.real
    for _ in range(50):
        x = stiffness.real - c**2 / 2 - c * stiffness.imag / (2 * np.sqrt(x))
    w = float(np.sqrt(x))
    force = y * abs(stiffness - x + 1j * c * w)
    half = plant.zeta + abs(stiffness.imag) / 2

    def below(at: float) -> float:
        return -steady_height(plant, force, at, y)

    trials = w * (1 + half * np.linspace(-1, 1, 9))
    i = int(np.clip(np.argmin([below(at) for at in trials]), 1, 7))
    found = minimize_scalar(
        below, bounds=trials[[i - 1, i + 1]], method="bounded", options={"xatol": 1e-4 * half}
    )
    return force, float(found.x), -float(found.fun)


def steady_height(plant: Plant, force: float, w: float, y: float) -> float:
    """Return the first harmonic of the displacement under a sine, simulated until it is steady."""
    periods = int(TIME_CONSTANTS / (2 * np.pi * plant.zeta)) + 3
    count, fs = periods * STEPS_A_PERIOD + 1, STEPS_A_PERIOD * w / (2 * np.pi)
    half_steps = force * np.cos(np.pi / STEPS_A_PERIOD * np.arange(2 * count - 1))
    last = march(plant, half_steps, fs, 1, (0.0, y * w))[0, -STEPS_A_PERIOD - 1 : -1]
    turn = np.exp(-2j * np.pi / STEPS_A_PERIOD * np.arange(STEPS_A_PERIOD))
    return float(2 * abs(np.mean(last * turn)))


def judged(rng: Rng, law: str, folder: Path) -> dict[str, Any]:
    """Identify a structure from one blow, and compare its resonances under forces."""
    one, drawn = hit(rng, law)
    made = Campaign("one hit", one, (Member("hit", drawn, 1.0),), {})
    path = write_campaign(folder, made, rng, TIMES)
    text = path.read_text().replace(
        "[campaign]\n", f"[campaign]\nmodal_mass = {drawn.mass:.9g}\n", 1
    )
    path.write_text(text)
    newton = drawn.mass * drawn.length * (2 * np.pi * drawn.hz) ** 2
    truths = [true_resonance(drawn.plant, share * drawn.top) for share in SHARES]
    row = {"law": law, "zeta": drawn.zeta, "noise": drawn.noise, "hz": drawn.hz}
    row["true"] = {
        "frequency": [w * drawn.hz for _, w, _ in truths],
        "displacement": [height * drawn.length for _, _, height in truths],
    }
    return row | _answer(path, [force * newton for force, _, _ in truths])


def _answer(path: Path, levels: list[float]) -> dict[str, Any]:
    """Return the law of a quick fit and its resonances with intervals, or why there is none."""
    import jbw
    from jbw.errors import JbwError

    jbw.enable_x64()
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            study = jbw.identify(jbw.load_campaign(path), quick=True, report=lambda _: None)
            found = study.resonance(levels)
        except JbwError as error:
            return {"refused": f"{type(error).__name__}: {' '.join(str(error).split())}"}
    return {
        "laws": json.loads(str(study.tree.attrs["laws"])),
        "seconds": time.process_time() - begun,
        "withheld": found["withheld"].values.tolist(),
        "warnings": str(found.attrs["warnings"]),
        **{name: found[name].values.tolist() for name in QUANTITIES},
    }


def is_near(row: dict[str, Any], level: int) -> bool:
    """Return whether the medians of frequency and height at a level are near the truth."""
    errors = [row[name][1][level] / row["true"][name][level] - 1 for name in QUANTITIES]
    return abs(errors[0]) < NEAR_HZ and abs(errors[1]) < NEAR_HEIGHT


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return accuracy, coverage and width of intervals, by law and quantity, in Markdown."""
    heads = ("law", "hits", "refused", "near at 80 %", "near at all")
    heads += tuple(f"{name} {what}" for name in QUANTITIES for what in ("inside", "width"))
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for law in [*dict.fromkeys(row["law"] for row in rows), "all"]:
        those = [row for row in rows if law in {row["law"], "all"}]
        told = [row for row in those if "refused" not in row]
        cells = [law, len(those), len(those) - len(told)]
        cells += [sum(is_near(row, 0) for row in told)]
        cells += [sum(all(is_near(row, i) for i in range(len(SHARES))) for row in told)]
        for name in QUANTITIES:
            values = np.array([row[name] for row in told], float)  # axes: row, quantile, level
            truth = np.array([row["true"][name] for row in told])
            low, middle, high = np.moveaxis(values, 1, 0) if len(told) else (truth,) * 3
            known = np.isfinite(low)
            floor = FLOORS[name] * truth
            is_inside = (low - floor <= truth) & (truth <= high + floor)
            inside = np.mean(is_inside[known]) if known.any() else np.nan
            half = ((high - low) / (2 * truth))[known]
            error = ((middle - truth) / truth)[known]
            width = np.mean(half) / 2.58 / np.sqrt(np.mean(error**2)) if known.any() else np.nan
            cells += [f"{100 * inside:.0f} %", f"{width:.2f}"]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw and identify structures, and print the table."""
    judge_each("one_hit", lambda rng, law, _, folder: judged(rng, law, folder), table, arguments)


if __name__ == "__main__":
    main()
