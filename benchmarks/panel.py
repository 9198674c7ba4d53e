"""Does the posterior converge with default settings, and is the verdict right, for 40 campaigns?

Each campaign is identified with the defaults, in a separate process without compiled code. Most
campaigns are made by `outside`, whose integrator shares nothing with jbw; those with steady tones
are made by jbw's rig.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from outside import programmes
from outside.simulator import Plant
from timing import Table, options, show

import jbw

GAIN, FS = 15.0, 256.0
OMEGA_N, ZETA = 2 * np.pi * 18.8, 0.00444
JOINT = {"omega_n": OMEGA_N, "zeta": ZETA, "alpha": 500.0, "delta": 340.0, "gamma": 33.0}
SWEEPS, NOISE, DECAYS = programmes.Sweeps(), programmes.Noise(), programmes.Decays()
NO_JOINT = {"omega_n": OMEGA_N, "zeta": ZETA}
FIFTY = np.geomspace(5e-5, 5e-3, 50)
QUESTIONS = ("sampling", "law", "knowledge")
ASKED_NOTHING = {"status": "not assessed"}
COLUMNS = {
    "campaign": "", "true law": "", "sampling": "", "law": "", "knowledge": "", "verdict": "",
    "because": "", "wall, s": ".0f", "ESS": ".0f",
    "ESS a second": ".1f", "R-hat": ".3f", "truth inside": "", "worst error, %": ".1f",
}  # fmt: skip


@dataclass(frozen=True)
class Outside:
    """A campaign from the independent integrator in `outside`: its joint, tests and settings."""

    joint: Plant | None = None  # joint; if None, a Bouc-Wen joint of `parameters`
    parameters: Mapping[str, float] = field(default_factory=lambda: JOINT)  # true parameters
    excitations: tuple[programmes.Excitation, ...] = (SWEEPS,)
    # noise relative to the rms of the strongest sweep, or else of the strongest test [-]
    noise: float = 0.002
    repeats: int = 4
    fs: float = FS
    delay: float = 0.0  # lag of the response [s]
    laws: tuple[str, ...] = ("bouc_wen",)
    right: bool = True  # whether the chosen laws can follow the truth

    def campaign(self) -> tuple[jbw.Campaign, dict[str, float]]:
        """Return the campaign, and the true values under the names of the posterior."""
        joint = self.joint or programmes.bouc_wen(**self.parameters)
        made = [
            test
            for seed, excitation in enumerate(self.excitations)
            for test in programmes.taken(
                joint, excitation, gain=GAIN, fs=self.fs, repeats=self.repeats, seed=seed,
                noise_std=self.noise * self._rms(joint), delay=self.delay,
            )
        ]  # fmt: skip
        truth = {"gain": GAIN, **self.parameters} if self.right else {}
        return jbw.Campaign("panel", Path(), tuple(made), laws=self.laws), truth

    def _rms(self, joint: Plant) -> float:
        """Return the rms velocity of the strongest test, without noise [m/s]."""
        (test,) = programmes.taken(
            joint, replace(self.excitations[0], levels=self.excitations[0].levels[-1:]),
            gain=GAIN, fs=self.fs, repeats=1, noise_std=0.0, seed=0,
        )  # fmt: skip
        return float(np.std(test.records[0].channels["velocity"]))


@dataclass(frozen=True)
class Rig:
    """A campaign from jbw's virtual rig: its options."""

    options: Mapping[str, Any]  # options of `jbw.rig.measure`
    right: bool = True

    def campaign(self) -> tuple[Any, dict[str, float]]:
        """Return the campaign without its stated priors, and the true values of its parameters."""
        made = jbw.rig.measure(**self.options)
        settings = made.settings.model_copy(update={"prior": {}, "fit": None})
        truth = {name: float(value) for name, value in made.truth["joint"].items()}
        return replace(made, settings=settings), truth


def _with(**changed: float) -> dict[str, float]:
    return {**JOINT, **changed}


