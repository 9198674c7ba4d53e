"""The tables of a run, from the entries of `summary.json` and of the posterior's tree."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import product
from operator import attrgetter, itemgetter
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
from jbw.report.result import arrays, branch, frequency, node
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
from jbw.results.run import RunSummary, StoredParameter, StoredStep, StoredTest

# prefixes of the groups of Steps 3 and 4 of Teloli et al., with any sampler
ROUTE = ("third_order_", "opening_")
GOOD_R_HAT, FAR = 1.01, 2.576
# variables of a joint's share in a mode
SHARES = ("energy_share_at_motion", "loss_share", "softening_share")
# columns of numbers in the unit of their row
IN_UNIT = ("map", "mean", "sd", "q005", "q995", "truth")


def main_first(summary: RunSummary) -> list[tuple[str, StoredStep]]:
    """Return the steps of a run, the main step first; the others are compared with it."""
    return sorted(summary.steps.items(), key=lambda step: step[0] != summary.main)


def step_heading(name: str, summary: RunSummary) -> str:
    """Return the heading of a step of the identification; it marks the main step."""
    return step_name(name) + (" (main result)" if name == summary.main else "")


def of_route(name: str, summary: RunSummary) -> bool:
    """Return whether a step is Step 3 or 4 of Teloli et al., which is expected to fail."""
    return name.startswith(ROUTE) and name != summary.main


def parameters_table(summary: RunSummary, quantities: Names, *, shown: bool = False) -> Table:
    """Return the table of parameters: every step with its verdict and all its parameters.

    With `shown` frequencies are in Hz and damping ratios in per cent; otherwise in SI.
    """
    sections = []
    for name, step in main_first(summary):
        rows = [_as_shown(row) if shown else row for row in step.parameters.values()]
        status = step.verdict.status
        verdict = Cell(*badge(status)) if status else Cell("")
        wall = seconds(step.wall_time_s).replace(NOTHING, "")
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
    return Table(f"Campaign {summary.campaign}", columns, tuple(sections), of="step")


def _as_shown(row: StoredParameter) -> StoredParameter:
    """Return a parameter's numbers in the unit that the page shows."""
    factor, unit, suffix = shown_as(row.name, row.unit)
    numbers = {key: getattr(row, key) for key in IN_UNIT}
    scaled = {key: factor * value for key, value in numbers.items() if value is not None}
    return row.replaced(**scaled, unit=unit, suffix=suffix)


def _unit(row: StoredParameter) -> str:
    return unit_text(row.unit) or "-"


def _interval(row: StoredParameter) -> str:
    return _to(row.q005, row.q995, row.sd)


def _to(low: float | None, high: float | None, sd: float | None) -> str:
    return f"{number(low, sd)} to {number(high, sd)}"


def _ess(row: StoredParameter) -> str:
    if row.ess_bulk is None:
        return NOTHING
    return f"{number(row.ess_bulk, 10.0)} / {number(row.ess_tail, 10.0)}"


def _r_hat(row: StoredParameter) -> Cell:
    unmixed = row.r_hat is not None and not row.r_hat < GOOD_R_HAT
    # The parameter was sampled, but its R-hat is unknown.
    unknown = row.r_hat is None and row.ess_bulk is not None
    return Cell(number(row.r_hat, 0.01), "flag" if unmixed or unknown else "")


def _z(row: StoredParameter) -> Cell:
    return Cell(number(row.z, 1.0), "flag" if row.z is not None and abs(row.z) > FAR else "")


def correlation_words(step: StoredStep, quantities: Names) -> list[str]:
    """Return texts on the strong correlations between parameters of a step."""
    pairs = {
        frozenset((first, second)): value
        for first, row in step.correlation.items()
        for second, value in row.items()
        if first != second and value is not None and abs(value) >= 0.9
    }
    return [
        f"{' and '.join(symbol(name, quantities) for name in sorted(pair))}: {number(value, 0.01)}"
        for pair, value in pairs.items()
    ]


