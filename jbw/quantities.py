"""The table of quantities that jbw uses: name, symbol, unit and meaning of each.

The parameters of a law of the joint are in that law's own table, in the same form. Units have one
dialect: `rad/s`, `N/kg`, `1/m`, `1/(m s^2)`: SI factors separated by spaces, powers by `^`, one
stroke, a parenthesis below it if there are several factors, `1` for a pure number. Runs of jbw up
to 0.1 also wrote `rad s-1` and `m^-2 s^6`; `in_dialect` reads them.
"""

import re
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

from jbw.errors import ConfigError


class Quantity(NamedTuple):
    """A quantity with its name, symbol, unit, meaning and range.

    Attributes:
        name: Name in campaigns, results and code, such as `omega_n`.
        symbol: Symbol for people, such as `ωₙ`.
        unit: SI unit; `1` for a pure number.
        meaning: Description in a few words.
        least: Lowest sensible value; None if there is none.
        is_share: Whether it is a part of omega_n^2, or that part over omega_n^2; its upper limit
            is the case in which only the joint provides stiffness.
        is_open: Whether the lowest value itself is excluded.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    least: float | None = None
    is_share: bool = False
    is_open: bool = False

    @property
    def attrs(self) -> dict[str, str]:
        """The attributes of the quantity's variable in a dataset."""
        return {"units": self.unit, "long_name": self.meaning, "symbol": self.symbol}


def must_be(quantity: Quantity, value: float) -> str | None:
    """Return the violated lower bound in words, such as "positive"; None if it is not violated."""
    least = quantity.least
    if least is None or value > least or (value == least and not quantity.is_open):
        return None
    if least == 0.0:
        return "positive"
    return f"greater than {least:g}" if quantity.is_open else f"at least {least:g}"


def attrs_of(quantities: Iterable[Quantity]) -> dict[str, dict[str, str]]:
    """Return the attributes of each quantity's dataset variable, keyed by the quantity's name."""
    return {quantity.name: quantity.attrs for quantity in quantities}


DEFAULT_LAWS = ("bouc_wen",)  # laws of a joint that states none
# The parameters of the default law, for checking a campaign file without loading the laws.
BOUC_WEN = (
    Quantity("alpha", "α", "1/s^2", "stiffness of the hysteretic part", 0.0, is_share=True),
    Quantity("delta", "δ", "1/m", "softening of the hysteresis"),
    Quantity("gamma", "γ", "1/m", "opening of the hysteresis loop"),
)

# Parameters of the linear oscillator, whatever the law of the joint.
OSCILLATOR = (
    Quantity("omega_n", "ωₙ", "rad/s", "natural frequency, full stick", 0.0, is_open=True),
    Quantity("zeta", "ζ", "1", "viscous damping ratio", 0.0),
    Quantity("gain", "gain", "N/kg/V", "force per unit mass and unit of input", 0.0),
)

# Signals that feed a shaker whose armature moves with the structure. The parameters are then those
# of the structure with the shaker, and have other names than those of the structure alone.
FED = {"voltage": ("ᵛ", "N/kg/V"), "current": ("ⁱ", "N/kg/A")}
ATTACHED = tuple(
    quantity._replace(
        name=f"{quantity.name}_{drive}", symbol=quantity.symbol + mark,
        unit=gain if quantity.name == "gain" else quantity.unit,
        meaning=f"{quantity.meaning}, driven by {drive}",
    )
    for drive, (mark, gain) in FED.items()
    for quantity in OSCILLATOR
)  # fmt: skip
# A moving base drives the same structure as a force does; only the gain is a separate parameter.
BASE_GAIN = Quantity("gain_base", "gainᵇ", "1", "participation in the motion of the base")
ATTACHED = (*ATTACHED, BASE_GAIN)
LINEAR = (*OSCILLATOR, *ATTACHED)
GAINS = frozenset(row.name for row in LINEAR if row.name.startswith("gain"))  # gains of the sources

