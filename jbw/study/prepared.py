"""Preparation of a campaign's tests before any fit: check, measure without a model, split.

If a campaign states no law, the exponents with which frequency and damping depend on amplitude
propose laws before anything is fitted. The proposals are fitted in turn, those with the fewest
parameters first, then others with the same kind of force, until one leaves white residuals. If
none does, the law with the smallest error is chosen.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np

from jbw.campaign.load import Campaign
from jbw.campaign.tables import force_per_unit
from jbw.errors import JbwError
from jbw.identification.accuracy import errors_and_colour
from jbw.identification.assemble import Measured, Report, assemble, measured_in
from jbw.identification.first_fit import first_fit
from jbw.identification.usable import usable
from jbw.inference.fit.fitting import Fit
from jbw.measurement.readings.statement import KINDS_OF_FORCE
from jbw.observables.dataset import Dataset
from jbw.observables.records import compile_beside
from jbw.oscillator.laws import law_named
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import laws as messages
from jbw.report.messages import stages
from jbw.study.look import Look, look_quietly

# An earlier proposal is preferred if its error is at most this multiple of the smallest error.
AS_GOOD = 1.1


class PreparedTests(NamedTuple):
    """The tests of a campaign before any fit.

    Attributes:
        measured: Fitted and held-out tests, the linear regime (Step 2), and the ingredients of the
            model.
        look: Readings of the records without a model.
        sentences: Sentences on tests that cannot be used, and on the choice of the law.
        start: Parameters of the fit by which the law was chosen.
    """

    measured: Measured
    look: Look
    sentences: tuple[str, ...]
    start: Mapping[str, float] = MappingProxyType({})


def prepare_tests(campaign: Campaign, report: Report, seed: int) -> PreparedTests:
    """Return the usable tests, their measured frequency and damping, and the data for each step.

    This precedes all sampling, so that an error in a record costs no result. If a campaign states
    no law, it gets the first one that leaves only noise, or the one that fits best.
    """
    gain = force_per_unit(campaign)
    several = campaign.joints is not None
    several |= campaign.structure is not None and len(campaign.structure.modes) > 1
    tests, left_out, line_fit = usable(
        campaign.tests, campaign.settings, gain, several_modes=several
    )
    for sentence in left_out:
        report(sentence)
    if not several:
        compile_beside(tests, campaign.laws)
    report(stages.READING_RECORDS)
    look = look_quietly(replace(campaign, tests=tests))
    measured = measured_in(campaign, report, tests, line_fit)
    if campaign.states_laws or several:
        return PreparedTests(measured, look, left_out)
    measured, theta, sentence = chosen(measured, candidates(look.record.laws), seed, report)
    return PreparedTests(measured, look, (*left_out, sentence), theta)


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


def chosen(
    seen: Measured, laws: Sequence[str], seed: int, report: Report
) -> tuple[Measured, dict[str, float], str]:
    """Fit laws in turn; choose the first law with white residuals, or else the law that fits best.

    If no fit from one start has white residuals, each law gets all starts, because one start may
    miss the optimum of the right law.

    Args:
        seen: Tests under any law.
        laws: Names of the laws, in the order of the fits.
        seed: Random seed.
        report: Function that is called with one sentence at every stage.

    Returns:
        Tests under the chosen law, its fit (empty if none was made), and a sentence on it.
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
        return seen, {}, ""
    enough = AS_GOOD * min(errors.values())
    best_law = law if is_white else next(name for name in errors if errors[name] <= enough)
    report(sentence := messages.chosen_by_fits(best_law, errors, is_white=is_white))
    return replace(seen, laws=(best_law,)), fits[best_law], sentence


def remains_of(best: Fit, data: Dataset) -> tuple[float, bool]:
    """Return the rms of the groups' relative errors, and whether their residuals are white."""
    error, found = errors_and_colour(best, data)
    mean_square = np.mean(np.square([*error.values()]))
    return float(np.sqrt(mean_square)), found is None or found.status == "ok"
