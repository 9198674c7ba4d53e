"""The outcomes of a run as tables: sound records, records with faults, drafts and fits."""

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

# Findings that name no fault: a record is short, coarse, noisy, or longer than needed.
NEUTRAL = re.compile(
    r"independent values|too short|hardly more than the resolution|median coherence|coarse|"
    r"changes nothing|distinct values|were both recorded",
    re.I,
)
# faults that do not change frequency and damping
UNREAD = ("polarity", "base motion", "unit of one file", "polarity of one file", "file twice")


def tables(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the tables of a run in Markdown."""
    good = [row for row in rows if "benchmark" not in row]
    of_sound = [row for row in good if row["what"] == "sound"]
    spoilt = [row for row in good if row["what"] == "mishandled"]
    if of_sound:
        yield _markdown(
            ("sound", "law", "number", "accused", "refused", "read", "linear called nonlinear",
             "strong found nonlinear", "f in 99 %", "damping in 99 %", "width of f / bound",
             "of damping", "error of f / damping", "of damping"),
            _sound_rows(of_sound),
        )  # fmt: skip
    if spoilt:
        yield _markdown(
            ("mishandled", "kind", "number", "named", "another name", "silent", "silent and wrong",
             "lines pasted", "cure", "accepted and wrong"),
            _spoilt_rows(spoilt),
        )  # fmt: skip
    drafts = [row for row in good if "draft" in row]
    if drafts:
        yield _markdown(
            ("draft of", "number", "no error", "asks something"),
            [
                (kind, len(group), sum(not (x["draft"]["errors"] or x["draft"]["refused"])
                                       for x in group),
                 sum(bool(x["draft"]["asked"]) for x in group))
                for kind, group in _groups(drafts, "kind")
            ],
        )  # fmt: skip
    timed = [row for row in good if "stretched" in row]
    if timed:
        others = [str(row["number"]) for row in timed if not row["stretched"]["same"]]
        yield (
            f"Said otherwise of the same motion in another time: {len(others)} of {len(timed)}"
            f"{': numbers ' + ', '.join(others) if others else ''}.\n"
        )
    fitted = [row for row in good if "quick" in row]
    if fitted:
        yield _markdown(
            ("first answer of", "number", "refused", "status ok or not assessed",
             "largest error of a group", "omega_n off by, sd", "zeta off by, sd"),
            _quick_rows(fitted),
        )  # fmt: skip
    failed = len(rows) - len(good)
    accused = sum(row["accused"] for row in of_sound)
    linear = [row for row in of_sound if row["law"] == "linear"]
    unnamed = [row for row in spoilt if not row["named"]]
    yield (
        f"Sound and accused: {accused} of {len(of_sound)}. Linear and called nonlinear: "
        f"{sum(row['nonlinear'] for row in linear)} of {len(linear)}. Mishandled and not named: "
        f"{len(unnamed)} of {len(spoilt)}; silent and wrong: {sum(map(_astray, spoilt))}."
        + (f" Failures of the benchmark itself: {failed}." if failed else "")
    )


def _sound_rows(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[Any, ...]]:
    for kind, group in [*_groups(rows, "kind"), ("all", list(rows))]:
        laws = _groups(group, "law") if kind != "all" else []
        for law, part in [*laws, ("all", group)]:
            strong = [row for row in part if row["law"] != "linear" and row["strong"]]
            linear = [row for row in part if row["law"] == "linear"]
            yield (
                kind, law, len(part), sum(bool(_accusations(row)) for row in part),
                sum(bool(row["errors"]) for row in part), sum(row["read"] for row in part),
                _share(row["nonlinear"] for row in linear),
                _share(row["nonlinear"] for row in strong),
                _percent(part, "inside_hz"), _percent(part, "inside_zeta"),
                _median(part, "width_hz"), _median(part, "width_zeta"),
                _median(part, "hz_error"), _median(part, "zeta_error"),
            )  # fmt: skip


def _quick_rows(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[Any, ...]]:
    for kind, group in _groups(rows, "kind"):
        answers = [row["quick"] for row in group if "refused" not in row["quick"]]
        errors = [max(one["quick"].values()) for one in answers if one.get("quick")]
        off = {
            name: [abs(one["off_by_sd"][name]) for one in answers if name in one["off_by_sd"]]
            for name in ("omega_n", "zeta")
        }
        yield (
            kind, len(group), len(group) - len(answers),
            sum(one["verdict"]["status"] != "failed" for one in answers),
            f"{np.median(errors):.2g}" if errors else "-",
            *(f"{np.median(values):.2g}" if values else "-" for values in off.values()),
        )  # fmt: skip


def _accusations(row: dict[str, Any]) -> list[str]:
    return [x["what"] for x in row["findings"] if not NEUTRAL.search(x["what"])] + row["errors"]


def _spoilt_rows(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[Any, ...]]:
    for fault, group in [*_groups(rows, "fault"), ("all", list(rows))]:
        kinds = _groups(group, "kind") if fault != "all" else [("all", group)]
        for kind, part in kinds:
            pasted = [one["result"] for row in part for one in row["remedies"]]
            yield (
                fault, kind, len(part), sum(row["named"] for row in part),
                sum(row["accused"] and not row["named"] for row in part),
                sum(not (row["accused"] or row["named"]) for row in part),
                sum(map(_astray, part)),
                len(pasted), pasted.count("cures"), pasted.count("wrong"),
            )  # fmt: skip


def _astray(row: dict[str, Any]) -> bool:
    """Return whether a record with a fault gives a wrong answer without any warning.

    Some faults leave frequency and damping as they are, but distort the data to which a joint is
    fitted.
    """
    silent = not (row["accused"] or row["named"])
    return silent and row["read"] and (row["fault"] in UNREAD or not row["right"])


def _groups(rows: Sequence[dict[str, Any]], key: str) -> list[tuple[str, list[dict[str, Any]]]]:
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(row[key], []).append(row)
    return list(found.items())


def _share(values: Iterator[bool]) -> str:
    found = list(values)
    return f"{sum(found)} of {len(found)}" if found else "-"


def _values(rows: Sequence[dict[str, Any]], key: str) -> list[float]:
    return [value for row in rows for value in row.get(key, [])]


def _percent(rows: Sequence[dict[str, Any]], key: str) -> str:
    values = _values(rows, key)
    return f"{100 * np.mean(values):.1f} %" if values else "-"


def _median(rows: Sequence[dict[str, Any]], key: str) -> str:
    values = np.abs(_values(rows, key))
    return f"{np.median(values):.2g}" if len(values) else "-"


def _markdown(heads: Sequence[str], rows: Any) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"
