"""Warnings about the parameters of a joint and their prior."""

from collections.abc import Mapping, Sequence
from typing import Any

from jbw.report.messages.message import number

BOUNDED = "alpha > 0 and delta + gamma >= 0 must hold"
SAME_CURVES = "every motion depends only on the sum of the virgin curves of all sliders"
SAME_EXPONENT = "with an exponent of 1 the two laws are the same"
EVEN_SQUARE = "`square` is a spring whose force is even in the displacement"

# quantities that stay undetermined if no record exceeds a threshold of a law
BEHIND_GAP = "the parameters that act once the gap closes"
STUCK_SLIDER = "its stiffness (the data determine only its sum with other stuck sliders)"


def stiffer_than_structure(held: str, stiffness: Any, limit: Any) -> str:
    """Return the message that the joint's stiffness exceeds the limit named by `held` [1/s^2]."""
    return (
        f"The joint is stiffer than the structure: its stiffness must not exceed {held}, but "
        f"{number(stiffness, '.4g')} > {number(limit, '.4g')} 1/s^2. Once the joint slips, no "
        "stiffness remains that holds the structure, and the motion grows without limit. Lower "
        "the stiffness of the laws, or raise omega_n, which includes the stiffness of the "
        "fully stuck joint."
    )


def no_bounds(names: Sequence[str]) -> str:
    """Return the message that the prior of a law omits some of its parameters."""
    return f"`prior` must bound every parameter of `table`, but has no {', '.join(names)}."


# required properties of the methods of an externally defined law, as text for `law_disagrees`
A_SCALAR = "a scalar, which is an array without axes"
FINITE = "finite"
SMOOTH_AT_REST = "differentiable at rest, with finite slopes"
PROPORTIONAL = "proportional to the velocity"
INTEGRAL_OF_RATE = "the integral of `rate`, which is compared by the force after a motion [N/kg]"
SLOPE_AT_REST = "the slope of `force` at rest"
DIFFERENCE_OF_RECORDS = "differentiable, with the derivative that finite differences give"
ODD = "odd in the motion, unless `check_periodic` refuses the law"
ALONG_MOTION = "the harmonics of `force` along a steady motion"
OTHER_UNITS = "the same law in other units, with the same harmonics"
FIRST_HARMONIC = "the first harmonic of `force`, divided by the amplitude"
HOLDS_MOTION = "the force that sustains the motion at resonance"
OF_PERIODIC_RECORD = "the first harmonic of the periodic record from `simulate`"
VALUES_OF_BUILD = "the values that `build` was given"


def law_disagrees(method: str, found: Any, what: str, right: Any) -> str:
    """Return the message that a method of a law disagrees with another way to compute it."""
    return (
        f"`{method}` must be {what}: the expected value is {_number(right)}, but the found value "
        f"is {_number(found)}."
    )


def law_fails(method: str, reason: str) -> str:
    """Return the message that testing a law raised an error in a method."""
    return f"the law cannot be tested further after `{method}`: {reason}"


def _number(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, complex | float) else f"{value}"


def unloads_beyond(z: float) -> str:
    """Return the clause on the |z| at which unloading starts, above alpha / (delta - gamma)."""
    return f"unloading starts at |z| = {z:g}, above alpha/(delta - gamma)"


def unbounded(reason: str, parameters: Mapping[str, Any], remedy: str) -> str:
    """Return the message that the hysteretic force is unbounded, with the reason."""
    return f"The hysteretic force is unbounded: {reason} ({_stated(parameters)}). {remedy}"


def may_diverge(
    conditions: Sequence[str], broken: Sequence[str], parameters: Mapping[str, Any]
) -> str:
    """Return the message on violated conditions for a bounded hysteretic force."""
    return (
        f"The joint is bounded for {' and '.join(conditions)}, but {_stated(parameters)} violate "
        f"{' and '.join(broken)}: the hysteretic force may diverge. Check the signs of the "
        "parameters, or keep the input small enough."
    )


def _stated(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in parameters.items())


def prior_unbounded(lowest: float) -> str:
    """Return the message that a prior allows gamma + delta below zero [1/m]."""
    return (
        f"The prior lets gamma + delta fall to {lowest:.4g} 1/m, where the hysteretic force "
        "grows without bound; draws that diverge count as failed solutions. Raise the lower bound "
        "of gamma above -delta unless this is intended."
    )


def prior_beyond_motion(name: str, least: float, most: float, y_peak: float) -> str:
    """Return the message that a prior allows gaps wider than the largest motion [m]."""
    what = f"begins at {least:.3g}" if least >= y_peak else f"reaches {most:.3g}"
    return (
        f"The prior of {name} {what} m, but the largest motion is {y_peak:.3g} m: a gap wider than "
        f"this never closes, and the gap's parameters have no effect. Lower the bound of {name}, "
        "or drive the structure harder."
    )


def no_known_force(parameter: str, law: str, must: str, value: float) -> str:
    """Return the message that a parameter is too small for the force of the law to be defined."""
    return (
        f"Parameter `{parameter}` of `{law}` must be {must}, but it is "
        f"{value:g}, where the law has no force."
    )


def modes_explained(
    num_modes: int, tests: Sequence[tuple[float, int, float]], is_explained: bool
) -> str:
    """Return the sentence on whether joints explain softening and losses: chi-square, dof and p."""
    rows = ". ".join(
        f"{what}: chi-square {chi_square:.3g} with {degrees} "
        f"degree{'' if degrees == 1 else 's'} of freedom (p = {p:.2g})"
        for what, (chi_square, degrees, p) in zip(("Softening", "Losses"), tests, strict=True)
    )
    does = "explain" if is_explained else "do not explain"
    return (
        f"At small motion the joints {does} frequency and damping of the {num_modes} modes. {rows}."
    )


def indistinguishable(laws: Sequence[str], why: str) -> str:
    """Return the message that no motion can distinguish two laws."""
    return (
        f"The laws {' and '.join(f'`{name}`' for name in laws)} cannot be distinguished: "
        f"{why}. Keep one of these laws."
    )


def joints_stiffer(largest: float) -> str:
    """Return the message that several joints together are stiffer than the structure."""
    return (
        "The joints are stiffer than the structure: every eigenvalue of k_j sum(h p / omega_n^2) "
        f"must be at most 1, but one is {largest:.4g}. Once the joints slip, no stiffness remains "
        "that holds the structure, and the motion grows without limit. Lower the stiffness of "
        "the laws, or raise omega_n, which includes the stiffness of all fully stuck joints."
    )


def step_of_mode(hz: float, angle: float, fs: float, substeps: int) -> str:
    """Return the clause on the phase by which the highest mode advances in one time step."""
    return (
        f"The phase of the highest mode, at {hz:.4g} Hz, advances by {angle:.3g} rad in a time "
        f"step of `fs` = {fs:g} Hz and `substeps` = {substeps}"
    )


def put_substeps(substeps: int) -> str:
    """Return the remedy with the number of substeps that resolves the highest mode."""
    return f"Put `substeps={substeps}`, sample the input faster, or leave the highest mode out."
