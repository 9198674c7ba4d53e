"""The tables of a run: what each column shows of the summary or of the tree."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import DataError
from jbw.inference.thresholds import BEYOND
from jbw.report.kernel import source_correction
from jbw.report.linear import resonance_window
from jbw.report.loops import BAND_SDS, MILLI, enclosed_areas
from jbw.report.result import branch, frequency, node
from jbw.report.table import Cell, Column, Section, Table, by_sd, digits, named, shares, table
from jbw.report.text import NOTHING, Names, number, percent, seconds, step_name, symbol, unit_text
from jbw.report.words import badge

GOOD_R_HAT, FAR = 1.01, 2.576
Summary = Mapping[str, Any]


def parameters_table(summary: Summary, known: Names) -> Table:
    """Table 1: every step with its verdict and what it found of every parameter.

    The main step comes first: it is what the others are held against.
    """
    main = summary.get("main")
    steps = sorted((summary.get("steps") or {}).items(), key=lambda each: each[0] != main)
    away = "distance of the mean from the truth in standard deviations, bold beyond 2.58"
    columns = (
        named("parameter", known),
        Column("unit", _unit, align="unit", only="page"),
        by_sd("MAP", "map", "highest posterior density", 2),
        by_sd("mean", "mean"),
        digits("sd", "sd", 2, "standard deviation"),
        shares("CV", "cv", "sd over the mean", 3),
        Column("99 % interval", _between, only="page"),
        Column("KL", _gain, "information gained over the prior, in nats", spared=1),
        Column("ESS\nbulk / tail", _ess, "effective number of draws", only="page"),
        Column("ESS", lambda row: number(row.get("ess_bulk"), 10.0), spared=6, only="terminal"),
        Column("R-hat", _r_hat, "above 1.01 (bold) the chains disagree"),
        by_sd("truth", "truth", spared=5),
        Column("z", _z, away, spared=4),
    )
    sections = tuple(_section(name, name == main, step) for name, step in steps)
    return Table(f"Campaign {summary.get('campaign', '')}", columns, sections, of="step")


def _section(name: str, main: bool, step: Summary) -> Section:
    rows = [{"name": key, **facts} for key, facts in (step.get("parameters") or {}).items()]
    judged = badge(step.get("verdict"))
    return Section(
        rows,
        name,
        step_name(name) + (" (main result)" if main else ""),
        Cell(judged.word, judged.kind) if step.get("verdict") else Cell(""),
        seconds(step.get("wall_time_s")).replace(NOTHING, ""),
    )


def _unit(row: Summary) -> str:
    return unit_text(str(row.get("unit") or "")) or "-"


def _between(row: Summary) -> str:
    return " to ".join(number(row.get(end), row.get("sd")) for end in ("q005", "q995"))


def _gain(row: Summary) -> str:
    return number(row.get("kl"), 0.1)


def _ess(row: Summary) -> str:
    if row.get("ess_bulk") is None:
        return NOTHING
    return f"{number(row['ess_bulk'], 10.0)} / {number(row.get('ess_tail'), 10.0)}"


def _r_hat(row: Summary) -> Cell:
    value = row.get("r_hat")
    unmixed = value is not None and not value < GOOD_R_HAT
    unknown = value is None and row.get("ess_bulk") is not None  # sampled, but no number
    return Cell(number(value, 0.01), "flag" if unmixed or unknown else "")


def _z(row: Summary) -> Cell:
    z = row.get("z")
    return Cell(number(z, 1.0), "flag" if z is not None and abs(z) > FAR else "")


def correlation_words(step: Summary, known: Names, strong: float = 0.9) -> list[str]:
    """Return the strong correlations of a step in words."""
    pairs = {
        frozenset((first, second)): value
        for first, row in (step.get("correlation") or {}).items()
        for second, value in row.items()
        if first != second and value is not None and abs(value) >= strong
    }
    return [
        f"{' and '.join(symbol(name, known) for name in sorted(pair))}: {number(value, 0.01)}"
        for pair, value in pairs.items()
    ]


def predictions_table(summary: Summary) -> Table:
    """The prediction errors, a row a test."""
    rows = [{"test": name, **row} for name, row in (summary.get("predictions") or {}).items()]
    return table(
        "Prediction errors",
        rows,
        Column("test", lambda row: row["test"], align="left wrap"),
        Column("level", level_of),
        Column("used as", _fitted),
        Column("inside the\n99 % predictive band", inside),
        error_column("error /\nrms of the record", "nrmse"),
        error_column("the same, best\nlinear oscillator", "nrmse_linear"),
        error_column("best\ncubic oscillator", "nrmse_cubic"),
    )


def error_column(heading: str, key: str) -> Column:
    """A column of relative errors; empty where none is known."""
    return Column(heading, lambda row: percent(row.get(key), digits=2).replace(NOTHING, ""))


def inside(row: Summary) -> str:
    """Share of the measured values in the predictive band, and of how many."""
    if row.get("coverage") is None:
        return NOTHING
    count = row.get("num_values")
    return percent(row["coverage"]) + ("" if count is None else f" of {count:,.0f}")


def level_of(row: Summary) -> str:
    """A test's level with its unit."""
    if row.get("level") is None:
        return NOTHING
    return f"{row['level']:.4g} {unit_text(str(row.get('level_unit') or ''))}".strip()


