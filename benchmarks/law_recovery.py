"""Does the posterior contain the truth, and is the right law preferred, for records of any law?

Campaigns of six sweeps come from the virtual rig, whose separate code integrates every law, with
parameters drawn again for each campaign. `jbw.compare_laws` gets each campaign with the true law
and its rivals; a sweep is a run, and each is left out in turn. Where the truth's rank among the
draws is a uniform number its z-score is standard normal. Results are appended to a file, one line
per campaign; earlier lines remain.

    python benchmarks/law_recovery.py --out FILE [--campaigns 50] [--only CASE] [--json FILE]
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy import stats
from timing import Table, options, show

import jbw
from jbw import rig
from jbw.inference.posterior.summary import scalars
from jbw.law_comparison.compare import LawComparison
from jbw.oscillator.laws import laws_named
from jbw.rig.generator import Sweep
from jbw.rig.presets import Preset

FS, OMEGA_N, ZETA, GAIN = 256.0, 2 * np.pi * 18.8, 0.00444, 15.0
SCATTER = 0.2  # sd of the logarithm of each of the law's parameters between campaigns
NOISE = 0.01  # noise relative to the rms of each record
NUM_LEVELS, REPEATS = 6, 2  # Each level is one run; fewer than five runs give no weights of laws.
RIVALS = ("cubic", "bouc_wen", "iwan4")
KNOWN = 0.25  # A parameter counts as identified if its sd relative to its mean is smaller.
COLUMNS = {
    "true law": "", "campaigns": "d", "z-scores": "d", "mean z": ".2f", "sd of z": ".2f",
    "p of Kolmogorov": ".2f", "within 99 %": ".3f", "compared": "d", "best": "d",
    "weight > 1/2": "d", "told apart from": "", "median time, s": ".0f",
}  # fmt: skip


@dataclass(frozen=True)
class Truth:
    """A law that generates records: its parameters, and the range of levels of the source."""

    law: str
    theta: Mapping[str, float]
    range: tuple[float, float]  # smallest and largest peak of the source [V]
    sure: tuple[str, ...] = ()  # parameters that do not vary: exponents and ratios


IWAN = {"iwan_stiffness": 1500.0, "iwan_loss": 217.0, "iwan_chi": -0.3, "iwan_beta": 0.5}
TRUTHS = {
    "Iwan-4 below macroslip": Truth("iwan4", IWAN, (0.005, 0.04), ("iwan_chi",)),
    "Iwan-4 past macroslip": Truth("iwan4", IWAN, (0.03, 0.3), ("iwan_chi",)),
    "gap in series": Truth(
        "gap_series",
        {"gap_stiffness": 700.0, "gap_softening": 300.0, "gap_opening": 100.0, "gap": 6e-4},
        (0.01, 0.08),
    ),
    "Bouc-Wen of nu = 0.5": Truth(
        "bouc_wen_nu",
        {"nu_stiffness": 497.4, "nu_softening": 0.3, "nu_opening": 0.1, "nu": 0.5},
        (0.01, 0.08), ("nu",),
    ),
    "Jenkins, three sliders": Truth(
        "jenkins_3",
        {
            "stiffness_1": 300.0, "slip_1": 5e-4, "stiffness_2": 250.0, "slip_ratio_2": 3.0,
            "stiffness_3": 200.0, "slip_ratio_3": 8 / 3,
        },
        (0.03, 0.3), ("slip_ratio_2", "slip_ratio_3"),
    ),
}  # fmt: skip


def made(truth: Truth, seed: int) -> tuple[Any, dict[str, float]]:
    """Return a campaign on the rig, and the true values of its law's parameters by name."""
    rng = np.random.default_rng([seed, len(truth.law)])
    theta = {
        name: value * (1.0 if name in truth.sure else np.exp(SCATTER * rng.standard_normal()))
        for name, value in truth.theta.items()
    }
    (kind,) = laws_named((truth.law,))
    joint = jbw.Oscillator(OMEGA_N, ZETA, (kind.build(theta),))
    levels = np.geomspace(*truth.range, NUM_LEVELS)
    plans = tuple(
        rig.Plan(
            f"sweep_{1e3 * level:.1f}mV", "sweep",
            Sweep(12.0, 26.0, level, burst=3.0, fade=0.2, duration=4.0), repeats=REPEATS,
        )
        for level in levels
    )  # fmt: skip
    preset = Preset(
        name="law recovery", gain=GAIN, input_range=1.0, velocity_range=2.0, plans=plans,
        noise_ratio=NOISE,
    )  # fmt: skip
    campaign = rig.measure(preset, joint=joint, seed=seed, fs=FS)
    every = {"fit_levels": [test.level for test in campaign.tests], "fit_repeats": REPEATS}
    settings = campaign.settings.model_copy(update={"prior": {}, "fit": None, **every})
    return replace(campaign, settings=settings), {"omega_n": OMEGA_N, "zeta": ZETA, **theta}


