"""From a plan file to what is believed, wanted and possible; all errors at once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jbw.campaign.document import checked_table, document_of, refuse, text_of, unknown_tables
from jbw.planning.keys import JOINT_KEYS, MOTIONS, TABLES, Range
from jbw.planning.proposals import Grid
from jbw.planning.prospects import Noise
from jbw.units import quantity_of, to_si

ZETA = (0.002, 0.01)
SHARE = (0.01, 0.1)
OPENING = (0.05, 0.3)  # gamma over delta
GRID_KEYS = {"frequencies": "frequencies_hz", "span": "span_hz"}
HELD_BACK = {"noise", "noise_unit", "gain", "modal_mass", *JOINT_KEYS}


@dataclass(frozen=True)
class Description:
    """A plan file, checked.

    Attributes:
        ranges: Of the joint's parameters, and of the gain where it is no single value.
        gain: Force per modal mass for one unit of the input where it is known exactly; None where
            nothing is said of it.
        input_unit: V, N or N/kg; None where nothing says it.
        noise: Of the response; None where it is not given.
        settings: The other keys of [plan].
        grids: Candidates by kind.
    """

    ranges: Mapping[str, Range]
    gain: float | None = None
    input_unit: str | None = None
    noise: Noise | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    grids: Mapping[str, Grid] = field(default_factory=dict)


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
    tables = {
        name: checked_table(document[name], keys, f"[{name}]", errors)
        for name, keys in TABLES.items()
        if name in document
    }
    plan = tables.pop("plan", {})
    errors += _contradictions(plan, document.get("plan", {}), of_run)
    errors += [line for name, table in tables.items() for line in _times(name, table)]
    refuse(file, errors)
    gain, unit, ranges = _force(plan)
    return Description(
        ranges={} if of_run else {**_joint(plan), **ranges},
        gain=gain,
        input_unit=unit,
        noise=_noise(plan),
        settings={key: value for key, value in plan.items() if key not in HELD_BACK},
        grids={kind: _grid(table) for kind, table in tables.items()},
    )


def _contradictions(plan: Mapping[str, Any], given: Any, of_run: bool) -> list[str]:
    """Keys that are missing, or say the same twice."""
    given = given if isinstance(given, dict) else {}
    told = [
        f"[plan]: give {one} or {other}, not both."
        for one, other in (("natural_hz", "omega_n"), ("share", "alpha"), ("gain", "modal_mass"))
        if one in given and other in given
    ]
    if of_run:
        told += [
            f"[plan] {key}: the run tells it; leave it out." for key in JOINT_KEYS if key in given
        ]
        told += [
            f"[plan] {key}: must be a single value beside a run, but is {list(plan[key])}."
            for key in ("gain", "modal_mass")
            if key in plan and plan[key][0] != plan[key][1]
        ]
        return told
    if not {"natural_hz", "omega_n"} & set(given):
        told.append("[plan] natural_hz: missing; natural frequency at small amplitude [Hz].")
    for key in ("delta", "noise"):
        if key not in given:
            told.append(f"[plan] {key}: missing; {TABLES['plan'][key].says}.")
    if "alpha" in plan and {"natural_hz", "omega_n"} & set(plan):
        least = _omega_n(plan)[0] ** 2
        if plan["alpha"][1] >= least:
            told.append(
                f"[plan] alpha: must stay below omega_n^2, which begins at {least:g}, "
                f"but reaches {plan['alpha'][1]:g}."
            )
    return told


def _times(kind: str, table: Mapping[str, Any]) -> list[str]:
    if "dwell" in table and table.get("settle", 0.0) >= table["dwell"]:
        return [
            f"[{kind}] settle: must be shorter than dwell ({table['dwell']:g} s), "
            f"but is {table['settle']:g}."
        ]
    return []


def _omega_n(plan: Mapping[str, Any]) -> Range:
    if "omega_n" in plan:
        return plan["omega_n"]
    low, high = plan["natural_hz"]
    return 2 * np.pi * low, 2 * np.pi * high


def _joint(plan: Mapping[str, Any]) -> dict[str, Range]:
    """Ranges of the joint's five parameters, defaults where nothing is said."""
    low, high = sorted(map(abs, plan["delta"]))
    stiffness = "alpha" if "alpha" in plan else "share"
    return {
        "omega_n": _omega_n(plan),
        "zeta": plan.get("zeta", ZETA),
        stiffness: plan.get(stiffness, SHARE),
        "delta": plan["delta"],
        "gamma": plan.get("gamma", (OPENING[0] * low, OPENING[1] * high)),
    }


def _force(plan: Mapping[str, Any]) -> tuple[float | None, str | None, dict[str, Range]]:
    """Gain where it is one value, unit of the input, and the gain's range where it is none."""
    if "gain" in plan:
        low, high, unit = *plan["gain"], "V"
    elif "modal_mass" in plan:
        low, high, unit = 1 / plan["modal_mass"][1], 1 / plan["modal_mass"][0], "N"
    else:
        return None, None, {}
    return (low, unit, {}) if low == high else (None, unit, {"gain": (low, high)})


def _noise(plan: Mapping[str, Any]) -> Noise | None:
    if "noise" not in plan:
        return None
    unit = plan.get("noise_unit", "m/s")
    quantity = quantity_of(unit, MOTIONS)
    return Noise(float(to_si(plan["noise"], unit, quantity)), quantity)


def _grid(table: Mapping[str, Any]) -> Grid:
    return Grid(**{GRID_KEYS.get(key, key): value for key, value in table.items()})
