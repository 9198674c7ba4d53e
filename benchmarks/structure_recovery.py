"""Does the posterior of two modes with one joint contain the truth, with a third mode nearby?

Campaigns of six sweeps come from the virtual rig: three about each of two modes, with a third mode
above both bands that the campaign does not state, and a shaker whose armature moves along while its
force is measured. Shapes and the joint's parameters are drawn again for each campaign. Where the
posterior is right, the truth's rank among the draws is a uniform number and its z-score standard
normal. Results are appended to a file, one line per campaign; earlier lines remain.

    python benchmarks/structure_recovery.py --out FILE [--campaigns 50] [--first SEED] [--json FILE]
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import numpy as np
from scipy import stats
from timing import Table, options, show

import jbw
from jbw import rig
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify, Structured
from jbw.identification.assemble import measured_in
from jbw.identification.joint import sample_joint
from jbw.identification.prepare import fit_joint
from jbw.inference.posterior.summary import scalars
from jbw.inference.samplers.chunked_run import no_checkpoint
from jbw.rig.generator import Sweep
from jbw.rig.presets import Plan, Preset
from jbw.rig.structure import Armature, Shapes, law_of_mode, modal_truth

FS, NOISE, REPEATS = 512.0, 0.01, 2
SCATTER = 0.2  # standard deviation of logarithms of shapes and joint parameters between campaigns
HZ = np.array([18.8, 57.2, 131.0])  # [Hz]; the campaign does not state the third mode
BANDS = {"low": (14.0, 24.0, (0.8, 1.2, 2.0)), "high": (50.0, 64.0, (4.0, 7.0, 12.0))}
ARMATURE = Armature(gain=1.0, mass=0.05, damping=1.0, stiffness=100.0)
COLUMNS = {
    "parameter": "", "campaigns": "d", "mean z": ".2f", "sd of z": ".2f",
    "within 99 %": ".3f", "p of Kolmogorov": ".2f",
}  # fmt: skip


def made(seed: int) -> tuple[Campaign, dict[str, float]]:
    """Return a campaign on the rig, and the true values of its parameters by name."""
    rng = np.random.default_rng(seed)

    def drawn(values: Sequence[float]) -> np.ndarray:
        return np.array(values) * np.exp(SCATTER * rng.standard_normal(len(values)))

    shapes = Shapes(
        omega=2 * np.pi * HZ, zeta=drawn([0.006, 0.008, 0.01]), drive=drawn([0.7, 0.9, 0.5]),
        joint=drawn([1.0, -0.8, 0.3]), output=drawn([1.0, 0.7, -0.4]),
    )  # fmt: skip
    alpha, delta, gamma = drawn([3e3, 340.0, 90.0])
    joint = jbw.BoucWen(float(shapes.omega[0]), float(shapes.zeta[0]), alpha, delta, gamma)
    plans = tuple(
        Plan(f"{band}_{i}", "sweep", Sweep(*ends, level, burst=3.0, fade=0.2, duration=4.0),
             REPEATS, sources=("force",))
        for band, (*ends, levels) in BANDS.items()
        for i, level in enumerate(levels)
    )  # fmt: skip
    preset = Preset(
        name="structure recovery", gain=1.0, input_range=64.0, velocity_range=8.0, plans=plans,
        source="force", noise_ratio=NOISE, shapes=shapes, armature=ARMATURE,
    )  # fmt: skip
    taken = rig.measure(preset, joint=joint, fs=FS, seed=seed)
    settings = Identify.of({"fit_repeats": REPEATS, "offsets": "none"})
    structure = Structured(modes=tuple(HZ[:2].tolist()))
    return replace(taken, structure=structure, settings=settings), truth(shapes, joint)


def truth(shapes: Shapes, joint: jbw.BoucWen) -> dict[str, float]:
    """Return the true parameters of two modes and their joint, from the shapes alone."""
    modes = modal_truth(shapes)
    first, second = ({name: values[i] for name, values in modes.items()} for i in (0, 1))
    found = {"omega_n": first["omega_n"], "zeta": first["zeta"], "gain": first["b"]}
    found |= {"omega_2": second["omega_n"], "zeta_2": second["zeta"]}
    found |= {"gain_ratio_2": second["b"] / first["b"], "shape_2": abs(second["h"])}
    found |= {"coupling_2": abs(second["p"]) * second["h"] ** 2}
    found |= law_of_mode(joint.laws[0], shapes)
    return {name: float(value) for name, value in found.items()}


def tried(seed: int) -> dict[str, Any]:
    """Return, for one campaign, the rank of the truth among the draws of each parameter."""
    campaign, true = made(seed)
    began, keys = perf_counter(), jax.random.split(jax.random.key(seed))
    ready = fit_joint(keys[0], measured_in(campaign, lambda _: None), lambda _: None)
    tree = sample_joint(keys[1], ready, campaign.settings, no_checkpoint, "joint")
    draws = scalars(tree)
    ranks = {
        name: float((np.sum(draws[name] < value) + 0.5) / (draws[name].size + 1))
        for name, value in true.items()
        if name in draws
    }
    return {"seed": seed, "wall": perf_counter() - began, "ranks": ranks}


def row(name: str, lines: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    """Return one parameter's z-scores over the campaigns, as a table row."""
    z = stats.norm.ppf([one["ranks"][name] for one in lines if name in one["ranks"]])
    inside = float(np.mean(np.abs(z) < stats.norm.ppf(0.995)))
    chance = float(stats.kstest(z, "norm").pvalue)
    return name, len(z), float(np.mean(z)), float(np.std(z)), inside, chance


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--campaigns", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    chosen.out.touch()
    lines = [json.loads(line) for line in chosen.out.read_text().splitlines()]
    done = {one["seed"] for one in lines}
    for seed in range(chosen.first, chosen.first + chosen.campaigns):
        if seed not in done:
            lines.append(tried(seed))
            with chosen.out.open("a") as file:
                print(json.dumps(lines[-1]), file=file)
    names = list(dict.fromkeys(name for one in lines for name in one["ranks"]))
    rows = [row(name, lines) for name in names]
    show([Table("Two modes with one joint recovered", COLUMNS, rows)], file=chosen.json)


if __name__ == "__main__":
    main()
