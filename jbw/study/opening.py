"""What a run found, in five sentences, before any table: what it is, how good, what stays open."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

Record = Mapping[str, Any]
LOW = 0.1  # of the largest displacement fitted: where the joint hardly slips


def opening(record: Record, tree: xr.DataTree) -> Iterator[str]:
    """What the joint does, how fitted and held-out tests are met, what is not known, what to do.

    `record` is a run's summary with its verdict and predictions, `tree` its result.
    """
    if "verification/backbone" in tree:
        yield _effect(tree["verification/backbone"].to_dataset())
    tests = [one for one in record["predictions"].values() if one.get("nrmse") is not None]
    fitted = [one for one in tests if one.get("fitted")]
    held = [one for one in tests if not one.get("fitted")]
    if fitted:
        yield f"The fit leaves of {_count(fitted)} {_errors(fitted)}."
    if held:
        yield f"Predictions leave of {_count(held)} that no fit saw {_errors(held)}."
    else:
        yield "No test was held out; `hold_out` shows how well one is predicted that no fit saw."
    verdict = record["verdict"]
    knowledge = (verdict.get("answers") or {}).get("knowledge", {"status": "ok"})
    if knowledge["status"] == "ok":
        yield "The data identify every parameter."
    else:
        yield knowledge["because"].split(". ")[0].removesuffix(".") + "."
    against = [one for one in verdict["findings"] if one["status"] != "ok" and one["action"]]
    yield f"To do next: {against[0]['action']}" if against else "To do next: use it."


def _effect(backbone: xr.Dataset) -> str:
    """Frequency and damping at a tenth of the largest displacement fitted, and there."""
    y_peak = float(backbone.attrs["y_fitted"])
    at = backbone.interp(amplitude=[LOW * y_peak, y_peak])
    (low, high), (weak, strong) = (at[name].values.T for name in ("frequency", "damping"))
    digits = max(3, int(np.ceil(np.log10(high[1] / max(high[2] - high[0], 1e-9 * high[1])))) + 2)
    way = "lowers" if high[1] < low[1] else "raises"
    return (
        f"From {LOW * y_peak:.2g} to {y_peak:.2g} m of motion the joint {way} the frequency from "
        f"{low[1]:.{digits}g} to {high[1]:.{digits}g} Hz [{high[0]:.{digits}g}, "
        f"{high[2]:.{digits}g}] and takes the damping from {100 * weak[1]:.2g} to "
        f"{100 * strong[1]:.2g} % [{100 * strong[0]:.2g}, {100 * strong[2]:.2g}]."
    )


def _errors(tests: Sequence[Record]) -> str:
    """Errors of the joint and of the best linear oscillator over some tests."""
    linear = [x for one in tests if (x := one.get("nrmse_linear")) is not None]
    beside = f"; the best linear oscillator {_span(linear)}" if linear else ""
    return f"{_span([one['nrmse'] for one in tests])}{beside}"


def _span(errors: Sequence[float]) -> str:
    least, most = (f"{100 * one:.2g}" for one in (min(errors), max(errors)))
    return f"{least} %" if least == most else f"{least} to {most} %"


def _count(tests: Sequence[Record]) -> str:
    return "one test" if len(tests) == 1 else f"{len(tests)} tests"
