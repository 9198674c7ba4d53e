"""Findings that answer the question whether the model fits the data."""

import math
from collections.abc import Sequence

from jbw.report.messages.discrepancy import missed
from jbw.report.messages.message import Message, capital, percent

OFFSETS = "The offset of the {quantity}"
TREND = (
    "on the amplitude of the {count} sessions: from the smallest to the largest amplitude the "
    "offset changes by {change:+.2g} +- {std:.1g} {unit} (p = {p:.1g})."
)

GRADES = {
    "ok": "is predictive", "usable": "is approximate", "failed": "is not predictive",
    "not assessed": "is not assessed",
}  # fmt: skip
TO = {
    "repeats": ", as small as the variation between repeats",
    "noise": ", as small as the noise",
    "": "",
}


def grade(
    status: str, count: int, error: float, worst: float, linear: float = math.nan,
    coverage: float = math.nan, to: str = "", **_: object,
) -> str:  # fmt: skip
    """Return the grade of a law, with its prediction errors relative to the rms of the tests."""
    one = count == 1
    tests = "the held-out test" if one else f"{count} held-out tests"
    most = "" if one else f" (at most {percent(worst)})"
    text = f"The law {GRADES[status]}: its RMS error on {tests} is {percent(error)} of the response"
    text += most + TO[to]
    if linear == linear:
        text += f"; the error of the best linear oscillator is {percent(linear)}"
    if coverage == coverage:
        text += f"; the 99 % bands contain {percent(coverage, '.3g')} of the values"
    return f"{text}."


def correlated(
    coloured: int, count: int, test: str, error: float, correlation: float, counted: float
) -> str:
    """Return the sentence on correlated residuals, with the test that has the strongest ones."""
    worst = f"lag-one autocorrelation {correlation:.2f}, RMS error {percent(error)}"
    if coloured == 0:
        return f"The residual of no test is correlated; the largest is that of {test}: {worst}."
    if count == 1:
        text = f"The residual of {test} is correlated: {worst}"
    else:
        noun, verb = ("residual", "is") if coloured == 1 else ("residuals", "are")
        text = (
            f"The {noun} of {coloured} of {count} tests {verb} correlated, most strongly that of "
            f"{test}: {worst}"
        )
    return (
        f"{text}. So that intervals do not become too narrow, {percent(counted)} of its values "
        "count as independent."
    )


def repeatability(count: int, test: str, error: float, scatter: float) -> str:
    """Return the sentence that compares the residual with the variation between repeats."""
    worst = "" if count == 1 else f" (the worst of {count} tests)"
    return (
        f"The residual of {test} is {percent(error)}, the standard deviation between its repeats "
        f"{percent(scatter)}{worst}; the residual must not exceed this standard deviation."
    )


