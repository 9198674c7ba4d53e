"""Rows of the report's tables: numbers from the summary, ready to print."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import DataError
from jbw.report.findings import badge, findings
from jbw.report.kernel import source_correction
from jbw.report.linear import resonance_window
from jbw.report.loops import BAND_SDS, MILLI, Areas, enclosed_areas
from jbw.report.result import branch, frequency, node
from jbw.report.text import NOTHING, number, percent, seconds, step_name, symbol, unit_text
from jbw.report.words import in_symbols

BEYOND = 1.05  # of the fitted displacement: from where on a prediction is said to extrapolate


def step_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return Table 1: for every step its verdict, and a row of text for every parameter.

    The main step comes first: it is what the others are held against.
    """
    main = summary.get("main")
    return [
        {
            "name": step_name(name),
            "main": name == main,
            "badge": badge(step.get("verdict")),
            "judged": bool(step.get("verdict")),
            "findings": findings(step.get("verdict")),
            "statements": [in_symbols(str(each)) for each in step.get("statements") or []],
            "wall": seconds(step.get("wall_time_s")),
            "rows": [
                _parameter_row(key, facts) for key, facts in (step.get("parameters") or {}).items()
            ],
            "correlations": _correlations(step.get("correlation")),
        }
        for name, step in sorted(
            (summary.get("steps") or {}).items(), key=lambda each: each[0] != main
        )
    ]


