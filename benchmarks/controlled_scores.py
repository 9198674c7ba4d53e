"""Do the intervals from controlled tests contain the truth, alone and together with decays?

    python benchmarks/controlled_scores.py [CAMPAIGN ...] [--campaigns 30] [--seeds 3]

A campaign is one of `CAMPAIGNS`. Seeds are counted in blocks, so that `--seeds 3` takes campaigns 0
to 29, 1000 to 1029 and 2000 to 2029. The exit code is 1 if a Kolmogorov-Smirnov test of any
parameter's z-scores against the standard normal has p below 1e-4.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest
from timing import Table, options, show

import jbw
from jbw import rig
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.prepare import prepare
from jbw.inference.compiled import forget_when_many
from jbw.inference.generator import parts_of
from jbw.inference.samplers.sampling import sample
from jbw.observables.dataset import log_likelihood

# This joint softens by more than the width of its resonance, so that its S-curves fold twice.
FOLDED = jbw.BoucWen(rig.TRUTH.omega_n, 0.003, 3000.0, 340.21, 3.0)
FOLDED_HZ, FOLDED_LEVELS = 18.2, tuple(np.geomspace(3e-4, 6e-3, 16).tolist())
DISTORTION_DB = -40.0  # distortion of the exciter [dB]
NUM_DRAWS = 500
LEAST_P = 1e-4
BLOCK = 1000  # difference of seeds between blocks


FOLDING = replace(
    rig.CONTROLLED,
    name="folding",
    plans=(
        *(plan for plan in rig.CONTROLLED.plans if plan.name != "s_curve"),
        rig.Plan("s_curve", "curve", rig.s_curve(FOLDED_HZ, FOLDED_LEVELS), 2),
    ),
)


class Design(NamedTuple):
    """A joint, and the controlled tests by which it is identified."""

    preset: rig.Preset
    joint: jbw.BoucWen
    tests: tuple[str, ...]
    # whether the modal mass is stated, because points at constant phase hardly determine it
    knows_mass: bool


CAMPAIGNS = {
    "backbone": Design(rig.CONTROLLED, rig.TRUTH, ("backbone",), True),
    "phase": Design(rig.CONTROLLED, rig.TRUTH, ("phase_60",), True),
    "s_curve": Design(FOLDING, FOLDED, ("s_curve",), True),
    "decays": Design(
        rig.CONTROLLED,
        rig.TRUTH,
        ("backbone", "phase_60", "s_curve", "decay_0p10N", "decay_0p40N"),
        False,
    ),
}


class Score(NamedTuple):
    """The z-scores of one campaign, (posterior mean - truth) / sd, and its sampling."""

    z: dict[str, float]
    khat: float
    chi_square: float  # chi-square per degree of freedom


def scored(design: Design, seed: int) -> Score:
    """Measure and identify one campaign; the fit starts at the truth, and sampling follows."""
    campaign = rig.measure(
        design.preset,
        seed=seed,
        joint=design.joint,
        tests=design.tests,
        distortion_db=DISTORTION_DB,
    )
    truth = {**campaign.truth["joint"], "gain": campaign.truth["gain"]}
    gain = truth["gain"] if design.knows_mass else None
    seen = measured(campaign.tests, Identify(), gain=gain)
    keys = parts_of(jax.random.key(seed), 3)
    ready = prepare(keys[:2], assemble(seen), seen.settings, truth)
    drawn = sample(
        keys[2], log_likelihood, ready.box, ready.data, sampler="importance", num_chains=1,
        num_samples=NUM_DRAWS, start=ready.fit.theta, covariance=ready.fit.covariance,
    )  # fmt: skip
    draws = drawn["posterior"].to_dataset()
    names = [str(n) for n in draws if n in truth]
    z = {n: float((draws[n].mean() - truth[n]) / draws[n].std()) for n in names}
    chi_square, degrees = ready.fit.chi_square
    return Score(z, float(drawn.attrs["khat"]), chi_square / degrees)


def table_of(name: str, blocks: Sequence[Sequence[Score]]) -> Table:
    """Return a table with one row per block and parameter: mean, sd and test of z-scores."""
    rows = []
    for number, block in enumerate(blocks):
        for parameter in block[0].z:
            z = np.array([score.z[parameter] for score in block])
            spread = float(z.std(ddof=1)) if len(z) > 1 else 0.0
            rows.append((BLOCK * number, len(z), parameter, float(z.mean()), spread, p_value(z)))
    forms = {"first seed": "d", "campaigns": "d", "parameter": "", "mean": "+.2f", "sd": ".2f"}
    return Table(name, {**forms, "p": ".2g"}, rows)


def p_value(z: NDArray[np.float64]) -> float:
    """Return the p-value of a Kolmogorov-Smirnov test against the standard normal."""
    return float(kstest(z, "norm").pvalue)


def score_campaigns(
    name: str, campaigns: int, seeds: int, report: Callable[[str], None] = print
) -> list[list[Score]]:
    """Return the scores of all campaigns in every block of seeds."""
    blocks = []
    for block in range(seeds):
        rows = []
        for seed in range(BLOCK * block, BLOCK * block + campaigns):
            rows.append(scored(CAMPAIGNS[name], seed))
            # Fifty campaigns with decays exhaust the memory mappings of a process.
            forget_when_many()
            shown = " ".join(f"{n} {z:+.2f}" for n, z in rows[-1].z.items())
            report(f"{name} {seed}: {shown}; k-hat {rows[-1].khat:.2f}, {rows[-1].chi_square:.2f}")
        blocks.append(rows)
    return blocks


def main() -> int:
    parser = options(__doc__, calls=1)
    parser.add_argument("names", nargs="*", default=list(CAMPAIGNS), metavar="CAMPAIGN")
    parser.add_argument("--campaigns", type=int, default=30, help="of each block of seeds")
    parser.add_argument("--seeds", type=int, default=3, help="blocks of seeds")
    asked = parser.parse_args()
    jbw.enable_x64()
    tables = []
    for name in asked.names:
        tables.append(table_of(name, score_campaigns(name, asked.campaigns, asked.seeds)))
    show(tables, file=asked.json)
    return int(min(row[-1] for table in tables for row in table.rows) < LEAST_P)


if __name__ == "__main__":
    sys.exit(main())
