"""The choice of a law from quick fits, if a campaign states none.

The exponents with which frequency and damping depend on amplitude propose laws before anything is
fitted. The proposals are fitted in turn, those with the fewest parameters first, until one leaves
white residuals. If none does, the law with the smallest error is chosen.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jbw.errors import JbwError
from jbw.identification.accuracy import errors_and_colour
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.first_fit import first_fit
from jbw.inference.fit.fitting import Fit
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws import law_named
from jbw.report.messages import laws as messages

# An earlier proposal is preferred if its error is at most this multiple of the least error.
AS_GOOD = 1.05


class ChosenLaw(NamedTuple):
    """The tests under the chosen law, its fit (empty if none was made), and a sentence on it."""

    measured: Measured
    theta: dict[str, float]
    sentence: str


def chosen(seen: Measured, laws: Iterable[str], seed: int, report: Report) -> ChosenLaw:
    """Fit laws in turn until one leaves white residuals; choose it, or the one that fits best.

    Args:
        seen: Tests under any law.
        laws: Proposed laws; of those with equally many parameters the first is tried first.
        seed: Random seed.
        report: Function that is called with one sentence at every stage.
    """
    fits: dict[str, dict[str, float]] = {}
    errors: dict[str, float] = {}
    is_white = False
    by_size = sorted(laws, key=lambda law: len(law_named(law).table))
    # If no fit from one start leaves white residuals, each law gets all starts.
    for law, alone in [(law, True) for law in by_size] + [(law, False) for law in by_size]:
        report(messages.trying(law))
        tried = assemble(replace(seen, laws=(law,)))
        try:
            _, best, data = first_fit(jax.random.key(seed), tried, seen.settings, alone=alone)
        except JbwError:  # the law cannot be solved for these tests
            continue
        fits[law] = best.theta
        errors[law], is_white = remains_of(best, data)
        if is_white:
            break
    if not errors:
        return ChosenLaw(seen, {}, "")
    enough = AS_GOOD * min(errors.values())
    best_law = law if is_white else next(name for name in errors if errors[name] <= enough)
    report(sentence := messages.chosen_by_fits(best_law, errors, is_white=is_white))
    return ChosenLaw(replace(seen, laws=(best_law,)), fits[best_law], sentence)


def remains_of(best: Fit, data: Dataset) -> tuple[float, bool]:
    """Return the rms of the groups' relative errors, and whether their residuals are white."""
    error, found = errors_and_colour(best, data)
    mean_square = np.mean(np.square([*error.values()]))
    return float(np.sqrt(mean_square)), found is None or found.status == "ok"
