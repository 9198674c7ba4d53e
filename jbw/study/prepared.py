"""Preparation of a campaign's tests before any fit: check, measure without a model, split.

If a campaign states no law, the exponents with which frequency and damping depend on amplitude
propose laws before anything is fitted. The proposals are fitted in turn, then others with the same
kind of force, until one leaves white residuals. If none does, the law with the smallest error is
chosen. The order is that in which the laws fit frequency and damping against amplitude.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.load import Campaign
from jbw.campaign.tables import force_per_unit
from jbw.errors import JbwError
from jbw.identification.accuracy import errors_and_colour
from jbw.identification.assemble import Measured, Report, assemble, measured_in
from jbw.identification.curve_fit import CurveFit, from_readings
from jbw.identification.first_fit import first_fit
from jbw.identification.prepare import Fitted
from jbw.identification.usable import usable
from jbw.identification.widening import widened_by_fit
from jbw.inference.fit.fitting import Fit
from jbw.measurement.channels import rms
from jbw.measurement.readings.statement import KINDS_OF_FORCE, curve_of, few_rows
from jbw.measurement.records import Test, drive_of
from jbw.measurement.resonances import AmplitudeCurve
from jbw.observables.dataset import Dataset
from jbw.observables.records import compile_beside
from jbw.oscillator.law import Law
from jbw.oscillator.laws import law_named
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import laws as messages
from jbw.report.messages import stages
from jbw.study.look import UNREADABLE, Look, look_quietly

# A law with fewer parameters is preferred if its error is at most this multiple of the smallest.
AS_GOOD = 1.1
# A law is excluded if its information criterion is larger than the smallest by more than this (Kass
# and Raftery 1995).
DECISIVE = 10.0
EXACT = 1e-9  # smallest relative error that is distinguished from zero


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
    if campaign.states_laws and not several:
        compile_beside(tests, campaign.laws)
    report(stages.READING_RECORDS)
    look = look_quietly(replace(campaign, tests=tests))
    measured = measured_in(campaign, report, tests, line_fit)
    if campaign.states_laws or several:
        return PreparedTests(measured, look, left_out)
    groups, curve = candidates(look.record.laws), measured_curve(look, measured.chosen)
    measured, theta, sentence = chosen(measured, groups, curve, seed, report)
    return PreparedTests(measured, look, (*left_out, sentence), theta)


def candidates(read: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Return the laws to fit: first the laws that frequency and damping suggest, then others.

    The default law is among the suggested laws. The other laws have a force of the same kind,
    because a measured exponent may exclude the right law; if `read` is empty, they are all other
    laws. Laws with few parameters come first.
    """

    def by_size(laws: Iterable[str]) -> list[str]:
        return sorted(dict.fromkeys(laws), key=lambda law: len(law_named(law).table))

    kinds = [kind for kind in KINDS_OF_FORCE if not read or set(kind) & set(read)]
    others = by_size(law for kind in kinds for law in kind)
    proposals = by_size([*read, *DEFAULT_LAWS])
    return tuple(proposals), tuple(law for law in dict.fromkeys(others) if law not in proposals)


def measured_curve(look: Look, tests: Sequence[Test]) -> AmplitudeCurve | None:
    """Return measured frequency and damping of the tests to fit against amplitude; None if none.

    Only tests with the drive of the first one are used, because others add their own damping. The
    damping is that of a steady motion.
    """
    alike = [test for test in tests if drive_of(test) == drive_of(tests[0])]
    tables = [few_rows(table) for test in alike for table in look.steady(test)]
    with suppress(*UNREADABLE):
        return curve_of(tables) if tables else None
    return None


