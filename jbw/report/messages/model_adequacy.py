"""Findings on the question: does the model follow the data?"""

from collections.abc import Sequence

from jbw.report.messages.discrepancy import missed
from jbw.report.messages.message import Message, capital, percent

OFFSETS = "The offset of the {quantity}"
TREND = (
    "on the amplitude of the {count} sessions: from the smallest to the largest it changes by "
    "{change:+.2g} +- {std:.1g} {unit} (p = {p:.1g})."
)

GRADES = {
    "ok": "is predictive", "usable": "is approximate", "failed": "is not predictive",
    "not assessed": "is not assessed",
}  # fmt: skip
TO = {"repeats": ", to the scatter of repeats", "noise": ", to the noise", "": ""}


def grade(
    status: str, count: int, error: float, worst: float, linear: float, coverage: float, to: str,
    **_: object,
) -> str:  # fmt: skip
    """Return the grade of a law, with its prediction errors relative to the rms of the tests."""
    one = count == 1
    tests = "the held-out test" if one else f"{count} held-out tests"
    most = "" if one else f" (at most {percent(worst)})"
    text = f"The law {GRADES[status]}: it misses {tests} by {percent(error)} of the rms{most}"
    text += TO[to]
    if linear == linear:
        text += f"; the best linear oscillator misses {percent(linear)}"
    if coverage == coverage:
        text += f"; the 99 % bands hold {percent(coverage, '.3g')} of the values"
    return f"{text}."


