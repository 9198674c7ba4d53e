"""The choice of a law from quick fits, if a campaign states none.

The exponents with which frequency and damping depend on amplitude propose laws before anything is
fitted. The proposals are fitted in turn, until one leaves white residuals. If none does, the law
with the smallest error is chosen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jbw.errors import JbwError
from jbw.identification.accuracy import residual_finding
from jbw.identification.assemble import Measured, Report
from jbw.identification.laplace import fit_quickly
from jbw.identification.prepare import Fitted
from jbw.observables import dataset, noise
from jbw.report.messages import laws as messages

AS_GOOD = 1.05  # times the least error: an error up to which an earlier proposal is preferred


class ChosenLaw(NamedTuple):
    """The tests under the chosen law, its fit (None if no fit succeeded) and a sentence."""

    measured: Measured
    fitted: Fitted | None
    sentence: str


def chosen(seen: Measured, laws: Sequence[str], seed: int, report: Report) -> ChosenLaw:
    """Fit laws in turn until one leaves white residuals; choose it, or the one that fits best.

    Args:
        seen: Tests under any law.
        laws: Proposed laws, the first to be tried first.
        seed: Random seed.
        report: Function that is called with one sentence at every stage.
    """
    fits: dict[str, Fitted] = {}
    errors: dict[str, float] = {}
    is_white = False
    for law in laws:
        report(messages.trying(law))
        try:
            fits[law] = fit_quickly(replace(seen, laws=(law,)), seed=seed, report=report)
        except JbwError:  # the law cannot be solved for these tests
            continue
        errors[law], is_white = remains_of(fits[law])
        if is_white:
            break
    if not errors:
        return ChosenLaw(seen, None, "")
    enough = AS_GOOD * min(errors.values())
    best = law if is_white else next(name for name, error in errors.items() if error <= enough)
    report(sentence := messages.chosen_by_fits(best, errors, is_white=is_white))
    return ChosenLaw(replace(seen, laws=(best,)), fits[best], sentence)


def remains_of(fitted: Fitted) -> tuple[float, bool]:
    """Return the rms of the groups' relative errors, and whether their residuals are white."""
    residuals = dataset.residual_by_label(fitted.fit.residual, fitted.data)
    error: Mapping[str, float] = dataset.error_by_label(residuals, fitted.data)
    found = residual_finding(residuals, noise.fractions_counted(fitted.data), error)
    mean_square = np.mean(np.square([*error.values()]))
    return float(np.sqrt(mean_square)), found is None or found.status == "ok"
