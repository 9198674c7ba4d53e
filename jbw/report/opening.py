"""The first statements on a run: five sentences, the determined parameters and one figure.

The sentences state the effect of the joint, the errors of fitted and of held-out tests, the
parameters that are not identified, and the next step.
"""

from collections.abc import Iterator, Sequence
from math import ceil, log10

import numpy as np
import xarray as xr

from jbw.inference.posterior.finding import ASKED
from jbw.inference.posterior.quantiles import HALF_99
from jbw.measurement.kinds import KINDS
from jbw.quantities import joints_of, split
from jbw.report.cycles import motion_unit, unit_of_motion
from jbw.report.messages import opening as messages
from jbw.report.messages.discrepancy import not_scored
from jbw.report.result import BACKBONE, laws_of, node
from jbw.report.words import TRUNCATED, grades, unseen_hysteresis
from jbw.results.attributes import DrawnPosterior, StoredBackbone
from jbw.results.run import (
    RunSummary,
    StoredBand,
    StoredJoints,
    StoredMode,
    StoredParameter,
    StoredTest,
)

# smaller amplitude of a comparison, relative to the largest fitted displacement; at this amplitude
# the joint hardly slips
LOW = 0.1
MOST_SHOWN = 8
MOST_DIGITS = 6  # number of digits that no laboratory can reproduce
LARGE_ODDS = 4  # number of digits above which odds are written as a power of ten

# candidates for the first figure, in order; the second list applies if the tree has no frequency
# and damping of records. If a joint's motion is prescribed, its loops come first.
LEADS, UNREAD = ("backbone", "amplitude", "loops"), ("amplitude", "backbone", "loops")
UNMEASURED = "zeta"  # parameter that a campaign without a free or driven mode cannot determine
CAUSE = "cause"  # finding that names a fault of the data as the cause of the residual
POORLY = 2  # grade of a parameter that the data determine better than the prior, but not to 30 %
LOOK, MEASURED = "look", ("y", "damping", "damping_sd")
# smallest relative difference between a law's damping ratio and the measured damping ratio that is
# reported
APART = 0.25
ABSENT = "no_joint"  # finding that replaces the first sentence: no joint is detected


def opening(summary: RunSummary, tree: xr.DataTree) -> list[str]:
    """Return the opening sentences on a run: effect of the joint, errors, limits, next step.

    The list is empty if the summary or the tree lacks their data.
    """
    if summary.main not in summary.steps or not summary.verdict.status:
        return []
    met = _misfits(summary) if summary.quick is None else [fit_sentence(summary)]
    doubts = [messages.doubtful(doubt) for doubt in summary.doubts]
    units = [messages.TORSION] if _unit_of_motion(summary) == "rad" else []
    effects = joint_sentences(summary.joints) or [effect_sentence(summary, tree)]
    return [
        *effects,
        *contradictions(summary, tree),
        *stiffness_sentences(summary, tree),
        *units,
        *met,
        _unknown(summary),
        *doubts,
        _following(summary),
    ]


def split_sentence(summary: RunSummary) -> str | None:
    """Return the sentence on which tests and repeats were fitted or held out; or None."""
    split = [(row, row.fitted_repeats) for row in summary.tests or ()]
    rows = [(row, used) for row, used in split if used is not None]
    sides: tuple[list[str], list[str]] = ([], [])
    some_repeats = False
    for row, used in rows:
        rest = [i for i in range(1, (row.repeats or 0) + 1) if i not in used]
        some_repeats |= bool(used and rest)
        for side, numbers in zip(sides, (used, rest), strict=True):
            if numbers:
                of_test = messages.repeats(row.test, numbers) if used and rest else row.test
                side.append(of_test)
    return messages.split(*sides, some_repeats=some_repeats) if rows else None


def lead(summary: RunSummary, drawn: Sequence[str]) -> str | None:
    """Return the name of the report's first figure: the first candidate that could be drawn."""
    moves = "loops" if not _has_mode(summary) else None
    leads = LEADS if summary.look.tests else UNREAD
    return next((name for name in (moves, *leads) if name in drawn), None)


def known_parameters(summary: RunSummary) -> list[str]:
    """Return texts on parameters determined to 30 %; products replace undetermined factors."""
    rows, graded = summary.parameters, grades(summary)
    drawn = [name for name in graded if rows[name].kl is not None]
    good = [name for name in drawn if graded[name] <= 1]
    if len(good) < len(drawn):
        good += [name for name in graded if name not in drawn and graded[name] <= 1]
    shown = ((name, *with_interval(rows[name])) for name in good[:MOST_SHOWN])
    return [" ".join(filter(None, parts)) for parts in shown]


