"""Messages on a plan: its basis, the recommended tests, and what these leave undetermined."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import percent

WRITE_PLAN = "To write an example of a plan: jbw plan --example > plan.toml"
NOISE_ALONE = (
    "The plan includes only measurement noise; variation between sessions and model discrepancy "
    "make the parameters less certain. A CV above 30 % is only an order of magnitude."
)
PER_KILOGRAM = (
    "The run has no gain, so the inputs of the planned tests are in N/kg; for V or N, give "
    "gain or modal_mass in a file of --limits."
)
FLEET_NOISE = "The errors of single records are neglected, because assemblies vary by far more."
NO_TEST_NEEDED = "No test is needed: the required CV is already reached."
NO_TEST_ADMITTED = "No test is within the limits; raise max_displacement or max_input."
TIMING = "Timing the first candidate of each form"
THIRD_HARMONIC = "the third harmonic of the tones"
LAST_FREQUENCY = "the sweep's last frequency"
NATURAL_FREQUENCY = "the natural frequency"


def drawn_from_ranges(num_joints: int) -> str:
    """Return the sentence that a plan is based on stated ranges of parameters."""
    return f"Plan for {num_joints} joints drawn from the stated ranges, which are the prior."


def drawn_from_run(num_joints: int) -> str:
    """Return the sentence that a plan is based on the posterior of a run."""
    return f"Plan for {num_joints} draws of the run's posterior, which is the prior of new tests."


def unknown_reach(displacement: float) -> str:
    """Return the warning that levels are planned for a displacement that jbw chose [m]."""
    return (
        "The run states no largest displacement, so the planned levels aim at "
        f"{displacement:.3g} m, where the joint slips; give max_displacement in a file of "
        "--limits."
    )


def cost(num_candidates: int, num_joints: int, seconds: float) -> str:
    """Return the sentence on how long the evaluation of all candidate tests takes."""
    duration = f"{seconds:.2g} s" if seconds < 120.0 else f"{seconds / 60.0:.2g} minutes"
    return (
        f"{num_candidates} candidate tests for {num_joints} joints take about {duration} after "
        "compilation; to save time, state fewer candidates or a smaller `joints` in [plan]"
    )


def too_far(displacement: float, limit: float) -> str:
    """Return the reason why a test is infeasible: its peak displacement is too large [m]."""
    return f"the peak displacement {displacement:.3g} m exceeds {limit:g} m"


def too_strong(limit: float, unit: str) -> str:
    """Return the reason why a test is infeasible: its input exceeds the limit."""
    return f"input exceeds {limit:g} {unit}"


def no_response(count: int, num_joints: int) -> str:
    """Return the reason why the response to a candidate test cannot be predicted."""
    return f"the response does not become steady for {count} of {num_joints} joints"


def with_median(worst: float, median: float) -> str:
    """Return a coefficient of variation that nine in ten joints do not exceed, and the median."""
    return f"{worst:.2g}" if worst == median else f"{worst:.2g} (median {median:.2g})"


def before(cvs: Mapping[str, str]) -> str:
    """Return the sentence on the coefficients of variation without any of the planned tests."""
    return f"CV before these tests (90 % of the joints lie below): {_pairs(cvs)}."


def title(cv: float, parameters: Sequence[str], num_joints: int) -> str:
    """Return the title of the table of candidate tests."""
    return (
        f"Tests that reach a CV of {cv:.2g} for {', '.join(parameters)} with 90 % of "
        f"{num_joints} joints"
    )


def most_per_second(test: str, level: float, unit: str) -> str:
    """Return the sentence on the test with the largest information gain per second."""
    return f"Largest information gain per second: {test}, {level:g} {unit}."


def recommended(tests: Sequence[str], cvs: Mapping[str, str], duration: str) -> list[str]:
    """Return the lines on the recommended tests, then the coefficients of variation."""
    heading = "Recommended tests, in order of expected information gain per second:"
    return [heading, *tests, f"  CV {_pairs(cvs)} after {duration} of measuring."]


def not_reached(
    tests: Sequence[str], cvs: Mapping[str, str], duration: str, most: int
) -> list[str]:
    """Return the sentence on the best tests if no combination reaches the required accuracy."""
    heading = (
        f"No combination of at most {most} repeats reaches the required CV. The best "
        "combination found:"
    )
    return [heading, *tests, f"  CV {_pairs(cvs)} after {duration} of measuring."]


def together(note: str) -> str:
    """Return the line on the quantities that all recommended tests together do not determine."""
    return f"  With all these tests together, {note}."


def fleet_designs(few: tuple[int, int], many: int, gain: float) -> str:
    """Return the sentence that compares designs: several assemblies per torque, or one each."""
    assemblies, torques = few
    return (
        f"{assemblies * torques} tightenings ({assemblies} assemblies at each of {torques} "
        f"torques) determine the slope with torque {gain:.2g} times more precisely than {many} "
        f"tightenings at {many} torques."
    )


def fleet_title(scatter: float) -> str:
    """Return the title of the table of designs for a fleet of assemblies."""
    return (
        "99 % intervals of a fleet in which assemblies vary by a standard deviation of "
        f"{percent(scatter, 'g')}"
    )


def told_by_run(key: str) -> str:
    """Return the message that a key must be removed, because the run already states its value."""
    return f"{key}: remove this key, because the run states its value."


def single_value(key: str, value: Sequence[float]) -> str:
    """Return the message on a key that must be a single value if a run is given."""
    return f" {key}: must be a single value when a run is given, but is {list(value)}."


def missing(key: str, meaning: str) -> str:
    """Return the message that a required key is missing."""
    return f" {key}: missing; {meaning}."


def beyond_stiffness(key: str, least: float, value: float) -> str:
    """Return the message on a joint stiffness that exceeds the whole stiffness."""
    return (
        f"{key}: must stay below omega_n^2, which may be as low as {least:g}, but reaches "
        f"{value:g}."
    )


def share_of(name: str) -> str:
    """Return the meaning of a key that states a stiffness as a fraction of omega_n^2."""
    return f"{name} / omega_n^2, instead of {name}"


def _pairs(cvs: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {cv}" for name, cv in cvs.items())
