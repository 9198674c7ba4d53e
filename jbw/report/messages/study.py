"""The messages of a study other than findings: Step 2, modes outside the band, exports, fleets."""

from collections.abc import Sequence

from jbw.report.messages.message import capital, percent

STEP_2_DRAWS = "Step 2 draws from the Gaussian of its fit."
NO_COMPILER = (
    "There is no C compiler here (cc, gcc or clang), so the FMU holds source code alone: compile "
    "it where it is used, or install a compiler and export again."
)
SLOW_LOOPS = "Steady loops under slow motion: the force of spring and joint, without any damper."
BACKBONES = "Resonance frequency, equivalent damping and force against amplitude."
BACKBONE_OF_FIRST_MODE = (
    "Resonance frequency and equivalent damping of the first mode against its motion at the first "
    "point."
)
LOOPS_OF_JOINTS = (
    "Steady loops of every joint under slow motion: the force of its spring and laws [N, or N m] "
    "against its motion [m, or rad]."
)
FMU = "Force of a joint after exact moves"
FMU_FORCE = "force of the joint's laws"
FMU_TOTAL = "the same with spring and dashpot in parallel"
NO_VERDICT = "the run states no verdict"
HIGHEST_DENSITY = "of the highest posterior density"
LAW_FACTOR = "factor of the laws' forces"
AS_ASKED = "as asked for"


def step_2(y_rms: float, repeats: int) -> str:
    """Return the message on the rms displacement [m] at which Step 2 reads the oscillator."""
    counted = "one record has no CV" if repeats < 2 else f"CV is over {repeats} repeats"
    return (
        f"Read at an rms displacement of {y_rms:.2g} m: omega_n is that of the oscillator at this "
        f"amplitude, which softening of the joint lowers; {counted}."
    )


def neighbours(modes: Sequence[tuple[float, float]], residual: float) -> str:
    """Return the message on modes that Step 2 fits together, with frequencies [Hz] and damping."""
    shown = ", ".join(f"{hertz:.4g} Hz ({percent(ratio, '.2f')})" for hertz, ratio in modes)
    return (
        f"Fitted with the neighbouring modes in the band, the joint's mode first: {shown}; "
        f"residual of the lines: {percent(residual)}. The joint is fitted to the first mode alone."
    )


def rigid_body(constant: str, unit: str) -> str:
    """Return the message that modes below the band dominate outside it."""
    return (
        f"The modes outside the band act as one real constant of {constant} {unit}: the rigid body "
        "and the modes below."
    )


def compliance(constant: str, unit: str) -> str:
    """Return the message that modes above the band dominate outside it."""
    return (
        f"The modes outside the band act as one real constant of {constant} {unit}: the compliance "
        "of the modes above."
    )


def no_shaker(test: str, why: str) -> str:
    """Return the message that a record does not show its shaker."""
    return f"{test}: its shaker is not identified. {why}"


def identify_anew(folder: str) -> str:
    """Return the message on what to do where a folder holds another result."""
    return f"Move {folder} away to identify anew, or choose another `out`."


def verdict_of(campaign: str, status: str, why: str) -> str:
    """Return the message on the verdict of a run in a line of an exported file."""
    return f"Verdict of the run {campaign}: {status}: {why}"


def exported_draw(number: int, count: int, why: str, mass: float) -> str:
    """Return the message on which draw an export holds, with the modal mass [kg]."""
    return f"Joint: draw {number} of {count}, from 0 on, {why}; modal mass {mass:g} kg."


def one_draw(number: int, mass: float) -> str:
    """Return the message on the same of one of several exported draws."""
    return f"Joint: draw {number}, from 0 on; modal mass {mass:g} kg."


def exported_joints(number: int, count: int, why: str, system: str) -> str:
    """Return the comment on which draw of the joints is exported, and its system of units."""
    return f"Joints: draw {number} of {count}, from 0 on, {why}; units {system}."


def one_of_joints_draws(number: int, system: str) -> str:
    """Return the message on the same of one of several exported draws."""
    return f"Joints: draw {number}, from 0 on; units {system}."


