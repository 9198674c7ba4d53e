"""Parsing of table cells that are no plain numbers: lost samples, grouped digits, dates, times."""

import re
from collections.abc import Sequence

import numpy as np

from jbw.measurement.channels import Reals

# Words, in lower case, that recorders write instead of a lost sample.
LOST = frozenset(
    ("", "-", "--", "---", "*", "nan", "n/a", "na", "#n/a", "null", "none", "nil", "ovl", "ovld",
     "overload", "ovf", "overflow", "over", "missing", "lost", "invalid", "no data", "err",
     "error", "#value!", "1.#qnan", "-1.#ind", "1.#inf", "?")
)  # fmt: skip
GROUPED = {
    ".": re.compile(r"[-+]?\d{1,3}(?:[,' ]\d{3})+\.\d+(?:[eE][-+]?\d+)?"),
    ",": re.compile(r"[-+]?\d{1,3}(?:[.' ]\d{3})+,\d+(?:[eE][-+]?\d+)?"),
}
CLOCK = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?\s*([AaPp][Mm])?(?:Z|[+-]\d\d:?\d\d)?"
DATES = (r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})", r"(\d{1,2})[./-](\d{1,2})[./-](\d{4}|\d{2})")
STAMP = re.compile(rf"(?:(?:{DATES[0]}|{DATES[1]})(?:[ T,;_]+|$))?(?:{CLOCK})?")
DAY = 86400.0
DIGITS = 9  # largest number of decimals of the second in a time stamp


def is_lost(text: str) -> bool:
    """Return whether a cell stands for a lost sample."""
    return text.partition("(")[0].strip().lower() in LOST


def ungrouped(text: str, decimal: str) -> str:
    """Return the text of a number without thousands separators, with a decimal point."""
    if GROUPED[decimal].fullmatch(text):
        return re.sub(r"[.' ]" if decimal == "," else r"[,' ]", "", text).replace(",", ".")
    if decimal == ",":
        return text.replace(".", "?").replace(",", ".")
    return text


def stamp(text: str) -> tuple[int, float] | None:
    """Parse a date, a time of day or both into day number and seconds; None for other text."""
    if ":" not in text and text.count("-") + text.count(".") + text.count("/") < 2:
        return None
    match = STAMP.fullmatch(text.strip()) if 5 < len(text) <= 40 else None
    if not match or not (match[7] or match[1] or match[4]):
        return None
    year, month, day = (int(x) for x in (match[1], match[2], match[3]) if x) if match[1] else (
        (int(match[6]), int(match[5]), int(match[4])) if match[4] else (0, 1, 1)
    )  # fmt: skip
    if not (1 <= month <= 31 and 1 <= day <= 31):
        return None
    # Only differences count, so the order of month and day matters only at midnight.
    days = 372 * year + 31 * month + day
    if not match[7]:
        return days, 0.0
    hours, minutes, seconds = int(match[7]), int(match[8]), int(match[9] or 0)
    if (match[11] or "").lower() == "pm" and hours < 12:
        hours += 12
    if (match[11] or "").lower() == "am" and hours == 12:
        hours = 0
    if minutes > 59 or seconds > 60 or hours > 24:
        return None
    part = int(match[10]) / 10 ** len(match[10]) if match[10] else 0.0
    return days, hours * 3600.0 + minutes * 60.0 + seconds + part


def since_first(stamps: Sequence[tuple[int, float] | None]) -> Reals:
    """Return the seconds since the first stamp, also across midnight; NaN for a missing stamp."""
    seconds = np.array([np.nan if moment is None else moment[1] for moment in stamps])
    days = np.array([0 if moment is None else moment[0] for moment in stamps])
    # Each change of date counts as the next day, whatever the month. Times without a date begin a
    # new day when they fall by more than half a day.
    turned = np.concatenate([[0.0], np.cumsum(np.diff(days) != 0)])
    plain = np.nan_to_num(seconds)
    if not turned.any():
        turned = np.concatenate([[0.0], np.cumsum(np.diff(plain) < -DAY / 2)])
    first = seconds[np.isfinite(seconds)][:1]
    since = seconds + DAY * turned - (first[0] if len(first) else 0.0)
    # This removes the round-off of the time of day.
    return np.asarray(np.round(since, DIGITS), np.float64)
