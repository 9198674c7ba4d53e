"""Example values for every entry and every function of the catalogue, and what they are written as.

`python tests/report/messages.py` writes the snapshot anew: read the difference.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from jbw.report.messages import identified
from jbw.report.messages.findings import FINDINGS, remedy_of, sentence_of

SNAPSHOT = Path(__file__).with_name("messages.txt")

MORE = {"num_samples": 2000, "sampler": "nuts"}
SIZE = {"name": "delta", "size": 212.0, "limit": 400.0}
PEAKS = {"name": "delta", "below": 12.3, "above": 45.6, "weight": 0.3}
BOUND = {"name": "alpha", "side": "upper", "share": 0.137, "edge": 0.01}
OTHER = {"sampler": "nuts"}
# Values of the sentence, then of the remedy.
OF_FINDINGS = {
    "non_finite": ({"count": 3, "name": "alpha"}, {}),
    "frozen_chain": ({"count": 1, "num_chains": 4, "name": "alpha"}, {}),
    "r_hat": ({"name": "delta", "r_hat": 1.0312, "limit": 1.01}, MORE),
    "r_hat.one_chain": ({}, {"num_chains": 4}),
    "ess_bulk": (SIZE, MORE),
    "ess_tail": (SIZE, {"num_samples": None, "sampler": "nuts"}),
    "crossing": (PEAKS, {}),
    "crossing.weighed": ({"name": "delta"}, {}),
    "ess_weights": ({"size": 12.0, "limit": 400.0}, OTHER),
    "khat": ({"khat": 0.91, "limit": 0.7}, OTHER),
    "temperature": ({"beta": 0.5}, OTHER),
    "quadrature": ({"error": 0.1, "limit": 1e-3}, OTHER),
    "divergences": ({"count": 7, "size": 4000}, {"substeps": 16}),
    "failed_solves": ({"share": 0.021, "limit": 0.01}, {"substeps": 16}),
    "tree_depth": ({"share": 0.1, "limit": 0.05}, {"num_warmup": 1000}),
    "e_bfmi": ({"e_bfmi": 0.21, "limit": 0.3}, {}),
    "budget": ({"spent": 900.0}, {"budget": 1800.0}),
    "chi_square": ({"ratio": 9.0, "low": 0.2, "high": 5.0}, {}),
    "at_bound": (BOUND, {"line": "Put under [identify.prior]: `alpha = [1.0, 3.0]`."}),
    "at_bound.ends": (BOUND, {"name": "alpha"}),
    "unidentified": (
        {"names": ("alpha", "delta"), "ratio": 0.97,
         "text": "only the product alpha*delta is determined"},
        {"name": "alpha", "low": 1.0, "high": 2.0},
    ),
    "modes": ({**PEAKS, "rest": 0.7, "error": 0.012}, {}),
    "calibration_ranks": (
        {"name": "zeta", "p": 0.002, "test": "ECDF", "count": 8, "limit": 0.01}, {}
    ),
    "calibration_coverage": (
        {"name": "zeta", "share": 0.95, "count": 400, "low": 0.91, "high": 0.976}, {}
    ),
    "calibration_failures": (
        {"share": 0.02, "counted": ["8 not finite", "0 not mixed"], "limit": 0.01}, {}
    ),
}  # fmt: skip


def of_findings() -> Iterator[str]:
    """Every finding: its sentence, that of a check that passed, its remedy."""
    for entry, message in FINDINGS.items():
        if not message.sentence:
            continue
        values, remedy = OF_FINDINGS[entry]
        yield f"{entry}: {sentence_of(entry, values, passed=False)}"
        if message.passed:
            yield f"  passed: {sentence_of(entry, values, passed=True)}"
        if message.remedy:
            yield f"  remedy: {remedy_of(entry, remedy)}"


# Functions of the catalogue and arguments, topic by topic.
OF_TOPICS = {
    "identified": [
        identified.directions(3, 5),
        identified.grade("known", [identified.with_error("alpha*delta", 12.0, 0.24, 0.02)]),
        identified.grade("roughly", ["zeta (12 %)"]),
        identified.grade("hardly", [identified.with_error("gamma", 2.0, 6.0, 3.0)]),
        identified.grade("unknown", ["alpha", "delta"]),
        identified.tie("alpha*delta", 34.2),
        identified.undetermined(["alpha", "delta"]),
        identified.determined(["alpha*delta"], logs=True),
        identified.determined(["a + b", "a - c"], logs=False),
        identified.box_sensitivity([identified.follows_bound("alpha", 0.17, "upper bound of alpha"),
                                    identified.follows_bound("gamma", float("inf"),
                                                             "lower bound of gamma")]),
        identified.box_sensitivity([]),
        identified.profile_interval("gamma", ["1.202", "1.31"]),
        identified.profile_limit("gamma", 1.3, "above"),
        identified.profile_open("gamma", (0.0, 50.0), 0.03, flat=True),
        identified.profile_refused("gamma", 3),
        identified.better_fit(12.3),
        identified.waterfall(1, 1),
        identified.waterfall(8, 1),
        identified.waterfall(8, 5),
        identified.costs(["12.1", "12.1"]),
        identified.costs(["12.1", "none"]),
    ],
}  # fmt: skip


def catalogue() -> str:
    """All that the catalogue says of the examples."""
    lines = list(of_findings())
    for topic, sentences in OF_TOPICS.items():
        lines += ["", topic, *(f"  {sentence}" for sentence in sentences)]
    return "".join(f"{line}\n" for line in lines)


if __name__ == "__main__":
    sys.stdout.write(f"{SNAPSHOT.write_text(catalogue(), encoding='utf-8')} characters\n")
