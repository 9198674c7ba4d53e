"""Checks that concern several tests of a campaign file: names, points, contradictions."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from jbw.campaign.settings import Identify
from jbw.campaign.tables import Assembly, TestSpec
from jbw.measurement.faults.fault import Fault, doubt
from jbw.measurement.records import BASE, INPUTS, RESPONSES, Record
from jbw.report.messages import campaign_faults as messages

# Levels or records whose ratio exceeds this differ by more than imprecise control explains.
APART = 1.5


def named(tests: Sequence[TestSpec]) -> Iterator[TestSpec]:
    """Yield the tests with unique names; a test without a name is named by its kind and level."""
    names = {test.name for test in tests}
    for test in tests:
        base = test.kind if np.isnan(test.level) else f"{test.kind} {test.level:g}"
        candidates = (base if n == 1 else f"{base} ({n})" for n in range(1, len(tests) + 2))
        name = test.name or next(name for name in candidates if name not in names)
        names.add(name)
        yield test.model_copy(update={"name": name})


def at_every_point(tests: Sequence[TestSpec]) -> Iterator[TestSpec]:
    """Yield each test, followed by a copy of it for every additional response point."""
    for test in tests:
        if not test.points:
            yield test
            continue
        run = test.run or test.name
        yield test.model_copy(update={"points": {}, "run": run})
        (response, *_) = (role for role in RESPONSES if role in test.channels)
        for point, channel in test.points.items():
            name, channels = f"{test.name} at {point}", {**test.channels, response: channel}
            changes = {"name": name, "point": point, "channels": channels, "points": {}, "run": run}
            yield test.model_copy(update=changes)


def of_others(tests: Sequence[TestSpec], assembly: Assembly) -> Iterator[str]:
    """Yield an error if tests belong to several assemblies, but [assembly] describes only one."""
    names = {test.assembly for test in tests if test.assembly} | {assembly.name or None} - {None}
    if len(names) > 1 and list(assembly.keys()):
        yield messages.several_assemblies(len(names), sorted(map(str, names)))


def on_a_base(tests: Sequence[TestSpec], *, is_weighed: bool, several: bool) -> Iterator[str]:
    """Yield an error if a moving base drives some tests and other sources others, except a force.

    Args:
        tests: The tests of the campaign.
        is_weighed: Whether the modal mass is stated, which determines the gain of a force.
        several: Whether the structure has several modes, whose gains differ between the drives.
    """
    drives = sorted({test.driven_by for test in tests if test.traits.is_driven} - {""})
    if BASE in drives and len(drives) > 1:
        others = [drive for drive in drives if drive != BASE]
        if others != ["force"] or several:
            yield messages.base_beside_others(", ".join(others))
        elif not is_weighed:
            yield messages.BASE_WITHOUT_MASS


def among(tests: Sequence[TestSpec], settings: Identify) -> Iterator[str]:
    """Yield an error for each duplicate name, mode outside all bands, and level without a test."""
    names = [test.name for test in tests if test.name]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield messages.name_of_several(name, names.count(name))
    bands = [test.band for test in tests if test.traits.is_driven and test.band]
    for freq in settings.modes if isinstance(settings.modes, tuple) and bands else ():
        if not any(low <= freq <= high for low, high in bands):
            yield messages.mode_outside(
                freq, ", ".join(f"{low:g} to {high:g} Hz" for low, high in bands)
            )
    levels = sorted({test.level for test in tests if test.level == test.level})
    listed = ", ".join(f"{level:g}" for level in levels) or "none"
    for level in settings.fit_levels or ():
        if level not in levels:
            yield messages.no_level(level, listed)


class Level(NamedTuple):
    """The level of a test, and the rms values of its first record."""

    test: str
    # kind and channels of the test; only tests that agree in both are compared
    alike: tuple[str, ...]
    role: str  # quantity that drives the test
    level: float
    source_rms: float
    response_rms: float


def level_of(record: Record, test: TestSpec) -> list[Level]:
    """Return the level of a driven test and rms values of its first record; empty if not stated."""
    driven = any(role in record.channels for role in INPUTS)
    if not (test.level > 0 and driven):
        return []
    samples = [record.channels[role] for role in (record.source, record.response)]
    finite = [x[np.isfinite(x)] for x in samples]
    if not all(x.size for x in finite):
        return []
    source, response = (float(np.sqrt(np.mean(x**2))) for x in finite)
    setup = (test.kind, record.source, record.response, test.driven_by, test.point)
    return [Level(test.name, setup, record.source, test.level, source, response)]


def against_levels(levels: Sequence[Level]) -> Iterator[tuple[str, Fault]]:
    """Yield a warning if a test has a larger level than another, but smaller drive and response."""
    for first, second in combinations(levels, 2):
        low, high = sorted((first, second), key=lambda level: level.level)
        apart = high.level > APART * low.level and low.alike == high.alike
        turned = low.source_rms > APART * high.source_rms
        if apart and turned and low.response_rms > high.response_rms:
            ratios = high.level / low.level, low.source_rms / high.source_rms
            found = messages.exchanged(high.test, ratios[0], low.test, ratios[1])
            yield high.test, doubt(high.role, *found)