# Contributions of other modes to a response, divided by the force per unit mass that drives the
# joint's own mode. Two constants represent all modes outside the band. Each mode within the band
# (a neighbour) is linear and has a frequency, a damping ratio and a relative gain.
CONSTANT_TERMS = (
    Quantity("residual_upper", "U", "s^2", "static response of the modes above the band"),
    Quantity("residual_lower", "L", "1", "response times omega^2 of the modes below the band"),
)
NEIGHBOURS = tuple(
    (
        Quantity(
            f"neighbour_{k}_omega", f"ω{n}", "rad/s", f"natural frequency, neighbour {k}", 0.0
        ),
        Quantity(f"neighbour_{k}_zeta", f"ζ{n}", "1", f"damping ratio, neighbour {k}", 0.0),
        Quantity(f"neighbour_{k}_share", f"s{n}", "1", f"gain over the mode's, neighbour {k}"),
    )
    for k, n in enumerate("₁₂₃₄", 1)
)
RESIDUAL_TERMS = (*CONSTANT_TERMS, *(quantity for mode in NEIGHBOURS for quantity in mode))

# Parameters of further modes that move the joint, relative to the effect of the first mode; the
# sign is fixed.
MODES = tuple(
    (
        Quantity(f"omega_{k}", f"ω{n}", "rad/s", f"natural frequency, mode {k}", 0.0, is_open=True),
        Quantity(f"zeta_{k}", f"ζ{n}", "1", f"viscous damping ratio, mode {k}", 0.0),
        Quantity(f"gain_ratio_{k}", f"b{n}/b₁", "1", f"gain of mode {k} / gain of mode 1"),
        Quantity(
            f"shape_{k}", f"|h{n}|", "1", f"motion of the joint in mode {k} / in mode 1",
            0.0, is_open=True,
        ),
        Quantity(
            f"coupling_{k}", f"κ{n}", "1", f"effect of the joint on mode {k} / on mode 1",
            0.0, is_open=True,
        ),
        Quantity(f"sign_{k}", f"sgn h{n}", "1", f"sign of the joint's motion in mode {k}"),
    )
    for k, n in enumerate("₂₃₄₅", 2)
)  # fmt: skip
# Responses of every mode at further points, relative to the response at the first point.
POINTS = tuple(
    tuple(
        Quantity(
            f"point_{k}_{i}", f"c{n}{m}", "1", f"response of mode {i} at point {k} / at point 1"
        )
        for i, m in enumerate("₁₂₃₄₅", 1)
    )
    for k, n in enumerate("₂₃₄₅", 2)
)  # fmt: skip
_SEEN = tuple(quantity for point in POINTS for quantity in point)
MODAL = (*(quantity for mode in MODES for quantity in mode), *_SEEN)
# Parameters that are determined while the joint is stuck.
STUCK = (*LINEAR, *(quantity for mode in MODES for quantity in mode[:3]), *_SEEN)

# Responses in the order of the derivative of the displacement.
MOTION = (
    Quantity("displacement", "y", "m", "displacement"),
    Quantity("velocity", "v", "m/s", "velocity"),
    Quantity("acceleration", "a", "m/s^2", "acceleration"),
)
UNIT_OF = {quantity.name: quantity.unit for quantity in MOTION}
LETTER_OF = {quantity.name: quantity.symbol for quantity in MOTION}

# all other quantities, under the names that results and the rig use
OTHERS = (
    Quantity("input", "u", "V", "voltage of the source"),
    Quantity("force", "F", "N", "force of the source"),
    Quantity("restoring_force", "R", "N", "force that holds the specimen"),
    Quantity("drive_point", "a_d", "m/s^2", "acceleration where the shaker pushes"),
    Quantity("frequency", "f", "Hz", "frequency"),
    Quantity("phase", "φ", "rad", "phase of the response"),
    Quantity("noise_std", "noise sd", "1", "noise of one repeat"),
    Quantity("h3", "H₃", "s^6/m^2", "third-order kernel"),
    Quantity("lambda_3", "λ₃", "1/(m^2 s^2)", "cubic coefficient of the smoothed law"),
    Quantity("log_likelihood", "log L", "1", "log likelihood"),
    Quantity("response", "v", "m/s", "velocity at one instant"),
)
BY_NAME = {
    quantity.name: quantity for quantity in (*LINEAR, *RESIDUAL_TERMS, *MODAL, *MOTION, *OTHERS)
}


Motion = Literal["displacement", "velocity", "acceleration"]


