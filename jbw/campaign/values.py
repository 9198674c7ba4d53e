"""Types of the values in campaign and plan files; each check has one plain sentence.

A check comes before pydantic's own and states in words what it refuses. Accepted values are then
converted to the annotated type, which also determines the JSON Schema.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainValidator,
)
from pydantic_core import CoreSchema, core_schema

from jbw.campaign.document import toml, unlike
from jbw.errors import ConfigError
from jbw.inference.density import Density, density_of, is_distribution
from jbw.measurement.kinds import KINDS
from jbw.measurement.records import ROLES, SENSITIVITIES, sensitivity_of, si_of
from jbw.report.messages.campaign_faults import decimal_points

ALL = "all"  # word that means all repeats
# escapes such as \t to which TOML converts parts of a Windows path, and the original text
ESCAPES = {"\a": "/a", "\b": "/b", "\t": "/t", "\n": "/n", "\f": "/f", "\r": "/r", "\x1b": "/e"}
Role = Literal[*ROLES]  # pyright: ignore[reportInvalidTypeForm]


@dataclass(frozen=True)
class OneOf:
    """A type for names in a register, which may grow after import."""

    # a function that returns the names, because more names may be registered later
    known: Callable[[], Iterable[str]]
    otherwise: str = ""  # an additional sentence for the error about an unknown name

    def check(self, value: Any) -> str:
        """Return the name if it is registered; raise a ValueError otherwise."""
        if text(value) not in (names := list(self.known())):
            raise ValueError(f"{value!r} is unknown{unlike(value, names)}.{self.otherwise}")
        return value

    def __get_pydantic_core_schema__(self, _: Any, __: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(
        self, _: CoreSchema, __: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"type": "string", "enum": list(self.known())}


def text(value: Any) -> str:
    """Return the value if it is a string of printable characters on one line."""
    if not isinstance(value, str):
        raise ValueError(f"must be a string, but is {value!r}.")
    if not value.isprintable():
        raise ValueError(f"must be printable, on one line, but is {value!r}.")
    return value


def number(value: Any) -> int | float:
    """Return the value if it is a finite number; true and false are rejected."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"must be a number, but is {value!r}.")
    try:
        finite = isfinite(value)
    except OverflowError:  # The value is an integer with hundreds of digits.
        finite = False
    if not finite:
        raise ValueError(f"must be finite, but is {value}.")
    return value


