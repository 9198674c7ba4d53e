"""The lines of `watch.jsonl` as types: the settings of a watch, and one line per record."""

from typing import Any

from pydantic import Field

from jbw.results.stored import Number, Stored


class WatchSettings(Stored):
    """The settings with which a watch began; `reference` is the number of reference records."""

    kind: str = "settings"
    format: int = 1
    when: str = ""
    test: str | None = None
    amplitudes: list[float] = []
    unit: str = ""
    false_alarms: float = 0.0
    reference: int = 0
    names: list[str] = []


class WatchLine(Stored):
    """A monitored record: its values and statement, or the reason why it is refused."""

    entry: str = Field(alias="kind")  # reading, refused, or known (already in the watch)
    number: int | None = None
    record: str = ""
    id: str = ""
    when: str = ""
    role: str = ""
    values: list[float] = []
    covariance: list[list[float]] = []
    other_modes: Number = None
    squared: Number = None
    threshold: Number = None
    tail: Number = None
    unchanged: Number = None
    alarm: str = ""
    change: dict[str, Any] | None = None
    statement: str = ""
    reason: str = ""
