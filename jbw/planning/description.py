"""From a plan file to what is believed, wanted and possible; all errors at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jbw.campaign.document import checked, document_of, refuse, text_of, unknown_tables
from jbw.campaign.settings import DEFAULT_LAWS, Joint
from jbw.errors import ConfigError
from jbw.oscillator.laws import quantities_of
from jbw.planning.keys import (
    MOTIONS,
    PARTS,
    RANGES,
    STIFFNESS,
    TABLES,
    PlanTable,
    Range,
    plan_table,
    shares_of,
)
from jbw.planning.plan import Noise
from jbw.planning.proposals import Grid
from jbw.units import quantity_of, to_si

GRID_KEYS = {"frequencies": "frequencies_hz", "span": "span_hz"}


@dataclass(frozen=True)
class Description:
    """A plan file, checked.

    Attributes:
        ranges: Of the joint's parameters, and of the gain where it is no single value.
        gain: Force per modal mass for one unit of the input where it is known exactly; None where
            nothing is said of it.
        input_unit: V, N or N/kg; None where nothing says it.
        noise: Of the response; None where it is not given.
        settings: The [plan] table.
        grids: Candidates by kind.
        laws: Laws of the joint.
    """

    ranges: Mapping[str, Range]
    gain: float | None = None
    input_unit: str | None = None
    noise: Noise | None = None
    settings: PlanTable = field(default_factory=PlanTable)
    grids: Mapping[str, Grid] = field(default_factory=dict)
    laws: tuple[str, ...] = DEFAULT_LAWS


def read_description(path: Path, *, of_run: bool = False) -> Description:
    """Read and check a plan file.

    Args:
        path: The TOML file.
        of_run: Whether a run tells the joint, so that the file must not.

    Raises:
        ConfigError: No such file, not UTF-8 TOML, or against the schema.
    """
    source = text_of(path, "Plan file", "Write one with: jbw plan --example > plan.toml")
    return parse(source, path.name, of_run=of_run)


def parse(source: str, file: str = "plan.toml", *, of_run: bool = False) -> Description:
    """Check the text of a plan file.

    Args:
        source: TOML text.
        file: Its name, for messages.
        of_run: Whether a run tells the joint, so that the file must not.

    Raises:
        ConfigError: Not TOML, or anything unknown, missing or of the wrong type; all at once.
    """
    document = document_of(source, file)
    errors = unknown_tables(document, TABLES)
    laws, model = _laws(document.get("joint", {}), errors)
    given = document.get("plan", {})
    plan = checked(model, given, "[plan]", errors)
    errors += _contradictions(plan, given, laws, of_run)
    if of_run and "joint" in document:
        errors.append("[joint]: the run tells it; leave it out.")
    grids = {}
    for name in ("sweep", "tones", "stepped"):
        if name in document:
            table = checked(TABLES[name], document[name], f"[{name}]", errors)
            grids[name] = {} if table is None else dict(table)
            errors += _times(name, grids[name])
    refuse(file, errors)
    plan = plan or PlanTable()
    gain, unit, ranges = _force(plan)
    return Description(
        ranges={} if of_run else {**_joint(plan, laws), **ranges},
        gain=gain,
        input_unit=unit,
        noise=_noise(plan),
        settings=plan,
        grids={kind: _grid(table) for kind, table in grids.items()},
        laws=laws,
    )


def _laws(given: Any, errors: list[str]) -> tuple[tuple[str, ...], type[PlanTable]]:
    """Laws of the joint, and the table whose keys are their parameters."""
    joint = checked(Joint, given, "[joint]", errors) or Joint()
    try:
        return joint.laws, plan_table(joint.laws)
    except ConfigError as error:
        errors.append(f"[joint] laws: {error}")
        return DEFAULT_LAWS, plan_table(DEFAULT_LAWS)


def _contradictions(
    plan: PlanTable | None, given: Any, laws: tuple[str, ...], of_run: bool
) -> list[str]:
    """Keys that are missing, or say the same twice."""
    given = given if isinstance(given, dict) else {}
    shares = shares_of(laws)
    pairs = [("natural_hz", "omega_n"), *shares.items(), ("gain", "modal_mass")]
    told = [
        f"[plan]: give {one} or {other}, not both."
        for one, other in pairs
        if one in given and other in given
    ]
    quantities = quantities_of(laws)
    if of_run:
        joint = ("natural_hz", "omega_n", "zeta", *shares, *(q.name for q in quantities))
        told += [f"[plan] {key}: the run tells it; leave it out." for key in joint if key in given]
        told += [
            f"[plan] {key}: must be a single value beside a run, but is {list(plan[key])}."
            for key in ("gain", "modal_mass")
            if plan and plan[key] and plan[key][0] != plan[key][1]
        ]
        return told
    if not {"natural_hz", "omega_n"} & set(given):
        told.append("[plan] natural_hz: missing; natural frequency at small amplitude [Hz].")
    told += [
        f"[plan] {name}: missing; {plan_table(laws).model_fields[name].description}."
        for name in (*_without_default(laws), "noise")
        if name not in given
    ]
    least = _omega_n(plan)[0] ** 2 if plan and {"natural_hz", "omega_n"} & set(given) else np.inf
    for name in [quantity.name for quantity in quantities if quantity.unit == STIFFNESS]:
        if plan and plan[name] and plan[name][1] >= least:
            told.append(
                f"[plan] {name}: must stay below omega_n^2, which begins at {least:g}, "
                f"but reaches {plan[name][1]:g}."
            )
    return told


def _without_default(laws: Sequence[str]) -> list[str]:
    """Parameters of the laws that must be told: no default stands for them."""
    bounded = {name for share, name in shares_of(tuple(laws)).items() if share in RANGES}
    return [q.name for q in quantities_of(laws) if q.name not in bounded | set(PARTS)]


def _times(kind: str, table: Mapping[str, Any]) -> list[str]:
    if "dwell" in table and table.get("settle", 0.0) >= table["dwell"]:
        return [
            f"[{kind}] settle: must be shorter than dwell ({table['dwell']:g} s), "
            f"but is {table['settle']:g}."
        ]
    return []


def _omega_n(plan: PlanTable) -> Range:
    if plan.omega_n is not None:
        return plan.omega_n
    low, high = plan["natural_hz"]
    return 2 * np.pi * low, 2 * np.pi * high


def _joint(plan: PlanTable, laws: tuple[str, ...]) -> dict[str, Range]:
    """Ranges of all of the joint's parameters, defaults where nothing is said."""
    ranges = {"omega_n": _omega_n(plan), "zeta": plan.zeta}
    share_of = {name: share for share, name in shares_of(laws).items()}
    for quantity in quantities_of(laws):
        name = quantity.name
        share = share_of.get(name, "")
        if plan[name] is not None:
            ranges[name] = plan[name]
        elif share:
            ranges[share] = plan[share] or RANGES[share]
        else:
            whole, (least, most) = PARTS[name]
            low, high = sorted(map(abs, plan[whole]))
            ranges[name] = least * low, most * high
    return ranges


def _force(plan: PlanTable) -> tuple[float | None, str | None, dict[str, Range]]:
    """Gain where it is one value, unit of the input, and the gain's range where it is none."""
    if plan.gain is not None:
        low, high, unit = *plan.gain, "V"
    elif plan.modal_mass is not None:
        low, high, unit = 1 / plan.modal_mass[1], 1 / plan.modal_mass[0], "N"
    else:
        return None, None, {}
    return (low, unit, {}) if low == high else (None, unit, {"gain": (low, high)})


def _noise(plan: PlanTable) -> Noise | None:
    if plan.noise is None:
        return None
    quantity = quantity_of(plan.noise_unit, MOTIONS)
    return Noise(float(to_si(plan.noise, plan.noise_unit, quantity)), quantity)


def _grid(table: Mapping[str, Any]) -> Grid:
    return Grid(**{GRID_KEYS.get(key, key): value for key, value in table.items()})