MESSAGES = (
    Message(
        "law_grade",
        grade,
        """
        Check: how well the law predicts held-out tests up to 1.25 times the fitted amplitudes.
        Errors are root mean squares over that of the test.

        *Predictive*: the error of all these tests together is at most 5 % (or `predictive` of
        [identify]), of none more than twice as much, and the 99 % bands hold at least 95 % of
        their values. *Approximate*: at most 25 %, and 0.6 times the error of the best linear
        oscillator, and bands that hold 95 %. *Not predictive*: else. The error may be what noise
        makes: where the fit leaves white residuals, or misses no more than 1.25 times the scatter
        of repeats, "to the noise" or "to the scatter of repeats" is added, the linear oscillator
        need not be beaten, and an error above 25 % is not assessed.

        The grade answers whether the law follows the data; other findings on the law say what it
        misses. Without a held-out test they answer themselves.

        Remedy: try other laws (`jbw laws`), or fit tests over the amplitudes that are wanted.
        """,
        remedy="Hold out tests that are louder than the noise, or try another law. {another_law}",
    ),
    Message(
        "chi_square",
        "Chi-square per degree of freedom is {ratio:.3g}; it must lie between {low:g} and "
        "{high:g}.",
        """
        Check: the sum of squared residuals of the fit over its degrees of freedom, for groups
        whose noise is estimated from repeats; between 0.2 and 5.

        Far above 1, the model does not follow the data to their noise. Far below 1, the repeats
        are not independent measurements.

        Remedy: see coloured_residual; check that repeats are separate measurements.
        """,
        remedy="Check that every repeat is a measurement of its own; else compare laws: jbw laws.",
    ),
    Message(
        "coloured_residual",
        "The residuals of {coloured} of {count} tests are coloured, most of all that of {test}: "
        "RMS error {error:.2g %}, lag-one autocorrelation {correlation:.2f}. So that intervals do "
        "not become too narrow, {counted:.2g %} of its values count as independent.",
        """
        Check: the lag-one autocorrelation of the residual; below 0.2, and below 3 / sqrt(n),
        which white noise of n values exceeds by chance only.

        White noise has no autocorrelation. A coloured residual is model discrepancy: of the
        joint's law, of a second mode, of a filter. The likelihood then counts an effective
        number of samples, so that the covariance of least squares equals that caused by such a
        residual (`model_error = "none"` takes the law as exact instead). Intervals then do not
        become too narrow; a bias of the parameters by the discrepancy may still exceed them.

        Where the residual of every test is at most 5 %, this finding, `repeatability` and
        `chi_square` are *usable*: the law is wrong by its residual and may be used within it.

        Remedy: try other laws (`jbw laws`), fit fewer levels (`hold_out`), restrict the `band`;
        or accept the discrepancy and quote its size.
        """,
        remedy="The law is inadequate, or a second mode lies in the band. {another_law}",
    ),
    Message(
        "repeatability",
        "Residual and scatter of the repeats, the worst of {count}: {test}, {error:.2g %} against "
        "{scatter:.2g %}; it must be no larger.",
        """
        Check: the residual of the mean of every test's repeats beside the scatter of a single
        repeat about that mean; the residual must not be larger.

        A law with a residual of 8 % for records whose repeats scatter by 3 % predicts a record
        worse than another repeat does. A law may pass this check and still have a coloured
        residual, which many repeats reveal.

        Remedy: see coloured_residual; or accept the law and quote its error.
        """,
        remedy="Quote this as the error of the law. {another_law}",
    ),
    Message(
        "cause",
        lambda text, share: (
            f"{capital(text)} would explain {percent(share, '.0f')} of the residual."
        ),
        """
        Check: where the residual exceeds the noise, the usual mistakes, each by one Gauss-Newton
        step beside the parameters: a delayed response, a test with its sign reversed or in
        another unit, swapped channels, a constant offset, clipped values, the response of modes
        outside the band, one more mode in the band, a natural frequency of every test's own.

        A cause that would explain more than half of the residual becomes this finding, with its
        size; causes that would explain a tenth or more stand among the statements of the
        posterior. The check shows what *would* explain the residual: a law that does not suit
        the joint may look like tests whose natural frequencies differ.

        Remedy: do what the finding says, and identify again.
        """,
        remedy="{action}",
    ),
    Message(
        "level_trend",
        f"{OFFSETS} depends {TREND}",
        """
        Check: where sessions have offsets of natural frequency and damping, whether the offsets
        depend on the size of the motion: a weighted slope over five sessions or more, by
        Student's t at a probability of 0.5 %.

        Sessions and assemblies scatter at random. Offsets that rise or fall with the motion are
        the error of the law's amplitude dependence, and the offsets hide it: the intervals are
        then those of a law that does not hold.

        Remedy: the law that the finding names, or `jbw laws`; `offsets = "none"` shows the
        residual without offsets. If levels were measured in rising order while the structure
        warmed up, measure them once in another order.
        """,
        remedy="This is an error of the law, and no scatter of sessions. {another_law}",
        passed=f"{OFFSETS} does not depend {TREND}",
    ),
    Message(
        "misfit",
        "Largest residual of a fitted record: {error:.2g %} of {test}; it must be less than "
        "{limit:.0f %}.",
        """
        Check: the residual of the best decay for every fitted record.

        Remedy: check `band` for a second mode, and `settle`.
        """,
        remedy="Doubt the band (a second mode), `settle`, or the law. {another_law}",
    ),
    Message(
        "leave_one_out",
        "Without {test} the estimate of {name} moves by {moves:.1f} standard deviations of such a "
        "change, the most of all sessions; it must be below {limit:g}.",
        """
        Check: the change of the fit without each session, in standard deviations of such a
        change by chance; below 4.

        Sessions that need different parameters contradict each other: the joint depends on
        amplitude in another way than the model, or the structure changed between them.

        Remedy: `hold_out` the levels that the law does not cover; name `run` and `assembly`
        where days differ.
        """,
        remedy="The sessions contradict each other: hold this one out by `hold_out`, or doubt the "
        "law. {another_law}",
    ),
    Message("leave_one_out.none", "No single session adds information to the others."),
    Message(
        "records_apart",
        lambda count, name, scatter, others, within, beyond: (
            f"Fitted each by itself, the {count} records scatter by {percent(scatter)} of "
            f"{name}{_others(others)} beyond their own errors. The 99 % interval of {name} is "
            f"+-{percent(within)} for a law that holds in all of them; for other records like "
            f"these it is +-{percent(beyond)}."
        ),
        """
        Check: every record of free decay fitted by itself, where a campaign has three decays or
        more and nothing else. Their products and zeta must agree within their errors, at a
        probability of 1 %, or scatter so little that no interval widens by a fifth.

        A law with a small error needs other parameters at other amplitudes. The posterior of all
        records takes the law as exact and is too narrow; other records of the same structure lie
        outside it. The scatter is that of a random effect (Paule and Mandel); an interval for
        records like these adds its square over their number. `jbw diff` widens the intervals of
        both runs by it.

        Remedy: quote the wider interval; compare laws by `jbw laws`; fit records of one size
        alone.
        """,
        remedy="Quote the wider interval, and look for what differs between the records, such as "
        "size or place of the blow: `jbw laws` tries laws that may hold in all of them.",
        passed="Fitted each by itself, the {count} records agree in what all of them say of "
        "{names:list}.",
    ),
    Message(
        "simpler_model",
        "RMS error on {test} ({fit_status}): {error:.2g %} of the record's rms by the law of the "
        "joint, {simpler:.2g %} by the best {kind} oscillator; on every test the former must be "
        "below {limit:g} times the latter.",
        """
        Check: the error of every test against that of the best linear and (with `compare_with =
        ["linear", "cubic"]`) cubic oscillator of the same tests; less than 1.1 times theirs.

        A joint that a simpler oscillator beats explains nothing. A Bouc-Wen joint of negative
        delta mimics a cubic stiffness at the fitted amplitude, and fails at another amplitude:
        this check detects it.

        Remedy: fit fewer levels, add `cubic`, or doubt that the data show hysteresis.
        """,
        remedy="The law of the joint does not hold there: fit fewer levels by `fit_levels`. "
        "{another_law}",
    ),
    Message(
        "discrepancy",
        missed,
        """
        Check: whether runs that are left out of the fit, each in turn, differ from what the fit
        to the others predicts by more than noise and the errors of the parameters, at a
        probability of 1 %: in natural frequency, in damping ratio, and in the rest of the
        response.

        A law that is not quite right has another stiffness or damping than the joint at some
        amplitudes. Bands of tests that were not fitted include what it misses: within the fitted
        amplitudes as runs left out show it, above them growing with the square of the amplitude
        and with the distance in its logarithm, below them to three times as much at most. A law
        that misses nothing beyond noise has the bands of its parameters and the noise. What is
        below 0.1 % of the response at resonance is in the bands and no fault of the law: sensors
        are not linear to less.

        Remedy: compare laws by `jbw laws`; fit the levels that are to be predicted.
        """,
        "Compare laws, or predict within the fitted amplitudes. {another_law}",
        "Predictions of runs left out of the fit err by no more than noise.",
    ),
    Message(
        "discrepancy.small",
        "Predictions of runs left out of the fit err by {error:.2g %} of the response at "
        "resonance: more than noise, but less than the limit of {limit:.2g %}. The bands include "
        "it.",
    ),
    Message(
        "discrepancy.no_repeats",
        "Predictions of runs left out of the fit err by no more than the residual of the fit, "
        "which counts as noise because no test has repeats.",
    ),
    Message(
        "law_replaced",
        "The bands with the model discrepancy are widest on {test}: their standard deviation over "
        "the error of the best linear oscillator is {ratio:.3g}; it must be less than {limit:.3g}, "
        "or the discrepancy has replaced the law.",
        """
        Check: where the law leaves more than noise on runs that were left out, the standard
        deviation of the bands of every held-out test over the error of the best linear
        oscillator; less than 1, or 1.4 where the joint misses as much as the linear oscillator.

        The bands of such tests include a model discrepancy: what the law misses of frequency and
        damping, by amplitude. Where that is as large as what a linear oscillator misses, the law
        says nothing about the joint there, however many values its bands hold.

        Remedy: do not predict such tests by this law, and try others: jbw laws.
        """,
        remedy="Do not predict such tests by this law. {another_law}",
    ),
    Message(
        "held_out_coverage",
        "Lowest coverage of the held-out tests: {share:.1f %} of the values of {test} lie "
        "inside the 99 % band; at least {limit:.0f %} must.",
        """
        Check: the share of the values of every held-out test inside the 99 % band; at least 95
        %.

        Where the law misses more than noise of runs that are left out, a test farther above the
        fitted amplitudes than these are apart has no band: it is withheld, and the test named.

        Remedy: see leave_one_out and coloured_residual. Beyond the fitted amplitudes the bands
        extrapolate; the report says how far. Of a test without a band: fit one of its level.
        """,
        remedy="The intervals are too narrow for what was not fitted: the law does not hold there, "
        "or runs differ. {line}",
    ),
    Message(
        "no_hysteresis",
        lambda y, damping, frequency: (
            f"No hysteresis is detected: at {y:.2g} mm the joint adds {_change(damping)} of zeta "
            f"to the damping, but its change of the natural frequency, {_change(frequency)}, "
            "includes zero. Damping by the square of the velocity does the same."
        ),
        """
        Check: whether the joint lowers the natural frequency, or adds damping alone, at the
        largest fitted displacement, by 99 % intervals.

        Hysteresis that adds damping reduces the stiffness, so the frequency falls with
        amplitude. Quadratic damping (drag, a fluid, a rough guide) adds damping in proportion to
        the amplitude and does not change the frequency. A law of hysteresis then follows it with
        meaningless parameters, and misses its phase.

        Where the frequency falls by less than half of the damping ratio that the joint adds, the
        same data are fitted by quadratic damping in place of the laws. If chi-square grows by no
        more than so many parameters reach by chance at a probability of 1 %, hysteresis is not
        seen, however narrow the intervals of its parameters are.

        Remedy: put `laws = ["quadratic_damping"]` under `[joint]`, and compare: jbw laws.
        """,
        remedy='Try damping without hysteresis. Put under [joint]: `laws = ["{law}"]`.',
    ),
    Message(
        "no_hysteresis.drag",
        lambda growth, least, number, y, frequency, damping: (
            f"No hysteresis is detected: damping proportional to the square of the velocity, with "
            f"{number} parameters fewer, {_fits(growth)}. At {y:.2g} mm the fitted joint adds "
            f"{_change(damping)} of zeta to the damping and changes the natural frequency by "
            f"{_change(frequency)}; slip that adds so much damping would lower it more. Do not use "
            "the joint's parameters, nor responses beyond that motion."
        ),
        remedy='Try damping without hysteresis. Put under [joint]: `laws = ["{law}"]`.',
        passed="Damping by the square of the velocity, in place of hysteresis, makes chi-square "
        "grow by {growth:.3g}, by chance {least:.3g}.",
    ),
)


def _fits(growth: float) -> str:
    """Return the clause that a law with fewer parameters fits as well, with chi-square."""
    if growth < 0.0:
        return f"fits better: chi-square falls by {-growth:.2g}"
    return f"fits as well: chi-square grows by only {growth:.2g}"


def _others(scatters: Sequence[tuple[str, float]]) -> str:
    """Return the standard deviations of more quantities between records, in brackets."""
    listed = ", ".join(f"{name} by {percent(scatter)}" for name, scatter in scatters)
    return f" ({listed})" if scatters else ""


def _change(quantiles: Sequence[float]) -> str:
    """Return the message on a relative change with its interval, in per cent."""
    low, middle, high = (f"{x:.0f}" if abs(x) >= 100 else f"{x:.2g}"
                         for x in (100 * value for value in quantiles))  # fmt: skip
    return f"{middle} % [{low}, {high}]"
