"""Messages of a study other than findings: FRF fit, modes outside the band, exports, fleets."""

import shlex
from collections.abc import Sequence

from jbw.report.messages.message import capital, number, percent

STEP_2_DRAWS = "The draws of Step 2 come from a Gaussian approximation around its fit."
NO_COMPILER = (
    "There is no C compiler here (cc, gcc or clang), so the FMU contains only source code: compile "
    "it where it is used, or install a compiler and export again."
)
SLOW_LOOPS = "Steady loops under slow motion: the force of spring and joint, without dampers."
BACKBONES = "Resonance frequency, equivalent damping and force against amplitude."
BACKBONE_OF_FIRST_MODE = (
    "Resonance frequency and equivalent damping of the first mode against its motion at the first "
    "point."
)
LOOPS_OF_JOINTS = (
    "Steady loops of every joint under slow motion: the force of its spring and laws [N, or N m] "
    "against its motion [m, or rad]."
)
FMU = "Force of a joint, computed by exact time steps"
FMU_FORCE = "force of the joint's laws"
FMU_TOTAL = "force of the joint's laws with spring and dashpot in parallel"
NO_VERDICT = "the run has no verdict"
HIGHEST_DENSITY = "the most probable draw"
LAW_FACTOR = "factor of the laws' forces"
AS_ASKED = "as requested"


def step_2(y_rms: float, repeats: int) -> str:
    """Return the sentence on the rms displacement [m] in the FRF fit (Step 2)."""
    counted = (
        "There is no CV (coefficient of variation), because there is only one record"
        if repeats < 2
        else f"CVs are the coefficients of variation between {repeats} repeats"
    )
    return (
        f"Fitted at an rms displacement of {number(1000000.0 * y_rms, '.2g')} um: omega_n is "
        "the natural frequency at this amplitude, where softening of the joint lowers omega_n. "
        f"{counted}."
    )


def neighbours(modes: Sequence[tuple[float, float]], residual: float) -> str:
    """Return the sentence on modes that the FRF fit includes, with frequencies [Hz] and damping."""
    shown = ", ".join(f"{hertz:.4g} Hz ({percent(ratio, '.2f')})" for hertz, ratio in modes)
    return (
        f"Several modes in the band were fitted together, the joint's mode first: {shown}; "
        f"residual of the spectral lines: {percent(residual)}. The joint is fitted only to the "
        "first mode."
    )


def rigid_body(constant: str, unit: str) -> str:
    """Return the sentence that modes below the band dominate the response outside it."""
    return (
        f"The modes outside the band contribute a real constant to the response, {constant} "
        f"{unit}, which comes from the rigid body and the modes below the band."
    )


def compliance(constant: str, unit: str) -> str:
    """Return the sentence that modes above the band dominate the response outside it."""
    return (
        f"The modes outside the band contribute a real constant to the response, {constant} "
        f"{unit}, which is the compliance of the modes above the band."
    )


def no_shaker(test: str, why: str) -> str:
    """Return the sentence that a record does not determine its shaker, with the reason."""
    return f"The shaker of test `{test}` is not identified. {why}"


def identify_anew(folder: str) -> str:
    """Return the remedy for a folder that contains another result."""
    return f"To identify again, move {folder} away or choose another `out`."


def identify_alone(campaign: str, folder: str, *, quick: bool) -> str:
    """Return the remedy for a campaign that must not run with others: a run of its own."""
    option = " --quick" if quick else ""
    words = shlex.join([campaign, "--out", f"{folder}-alone"])
    return f"Identify this campaign alone: jbw identify {words}{option}"


def outcomes_not_written(file: str, why: str) -> str:
    """Return the warning that the list of outcomes cannot be written, which loses no run."""
    return (
        f"{file} cannot be written: {why}. All runs continue; `jbw status` will not know of those "
        "that end from now on."
    )


def verdict_of(campaign: str, status: str, why: str) -> str:
    """Return the line of an exported file with the verdict of a run."""
    return f"Verdict of the run {campaign}: {status}: {why}"


def exported_draw(number: int, count: int, why: str, mass: float) -> str:
    """Return the line with the number of the exported draw, its reason and the modal mass [kg]."""
    return (
        f"Joint: draw number {number} of {count} (counted from 0), {why}; modal mass {mass:g} kg."
    )


def one_draw(number: int, mass: float) -> str:
    """Return the line on one of several exported draws, with the modal mass [kg]."""
    return f"Joint: draw number {number} (counted from 0); modal mass {mass:g} kg."


def exported_joints(number: int, count: int, why: str, system: str) -> str:
    """Return the comment on which draw of the joints is exported, and its system of units."""
    return f"Joints: draw number {number} of {count} (counted from 0), {why}; units {system}."


def one_of_joints_draws(number: int, system: str) -> str:
    """Return the comment on one of several exported draws of the joints, with units."""
    return f"Joints: draw number {number} (counted from 0); units {system}."