def mode_beside_matrices(mode: int, hz: float, model_hz: float, damping: float) -> str:
    """Return the comment on a mode's identified frequency and damping, and the model's [Hz]."""
    return (
        f"Mode {mode} in full stick: {hz:.5g} Hz, where the matrices have {model_hz:.5g} Hz, and a "
        f"damping ratio of {percent(damping, '.3g')}."
    )


def motion_beside_matrices(what: str, factor: float) -> str:
    """Return the comment on a factor of joint motion that a model with these matrices lacks."""
    return f"{capital(what)} is {factor:.4g}; a model with these matrices lacks this factor."


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
    spring = f"{stiffness[0]:.6g} {stiffness[1]} in full stick"
    if not has_law:
        held = "which the model holds" if is_held else "which the model lacks: add it as a spring"
        return f"{place}. It has no law and is not in these files: {spring}, {held}."
    if is_held:
        return f"{place}, {spring}; the model holds that as a spring, which this replaces."
    return f"{place}, {spring}; the model has no spring there."


def joint_in_si(name: str, motion_unit: str, force_unit: str) -> str:
    """Return the message that a file of one joint is in SI, whatever the units of the matrices."""
    return f"This is {name} in SI: its motion in {motion_unit}, its force in {force_unit}."


def joint_dashpot(name: str, hz: float, motion: float, unit: str) -> str:
    """Return the comment on the frequency and motion at which a dashpot loses as a joint does."""
    return (
        f"Dashpot of {name}: at {hz:.4g} Hz it loses as the joint does at {motion:.4g} {unit}, the "
        "largest motion measured, in the mode that moved it most."
    )


def within_interval(
    name: str, value: float, unit: str, low: float, high: float, *, inside: bool
) -> str:
    """Return the message on where a product of the exported draw lies among all draws."""
    place = "within" if inside else "outside"
    return f"{name} is {value:.6g} {unit}, {place} its 99 % interval {low:.6g} to {high:.6g}."


def within_bands(*, inside: bool) -> str:
    """Return the message on whether the exported backbone lies in the bands of all draws."""
    return f"Its backbone {'lies within' if inside else 'leaves'} the 99 % bands of all draws."


def sliders(
    law: str, reach: float, least: float, most: float, error: float, unit: str = "m"
) -> str:
    """Return the message on how far and how well sliders represent a law."""
    return (
        f"Sliders represent {law} up to {reach:.4g} {unit}, a spring beyond; from {least:.4g} to "
        f"{most:.4g} {unit} the loss per cycle is right to {error:.2g} %."
    )


def without_form(program: str) -> str:
    """Return the message on a program for which no file is written."""
    return f"{program} has no form of the joint, so it gets no file."


def no_logarithm(name: str, units: Sequence[str]) -> str:
    """Return the message on a parameter that a fleet cannot pool."""
    return f"Without {name}: unknown or not positive in {', '.join(units)}."


def unfinished(folder: str) -> str:
    """Return the message on a run that a fleet omits."""
    return f"{folder} is not finished and is omitted; continue it: jbw resume {folder}"


def further_units(torque: float | None, *, of_units: bool) -> str:
    """Return the message on which units a prediction is for, and whose gain they have."""
    at = "" if torque is None else f" at {torque:.3g} N m"
    gain = "the gains of the measured units" if of_units else "the campaign's gain for its tests"
    return f"Further units{at}, with {gain}"


VARIABLES = {
    "response": "root mean square of the response, over that of the mean of its test's repeats",
    "log_likelihood": (
        "log likelihood of a record given its noise, over that about the mean of its test's "
        "repeats at their scatter [nats]"
    ),
    "conv": "running mean of the response's energy, conv(n)",
    "extrapolation": "largest displacement over that fitted",
    "line": "error over rms of a linear oscillator of the session",
    "hopeless": "judged by its fit, the band is that of the fit",
    "weight": "factor of a degree of freedom in the joint's motion",
}
"""Long names of variables of results."""


def rank_below(name: str) -> str:
    """Return the long name of a calibration's ranks: the draws below the true value."""
    return f"draws below the true {name}"


def truth_inside(name: str) -> str:
    """Return the long name of the flag that an interval contains the true value."""
    return f"true {name} inside the 99 % interval"
