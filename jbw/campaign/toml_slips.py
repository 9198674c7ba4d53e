"""What people write that is not TOML, with the line as it should stand."""

import re
import tomllib
from collections.abc import Callable
from typing import NamedTuple

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


def _is_toml_to(number: int, lines: list[str]) -> bool:
    """Whether lines are TOML up to that of a number, itself included."""
    source = "\n".join(lines)
    try:
        tomllib.loads(source)
    except ValueError as error:
        return _line_number(error, source) > number
    return True


def _line_number(error: Exception, source: str) -> int:
    """The line at which a text was found to be no TOML, counted from one; its last, of its end."""
    match = re.search(r"\(at line (\d+),", str(error))
    return int(match[1]) if match else source.count("\n") + 1