MESSAGES = (
    Message(
        "law_grade",
        grade,
        """
        Check: how well the law predicts held-out tests up to 1.25 times the fitted amplitudes.
        Errors are root mean squares, divided by that of the test.

        *Predictive*: the error of all these tests together is at most 5 % (or `predictive` of
        [identify]), the error of no test is more than twice as much, and the 99 % bands contain at
        least 95 % of the values. *Approximate*: the error is at most 25 % and at most 0.6 times
        that of the best linear oscillator, and the bands contain 95 %. *Not predictive*: all
        other cases. The error may come from noise alone: where the residuals of the fit are white,
        or are at most 1.25 times the variation between repeats, the sentence adds "as small as the
        noise" or "as small as the variation between repeats". The law then need not beat the
        linear oscillator, and an error above 25 % is not assessed.

        The grade answers whether the law follows the data; other findings on the law describe its
        errors. Without a held-out test, those findings alone answer the question.

        Remedy: try other laws (`jbw laws`), or fit tests over the amplitudes that you need.
        """,
        remedy="Hold out tests whose response is well above the noise, or change the law. "
        "{another_law}",
    ),
    Message(
        "chi_square",
        "Chi-square per degree of freedom is {ratio:.3g}; it must lie between {low:g} and "
        "{high:g}.",
        """
        Check: the sum of squared residuals of the fit, divided by its degrees of freedom, for
        groups whose noise is estimated from repeats; it must lie between 0.2 and 5.

        Far above 1, the residual of the model exceeds the noise. Far below 1, the repeats are not
        independent measurements.

        Remedy: see coloured_residual; check that repeats are separate measurements.
        """,
        remedy="Check that every repeat is a separate measurement; if so, compare laws: jbw laws.",
    ),
    Message(
        "coloured_residual",
        correlated,
        """
        Check: the lag-one autocorrelation of the residual; it must be below 0.2 or below 3 /
        sqrt(n), which white noise of n values exceeds only by chance.

        White noise has no autocorrelation. A correlated residual shows a model discrepancy: an
        error of the joint's law, a second mode, or a filter. The likelihood then counts fewer
        samples (an effective number), so that the intervals are as wide as the correlated residual
        requires. `model_error = "none"` takes the law as exact instead. The discrepancy may still
        change the parameters by more than the intervals.

        Where the residual of every test is at most 5 %, this finding, `repeatability` and
        `chi_square` are *usable*: the residual is the error of the law, and the law may be used
        where that error is acceptable.

        Remedy: try other laws (`jbw laws`), fit fewer levels (`hold_out`), restrict the `band`;
        or accept the discrepancy and quote its size.
        """,
        remedy="Check whether the band contains a second mode; if not, the law is inadequate. "
        "{another_law}",
    ),
    Message(
        "repeatability",
        repeatability,
        """
        Check: the residual of the mean of every test's repeats, compared with the standard
        deviation of a single repeat about that mean; the residual must not be larger.

        A law with a residual of 8 % for records whose repeats vary by 3 % predicts a record
        worse than another repeat does. A law may pass this check and still have a correlated
        residual, which many repeats reveal.

        Remedy: see coloured_residual; or accept the law and quote its error.
        """,
        remedy="Quote this residual as the error of the law. {another_law}",
    ),
    Message(
        "cause",
        lambda text, share: (
            f"{capital(text.rstrip('.'))}. This would explain {percent(share, '.0f')} of the "
            "residual."
        ),
        """
        Check: if the residual exceeds the noise, whether a usual mistake explains the residual.
        Each mistake is fitted together with the parameters by one Gauss-Newton step. The mistakes
        are: a delayed response, a test with a reversed sign or in another unit, swapped channels,
        a constant offset, clipped values, the response of modes outside the band, one more mode
        in the band, a separate natural frequency for each test.

        A cause that would explain more than half of the residual is reported as this finding, with
        the size of the cause. Causes that would explain a tenth or more are listed among the
        statements of the posterior. The check shows what *would* explain the residual: a law that
        does not suit the joint may look like tests whose natural frequencies differ.

        Remedy: do what the finding says, and identify again.
        """,
        remedy="{action}",
    ),
    Message(
        "level_trend",
        f"{OFFSETS} depends {TREND}",
        """
        Check: whether the sessions' offsets of natural frequency and damping depend on the size
        of the motion. A weighted straight line is fitted to the offsets of five sessions or more;
        its slope is tested by Student's t at a probability of 0.5 %.

        Sessions and assemblies vary at random. Offsets that rise or fall with the motion show
        that the law's dependence on amplitude is wrong, but they hide the error from the
        residual: the intervals are those of a wrong law.

        Remedy: the law that the finding names, or `jbw laws`; `offsets = "none"` shows the
        residual without offsets. If levels were measured in rising order while the structure
        warmed up, measure them once in another order.
        """,
        remedy="Change the law: the law's dependence on amplitude is wrong. (Differences between "
        "sessions cause random offsets, without a trend.) {another_law}",
        passed=f"{OFFSETS} does not depend {TREND}",
    ),
    Message(
        "misfit",
        "The largest residual of a fitted record is {error:.2g %} of its rms ({test}); it must be "
        "less than {limit:.0f %}.",
        """
        Check: the residual of every fitted record, for the decay that fits it best.

        Remedy: check `band` for a second mode, and `settle`.
        """,
        remedy="Check whether the band contains a second mode, and check `settle`; if both are "
        "right, the law is inadequate. {another_law}",
    ),
    Message(
        "leave_one_out",
        "Without session {test}, the fitted value of {name} changes by {moves:.1f} times the "
        "standard deviation that chance would cause; the limit is {limit:g}, and no other session "
        "has so large an effect.",
        """
        Check: the change of the fit without each session, divided by the standard deviation that
        chance would cause; the ratio must be below 4.

        Sessions that need different parameters contradict each other: the joint depends on
        amplitude in another way than the model, or the structure changed between them.

        Remedy: `hold_out` the levels that the law does not cover; name `run` and `assembly`
        where days differ.
        """,
        remedy="Hold this session out by `hold_out`, or change the law: the sessions contradict "
        "each other. {another_law}",
    ),
    Message(
        "leave_one_out.none", "No single session contains information that the other sessions lack."
    ),
    Message(
        "records_apart",
        lambda count, name, scatter, others, within, beyond: (
            f"When each of the {count} records is fitted separately, {name} varies between them by "
            f"{percent(scatter)}{_others(others)} in addition to its errors (standard deviation). "
            f"The 99 % interval of {name} is +-{percent(within)} if one law describes all records; "
            f"for other records like these it is +-{percent(beyond)}."
        ),
        """
        Check: if a campaign has three free decays or more and no other test, every record is
        fitted separately. The products and zeta of the records must agree within their errors, at
        a probability of 1 %, or vary so little that no interval widens by a fifth.

        A law with a small error needs other parameters at other amplitudes. The posterior of all
        records takes the law as exact and is too narrow; other records of the same structure lie
        outside its bands. The standard deviation between records is that of a random effect
        (Paule and Mandel). An interval for similar records adds the square of this standard
        deviation, divided by the number of records, to the variance. `jbw diff` widens the
        intervals of both runs in this way.

        Remedy: quote the wider interval; compare laws by `jbw laws`; fit only records of similar
        amplitude.
        """,
        remedy="Quote the wider interval. Look for a difference between the records, such as the "
        "size or place of the blow; `jbw laws` tries laws that may describe all of them.",
        passed="When each of the {count} records is fitted separately, the values of {names:list} "
        "agree within their errors.",
    ),
    Message(
        "simpler_model",
        "On {test} ({fit_status}) the RMS error of the joint's law is {error:.2g %} of the "
        "record's rms; the error of the best {kind} oscillator is {simpler:.2g %}. On every test "
        "the law's error must be below {limit:g} times the oscillator's error.",
        """
        Check: the error of every test, compared with that of the best linear and (with
        `compare_with` = ["linear", "cubic"]) cubic oscillator of the same tests; it must be less
        than 1.1 times the oscillator's error.

        If a simpler oscillator has a smaller error, the law of the joint explains nothing. A
        Bouc-Wen joint of negative delta mimics a cubic stiffness at the fitted amplitude, and
        fails at another amplitude: this check detects it.

        Remedy: fit fewer levels, add `cubic`, or check whether the data show hysteresis at all.
        """,
        remedy="Use `fit_levels` to fit fewer levels: the joint's law does not describe this test. "
        "{another_law}",
    ),
    Message(
        "discrepancy",
        missed,
        """
        Check: each run in turn is left out of the fit, and predicted from the others. The
        prediction must not differ from the run by more than noise and the errors of the
        parameters explain, at a probability of 1 %: in natural frequency, in damping ratio, and
        in the rest of the response.

        A law that is not quite right has another stiffness or damping than the joint at some
        amplitudes. Bands of tests that were not fitted include this error of the law: Within the
        fitted amplitudes this error is as large as the omitted runs show. Above them it grows with
        the square of the amplitude and with the distance in its logarithm; below them it grows at
        most by a factor of three. Where the errors do not exceed noise, the bands contain the
        uncertainty of the parameters and the noise alone. The bands include an error below 0.1 % of
        the response at resonance, but such an error does not fail the law, because sensors are not
        more linear.

        Remedy: compare laws by `jbw laws`; fit the levels that you want to predict.
        """,
        "Predict only within the fitted amplitudes, or change the law. {another_law}",
        "Runs that are left out of the fit are predicted within the noise.",
    ),
    Message(
        "discrepancy.small",
        "Runs that are left out of the fit are predicted with an error of {error:.2g %} of the "
        "response at resonance: more than noise, but less than the limit of {limit:.2g %}. The "
        "bands include this error.",
    ),
    Message(
        "discrepancy.no_repeats",
        "Runs that are left out of the fit are predicted within the residual of the fit, which "
        "counts as noise because no test has repeats.",
    ),
    Message(
        "law_replaced",
        "On {test} the standard deviation of the bands with the model discrepancy is {ratio:.3g} "
        "times the error of the best linear oscillator, the largest ratio of all tests; it must "
        "be less than {limit:.3g}. Wider bands come from the discrepancy, not from the law.",
        """
        Check: the standard deviation of the bands of every held-out test, divided by the error of
        the best linear oscillator. The ratio must be less than 1, or less than 1.4 if the error
        of the joint's law is as large as that of the linear oscillator. The check is made if the
        error of the law on runs that were left out of the fit exceeds noise.

        The bands of held-out tests then include a model discrepancy: the error of the law in
        frequency and damping at each amplitude. If the discrepancy is as large as the error of a
        linear oscillator, the law does not describe the joint, even if the bands contain all
        values.

        Remedy: do not predict tests of this kind and level with this law, and try other laws:
        jbw laws.
        """,
        remedy="Do not predict tests of this kind and level with this law. {another_law}",
    ),
    Message(
        "held_out_coverage",
        "The lowest coverage of a held-out test is that of {test}: {share:.1f %} of its values lie "
        "inside the 99 % band; at least {limit:.0f %} must.",
        """
        Check: the share of the values of every held-out test inside the 99 % band; at least 95
        %.

        A band is withheld if two conditions hold: the error of the law on runs that are left out
        of the fit exceeds noise, and the test's amplitude is too large. It is too large if its
        ratio to the largest fitted amplitude exceeds both two and the ratio of the largest to the
        smallest fitted amplitude. The message names the tests without a band.

        Remedy: see leave_one_out and coloured_residual. Beyond the fitted amplitudes the bands
        extrapolate; the report says how far. If a test has no band, fit a test of its level.
        """,
        remedy="The bands are too narrow for tests that were not fitted: allow for differences "
        "between runs, or change the law. {line}",
    ),
    Message(
        "no_hysteresis",
        lambda y, damping, frequency: (
            f"No hysteresis is detected: at {y:.2g} mm the joint adds {_change(damping)} of zeta "
            "to the damping, but the interval of its change of the natural frequency, "
            f"{_change(frequency)}, includes zero. Damping proportional to the square of the "
            "velocity has the same effect."
        ),
        """
        Check: whether the joint lowers the natural frequency at the largest fitted displacement,
        or only adds damping, according to the 99 % intervals.

        Hysteresis that adds damping reduces the stiffness, so the frequency falls with amplitude.
        Quadratic damping (drag, a fluid, a rough guide) adds damping in proportion to the amplitude
        and does not change the frequency. A law of hysteresis that is fitted to quadratic damping
        imitates it, with meaningless parameters and a wrong phase.

        If the frequency falls by less than half of the damping ratio that the joint adds,
        quadratic damping is fitted to the same data in place of the laws. Quadratic damping has
        fewer parameters, so chi-square usually grows. Hysteresis is detected only if the growth
        exceeds the limit that chance exceeds with a probability of 1 %, however narrow the
        intervals of the laws' parameters are.

        Remedy: put `laws = ["quadratic_damping"]` under `[joint]`, and compare: jbw laws.
        """,
        remedy='Try damping without hysteresis. Put under [joint]: `laws = ["{law}"]`.',
    ),
    Message(
        "no_hysteresis.drag",
        lambda growth, least, number, y, frequency, damping: (
            "No hysteresis is detected: a model with damping proportional to the square of the "
            f"velocity and {number} parameters fewer {_fits(growth)}. At {y:.2g} mm the fitted "
            f"joint adds {_change(damping)} of zeta to the damping and changes the natural "
            f"frequency by {_change(frequency)}; slip that adds so much damping would lower the "
            "frequency more. Do not use the joint's parameters, and do not predict responses "
            f"beyond {y:.2g} mm."
        ),
        remedy='Try damping without hysteresis. Put under [joint]: `laws = ["{law}"]`.',
        passed="With damping proportional to the square of the velocity in place of hysteresis, "
        "chi-square grows by {growth:.3g}; growth by chance is at most {least:.3g} (99 %).",
    ),
)


def _fits(growth: float) -> str:
    """Return the clause that a law with fewer parameters fits as well, with chi-square."""
    if growth < 0.0:
        return f"fits better: chi-square falls by {-growth:.2g}"
    return f"fits as well: chi-square grows by only {growth:.2g}"


def _others(scatters: Sequence[tuple[str, float]]) -> str:
    """Return the standard deviations between records of all quantities except the first."""
    listed = ", ".join(f"{name} by {percent(scatter)}" for name, scatter in scatters)
    return f" ({listed})" if scatters else ""


def _change(quantiles: Sequence[float]) -> str:
    """Return a relative change with its interval, in per cent, as text."""
    low, middle, high = (f"{x:.0f}" if abs(x) >= 100 else f"{x:.2g}"
                         for x in (100 * value for value in quantiles))  # fmt: skip
    return f"{middle} % [{low}, {high}]"
