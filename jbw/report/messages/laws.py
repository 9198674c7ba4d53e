"""Messages on a comparison of laws: the best law, which laws differ from it, and why."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import listed, percent

# words that follow the names of the laws if several modes do not share a joint
OF_EACH_MODE = " of each mode"
IN_FIRST_MODE = " in the first mode"
BY_READINGS = "Fitting laws to frequency and damping against amplitude"  # progress message


def trying(law: str) -> str:
    """Return the progress message that a law is fitted because the campaign states none."""
    return f"The campaign states no law: fitting {law}"


def chosen_by_fits(
    law: str, errors: Mapping[str, float], excluded: Sequence[str], *, is_white: bool
) -> str:
    """Return the sentence on the law that was chosen because the campaign states none.

    Args:
        law: The chosen law.
        errors: Errors of the fitted laws relative to the rms of the records, in order of the fits.
        excluded: Laws that were not fitted to the records, as frequency and damping exclude them.
        is_white: Whether the residuals of the chosen law are white.
    """
    fitted = f"the error of {law} is {percent(errors[law])} of the records' rms"
    others = [f"{name} {percent(error)}" for name, error in errors.items() if name != law]
    reason = "only noise remains" if is_white else "the residual of every tried law exceeds noise"
    than = f" (errors of other laws: {', '.join(others)})" if others else ""
    reason += f"; frequency and damping exclude {listed(excluded)}" if excluded else ""
    return (
        f"The campaign states no law; {law} is chosen: {fitted}{than}; {reason}. "
        f'Put under [joint]: `laws = ["{law}"]` to state it.'
    )


EVERY, NONE, NEITHER = "every law", "no law", "neither"  # laws that were tried at one joint only


def tried_at_joints(
    alike: Sequence[str], own: Sequence[str], num_changed: int, which: str, most: int
) -> str:
    """Return the sentences that list the compared laws if there are several joints."""
    sentences = [f"Compared laws, each at all joints: {', '.join(alike)}."] if alike else []
    sentences += [f"Compared laws, as the campaign states them: {', '.join(own)}."] if own else []
    sentences += {
        EVERY: [
            f"In addition, {num_changed} combinations were compared in which one joint has another "
            "law."
        ],
        NONE: [
            f"In addition, {num_changed} combinations were compared in which one joint is fully "
            "stuck. Combinations in which one joint has another law were not compared, because "
            f"there are more than {most}."
        ],
        NEITHER: ["No combination was compared in which the law of a single joint is changed."],
    }[which]
    return " ".join(sentences)


def best_by_predictions(law: str, num_sessions: int) -> str:
    """Return the sentence on the law that best predicts held-out sessions."""
    return f"Best law: {law}; it predicts {num_sessions} held-out sessions best."


def best_by_evidence(law: str, num_sessions: int, needed: int) -> str:
    """Return the sentence on the best law by evidence, if there are too few sessions."""
    there_are = f"there are {num_sessions}" if num_sessions != 1 else "there is 1"
    return (
        f"Best law: {law}, by the evidence alone, which depends on the priors. A comparison of "
        f"predictions needs {needed} sessions, but {there_are}."
    )


def equivalent(laws: Sequence[str]) -> str:
    """Return the sentence on laws that the data do not distinguish from the best law."""
    return f"Laws that the data do not distinguish from the best law: {', '.join(laws)}."


WITHIN, OUTWARD, ACROSS = "within", "outward", "across"
_TARGETS = {
    OUTWARD: ("tests beyond the fitted amplitudes", "the highest level is left out of the fit"),
    ACROSS: ("other kinds of test", "each kind of test is predicted from the other kinds"),
}


def predicted_by(
    target: str, names: Sequence[str], error: float, best: str, of_best: float | None
) -> str:
    """Return the sentence on laws that predict some kinds of test better than the best law does."""
    tests, score = _TARGETS[target]
    comparison = "" if of_best is None else f" (error of {best}: {percent(of_best)})"
    return (
        f"For {tests}, use the predictions of {listed(names)}: when {score}, the prediction error "
        f"of {names[0]} is {percent(error)}{comparison}."
    )


def worse(laws: Sequence[str]) -> str:
    """Return the sentence on laws that the data show to be worse than the best law."""
    return f"Laws that are significantly worse than the best law: {', '.join(laws)}."


def by_fit_alone(law: str, error: float, best: str, least_error: float, behind: float) -> str:
    """Return the sentence on a law whose fit is so poor that nothing else was computed."""
    return (
        f"{law} is judged by its fit alone: its RMS error is {percent(error)} ({best}: "
        f"{percent(least_error)}), and its maximum log likelihood is {behind:.0f} lower than "
        f"that of {best}."
    )


def not_judged(laws: Sequence[str], best: str, khat: float) -> str:
    """Return the sentence on laws whose scores are unreliable."""
    return (
        f"Laws that are not judged: {', '.join(laws)}, because the score of each, or that of "
        f"{best}, is unreliable (k-hat above {khat:g}). Draw more samples, or narrow the "
        "priors."
    )


def against_repeats(law: str, error: float, floor: float, *, near: bool) -> str:
    """Return the sentence on the best law's error compared with that of the mean of repeats."""
    enough = "; the error is so small that the data need no better law" if near else ""
    return (
        f"RMS error of {law}: {percent(error)} of the response; standard error of the mean of a "
        f"test's repeats: {percent(floor)}{enough}."
    )


def linear_by_session(error: float, least: float, most: float) -> str:
    """Return the sentence on the error of linear oscillators, one for each session."""
    return (
        f"RMS error of a linear oscillator fitted to each session: {percent(error)} ("
        f"{percent(least)} to {percent(most)})."
    )


