"""The table of measured structures, from finished runs of the campaigns in this folder.

    for file in notebooks/campaigns/*.toml; do
        jbw identify $file --allow-outside --out runs/$(basename $file .toml)
    done
    python notebooks/campaigns/table.py runs

Errors are root mean squares over that of the record in per cent, of the best linear oscillator, of
the best cubic one and of the joint's median, all of the same fitted tests. What 99 % bands hold is
of the values of tests that were held out; a band that is withheld is said. Of a run that fits all
tests for use (`--final`) both are of the fit before. The verdict is given by its three answers.
"""

import json
import math
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

ROW = "| {} | {} | {} | {} | {} | {} | {} |"
QUESTIONS = ("sampling", "law", "knowledge")
ANSWERS = " / ".join(QUESTIONS)
HEAD = (
    "structure", "identified [99 % interval]", "fitted [%]", "held out [%]", "inside bands [%]",
    ANSWERS, "time [s]",
)  # fmt: skip
# What each campaign's data know, with the factor and the unit it is written in.
SHOWN = {
    "bolted_double_beam": {
        "alpha_delta": (1e-6, "e6 1/(m s^2)"),
        "alpha_gamma": (1e-6, "e6 1/(m s^2)"),
    },
    "bolted_double_beam_mode2": {
        "alpha_delta": (1e-6, "e6 1/(m s^2)"),
        "alpha_gamma": (1e-6, "e6 1/(m s^2)"),
    },
    "brake_reuss_beam": {"omega_n": (1, "rad/s"), "alpha_gamma": (1e-6, "e6 1/(m s^2)")},
    "brake_reuss_all": {"omega_n": (1, "rad/s"), "nu": (1, "")},
    "f16_multisine": {"alpha_delta": (1e-5, "e5 1/(m s^2)"), "alpha_gamma": (1e-5, "e5 1/(m s^2)")},
    "f16_sweep": {"alpha_delta": (1e-5, "e5 1/(m s^2)"), "alpha_gamma": (1e-5, "e5 1/(m s^2)")},
    "f16_torsion": {"omega_n": (1, "rad/s"), "iwan_chi": (1, "")},
    "hysteretic_benchmark": {"alpha": (1, "1/s^2"), "delta": (1, "1/m"), "gamma": (1, "1/m")},
    "silverbox": {"cubic": (1e-5, "e5 1/(V^2 s^2)")},
    "silverbox_smooth": {"cubic": (1e-5, "e5 1/(V^2 s^2)")},
    "silverbox_without_cubic": {"alpha_delta": (1e-4, "e4 1/(V s^2)")},
    "friction_damper": {"alpha": (1e-6, "e6 1/s^2"), "delta": (1, "1/m"), "gamma": (1, "1/m")},
}


def spread(values: Sequence[float]) -> str:
    """Least and largest error in per cent."""
    low, high = (f"{float(f'{100 * value:.2g}'):g}" for value in (min(values), max(values)))
    return low if low == high else f"{low}-{high}"


def errors(tests: Iterable[dict[str, Any]]) -> str:
    """Errors of the three models over some tests."""
    rows = [row for row in tests if row.get("nrmse") is not None]
    if not rows:
        return "-"
    told = []
    for key in ("nrmse_linear", "nrmse_cubic", "nrmse"):
        known = [row[key] for row in rows if row.get(key) is not None]
        told.append(spread(known) if known else "-")
    return " / ".join(told)


def held_by_bands(tests: Iterable[dict[str, Any]]) -> str:
    """Least and largest share of values inside the bands of some tests, and bands withheld."""
    rows = list(tests)
    held = [100 * row["coverage"] for row in rows if row.get("coverage") is not None]
    ends = dict.fromkeys(f"{share:.3g}" for share in (min(held), max(held))) if held else []
    withheld = sum(bool(row.get("withheld")) for row in rows)
    return ", ".join(filter(None, ["-".join(ends), f"{withheld} withheld" * (withheld > 0)])) or "-"


def identified(parameters: dict[str, Any], shown: dict[str, tuple[float, str]]) -> str:
    """Mean and interval of what the data know."""
    told = []
    for name, (factor, unit) in shown.items():
        mean, low, high = (factor * parameters[name][key] for key in ("mean", "q005", "q995"))
        # Two digits of the interval's width.
        digits = max(3, math.ceil(math.log10(max(abs(mean), abs(high)) / (high - low))) + 2)
        values = f"{mean:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"
        told.append(f"{name} {values} {unit}".rstrip())
    return "; ".join(told)


def row(folder: Path) -> str:
    """One run as a row of the table."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    tests, answers = summary["predictions"].values(), summary["verdict"]["answers"]
    before = (summary.get("held_out_answer") or {}).get("predictions") or {}
    held_out = [*(test for test in tests if not test["fitted"]), *before.values()]
    return ROW.format(
        summary["campaign"],
        identified(summary["steps"][summary["main"]]["parameters"], SHOWN[folder.name]),
        errors(test for test in tests if test["fitted"]),
        errors(held_out),
        held_by_bands(held_out),
        " / ".join(answers.get(name, {}).get("status", "not assessed") for name in QUESTIONS),
        f"{summary['wall_time_s']:.0f}",
    )


def main(runs: Path) -> None:
    """Print the table.

    Args:
        runs: Folder of the runs, each named as its campaign's file.
    """
    print(ROW.format(*HEAD))
    print(ROW.format(*["---"] * len(HEAD)))
    for name in SHOWN:
        if (runs / name / "summary.json").exists():
            print(row(runs / name))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
