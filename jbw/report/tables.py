"""The tables of a run: what each column shows of the summary or of the tree."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import DataError
from jbw.inference.thresholds import BEYOND
from jbw.measurement.records import belongs_to
from jbw.quantities import natural
from jbw.report.loops import BAND_SDS, MILLI, enclosed_areas
from jbw.report.messages import tables as notes
from jbw.report.responses import resonance_window
from jbw.report.result import branch, frequency, node
from jbw.report.table import (
    Cell,
    Column,
    Section,
    Table,
    by_sd,
    digits,
    named,
    shares,
    table,
    words,
)
from jbw.report.text import (
    NOTHING,
    Names,
    about,
    number,
    percent,
    seconds,
    shown_as,
    step_name,
    symbol,
    unit_text,
)
from jbw.report.words import badge

ROUTE = ("third_order_", "opening_")  # steps 3 and 4 of the paper, with any sampler
GOOD_R_HAT, FAR = 1.01, 2.576
IN_UNIT = ("map", "mean", "sd", "q005", "q995", "truth")  # numbers in the unit of their row
Summary = Mapping[str, Any]


def main_first(summary: Summary) -> list[tuple[str, Summary]]:
    """Return the steps of a run, the main one first, with which the others are compared."""
    steps = (summary.get("steps") or {}).items()
    return sorted(steps, key=lambda step: step[0] != summary.get("main"))


def step_heading(name: str, summary: Summary) -> str:
    """Return the heading of a step of the identification; it marks the main step."""
    return step_name(name) + (" (main result)" if name == summary.get("main") else "")


def of_route(name: str, summary: Summary) -> bool:
    """Return whether a step belongs to the paper's own route, which is expected to fail."""
    return name.startswith(ROUTE) and name != summary.get("main")


def parameters_table(summary: Summary, quantities: Names, *, shown: bool = False) -> Table:
    """Return the table of parameters: every step with its verdict and all its parameters.

    With `shown` frequencies are in Hz and damping ratios in per cent; otherwise in SI.
    """
    sections = []
    for name, step in main_first(summary):
        rows = [{"name": key, **facts} for key, facts in (step.get("parameters") or {}).items()]
        rows = [_as_shown(row) if shown else row for row in rows]
        verdict = Cell(*badge(step["verdict"])) if step.get("verdict") else Cell("")
        wall = seconds(step.get("wall_time_s")).replace(NOTHING, "")
        sections.append(Section(rows, name, step_heading(name, summary), verdict, wall))
    columns = (
        named("parameter", quantities),
        Column("unit", _unit, align="unit", only="page"),
        by_sd("MAP", "map", meaning="highest posterior density", spared=2),
        by_sd("mean", "mean"),
        digits("sd", "sd", 2, meaning="standard deviation"),
        shares("CV", "cv", meaning="sd over the mean", spared=3),
        Column("99 % interval", _interval, only="page"),
        digits("KL", "kl", place=0.1, meaning=notes.KL, spared=1),
        Column("ESS\nbulk / tail", _ess, "effective number of draws", only="page"),
        digits("ESS", "ess_bulk", place=10.0, spared=6, only="terminal"),
        Column("R-hat", _r_hat, notes.R_HAT),
        by_sd("truth", "truth", spared=5),
        Column("z", _z, notes.FROM_TRUTH, spared=4),
    )
    return Table(f"Campaign {summary.get('campaign', '')}", columns, tuple(sections), of="step")


def _as_shown(row: dict[str, Any]) -> dict[str, Any]:
    """Return a parameter's numbers in the unit that the page shows."""
    shown = shown_as(row["name"], str(row.get("unit") or ""))
    scaled = {key: shown.factor * row[key] for key in IN_UNIT if row.get(key) is not None}
    return {**row, **scaled, "unit": shown.unit, "suffix": shown.suffix}


def _unit(row: Summary) -> str:
    return unit_text(str(row.get("unit") or "")) or "-"


def _interval(row: Summary) -> str:
    return " to ".join(number(row.get(end), row.get("sd")) for end in ("q005", "q995"))


