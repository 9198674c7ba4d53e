"""From the text of a campaign file to its checked values; all errors at once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jbw.campaign.document import (
    checked_table,
    document_of,
    refuse,
    text_of,
    unknown_tables,
)
from jbw.campaign.keys import CAMPAIGN, IDENTIFY, MASKABLE, RESPONSES, SOURCES, TABLES, TEST
from jbw.measurement.roles import ratio_of


@dataclass(frozen=True)
class TestSpec:
    """One [[test]] table, checked; the fields are its keys."""

    __test__ = False  # not a pytest class

    kind: str
    files: tuple[str, ...] | Mapping[str, tuple[str, ...]]
    channels: Mapping[str, str]
    units: Mapping[str, str] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    name: str = ""
    level: float = float("nan")
    fs: float | str | None = None
    band: tuple[float, float] | None = None
    tones: tuple[float, ...] = ()
    dwell: float = float("nan")
    settle: float = 0.0
    delay: float = 0.0
    assembly: str = ""
    run: str = ""
    repeats: str = "files"
    exclude: tuple[int | str, ...] = ()
    span: tuple[float, float] | None = None
    amplitudes: str = "peak"
    periods: int = 1
    remove_mean: bool = False
    gaps: str = "refuse"


@dataclass(frozen=True)
class CampaignSpec:
    """A campaign file, checked; no measurement file has been opened yet."""

    name: str
    tests: tuple[TestSpec, ...]
    gain: float | None = None
    modal_mass: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


def parse(source: str, file: str = "campaign.toml") -> CampaignSpec:
    """Check the text of a campaign file against the schema.

    Args:
        source: TOML text.
        file: Its name, for messages.

    Raises:
        ConfigError: Not TOML, or anything unknown, missing or of the wrong type; all at once.
    """
    document, errors = document_of(source, file), []
    spec = _campaign(document, errors)
    refuse(file, errors)
    return spec


def read_spec(path: Path) -> CampaignSpec:
    """Read and check a campaign file.

    Raises:
        ConfigError: No such file, not UTF-8 TOML, or against the schema.
    """
    source = text_of(path, "Campaign file", "Write one with: jbw init FOLDER")
    return parse(source, path.name)


def _campaign(document: Mapping[str, Any], errors: list[str]) -> CampaignSpec:
    errors += unknown_tables(document, TABLES)
    head = checked_table(document.get("campaign", {}), CAMPAIGN, "[campaign]", errors)
    if {"gain", "modal_mass"} <= set(head):
        errors.append("[campaign]: give gain or modal_mass, not both; they say the same.")
    tables = document.get("test", [])
    if not isinstance(tables, list) or not tables:
        errors.append("[[test]]: at least one test is needed, each under its own [[test]].")
        tables = []
    tests = [_test(table, f"[[test]] {i + 1}", errors) for i, table in enumerate(tables)]
    settings = checked_table(document.get("identify", {}), IDENTIFY, "[identify]", errors)
    specs = [test for test in tests if test is not None]
    if len(specs) == len(tests):
        _unique_names(specs, errors)
        _levels_exist(specs, settings, errors)
    head.setdefault("name", "campaign")
    return CampaignSpec(tests=tuple(specs), settings=settings, **head)


def _test(table: Any, where: str, errors: list[str]) -> TestSpec | None:
    before = len(errors)
    checked = checked_table(table, TEST, where, errors)
    if len(errors) > before:
        return None
    test = TestSpec(**checked)
    errors += [f"{where} {message}" for message in _needs(test)]
    return test if len(errors) == before else None


def _needs(test: TestSpec) -> list[str]:
    """What a test's kind needs and its table lacks, and what contradicts."""
    roles = set(test.channels)
    told = [
        f"{key} names role `{role}`, which channels does not."
        for key, names in (("units:", test.units), ("scale:", test.scale))
        for role in names
        if role not in roles
    ]
    if not roles & RESPONSES:
        told.append(f"channels: needs a response, one of {', '.join(sorted(RESPONSES))}.")
    ratios = [role for role, unit in test.units.items() if ratio_of(role, unit) is not None]
    if ratios and test.kind != "frf":
        told.append(f"units: `{test.units[ratios[0]]}` of `{ratios[0]}` is for kind `frf` only.")
    if test.kind not in ("decay", "loop") and not (roles & SOURCES or ratios):
        told.append(f"channels: kind `{test.kind}` needs `input` or `force`.")
    if test.kind == "loop" and not (
        "displacement" in roles and roles & {"restoring_force", "force"}
    ):
        told.append("channels: kind `loop` needs `displacement` and `restoring_force`.")
    if test.kind == "frf" and "frequency" not in roles:
        told.append("channels: kind `frf` needs `frequency`, and `phase` beside real amplitudes.")
    if test.kind != "frf" and roles & {"frequency", "phase"}:
        told.append("channels: `frequency` and `phase` belong to kind `frf`.")
    told += _contradictions(test, roles)
    if test.kind in ("tones", "stepped") and not test.tones:
        told.append(f"tones: missing; kind `{test.kind}` needs the frequencies [Hz].")
    if test.kind == "stepped" and not test.dwell > 0:
        told.append("dwell: missing; kind `stepped` needs the duration of each step [s].")
    if test.settle >= test.dwell:  # never when dwell is not given: it is NaN then
        told.append(
            f"settle: must be shorter than dwell ({test.dwell:g} s), but is {test.settle:g}."
        )
    return told


def _contradictions(test: TestSpec, roles: set[str]) -> list[str]:
    """Keys that are given, but not meant for the test's kind or channels."""
    told = []
    if test.kind != "frf" and test.amplitudes != "peak":
        told.append("amplitudes: for kind `frf` only; the samples of a record are what they are.")
    if test.kind == "frf" and test.remove_mean:
        told.append("remove_mean: for records in time, not for kind `frf`.")
    if test.gaps == "mask" and test.kind not in MASKABLE:
        told.append(
            f"gaps: kind `{test.kind}` needs every sample, only {', '.join(MASKABLE)} can mask; "
            "keep a clean part with span, or drop the repeat with exclude."
        )
    if isinstance(test.files, Mapping) and set(test.files) != roles:
        told.append(
            f"files: as a table it must name a file for each role ({', '.join(sorted(roles))}), "
            f"but names {', '.join(sorted(test.files))}."
        )
    return told


def _unique_names(tests: list[TestSpec], errors: list[str]) -> None:
    given = [test.name for test in tests if test.name]
    for name in sorted({name for name in given if given.count(name) > 1}):
        errors.append(f"[[test]] name: {name!r} is given to {given.count(name)} tests.")


def _levels_exist(tests: list[TestSpec], settings: Mapping[str, Any], errors: list[str]) -> None:
    levels = sorted({test.level for test in tests if test.level == test.level})
    for level in settings.get("fit_levels", ()):
        if level not in levels:
            listed = ", ".join(f"{known:g}" for known in levels) or "none"
            errors.append(f"[identify] fit_levels: no test has level {level:g}; levels: {listed}.")