def _parameter_row(name: str, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return one row of Table 1 as text; digits follow the standard deviation."""
    sd = facts.get("sd")
    r_hat, z = facts.get("r_hat"), facts.get("z")
    return {
        "symbol": symbol(name),
        "unit": unit_text(str(facts.get("unit") or "")) or "-",
        "map": number(facts.get("map"), sd),
        "mean": number(facts.get("mean"), sd),
        "sd": number(sd, digits=2),
        "cv": percent(facts.get("cv"), digits=2),
        "interval": f"{number(facts.get('q005'), sd)} to {number(facts.get('q995'), sd)}",
        "kl": number(facts.get("kl"), 0.1),
        "ess": f"{number(facts.get('ess_bulk'), 10.0)} / {number(facts.get('ess_tail'), 10.0)}",
        "r_hat": number(r_hat, 0.01),
        "unmixed": r_hat is None or not r_hat < 1.01,
        "sampled": facts.get("ess_bulk") is not None or r_hat is not None,
        "truth": number(facts.get("truth"), sd),
        "z": number(z, 1.0),
        "far": z is not None and abs(z) > 2.576,
    }


def _correlations(correlation: Any, strong: float = 0.9) -> list[str]:
    """Return the strong correlations of a step in words; keys are nested or joined by a comma."""
    if not isinstance(correlation, Mapping):
        return []
    pairs: dict[frozenset[str], float] = {}
    for first, value in correlation.items():
        inner = value.items() if isinstance(value, Mapping) else [("", value)]
        for second, number_ in inner:
            names = [first, second] if second else str(first).replace(":", ",").split(",")
            key = frozenset(name.strip() for name in names)
            if len(key) == 2 and number_ is not None and abs(number_) >= strong:
                pairs[key] = float(number_)
    return [
        f"{' and '.join(symbol(name) for name in sorted(key))}: {number(value, 0.01)}"
        for key, value in pairs.items()
    ]


def prediction_rows(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the prediction errors, a row a test."""
    return [
        {
            "test": name,
            "level": _level(facts),
            "fitted": _fitted(facts),
            "coverage": percent(facts.get("coverage")),
            "nrmse": percent(facts.get("nrmse"), digits=2),
            "linear": percent(facts.get("nrmse_linear"), digits=2),
            "cubic": percent(cubic, digits=2) if (cubic := facts.get("nrmse_cubic")) else "",
        }
        for name, facts in (summary.get("predictions") or {}).items()
    ]


def _fitted(facts: Mapping[str, Any]) -> str:
    """Return whether a test was fitted, and how far beyond the fitted displacements it lies."""
    if facts.get("fitted"):
        return "fitted"
    reach = facts.get("extrapolation") or 0.0
    if reach <= BEYOND:
        return "not fitted"
    return f"not fitted, {reach:.2g} times the displacement that was"


def _level(facts: Mapping[str, Any]) -> str:
    """Return a test's level with its unit."""
    if facts.get("level") is None:
        return NOTHING
    return f"{facts['level']:.4g} {unit_text(str(facts.get('level_unit') or ''))}".strip()


def route_rows(summary: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the paper's cut beside the joint posterior, a row a parameter."""
    comparison = summary.get("comparison") or {}
    return [
        {
            "symbol": symbol(name),
            "cut": number(row["cut"]["mean"], row["cut"]["sd"]),
            "cut_sd": number(row["cut"]["sd"], digits=2),
            "joint": number(row["joint"]["mean"], row["joint"]["sd"]),
            "joint_sd": number(row["joint"]["sd"], digits=2),
            "ratio": number(row.get("sd_ratio"), digits=2),
            "difference": number(row.get("difference"), 1.0),
        }
        for name, row in (comparison.get("parameters") or {}).items()
    ]


def loop_rows(summary: Mapping[str, Any], tree: xr.DataTree) -> list[dict[str, str]]:
    """Return the enclosed areas, a row a test and kind of force."""
    rows = []
    parent = node(tree, "validation/loops")
    listed = dict.fromkeys(parent.children if parent is not None else ())
    listed |= summary.get("loops") or {}
    for name, facts in listed.items():
        own = facts if isinstance(facts, Mapping) else {}
        stored = node(tree, f"validation/loops/{name}")
        test = xr.Dataset() if stored is None else stored.to_dataset()
        test = test.assign_attrs({key: value for key, value in own.items() if key != "level"})
        for ending, force in (("", "elastic and hysteretic"), ("_viscous", "with viscous")):
            areas = enclosed_areas(test, ending)
            if areas is not None:
                rows.append({"test": name, "force": force, **_area_row(areas)})
    return rows


def _area_row(areas: Areas) -> dict[str, str]:
    """Return the areas of one loop in print [mJ/kg], to the digits of the model's band."""
    low, middle, high = (MILLI * each for each in areas.model)
    lowest, measured, highest = (MILLI * each for each in areas.measured)
    sd = (high - low) / BAND_SDS
    spread = f" ({number(lowest, sd)} to {number(highest, sd)})" if lowest < highest else ""
    return {
        "measured": number(measured, sd) + spread,
        "median": number(middle, sd),
        "band": f"{number(low, sd)} to {number(high, sd)}",
        "meet": "yes" if low <= highest and lowest <= high else "no",
    }


def data_rows(tree: xr.DataTree) -> list[dict[str, str]]:
    """Return what the records themselves say: coherence, spread of repeats, the source."""
    rows = []
    for check in (_coherence, _spread, _correction):
        try:
            rows.extend(check(tree))
        except DataError:
            # The step was not run; its figure says so on the page.
            continue
    return rows


def _coherence(tree: xr.DataTree) -> list[dict[str, str]]:
    """Return the lowest coherence within the resonance."""
    line = branch(tree, "steps/linear", "coherence", "h_magnitude")
    freq = frequency(line)
    low, high = resonance_window(freq, np.asarray(line["h_magnitude"], float), depth=0.3)
    inside = np.asarray(line["coherence"], float)[(freq >= low) & (freq <= high)]
    text = "near 1 where the records are long enough for the damping and free of noise"
    return [_row("lowest coherence at the resonance", number(np.nanmin(inside)), text)]


def _spread(tree: xr.DataTree) -> list[dict[str, str]]:
    """Return the variation of the linear parameters between repeats."""
    facts = branch(tree, "steps/linear").attrs
    text = "between repeats; set it against the standard deviations of Table 1"
    return [
        _row(f"variation of {symbol(name)}", percent(facts[f"cv_{name}"], digits=2), text)
        for name in ("omega_n", "zeta", "gain")
        if f"cv_{name}" in facts
    ]


def _correction(tree: xr.DataTree) -> list[dict[str, str]]:
    """Return the largest part of Y(3 omega) that came from the source."""
    largest = percent(np.nanmax(source_correction(tree)), digits=2)
    text = "of Y(3ω), taken out with the measured input"
    return [_row("largest third harmonic of the source", largest, text)]


def _row(what: str, value: str, meaning: str) -> dict[str, str]:
    """Return one row of the data checks."""
    return {"what": what, "value": value or NOTHING, "meaning": meaning}