def _ess(row: Summary) -> str:
    if row.get("ess_bulk") is None:
        return NOTHING
    return f"{number(row['ess_bulk'], 10.0)} / {number(row.get('ess_tail'), 10.0)}"


def _r_hat(row: Summary) -> Cell:
    value = row.get("r_hat")
    unmixed = value is not None and not value < GOOD_R_HAT
    # The parameter was sampled, but its R-hat is unknown.
    unknown = value is None and row.get("ess_bulk") is not None
    return Cell(number(value, 0.01), "flag" if unmixed or unknown else "")


def _z(row: Summary) -> Cell:
    z = row.get("z")
    return Cell(number(z, 1.0), "flag" if z is not None and abs(z) > FAR else "")


def correlation_words(step: Summary, quantities: Names, strong: float = 0.9) -> list[str]:
    """Return the strong correlations between the parameters of a step, as texts."""
    pairs = {
        frozenset((first, second)): value
        for first, row in (step.get("correlation") or {}).items()
        for second, value in row.items()
        if first != second and value is not None and abs(value) >= strong
    }
    return [
        f"{' and '.join(symbol(name, quantities) for name in sorted(pair))}: {number(value, 0.01)}"
        for pair, value in pairs.items()
    ]


def table_of_tests(summary: Summary, tree: xr.DataTree | None = None) -> Table:
    """Return the table of a campaign's tests: fitted or held out, with the model's errors.

    Where all tests are fitted in the end, the tests that were held out before appear with both
    errors.
    """
    rows = sorted(with_records(every_test(summary, tree)), key=_in_order)
    before = (summary.get("held_out_answer") or {}).get("predictions") or {}
    of_kinds = [
        {"test": f"all {kind}", "nrmse": row["error"], "rests_on": row["rests_on"]}
        for kind, row in (summary.get("across_kinds") or {}).items()
    ]
    sides = (
        ("Fitted", [row for row in rows if row.get("fitted")]),
        ("Held out", [row for row in rows if not row.get("fitted")]),
        (
            notes.HELD_OUT_BEFORE,
            sorted(({"test": name, **row} for name, row in before.items()), key=_in_order),
        ),
    )
    parts = [(f"{word} ({_tests_counted(chosen)})", chosen) for word, chosen in sides if chosen]
    parts += [(notes.ACROSS_KINDS, of_kinds)] if of_kinds else []
    columns = (
        words("test", "test", "left wrap"),
        Column("kind", lambda row: str(row.get("kind") or "").replace("_", " "), align="left"),
        Column("session", lambda row: str(row.get("run") or ""), align="left"),
        Column("level", level_of),
        Column(
            "used as", lambda row: "fitted" if row.get("fitted") else "held out", only="terminal"
        ),
        Column("remark", _fitted, align="left"),
        shares(notes.ERROR, "nrmse", ""),
        shares(notes.OWN_FREQUENCY, "nrmse_own_frequency", ""),
        shares("the same, best\nlinear oscillator", "nrmse_linear", ""),
        shares("the same, best\ncubic oscillator", "nrmse_cubic", ""),
        Column("inside the\n99 % band", inside),
        shares(notes.HALF_WIDTH, "half_width", ""),
    )
    sections = tuple(Section(rows, heading, heading) for heading, rows in parts)
    return Table(notes.TESTS, columns, sections)


def every_test(summary: Summary, tree: xr.DataTree | None = None) -> list[dict[str, Any]]:
    """Return every test in the summary, with its prediction error where there is one.

    Summaries of earlier versions list no tests; the tests with readings or predictions then count.
    """
    predicted = dict(summary.get("predictions") or {})
    listed = summary.get("tests")
    if listed is None:
        read = None if tree is None else node(tree, "look")
        every = [] if read is None else [dict(test.attrs) for test in read.children.values()]
        listed = [{**row, "fitted": int(row["fitted"])} for row in every if "fitted" in row]
    rows = [{**predicted.pop(row["test"], {}), **row} for row in listed]
    return [*rows, *({"test": name, **row} for name, row in predicted.items())]


