"""The selection of the tests that a figure draws, if a campaign has too many for one page."""

from typing import Literal

import xarray as xr

from jbw.errors import ConfigError, DataError
from jbw.results.attributes import PredictedTest

MOST = 3  # largest number of tests that a figure draws side by side
Tests = list[tuple[str, xr.Dataset]]
Part = Literal["chosen", "rest", "all"]


def selected(tests: Tests, part: Part) -> Tests:
    """Return the tests that a figure draws: the representative tests, the others, or all.

    Raises:
        ConfigError: `part` has another value.
        DataError: The remaining tests are requested but every test is chosen.
    """
    if part not in ("chosen", "rest", "all"):
        raise ConfigError(
            f"Argument `part` must be 'chosen', 'rest' or 'all', but is {part!r}.",
            remedy='Leave `part` out, or give part="all" for every test.',
        )
    if part == "all":
        return tests
    names = chosen_names(tests)
    in_part = [(name, test) for name, test in tests if (name in names) == (part == "chosen")]
    if not in_part:
        raise DataError('All tests of this kind are already drawn with part="chosen".')
    return in_part


def chosen_names(tests: Tests) -> set[str]:
    """Choose three representative tests: the weakest and the strongest fitted, and a held-out one.

    The first test of a kind and level represents all tests of that kind and level.
    """
    first: dict[tuple[bool, str, float], str] = {}
    for name, test in tests:
        facts = PredictedTest.of(test)
        first.setdefault((facts.is_fitted, facts.kind, facts.level or 0.0), name)
    fitted, held_out = ([name for key, name in first.items() if key[0] == x] for x in (True, False))
    ends = fitted or held_out
    middle = held_out[len(held_out) // 2 :][:1]
    ordered = [*ends[:1], *middle, *ends[-1:], *first.values(), *(name for name, _ in tests)]
    return set(list(dict.fromkeys(ordered))[:MOST])