def table_of_tests(summary: RunSummary, tree: xr.DataTree | None = None) -> Table:
    """Return the table of a campaign's tests: fitted or held out, with the model's errors.

    Where all tests are fitted in the end, the tests that were held out before appear with both
    errors.
    """
    rows = sorted(with_records(every_test(summary, tree)), key=_in_order)
    before = [row.replaced(test=name) for name, row in summary.held_out_answer.predictions.items()]
    of_kinds = [
        StoredTest(test=f"all {kind}", nrmse=row.error, rests_on=row.rests_on)
        for kind, row in summary.across_kinds.items()
    ]
    sides = (
        ("Fitted", [row for row in rows if row.fitted]),
        ("Held out", [row for row in rows if not row.fitted]),
        (notes.HELD_OUT_BEFORE, sorted(before, key=_in_order)),
    )
    parts = [(f"{word} ({_tests_counted(chosen)})", chosen) for word, chosen in sides if chosen]
    parts += [(notes.ACROSS_KINDS, of_kinds)] if of_kinds else []
    columns = (
        words("test", "test", "left wrap"),
        Column("kind", lambda row: row.kind.replace("_", " "), align="left"),
        Column("session", lambda row: row.run or "", align="left"),
        Column("level", level_of),
        Column("used as", lambda row: "fitted" if row.fitted else "held out", only="terminal"),
        Column("remark", _fitted, align="left"),
        shares(notes.ERROR, "nrmse", ""),
        shares(notes.OWN_FREQUENCY, "nrmse_own_frequency", ""),
        shares("RMS error, best\nlinear oscillator", "nrmse_linear", ""),
        shares("RMS error, best\ncubic oscillator", "nrmse_cubic", ""),
        Column("inside the\n99 % band", inside),
        shares(notes.HALF_WIDTH, "half_width", ""),
    )
    sections = tuple(Section(rows, heading, heading) for heading, rows in parts)
    return Table(notes.TESTS, columns, sections)


def every_test(summary: RunSummary, tree: xr.DataTree | None = None) -> list[StoredTest]:
    """Return every test in the summary, with its prediction error if there is one.

    Summaries of earlier versions list no tests; the tests with readings or predictions then count.
    """
    predicted = dict(summary.predictions)
    listed = summary.tests
    if listed is None:
        read = None if tree is None else node(tree, "look")
        groups = () if read is None else read.children.values()
        every: list[Any] = [test.attrs for test in groups if "fitted" in test.attrs]
        listed = [StoredTest.read({**row, "fitted": int(row["fitted"])}) for row in every]
    rows = [predicted.pop(row.test, row).replaced(**row.stated) for row in listed]
    return [*rows, *(row.replaced(test=name) for name, row in predicted.items())]


def tests_of_records(rows: Sequence[StoredTest]) -> dict[str, StoredTest]:
    """Map each record that has its own table row, such as a free decay, to its test's row."""
    kind_of = attrgetter("kind")
    return {
        row.test: test
        for test in rows
        if test.nrmse is None
        for row in rows
        if row is not test and kind_of(row) == kind_of(test) and belongs_to(row.test, test.test)
    }


def with_records(rows: Sequence[StoredTest]) -> list[StoredTest]:
    """Return the rows of tests; rows of single records replace the row of their test."""
    tests = tests_of_records(rows)
    replaced = {test.test for test in tests.values()}
    of_test = {
        name: {"run": test.run, "assembly": test.assembly, "is_record": True}
        for name, test in tests.items()
    }
    return [
        row.replaced(**{**of_test.get(row.test, {}), **row.stated})
        for row in rows
        if row.test not in replaced
    ]


def _in_order(row: StoredTest) -> tuple[Any, ...]:
    return row.kind, about(row.level), natural(row.test)


def _tests_counted(rows: Sequence[StoredTest]) -> str:
    noun = "record" if any(row.is_record for row in rows) else "test"
    return notes.counted(len(rows), noun)


def inside(row: StoredTest) -> str:
    """Return a text on the fraction of a test's values inside the predictive band."""
    if row.coverage is None:
        return notes.WITHHELD if row.withheld else ""
    count = row.num_values
    return percent(row.coverage) + ("" if count is None else f" of {count:,.0f}")


def level_of(row: StoredTest) -> str:
    """Return a test's level with its unit, as text."""
    return NOTHING if row.level is None else f"{row.level:.4g} {unit_text(row.level_unit)}".strip()