def whole(least: int) -> Callable[[Any], int]:
    """Return a function that checks for an integer of at least `least`."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"must be a whole number of at least {least}, but is {value!r}.")
        return value

    return check


def repeats(value: Any) -> int | str:
    """Return the value if it is a positive number of repeats or "all"."""
    if value == ALL:
        return ALL
    try:
        return whole(1)(value)
    except ValueError:
        raise ValueError(
            f'must be a whole number of at least 1, or "{ALL}", but is {value!r}.'
        ) from None


def strings(value: Any) -> tuple[str, ...]:
    """Return a string, or a list of at least one string, as a tuple."""
    items = value if isinstance(value, list | tuple) else [value]
    if not items or not all(isinstance(item, str) and item for item in items):
        raise ValueError(f"must be a string or a list of strings, but is {value!r}.")
    return tuple(items)


def numbers(value: Any) -> tuple[Any, ...]:
    """Return a list of at least one number as a tuple."""
    if not isinstance(value, list | tuple) or not value:
        raise ValueError(f"must be a list of numbers, but is {value!r}.")
    return tuple(number(item) for item in value)


def bounds(value: Any) -> tuple[Any, Any]:
    """Return a pair of numbers if the second is larger."""
    pair = numbers(value)
    if len(pair) != 2 or pair[0] >= pair[1]:
        hint = ""
        if len(pair) == 4 and all(isinstance(item, int) for item in pair):
            lower, lower_digits, upper, upper_digits = pair
            hint = " " + decimal_points(f"[{lower}.{lower_digits}, {upper}.{upper_digits}]")
        raise ValueError(f"must be [lower, upper] with lower < upper, but is {list(value)}.{hint}")
    return pair


def prior(value: Any) -> tuple[float, float]:
    """Return the bounds of a uniform prior, or the density from a table or NumPyro distribution."""
    if isinstance(value, Density):
        return value
    if isinstance(value, list | tuple):
        lower, upper = bounds(value)
        return float(lower), float(upper)
    if isinstance(value, Mapping) or is_distribution(value):
        return density_of(value)
    raise ValueError(
        "must be [lower, upper], or a distribution such as { LogNormal = [-5.4, 0.3] }, "
        f"but is {value!r}."
    )


def unequal(value: Any) -> tuple[Any, ...]:
    """Check that all numbers of a list differ; return the list as a tuple."""
    if len(set(numbers(value))) < len(value):
        raise ValueError(f"must not repeat a frequency, but is {list(value)}.")
    return tuple(value)


def nonzero(value: Any) -> tuple[Any, ...]:
    """Check that no number of a list is zero; return the list as a tuple."""
    if 0 in numbers(value):
        raise ValueError(f"must not contain a 0, but is {list(value)}.")
    return tuple(value)


def modes(value: Any) -> tuple[Any, ...] | int:
    """Check and return `modes`: either the number of modes or a list of distinct frequencies."""
    return whole(1)(value) if isinstance(value, int) else unequal(value)


def lag(value: Any) -> float:
    """Return a phase if it lies between -180 and 0 degrees, as a driven response requires."""
    if not -180 < number(value) < 0:
        raise ValueError(
            f"must lie between -180 and 0, -90 at phase resonance, but is {value!r}; the "
            "displacement lags behind the force."
        )
    return float(value)


def _sampling(value: Any) -> float | str:
    if isinstance(value, str) and value:
        return value
    if number(value) <= 0:
        raise ValueError(f"must be positive, but is {value}.")
    return float(value)


def _excluded(value: Any) -> tuple[int | str, ...]:
    items = value if isinstance(value, list | tuple) else [value]
    for item in items:
        if isinstance(item, bool) or not isinstance(item, int | str):
            raise ValueError(f"must be a list of repeat numbers or file names, but is {value!r}.")
        if isinstance(item, int) and item < 0:
            raise ValueError(
                f"must not contain a negative repeat number, but contains {item}; repeats are "
                "counted from zero."
            )
    return tuple(items)


def _by_role(check: Callable[[str, Any], Any], example: Any) -> Callable[[Any], dict[str, Any]]:
    """Return a function that checks a table of one value per quantity and reports all errors."""

    def check_all(value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping) or not value:
            raise ValueError(
                f"must be a table such as {toml({'velocity': example})}, but is {value!r}."
            )
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

    return check_all


def named(value: Any) -> dict[str, str]:
    """Return a table of channels, whose names are arbitrary."""
    if not isinstance(value, Mapping) or not value:
        raise ValueError(f"must be a table such as {toml({'wing': 'acc_2'})}, but is {value!r}.")
    for name, item in value.items():
        if not isinstance(item, str) or not item:
            raise ValueError(f"`{name}` needs a channel's name or path, but has {item!r}.")
    return {text(name): item for name, item in value.items()}


def _path(role: str, item: Any) -> str:
    if not isinstance(item, str) or not item:
        raise ValueError(f"role `{role}` needs a channel's name or path, but has {item!r}.")
    return item


def _unit(role: str, item: Any) -> str:
    if not isinstance(item, str):
        raise ValueError(f"role `{role}` needs a unit, but has {item!r}.")
    # The check accepts the ratio of two units, because a measured FRF is a response per unit of
    # excitation.
    si_of(role, item)
    return item


def _sensitivity(role: str, item: Any) -> str:
    if role not in SENSITIVITIES or not isinstance(item, str):
        raise ValueError(f"role `{role}` needs volts per unit as text, but has {item!r}.")
    sensitivity_of(role, item)
    return item


def _factor(role: str, item: Any) -> float:
    if number(item) == 0:
        raise ValueError(f"the factor of role `{role}` must not be 0.")
    return item


def _spread(role: str, item: Any) -> float:
    if not 0 < number(item) < 1:
        raise ValueError(
            f"the relative standard deviation of role `{role}` must lie between 0 and 1, "
            f"but is {item!r}."
        )
    return item


def _files(value: Any) -> tuple[str, ...] | dict[str, tuple[str, ...]]:
    """Return file patterns, or one pattern per quantity if channels are in several files."""
    if isinstance(value, Mapping):
        return _by_role(lambda _, item: _patterns(item), "laser_*.h5")(value)
    return _patterns(value)


def _patterns(value: Any) -> tuple[str, ...]:
    """Return names or patterns of files; reject Windows paths that TOML misread as escapes."""
    for item in strings(value):
        if not item.isprintable():
            slashed = "".join(c if c.isprintable() else ESCAPES.get(c, "?") for c in item)
            raise ValueError(
                f"must be printable, but is {item!r}: a backslash in double quotes begins an "
                f'escape. Write forward slashes: "{slashed}".'
            )
    return strings(value)


Kind = Annotated[str, OneOf(lambda: KINDS)]
Text = Annotated[str, BeforeValidator(text)]
Number = Annotated[float, BeforeValidator(number)]
Positive = Annotated[float, Field(gt=0), BeforeValidator(number)]
NonNegative = Annotated[float, Field(ge=0), BeforeValidator(number)]
Count = Annotated[int, Field(ge=1), BeforeValidator(whole(1))]
Repeats = Annotated[
    int | Literal["all"],
    BeforeValidator(repeats, json_schema_input_type=Count | Literal["all"]),
]
Index = Annotated[int, Field(ge=0), BeforeValidator(whole(0))]
Strings = Annotated[
    tuple[str, ...], BeforeValidator(strings, json_schema_input_type=str | list[str])
]
Laws = Annotated[
    tuple[str, ...],
    BeforeValidator(
        lambda value: () if value in ([], ()) else strings(value),
        json_schema_input_type=str | list[str],
    ),
]
KindToFit = Annotated[
    str, OneOf(lambda: KINDS, " State tests by name in hold_out to keep them out of every fit.")
]
ToFit = Annotated[
    tuple[KindToFit, ...], BeforeValidator(strings, json_schema_input_type=Kind | list[Kind])
]
Numbers = Annotated[tuple[Positive, ...], BeforeValidator(numbers)]
Levels = Annotated[tuple[NonNegative, ...], BeforeValidator(numbers)]
Frequencies = Annotated[tuple[Positive, ...], BeforeValidator(unequal)]
Shapes = Annotated[tuple[float, ...], BeforeValidator(nonzero)]
Modes = Annotated[
    int | tuple[Positive, ...],
    BeforeValidator(modes, json_schema_input_type=Count | list[Positive]),
]
Bounds = Annotated[tuple[float, float], BeforeValidator(bounds)]
# No other validator follows, because it would convert a density to bounds.
Prior = Annotated[
    tuple[float, float],
    PlainValidator(
        prior,
        json_schema_input_type=tuple[float, float]
        | dict[str, tuple[float, ...] | dict[str, float] | float],
    ),
]
Span = Annotated[tuple[NonNegative, NonNegative], BeforeValidator(bounds)]
Sampling = Annotated[float | str, BeforeValidator(_sampling)]
Excluded = Annotated[
    tuple[int | str, ...],
    BeforeValidator(_excluded, json_schema_input_type=int | str | list[int | str]),
]
Channels = Annotated[
    dict[str, str],
    BeforeValidator(_by_role(_path, "laser"), json_schema_input_type=dict[Role, str]),
]
Named = Annotated[dict[str, str], BeforeValidator(named)]
Units = Annotated[
    dict[str, str],
    BeforeValidator(_by_role(_unit, "mm/s"), json_schema_input_type=dict[Role, str]),
]
Sensitivities = Annotated[
    dict[str, str],
    BeforeValidator(
        _by_role(_sensitivity, "200 mV/(mm/s)"), json_schema_input_type=dict[Role, str]
    ),
]
Factors = Annotated[
    dict[str, float],
    BeforeValidator(_by_role(_factor, 2.5), json_schema_input_type=dict[Role, float]),
]
Lag = Annotated[float, Field(gt=-180, lt=0), BeforeValidator(lag)]
Spread = Annotated[float, Field(gt=0, lt=1), BeforeValidator(number)]
Spreads = Annotated[
    dict[str, float],
    BeforeValidator(_by_role(_spread, 0.01), json_schema_input_type=dict[Role, Spread]),
]
Files = Annotated[
    tuple[str, ...] | dict[str, tuple[str, ...]],
    BeforeValidator(_files, json_schema_input_type=str | list[str] | dict[Role, str | list[str]]),
]
