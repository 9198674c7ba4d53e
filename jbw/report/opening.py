"""What a run found, before any table: five sentences, the parameters that are known, one picture.

The sentences: what the joint does, the errors of the fitted tests and of those held out, which
parameters are not identified, what to do next.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import ceil, log10
from typing import Any

import numpy as np
import xarray as xr

from jbw.inference.posterior.finding import ASKED
from jbw.report.result import BACKBONE, laws_of, node
from jbw.report.text import length_unit
from jbw.report.words import grades

Summary = Mapping[str, Any]
LOW = 0.1  # of the largest displacement fitted: where the joint hardly slips
MOST_SHOWN = 8
# Pictures that may stand first, and where the tree has no readings of the records; of a joint whose
# motion is prescribed its loops.
LEADS, UNREAD = ("backbone", "amplitude", "loops"), ("amplitude", "backbone", "loops")
UNMEASURED = "zeta"  # what a campaign without a free or driven mode cannot know
LEANING, ABSENT = "at_bound", "no_joint"  # findings that say something first


def opening(summary: Summary, tree: xr.DataTree) -> list[str]:
    """The sentences of a run's summary and tree, its doubts too; none of a run that lacks them."""
    steps = summary.get("steps") or {}
    if summary.get("main") not in steps or not summary.get("verdict"):
        return []
    met = [fit_sentence(summary)] if "quick" in summary else _misfits(summary)
    doubts = [f"Doubtful: {doubt}" for doubt in summary.get("doubts") or ()]
    return [effect_sentence(summary, tree), *met, _unknown(summary), *doubts, _following(summary)]


def lead(summary: Summary, drawn: Sequence[str]) -> str | None:
    """The name of the figure that stands first, of those that could be drawn."""
    moves = "loops" if not _has_mode(summary) else None
    leads = LEADS if (summary.get("look") or {}).get("tests") else UNREAD
    return next((name for name in (moves, *leads) if name in drawn), None)


def known_parameters(summary: Summary) -> list[str]:
    """Each parameter known to 30 % with its 99 % interval; products where a factor is not known."""
    rows, found = _rows(summary), grades(summary)
    drawn = [name for name in found if rows[name].get("kl") is not None]
    good = [name for name in drawn if found[name] <= 1]
    if len(good) < len(drawn):
        good += [name for name in found if name not in drawn and found[name] <= 1]
    return [f"{name} {_with_interval(rows[name])}" for name in good[:MOST_SHOWN]]


def _rows(summary: Summary) -> Mapping[str, Any]:
    return summary["steps"][summary["main"]].get("parameters") or {}


def _has_mode(summary: Summary) -> bool:
    steps = summary.get("steps") or {}
    return UNMEASURED in ((steps.get(summary.get("main")) or {}).get("parameters") or {})


def _with_interval(row: Mapping[str, Any]) -> str:
    """Mean and 99 % interval to two digits of its width, with the unit."""
    ends = row["mean"], row["q005"], row["q995"]
    mean, low, high = (f"{one:.{_digits(*ends[1:])}g}" for one in ends)
    unit = str(row.get("unit") or "1")
    return f"{mean} [{low}, {high}]" + ("" if unit == "1" else f" {unit}")


def _digits(low: float, high: float) -> int:
    """Digits that leave two of the width of an interval; three at least, fifteen at most."""
    largest = max(abs(low), abs(high))
    if not high - low > 0.0 or not largest:
        return 6
    return int(min(15, max(3, ceil(log10(largest / (high - low))) + 2)))


def effect_sentence(summary: Summary, tree: xr.DataTree) -> str:
    """Frequency and damping at a tenth of the largest displacement fitted, and there."""
    for finding in summary["verdict"]["findings"]:
        if finding["code"] == ABSENT and finding["status"] != "ok":
            return finding["reason"]
    if not laws_of(tree):
        return "The structure was taken as linear: no joint was looked for."
    found = node(tree, BACKBONE)
    if found is None:
        return "Frequency and damping against amplitude are not known of this run."
    y_peak = float(found.attrs["y_fitted"])
    at = found.to_dataset().interp(amplitude=[LOW * y_peak, y_peak])
    factor, unit = length_unit(y_peak)
    reach = f"From {LOW * y_peak * factor:.2g} to {y_peak * factor:.2g} {unit} of motion the joint"
    frequency, damping = (at[name].transpose("amplitude", "quantile").values for name in
                          ("frequency", "damping"))  # fmt: skip
    if not _has_mode(summary):
        part = 100 * (frequency[1, ::-1] / frequency[0, 1]) ** 2
        return f"{reach} keeps {part[1]:.3g} % [{part[2]:.3g}, {part[0]:.3g}] of its stiffness."
    return (
        f"{reach} {_change('natural frequency', frequency, 'Hz')} and "
        f"{_change('damping ratio', 100 * damping, '%')}."
    )


def _change(what: str, values: np.ndarray, unit: str) -> str:
    """How a quantity changes from the weak motion (first row) to the strong one, with its band."""
    (_, weak, _), (low, strong, high) = values
    digits = _digits(low, high)
    ends = f"{strong:.{digits}g} {unit} [{low:.{digits}g}, {high:.{digits}g}]"
    if low <= weak <= high:
        return f"changes the {what} by less than its uncertainty ({ends})"
    return f"{'lowers' if strong < weak else 'raises'} the {what} from {weak:.{digits}g} to {ends}"