def ranks(compared: LawComparison, law: str, truth: Mapping[str, float]) -> dict[str, list[float]]:
    """Return the rank of the true values among the true law's draws, and the draws' sd over mean.

    Ranks are between 0 and 1.
    """
    draws = scalars(compared.tree[f"laws/{law}"])
    found = {}
    for name in (name for name in truth if name in draws):
        values = np.ravel(draws[name])
        rank = (np.sum(values < truth[name]) + 0.5) / (len(values) + 1)
        found[name] = [float(rank), float(abs(np.std(values) / np.mean(values)))]
    return found


def tried(name: str, seed: int, rivals: Sequence[str]) -> dict[str, Any]:
    """Return the result for one campaign: ranks of the truth, scores and evidence of the laws."""
    truth = TRUTHS[name]
    campaign, theta = made(truth, seed)
    laws = list(dict.fromkeys([truth.law, *rivals]))
    started = perf_counter()
    compared = jbw.compare_laws(campaign, laws, seed=seed)
    wall = perf_counter() - started
    rows, runs = compared.record["laws"], compared.record["runs"]
    if len(runs) < NUM_LEVELS:
        raise RuntimeError(f"{name}: {len(runs)} of {NUM_LEVELS} runs were compared")
    return {
        "case": name, "seed": seed, "wall": wall,
        "ranks": ranks(compared, truth.law, theta),
        "khat": rows[truth.law]["khat_evidence"],
        "weight": rows[truth.law]["weight"],
        "answers": {law: row["answer"] for law, row in rows.items()},
        "error": {law: row["error_left_out"] for law, row in rows.items()},
    }  # fmt: skip


def row(name: str, lines: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    """Return one row of the table, for one true law."""
    law = TRUTHS[name].law
    known = [rank for one in lines for rank, sd in one["ranks"].values() if sd < KNOWN]
    z = stats.norm.ppf(known)
    rivals = (law for law in RIVALS if law != TRUTHS[name].law)
    compared = [one for one in lines if len(one["answers"]) > 1]
    answers = [one["answers"] for one in compared]
    apart = {rival: sum(one.get(rival) == "worse" for one in answers) for rival in rivals}
    return (
        name, len(lines), len(z), float(np.mean(z)), float(np.std(z)),
        float(stats.kstest(z, "norm").pvalue), float(np.mean(np.abs(z) < stats.norm.ppf(0.995))),
        len(compared), sum(one.get(law) == "best" for one in answers),
        sum((one["weight"] or 0.0) > 0.5 for one in compared),
        ", ".join(f"{rival} {count}" for rival, count in apart.items()),
        float(np.median([one["wall"] for one in compared or lines])),
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--campaigns", type=int, default=50)
    parser.add_argument("--only", action="append", choices=list(TRUTHS))
    parser.add_argument("--alone", action="store_true", help="fit the true law only")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    chosen.out.touch()
    lines = [json.loads(line) for line in chosen.out.read_text().splitlines()]
    done = {(one["case"], one["seed"]) for one in lines}
    names = chosen.only or list(TRUTHS)
    for seed in range(chosen.campaigns):
        for name in names:
            if (name, seed) not in done:
                lines.append(tried(name, seed, () if chosen.alone else RIVALS))
                with chosen.out.open("a") as file:
                    print(json.dumps(lines[-1]), file=file)
    rows = [row(name, own) for name in names if (own := [x for x in lines if x["case"] == name])]
    show([Table("Laws recovered", COLUMNS, rows)], file=chosen.json)


if __name__ == "__main__":
    main()
