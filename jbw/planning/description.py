"""The plan file: its typed tables, with ranges of parameters, wanted accuracy and test limits."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, create_model

from jbw.campaign.document import (
    FileTable,
    checked,
    document_of,
    key,
    refuse,
    text_of,
    unknown_tables,
)
from jbw.campaign.settings import JointLaws
from jbw.campaign.values import Count, Index, Positive, number, strings, text, whole
from jbw.errors import ConfigError
from jbw.oscillator.laws import quantities_of
from jbw.planning.beliefs import Range, ranges_of, shares_of, usual_of
from jbw.planning.plan import ResponseNoise
from jbw.planning.proposals import GRIDS, Grid
from jbw.quantities import DEFAULT_LAWS, UNIT_OF, Quantity, must_be
from jbw.report.messages import planning
from jbw.units import quantity_of, to_si

MOTIONS = tuple(UNIT_OF)
POSITIVE = Quantity("positive", "", "1", "a positive number", 0.0)


def _range(value: Any) -> Range:
    """Return [lower, upper] from a number or a pair; raise a ValueError unless both have one sign.

    A coefficient of variation (CV) needs a value that cannot be zero.
    """
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


def _within(quantity: Quantity, bounds: Range) -> Range:
    low, high = bounds
    if (must := must_be(quantity, low)) is not None:
        shown = f"{low:g}" if low == high else f"[{low:g}, {high:g}]"
        raise ValueError(f"must be {must}, but is {shown}.")
    return bounds


def _part(bounds: Range) -> Range:
    """Return the range of a stiffness share; raise a ValueError unless it lies below one."""
    if bounds[1] >= 1:
        raise ValueError(
            "must lie between 0 and 1 (share of the stiffness), but its upper end is "
            f"{bounds[1]:g}."
        )
    return bounds


def _motion_unit(value: Any) -> str:
    quantity_of(text(value), MOTIONS)
    return value


def _fraction(value: Any) -> float:
    if not 0 < number(value) < 1:
        raise ValueError(f"must lie between 0 and 1 (0.05 for 5 %), but is {value}.")
    return float(value)


AnyRange = Annotated[Range, BeforeValidator(_range, json_schema_input_type=float | Range)]
PositiveRange = Annotated[AnyRange, AfterValidator(partial(_within, POSITIVE))]
Part = Annotated[PositiveRange, AfterValidator(_part)]


class PlanTable(FileTable):
    """The [plan] table of a plan file; parameters of the laws are added separately."""

    natural_hz: PositiveRange | None = key(None, "natural frequency at small amplitude [Hz]")
    omega_n: PositiveRange | None = key(None, "natural frequency [rad/s], instead of natural_hz")
    zeta: PositiveRange = key((0.002, 0.01), "viscous damping ratio [-]")
    gain: PositiveRange | None = key(None, "force per modal mass for one volt [N/kg/V]")
    modal_mass: PositiveRange | None = key(None, "modal mass [kg], if the input is a force in N")
    noise: Positive | None = key(
        None, "standard deviation of a sample of the response, in noise_unit"
    )
    noise_unit: Annotated[str, BeforeValidator(_motion_unit)] = key(
        "m/s", "unit of the noise, which also states the measured quantity"
    )
    fs: Positive | None = key(None, "sampling frequency [Hz]")
    wanted: tuple[str, ...] | None = key(
        None, "parameters to determine; by default all parameters of the laws"
    )
    cv: Annotated[float, BeforeValidator(_fraction)] = key(
        0.05, "required coefficient of variation [-]"
    )
    max_input: Positive | None = key(None, "largest input [V, N or N/kg]")
    max_displacement: Positive | None = key(None, "largest displacement [m]")
    max_repeats: Count = key(1000, "largest number of repeats")
    joints: Annotated[int, Field(ge=2), BeforeValidator(whole(2))] = key(
        16, "number of joints drawn"
    )
    seed: Index = key(0, "seed of the draws")


@cache
def plan_table(laws: tuple[str, ...] = DEFAULT_LAWS) -> type[PlanTable]:
    """Return the class of the [plan] table for these laws, whose parameters are further keys."""
    fields: dict[str, Any] = {}
    for quantity in quantities_of(laws):
        kind: Any = Annotated[AnyRange, AfterValidator(partial(_within, quantity))]
        fields[quantity.name] = kind | None, key(None, f"{quantity.meaning} [{quantity.unit}]")
    words = Literal["omega_n", "zeta", *fields]  # pyright: ignore[reportInvalidTypeForm]
    check = BeforeValidator(strings, json_schema_input_type=words | list[words])
    says = PlanTable.model_fields["wanted"].description or ""
    field: Any = Annotated[tuple[words, ...] | None, check], key(None, says)
    part: Any = Part
    for share, name in shares_of(laws).items():
        fields[share] = part | None, key(None, planning.share_of(name))
    return create_model("PlanTable", __base__=PlanTable, wanted=field, **fields)


TABLES: dict[str, type[FileTable]] = {"joint": JointLaws, "plan": PlanTable, **GRIDS}


def plan_file() -> type[FileTable]:
    """Return the class of the whole plan file, from which editors get its JSON Schema."""
    fields: dict[str, Any] = {name: (table | None, None) for name, table in TABLES.items()}
    fields["plan"] = plan_table() | None, None
    return create_model("PlanFile", __base__=FileTable, **fields)


@dataclass(frozen=True)
class Description:
    """A checked plan file, with None for values that it does not state."""

    # ranges of the joint's parameters, and of the gain unless it has one value
    ranges: Mapping[str, Range]
    # force per modal mass and per unit of the input, if it is known exactly
    gain: float | None = None
    input_unit: str | None = None  # unit of the input: V, N or N/kg
    noise: ResponseNoise | None = None  # noise of the response
    settings: PlanTable = field(default_factory=PlanTable)
    grids: Mapping[str, Grid] = field(default_factory=dict)  # candidate tests by kind
    laws: tuple[str, ...] = DEFAULT_LAWS


def read_description(path: Path, *, of_run: bool = False) -> Description:
    """Read and check a plan file."""
    source = text_of(path, "Plan file", planning.WRITE_PLAN)
    return parse(source, path.name, of_run=of_run)


def parse(source: str, file: str = "plan.toml", *, of_run: bool = False) -> Description:
    """Parse and check the text of a plan file; report all errors together."""
    document = document_of(source, file)
    errors = unknown_tables(document, TABLES)
    joint = checked(JointLaws, document.get("joint", {}), "[joint]", errors) or JointLaws()
    try:
        laws, model = joint.laws, plan_table(joint.laws)
    except ConfigError as error:
        errors.append(f"[joint] laws: {error}")
        laws, model = DEFAULT_LAWS, plan_table()
    table = document.get("plan", {})
    plan = checked(model, table, "[plan]", errors)
    table = set(table) if isinstance(table, dict) else set()
    pairs = [("natural_hz", "omega_n"), *shares_of(laws).items(), ("gain", "modal_mass")]
    faults = [
        f": give {first} or {second}, not both."
        for first, second in pairs
        if {first, second} <= table
    ]
    faults += _told_by_run(plan, table, laws) if of_run else _missing(plan, table, laws)
    errors += [f"[plan]{line}" for line in faults]
    if of_run and "joint" in document:
        errors.append(planning.told_by_run("[joint]"))
    grids = {
        name: grid
        for name, table in GRIDS.items()
        if name in document and (grid := checked(table, document[name], f"[{name}]", errors))
    }
    refuse(file, errors)
    plan = plan or PlanTable()
    gain, unit, ranges = _force(plan)
    return Description(
        ranges={} if of_run else {**ranges_of(_omega_n(plan), plan.model_dump(), laws), **ranges},
        gain=gain,
        input_unit=unit,
        noise=_noise(plan),
        settings=plan,
        grids=grids,
        laws=laws,
    )


def _told_by_run(plan: PlanTable | None, stated_keys: set[str], laws: tuple[str, ...]) -> list[str]:
    names = ("natural_hz", "omega_n", "zeta", *shares_of(laws))
    joint = (*names, *(quantity.name for quantity in quantities_of(laws)))
    faults = [planning.told_by_run(f" {name}") for name in joint if name in stated_keys]
    return faults + [
        planning.single_value(name, plan[name])
        for name in ("gain", "modal_mass")
        if plan and plan[name] and plan[name][0] != plan[name][1]
    ]


def _missing(plan: PlanTable | None, stated_keys: set[str], laws: tuple[str, ...]) -> list[str]:
    """Return the errors of missing keys and of joints stiffer than the whole structure."""
    faults, usual, fields = [], usual_of(laws), plan_table(laws).model_fields
    tells_frequency = bool({"natural_hz", "omega_n"} & stated_keys)
    if not tells_frequency:
        faults.append(planning.missing("natural_hz", str(fields["natural_hz"].description)))
    names = [quantity.name for quantity in quantities_of(laws) if quantity.name not in usual]
    faults += [
        planning.missing(name, str(fields[name].description))
        for name in (*names, "noise")
        if name not in stated_keys
    ]
    if plan is None or not tells_frequency:
        return faults
    least = _omega_n(plan)[0] ** 2
    return faults + [
        planning.beyond_stiffness(quantity.name, least, plan[quantity.name][1])
        for quantity in quantities_of(laws)
        if quantity.is_share and (plan[quantity.name] or (0, 0))[1] >= least
    ]


def _omega_n(plan: PlanTable) -> Range:
    if plan.omega_n is not None:
        return plan.omega_n
    low, high = plan["natural_hz"]
    return 2 * np.pi * low, 2 * np.pi * high


def _force(plan: PlanTable) -> tuple[float | None, str | None, dict[str, Range]]:
    """Return the gain (None if it has a range), the input's unit, and the range of the gain."""
    if plan.gain is not None:
        low, high, unit = *plan.gain, "V"
    elif plan.modal_mass is not None:
        low, high, unit = 1 / plan.modal_mass[1], 1 / plan.modal_mass[0], "N"
    else:
        return None, None, {}
    return (low, unit, {}) if low == high else (None, unit, {"gain": (low, high)})


def _noise(plan: PlanTable) -> ResponseNoise | None:
    if plan.noise is None:
        return None
    quantity = quantity_of(plan.noise_unit, MOTIONS)
    return ResponseNoise(float(to_si(plan.noise, plan.noise_unit, quantity)), quantity)