def _unit_of_motion(summary: RunSummary) -> str:
    """Return "rad" if all tests are of torque and rotation, otherwise "m"."""
    look = summary.look
    return summary.motion_unit or ("m" if look.tests else unit_of_motion(look.loops))


def _has_mode(summary: RunSummary) -> bool:
    return UNMEASURED in summary.parameters


def with_interval(row: StoredParameter) -> tuple[str, str, str]:
    """Return a parameter's mean, 99 % interval and unit as text."""
    ends = (np.nan if value is None else value for value in (row.mean, row.q005, row.q995))
    mean, low, high = ends
    digits = _digits(low, high)
    interval = f"[{low:.{digits}g}, {high:.{digits}g}]"
    return f"{mean:.{digits}g}", interval, "" if row.unit == "1" else row.unit


def _digits(low: float, high: float) -> int:
    """Return the number of digits (3 to 6) that shows an interval's width to two digits."""
    largest = max(abs(low), abs(high))
    if not high - low > 0.0 or not largest:
        return MOST_DIGITS
    return int(min(MOST_DIGITS, max(3, ceil(log10(largest / (high - low))) + 2)))


def effect_sentence(summary: RunSummary, tree: xr.DataTree) -> str:
    """Return the sentence on the joint's effect at the largest fitted amplitude and 10 % of it."""
    for finding in summary.verdict.against:
        if finding.code == ABSENT:
            return finding.reason
    if not laws_of(tree):
        return messages.LINEAR
    curve = node(tree, BACKBONE)
    if curve is None:
        return messages.NO_BACKBONE
    y_peak = StoredBackbone.of(curve).y_fitted
    at = curve.to_dataset().interp(amplitude=[LOW * y_peak, y_peak])
    factor, unit = motion_unit(y_peak, _unit_of_motion(summary))
    frequency, damping = (at[name].transpose("amplitude", "quantile").values for name in
                          ("frequency", "damping"))  # fmt: skip
    if not _has_mode(summary):
        low, middle, high = 100 * (frequency[1] / frequency[0, 1]) ** 2
        changes = messages.keeps_stiffness(middle, low, high)
    else:
        changes = (
            f"{_change('natural frequency', frequency, 'Hz')} and "
            f"{_change('damping ratio', 100 * damping, '%')}"
        )
    return messages.effect(LOW * y_peak * factor, y_peak * factor, unit, changes)


def contradictions(summary: RunSummary, tree: xr.DataTree) -> list[str]:
    """Return the sentence that the damping ratios of law and records differ, if they do.

    Both are 99 % intervals at the same amplitude. They must be disjoint, and their centres must
    differ by a quarter of the measured damping ratio. The largest difference is stated.
    """
    curve, look = node(tree, BACKBONE), node(tree, LOOK)
    if curve is None or look is None or summary.joints is not None:
        return []
    # Results of earlier versions do not contain the errors of measured damping ratios.
    groups = [group.to_dataset() for group in look.children.values()]
    read = [group for group in groups if set(MEASURED) <= set(group.data_vars)]
    parts = [np.stack([group[name].values for name in MEASURED]) for group in read]
    rows = np.concatenate([np.zeros((len(MEASURED), 0)), *parts], axis=1)
    y, measured, sd = rows[:, (rows[0] > 0) & (rows[0] <= StoredBackbone.of(curve).y_fitted)]
    if not y.size:
        return []
    group = curve.to_dataset()
    law = group["damping"].interp(amplitude=y).transpose("quantile", ...).values
    if "damping_missed" in group:  # The error of the law that its band contains is left out.
        missed = HALF_99 * group["damping_missed"].interp(amplitude=y).values
        half = np.sqrt(np.maximum((law - law[1]) ** 2 - missed**2, 0.0))
        law = law[1] + np.array([[-1], [0], [1]]) * half
    apart = np.maximum(law[0] - measured, measured - law[2]) > HALF_99 * sd
    away = np.where(apart, np.abs(law[1] / measured - 1), 0.0)
    worst = int(np.argmax(away))
    if not away[worst] > APART:
        return []
    factor, unit = motion_unit(float(y[worst]), _unit_of_motion(summary))
    low, middle, high = 100 * law[:, worst]
    digits = _digits(low, high)
    modelled = f"{middle:.{digits}g} % [{low:.{digits}g}, {high:.{digits}g}]"
    error = f"{100 * measured[worst]:.3g} ± {100 * HALF_99 * sd[worst]:.1g} %"
    return [messages.contradicted(factor * float(y[worst]), unit, modelled, error)]


