"""Numbers, units and names as readable text."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from jbw.errors import printable
from jbw.quantities import BY_NAME, Quantity, in_dialect
from jbw.report.messages import opening
from jbw.report.messages.message import length_unit as length_unit

Names = Mapping[str, Quantity]

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LEVEL = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
NOTHING = "–"


def quantity(name: str, names: Names | None = None) -> Quantity:
    """Return symbol, unit and meaning of a quantity, from a run's own names or jbw's tables."""
    if names is not None and name in names:
        return names[name]
    if name in BY_NAME:
        return BY_NAME[name]
    if name.startswith("noise_std_"):
        noise = BY_NAME["noise_std"]
        return noise._replace(
            name=name, symbol=name.replace("noise_std_", f"{noise.symbol}, ", 1), unit=""
        )
    # The tables of all laws load JAX, and are only needed if a run does not state the quantity.
    from jbw.oscillator.laws import vocabulary

    return vocabulary().get(name) or Quantity(name, name, "", "")


def symbol(name: str, names: Names | None = None) -> str:
    """Return a parameter's symbol: omega_n as ωₙ, noise_std[0.2] as noise sd at 0.2."""
    stem, bracket, index = name.partition("[")
    called = quantity(stem, names).symbol
    return f"{called} at {index.removesuffix(']')}" if bracket else called


def step_name(name: str) -> str:
    """Return the displayed name of a step and its sampler."""
    return opening.STEPS.get(name, name)


def unit_text(unit: str) -> str:
    """Return a unit with raised exponents: m/s^2 as m/s², 1/(m s^2) as m⁻¹ s⁻²; nothing for 1."""
    if unit == "1":
        return ""
    unit = in_dialect(unit)
    # The 1 of a unit such as 1/s would look like a digit of the number before the unit.
    if unit.startswith("1/"):
        powers = re.findall(r"([A-Za-z]+)(?:\^(\d+))?", unit)
        unit = " ".join(f"{name}^-{power or 1}" for name, power in powers)
    return raised(unit)


def raised(text: str) -> str:
    """Return a text with its integer exponents as superscripts: m^2 as m²."""
    return re.sub(r"\^(-?\d+)(?![\d.])", lambda match: match[1].translate(_RAISED), text)


def typed(text: str) -> str:
    """Return a printed number as it is typed on a keyboard: 3.2×10⁻⁶ as 3.2e-06, −1 as -1."""
    text = re.sub(
        r"×10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda match: f"e{int(match[1].translate(_LEVEL)):+03d}", text
    )
    return "-" if text == NOTHING else re.sub(r"−(?=[\d∞])", "-", text)


def axis_label(what: str, unit: str) -> str:
    """Return an axis label with its unit in brackets, or with [-] if there is none."""
    return f"{what} [{unit_text(unit) or '-'}]"


def about(level: float | None) -> float:
    """Round a level to two digits, so that repeats of one level have equal values."""
    return float(f"{level or 0.0:.2g}")


def number(value: Any, sd: Any = None, digits: int = 3) -> str:
    """Format a number to two digits of its `sd`, or to `digits` digits; a dash if undefined."""
    value, sd = _float(value), _float(sd)
    if value is None:
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    last = _exponent(sd) - 1 if sd else _exponent(value) - digits + 1
    lead = max(_exponent(value), last)
    if -3 <= lead <= 5:
        text = f"{round(value, -last):.{max(0, -last)}f}"
        return text.replace("-", "−")
    mantissa = f"{value / 10.0**lead:.{min(15, max(0, lead - last))}f}"
    return f"{mantissa}×10{str(lead).translate(_RAISED)}".replace("-", "−")


def interval(low: float, middle: float, high: float, sd: float = 0.2) -> str:
    """Return a value and its interval as typed text; the interval's width determines the digits."""
    ends = [typed(number(x, sd * (high - low))) for x in (middle, low, high)]
    return f"{ends[0]} [{ends[1]}, {ends[2]}]"


def spread_text(draws: Any, unit: str) -> str:
    """Return the median of draws with its unit, and half of their 99 % interval in percent."""
    low, middle, high = (float(quantile) for quantile in np.nanquantile(draws, [0.005, 0.5, 0.995]))
    half = 0.5 * (high - low)
    text = f"{number(middle, max(half, 1e-4 * abs(middle)))} {unit_text(unit)}".rstrip()
    return f"{text} ± {percent(half / abs(middle), digits=2)}" if middle else text


def shown_as(name: str, unit: str) -> tuple[float, str, str]:
    """Return the factor of a parameter's displayed values, their unit, and its symbol's suffix.

    ωₙ [rad/s] is shown as ωₙ/2π in Hz, and damping ratios in per cent.
    """
    if in_dialect(unit) == "rad/s":
        return 1.0 / (2.0 * math.pi), "Hz", "/2π"
    is_ratio = unit in ("", "1") and re.match(r"zeta(_|\[|$)", name) is not None
    return (100.0, "%", "") if is_ratio else (1.0, unit, "")


def percent(value: Any, digits: int = 3) -> str:
    """Return a ratio in percent as text."""
    ratio = _float(value)
    return NOTHING if ratio is None else f"{number(100.0 * ratio, digits=digits)} %"


def seconds(value: Any) -> str:
    """Return a duration in seconds, or in minutes and seconds, as text."""
    time = _float(value)
    if time is None:
        return NOTHING
    minutes, rest = divmod(round(time), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{number(time, digits=2)} s"


def _float(value: Any) -> float | None:
    """Return a finite or infinite number; None for a missing or undefined value."""
    if value is None or isinstance(value, str):
        return None
    as_float = float(value)
    return None if math.isnan(as_float) else as_float


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value else 0


def plain(name: object) -> str:
    """Return a name from a file as plain text, in which dollar signs do not begin formulas."""
    return printable(str(name)).replace("$", r"\$")
