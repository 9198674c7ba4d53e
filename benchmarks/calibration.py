"""Do the intervals of each step contain the true values as often as stated?

Simulation-based calibration of Steps 2, 3, 4 and of the joint posterior on short tests: the
smallest p-value of uniform ranks over all quantities, the lowest and highest coverage of 99 %
intervals, and the failures, which are never left out. With --campaigns also whole campaigns of the
virtual rig: mean and standard deviation of the truth's z-scores in the joint posterior, and the
p-value of a Kolmogorov-Smirnov test against the standard normal.

    python benchmarks/calibration.py [--calls 1] [--json FILE] [--out FOLDER] [--campaigns 50]
"""

import sys
import warnings
from pathlib import Path
from typing import Any

import jax
from campaign_scores import score_campaigns
from timing import Table, options, show

from jbw.lab.calibration import REPLICATIONS, sbc
from jbw.report.figures import figure_of
from jbw.report.studies import rank_ecdfs

CASES: dict[str, dict[str, Any]] = {
    "Step 2": {"step": "linear"},
    "Step 3, noise known": {"step": "third_order", "noise": "known"},
    "Step 3, noise from 8 repeats": {"step": "third_order", "noise": "unknown"},
    "Step 4": {"step": "opening"},
    "joint, sweeps": {"step": "joint"},
}
CAMPAIGNS = {
    "24 repeats, 50 um/s": {"repeats": 24},
    "4 repeats, 1 % noise": {"repeats": 4, "noise_ratio": 0.01},
    "every kind of test, 2 repeats, 2 % noise": {
        "campaign": "mixed",
        "repeats": 2,
        "noise_ratio": 0.02,
    },
}
COLUMNS = {
    "posterior": "", "replications": "d", "sampler": "", "least p (ECDF)": ".2g", "of": "",
    "99 % holds, %": ".1f", "of ": "", "to, %": ".1f", "failed": "d", "verdict": "", "s": ".0f",
}  # fmt: skip


def row_of(name: str, found: Any) -> tuple[Any, ...]:
    """Return the table row of one calibration."""
    record = found.record
    rows = record["quantities"]
    least = min(rows, key=lambda one: rows[one]["p_ecdf"])
    shares = {one: 100 * row["coverage_99"] for one, row in rows.items()}
    lowest = min(shares, key=lambda one: shares[one])
    return (
        name, record["replications"], record["sampler"], rows[least]["p_ecdf"], least,
        shares[lowest], lowest, max(shares.values()), record["failed"],
        record["verdict"]["status"], record["wall_time_s"],
    )  # fmt: skip


def ranks(calls: int, seed: int, only: list[str], out: Path | None) -> Table:
    """Return the calibrations of every step, each of 1000 or 200 times `calls` replications."""
    rows = []
    for name, case in CASES.items():
        if only and case["step"] not in only:
            continue
        found = sbc(num_replications=calls * REPLICATIONS[case["step"]], seed=seed, **case)
        rows.append(row_of(name, found))
        print(rows[-1], file=sys.stderr)
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            stem = "_".join(case.values())
            figure = figure_of(rank_ecdfs(found.calibration))
            figure.savefig(out / f"sbc_{stem}.png", dpi=130, facecolor="white")
    return Table("Ranks of simulated truths", COLUMNS, rows)


def scores(number: int) -> Table:
    """Return the table of z-scores of the true values in whole campaigns of the virtual rig."""
    rows = []
    for name, case in CAMPAIGNS.items():
        found = score_campaigns(number, **case)
        for i, parameter in enumerate(found.names):
            z = found.z[:, i]
            rows.append(
                (name, parameter, z.mean(), z.std(ddof=1), found.p_values[parameter],
                 found.chi_square.mean(), found.khat.max())
            )  # fmt: skip
    columns = {
        "campaign": "", "parameter": "", "z, mean": "+.2f", "sd": ".2f", "KS p": ".3f",
        "chi2 / dof": ".4f", "worst k-hat": ".2f",
    }  # fmt: skip
    return Table(f"Truth's z-scores over {number} campaigns", columns, rows)


def main() -> None:
    parser = options(__doc__, calls=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", default="", help="some of linear,third_order,opening,joint")
    parser.add_argument("--out", type=Path, help="folder to store the figures in")
    parser.add_argument("--campaigns", type=int, default=0, help="whole campaigns of each kind")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    only = [step for step in arguments.steps.split(",") if step]
    tables = [ranks(arguments.calls, arguments.seed, only, arguments.out)]
    if arguments.campaigns:
        tables.append(scores(arguments.campaigns))
    show(tables, ("numpyro", "blackjax"), arguments.json)


if __name__ == "__main__":
    main()