def stiffness_sentences(summary: RunSummary, tree: xr.DataTree) -> list[str]:
    r"""Return a sentence on the stiffness $\omega_n^2$ of a fully stuck joint of unknown mass.

    The list is empty if a test shows a mode, or if the modal mass is stated.
    """
    frequency = summary.parameters.get("omega_n")
    is_per_mass = DrawnPosterior.of(tree).held.get("gain") == 1.0
    if _has_mode(summary) or frequency is None or not is_per_mass:
        return []
    known = {name: getattr(frequency, name) for name in ("mean", "q005", "q995")}
    squared = {name: None if value is None else value**2 for name, value in known.items()}
    stiffness = frequency.model_copy(update=squared)
    is_rotation = _unit_of_motion(summary) == "rad"
    return [messages.of_unknown_mass(*with_interval(stiffness)[:2], is_rotation=is_rotation)]


def joint_sentences(joints: StoredJoints | None) -> list[str]:
    """Return sentences on several joints: effect on each mode, damping, unidentified joints.

    The list is empty for a single joint.
    """
    if joints is None:
        return []
    effects = [
        _joints_effect(mode) for mode in joints.modes if mode.frequency_change.median is not None
    ]
    unknown = [row.joint for row in joints.joints if row.verdict != "identified"]
    damped = []
    for i, mode in enumerate(joints.modes):
        bands = ((row.joint, row.loss_share[i]) for row in joints.joints)
        shares = {joint: band.median for joint, band in bands if band and band.median is not None}
        most = max(shares, key=shares.__getitem__, default=None)
        if most is not None and most not in unknown:
            damped.append(messages.damped_by(mode.mode, most, f"{100 * shares[most]:.3g}"))
    damping = [messages.sentence(damped)] if damped else []
    unidentified = [messages.joints_unidentified(unknown)] if unknown else []
    return [messages.at_largest_motion(effects), *damping, *unidentified, *tied_sentences(joints)]


def _joints_effect(mode: StoredMode) -> str:
    """Return the sentence on the effect of all joints on a mode, which names the mode shape."""
    changes = map(_per_cents, (mode.frequency_change, mode.damping_added))
    effect = messages.joints_effect(mode.mode, *changes)
    return effect if mode.shape == "free" else messages.in_full_stick(effect)


def tied_sentences(joint_facts: StoredJoints) -> list[str]:
    """Return the sentence on whether joints share one law; empty if that was not compared."""
    tied = joint_facts.tied
    if tied is None:
        return []
    groups = [joints for _, joints in map(split, tied.laws) if len(joints) > 1]
    joints = [joint for joint in joints_of(tied.laws) if any(joint in group for group in groups)]
    odds = _odds(abs(tied.log_evidence_ratio), at_least=tied.is_bound)
    if tied.answer == "tied":
        return [messages.one_law(joints, odds)]
    if tied.answer == "own":
        return [messages.own_laws(joints, odds)]
    preferred = "one law" if tied.log_evidence_ratio > 0 else "separate laws"
    weak = messages.weak_evidence(odds, preferred)
    reason = weak if tied.is_trusted else messages.rough_evidence(tied.khat)
    return [messages.law_not_told(joints, reason)]


def _odds(nats: float, *, at_least: bool) -> str:
    """Format a log ratio in nats as odds: `12`, or a power of ten if it is large."""
    digits = nats / np.log(10)
    odds = f"{np.exp(nats):.2g}" if digits < LARGE_ODDS else f"10^{digits:.0f}"
    return f"at least {odds}" if at_least else odds


def _per_cents(band: StoredBand) -> str:
    """Return the median and 99 % interval of a ratio in per cent."""
    ends = (np.nan if end is None else end for end in (band.low, band.median, band.high))
    low, middle, high = (f"{100 * end:.3g}" for end in ends)
    return f"{middle} % [{low}, {high}]"


def _change(what: str, values: np.ndarray, unit: str) -> str:
    """Return the clause on a quantity's change from weak motion (first row) to strong motion."""
    (_, weak, _), (low, strong, high) = values
    digits = _digits(low, high)
    interval = f"{strong:.{digits}g} {unit} [{low:.{digits}g}, {high:.{digits}g}]"
    if low <= weak <= high:
        return messages.no_change(what, interval)
    return messages.change(what, f"{weak:.{digits}g}", interval, lowers=strong < weak)