def tests_of_records(rows: Sequence[Summary]) -> dict[str, Summary]:
    """Return the test of each record that has a separate row, such as a free decay."""
    return {
        row["test"]: test
        for test in rows
        if test.get("nrmse") is None
        for row in rows
        if row is not test
        and row.get("kind") == test.get("kind")
        and belongs_to(row["test"], test["test"])
    }


def with_records(rows: Sequence[Summary]) -> list[dict[str, Any]]:
    """Replace each test's row by the rows of its records, where each record has a row."""
    tests = tests_of_records(rows)
    replaced = {test["test"] for test in tests.values()}
    sessions = {
        name: {"run": test.get("run"), "assembly": test.get("assembly"), "is_record": True}
        for name, test in tests.items()
    }
    return [{**sessions.get(row["test"], {}), **row} for row in rows if row["test"] not in replaced]


def _in_order(row: Summary) -> tuple[Any, ...]:
    return str(row.get("kind") or ""), about(row.get("level")), natural(str(row["test"]))


def _tests_counted(rows: list[dict[str, Any]]) -> str:
    noun = "record" if any(row.get("is_record") for row in rows) else "test"
    return notes.counted(len(rows), noun)


def inside(row: Summary) -> str:
    """Return the text on a test's coverage by the predictive band, with the number of values."""
    if row.get("coverage") is None:
        return notes.WITHHELD if row.get("withheld") else ""
    count = row.get("num_values")
    return percent(row["coverage"]) + ("" if count is None else f" of {count:,.0f}")


def level_of(row: Summary) -> str:
    """Return a test's level with its unit, as text."""
    if row.get("level") is None:
        return NOTHING
    return f"{row['level']:.4g} {unit_text(str(row.get('level_unit') or ''))}".strip()


def _fitted(row: Summary) -> str:
    """Return a note on a test: partly fitted repeats, or its distance beyond the fitted tests.

    For a kind of test it names the parameters that only tests of this kind identify.
    """
    if needed := row.get("rests_on"):
        return notes.rests_on(needed)
    count, fitted = row.get("repeats"), row.get("fitted")
    if fitted:
        some = count is not None and int(fitted) < count
        return f"{fitted} of {count} repeats fitted" if some else ""
    reach = row.get("extrapolation") or 0.0
    if reach <= BEYOND:
        return ""
    return notes.beyond(reach)


def routes_table(summary: Summary, quantities: Names) -> Table:
    """Return a table that compares the paper's route with the joint posterior, by parameter."""
    compared = (summary.get("comparison") or {}).get("parameters") or {}
    facts = [(route, key) for route in ("cut", "joint") for key in ("mean", "sd")]
    rows = [
        {"name": name, **row} | {f"{route}_{key}": row[route][key] for route, key in facts}
        for name, row in compared.items()
    ]

    def mean(route: str) -> Column:
        by = (f"{route}_mean", f"{route}_sd")
        return Column(f"{route}: mean", lambda row: number(row[by[0]], row[by[1]]))

    return table(
        notes.ROUTES,
        rows,
        named("parameter", quantities),
        mean("cut"),
        digits("cut: sd", "cut_sd", 2),
        mean("joint"),
        digits("joint: sd", "joint_sd", 2),
        digits("joint sd /\ncut sd", "sd_ratio", 2),
        digits(notes.CUT_LESS_JOINT, "difference", place=1.0),
    )


def loops_table(tree: xr.DataTree) -> Table:
    """Return the table of enclosed loop areas, one row per test and kind of force."""
    rows = []
    parent = node(tree, "validation/loops")
    for name, test in parent.children.items() if parent is not None else ():
        for ending, force in (("", "elastic and hysteretic"), ("_viscous", "with viscous")):
            if (areas := enclosed_areas(test.to_dataset(), ending)) is not None:
                measured, model = MILLI * areas.measured, MILLI * areas.model
                sd = (model[2] - model[0]) / BAND_SDS
                ends = {"q005": model[0], "q995": model[2], "sd": sd}
                rows.append(dict(test=name, force=force, measured=measured, model=model, **ends))
    return table(
        notes.LOOPS,
        rows,
        words("test", "test", "left wrap"),
        words("restoring force", "force", "right"),
        Column("measured [mJ/kg]", _measured_area),
        Column("model [mJ/kg]\nmedian", lambda row: number(row["model"][1], row["sd"])),
        Column(notes.MODEL_AREA, _interval),
        Column("bands\nmeet", _meet),
    )


