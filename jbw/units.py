"""Units at the border: a small fixed table to SI, by quantity. Inside jbw everything is SI."""

import re
from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, did_you_mean

INCH = 0.0254  # exact, by the definition of 1959
POUND_FORCE = 4.4482216152605  # exact, 0.45359237 kg times standard gravity
GRAVITY = 9.80665  # exact, standard gravity

# quantity -> unit -> factor to SI; the first unit of each quantity is its SI unit.
FACTORS: dict[str, dict[str, float]] = {
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6},
    "force": {
        "N": 1.0,
        "kN": 1e3,
        "mN": 1e-3,
        "lbf": POUND_FORCE,
        "lb": POUND_FORCE,
        "kip": 1e3 * POUND_FORCE,
        "kgf": GRAVITY,
    },
    "current": {"A": 1.0, "mA": 1e-3},
    "force per mass": {"N/kg": 1.0, "mN/kg": 1e-3, "kN/kg": 1e3},
    "displacement": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": INCH},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "in/s": INCH},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3, "um/s^2": 1e-6, "in/s^2": INCH, "g": GRAVITY},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "rad/s": 1 / (2 * pi)},
    "angle": {"rad": 1.0, "deg": pi / 180},
}

TIME = r"^t$|\btime\b|\bzeit\b"  # in the name of a column of times
# One spelling for the ways in which files write micro, powers and inverse seconds.
_SPELLING = str.maketrans({"µ": "u", "μ": "u", "²": "^2", "°": "deg", " ": None})


def si_unit(quantity: str) -> str:
    """SI unit in which jbw holds a quantity, such as `m/s` for a velocity."""
    return next(iter(FACTORS[quantity]))


def plain(unit: str) -> str:
    """Spelling of a unit as the table has it: `µm/s²` is `um/s^2`, `m/s**2` is `m/s^2`."""
    return unit.translate(_SPELLING).replace("**", "^").replace("/s2", "/s^2")


def titled(title: str) -> tuple[str, str]:
    """Name and unit of a title such as `force [kN]` or `Time (ms)`; the unit is empty without one.

    What stands behind a time is its unit whatever it says: a wrong one would be a wrong rate.
    """
    found = re.fullmatch(r"\s*(.*\S)\s*(?:\[([^\[\]]+)\]|\(([^()]+)\))\s*", title)
    if not found:
        return title, ""
    name, unit = found[1], found[2] or found[3]
    known = any(plain(unit) in factors for factors in FACTORS.values())
    return (name, unit) if known or re.search(TIME, name.lower()) else (title, "")


def quantity_of(unit: str, among: tuple[str, ...] = tuple(FACTORS)) -> str:
    """Quantity that a unit measures, of those that may be meant.

    Args:
        unit: Unit as the user wrote it.
        among: Quantities that the place admits, such as ("voltage", "force per mass").

    Returns:
        The quantity's name.

    Raises:
        ConfigError: The unit is not in the table, or measures another quantity.
    """
    written = plain(unit)
    for quantity in among:
        if written in FACTORS[quantity]:
            return quantity
    wanted = " or ".join(f"a {quantity}" for quantity in among)
    known = [name for quantity in among for name in FACTORS[quantity]]
    others = [quantity for quantity, factors in FACTORS.items() if written in factors]
    if others:
        what = f"Unit `{unit}` measures a {others[0]}, but {wanted} is needed."
        raise ConfigError(what, remedy=f"Use one of {', '.join(known)}, or correct the role.")
    remedy = did_you_mean(written, known) + f"Known: {', '.join(known)}."
    raise ConfigError(f"Unit `{unit}` of {wanted} is not known.", remedy=remedy)


def to_si(values: ArrayLike, unit: str, quantity: str) -> NDArray[np.float64]:
    """Values in SI, as float64.

    Args:
        values: Numbers in `unit`.
        unit: A unit of the table, such as `mm/s`.
        quantity: What it measures, such as `velocity`.

    Returns:
        The same numbers in `si_unit(quantity)`.

    Raises:
        ConfigError: Unknown unit, or a unit of another quantity.
    """
    quantity_of(unit, (quantity,))
    return np.asarray(values, dtype=np.float64) * FACTORS[quantity][plain(unit)]


def powers_of(unit: str) -> dict[str, int]:
    """Powers of its factors in a unit of jbw's dialect: `1/(m s^2)` is {m: -1, s: -2}."""
    above, _, below = unit.partition("/")
    found: dict[str, int] = {}
    for part, sign in ((above, 1), (below.strip("()"), -1)):
        for factor in part.split():
            name, _, power = factor.partition("^")
            if name != "1":
                found[name] = found.get(name, 0) + sign * int(power or 1)
    return found