def chosen(
    seen: Measured,
    groups: Sequence[Sequence[str]],
    curve: AmplitudeCurve | None,
    seed: int,
    report: Report,
) -> tuple[Measured, dict[str, float], str]:
    """Fit laws in turn; choose the first law with white residuals, or else the law that fits best.

    Within a group, the law that fits the measured frequency and damping best is the first, and
    starts from that fit. If no fit from one start has white residuals, each law gets all starts,
    because one start may miss the optimum of the right law.

    Args:
        seen: Tests under any law.
        groups: Names of laws; a later group is tried if no law of an earlier one suffices.
        curve: Measured frequency and damping against amplitude.
        seed: Random seed.
        report: Function that is called with one sentence at every stage.

    Returns:
        Tests under the chosen law, its fit (empty if none was made), and a sentence on it.
    """
    if curve is not None:
        report(messages.BY_READINGS)
    key, is_white = jax.random.key(seed), False
    fits: dict[str, dict[str, float]] = {}
    errors: dict[str, dict[str, float]] = {}
    by_curve: dict[str, CurveFit] = {}
    for law, start, alone in _trials(seen, groups, curve, by_curve, key):
        report(messages.trying(law))
        tried = assemble(replace(seen, laws=(law,)))
        try:
            prior, best, data = first_fit(key, tried, seen.settings, start=start, alone=alone)
        except JbwError:  # The law cannot be solved for these tests.
            continue
        first = Fitted(best, prior, data)
        fitted = widened_by_fit(first, seen.settings.prior) or first
        fits[law] = fitted.fit.theta
        errors[law], is_white = remains_of(fitted.fit, data)
        if is_white:
            break
    if not errors:
        return seen, {}, ""
    scores = beside_smallest(errors)
    enough = AS_GOOD * min(scores.values())
    good = [name for name in errors if scores[name] <= enough]
    best_law = law if is_white else min(good, key=lambda name: len(law_named(name).table))
    criteria = {name: one.criterion for name, one in by_curve.items()}
    most = DECISIVE + min(criteria.values(), default=0.0)
    ruled_out = [name for name in criteria if criteria[name] > most]
    excluded = [name for name in ruled_out if name not in errors]
    means = {name: rms(list(of_law.values())) for name, of_law in errors.items()}
    sentence = messages.chosen_by_fits(best_law, means, excluded, is_white=is_white)
    report(sentence)
    rivals = full_slip_beside(best_law, ruled_out)
    return replace(seen, laws=(best_law,), rivals=rivals), fits[best_law], sentence


def full_slip_beside(law: str, excluded: Sequence[str]) -> tuple[str, ...]:
    """Return the other laws of a slipping joint that slip fully at some amplitude, as Iwan's does.

    Records below that amplitude may follow either law. `excluded` are laws that they rule out.
    """
    kind = next((kind for kind in KINDS_OF_FORCE if law in kind), ())
    others = [name for name in kind if name != law and name not in excluded]
    return tuple(n for n in others if law_named(n).thresholds is not Law.thresholds)


def _trials(
    seen: Measured,
    groups: Sequence[Sequence[str]],
    curve: AmplitudeCurve | None,
    by_curve: dict[str, CurveFit],
    key: Key[Array, ""],
) -> Iterator[tuple[str, Mapping[str, float], bool]]:
    """Yield each law to fit, its starting point, and whether the fit uses only this point.

    Laws are fitted to the curve group by group; `by_curve` collects these fits.
    """
    trials: list[tuple[str, Mapping[str, float]]] = []
    for group in groups:
        for law in group:
            tried = assemble(replace(seen, laws=(law,)))
            least = min((one.criterion for one in by_curve.values()), default=np.inf)
            with suppress(JbwError):  # The law has no steady loops.
                one = from_readings(key, tried, seen.settings, curve, below=least)
                if one is not None:
                    by_curve[law] = one
        fits = {law: by_curve.get(law, CurveFit({}, np.inf)) for law in group}
        ordered = sorted(fits.items(), key=lambda fit: fit[1].criterion)
        yield from ((law, fit.theta, True) for law, fit in ordered)
        trials += [(law, fit.theta) for law, fit in ordered]
    yield from ((law, start, False) for law, start in trials)


def remains_of(best: Fit, data: Dataset) -> tuple[dict[str, float], bool]:
    """Return the groups' relative errors, and whether their residuals are white."""
    error, found = errors_and_colour(best, data)
    return error, found is None or found.status == "ok"


def beside_smallest(errors: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    r"""Return each law's rms over data groups of its error, relative to the smallest of any law.

    $$s_l = \sqrt{\mathrm{mean}_g (e_{lg} / \min_k e_{kg})^2}$$

    so that a group whose noise hides the differences between laws does not outweigh the others.
    """
    labels = [*next(iter(errors.values()))]
    rows = np.array([[of_law[label] for label in labels] for of_law in errors.values()])
    rows = np.maximum(rows, EXACT)
    scores = np.sqrt(np.mean((rows / rows.min(axis=0)) ** 2, axis=1))
    return dict(zip(errors, scores.tolist(), strict=True))