def _level(*levels: float) -> tuple[programmes.Sweeps]:
    return (replace(SWEEPS, levels=levels),)


def _wrong(joint: Plant, **more: Any) -> Outside:
    return Outside(joint, right=False, **more)


THREE = {
    "stiffness_1": 200.0, "slip_1": 0.2e-3, "stiffness_2": 200.0, "slip_2": 0.6e-3,
    "stiffness_3": 100.0, "slip_3": 2.0e-3,
}  # fmt: skip
TONES = [f"tone_{f}Hz" for f in ("5p00", "5p50", "6p00", "6p50", "6p75")]

CAMPAIGNS: dict[str, Outside | Rig] = {
    "noise 0.02 %": Outside(noise=2e-4),
    "noise 0.2 %": Outside(),
    "noise 0.5 %": Outside(noise=5e-3),
    "noise 1 %": Outside(noise=1e-2),
    "noise 2 %": Outside(noise=2e-2),
    "noise 5 %": Outside(noise=5e-2),
    "weak levels": Outside(excitations=_level(0.001, 0.002, 0.004)),
    "strong levels": Outside(excitations=_level(0.05, 0.15, 0.4)),
    "one level": Outside(excitations=_level(0.05)),
    "one repeat": Outside(repeats=1),
    "sixteen repeats": Outside(repeats=16),
    "hardening": Outside(parameters=_with(delta=-120.0, gamma=200.0)),
    "gamma above delta": Outside(parameters=_with(delta=100.0, gamma=250.0)),
    "gamma near delta": Outside(parameters=_with(delta=200.0, gamma=199.0)),
    "zeta 0.1 %": Outside(parameters=_with(zeta=1e-3)),
    "zeta 1 %": Outside(parameters=_with(zeta=1e-2)),
    "zeta 3 %": Outside(parameters=_with(zeta=3e-2)),
    "alpha 0.1 % of omega_n^2": Outside(parameters=_with(alpha=1e-3 * OMEGA_N**2)),
    "alpha 1 %": Outside(parameters=_with(alpha=1e-2 * OMEGA_N**2)),
    "alpha 10 %": Outside(parameters=_with(alpha=1e-1 * OMEGA_N**2)),
    "alpha 50 %": Outside(parameters=_with(alpha=5e-1 * OMEGA_N**2)),
    "three samples a period": Outside(fs=64.0),
    "55 samples a period": Outside(fs=1024.0),
    "sweeps and noise": Outside(excitations=(SWEEPS, NOISE)),
    "sweeps, noise, decays": Outside(excitations=(SWEEPS, NOISE, DECAYS)),
    "decays alone": Outside(excitations=(DECAYS,)),
    "weak noise alone": Outside(excitations=(NOISE,)),
    "tones alone": Rig({"tests": TONES}),
    "stepped sine alone": Rig({"tests": ["stepped_0p005V", "stepped_0p05V"]}),
    "every kind of test": Rig({"preset": "mixed"}),
    "days with other frequencies": Rig({"preset": "mixed", "omega_n_cv": 0.0018}),
    "days with other damping": Rig({"preset": "mixed", "zeta_cv": 0.05}),
    "linear": Outside(Plant(OMEGA_N, ZETA), parameters=NO_JOINT),
    "linear, sweeps, noise, decays": Outside(
        Plant(OMEGA_N, ZETA), parameters=NO_JOINT, excitations=(SWEEPS, NOISE, DECAYS)
    ),
    "cubic": _wrong(programmes.bouc_wen(**_with(alpha=0.0, delta=0.0, gamma=0.0), cubic=4e7)),
    "cubic beside Bouc-Wen": _wrong(programmes.bouc_wen(**JOINT, cubic=4e7)),
    "three sliders by jenkins_3": Outside(
        programmes.sliders(OMEGA_N, ZETA, springs=(200, 200, 100), slips=(0.2e-3, 0.6e-3, 2e-3)),
        parameters={"omega_n": OMEGA_N, "zeta": ZETA, **THREE}, laws=("jenkins_3",),
    ),
    "fifty sliders": _wrong(
        programmes.sliders(OMEGA_N, ZETA, springs=[10.0] * 50, slips=list(FIFTY))
    ),
    "nu = 0.5": _wrong(programmes.bouc_wen(**_with(delta=10.0, gamma=3.0), nu=0.5)),
    "velocity late by a sample": _wrong(programmes.bouc_wen(**JOINT), delay=1 / FS),
}  # fmt: skip