def derivative_order(response: str) -> int:
    """Return the order of differentiation from displacement to a response: 0, 1 or 2.

    Args:
        response: Kind of response: displacement, velocity or acceleration.

    Returns:
        The order p; the response's spectrum is (j omega)^p times the displacement's.

    Raises:
        ConfigError: `response` is another word.
    """
    if response not in UNIT_OF:
        raise ConfigError(
            f"Argument `response` must be one of {', '.join(UNIT_OF)}, but it is {response!r}."
        )
    return list(UNIT_OF).index(response)


def per(unit: str, source: str) -> str:
    """Return the unit of a ratio of two quantities, such as `m/V` for `m` and `V`."""
    return f"{unit}/({source})" if "/" in source else f"{unit}/{source}"


def gain_unit(source: str) -> str:
    """Return the unit of a source's gain: force per unit modal mass, per unit of the source signal.

    For a force in N the gain is one over the modal mass; for a force per mass it is the number 1.
    """
    return {"N": "1/kg", "N/kg": "1"}.get(source) or per("N/kg", source)


def in_dialect(unit: str) -> str:
    """Return a unit in jbw's spelling; old spellings such as `m s-1`, `m^-2 s^6` are converted."""
    stem, words, rest = unit.partition(" per ")
    # A minus sign after a letter marks a power in old units; the present form `m/s^2` contains
    # none.
    if not re.search(r"[A-Za-z]\^?-\d", stem):
        return unit
    factors = re.findall(r"([A-Za-z]+)\^?(-?\d+)?", stem)
    above = [name + _power(n or "1") for name, n in factors if not n.startswith("-")]
    below = [name + _power(n[1:]) for name, n in factors if n.startswith("-")]
    under = f"({' '.join(below)})" if len(below) > 1 else below[0]
    return f"{' '.join(above) or '1'}/{under}{words}{rest}"


def _power(exponent: str) -> str:
    return "" if exponent == "1" else f"^{exponent}"


# -- of several joints -----------------------------------------------------------------------------
AT, TIED = "@", "="  # "@" separates a name from its joint, "+" separates joints that share a law


def label(name: str) -> str:
    """Return a joint's name as it occurs in parameter names, such as `bolt_1` for `bolt 1`."""
    return re.sub(r"\W+", "_", name)


def name_at(name: str, joint: str) -> str:
    """Return the name of a law's parameter at a joint, such as `alpha@bolt_1`."""
    return f"{name}{AT}{joint}"


def law_name(law: str, joints: Iterable[str]) -> str:
    """Return the name of a law with the joints that share it."""
    return name_at(law, TIED.join(joints))


def natural(name: str) -> list[tuple[int, int | str]]:
    """Return a key for sorting names in which numbers sort by value: run_2 comes before run_10."""
    parts = re.split(r"(\d+)", name)
    return [(1, int(part)) if part.isdecimal() else (0, part) for part in parts]


def split(law: str) -> tuple[str, tuple[str, ...]]:
    """Return a law's name and the joints that share it; no joints if there is only one joint."""
    plain, _, joints = law.partition(AT)
    return plain, tuple(joints.split(TIED)) if joints else ()


def are_at_joints(laws: Iterable[Any]) -> bool:
    """Return whether any of the laws belongs to one of several joints."""
    return any(isinstance(law, str) and AT in law for law in laws)


MOTION_FACTOR = "motion_factor"
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def motion_factor(mode: int, joint: str) -> Quantity:
    """Define the quantity: a joint's motion in a mode, divided by that in the structural model."""
    number = str(mode).translate(_LOWERED)
    return Quantity(
        name_at(f"{MOTION_FACTOR}_{mode}", joint), f"f{number} {joint}", "1",
        f"motion of {joint} in mode {mode} relative to the structural model", 0.0, is_open=True,
    )  # fmt: skip


def motion_factors_in(names: Iterable[Any]) -> dict[str, Quantity]:
    """Return the quantities of all joint motion factors among parameter names, keyed by name."""
    stated = [re.fullmatch(rf"{MOTION_FACTOR}_(\d+){AT}(\w+)", str(name)) for name in names]
    found = (motion_factor(int(match[1]), match[2]) for match in stated if match)
    return {quantity.name: quantity for quantity in found}


def joints_of(laws: Iterable[str]) -> tuple[str, ...]:
    """Return the names of all joints that have laws, in the order in which the laws are listed."""
    return tuple(dict.fromkeys(joint for law in laws for joint in split(law)[1]))
