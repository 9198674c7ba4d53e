"""Questions to the user about facts that records do not show, one by one: `jbw init --ask`.

The first questions are about the channels of files in which none is named like a response; the
others are about doubtful lines.

A line ends in `# CHECK: why` if the records do not determine it. An answer replaces its value. No
answer keeps the value, and so does an invalid answer, which is reported.
"""

import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from jbw.campaign.document import toml
from jbw.campaign.schema import parse
from jbw.errors import ConfigError, did_you_mean
from jbw.measurement.records import INPUTS, RESPONSES
from jbw.report.messages import draft as messages

LINE = re.compile(r"^(# )?(\w+) = (.+?)  # CHECK: (.*)$")
LISTS = ("band", "tones", "span")  # keys of a test whose value is a list of numbers
SAID = {
    "kind": "kind of test",
    "fs": "sampling frequency [Hz]",
    "band": messages.ASK_BAND,
    "tones": messages.ASK_TONES,
    "dwell": messages.ASK_DWELL,
    "resample": messages.ASK_RATE,
}
# a function that asks a question and returns the answer; it raises EOFError without a user
Ask = Callable[[str], str]
Tell = Callable[[str], Any]
# a function of a file and its channel names that returns the channels which the user named
Named = Callable[[Path, Collection[str]], Mapping[str, str]]
MOST_LISTED = 12  # largest number of channels that a question lists


def channels_named_by(ask: Ask, tell: Tell) -> Named:
    """Return a function that asks the user which channels of a file are response and drive.

    Files with the same channels are asked about once. An empty answer leaves a channel out.
    """
    roles_by_layout: dict[tuple[str, ...], dict[str, str]] = {}

    def named(path: Path, channels: Collection[str]) -> dict[str, str]:
        layout = tuple(channels)
        if layout not in roles_by_layout:
            roles_by_layout[layout] = _channels_of(path, channels, ask, tell)
        return roles_by_layout[layout]

    return named


def _channels_of(path: Path, channels: Collection[str], ask: Ask, tell: Tell) -> dict[str, str]:
    """Ask the user which channels are response and drive; return them by measured quantity."""
    roles: dict[str, str] = {}
    file = toml(path.name)
    with suppress(EOFError):
        for what, quantities in (("response", RESPONSES[::-1]), ("drive", INPUTS[::-1])):
            others = [channel for channel in channels if channel not in roles.values()]
            names = ", ".join(others[:MOST_LISTED])
            question = f"{file}: which channel is the {what}: {names}? [none]: "
            channel = _one_of(others, question, "", ask, tell)
            if channel:
                measured = (
                    f"{file}: which quantity does {channel} measure: {' or '.join(quantities)}?"
                )
                default = quantities[0]
                role = _one_of(quantities, f"{measured} [{default}]: ", default, ask, tell)
                roles[role] = channel
            elif what == "response":
                break
    return roles


def _one_of(names: Collection[str], question: str, default: str, ask: Ask, tell: Tell) -> str:
    """Ask until the user gives one of the names; return it, or the default for an empty answer."""
    while (answer := ask(question).strip()) and answer not in names:
        tell(f"`{answer}` is not one of the listed names. {did_you_mean(answer, names)}".rstrip())
    return answer or default


def answered(text: str, ask: Ask, tell: Tell) -> str:
    """Return the draft with the user's answers; lines without an answer stay unchanged."""
    lines = text.splitlines()
    files = ""
    for i, line in enumerate(lines):
        if line.startswith("files = "):
            files = line.partition(" = ")[2].partition("  #")[0]
        try:
            for question, to_line in _questions(line):
                answer = ask(f"{files}: {question}: ").strip()
                if answer:
                    lines[i] = _taken(lines, i, to_line(lines[i], answer), tell)
        except EOFError:
            break
    return "\n".join(lines) + ("\n" if text.endswith("\n") else "")


def still_doubtful(text: str) -> Iterator[str]:
    """Yield each line of a draft that is still marked as doubtful, with the files of its test."""
    files = ""
    for line in text.splitlines():
        if line.startswith("files = "):
            files = line.partition(" = ")[2].partition("  #")[0]
        if match := LINE.match(line):
            _, key, value, why = match.groups()
            yield f"{files}: {key} = {value}, {why}"


def _questions(line: str) -> list[tuple[str, Callable[[str, str], str]]]:
    """Return the questions about a draft's line, each with the function that uses the answer."""
    match = LINE.match(line)
    if match is None:
        return []
    off, key, value, why = match.groups()
    try:
        table = tomllib.loads(f"{key} = {value}")[key]
    except tomllib.TOMLDecodeError:
        return []
    if not isinstance(table, dict):
        default = "leave it out" if off else _shown(table)
        question = SAID.get(key, key)
        return [(f"{question} ({why}) [{default}]", lambda old, text: _value(old, key, text))]
    roles = [role for role in table if re.search(rf"\b{role}\b", why)]
    what = "unit" if key == "units" else "channel"
    return [
        (f"{what} of {role} [{table[role]}]", lambda old, text, role=role: _of(old, role, text))
        for role in roles
    ]


def _shown(value: Any) -> str:
    return ", ".join(f"{x:g}" for x in value) if isinstance(value, list) else str(value)


def _value(line: str, key: str, answer: str) -> str:
    """Return a draft's line with the user's answer and without the mark of doubt."""
    numbers = [part for part in re.split(r"[,;\s]+", answer.strip("[] ")) if part]
    try:
        values = [float(number) for number in numbers]
    except ValueError:
        return f"{key} = {toml(answer)}"
    return f"{key} = {toml(values if key in LISTS else values[0])}"


def _of(line: str, role: str, answer: str) -> str:
    """Return a line with one quantity's unit or channel replaced; keep its other CHECK marks."""
    match = LINE.match(line)
    body, why = (line, "") if match is None else (line.partition("  # CHECK: ")[0], match[4])
    key, _, value = body.partition(" = ")
    table = tomllib.loads(f"{key} = {value}")[key] | {role: answer}
    rest = re.sub(rf"(, )?\b{role}\b", "", why, count=1)
    still = any(re.search(rf"\b{other}\b", rest) for other in table)
    return f"{key} = {toml(table)}" + (f"  # CHECK: {rest}" if still else "")


def _taken(lines: list[str], i: int, line: str, tell: Tell) -> str:
    """Return the new line, or the old line if the new one makes the campaign file invalid."""
    before, after = (
        _error("\n".join([*lines[:i], new_line, *lines[i + 1 :]])) for new_line in (lines[i], line)
    )
    if after is not None and after != before:
        tell(f"{after} Kept: {lines[i].partition('  # CHECK')[0]}")
        return lines[i]
    return line


def _error(text: str) -> str | None:
    try:
        parse(text)
    except ConfigError as error:
        return " ".join(error.what.split())
    return None
