"""The choice of a law from quick fits, if a campaign states none.

The exponents with which frequency and damping depend on amplitude propose laws before anything is
fitted. The proposals are fitted in turn, those with the fewest parameters first, then others with
the same kind of force, until one leaves white residuals. If none does, the law with the smallest
error is chosen.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jbw.errors import JbwError
from jbw.identification.accuracy import errors_and_colour
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.first_fit import first_fit
from jbw.inference.fit.fitting import Fit
from jbw.measurement.readings.statement import KINDS_OF_FORCE
from jbw.observables.dataset import Dataset
from jbw.oscillator.laws import law_named
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import laws as messages

# An earlier proposal is preferred if its error is at most this multiple of the smallest error.
AS_GOOD = 1.05


def candidates(read: Sequence[str]) -> tuple[str, ...]:
    """Return the laws to fit, in order, after those that frequency and damping suggest.

    The proposals and the default law come first, those with the fewest parameters before the
    others. Other laws with a force of the same kind follow, because a measured exponent may exclude
    the right law. If `read` is empty, the default law comes first, and all others follow.
    """

    def by_size(laws: Iterable[str]) -> list[str]:
        return sorted(dict.fromkeys(laws), key=lambda law: len(law_named(law).table))

    kinds = [kind for kind in KINDS_OF_FORCE if not read or set(kind) & set(read)]
    others = by_size(law for kind in kinds for law in kind)
    return tuple(dict.fromkeys([*by_size([*read, *DEFAULT_LAWS]), *others]))


class ChosenLaw(NamedTuple):
    """The tests with the chosen law, its fit if one was made, and a sentence on the choice."""

    measured: Measured
    theta: dict[str, float]
    sentence: str


def chosen(seen: Measured, laws: Sequence[str], seed: int, report: Report) -> ChosenLaw:
    """Fit laws in turn until one leaves white residuals; choose this law, or else the best fit.

    If no fit from one start leaves white residuals, each law gets all starts.

    Args:
        seen: Tests under any law.
        laws: Names of the laws, in the order of the fits.
        seed: Random seed.
        report: Function that is called with one sentence at every stage.
    """
    fits: dict[str, dict[str, float]] = {}
    errors: dict[str, float] = {}
    is_white = False
    for law, alone in [(law, True) for law in laws] + [(law, False) for law in laws]:
        report(messages.trying(law))
        tried = assemble(replace(seen, laws=(law,)))
        try:
            _, best, data = first_fit(jax.random.key(seed), tried, seen.settings, alone=alone)
        except JbwError:  # The law cannot be solved for these tests.
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
    """Return the rms of the data groups' relative errors, and whether their residuals are white."""
    error, found = errors_and_colour(best, data)
    mean_square = np.mean(np.square([*error.values()]))
    return float(np.sqrt(mean_square)), found is None or found.status == "ok"
