"""What the verification says of the main posterior: findings of the verdict beside the chains'.

A narrow posterior of the wrong law passes every look at its chains. It fails where a simpler
oscillator predicts better, or where tests that no fit saw leave its bands.
"""

import numpy as np
import xarray as xr

from jbw.inference.posterior.verdict import Finding
from jbw.verification.noise import ALIKE

BETTER = 1.1  # times the error of a simpler oscillator: beyond, that one is the better model
LEAST_COVERAGE = 0.95  # of a 99 % band over a record
LEAST_VALUES = 50  # of a record whose coverage says something
KINDS = ("sweep", "curve", "loop", "multisine", "decay")
SIMPLER = ("linear", "cubic")


def prediction_findings(tree: xr.DataTree) -> list[Finding]:
    """Whether the joint predicts better than simpler oscillators, and within its bands.

    Args:
        tree: The collected result.

    Returns:
        A finding `simpler_model`, whose number is the largest error over that of the best simpler
        oscillator, where one was compared; and `held_out_coverage`, whose number is the least share
        of a record that no fit saw inside its 99 % band, where there was any.
    """
    tests = {
        name: {"group": kind, **one.attrs}
        for kind in KINDS
        if (path := f"/verification/{kind}") in tree.groups
        for name, one in tree[path].children.items()
        if "nrmse" in one.attrs
    }
    found = [_simpler(tests), _coverage(tests)]
    return [finding for finding in found if finding is not None]


def _simpler(tests: dict[str, dict]) -> Finding | None:
    ratios = {
        (name, kind): attrs["nrmse"] / attrs[f"nrmse_{kind}"]
        for name, attrs in tests.items()
        for kind in SIMPLER
        if np.isfinite(attrs.get(f"nrmse_{kind}", np.nan)) and attrs[f"nrmse_{kind}"] > 0
    }
    # A joint that cannot be solved where another model can is no better than that.
    ratios = {key: ratio if np.isfinite(ratio) else np.inf for key, ratio in ratios.items()}
    if not ratios:
        return None
    name, kind = max(ratios, key=lambda pair: ratios[pair])
    worst, attrs = float(ratios[name, kind]), tests[name]
    ok = worst < BETTER
    seen = "fitted" if attrs.get("fitted") else "never fitted"
    return Finding(
        "simpler_model",
        "ok" if ok else "failed",
        f"On {name} ({seen}) the joint's error is {attrs['nrmse']:.2g} of the record, that of the "
        f"best {kind} oscillator {attrs[f'nrmse_{kind}']:.2g}; it must be below {BETTER:g} times "
        "that, here as on every other test.",
        worst,
        ""
        if ok
        else "The law of the joint does not hold there: fit fewer levels, add `cubic` to the "
        "prior, or doubt that hysteresis is what the data show.",
    )


def _coverage(tests: dict[str, dict]) -> Finding | None:
    # Harmonics and loops of another level may have another noise: a mean of theirs proves nothing.
    shares = {
        name: float(attrs["coverage"])
        for name, attrs in tests.items()
        if not attrs.get("fitted")
        and (attrs["group"] == "sweep" or attrs.get("noise") != ALIKE)
        and np.isfinite(attrs.get("coverage", np.nan))
        and attrs.get("num_values", 0) >= LEAST_VALUES
    }
    if not shares:
        return None
    worst = min(shares, key=lambda name: shares[name])
    ok = shares[worst] >= LEAST_COVERAGE
    return Finding(
        "held_out_coverage",
        "ok" if ok else "failed",
        f"Of {worst}, which no fit saw, {shares[worst]:.1%} lie inside the 99 % band, the least of "
        f"all; it must be at least {LEAST_COVERAGE:.0%}.",
        shares[worst],
        ""
        if ok
        else "The intervals are too narrow for what was not fitted: the law does not hold there, "
        "or runs differ; mark them by `run`.",
    )
