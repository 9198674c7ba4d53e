"""Messages on a posterior: its sampling, the fit before it, and the topics of its checks."""

from collections.abc import Sequence

WITHOUT_JOINT = "The posterior describes the structure without this joint."
TOO_CURVED = (
    "The posterior is too far from its Gaussian approximation for elliptical slice sampling. Use "
    'sampler = "nuts" in [identify], which follows the gradient of the model, but needs about a '
    "hundred times as many evaluations per draw."
)

# topics of checks and statements; a sentence on a missing check or statement names its topic
EACH_FROM_OTHERS = "each test predicted from the others"
RESIDUAL = "the residual of the fit"
SHAPE = "the shape of the residual"
REPEATS = "the variation between repeats"
RESPONSE_BANDS = "the response bands"
DISCREPANCY = "the model discrepancy"
HYSTERESIS = "hysteresis compared with drag"
SOLVER_STEPS = "the steps of the solver"
CAUSES = "the causes of the residual"
OFFSETS = "The offsets of the runs"
JOINT_SHARES = "The effect of each joint on the modes"
PARTICIPATION = "the participation of each mode in the motion"
JOINT_OF_MODES = "the comparison of a common joint with a separate joint for each mode"
ONE_JOINT = "a joint shared by all modes"
JOINT_DIFFERENCE = "the difference between the joints of uncoupled modes"
JOINT_EFFECT = "The effect of the joint on the modes"
THRESHOLDS = "The statement on the thresholds of the laws, such as macroslip"
WITHOUT_EACH_TEST = "the fits that each omit one test"
WITHOUT_EACH_KIND = "the fits that each omit one kind of test"
EACH_RECORD = "the fit to each record alone"
JOINT_SEEN = "the detection of a joint"

LOG_DENSITY = "log density of the Gaussian approximation, minus that at its optimum"
LOG_LIKELIHOOD = "log likelihood"


def check_of(topic: str) -> str:
    """Return the subject of a sentence that explains why the check of a topic is missing."""
    return f"The check of {topic}"


def statement_on(topic: str) -> str:
    """Return the subject of a sentence that explains why a statement on a topic is missing."""
    return f"The statement on {topic}"


def sampler(name: str, evaluations: int, coordinates: str) -> str:
    """Return the sentence on the posterior's sampler, its evaluations and its parametrisation."""
    return (
        f"Sampler: {name}, {evaluations} evaluations, parametrisation: {coordinates}, the best of "
        "those that were tried."
    )


def evidence(log_evidence: float, error: float) -> str:
    """Return the sentence on the log evidence with its error [nats]."""
    return f"The log evidence is {log_evidence:.2f} ± {error:.2g}."


def in_group_unit(name: str) -> str:
    """Return the long name of a quantity whose unit differs between groups."""
    return f"{name}, in the unit of its group"


def at_bound(name: str, side: str) -> str:
    """Return the sentence that the fit lies at a bound of the prior."""
    return f"The best fit of {name} lies at the {side} bound of its prior."


def intervals_of_fit(effective: float | None) -> str:
    """Return the clause on how a quick result's intervals were computed.

    Args:
        effective: Effective number of weighted points; None if the intervals are Gaussian.
    """
    if effective is None:
        return "the intervals are those of a Gaussian approximation at the optimum of the fit"
    return (
        "the intervals come from points around the fit that are weighted by the likelihood (as "
        f"good as {effective:.0f} independent draws), because the posterior is not Gaussian"
    )


def by_fit(combinations: str) -> str:
    """Return the sentence on which combinations the fit determines."""
    return f"The fit shows that {combinations}."


def by_initial_fit(combinations: str) -> str:
    """Return the sentence on which combinations the initial fit determines."""
    return f"The initial fit shows that {combinations}."


def products_sampled(most: Sequence[str], last: str, names: Sequence[str], meanings: str) -> str:
    """Return the sentence that products of parameters are sampled instead of the parameters."""
    verb = "is" if len(names) == 1 else "are"
    return (
        f"The data determine only products of {', '.join(most)} and {last}; therefore "
        f"{', '.join(names)} {verb} sampled instead ({meanings})."
    )


def test_left_out(name: str, why: str) -> str:
    """Return the message that a test cannot be used, with the reason."""
    return f"Test {name} is left out: {why}"


def widened_fit(bounds: Sequence[str]) -> str:
    """Return the sentence that a fit reached prior bounds, which were moved for a new fit."""
    return (
        "The fit reached default prior bounds and was repeated in wider bounds: "
        f"{', '.join(bounds)}."
    )


def widened(bounds: Sequence[str]) -> str:
    """Return the sentence on bounds that were moved before the posterior was sampled again."""
    return (
        "Default prior bounds truncated the posterior, which was sampled again in wider bounds: "
        f"{', '.join(bounds)}."
    )