def _fitted(row: Summary) -> str:
    """Whether a test was fitted, and how far beyond the fitted displacements it lies."""
    if row.get("fitted"):
        return "fitted"
    reach = row.get("extrapolation") or 0.0
    if reach <= BEYOND:
        return "not fitted"
    return f"not fitted, {reach:.2g} times the displacement that was"


def routes_table(summary: Summary, known: Names) -> Table:
    """The paper's cut beside the joint posterior, a row a parameter."""
    found = (summary.get("comparison") or {}).get("parameters") or {}

    def of(route: str, key: str) -> Any:
        if key == "mean":
            return lambda row: number(row[route]["mean"], row[route]["sd"])
        return lambda row: number(row[route]["sd"], digits=2)

    return table(
        "The paper's cut beside the joint posterior",
        [{"name": name, **row} for name, row in found.items()],
        named("parameter", known),
        *(
            Column(f"{route}: {key}", of(route, key))
            for route in ("cut", "joint")
            for key in ("mean", "sd")
        ),
        digits("joint sd /\ncut sd", "sd_ratio", 2),
        Column("cut less joint,\nin joint sds", lambda row: number(row.get("difference"), 1.0)),
    )


def loops_table(summary: Summary, tree: xr.DataTree) -> Table:
    """The enclosed areas, a row a test and kind of force."""
    rows = []
    parent = node(tree, "validation/loops")
    listed = dict.fromkeys(parent.children if parent is not None else ())
    for name, facts in (listed | (summary.get("loops") or {})).items():
        stored = node(tree, f"validation/loops/{name}")
        test = xr.Dataset() if stored is None else stored.to_dataset()
        own = {key: value for key, value in (facts or {}).items() if key != "level"}
        test = test.assign_attrs(own)
        for ending, force in (("", "elastic and hysteretic"), ("_viscous", "with viscous")):
            if (areas := enclosed_areas(test, ending)) is not None:
                measured, model = (MILLI * np.asarray(each) for each in areas)
                sd = (model[2] - model[0]) / BAND_SDS
                rows.append(dict(test=name, force=force, measured=measured, model=model, sd=sd))
    return table(
        "Areas of the hysteresis loops",
        rows,
        Column("test", lambda row: row["test"], align="left wrap"),
        Column("restoring force", lambda row: row["force"]),
        Column("measured [mJ/kg]", _measured_area),
        Column("model [mJ/kg]\nmedian", lambda row: number(row["model"][1], row["sd"])),
        Column("model [mJ/kg]\n99 % parameter band", lambda row: _interval(row, "model")),
        Column("bands\nmeet", _meet),
    )


def _interval(row: Summary, key: str) -> str:
    return f"{number(row[key][0], row['sd'])} to {number(row[key][2], row['sd'])}"


def _measured_area(row: Summary) -> str:
    low, middle, high = row["measured"]
    return number(middle, row["sd"]) + (f" ({_interval(row, 'measured')})" if low < high else "")


def _meet(row: Summary) -> str:
    (low, _, high), (least, _, most) = row["measured"], row["model"]
    return "yes" if least <= high and low <= most else "no"


def checks_table(tree: xr.DataTree, known: Names) -> Table:
    """What the records themselves say: coherence, spread of repeats, the source."""
    rows: list[tuple[str, str, str]] = []
    for check in (_coherence, partial(_spread, known=known), _correction):
        try:
            rows += check(tree)
        except DataError:
            # The step was not run; its figure says so on the page.
            continue
    return table(
        "Checks of the data",
        rows,
        Column("", lambda row: row[0], align="left"),
        Column("", lambda row: row[1] or NOTHING),
        Column("", lambda row: Cell(row[2], "soft"), align="wrap"),
    )


def _coherence(tree: xr.DataTree) -> list[tuple[str, str, str]]:
    """The lowest coherence within the resonance."""
    line = branch(tree, "steps/linear", "coherence", "h_magnitude")
    freq = frequency(line)
    low, high = resonance_window(freq, np.asarray(line["h_magnitude"], float), depth=0.3)
    within = np.asarray(line["coherence"], float)[(freq >= low) & (freq <= high)]
    text = "near 1 where the records are long enough for the damping and free of noise"
    return [("lowest coherence at the resonance", number(np.nanmin(within)), text)]


def _spread(tree: xr.DataTree, known: Names) -> list[tuple[str, str, str]]:
    """The variation of the linear parameters between repeats."""
    facts = branch(tree, "steps/linear").attrs
    text = "between repeats; set it against the standard deviations of Table 1"
    names = [key.removeprefix("cv_") for key in map(str, facts) if key.startswith("cv_")]
    return [
        (f"variation of {symbol(name, known)}", percent(facts[f"cv_{name}"], digits=2), text)
        for name in names
    ]


def _correction(tree: xr.DataTree) -> list[tuple[str, str, str]]:
    """The largest part of Y(3 omega) that came from the source."""
    largest = percent(np.nanmax(source_correction(tree)), digits=2)
    text = "of Y(3ω), taken out with the measured input"
    return [("largest third harmonic of the source", largest, text)]
