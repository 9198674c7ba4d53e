"""Checks of single values of a campaign file: each returns the value, or raises ValueError."""

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from math import isfinite
from typing import Any

from jbw.errors import ConfigError
from jbw.measurement.roles import ROLES, ratio_of, si_of

# Prior names, and the least value that each admits; None where the sign is free.
LEAST: dict[str, float | None] = {
    "omega_n": 0.0,
    "zeta": 0.0,
    "alpha": 0.0,
    "delta": None,
    "gamma": None,
    "gain": 0.0,
    "cubic": None,
}


def unlike(name: str, known: Iterable[str]) -> str:
    """The end of a refusal of a name: the nearest known one, and all of them."""
    known = list(known)
    nearest = get_close_matches(str(name), known, n=1, cutoff=0.5)
    return (f"; did you mean `{nearest[0]}`" if nearest else "") + f" (known: {', '.join(known)})"


def text(value: Any) -> str:
    """A string of printable characters, on one line."""
    if not isinstance(value, str):
        raise ValueError(f"must be a string, but is {value!r}.")
    if not value.isprintable():
        raise ValueError(f"must be printable, on one line, but is {value!r}.")
    return value


def number(value: Any) -> float:
    """A finite number; true and false are none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"must be a number, but is {value!r}.")
    try:
        found = float(value)
    except OverflowError:  # a whole number of hundreds of digits
        found = float("inf")
    if not isfinite(found):
        raise ValueError(f"must be finite, but is {value}.")
    return found


def positive(value: Any) -> float:
    """A number above zero."""
    if number(value) <= 0:
        raise ValueError(f"must be positive, but is {value}.")
    return float(value)


def non_negative(value: Any) -> float:
    """A number, zero or above."""
    if number(value) < 0:
        raise ValueError(f"must not be negative, but is {value}.")
    return float(value)


def a_whole_number(least: int) -> Callable[[Any], int]:
    """Check for an integer from `least` on."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"must be a whole number from {least} on, but is {value!r}.")
        return value

    return check


def yes_or_no(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise ValueError(f"must be true or false, but is {value!r}.")
    return value


def one_of(*words: str) -> Callable[[Any], str]:
    """Check for one of a few words."""

    def check(value: Any) -> str:
        if value not in words:
            raise ValueError(f"{text(value)!r} is unknown{unlike(value, words)}.")
        return value

    return check


def some_of(*words: str) -> Callable[[Any], tuple[str, ...]]:
    """Check for words among a few."""
    check = one_of(*words)
    return lambda value: tuple(check(word) for word in strings(value))


def strings(value: Any) -> tuple[str, ...]:
    """A string, or a list of at least one."""
    items = value if isinstance(value, list) else [value]
    if not items or not all(isinstance(item, str) and item for item in items):
        raise ValueError(f"must be a string or a list of strings, but is {value!r}.")
    return tuple(items)


def files(value: Any) -> tuple[str, ...] | dict[str, tuple[str, ...]]:
    """Patterns of files, or role to patterns where the channels of a record lie in several."""
    if not isinstance(value, dict):
        return strings(value)
    return _roles(value, lambda _, item: strings(item))


def _numbers(value: Any, check: Callable[[Any], float]) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"must be a list of numbers, but is {value!r}.")
    return tuple(check(item) for item in value)


def positive_list(value: Any) -> tuple[float, ...]:
    """A list of at least one number above zero."""
    return _numbers(value, positive)


def level_list(value: Any) -> tuple[float, ...]:
    """A list of at least one number, zero or above."""
    return _numbers(value, non_negative)


def modes(value: Any) -> tuple[float, ...]:
    """Frequencies of modes, all different."""
    found = positive_list(value)
    if len(set(found)) < len(found):
        raise ValueError(f"must not repeat a frequency, but is {value}.")
    return found


def rising_pair(value: Any) -> tuple[float, float]:
    """Two numbers, zero or above, the second larger."""
    pair = _numbers(value, non_negative)
    if len(pair) != 2 or pair[0] >= pair[1]:
        raise ValueError(f"must be [lower, upper] with lower < upper, but is {value}.")
    return pair[0], pair[1]


