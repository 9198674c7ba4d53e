"""Conversion of units at input and output, from a fixed table to SI; inside jbw all is SI."""

import re
from collections.abc import Iterator
from functools import cache
from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jbw.errors import ConfigError, did_you_mean

INCH = 0.0254  # exact: the international foot of 1959
FOOT = 0.3048  # exact, twelve inches
POUND_FORCE = 4.4482216152605  # exact, 0.45359237 kg times standard gravity
GRAVITY = 9.80665  # exact, standard gravity

# Factors to SI by quantity and unit; the first unit of each quantity is its SI unit.
FACTORS: dict[str, dict[str, float]] = {
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6},
    "force": {
        "N": 1.0,
        "kN": 1e3,
        "MN": 1e6,
        "mN": 1e-3,
        "daN": 10.0,
        "lbf": POUND_FORCE,
        "lb": POUND_FORCE,
        "kip": 1e3 * POUND_FORCE,
        "kgf": GRAVITY,
    },
    "current": {"A": 1.0, "mA": 1e-3},
    "force per mass": {"N/kg": 1.0, "mN/kg": 1e-3, "kN/kg": 1e3},
    "displacement": {
        "m": 1.0,
        "cm": 1e-2,
        "mm": 1e-3,
        "um": 1e-6,
        "nm": 1e-9,
        "in": INCH,
        "mil": 1e-3 * INCH,
        "ft": FOOT,
    },
    "velocity": {
        "m/s": 1.0,
        "cm/s": 1e-2,
        "mm/s": 1e-3,
        "um/s": 1e-6,
        "nm/s": 1e-9,
        "in/s": INCH,
        "ft/s": FOOT,
    },
    "acceleration": {
        "m/s^2": 1.0,
        "cm/s^2": 1e-2,
        "mm/s^2": 1e-3,
        "um/s^2": 1e-6,
        "in/s^2": INCH,
        "ft/s^2": FOOT,
        "g": GRAVITY,
        "mg": 1e-3 * GRAVITY,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "rad/s": 1 / (2 * pi), "RPM": 1 / 60},
    "angle": {"rad": 1.0, "deg": pi / 180},
    # Quantities of torsion replace metres by radians, newtons by newton metres, masses by inertias.
    "rotation": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": pi / 180},
    "angular velocity": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": pi / 180},
    "angular acceleration": {"rad/s^2": 1.0, "mrad/s^2": 1e-3, "deg/s^2": pi / 180},
    "torque": {
        "N m": 1.0,
        "kN m": 1e3,
        "mN m": 1e-3,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "lbf ft": POUND_FORCE * FOOT,
        "lbf in": POUND_FORCE * INCH,
    },
}
TORSION = ("rotation", "angular velocity", "angular acceleration", "torque")

