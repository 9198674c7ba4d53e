"""Validation of TOML files: all errors are reported at once, each in a sentence.

Common slips that are not valid TOML are reported with the corrected line.
"""

import json
import re
import shlex
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from jbw.errors import ConfigError
from jbw.inference.density import Density
from jbw.measurement.spans import toml_table
from jbw.report.messages import campaign_faults as messages
from jbw.report.messages.campaign_faults import SEE_TOML
from jbw.report.messages.message import Template, written

NAMED = "campaign.toml"
CAMPAIGN = "Campaign file", "Write a campaign file with: jbw init FOLDER"
MOST_BYTES = 2**20  # largest size of a campaign file in bytes, enough for several thousand tests
LISTED = 20  # largest number of keys or errors that are listed one by one
# sentences for errors that pydantic finds; this package's own checks have separate sentences
SENTENCES = {
    "bool_type": "must be true or false, but is {value!r}.",
    "greater_than": "must be positive, but is {value}.",
    "greater_than_equal": "must not be negative, but is {value}.",
}
# characters that word processors and web pages use in place of quotes, minus signs and blanks
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
# KEY matches a key, or a quantity in its table, with its value; HEAD matches a table's heading.
KEY = re.compile(r"\s*([\w-]+)(?:\.([\w-]+))?\s*=\s*(.*\S)\s*")
HEAD = re.compile(r"\s*\[\s*([\w.-]+)\s*\]\s*")
WORDS_OF_TOML = {
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


class FileTable(BaseModel):
    """A table of a file: immutable, and without unknown keys.

    Unpacked as a mapping (`{**table}`) it contains only stated keys, without the defaults.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    def keys(self) -> Iterator[str]:
        """Return the names of stated keys only, so that `{**settings}` contains no defaults."""
        return (name for name in type(self).model_fields if name in self.model_fields_set)

    def __iter__(self) -> Iterator[str]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self.keys()

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)


def key(default: Any, says: str, example: Any = None) -> Any:
    """Return the field for a table's key: default (or factory, or `...`), meaning and example."""
    default_field: dict[str, Any] = {"default_factory" if callable(default) else "default": default}
    return Field(**default_field, description=says, examples=None if example is None else [example])


def unlike(name: str, names: Iterable[str]) -> str:
    """Return the end of an error about an unknown name: the most similar name, and all names."""
    names = list(names)
    nearest = get_close_matches(str(name), names, n=1, cutoff=0.5)
    return (f"; did you mean `{nearest[0]}`" if nearest else "") + f" (known: {', '.join(names)})"


def text_of(path: Path, what: str, remedy: str) -> str:
    """Return the text of a file that a user wrote; `what` and `remedy` are for its errors.

    Raises:
        ConfigError: The file does not exist, cannot be read, or is not UTF-8.
    """
    require_file(path, what, remedy)
    if (size := path.stat().st_size) > MOST_BYTES:
        raise ConfigError(
            f"{what} `{path}` must be of {MOST_BYTES // 2**20} MiB at most, but has {size} bytes.",
            why="A campaign file names the files of samples; it does not contain samples.",
            remedy='Name the files by patterns such as files = "run_*.h5".',
        )
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"File {path.name} is not UTF-8 text: byte {error.start} is invalid.",
            remedy="Save the campaign file as UTF-8.",
        ) from None


def document_of(source: str, file: str) -> dict[str, Any]:
    """Return the document in the TOML text of a file.

    Raises:
        ConfigError: The text is not TOML.
    """
    try:
        return tomllib.loads(source)
    # The text is not TOML, or it contains a number with thousands of digits.
    except (ValueError, RecursionError) as error:
        if isinstance(error, RecursionError):
            reason, remedy = "nested too deeply", SEE_TOML
        else:
            reason, remedy = slip_of(source, error) or (error, SEE_TOML)
        raise ConfigError(f"{file} is not valid TOML: {reason}.", remedy=remedy) from None