def of_law(law: str, sentence: str) -> str:
    """Return a sentence about the fit of one law; the sentence begins with the law's name."""
    return f"{law}: {sentence}"


def at_bound(law: str, parameters: Sequence[str]) -> str:
    """Return the sentence on a law's parameters that a prior bound truncates."""
    return f"{law}: a prior bound truncates {', '.join(parameters)}."


def unreliable_scores(laws: Sequence[str], khat: float) -> str:
    """Return the sentence on laws whose scores of held-out sessions depend on few draws."""
    return (
        f"Held-out scores of {', '.join(laws)} are unreliable (k-hat above {khat:g}): do not "
        "compare laws by these scores."
    )


def unreliable_evidence(laws: Sequence[str], khat: float) -> str:
    """Return the sentence on laws whose evidence depends on few draws."""
    return (
        f"The evidence of {', '.join(laws)} is unreliable (k-hat above {khat:g}): do not compare "
        "laws by this evidence."
    )


def best_within(law: str, error: float) -> str:
    """Return the sentence on the law that best predicts held-out tests within the fitted motion."""
    best = f"{law} predicts best (RMS error {percent(error)})"
    return f"Held-out tests within the fitted motion: {best}."


def best_beyond(law: str, error: float) -> str:
    """Return the sentence on the law that best predicts tests beyond the fitted motion."""
    return f"Tests beyond the fitted motion: {law} predicts best (RMS error {percent(error)})."


def best_across(law: str, kind: str, error: float) -> str:
    """Return the sentence on the law that best predicts a kind of test from other kinds."""
    return f"{law} predicts {kind} best from the other kinds of test (RMS error {percent(error)})."


def moved(name: str, without: tuple[float, float], with_: tuple[float, float]) -> str:
    """Return a parameter with its error as text, without and with offsets of the test sessions."""
    return (
        f"{name} {without[0]:.3g} +- {without[1]:.1g} (with offsets {with_[0]:.3g} +- "
        f"{with_[1]:.1g})"
    )


def without_offsets(
    law: str, error: float, with_offsets: float, parameters: Sequence[str], least: str,
    least_error: float,
) -> str:  # fmt: skip
    """Return the sentence on the best law if all sessions had the same frequency and damping."""
    other = (
        "no law would have a smaller error"
        if least == law
        else f"{least} would have the smallest error, {percent(least_error)}"
    )
    return (
        "Session offsets and softening compensate each other. Without session offsets, "
        f"{law} has an RMS error of {percent(error)} (with offsets {percent(with_offsets)}) and "
        f"{', '.join(parameters)}; {other}."
    )


def wider_priors(changes: Mapping[str, float]) -> str:
    """Return the sentence on how much the evidence depends on the width of the priors."""
    shown = ", ".join(f"{law} {change:+.1f}" for law, change in changes.items())
    return (
        "If the priors of the laws' parameters are made twice as wide, the log evidence "
        f"changes: {shown} (for every identified parameter it falls by 0.7; it changes by more "
        "if a prior bound truncates the parameter)."
    )


def no_wider_evidence(laws: Sequence[str]) -> str:
    """Return the sentence on laws whose evidence under wider priors could not be computed."""
    return f"With priors twice as wide, the evidence of {', '.join(laws)} could not be computed."


def heading(count: int) -> str:
    """Return the heading of the page that compares laws."""
    return f"{count} laws fitted to the same data with the same weights, 99 % bands."


def not_distinguished(laws: Sequence[str]) -> str:
    """Return the clause that names the laws equivalent to the best law."""
    return f", but the data do not distinguish this law from {', '.join(laws)}"


def error_of_fit(error: float) -> str:
    """Return the title next to the panels of a law: the RMS error of its fit."""
    return f"RMS error of the fit: {percent(error)}"


ANSWERS = {"best": "preferred", "worse": "significantly worse", "not told apart": "equivalent"}
"""The words that the page of a comparison prints for each possible rating of a law."""


BACKBONES = (
    "Frequency and damping ratio against amplitude under each law: first the preferred law, then "
    "the other laws in order of their scores, all on the scale of the preferred law. Open "
    "symbols: values of each test from the fit of a linear oscillator, without a law of the joint. "
    "If the symbols lie outside the band of a law, the law does not describe this joint. Grey: "
    "beyond the fitted amplitudes."
)
LOOPS = (
    "From top to bottom: frequency and damping of all laws in one panel each, the loop of each "
    "law, the residual of each law along one record, and the error of each session, predicted "
    "from the other sessions."
)
LOOPS_TITLE = "Loops, residuals and held-out sessions"
FURTHER = "Frequency and damping ratio against amplitude under the laws with lower scores."
UNJUDGED_TITLE = "Laws that could not be judged"
# labels of the figure that shows the laws side by side
UNDER_EACH_LAW = " under each law with its 99 % band; dotted: largest fitted amplitude"
AMPLITUDE_AXIS = "amplitude of the displacement [mm]"
LOOP_OF_LAWS = "loop of each law at the largest fitted amplitude"
FORCE_AXIS = "force minus the force of the linear spring [N/kg]"
RESIDUAL_ALONG = "residual of each law along "
POSITION_AXIS = "position in the record (0: start, 1: end)"
ERROR_OF_SESSIONS = "error of each session, predicted from the other sessions"
BAR_OF_LINEAR = "; bar: error of a linear oscillator that is fitted to the session"
ERROR_AXIS = "RMS error / rms of the record [%]"