TIME = r"^t(?:_(?:s|sec|ms|us))?$|\b(?:time|zeit)(?:\b|_)"  # matches the name of a column of times
# Map the ways in which files write micro, powers and inverse seconds to one spelling.
SUPERSCRIPT = re.compile("[⁻⁺¹²³⁴]+")
_RAISED = str.maketrans("⁻⁺¹²³⁴", "-+1234")
_SPELLING = str.maketrans(
    {"µ": "u", "μ": "u", "²": "^2", "°": "deg", "·": "*", "×": "*", "⋅": "*", "−": "-"}
)
# Words that recorders write for units (in lower case), each with its symbol in the table of units.
WORDS = {
    "newton": "N", "newtons": "N", "kilonewton": "kN", "kilonewtons": "kN", "lbs": "lbf",
    "pounds": "lbf", "kips": "kip", "kp": "kgf", "dan": "daN",
    "volt": "V", "volts": "V", "millivolt": "mV", "millivolts": "mV", "ampere": "A",
    "amperes": "A", "amp": "A", "amps": "A",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "millimeter": "mm",
    "millimeters": "mm", "millimetre": "mm", "millimetres": "mm", "micron": "um",
    "microns": "um", "micrometer": "um", "micrometers": "um", "micrometre": "um",
    "micrometres": "um", "inch": "in", "inches": "in", "foot": "ft", "feet": "ft",
    "mils": "mil", "ips": "in/s", "gs": "g", "g's": "g", "gn": "g", "g_n": "g", "grav": "g",
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "msecs": "ms",
    "millisecond": "ms", "milliseconds": "ms", "usec": "us", "microsecond": "us",
    "microseconds": "us", "nsec": "ns", "nanosecond": "ns", "nanoseconds": "ns",
    "minute": "min", "minutes": "min", "hour": "h", "hours": "h", "sek": "s", "sekunden": "s",
    "hertz": "Hz", "hz": "Hz", "khz": "kHz", "rpm": "RPM", "r/min": "RPM", "1/min": "RPM",
    "min^-1": "RPM", "1/s": "Hz", "s^-1": "Hz",
    "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", "grad": "deg",
    "n-m": "N m", "lb-ft": "lbf ft", "ft-lb": "lbf ft", "ft-lbf": "lbf ft",
    "lbf-ft": "lbf ft", "in-lb": "lbf in", "in-lbf": "lbf in", "lbf-in": "lbf in",
    "lb-in": "lbf in",
}  # fmt: skip
# Spellings that are matched exactly, because upper or lower case changes the meaning.
SYMBOLS = {
    "G": "g", "gn": "g", "HZ": "Hz", "hz": "Hz", "Nm": "N m", "kNm": "kN m", "mNm": "mN m",
    "Nmm": "N mm", "Ncm": "N cm", "ms-1": "m/s", "ms^-1": "m/s", "ms-2": "m/s^2",
    "ms^-2": "m/s^2", "ms2": "m/s^2", "mms2": "mm/s^2", "mms": "mm/s", "mms-1": "mm/s",
    "mms^-1": "mm/s",
}  # fmt: skip
# SI factor and dimensions of symbols that take prefixes or occur in compounds, in powers of metre,
# kilogram, second, volt, ampere and radian.
_BASE: dict[str, tuple[float, tuple[int, ...]]] = {
    "m": (1.0, (1, 0, 0, 0, 0, 0)), "kg": (1.0, (0, 1, 0, 0, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0, 0)), "V": (1.0, (0, 0, 0, 1, 0, 0)),
    "A": (1.0, (0, 0, 0, 0, 1, 0)), "rad": (1.0, (0, 0, 0, 0, 0, 1)),
    "N": (1.0, (1, 1, -2, 0, 0, 0)), "Hz": (1.0, (0, 0, -1, 0, 0, 0)),
    "deg": (pi / 180, (0, 0, 0, 0, 0, 1)), "g": (GRAVITY, (1, 0, -2, 0, 0, 0)),
    "in": (INCH, (1, 0, 0, 0, 0, 0)), "ft": (FOOT, (1, 0, 0, 0, 0, 0)),
    "mil": (1e-3 * INCH, (1, 0, 0, 0, 0, 0)), "lbf": (POUND_FORCE, (1, 1, -2, 0, 0, 0)),
    "lb": (POUND_FORCE, (1, 1, -2, 0, 0, 0)), "kip": (1e3 * POUND_FORCE, (1, 1, -2, 0, 0, 0)),
    "kgf": (GRAVITY, (1, 1, -2, 0, 0, 0)), "min": (60.0, (0, 0, 1, 0, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0, 0)), "1": (1.0, (0, 0, 0, 0, 0, 0)),
    "Ns": (1.0, (1, 1, -1, 0, 0, 0)), "Nm": (1.0, (2, 1, -2, 0, 0, 0)),
}  # fmt: skip
_PREFIXED = ("m", "s", "V", "A", "N", "g", "Hz", "rad")
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "da": 10.0, "k": 1e3, "M": 1e6}
_DECIBEL = re.compile(
    r"dB\s*[,(]?\s*(?:reference|ref\.?|rel\.?|re\.?)[:=]?\s*([\d.]+(?:[eE][-+]?\d+)?)?\s*(\S.*?)\)?\s*",
    re.IGNORECASE,
)
LONGEST = 64  # largest number of characters of a unit; a longer text is not a unit


def si_unit(quantity: str) -> str:
    """Return the SI unit in which jbw stores a quantity, such as `m/s` for a velocity."""
    return next(iter(FACTORS[quantity]))


def plain(unit: str) -> str:
    """Return a unit as the table of units spells it: `um/s^2` for `µm/s²`, `g` for `G's`."""
    return _plain(unit) if len(unit) <= LONGEST else unit


@cache
def _plain(unit: str) -> str:
    raised = SUPERSCRIPT.sub(lambda match: "^" + match[0].translate(_RAISED), unit)
    written = " ".join(raised.translate(_SPELLING).split()).replace("**", "^")
    outer = re.fullmatch(r"\[(.*)\]|\(([^()]*)\)", written)
    written = (outer[1] or outer[2] or "").strip() if outer else written
    if symbol := SYMBOLS.get(written) or WORDS.get(written.lower() if len(written) > 2 else ""):
        return symbol
    stripped = re.sub(r"\s*([*/^()])\s*", r"\1", written)
    stripped = re.sub(r"(?<=[/ *.])s2\b", "s^2", stripped)
    words = re.sub(r"[A-Za-z][A-Za-z']*", lambda match: _word(match[0]), stripped)
    words = SYMBOLS.get(words, words)
    if _in_table(words):
        return words
    closed = words.replace(" ", "")
    if _in_table(closed):
        return closed
    return _same_in_table(words) or words


