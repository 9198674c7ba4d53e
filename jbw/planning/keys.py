"""The tables of a plan file, typed: those of the joint are its laws' own; and an example of all."""

from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, create_model

from jbw.campaign.document import Table, key
from jbw.campaign.settings import DEFAULT_LAWS, Joint
from jbw.campaign.values import (
    Count,
    Index,
    NonNegative,
    Numbers,
    Positive,
    Span,
    number,
    strings,
    text,
    whole,
)
from jbw.quantities import UNIT_OF
from jbw.units import quantity_of

MOTIONS = tuple(UNIT_OF)
Range = tuple[float, float]
STIFFNESS = "1/s^2"  # unit of a part of omega_n^2
# Where nothing is said of a law's parameter: its range, or its range as parts of another's.
RANGES = {"share": (0.01, 0.1)}
PARTS = {"gamma": ("delta", (0.05, 0.3))}


def _range(value: Any) -> Range:
    """A number that is not zero, or [lower, upper] of one sign."""
    if not isinstance(value, list | tuple):
        value = [value, value]
    elif len(value) != 2:
        raise ValueError(f"must be a number or [lower, upper], but is {value!r}.")
    low, high = number(value[0]), number(value[1])
    if not (low * high > 0 and low <= high):
        raise ValueError(
            f"must be a number other than 0, or [lower, upper] of one sign with lower < upper, "
            f"but is {value}; bound it away from zero."
        )
    return float(low), float(high)


def _positive_range(value: Any) -> Range:
    low, high = _range(value)
    if low < 0:
        raise ValueError(f"must be positive, but is {value}.")
    return low, high


def _part(value: Any) -> Range:
    """A positive range below one: the rest is the stiffness beside the joint."""
    low, high = _positive_range(value)
    if high >= 1:
        raise ValueError(
            f"must lie between 0 and 1, a part of the stiffness, but reaches {high:g}."
        )
    return low, high


def _motion_unit(value: Any) -> str:
    quantity_of(text(value), MOTIONS)
    return value


def _fraction(value: Any) -> float:
    if not 0 < number(value) < 1:
        raise ValueError(f"must lie between 0 and 1, 0.05 for 5 %, but is {value}.")
    return float(value)


AnyRange = Annotated[Range, BeforeValidator(_range, json_schema_input_type=float | Range)]
PositiveRange = Annotated[
    Range, BeforeValidator(_positive_range, json_schema_input_type=float | Range)
]
Part = Annotated[Range, BeforeValidator(_part, json_schema_input_type=float | Range)]


class PlanTable(Table):
    """The [plan] table but for the parameters of the laws; every default stands here."""

    natural_hz: PositiveRange | None = key(None, "natural frequency at small amplitude [Hz]")
    omega_n: PositiveRange | None = key(None, "the same [rad/s], instead")
    zeta: PositiveRange = key((0.002, 0.01), "viscous damping ratio [-]")
    gain: PositiveRange | None = key(None, "force per modal mass for one volt [N/kg/V]")
    modal_mass: PositiveRange | None = key(None, "[kg], where the input is a force in N")
    noise: Positive | None = key(
        None, "standard deviation of a sample of the response, in noise_unit"
    )
    noise_unit: Annotated[str, BeforeValidator(_motion_unit)] = key(
        "m/s", "its unit, which says what is measured"
    )
    fs: Positive | None = key(None, "sampling frequency [Hz]")
    wanted: tuple[str, ...] | None = key(None, "parameters to be known; by default the laws'")
    cv: Annotated[float, BeforeValidator(_fraction)] = key(
        0.05, "their wished coefficient of variation [-]"
    )
    max_input: Positive | None = key(None, "largest input [V, N or N/kg]")
    max_displacement: Positive | None = key(None, "largest displacement [m]")
    max_repeats: Count = key(1000, "most repeats of a test")
    joints: Annotated[int, Field(ge=2), BeforeValidator(whole(2))] = key(
        16, "how many joints are drawn from the ranges"
    )
    seed: Index = key(0, "of the draws")


def shares_of(laws: tuple[str, ...]) -> dict[str, str]:
    """Names that stand for a stiffness of a law as a share of omega_n^2, and the stiffness."""
    from jbw.oscillator.laws import laws_named  # loads JAX, which the example needs not

    return {
        monomial.name: name
        for law in laws_named(laws)
        for coordinates in law.coordinates.values()
        for monomial in coordinates.inverse
        for name in law.names()
        if monomial.powers == {name: 1, "omega_n": -2}
    }


@cache
def plan_table(laws: tuple[str, ...]) -> type[PlanTable]:
    """The [plan] table of a joint with these laws, whose parameters are keys too.

    Raises:
        ConfigError: An unknown law, or laws that cannot stand beside each other.
    """
    from jbw.oscillator.laws import quantities_of

    fields: dict[str, Any] = {}
    for quantity in quantities_of(laws):
        kind: Any = AnyRange if quantity.least is None else PositiveRange
        fields[quantity.name] = kind | None, key(None, f"{quantity.meaning} [{quantity.unit}]")
    words = Literal["omega_n", "zeta", *fields]  # pyright: ignore[reportInvalidTypeForm]
    check = BeforeValidator(strings, json_schema_input_type=words | list[words])
    says = PlanTable.model_fields["wanted"].description or ""
    wanted: Any = Annotated[tuple[words, ...] | None, check], key(None, says)
    part: Any = Part
    for share, name in shares_of(laws).items():
        fields[share] = part | None, key(None, f"{name} / omega_n^2, instead of {name}")
    return create_model("PlanTable", __base__=PlanTable, wanted=wanted, **fields)


class SweepTable(Table):
    """The [sweep] table."""

    levels: Numbers | None = key(None, "peaks of the input [V, N or N/kg]")
    span: Span | None = key(None, "first and last frequency [Hz]")
    rates: Numbers | None = key(None, "sweep rates [Hz/s]")
    rest: NonNegative | None = key(None, "free decay recorded behind the burst [s]")


class TonesTable(Table):
    """The [tones] table."""

    levels: Numbers | None = key(None, "peaks of the input [V, N or N/kg]")
    frequencies: Numbers | None = key(None, "tones, each alone [Hz]")
    dwell: Positive | None = key(None, "time on each frequency [s]")
    settle: NonNegative | None = key(None, "of that, the first part, which is discarded [s]")


class SteppedTable(TonesTable):
    """The [stepped] table."""

    frequencies: Numbers | None = key(None, "steps, in turn [Hz]")


TABLES: dict[str, type[Table]] = {
    "joint": Joint,
    "plan": PlanTable,
    "sweep": SweepTable,
    "tones": TonesTable,
    "stepped": SteppedTable,
}


def plan_file(laws: tuple[str, ...] = DEFAULT_LAWS) -> type[Table]:
    """The whole file, as its JSON Schema tells it to editors."""
    fields: dict[str, Any] = {name: (table | None, None) for name, table in TABLES.items()}
    fields["plan"] = plan_table(laws) | None, None
    return create_model("PlanFile", __base__=Table, **fields)


EXAMPLE = Path(__file__).with_name("example.toml").read_text(encoding="utf-8")
