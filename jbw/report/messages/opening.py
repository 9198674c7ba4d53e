"""The opening sentences of a run: effect of the joint, errors, identifiability, next step."""

from collections.abc import Sequence

from jbw.report.messages.message import listed, number

LINEAR = "The structure is modelled as linear, without a joint."
NO_BACKBONE = "This run does not contain frequency and damping against amplitude."
NO_ERRORS = "This run does not contain the errors of the fitted tests."
TORSION = (
    "The motion is a rotation: in all units of parameters and tables, read rad for m and N m for N."
)
NONE_HELD_OUT = (
    "No test was held out; with `hold_out` the report shows how well the model predicts a test."
)
FITTED_NOW = "After this check, the held-out tests were included in the fit."
LAW_APPROXIMATES = (
    "The residual exceeds noise, so the law is an approximation. The intervals of frequency and "
    "damping at an amplitude include an error of the size of the residual; intervals of parameters "
    "do not, and omega_n and zeta, which are values at vanishing motion, may differ by more."
)
NO_FIT_ERROR = "The error of the fit will be known when the posterior is sampled."
SPREAD = (
    "The fitted repeats range from the strongest to the weakest; `fit_repeats` states how many "
    "repeats are fitted."
)
NAMED = 6  # largest number of tests that a list names
NO_GRADES = (
    "The result of this run does not state which parameters are identified. Look at the findings "
    "of the run."
)
NOTHING_TO_DO = "To do next: nothing; the result can be used."
STATUS = {
    "ok": "The main posterior can be used.",
    "usable": "The main posterior can be used with the stated model discrepancy.",
    "not assessed": "Some checks could not be made: treat the main posterior as provisional.",
    "failed": "Do not use the main posterior as it is.",
}
READ_FIRST = "Read the findings before you use the result."
UNDRAWN = "This figure could not be drawn: "
BACKBONE_PICTURE = "Frequency and damping against amplitude"
GRADES = (
    "Identified, with the coefficient of variation",
    "Roughly identified",
    "Poorly identified",
    "Not identified, the prior is nearly unchanged",
)
STEPS = {
    "linear": "Step 2: linear regime, line fit",
    "third_order_paper": "Step 3: third-order kernel, random walk as published",
    "third_order_walk": "Step 3: third-order kernel, tuned random walk",
    "third_order_nuts": "Step 3: third-order kernel, NUTS",
    "opening_paper": "Step 4: gamma alone, random walk as published",
    "opening_walk": "Step 4: gamma alone, tuned random walk",
    "opening_nuts": "Step 4: gamma alone, NUTS",
    "joint": "Step 4: all parameters together",
    "decay": "Free decays",
}


def doubtful(doubt: str) -> str:
    """Return the sentence on a doubt about the records."""
    return f"Doubtful: {doubt}"


def split(fitted: Sequence[str], held_out: Sequence[str], *, some_repeats: bool) -> str:
    """Return the sentence on fitted tests, held-out tests and the choice of repeats."""
    said = f"Fitted: {_some(fitted)}. Held out: {_some(held_out) if held_out else 'nothing'}."
    return f"{said} {SPREAD}" if some_repeats else said


def _some(tests: Sequence[str]) -> str:
    more = len(tests) - NAMED
    return listed([*tests[:NAMED], f"{more} more"] if more > 1 else tests)


def repeats(test: str, numbers: Sequence[int]) -> str:
    """Return the name of a test with the numbers of some of its repeats."""
    return f"{test} ({'repeat' if len(numbers) == 1 else 'repeats'} {listed(numbers)})"


def effect(least: float, most: float, unit: str, changes: str) -> str:
    """Return the sentence on the effect of the joint between two amplitudes."""
    low, high = number(least, ".2g"), number(most, ".2g")
    return f"From {low} to {high} {unit} of motion the joint {changes}."