def _word(word: str) -> str:
    """Return the symbol for a word of a compound unit, or the word itself if there is no symbol."""
    symbol = WORDS.get(word.lower(), "") if len(word) > 2 else SYMBOLS.get(word, "")
    return symbol if symbol and re.fullmatch("[A-Za-z]+", symbol) else word


def _in_table(unit: str) -> bool:
    return any(unit in factors for factors in FACTORS.values())


def _same_in_table(unit: str) -> str:
    """Return the listed unit that equals a compound unit; an empty text if there is none.

    `m/s/s` and `m s^-2` are `m/s^2`; a unit per force or mass is a ratio, which no table contains.
    """
    of_unit = measured(unit)
    if of_unit is None or any(p < 0 and _has_mass(s) for s, p in _factors(unit)):
        return ""
    for quantity, factors in FACTORS.items():
        for name in factors if quantity != "force per mass" else ():
            if (listed := measured(name)) is not None and _is_same_unit(of_unit, listed):
                return name
    return ""


def _has_mass(symbol: str) -> bool:
    return (_symbol(symbol) or _BASE["1"])[1][1] > 0


Measured = tuple[float, tuple[int, ...]]  # factor to SI, and powers of the base units


def _is_same_unit(a: Measured, b: Measured) -> bool:
    return a[1] == b[1] and abs(a[0] / b[0] - 1) < 1e-12


@cache
def measured(unit: str) -> Measured | None:
    """Return a compound unit's factor to SI and its powers of base units; None if it is unknown.

    Powers are of metre, kilogram, second, volt, ampere and radian: `g/N` is (9.80665, (0, -1, 0, 0,
    0, 0)), an accelerance.
    """
    if not unit or len(unit) > LONGEST:
        return None
    factor, powers = 1.0, [0] * 6
    try:
        for symbol, power in _factors(unit):
            base = _symbol(symbol)
            if base is None or abs(power) > 9:
                return None
            factor *= base[0] ** power
            powers = [x + power * y for x, y in zip(powers, base[1], strict=True)]
    except ValueError:
        return None
    return factor, tuple(powers)


def _factors(unit: str, sign: int = 1, depth: int = 0) -> Iterator[tuple[str, int]]:
    """Yield the symbols of a compound unit with their exponents, negative after a slash."""
    if depth > 4:
        raise ValueError(unit)
    rest, below = unit.strip(), 1
    while rest:
        if rest[0] == "(":
            level = 0
            end = next(
                (i for i, c in enumerate(rest)
                 if (level := level + {"(": 1, ")": -1}.get(c, 0)) == 0), -1
            )  # fmt: skip
            if end < 0:
                raise ValueError(unit)
            power = re.match(r"\^?(\d)", rest[end + 1 :])
            for symbol, each in _factors(rest[1:end], sign * below, depth + 1):
                yield symbol, each * int(power[1] if power else 1)
            rest = rest[end + 1 + (power.end() if power else 0) :]
        else:
            match = re.match(r"(1(?![\d.])|[A-Za-z]+)(?:\^?(-?\d+)|\^\((-?\d+)\))?", rest)
            if not match:
                raise ValueError(unit)
            yield match[1], sign * below * int(match[2] or match[3] or 1)
            rest = rest[match.end() :]
        rest = rest.strip()
        below = 1
        if rest[:1] in ("/", "*", "."):
            below = -1 if rest[0] == "/" else 1
            rest = rest[1:].strip()
            if not rest:
                raise ValueError(unit)


def _symbol(symbol: str) -> Measured | None:
    if symbol in _BASE:
        return _BASE[symbol]
    for prefix, factor in _PREFIXES.items():
        base = symbol.removeprefix(prefix)
        if symbol.startswith(prefix) and base in _PREFIXED:
            return factor * _BASE[base][0], _BASE[base][1]
    return None


def decibels(unit: str) -> tuple[float, str] | None:
    """Return the reference of a decibel unit: (1e-6, "m/s^2") for `dB re 1e-6 m/s^2`; else None."""
    match = _DECIBEL.fullmatch(unit.strip()) if len(unit) <= LONGEST else None
    return (float(match[1] or 1.0), match[2]) if match else None


