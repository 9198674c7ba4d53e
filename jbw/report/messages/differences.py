"""Messages on the difference between two runs: which parameters differ, and limits."""

from collections.abc import Mapping, Sequence

from jbw.report.messages.message import listed, percent

NONE_DIFFERS = "No parameter differs significantly (P(A > B) is between 0.005 and 0.995)."
INDEPENDENT = (
    "P(A > B) takes the posteriors as independent: it does not include errors that both runs "
    "share, such as those of a sensor or a mass."
)
ONE_ASSEMBLY = (
    "Neither campaign has several assemblies: the variation between tightenings is unknown, and "
    "may alone cause a significant difference. Measure several assemblies in each campaign."
)
SHARES = {True: "the modes have two joints", False: "the modes may share one joint"}


def differs(name: str, difference: str, *, sure: bool) -> str:
    """Return the sentence that a quantity differs between two runs, with the interval."""
    verb = "differs" if sure else "may be the same"
    return f"{name} {verb}: A - B is {difference}."


def may_be_same(names: Sequence[str]) -> str:
    """Return the sentence on parameters that may be equal in both runs."""
    return f"Parameters that may be the same: {', '.join(names)}."


def joint_changed(joint: str, chi_square: float, degrees: int) -> str:
    """Return the sentence that a joint has changed, with chi-square of all its parameters."""
    return (
        f"{joint} has changed: chi-square of the differences of all its parameters is "
        f"{chi_square:.3g} with {degrees} degrees of freedom."
    )


def joints_may_be_same(joints: Mapping[str, float]) -> str:
    """Return the sentence on joints whose parameters differ by no more than chance, with p."""
    shown = ", ".join(f"{joint} (p = {p:.2g})" for joint, p in joints.items())
    return f"Joints that may be the same: {shown}."


def factors_apart(names: Sequence[str]) -> str:
    """Return the sentence on how two runs are compared if the joints' motion was uncertain."""
    return (
        "All parameters of a joint's law are compared at once; the factors on the motion of joints "
        f"({listed(names)}) are compared one by one between the runs."
    )


def homes_differ(joints: str, first: str, second: str) -> str:
    """Return the sentence that a joint's parameters refer to different motions in two runs."""
    return (
        f"The parameters of {joints} refer to the model's motion of {first} in run A and of "
        f"{second} in run B. If the model's shapes are wrong, the parameters differ for this "
        "reason alone."
    )


def of_prior(names: Mapping[str, Sequence[str]]) -> str:
    """Return the sentence on parameters that the data of the named runs do not determine."""
    shown = ", ".join(f"{name} ({' and '.join(runs)})" for name, runs in names.items())
    return (
        "Parameters that are not compared, because the data of the runs in brackets do not "
        f"identify them: {shown}."
    )


def only_one(names: Sequence[str]) -> str:
    """Return the sentence on parameters that only one of two runs has."""
    return f"Only one of the two runs has the parameters {listed(names)}."


def not_usable(run: str, verdict: str) -> str:
    """Return the sentence that a run's numbers must not be used, because of its verdict."""
    if verdict == "not assessed":
        return (
            f"Run {run} is a first answer, which is not assessed: to sample the posterior, jbw "
            "resume DIR, where DIR is the folder of this run."
        )
    return f"The verdict of run {run} is {verdict}: read its report before you use its numbers."


def inadequate(runs: Sequence[str]) -> str:
    """Return the sentence that a difference may come from model discrepancy, not from the joint."""
    return (
        f"In {listed(runs)} the residual of the law exceeds the noise. The parameters then depend "
        "on which records were fitted and on their amplitudes, which no interval includes: the "
        "difference may come from the records alone. Identify both runs over the same range of "
        "motion, or with another law: jbw laws."
    )


def records_scatter(spreads: Mapping[str, Mapping[str, float]]) -> str:
    """Return the sentence on how the variation between records affects the means of each run."""
    shown = "; ".join(
        f"{run} {', '.join(f'{name} {percent(sd)}' for name, sd in row.items())}"
        for run, row in spreads.items()
    )
    return (
        "Single records of a run need different parameters. The intervals and P(A > B) include "
        f"the standard deviation of the mean over the records: {shown}."
    )


def sessions_scatter(spreads: Mapping[str, tuple[str, str]]) -> str:
    """Return the sentence on how natural frequency and damping vary between a run's sessions."""
    shown = "; ".join(
        f"{omega} for omega_n and {zeta} for zeta in run {run}"
        for run, (omega, zeta) in spreads.items()
    )
    return (
        f"The sessions of a campaign vary (standard deviations: {shown}). The intervals are those "
        "of the means over sessions; another assembly may differ from the mean by as much."
    )


def one_joint(ratio: str, a: str, b: str, *, sure: bool) -> str:
    """Return the sentence on whether two modes may share one joint."""
    return (
        f"If both modes share one joint, {ratio} is the same in both. A: {a}, B: {b}; "
        f"{SHARES[sure]}."
    )


def without_backbone(run: str) -> str:
    """Return the message that a run lacks frequency and damping against amplitude."""
    return (
        f"Run {run} lacks the parameters or the displacement that are needed to compute frequency "
        "and damping."
    )


def with_torque(quantity: str, amplitude: str, change: str, word: str, *, steady: bool) -> str:
    """Return the sentence on a quantity's trend with torque; an empty `word` means no trend.

    `steady` states that the interval of the change per doubling does not contain zero.
    """
    if not word:
        return f"At {amplitude} the {quantity} shows no trend with torque: {change} per doubling."
    if steady:
        return f"At {amplitude} the {quantity} {word} with torque: {change} per doubling."
    return (
        f"At {amplitude} the {quantity} {word} from each torque to the next, by unequal amounts: "
        f"the line through all torques changes by {change} per doubling."
    )


SCATTER = (
    "The runs deviate from a straight line in the logarithm of the torque by more than their "
    "posteriors explain; the intervals of the trend include this variation. Each tightening "
    "differs, or the trend is not a straight line."
)
LEAVE_IT_OUT = "Leave this run out, or compare the parameters of two runs: jbw diff A B"
NO_TORQUES = (
    "A trend with torque cannot be computed: the campaigns do not state different torques. State "
    "`torque` in [assembly] of each campaign."
)
INDEPENDENT_RUNS = (
    "The intervals take the posteriors as independent: they do not include errors that all runs "
    "share, such as those of a sensor or a mass, nor the variation between tightenings."
)
SIDE_BY_SIDE = "Frequency and damping of {} runs, median and 99 % interval"
TABLE = "Parameters, median and 99 % interval"
BACKBONE_TABLE = "Frequency and damping against amplitude, median and 99 % interval"