def sampling(value: Any) -> float | str:
    """A sampling frequency, or the path of one."""
    return value if isinstance(value, str) and value else positive(value)


def a_repeat_list(value: Any) -> tuple[int | str, ...]:
    """Repeats by number, from zero, or by file name."""
    items = value if isinstance(value, list) else [value]
    for item in items:
        if isinstance(item, bool) or not isinstance(item, int | str):
            raise ValueError(f"must be a list of repeat numbers or file names, but is {value!r}.")
        if isinstance(item, int) and item < 0:
            raise ValueError(f"repeats are counted from zero, but one is {item}.")
    return tuple(items)


def _roles(value: Any, check: Callable[[str, Any], Any]) -> dict[str, Any]:
    """A table by role, each value checked; all that is wrong in one ValueError."""
    if not isinstance(value, dict) or not value:
        raise ValueError(f"must be a table such as {{ velocity = ... }}, but is {value!r}.")
    checked, errors = {}, []
    for role, item in value.items():
        try:
            if role not in ROLES:
                raise ValueError(f"role `{role}` is unknown{unlike(role, ROLES)}.")
            checked[role] = check(role, item)
        except ConfigError as error:
            errors.append(" ".join(filter(None, (error.what, error.remedy))))
        except ValueError as error:
            errors.append(str(error))
    if errors:
        raise ValueError("\n".join(errors))
    return checked


def role_paths(value: Any) -> dict[str, str]:
    """Role to path of the channel."""

    def path(role: str, item: Any) -> str:
        if not isinstance(item, str) or not item:
            raise ValueError(f"role `{role}` needs a channel's name or path, but has {item!r}.")
        return item

    return _roles(value, path)


def role_units(value: Any) -> dict[str, str]:
    """Role to unit; the unit must measure what the role is."""

    def unit(role: str, item: Any) -> str:
        if not isinstance(item, str):
            raise ValueError(f"role `{role}` needs a unit, but has {item!r}.")
        if ratio_of(role, item) is None:  # a measured FRF may be per unit of excitation
            si_of(role, item)
        return item

    return _roles(value, unit)


def role_numbers(value: Any) -> dict[str, float]:
    """Role to a factor that is not zero."""

    def factor(role: str, item: Any) -> float:
        if number(item) == 0:
            raise ValueError(f"the factor of role `{role}` must not be 0.")
        return float(item)

    return _roles(value, factor)


def a_prior(value: Any) -> dict[str, tuple[float, float]]:
    """Parameter to bounds; alpha must stay below omega_n^2, or the structure has no stiffness."""
    if not isinstance(value, dict):
        raise ValueError(f"must be a table such as {{ zeta = [lower, upper] }}, but is {value!r}.")
    bounds: dict[str, tuple[float, float]] = {}
    errors = []
    for name, item in value.items():
        try:
            bounds[name] = _bounds(name, item)
        except ValueError as error:
            errors.append(f"{name}: {error}")
    if not errors and {"omega_n", "alpha"} <= set(bounds):
        highest, least = bounds["alpha"][1], bounds["omega_n"][0] ** 2
        if highest >= least:
            errors.append(
                f"alpha < omega_n^2 must hold everywhere, but alpha reaches {highest:g} "
                f"and omega_n^2 begins at {least:g}; lower alpha's upper bound."
            )
    if errors:
        raise ValueError("\n".join(errors))
    return bounds


def _bounds(name: str, item: Any) -> tuple[float, float]:
    if name not in LEAST:
        raise ValueError(f"unknown parameter{unlike(name, LEAST)}.")
    pair = _numbers(item, number)
    if len(pair) != 2 or pair[0] >= pair[1]:
        raise ValueError(f"must be [lower, upper] with lower < upper, but is {item}.")
    least = LEAST[name]
    if least is not None and (pair[0] < least or (name == "omega_n" and pair[0] <= 0)):
        raise ValueError(f"must be positive, but its lower bound is {pair[0]:g}.")
    return pair