def mode_beside_matrices(mode: int, hz: float, model_hz: float, damping: float) -> str:
    """Return the comment on a mode's identified frequency and damping, and the model's [Hz]."""
    return (
        f"Mode {mode} with fully stuck joints: {hz:.5g} Hz (the matrices predict {model_hz:.5g} "
        f"Hz), damping ratio {percent(damping, '.3g')}."
    )


def motion_beside_matrices(what: str, factor: float) -> str:
    """Return the comment on a joint's motion factor, which the exported matrices lack."""
    return (
        f"{capital(what)} is {factor:.4g}. A model with these matrices does not include this "
        "factor."
    )


def joint_place(
    name: str,
    motion: tuple[str, str],
    stiffness: tuple[float, str],
    *,
    is_held: bool,
    has_law: bool,
) -> str:
    """Return the comment on where a joint acts, and its stiffness in the model, with units."""
    place = f"Joint {name} moves by x = {motion[0]} [{motion[1]}]"
    spring = f"the stiffness of the fully stuck joint is {stiffness[0]:.6g} {stiffness[1]}"
    if not has_law:
        held = (
            f"The model contains the stiffness of joint {name} as a spring."
            if is_held
            else f"The model does not contain the stiffness of joint {name}: add a spring."
        )
        return f"{place}. Joint {name} has no law and is not in these files; {spring}. {held}"
    if is_held:
        return (
            f"{place}; {spring}. The model contains the stiffness of joint {name} as a spring, "
            "which the exported joint replaces."
        )
    return f"{place}; {spring}. The model has no spring at joint {name} that must be removed."


def joint_in_si(name: str, motion_unit: str, force_unit: str) -> str:
    """Return the note that a joint's file is in SI, whatever the units of the matrices are."""
    return f"This is {name} in SI: its motion in {motion_unit}, its force in {force_unit}."


def joint_dashpot(name: str, hz: float, motion: float, unit: str) -> str:
    """Return the comment on where a dashpot dissipates as much energy as a joint."""
    return (
        f"Dashpot of {name}: at {hz:.4g} Hz it dissipates as much as the joint does at "
        f"{motion:.4g} {unit}, the joint's largest measured motion, in the mode that moved the "
        "joint most."
    )


def within_interval(
    name: str, value: float, unit: str, low: float, high: float, *, inside: bool
) -> str:
    """Return the comment on whether a product of parameters lies in the interval of all draws."""
    place = "within" if inside else "outside"
    return f"{name} is {value:.6g} {unit}, {place} its 99 % interval {low:.6g} to {high:.6g}."


def within_bands(*, inside: bool) -> str:
    """Return the comment on whether the exported backbone lies in the bands of all draws."""
    place = "within" if inside else "partly outside"
    return f"The backbone of the exported joint lies {place} the 99 % bands of all draws."


def sliders(
    law: str, reach: float, least: float, most: float, error: float, unit: str = "m"
) -> str:
    """Return the comment on the range and accuracy with which sliders represent a law."""
    return (
        f"The joint {law} is represented by sliders up to a displacement of {reach:.4g} {unit}, "
        f"and by a spring beyond it. From {least:.4g} to {most:.4g} {unit} the error of the "
        f"energy loss per cycle is at most {error:.2g} %."
    )


def without_form(program: str) -> str:
    """Return the note that no file is written for a program that does not support a law."""
    return f"No file is written for {program}, which cannot represent this joint."


def no_logarithm(name: str, units: Sequence[str]) -> str:
    """Return the message on a parameter that a fleet cannot pool."""
    return f"{name} is left out of the fleet: it is unknown or not positive in {', '.join(units)}."


def unfinished(folder: str) -> str:
    """Return the message on an unfinished run that a fleet omits."""
    return (
        f"{folder} is left out of the fleet, because the run is not finished. Continue the run: "
        f"jbw resume {folder}"
    )


def further_units(torque: float | None, *, of_units: bool) -> str:
    """Return the message on the units that a prediction concerns, and the gain used."""
    at = "" if torque is None else f" at {torque:.3g} N m"
    gain = "the gains of the fleet's units" if of_units else "the gain stated in the campaign"
    return f"New units{at}, with {gain}"


# long names of variables of results
RMS_OF_RESPONSE = "rms of the response, divided by the rms of the mean of the test's repeats"
LIKELIHOOD_OF_RECORD = (
    "log likelihood of a record given its noise, minus its log likelihood under the mean and the "
    "standard deviation of the test's repeats [nats]"
)
RUNNING_ENERGY = "running mean of the response's energy, conv(n)"
EXTRAPOLATION = "largest displacement / largest fitted displacement"
ERROR_OF_LINEAR = (
    "RMS error of a linear oscillator fitted to the session, divided by the rms of the session"
)
FIT_ALONE = (
    "1 if the law is judged by its fit alone, so that its band is only that of the fit; otherwise 0"
)
WEIGHT_OF_DOF = "factor by which a degree of freedom enters the joint's motion"


def rank_below(name: str) -> str:
    """Return the long name of a calibration's ranks: the number of draws below the true value."""
    return f"number of posterior draws below the true {name}"


def truth_inside(name: str) -> str:
    """Return the long name of the flag that an interval contains the true value."""
    return f"whether the 99 % interval contains the true {name}"
