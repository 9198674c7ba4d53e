"""Files of records and campaigns: CSV as recorders write it, a campaign file, and true values."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .campaigns import Campaign, Member
from .plants import Rng, loop_of
from .records import Drawn

UNITS = {
    "displacement": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "acceleration": {"m/s^2": 1.0, "g": 9.80665},
    "force": {"N": 1.0, "kN": 1e3},
    "restoring_force": {"N": 1.0, "kN": 1e3},
}
TIMES = ("decimals", "exact", "none")
TRUTH_POINTS, TRUTH_RANGE = 12, 50.0


@dataclass(frozen=True)
class Layout:
    """The format in which a recorder writes its files.

    Attributes:
        units: Unit of each role.
        names: Name of each role in the header.
        time: `decimals` (six digits), `exact`, or `none` if the campaign states the rate.
        units_in: Where units stand in the header: `brackets`, `parentheses` or `nowhere`.
        delimiter: Delimiter between columns.
    """

    units: dict[str, str]
    names: dict[str, str]
    time: str
    units_in: str
    delimiter: str


def layout(rng: Rng, roles: Sequence[str], times: Sequence[str] = TIMES) -> Layout:
    """Draw the format of a recorder's files."""
    units = {role: str(rng.choice(list(UNITS[role]))) for role in roles}
    short = {"displacement": "disp", "velocity": "vel", "acceleration": "acc", "force": "F",
             "restoring_force": "load"}  # fmt: skip
    plain = rng.random() < 0.7
    return Layout(
        units, {role: role if plain else short[role] for role in roles},
        str(rng.choice(times)),
        str(rng.choice(["brackets", "parentheses", "nowhere"])),
        str(rng.choice([",", ";"])),
    )  # fmt: skip


def write_csv(path: Path, drawn: Drawn, how: Layout) -> None:
    """Write a record to a CSV file."""
    forms = {"brackets": " [{}]", "parentheses": " ({})", "nowhere": ""}
    columns, heads = [], []
    if how.time != "none":
        t = np.arange(len(drawn.x)) / drawn.fs
        # Use six decimals, or as many as distinguish samples: fewer would be a fault of the
        # recorder.
        digits = max(6, int(np.ceil(np.log10(drawn.fs))) + 2)
        form = f".{digits}f" if how.time == "decimals" else ".17g"
        columns.append([format(value, form) for value in t])
        heads.append("time" + forms[how.units_in].format("s"))
    for role, x in drawn.channels.items():
        factor = UNITS[role][how.units[role]]
        columns.append([f"{value:.9g}" for value in x / factor])
        heads.append(how.names[role] + forms[how.units_in].format(how.units[role]))
    lines = [how.delimiter.join(row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([how.delimiter.join(heads), *lines]) + "\n")


def write_campaign(folder: Path, made: Campaign, rng: Rng, times: Sequence[str] = TIMES) -> Path:
    """Write records, campaign.toml and truth.json; return the path of the campaign file."""
    folder.mkdir(parents=True, exist_ok=True)
    roles = dict.fromkeys(role for one in made.members for role in one.drawn.channels)
    how, mass = layout(rng, list(roles), times), made.members[0].drawn.mass
    files, tables = [], {}
    for number, one in enumerate(made.members):
        repeat = sum(other.test == one.test for other in made.members[:number]) + 1
        files.append(f"{one.test}_{repeat}.csv")
        write_csv(folder / files[-1], one.drawn, how)
        tables.setdefault(one.test, []).append((files[-1], one))
    driven = any("force" in one.drawn.channels for one in made.members)
    head = ["[campaign]", 'name = "outside"', *([f"modal_mass = {mass:.9g}"] if driven else [])]
    # Decays of one mode share a band, and so do tests of any other kind: that of the first test.
    bands = {one.drawn.kind: one.drawn.band for one in reversed(made.members)}
    tests = (_test(name, rows, how, bands) for name, rows in tables.items())
    text = "\n".join([*head, *tests]) + "\n"
    path = folder / "campaign.toml"
    path.write_text(text)
    truth = {"campaign": made.name, "law": made.law, "fault": made.fault, "size": made.size,
             "facts": made.facts, "records": {}}  # fmt: skip
    for file, one in zip(files, made.members, strict=True):
        truth["records"][file] = truth_of_record(one)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1, default=float))
    return path


def _test(
    name: str, rows: list[tuple[str, Member]], how: Layout, bands: dict[str, tuple[float, float]]
) -> str:
    """Return the [[test]] table of a test's records."""
    first = rows[0][1].drawn
    names = {role: how.names[role] for role in first.channels}
    if how.units_in != "nowhere":
        form = " [{}]" if how.units_in == "brackets" else " ({})"
        names = {role: named + form.format(how.units[role]) for role, named in names.items()}
    units = {role: how.units[role] for role in first.channels}
    lines = ["", "[[test]]", f'kind = "{first.kind}"', f'name = "{name}"']
    lines.append(f"files = {json.dumps([file for file, _ in rows])}")
    if how.time == "none":
        lines.append(f"fs = {first.fs:.12g}")
    else:
        form = {"brackets": " [s]", "parentheses": " (s)", "nowhere": ""}[how.units_in]
        names, units = {"time": "time" + form, **names}, {"time": "s", **units}
    lines += [f"channels = {_inline(names)}", f"units = {_inline(units)}"]
    if first.kind in ("decay", "noise", "multisine"):
        low, high = bands[first.kind]
        lines.append(f"band = [{low:.6g}, {min(high, 0.45 * first.fs):.6g}]")
    if "periods" in first.facts:
        lines.append(f"periods = {first.facts['periods']}")
    if rows[0][1].session:
        lines.append(f'run = "{rows[0][1].session}"')
    return "\n".join(lines)


def _inline(table: dict[str, str]) -> str:
    return "{ " + ", ".join(f"{key} = {json.dumps(text)}" for key, text in table.items()) + " }"


def truth_of_record(one: Member) -> dict[str, Any]:
    """Return the true values behind a record as plain values."""
    drawn = one.drawn
    plant = {name: value for name, value in asdict(drawn.plant).items() if value}
    facts = {
        "test": one.test, "kind": drawn.kind, "law": drawn.law, "strong": drawn.strong,
        "level": one.level, "session": one.session, "hz": drawn.hz, "zeta": drawn.zeta,
        "length": drawn.length, "mass": drawn.mass, "fs": drawn.fs, "noise": drawn.noise,
        "bits": drawn.bits, "fault": drawn.fault, "size": drawn.size, "facts": dict(drawn.facts),
        "plant": plant,
    }  # fmt: skip
    if drawn.kind == "loop":
        top, stiffness = drawn.facts["amplitudes"][-1], drawn.facts["stiffness"]
        rate = 1 / (drawn.facts["seconds"] * drawn.hz)  # frequency of a cycle over omega_n
        loops = [
            (y, *loop_of(drawn.plant, y / drawn.length, rate)) for y in drawn.facts["amplitudes"]
        ]
        work = stiffness * drawn.length**2
        facts["loops"] = [(y, stiffness * secant, work * energy) for y, secant, energy in loops]
        return facts | {"top": top}
    top = drawn.top * drawn.length
    amplitude = np.geomspace(top / TRUTH_RANGE, top, TRUTH_POINTS)
    hz, zeta = drawn.true_at(amplitude)
    return facts | {"top": top, "by_amplitude": np.stack([amplitude, hz, zeta], 1).tolist()}
