"""The assignment of tests to steps, and their split into fitted and held-out tests."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from jbw.campaign.settings import Identify
from jbw.campaign.values import ALL
from jbw.errors import ConfigError
from jbw.measurement.channels import strength_ranks
from jbw.measurement.records import Test, drive_of, share_clock

THIRD = (0.2, 0.45)  # range of a probing tone's frequency, relative to the natural frequency
LEVEL = attrgetter("level")  # key by which tests are sorted: their level


@dataclass(frozen=True)
class Sweeps:
    """The fitted and the held-out sweeps of a campaign."""

    fitted: tuple[Test, ...]  # fitted levels, each with its fitted repeats only
    held_out: tuple[Test, ...]  # all levels, with those repeats that are not fitted


def fitted(tests: Sequence[Test], settings: Identify) -> list[Test]:
    """Return the tests to fit, according to the settings `fit` and `hold_out`."""
    names = [test.name for test in tests]
    unknown = [name for name in settings.hold_out if name not in names]
    if unknown:
        raise ConfigError(
            f"Setting `hold_out` must name tests of the campaign, but names {unknown}.",
            remedy=f"The tests are {', '.join(names)}.",
        )
    kinds = {test.kind for test in tests} if settings.fit is None else settings.fit
    return [test for test in tests if test.kind in kinds and test.name not in settings.hold_out]


def linear_test(tests: Sequence[Test]) -> Test | None:
    """Return the noise or multisine test of the lowest level, which the line fit (Step 2) uses."""
    noise = [test for test in tests if test.traits.is_broadband]
    return min(noise, key=LEVEL, default=None)


def probing_tests(tests: Sequence[Test], natural_hz: float) -> tuple[Test, ...]:
    """Return the single-tone tests near a third of the natural frequency, for the kernel fit."""
    low, high = (part * natural_hz for part in THIRD)
    single = [test for test in tests if test.is_single_tone and low < test.tones_hz[0] < high]
    return tuple(sorted(single, key=lambda test: test.tones_hz[0]))


def loop_tests(tests: Sequence[Test], natural_hz: float) -> tuple[Test, ...]:
    """Return single-tone tests near the resonance, for validation by their loops."""
    probing = {test.name for test in probing_tests(tests, natural_hz)}
    single = [test for test in tests if test.is_single_tone and test.name not in probing]
    return tuple(sorted(single, key=LEVEL))


def sweep_tests(tests: Sequence[Test], settings: Identify, *, every: bool = False) -> Sweeps | None:
    """Divide the sweeps into fitted and held-out ones.

    `fit_levels` names the levels to fit. By default these are the lowest and the highest level of
    each drive if it has three or more, otherwise all. If `every`, all levels are fitted, because
    each of several modes has its own. `fit_repeats` is the number of fitted repeats, by default
    half, or all; they span the amplitudes.
    """
    sweeps = [test for test in sorted(tests, key=LEVEL) if test.traits.is_transient]
    if not sweeps:
        return None
    levels = [test.level for test in sweeps]
    unknown = [level for level in settings.fit_levels or () if level not in levels]
    if unknown:
        raise ConfigError(
            f"Setting `fit_levels` must name levels of sweeps, but holds {unknown}.",
            remedy=f"The sweeps have the levels {levels}.",
        )
    fitted, held_out = [], []
    for test in sweeps:
        usual = levels if every else _outermost(sweeps, drive_of(test))
        chosen = settings.fit_levels or usual
        places = _fitted_places(test, settings) if test.level in chosen else ()
        for side, is_fitted in ((fitted, True), (held_out, False)):
            kept = (x for i, x in enumerate(test.records) if (i in places) == is_fitted)
            side.append(replace(test, records=tuple(kept)))
    return Sweeps(*(tuple(test for test in side if test.records) for side in (fitted, held_out)))


def _outermost(sweeps: Sequence[Test], drive: str) -> list[float]:
    """Return the lowest and highest level of a drive; all levels if there are at most two."""
    levels = [test.level for test in sweeps if drive_of(test) == drive]
    return [levels[0], levels[-1]] if len(levels) > 2 else levels


@dataclass(frozen=True)
class DecaySplit:
    """The fitted and the held-out free decays of all tests, as one test."""

    fitted: Test
    together: Test  # all decays, the fitted ones first
    # for each decay, the name of its test and its number in this test, counted from one
    names: tuple[str, ...]


def decay_tests(
    tests: Sequence[Test], settings: Identify, chosen: Sequence[Test] | None = None
) -> DecaySplit | None:
    """Divide the free decays into fitted and held-out ones; return None if none is fitted.

    `fit_repeats` decays of each of the `chosen` tests (all tests if None) are fitted, half by
    default; they span the amplitudes.
    """
    decays = [test for test in tests if test.traits.is_free]
    if not decays:
        return None
    rates = [record.fs for t in decays for record in t.records]
    shared = {
        "band [Hz]": {t.band_hz for t in decays},
        "settle [s]": {t.settle for t in decays},
        "sampling frequency [Hz]": {rates[0]} if share_clock(max(rates), min(rates)) else {*rates},
        "response": {t.records[0].response for t in decays},
        "drive": {drive_of(t) for t in decays},
    }
    for name, found in shared.items():
        if len(found) > 1:
            listed = " and ".join(sorted(map(str, found)))
            raise ConfigError(
                "Tests of kind decay must share band, settle, sampling frequency, response and "
                f"drive, but their {name} are {listed}.",
                remedy=f"Give all decays of one mode the same {name}; write a separate campaign "
                "for each mode.",
            )
    allowed = {test.name for test in (decays if chosen is None else chosen)}
    first, rest = [], []
    for test in decays:
        places = _fitted_places(test, settings) if test.name in allowed else ()
        for i, record in enumerate(test.records):
            (first if i in places else rest).append((record, f"{test.name} {i + 1}"))
    if not first:
        return None
    fitted = replace(decays[0], records=tuple(record for record, _ in first))
    together = replace(decays[0], records=tuple(record for record, _ in (*first, *rest)))
    return DecaySplit(fitted, together, tuple(name for _, name in (*first, *rest)))


def _fitted_places(test: Test, settings: Identify) -> tuple[int, ...]:
    """Return the indices of the fitted repeats, evenly spaced from strong to weak.

    Among equally strong repeats, the first are chosen. So a law is never judged on motion larger
    than in the fitted repeats, in whatever order a structure was hit.
    """
    count = _fitted_repeats(test, settings)
    sizes = [float(np.nanstd(record.channels[record.response])) for record in test.records]
    ranks = strength_ranks(sizes)
    left, places = list(range(len(sizes))), []
    for step in np.linspace(0, len(sizes) - 1, count).round().astype(int):
        wanted = np.sort(ranks)[step]
        places.append(next(i for i in left if ranks[i] == wanted))
        left.remove(places[-1])
    return tuple(sorted(places))


def _fitted_repeats(test: Test, settings: Identify) -> int:
    total = len(test.records)
    count = settings.fit_repeats
    if count == ALL:
        return total
    if count is None:
        count = total // 2 if total >= 4 else total
    if not 1 <= count <= total:
        raise ConfigError(
            f"Setting `fit_repeats` must lie between 1 and the {total} repeats of `{test.name}`, "
            f"but is {count}.",
            remedy=f'Put under [identify]: `fit_repeats = "{ALL}"`, or no `fit_repeats` at all.',
        )
    return count


def fitted_for_use(tests: Sequence[Test], settings: Identify) -> Identify:
    """Return settings with which every test, level and repeat is fitted."""
    levels = tuple(dict.fromkeys(test.level for test in tests if test.traits.is_transient))
    return settings.model_copy(
        update={"final": False, "hold_out": (), "fit_levels": levels or None, "fit_repeats": ALL}
    )