def unknown_tables(document: Mapping[str, Any], tables: Collection[str]) -> list[str]:
    """Return a sentence on each unknown table of a file; if there are many, only their number."""
    unknown = [name for name in document if name not in tables]
    sentences = [f"[{name}]: unknown table{unlike(name, tables)}." for name in unknown[:LISTED]]
    return sentences + (
        [f"{len(unknown) - LISTED} more unknown tables."] if unknown[LISTED:] else []
    )


def checked[Found: FileTable](
    model: type[Found], table: Any, where: str, errors: list[str]
) -> Found | None:
    """Validate a table and return its record; for errors, append sentences and return None.

    `where` is the name of the table in messages, such as `[identify]`.
    """
    if not isinstance(table, Mapping):
        errors.append(f"{where}: must be a table, but is {table!r}.")
        return None
    unknown = [name for name in table if name not in model.model_fields]
    if len(unknown) > LISTED:
        shown = ", ".join(unknown[:3])
        errors.append(f"{where}: {len(unknown)} unknown keys: {shown[:60]}, ...")
        return None
    try:
        return model.model_validate(table)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            errors += [f"{where}{line}" for line in _lines(model, detail)]
    return None


def _lines(model: type[FileTable], error: ErrorDetails) -> Iterator[str]:
    """Yield the sentences on one validation error of a TOML table; each names the table's key."""
    key, *inner = [str(part) for part in error["loc"] if isinstance(part, str)] or [""]
    # If an error concerns a whole table, the text of the error may already begin with a key.
    names = f" {': '.join([key, *inner])}: " if key else ""
    for line in _sentence(model, key, error).splitlines():
        yield names + line if names else f" {line}" if re.match(r"\w+:", line) else f": {line}"


def _sentence(model: type[FileTable], key: str, error: ErrorDetails) -> str:
    code, value, context = error["type"], error["input"], error.get("ctx", {})
    if code == "extra_forbidden":
        return f"unknown key{unlike(key, model.model_fields)}."
    field = model.model_fields.get(key)
    if code == "missing" and field:
        return f"missing; {field.description}."
    if code == "literal_error":
        words = re.findall(r"'([^']*)'", context["expected"])
        if isinstance(value, str):
            return f"{value!r} is unknown{unlike(value, words)}."
        return f"must be a string, but is {value!r}."
    if code == "value_error":
        return str(context["error"])
    if code in ("mapping_type", "dict_type") and field and field.examples:
        return f"must be a table such as {toml(field.examples[0])}, but is {value!r}."
    if code in SENTENCES:
        return SENTENCES[code].format(value=value)
    return f"{error['msg']}, but is {value!r}."


def refuse(file: str, errors: Sequence[str]) -> None:
    """Raise a ConfigError that lists all errors of a file; do nothing without errors."""
    if errors:
        count = "an error" if len(errors) == 1 else f"{len(errors)} errors"
        shown = errors[: 5 * LISTED]
        more = [f"and {len(errors) - len(shown)} more."] if len(errors) > len(shown) else []
        raise ConfigError("\n  ".join([f"{file} has {count}:", *shown, *more]))