def _fitted(row: StoredTest) -> str:
    """Return the note on a test: the fitted repeats, or its motion relative to fitted motion.

    For a kind of test it names the parameters that only tests of this kind identify.
    """
    if row.rests_on:
        return notes.rests_on(row.rests_on)
    if row.fitted:
        some = row.repeats is not None and int(row.fitted) < row.repeats
        return f"{row.fitted} of {row.repeats} repeats fitted" if some else ""
    reach = row.extrapolation or 0.0
    if reach <= BEYOND:
        return ""
    return notes.beyond(reach)


def routes_table(summary: RunSummary, quantities: Names) -> Table:
    """Return a table of parameters: Steps 2 to 4 of Teloli et al. and the joint posterior."""
    return table(
        notes.ROUTES,
        summary.comparison.parameters.values(),
        named("parameter", quantities),
        Column("cut: mean", lambda row: number(row.cut.mean, row.cut.sd)),
        Column("cut: sd", lambda row: number(row.cut.sd, digits=2)),
        Column("joint: mean", lambda row: number(row.joint.mean, row.joint.sd)),
        Column("joint: sd", lambda row: number(row.joint.sd, digits=2)),
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
                texts = _areas(MILLI * areas.measured, MILLI * areas.model)
                rows.append((str(name), force, *texts))
    headings = (
        "restoring force", "measured [mJ/kg]", "model [mJ/kg]\nmedian", notes.MODEL_AREA,
        "bands\nmeet",
    )  # fmt: skip
    columns = (Column(heading, itemgetter(i)) for i, heading in enumerate(headings, start=1))
    return table(notes.LOOPS, rows, Column("test", itemgetter(0), align="left wrap"), *columns)


def _areas(measured: np.ndarray, model: np.ndarray) -> tuple[str, str, str, str]:
    """Return texts on measured loop area, model loop area, and whether their intervals overlap."""
    sd = (model[2] - model[0]) / BAND_SDS
    low, middle, high = (number(end, sd) for end in measured)
    own = f"{middle} ({low} to {high})" if measured[0] < measured[2] else middle
    meet = model[0] <= measured[2] and measured[0] <= model[2]
    return own, number(model[1], sd), _to(model[0], model[2], sd), "yes" if meet else "no"


def joints_table(tree: xr.DataTree) -> Table:
    """Return a table with each joint's effect on each mode; empty for a single joint."""
    group, rows = node(tree, "joints"), []
    if group is not None:
        joints = group.to_dataset()
        for joint, mode in product(joints["joint"].values, joints["mode"].values):
            effect = joints.sel(joint=joint, mode=mode)
            hz, energy, is_identified = arrays(effect, "frequency_hz", "energy_share", "identified")
            shares = (_share(effect[name].values) if name in effect else NOTHING for name in SHARES)
            rows.append(
                (
                    str(joint),
                    f"{mode}, {hz:.4g} Hz",
                    percent(float(energy), digits=2),
                    *shares,
                    "identified" if is_identified else "unidentified",
                )
            )
    headings = (
        ("joint", "left"), ("mode", "left"), ("strain energy,\nin full stick", "right"),
        ("strain energy,\nat that motion", "right"), ("losses of\nall joints", "right"),
        ("softening of\nall joints", "right"), ("by itself", "left"),
    )  # fmt: skip
    columns = (
        Column(heading, itemgetter(i), align=align) for i, (heading, align) in enumerate(headings)
    )
    return table(notes.JOINTS, rows, *columns)


def _share(ends: np.ndarray) -> str:
    """Return the median and 99 % interval of a share, as text."""
    if not np.all(np.isfinite(ends)):
        return NOTHING
    low, middle, high = (f"{100 * end:.3g}" for end in ends)
    return f"{middle} % ({low} to {high})"


def checks_table(tree: xr.DataTree, quantities: Names) -> Table:
    """Return a table of checks on the records: coherence, variation of repeats, the source."""
    rows: list[tuple[str, str, str]] = []
    with suppress(DataError):
        line = branch(tree, "steps/linear", "coherence", "h_magnitude")
        freq, (magnitude, coherence) = frequency(line), arrays(line, "h_magnitude", "coherence")
        low, high = resonance_window(freq, magnitude, depth=0.3)
        least = np.nanmin(coherence[(freq >= low) & (freq <= high)])
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
        Column("", itemgetter(0), align="left"),
        Column("", lambda row: row[1] or NOTHING),
        Column("", lambda row: Cell(row[2], "soft"), align="wrap"),
    )
