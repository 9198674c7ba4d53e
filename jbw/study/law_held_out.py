"""Tests that no law was fitted to, as each law predicts them: within what was fitted, and beyond.

Between the levels that were fitted and above them other laws may be best, and a laboratory that
asks for the next level wants the second.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import JbwError
from jbw.identification.across_kinds import across_kinds
from jbw.identification.evidence import Candidate
from jbw.identification.floors import rms
from jbw.inference.thresholds import BEYOND
from jbw.measurement.records import Test, belongs_to
from jbw.report.messages import study as messages
from jbw.verification.predict import Request, predict
from jbw.verification.predicted import is_measured
from jbw.verification.predictive_basis import basis_of

NUM_DRAWS = 20  # an error is that of the median of so many


def unseen(tests: Sequence[Test], runs: Sequence[str]) -> list[Test]:
    """Measured tests of which no run was fitted."""
    return [
        test
        for test in tests
        if is_measured(test) and not any(belongs_to(r, test.name) for r in runs)
    ]


def errors_across_kinds(candidate: Candidate) -> dict[str, float] | None:
    """Error of a law on each kind of test as the other kinds predict it; None of one kind."""
    fitted = candidate.fitted
    predicted = across_kinds(fitted.fit, fitted.box, fitted.data)
    if predicted is None:
        return None
    return dict(
        zip(map(str, predicted["kind"].values), predicted["error"].values.tolist(), strict=True)
    )


def held_out(
    tests: Sequence[Test], groups: Mapping[str, xr.Dataset], laws: Sequence[str], seed: int
) -> xr.Dataset | None:
    """Error of every law on every test, and the largest displacement over that fitted; or None.

    NaN where a law predicts none. `groups` are those of `law_groups`.
    """
    if not tests:
        return None
    shape = len(laws), len(tests)
    error, reach = np.full(shape, np.nan), np.full(shape, np.nan)
    for i, law in enumerate(laws):
        law_tree = xr.DataTree.from_dict(
            {"/": groups[f"/laws/{law}"], "/posterior": groups[f"/laws/{law}/posterior"]}
        )
        try:
            basis = basis_of(law_tree)
        except JbwError:
            continue
        for j, test in enumerate(tests):
            try:
                prediction = predict(basis, test, Request(num_draws=NUM_DRAWS, seed=seed)).attrs
            except JbwError:
                continue
            error[i, j] = prediction.get("nrmse", np.nan)
            reach[i, j] = prediction.get("extrapolation", np.nan)
    dims = ("law", "test")
    return xr.Dataset(
        {
            "error": (dims, error, {"units": "1", "long_name": "error over rms"}),
            "extrapolation": (dims, reach, {
                "units": "1", "long_name": messages.VARIABLES["extrapolation"]}),
        },
        {"law": list(laws), "test": [test.name for test in tests]},
    )  # fmt: skip


def errors_apart(found: xr.Dataset | None, law: str, best: str) -> dict[str, Any]:
    """Error of a law on tests within the motion fitted, and beyond it as the best law has it."""
    if found is None:
        return {"error_held_out": None, "error_beyond": None}
    law_errors = found["error"].sel(law=law).values
    beyond = found["extrapolation"].sel(law=best).values > BEYOND
    finite = np.isfinite(law_errors)
    apart = (law_errors[finite & ~beyond], law_errors[finite & beyond])
    error_by_reach = [rms(part.tolist()) if len(part) else None for part in apart]
    return dict(zip(("error_held_out", "error_beyond"), error_by_reach, strict=True))