def json_schema(model: type[FileTable]) -> dict[str, Any]:
    """Return the JSON Schema of a file's model for editors, without empty titles and defaults."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return head | _plain(model.model_json_schema())


def _plain(node: Any) -> Any:
    if isinstance(node, list):
        return [_plain(item) for item in node]
    if not isinstance(node, dict):
        return node
    plain = {key: _plain(item) for key, item in node.items()}
    if isinstance(plain.get("title"), str):
        del plain["title"]
    default = plain.get("default", 0)
    if default in (None, {}, []) or default != default:  # NaN means that no value is stated.
        del plain["default"]
    # TOML has no null, so an optional key is simply absent.
    options = [option for option in plain.pop("anyOf", []) if option != {"type": "null"}]
    if len(options) == 1:
        return plain | options[0]
    return plain | {"anyOf": options} if options else plain


def toml(value: Any) -> str:
    """Return a value in TOML notation."""
    if isinstance(value, Density):
        value = value.table()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    # Strings, numbers and lists of JSON are also valid TOML.
    return json.dumps(value, ensure_ascii=False)


def commented(table: type[FileTable], names: Iterable[str]) -> list[str]:
    """Return comment lines that offer additional keys of a table, each with example and meaning."""
    fields = {name: table.model_fields[name] for name in names}
    return [
        f"# {name} = {toml(field.examples[0]) if field.examples else '...'}  # {field.description}"
        for name, field in fields.items()
    ]


class Slip(NamedTuple):
    """A common mistake in a TOML line: the message, and a function that corrects the line."""

    says: Template
    cured: Callable[[str], str]


def _with_straight_quotes(line: str) -> str:
    return line.translate(STRAIGHT)


def _with_forward_slashes(line: str) -> str:
    """Replace backslashes by forward slashes in double-quoted paths; Windows accepts both."""
    return DOUBLE_QUOTED.sub(lambda match: re.sub(r"\\+", "/", match[0]), line)


def _with_decimal_points(line: str) -> str:
    return COMMA.sub(r"\1.\2", line)


def _with_whole_numbers(line: str) -> str:
    """Write digits on both sides of every decimal point in a TOML line."""
    return POINT.sub(lambda match: f"{match[1] or 0}.{match[2] or 0}", line)


def _with_quotes(line: str) -> str:
    """Put the bare words of a TOML line in quotes, or replace them by the constants they mean."""

    def quoted(match: re.Match[str]) -> str:
        value = WORDS_OF_TOML.get(match[2]) or '"{}"'.format(match[2].replace("\\", "/"))
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
    """Return the reason why a text is not TOML, and the remedy; None if the cause is unknown.

    A slip counts as the cause if the corrected text is TOML up to a later line.
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
    """Return error and remedy if two lines state the same key or table; otherwise None."""
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
    if first[2] and last[2]:  # Lines of one table with different dotted keys are valid.
        return None
    role, item, table = (last[2], last[3], first[3]) if last[2] else (first[2], first[3], last[3])
    return _in_one_table(last[1], role, item, table, (other, number))


def _in_one_table(
    key: str, role: str, item: str, table: str, numbers: tuple[int, int]
) -> tuple[str, str] | None:
    """Merge two lines that state a key for several quantities; return message and merged line."""
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
    """Return whether the text is valid TOML up to and including the given line."""
    source = "\n".join(lines)
    try:
        tomllib.loads(source)
    except RecursionError:  # The table is nested too deeply in a later line.
        return False
    except ValueError as error:
        return _line_number(error, source) > number
    return True


def _line_number(error: Exception, source: str) -> int:
    """Return the line (from 1) at which TOML parsing failed; the last line if none is stated."""
    match = re.search(r"\(at line (\d+),", str(error))
    return int(match[1]) if match else source.count("\n") + 1


def is_campaign(path: Path) -> bool:
    """Return whether a path has the name of a campaign file."""
    return path.suffix.lower() == ".toml" and not path.is_dir()


def campaign_in(folder: Path) -> Path | None:
    """Return the campaign file of a folder: `campaign.toml`, or its only TOML campaign file."""
    inside = sorted(folder.glob("*.toml"))
    usual = [path for path in inside if path.name == NAMED] or inside
    return usual[0] if len(usual) == 1 else None


def require_file(path: Path, what: str, remedy: str) -> None:
    """Raise a ConfigError unless a path is a readable file; see `text_of` for the arguments."""
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
        if is_file:
            path.open("rb").close()
    except PermissionError:
        raise ConfigError(
            f"{what} `{path}` must be readable, but permission is denied.",
            remedy="Ask the owner of the file for permission to read the file and the folder.",
        ) from None
    if is_folder:
        inside = sorted(path.glob("*.toml")) or sorted(path.glob("*/*.toml"))
        raise ConfigError(
            f"{what} `{path}` must be a file, but it is a folder.",
            remedy=f"Name the file in this folder: {shlex.quote(str(inside[0]))}"
            if inside
            else remedy.replace("FOLDER", shlex.quote(str(path))),
        )
    if not is_file:
        raise ConfigError(f"{what} `{path}` does not exist.", remedy=remedy)