def contradicted(y: float, unit: str, modelled: str, measured: str) -> str:
    """Return the sentence that the law's damping differs from the damping of the records."""
    return (
        f"At {number(y, '.3g')} {unit} the law has a damping ratio of {modelled}, but the records "
        f"show {measured} without a law. One of these values is wrong: do not use the law near "
        "this amplitude before you know which. Another mode may move the joint too, which changes "
        "both (leave out the beginning of decays by `settle`); the joint may differ between "
        "records (identify each day and torque separately); or the law may be wrong (compare laws: "
        "jbw laws)."
    )


def joints_effect(mode: int, frequency: str, damping: str) -> str:
    """Return the clause on the effect of all joints on a mode at its largest motion."""
    return f"the frequency of mode {mode} changes by {frequency} and its damping ratio by {damping}"


def in_full_stick(effect: str) -> str:
    """Return the clause that an effect is computed with the mode shape of fully stuck joints."""
    return f"{effect} (in the mode shape with fully stuck joints)"


def at_largest_motion(effects: Sequence[str]) -> str:
    """Return the sentence on the effect of all joints on every mode at its largest motion."""
    return (
        "Effect of all joints together at the largest motion of each mode, in the mode shape at "
        f"that motion: {'; '.join(effects)}."
    )


def sentence(clauses: Sequence[str]) -> str:
    """Return a sentence that joins several clauses by commas."""
    joined = ", ".join(clauses)
    return f"{joined[0].upper()}{joined[1:]}."


def damped_by(mode: int, joint: str, percent: str) -> str:
    """Return the clause on the joint with the largest share of a mode's losses."""
    return f"mode {mode} is damped mainly by {joint} ({percent} % of the joints' losses)"


def joints_unidentified(names: Sequence[str]) -> str:
    """Return the sentence on joints whose separate effects the tests do not identify."""
    return (
        f"Not identified separately: {listed(names)}; the effect of all joints together on each "
        "mode is identified."
    )


def one_law(joints: Sequence[str], odds: str) -> str:
    """Return the sentence that joints share one law, according to the evidence."""
    return (
        f"{' and '.join(joints)} have the same law: the evidence is {odds} to 1 against separate "
        "laws."
    )


def own_laws(joints: Sequence[str], odds: str) -> str:
    """Return the sentence that joints have different laws, according to the evidence."""
    return (
        f"{' and '.join(joints)} have different laws: the evidence is {odds} to 1 against one law."
    )


def law_not_told(joints: Sequence[str], reason: str) -> str:
    """Return the sentence that the evidence does not decide whether joints share a law."""
    return f"The tests do not determine whether {' and '.join(joints)} have the same law: {reason}."


def rough_evidence(khat: float) -> str:
    """Return the reason that the evidence is unreliable, with the k-hat of its weights."""
    return f"the evidence is unreliable (k-hat {khat:.2g})"


def weak_evidence(odds: str, preferred: str) -> str:
    """Return the clause that the evidence for one law or for separate laws is weak."""
    return f"the evidence is only {odds} to 1 for {preferred}"


def keeps_stiffness(percent: float, low: float, high: float) -> str:
    """Return the clause on the fraction of its stiffness that a joint keeps at large motion."""
    return f"keeps {percent:.3g} % [{low:.3g}, {high:.3g}] of its stiffness"


def of_unknown_mass(stiffness: str, interval: str, *, is_rotation: bool) -> str:
    """Return the sentence on a stuck joint's stiffness if no test determines the modal mass."""
    mass, unit = ("inertia", "N m/rad") if is_rotation else ("mass", "N/m")
    return (
        f"The stiffness of the fully stuck joint is {stiffness} {interval} {unit}. The tests do "
        f"not determine the modal {mass}: the parameters are those of 1 kg{' m^2' * is_rotation}."
    )


def no_change(what: str, interval: str) -> str:
    """Return the clause that the change of a quantity is smaller than its uncertainty."""
    return f"changes the {what} by less than its uncertainty ({interval})"