def _misfits(summary: Summary) -> Iterator[str]:
    """Errors of the fitted tests, and of those held out."""
    tests = [one for one in (summary.get("predictions") or {}).values() if one.get("nrmse")]
    fitted = [one for one in tests if one.get("fitted")]
    held = [one for one in tests if not one.get("fitted")]
    before = ((summary.get("held_out_answer") or {}).get("predictions") or {}).values()
    fitted_last = [one for one in before if one.get("nrmse")]
    if fitted:
        yield f"RMS error of the {_count(fitted)} that {_were(fitted)} fitted: {_errors(fitted)}."
    else:
        yield "The errors of the fitted tests are not known of this run."
    if fitted_last:
        yield f"{_of_held_out(fitted_last)} They are fitted now, for use."
        return
    if not held:
        yield "No test was held out; with `hold_out` the report shows how well one is predicted."
        return
    yield _of_held_out(held)


def _of_held_out(held: Sequence[Summary]) -> str:
    """Errors of tests that were held out, and how much of them the bands hold."""
    inside = [one["coverage"] for one in held if one.get("coverage") is not None]
    band = f"; the 99 % bands hold {_span(inside, 3)} of the values" if inside else ""
    if inside and (widths := [x for one in held if (x := one.get("half_width")) is not None]):
        band += f" (half width: {_span(widths)} of the rms)"
    return f"RMS error of the {_count(held)} that {_were(held)} held out: {_errors(held)}{band}."


def fit_sentence(summary: Summary) -> str:
    """RMS error of the fitted tests by the fit alone, where nothing was drawn yet."""
    errors = list((summary.get("quick") or {}).values())
    if not errors:
        return "What the fit misses is known after the posterior is drawn."
    tests = "the fitted test" if len(errors) == 1 else f"the {len(errors)} fitted tests"
    return f"RMS error of {tests}: {_span(errors)}; no other test was predicted yet."


def _errors(tests: Sequence[Summary]) -> str:
    """Errors over the rms of the record, of the joint and of the best linear oscillator."""
    linear = [x for one in tests if (x := one.get("nrmse_linear")) is not None]
    beside = f" (best linear oscillator: {_span(linear)})" if linear else ""
    return f"{_span([one['nrmse'] for one in tests])} of the record's rms{beside}"


def _span(parts: Sequence[float], digits: int = 2) -> str:
    """Least and largest part in per cent."""
    least, most = (f"{float(f'{100 * one:.{digits}g}'):g}" for one in (min(parts), max(parts)))
    return f"{least} %" if least == most else f"{least} to {most} %"


def _count(tests: Sequence[Summary]) -> str:
    return "one test" if len(tests) == 1 else f"{len(tests)} tests"


def _were(tests: Sequence[Summary]) -> str:
    return "was" if len(tests) == 1 else "were"


def _unknown(summary: Summary) -> str:
    """Which parameters the data do not identify, and which the prior truncates."""
    rows, found = _rows(summary), grades(summary)
    drawn = {name: grade for name, grade in found.items() if rows[name].get("kl") is not None}
    hidden = [name for name, grade in drawn.items() if grade > 1]
    leaning = [one["reason"] for one in summary["verdict"]["findings"]
               if one["code"] == LEANING and one["status"] != "ok"]  # fmt: skip
    if hidden:
        least = _per_cent(min(abs(rows[name]["cv"]) for name in hidden))
        beside = [name for name, grade in found.items() if name not in drawn and grade <= 1]
        said = f"Not identified: {_listed(hidden)} (CV {least} % and more)"
        if beside:
            worst = _per_cent(max(abs(rows[name]["cv"]) for name in beside))
            return f"{said}; identified: {_listed(beside)} (CV {worst} % at most)."
        return f"{said}."
    if leaning:
        return f"Not sure: {leaning[0]}"
    if not drawn:
        return "Which parameters the data identify is not known of this run."
    worst = max(drawn, key=lambda name: abs(rows[name]["cv"]))
    known = "identified" if drawn[worst] == 0 else "identified, some roughly"
    return f"All parameters {known}; least certain: {worst} (CV {_per_cent(rows[worst]['cv'])} %)."


def _per_cent(cv: float) -> str:
    return f"{float(f'{100 * abs(cv):.2g}'):g}"


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _following(summary: Summary) -> str:
    """The remedy of the first finding that fails, else of the first that is not ok.

    Of a joint that is not seen no parameter can be identified: its bounds are no remedy.
    """
    against = [one for one in summary["verdict"]["findings"] if one["status"] != "ok"]
    if any(one["code"] == ABSENT for one in against):
        follows = set(ASKED["knowledge"]) - {ABSENT}
        against = [one for one in against if one["code"] not in follows]
    against.sort(key=lambda one: one["status"] != "failed")
    action = next((one["action"] for one in against if one["action"]), None)
    return f"To do next: {action}" if action else "To do next: nothing; the result can be used."