def titled(title: str) -> tuple[str, str]:
    """Return the name and unit in a column title such as `force [kN]`; unit "" if none is stated.

    `Force, N` and `Velocity / mm/s` also have a unit. The text after the name of a time is always
    taken as its unit, because ignoring it would give a wrong rate.
    """
    match = re.fullmatch(r"\s*(.*?\S)\s*(?:\[([^\[\]]+)\]|\((.+)\)|\{([^{}]+)\})\s*", title)
    if not match:
        apart = re.fullmatch(r"\s*(.*?\S)(?:\s*,\s*|\s+(?:/|in)\s+)(\S.*?)\s*", title)
        apart = apart if apart and is_unit(apart[2]) else None
        return (apart[1], apart[2]) if apart else (title, "")
    name, unit = match[1], match[2] or match[3] or match[4]
    timed = re.search(TIME, name.lower()) is not None
    return (name.rstrip("/ "), unit) if is_unit(unit) or timed else (title, "")


def is_unit(text: str) -> bool:
    """Return whether a text is a unit that jbw knows, or a compound or decibels of such units."""
    written = plain(text)
    if decibels(text) is not None or _in_table(written):
        return True
    return bool(re.search("[/ *^]", written)) and measured(written) is not None


def is_voltage(unit: str) -> bool:
    """Return whether a unit measures voltage, so that a sensor's sensitivity is still missing."""
    return plain(unit) in FACTORS["voltage"]


def quantity_of(unit: str, among: tuple[str, ...] = tuple(FACTORS)) -> str:
    """Return which of the accepted quantities a unit measures; raise an error if it measures none.

    Args:
        unit: Unit as the user wrote it.
        among: Quantities that are accepted, such as ("voltage", "force per mass").

    Returns:
        The quantity's name.

    Raises:
        ConfigError: The unit is not in the table, or measures another quantity.
    """
    written = plain(unit)
    for quantity in among:
        if written in FACTORS[quantity]:
            return quantity
    for quantity in among:
        if _factor(written, quantity) is not None:
            return quantity
    # Torsion is not listed in the message, because only a few users need it.
    shown = [quantity for quantity in among if quantity not in TORSION] or among
    named = " or ".join(
        f"{'an' if quantity[0] in 'aeiou' else 'a'} {quantity}" for quantity in shown
    )
    units = [name for quantity in shown for name in FACTORS[quantity]]
    others = [quantity for quantity in FACTORS if _factor(written, quantity) is not None]
    if written.lower() == "db":
        raise ConfigError(
            f"Unit `{unit}` of {named} needs the value that 0 dB stands for.",
            remedy=f'State the unit with the value of 0 dB: "dB re 1 {si_unit(among[0])}".',
        )
    if others:
        what = f"Unit `{unit}` measures a {others[0]}, but {named} is needed."
        raise ConfigError(what, remedy=f"Use one of {', '.join(units)}, or correct the role.")
    remedy = did_you_mean(written, units) + f"Known: {', '.join(units)}."
    raise ConfigError(f"Unit `{unit}` of {named} is not known.", remedy=remedy)


def to_si(values: ArrayLike, unit: str, quantity: str) -> NDArray[np.float64]:
    """Return values converted to SI units, as float64.

    Args:
        values: Numbers in `unit`.
        unit: A unit of the table, such as `mm/s`.
        quantity: Measured quantity, such as `velocity`.

    Returns:
        The same numbers in `si_unit(quantity)`.

    Raises:
        ConfigError: The unit is unknown or measures another quantity.
    """
    quantity_of(unit, (quantity,))
    return np.asarray(values, dtype=np.float64) * factor_of(unit, quantity)


def factor_of(unit: str, quantity: str) -> float:
    """Return a unit's factor to SI; raise a ConfigError if it measures another quantity."""
    quantity_of(unit, (quantity,))
    return float(_factor(plain(unit), quantity) or 1.0)


def _factor(written: str, quantity: str) -> float | None:
    """Return the factor to SI of a listed unit, or of a compound with the right dimensions."""
    if written in FACTORS[quantity]:
        return FACTORS[quantity][written]
    of_unit, si = measured(written), measured(si_unit(quantity))
    # The dimensions of a frequency are also those of other rates, and the dimensions of N/kg are
    # those of an acceleration; such units are accepted only if the table lists them.
    by_table = quantity in ("frequency", "time") or (quantity == "acceleration" and "kg" in written)
    by_table = by_table or (quantity == "force per mass" and "kg" not in written)
    if by_table or of_unit is None or si is None or of_unit[1] != si[1]:
        return None
    return of_unit[0]


def powers_of(unit: str) -> dict[str, int]:
    """Return the exponent of each factor in a unit, such as {m: -1, s: -2} for `1/(m s^2)`."""
    above, _, below = unit.partition("/")
    powers: dict[str, int] = {}
    for part, sign in ((above, 1), (below.strip("()"), -1)):
        for factor in part.split():
            name, _, power = factor.partition("^")
            if name != "1":
                powers[name] = powers.get(name, 0) + sign * int(power or 1)
    return powers
