"""TOML files checked against a table of keys: unknown and wrong ones all told at once."""

import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from jbw.campaign.keys import Key
from jbw.campaign.values import unlike
from jbw.errors import ConfigError


def text_of(path: Path, what: str, remedy: str) -> str:
    """Text of a file that somebody wrote.

    Args:
        path: The file.
        what: What it should be, for messages.
        remedy: What to do where there is none.

    Raises:
        ConfigError: No such file, or not UTF-8.
    """
    if not path.is_file():
        raise ConfigError(f"{what} `{path}` does not exist.", remedy=remedy)
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path.name} is not UTF-8: byte {error.start}.", remedy="Save it as UTF-8."
        ) from None


def document_of(source: str, file: str) -> dict[str, Any]:
    """The document that a TOML text holds.

    Args:
        source: TOML text.
        file: Its name, for messages.

    Raises:
        ConfigError: Not TOML.
    """
    try:
        return tomllib.loads(source)
    except (ValueError, RecursionError) as error:  # not TOML, or a number of thousands of digits
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise ConfigError(
            f"{file} is not valid TOML: {reason}.",
            remedy="See https://toml.io; strings need quotes, and each key stands once.",
        ) from None


def unknown_tables(document: Mapping[str, Any], tables: Collection[str]) -> list[str]:
    """What to say of tables that nobody knows."""
    return [
        f"[{key}]: unknown table{unlike(key, tables)}." for key in document if key not in tables
    ]


def checked_table(
    table: Any, keys: Mapping[str, Key], where: str, errors: list[str]
) -> dict[str, Any]:
    """The checked values of a table; what is wrong is added to the errors."""
    if not isinstance(table, dict):
        errors.append(f"{where}: must be a table, but is {table!r}.")
        return {}
    checked = {}
    for name, value in table.items():
        if name not in keys:
            errors.append(f"{where} {name}: unknown key{unlike(name, keys)}.")
            continue
        try:
            checked[name] = keys[name].check(value)
        except ValueError as error:
            errors += [f"{where} {name}: {line}" for line in str(error).splitlines()]
    errors += [
        f"{where} {name}: missing; {key.says}."
        for name, key in keys.items()
        if key.required and name not in table
    ]
    return checked


def refuse(file: str, errors: Sequence[str]) -> None:
    """Raise a ConfigError of all errors of a file; nothing where there are none."""
    if errors:
        count = "an error" if len(errors) == 1 else f"{len(errors)} errors"
        raise ConfigError("\n  ".join([f"{file} has {count}:", *errors]))