def joints_table(tree: xr.DataTree) -> Table:
    """Return a table with each joint's effect on each mode; empty for a single joint."""
    group, rows = node(tree, "joints"), []
    if group is not None:
        joints = group.to_dataset()
        for joint, mode in product(joints["joint"].values, joints["mode"].values):
            effect = joints.sel(joint=joint, mode=mode)
            rows.append(
                {
                    "joint": str(joint),
                    "mode": f"{mode}, {float(effect['frequency_hz']):.4g} Hz",
                    "energy": float(effect["energy_share"]),
                    "energy_at_motion": (
                        effect["energy_share_at_motion"].values
                        if "energy_share_at_motion" in effect
                        else np.full(3, np.nan)
                    ),
                    "losses": effect["loss_share"].values,
                    "frequency": effect["softening_share"].values,
                    "verdict": "identified" if bool(effect["identified"]) else "unidentified",
                }
            )
    return table(
        notes.JOINTS,
        rows,
        words("joint", "joint", "left"),
        words("mode", "mode", "left"),
        Column("strain energy,\nin full stick", lambda row: percent(row["energy"], digits=2)),
        Column("strain energy,\nat that motion", lambda row: _share(row["energy_at_motion"])),
        Column("losses of\nall joints", lambda row: _share(row["losses"])),
        Column("softening of\nall joints", lambda row: _share(row["frequency"])),
        words("by itself", "verdict", "left"),
    )


def _share(ends: np.ndarray) -> str:
    """Return the median and 99 % interval of a share, as text."""
    if not np.all(np.isfinite(ends)):
        return NOTHING
    low, middle, high = (f"{100 * end:.3g}" for end in ends)
    return f"{middle} % ({low} to {high})"


def _measured_area(row: Summary) -> str:
    low, middle, high = (number(end, row["sd"]) for end in row["measured"])
    return f"{middle} ({low} to {high})" if row["measured"][0] < row["measured"][2] else middle


def _meet(row: Summary) -> str:
    (low, _, high), (least, _, most) = row["measured"], row["model"]
    return "yes" if least <= high and low <= most else "no"


def checks_table(tree: xr.DataTree, quantities: Names) -> Table:
    """Return a table of checks on the records: coherence, spread of repeats, the source."""
    rows: list[tuple[str, str, str]] = []
    with suppress(DataError):
        line = branch(tree, "steps/linear", "coherence", "h_magnitude")
        freq = frequency(line)
        low, high = resonance_window(freq, np.asarray(line["h_magnitude"], float), depth=0.3)
        least = np.nanmin(np.asarray(line["coherence"], float)[(freq >= low) & (freq <= high)])
        rows.append((notes.COHERENCE, number(least), notes.COHERENCE_NOTE))
    with suppress(DataError):
        for key, value in branch(tree, "steps/linear").attrs.items():
            if str(key).startswith("cv_"):
                what = f"variation of {symbol(str(key).removeprefix('cv_'), quantities)}"
                rows.append((what, percent(value, digits=2), notes.VARIATION_NOTE))
    with suppress(DataError):
        part = np.abs(branch(tree, "verification/h3", "correction")["correction"])
        largest = percent(np.nanmax(part), digits=2)
        rows.append((notes.HARMONIC, largest, notes.HARMONIC_NOTE))
    return table(
        "Checks of the data",
        rows,
        Column("", lambda row: row[0], align="left"),
        Column("", lambda row: row[1] or NOTHING),
        Column("", lambda row: Cell(row[2], "soft"), align="wrap"),
    )