def judged(name: str) -> dict[str, Any]:
    """Identify a campaign; return verdict, coverage, errors and time."""
    case = CAMPAIGNS[name]
    campaign, truth = case.campaign()
    started = perf_counter()
    study = jbw.identify(campaign, seed=1, truth=truth)
    wall = perf_counter() - started
    summary = study.summary()
    main = summary["steps"][summary["main"]]
    rows = main["parameters"]
    inside = [rows[n]["q005"] <= v <= rows[n]["q995"] for n, v in truth.items() if n in rows]
    errors = [p["nrmse"] for p in summary["predictions"].values() if p.get("nrmse") is not None]
    against = [f for f in summary["verdict"]["findings"] if f["status"] != "ok"]
    for finding in against:
        print(finding["reason"], file=sys.stderr)
    answers = summary["verdict"]["answers"]
    return {
        "answers": [answers.get(name, ASKED_NOTHING)["status"] for name in QUESTIONS],
        "verdict": summary["verdict"]["status"],
        "because": ", ".join(dict.fromkeys(f["code"] for f in against)),
        "wall": wall,
        "ess": min((r["ess_bulk"] for r in rows.values() if r.get("ess_bulk")), default=None),
        "r_hat": max((r["r_hat"] for r in rows.values() if r.get("r_hat")), default=None),
        "inside": [sum(inside), len(inside)],
        "error": 100 * max(errors) if errors else None,
    }


def row(name: str, limit: float) -> tuple[Any, ...]:
    """Return one row of the table, from a separate process."""
    command = [sys.executable, __file__, "--one", name]
    env = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    law = "right" if CAMPAIGNS[name].right else "wrong"
    started = perf_counter()
    try:
        ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return (name, law, *[""] * 3, "stopped", "", limit, *[None] * 3, "", None)
    wall = perf_counter() - started
    if ended.returncode:
        last = ended.stderr.strip().splitlines()[-1:] or [""]
        return (name, law, *[""] * 3, "refused", last[0][:120], wall, *[None] * 3, "", None)
    found = json.loads(ended.stdout.strip().splitlines()[-1])
    ess, (inside, count) = found["ess"], found["inside"]
    rate = ess / found["wall"] if ess else None
    return (name, law, *found["answers"], found["verdict"], found["because"], wall, ess, rate,
            found["r_hat"], f"{inside} of {count}" if count else "", found["error"])  # fmt: skip


def main() -> None:
    """Print the table; `--only` takes campaigns by a part of their names."""
    parser = options(__doc__, calls=1)
    parser.add_argument("--only", nargs="*", help="parts of the names of campaigns to take")
    parser.add_argument("--limit", type=float, default=1200.0, help="seconds for a campaign")
    parser.add_argument("--one", help="identify this campaign here and print what it came to")
    arguments = parser.parse_args()
    jbw.enable_x64()
    if arguments.one:
        print(json.dumps(judged(arguments.one)))
        return
    wanted = [n for n in CAMPAIGNS if not arguments.only or any(o in n for o in arguments.only)]
    rows = []
    for name in wanted:
        rows.append(row(name, arguments.limit))
        print(rows[-1], file=sys.stderr, flush=True)
    show([Table("The panel", COLUMNS, rows)], ("numpyro",), arguments.json)


if __name__ == "__main__":
    main()