def _misfits(summary: RunSummary) -> Iterator[str]:
    """Yield sentences on the errors of fitted and of held-out tests."""
    tests = [row for row in summary.predictions.values() if row.nrmse]
    fitted = [row for row in tests if row.fitted]
    held_out = [row for row in tests if not row.fitted]
    fitted_last = [row for row in summary.held_out_answer.predictions.values() if row.nrmse]
    if fitted:
        yield messages.fitted_errors(len(fitted), _errors(fitted), _noun(fitted))
    else:
        yield messages.NO_ERRORS
    if fitted_last:
        yield f"{_of_held_out(fitted_last)} {messages.FITTED_NOW}"
    elif held_out:
        yield _of_held_out(held_out)
    else:
        yield messages.NONE_HELD_OUT
    unscored = summary.unscored
    if unscored.levels or unscored.kind:
        yield not_scored(unscored.levels, unscored.kind)


def _of_held_out(tests: Sequence[StoredTest]) -> str:
    """Return the sentence on the errors of held-out tests and on the coverage of their bands."""
    inside = [row.coverage for row in tests if row.coverage is not None]
    widths = [row.half_width for row in tests if row.half_width is not None]
    return messages.held_out_errors(
        len(tests), _errors(tests), _span(inside, 3) if inside else "",
        _span(widths) if inside and widths else "",
        sum(row.withheld for row in tests), _noun(tests),
    )  # fmt: skip


def _noun(tests: Sequence[StoredTest]) -> str:
    """Return the noun for what is predicted: record if there are free decays, otherwise test."""
    kinds = (KINDS.get(row.kind) for row in tests)
    return "record" if any(kind is not None and kind.is_free for kind in kinds) else "test"


def fit_sentence(summary: RunSummary) -> str:
    """Return the sentence on RMS errors of fitted tests, from a fit without draws."""
    errors = list((summary.quick or {}).values())
    if not errors:
        return messages.NO_FIT_ERROR
    fitted = [row for row in summary.tests or () if row.fitted is None or row.fitted]
    sentence = messages.fit_errors(len(errors), _span(errors), _noun(fitted))
    return f"{sentence} {messages.LAW_APPROXIMATES}" if summary.exceeds_noise else sentence


def _errors(tests: Sequence[StoredTest]) -> str:
    """Return the text on relative errors of the joint and of the best linear oscillator.

    For held-out free decays it adds the errors with each record's own natural frequency.
    """
    linear = [row.nrmse_linear for row in tests]
    own_frequency = [row.nrmse_own_frequency for row in tests if not row.fitted]
    columns = ([row.nrmse for row in tests], linear, own_frequency)
    errors = ([number for number in column if number is not None] for column in columns)
    return messages.relative_error(*(_span(known) if known else "" for known in errors))


def _span(ratios: Sequence[float], digits: int = 2) -> str:
    """Return the smallest and largest of some ratios in per cent, as text."""
    ends = min(ratios), max(ratios)
    return messages.span(*(f"{float(f'{100 * ratio:.{digits}g}'):g}" for ratio in ends))


def _unknown(summary: RunSummary) -> str:
    """Return the sentence on parameters that the data do not identify or the prior truncates."""
    if (reason := unseen_hysteresis(summary.verdict)) is not None:
        return reason
    rows, graded = summary.parameters, grades(summary)
    drawn = {name: grade for name, grade in graded.items() if rows[name].kl is not None}
    hidden = [name for name, grade in drawn.items() if grade > 1]
    leaning = [row.reason for row in summary.verdict.against if row.code == TRUNCATED]
    if hidden:
        least = _per_cent(min(rows[name].variation for name in hidden))
        products = [name for name, grade in graded.items() if name not in drawn and grade <= 1]
        worst = _per_cent(max((rows[name].variation for name in products), default=0.0))
        poorly = all(drawn[name] == POORLY for name in hidden)
        return messages.not_identified(hidden, least, products, worst, poorly=poorly)
    if leaning:
        return messages.truncated(leaning[0])
    if not drawn:
        return messages.NO_GRADES
    worst = max(drawn, key=lambda name: rows[name].variation)
    share = _per_cent(rows[worst].variation)
    return messages.all_identified(worst, share, roughly=drawn[worst] != 0)


def _per_cent(ratio: float) -> str:
    return f"{float(f'{100 * ratio:.2g}'):g}"


def _following(summary: RunSummary) -> str:
    """Return the sentence on the next step: the remedy of the most important finding.

    Failed findings come before other findings, and a cause before its consequences. If the data
    show no joint, no parameter can be identified, so that remedies for its parameters are left out.
    """
    against = summary.verdict.against
    if any(row.code == ABSENT for row in against):
        follows = set(ASKED["knowledge"]) - {ABSENT}
        against = [row for row in against if row.code not in follows]
    against.sort(key=lambda row: (row.status != "failed", row.code != CAUSE))
    return messages.next_step(next((row.action for row in against if row.action), ""))
