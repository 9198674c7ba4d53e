"""Remedies: lines to put into a campaign file, and when to take more draws or another sampler."""

import json
import re
from typing import Any

PUT = "Put under [[test]]:"
LEAVE_OUT_BY_NUMBER = "leave the record out by its number in `exclude`"
LEAVE_OUT_TEST = "Leave the test out."
NO_LINE = "Measure again: no change of the campaign file was found that repairs this fault."
OTHER_LAWS = "Try other laws: jbw laws."
# patterns that find the texts of the functions below in a remedy
SPAN = re.compile(r"`span = \[([^,\]]+), ([^\]]+)\]`")
EXCLUDE = re.compile(r"`exclude = (\[[^`]*\])`")
ONLY_LEFT_OUT = re.compile(rf"{re.escape(PUT)} `exclude = [^`]*`\.")
OR_LEFT_OUT = re.compile(r",? or leave the records? out: `exclude = [^`]*`")
# pattern of a table with one key, a role, whose value is a factor or a unit
OF_ONE_ROLE = re.compile(r'(scale|units) = \{ (\w+) = (-?[\d.]+|"[^"]+") \}')


def span(first: float, last: float) -> str:
    """Return the campaign line that keeps a part of a record [s]."""
    return f"`span = [{first}, {last}]`"


def periods(first: float, last: float, count: int) -> str:
    """Return the campaign keys that cut a record to whole periods between two times [s]."""
    return f"{span(first, last)} and `periods = {count}`"


def exclude(files: str) -> str:
    """Return the campaign line that excludes files, given as a TOML list."""
    return f"`exclude = {files}`"


def leave_out(files: str) -> str:
    """Return the remedy that excludes a record by the name of its file."""
    return f"leave the record out: {exclude(files)}"


def part_or_leave_out(part_line: str, leaving_out: str) -> str:
    """Return the remedy: use the part without bad samples, or exclude the record."""
    return f"{part_line}, a part without these samples, or {leaving_out}."


def put(table: str, key: str, value: Any) -> str:
    """Return the sentence on the key and value to put under a table of a campaign file."""
    return f"Put under [{table}]: `{key} = {json.dumps(value)}`."


def beside_other_laws(line: str) -> str:
    """Return the remedy to try another law: the line to paste, and the comparing command."""
    return f"{line} To compare this and other laws, such as a gap between contacts: jbw laws."


def draw_more(num_samples: int | None, sampler: str) -> str:
    """Return the remedy for too few draws: more samples, or another sampler."""
    if num_samples is None:
        line = put("identify", "sampler", sampler)
        return f"Use another sampler: more draws of the present one will not be enough. {line}"
    return f"Draw more samples. {put('identify', 'num_samples', num_samples)}"