def change(what: str, start: str, interval: str, *, lowers: bool) -> str:
    """Return the clause on how a quantity changes, with the interval of its final value."""
    return f"{'lowers' if lowers else 'raises'} the {what} from {start} to {interval}"


def fitted_errors(count: int, errors: str, noun: str = "test") -> str:
    """Return the sentence on the errors of fitted tests, or of their records."""
    return f"RMS error of {_tests(count, 'fitted', noun)}: {errors}."


def held_out_errors(
    count: int, errors: str, coverage: str, width: str, withheld: int = 0, noun: str = "test"
) -> str:
    """Return the sentence on errors of held-out tests, with the coverage of the bands."""
    half_width = f" (half width: {width} of the rms)" if width else ""
    band = f"; the 99 % bands contain {coverage} of the values{half_width}" if coverage else ""
    bands = "band is" if withheld == 1 else "bands are"
    without = f"; the {bands} withheld for {withheld} of these tests" if withheld else ""
    return f"RMS error of {_tests(count, 'held-out', noun)}: {errors}{band}{without}."


def fit_errors(count: int, errors: str, noun: str = "test") -> str:
    """Return the sentence on errors of fitted tests (or records), before sampling."""
    fitted = _tests(count, "fitted", noun)
    return f"RMS error of {fitted}: {errors}; no other test is predicted yet."


def relative_error(error: str, linear: str, own: str = "") -> str:
    """Return an error relative to the record's rms as text, with errors for comparison.

    Args:
        error: As it stands.
        linear: Of the best linear oscillator; empty where not known.
        own: With the natural frequency of each record as measured; empty where not known.
    """
    compared = [f"best linear oscillator: {linear}"] if linear else []
    compared += [f"with a natural frequency for each record: {own}"] if own else []
    comparison = f" ({'; '.join(compared)})" if compared else ""
    return f"{error} of the record's rms{comparison}"


def span(least: str, most: str) -> str:
    """Return a range in per cent as text."""
    return f"{least} %" if least == most else f"{least} to {most} %"


def not_identified(
    names: Sequence[str],
    least: str,
    identified: Sequence[str] = (),
    most: str = "",
    *,
    poorly: bool = False,
) -> str:
    """Return the sentence on parameters that are not identified (or only poorly), and products."""
    grade = "Poorly identified" if poorly else "Not identified"
    sentence = f"{grade}: {listed(names)} (CV at least {least} %)"
    if identified:
        sentence += f"; identified: {listed(identified)} (CV at most {most} %)"
    return f"{sentence}."


def truncated(reason: str) -> str:
    """Return the sentence on the first parameter that a prior bound truncates."""
    return f"Uncertain: {reason}"


def all_identified(worst: str, cv: str, *, roughly: bool) -> str:
    """Return the sentence that all parameters are identified, with the least certain one."""
    grade = "identified, some roughly" if roughly else "identified"
    return f"All parameters {grade}; least certain: {worst} (CV {cv} %)."


def next_step(remedy: str) -> str:
    """Return the sentence on what to do next: the remedy of the first finding."""
    return f"To do next: {remedy}" if remedy else NOTHING_TO_DO


def by_the_fit(identified: Sequence[str]) -> str:
    """Return the terminal's line on the parameters that the fit identifies, before sampling."""
    return (
        "Identified from the fit alone (the posterior is not assessed): "
        f"{'; '.join(identified) or 'nothing'}"
    )


def headline(identified: Sequence[str], *, quick: bool) -> str:
    """Return the line of the terminal that lists the identified parameters."""
    by = " from the fit alone" if quick else ""
    return f"Identified{by}, mean [99 % interval]: {'; '.join(identified) or 'nothing'}"


def _tests(count: int, which: str, noun: str = "test") -> str:
    return f"the {which} {noun}" if count == 1 else f"the {count} {which} {noun}s"
