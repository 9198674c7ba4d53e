"""What people write that is not TOML, with the line as it should stand."""

import re
import tomllib
from collections.abc import Callable
from math import prod
from typing import NamedTuple

from jbw.measurement.spans import toml_table
from jbw.report.messages import campaign_faults as messages
from jbw.report.messages.message import Template, written

# What word processors, mail programs and web pages make of quotes, minus signs and blanks.
DOUBLE, SINGLE = "“”„‟«»″", "\u2018\u2019\u201a\u201b\u2039\u203a\u2032"
STRAIGHT = str.maketrans(
    dict.fromkeys(DOUBLE, '"') | dict.fromkeys(SINGLE, "'")
    | dict.fromkeys("−–", "-") | dict.fromkeys("\u00a0\u2007\u202f\u2009", " ")
)  # fmt: skip
TYPED = re.compile(f"[{DOUBLE}{SINGLE}−–\u00a0\u2007\u202f\u2009]")
DOUBLE_QUOTED = re.compile(r'"[^"]*"')
COMMA = re.compile(r"(?<![\w.,\"'])([-+]?\d+),(\d+)(?![\w.])")
POINT = re.compile(r"(?<![\w.\"'])(\d*)\.(\d*)(?![\w.\"'])")
BARE = re.compile(r"""(=\s*)([A-Za-z_/~*][^\s"'#{}\[\],=]*)(?=\s*(?:[,}\]#]|$))""")
# A key, or a role in its table, and the value; the head of a table.
KEY = re.compile(r"\s*([\w-]+)(?:\.([\w-]+))?\s*=\s*(.*\S)\s*")
HEAD = re.compile(r"\s*\[\s*([\w.-]+)\s*\]\s*")
WORDS = {
    "true": "true",
    "false": "false",
    "True": "true",
    "False": "false",
    "NaN": "nan",
    "NAN": "nan",
    "Inf": "inf",
    "nan": "nan",
    "inf": "inf",
}


class Slip(NamedTuple):
    """A slip of the pen: what is wrong with a line, and the line without it."""

    says: Template
    cured: Callable[[str], str]


def _with_straight_quotes(line: str) -> str:
    return line.translate(STRAIGHT)


def _with_forward_slashes(line: str) -> str:
    """The line whose double quotes hold paths with forward slashes, which Windows takes as well."""
    return DOUBLE_QUOTED.sub(lambda match: re.sub(r"\\+", "/", match[0]), line)


def _with_decimal_points(line: str) -> str:
    return COMMA.sub(r"\1.\2", line)


def _with_whole_numbers(line: str) -> str:
    """The line whose numbers have digits on both sides of their points."""
    return POINT.sub(lambda match: f"{match[1] or 0}.{match[2] or 0}", line)


def _with_quotes(line: str) -> str:
    """The line whose bare words are in quotes, or are the constants that they mean."""

    def quoted(match: re.Match[str]) -> str:
        value = WORDS.get(match[2]) or '"{}"'.format(match[2].replace("\\", "/"))
        return f"{match[1]}{value}"

    return BARE.sub(quoted, line)


SLIPS = (
    Slip(messages.typographic, _with_straight_quotes),
    Slip(messages.BACKSLASH, _with_forward_slashes),
    Slip(messages.DECIMAL_COMMA, _with_decimal_points),
    Slip(messages.BARE_POINT, _with_whole_numbers),
    Slip(messages.BARE_WORD, _with_quotes),
)


def slip_of(source: str, error: Exception) -> tuple[str, str] | None:
    """What is wrong with a text that is not TOML and what to write instead; None where unknown.

    A slip is the cause where the text without it is TOML up to a later line.
    """
    number, lines = _line_number(error, source), source.split("\n")
    if (twice := _stated_twice(number, lines)) is not None:
        return twice
    line = lines[number - 1]
    for slip in SLIPS:
        cured = slip.cured(line)
        if cured == line or not _is_toml_to(number, [*lines[: number - 1], cured, *lines[number:]]):
            continue
        typed = " ".join(
            "a wide blank" if c.isspace() else c for c in sorted({*TYPED.findall(line)})
        )
        further = [
            i for i, other in enumerate(lines, 1) if i > number and slip.cured(other) != other
        ]
        says = written(slip.says, {"typed": typed})
        return f"line {number} {says}", messages.mended(number, cured.strip(), further)
    return None


def _stated_twice(number: int, lines: list[str]) -> tuple[str, str] | None:
    """Two lines that state one key, and how to make one of them; None where there are none."""
    if head := HEAD.fullmatch(lines[number - 1]):
        opened = {match[1]: i for i, x in reversed([*enumerate(lines[: number - 1], 1)])
                  if (match := HEAD.fullmatch(x))}  # fmt: skip
        first = opened.get(head[1])
        return None if first is None else messages.table_again(number, head[1], first)
    begins = max(
        (i for i, x in enumerate(lines[:number], 1) if x.lstrip().startswith("[")), default=0
    )
    stated = [(i, KEY.fullmatch(lines[i - 1])) for i in range(begins + 1, number + 1)]
    last = stated[-1][1] if stated else None
    same = [(i, key) for i, key in stated[:-1] if key and last and key[1] == last[1]]
    if last is None or not same:
        return None
    other, first = same[-1]
    if first[2] == last[2]:
        return messages.key_again(number, last[1], other)
    if first[2] and last[2]:  # two roles, each with a line of its own
        return None
    role, item, table = (last[2], last[3], first[3]) if last[2] else (first[2], first[3], last[3])
    return _in_one_table(last[1], role, item, table, (other, number))


def _in_one_table(
    key: str, role: str, item: str, table: str, numbers: tuple[int, int]
) -> tuple[str, str] | None:
    """A line with all that two lines state of roles; a factor multiplies one that is stated."""
    try:
        stated, value = tomllib.loads(f"table = {table}\nitem = {item}").values()
    except (ValueError, RecursionError):
        return None
    if not isinstance(stated, dict):
        return None
    if key == "scale" and role in stated:
        factors = (stated[role], value)
        if not all(isinstance(factor, int | float) for factor in factors):
            return None
        value = prod(factors)
    return messages.in_one_table(*numbers, key, f"{key} = {toml_table({**stated, role: value})}")


def _is_toml_to(number: int, lines: list[str]) -> bool:
    """Whether lines are TOML up to that of a number, itself included."""
    source = "\n".join(lines)
    try:
        tomllib.loads(source)
    except RecursionError:  # nested too deeply further down
        return False
    except ValueError as error:
        return _line_number(error, source) > number
    return True


def _line_number(error: Exception, source: str) -> int:
    """The line at which a text was found to be no TOML, counted from one; its last, of its end."""
    match = re.search(r"\(at line (\d+),", str(error))
    return int(match[1]) if match else source.count("\n") + 1
