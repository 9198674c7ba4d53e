"""Whole campaigns: several tests of one structure, which may differ in level, day or torque.

A campaign has one specimen; sessions change its frequency, torque, or the mass of a sensor.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .faults import FAULTS, VISIBLE, Fault, spoilt
from .plants import Rng, log_uniform
from .records import ANY, KINDS, Choice, Drawn, Specimen, recorded, specimen

LEVELS = (1.0, 3.0, 10.0)  # approximate ratios of the levels of three tests


@dataclass(frozen=True)
class Member:
    """One record of a campaign.

    Attributes:
        test: Name of its test; records of one test are its repeats.
        drawn: The record.
        level: Level of the test relative to the strongest one.
        session: Name of the day, torque or sensor; empty if there is only one.
    """

    test: str
    drawn: Drawn
    level: float
    session: str = ""


@dataclass(frozen=True)
class Campaign:
    """Several tests of a specimen.

    Attributes:
        name: Kind of campaign: decays, sweeps, mixed, sessions and so on.
        specimen: The structure.
        members: Records by test.
        facts: What differs between sessions.
        fault: Name of the fault; empty for a sound campaign.
        size: Size of the fault, and the records that have it.
    """

    name: str
    specimen: Specimen
    members: tuple[Member, ...]
    facts: dict[str, Any]
    fault: str = ""
    size: str = ""

    @property
    def law(self) -> str:
        """The law of the joint."""
        return self.specimen.law


Make = Callable[[Rng, Drawn], Drawn]


def _levels(rng: Rng, count: int = 3) -> list[float]:
    """Draw levels that begin at one and fall by a factor of about three each."""
    steps = np.append(0.0, np.cumsum(rng.uniform(0.8, 1.4, count - 1)))
    return [float(3.0**-step) for step in steps]


def _tests(
    rng: Rng, one: Specimen, kind: str, levels: list[float], repeats: int, session: str = ""
) -> list[Member]:
    """Draw perfect records of one kind at several levels."""
    suffix = f"_{session}" if session else ""
    return [
        Member(f"{kind}_{number + 1}{suffix}", KINDS[kind](rng, one, level), level, session)
        for number, level in enumerate(levels)
        for _ in range(repeats)
    ]


def _of_levels(kind: str, repeats: int) -> Callable[..., Campaign]:
    def draw(rng: Rng, choice: Choice) -> Campaign:
        one = specimen(rng, kind, choice)
        members = _tests(rng, one, kind, _levels(rng), repeats)
        return Campaign(f"{kind}s", one, tuple(members), {})

    return draw


def _mixed(rng: Rng, choice: Choice) -> Campaign:
    """Draw decays and sweeps of one structure, and in half of the cases also noise."""
    one = specimen(rng, "mixed", choice)
    members = _tests(rng, one, "decay", _levels(rng, 2), 2)
    members += _tests(rng, one, "sweep", _levels(rng, 2), 1)
    if rng.random() < 0.5:
        members += _tests(rng, one, "noise", [0.3], 1)
    return Campaign("mixed", one, tuple(members), {})


def _sessions(rng: Rng, choice: Choice) -> Campaign:
    """Draw records of one level on several days, at several torques, or with several sensors."""
    kind = str(rng.choice(["decay", "sweep"]))
    one = specimen(rng, kind, choice)
    count, what = int(rng.integers(3, 6)), str(rng.choice(["day", "torque", "mass"]))
    if what == "day":  # bolts relax, and temperature changes
        falls = bool(rng.random() < 0.5)
        step = log_uniform(rng, 3e-4, 5e-3)
        by = -step * np.arange(count) if falls else step * rng.standard_normal(count)
        changed = [replace(one, hz=one.hz * (1 + float(x))) for x in by]
        named = [f"day{i + 1}" for i in range(count)]
        facts = {"offsets": by.tolist(), "falls": falls}
    elif what == "torque":  # With more torque, slip needs more motion, and the joint is stiffer.
        torques = np.sort(rng.choice(np.arange(4, 30), count, replace=False))
        share = torques / torques.max()
        changed = [
            replace(one, length=one.length * float(s), hz=one.hz * (1 + 0.01 * float(s - 1)))
            for s in share
        ]
        named = [f"{torque}Nm" for torque in torques]
        facts = {"torques": torques.tolist()}
    else:  # sensors of different mass
        share = np.sort(rng.uniform(0, 0.01, count))
        changed = [replace(one, hz=one.hz / np.sqrt(1 + float(s))) for s in share]
        named = [f"sensor{i + 1}" for i in range(count)]
        facts = {"masses": share.tolist()}
    # The motion is the same, whatever displacement corresponds to an amplitude of one at a torque.
    levels = [one.length / each.length * 0.5 for each in changed]
    members = [
        Member(f"{kind}_{name}", KINDS[kind](rng, each, min(level, 1.0)), 1.0, name)
        for each, name, level in zip(changed, named, levels, strict=True)
    ]
    return Campaign("sessions", one, tuple(members), {"what": what, **facts})


def stretched(made: Campaign, factor: float) -> Campaign:
    """Return a campaign with the same motion of a structure that is `factor` times as fast.

    A faster structure moves less, so that its acceleration remains realistic.
    """
    size = min(1.0, factor**-2)

    def faster(drawn: Drawn) -> Drawn:
        powers = {"displacement": 0, "velocity": 1, "acceleration": 2, "force": 2}
        scaled = {
            role: x * size * factor ** powers.get(role, 0) for role, x in drawn.channels.items()
        }
        low, high = drawn.band
        if drawn.kind == "loop":  # the force of slow cycles does not depend on time
            scaled = dict(drawn.channels)
        return replace(
            drawn, hz=drawn.hz * factor, fs=drawn.fs * factor, length=drawn.length * size,
            channels=scaled,
            band=(low * factor, high * factor),
        )  # fmt: skip

    members = tuple(replace(one, drawn=faster(one.drawn)) for one in made.members)
    return replace(made, members=members)


CAMPAIGNS: dict[str, Callable[[Rng, Choice], Campaign]] = {
    "decays": _of_levels("decay", 3),
    "sweeps": _of_levels("sweep", 1),
    "noises": _of_levels("noise", 1),
    "multisines": _of_levels("multisine", 1),
    "loops": _of_levels("loop", 1),
    "mixed": _mixed,
    "sessions": _sessions,
}


# -------------------------------------------------------------------- faults of files, not records
UNITS = {"m for mm": 1e3, "mm for m": 1e-3, "g for m/s^2": 9.80665, "in for mm": 25.4}


def _unit_of_one_file(rng: Rng, drawn: Drawn) -> Drawn:
    """Write a response in a unit other than that stated by the campaign."""
    slips = [s for s in UNITS if ("g " in s) == (drawn.response == "acceleration")]
    slip = str(rng.choice(slips))
    factor = UNITS[slip] ** rng.choice([-1, 1])
    return replace(drawn.with_x(drawn.x * factor), size=f"{slip}: {factor:.4g}")


OF_CAMPAIGNS: dict[str, Callable[[Rng, Drawn], Drawn]] = {
    "unit of one file": _unit_of_one_file,
    "polarity of one file": FAULTS["polarity"].edit,
}
OF_FILES = {
    "unit of one file": r"unit|times (what|that)|factor|scale|level",
    "polarity of one file": FAULTS["polarity"].named.pattern,
    "file twice": r"same samples|twice|shares|holds the same",
}


def sound_campaign(rng: Rng, name: str, choice: Choice = ANY) -> Campaign:
    """Draw a sound campaign; draw again if a motion grows without bound."""
    while True:
        try:
            made = CAMPAIGNS[name](rng, choice)
        except FloatingPointError:
            continue
        members = [replace(one, drawn=recorded(rng, one.drawn)) for one in made.members]
        return replace(made, members=tuple(members))


def mishandled_campaign(rng: Rng, name: str) -> Campaign:
    """Draw a campaign with a fault in one of its records, or in all records of one test."""
    while True:
        try:
            made = CAMPAIGNS[name](rng, VISIBLE)
            return _with_fault(rng, made)
        except FloatingPointError:
            continue


def _with_fault(rng: Rng, made: Campaign) -> Campaign:
    members = list(made.members)
    at = int(rng.integers(len(members)))
    kind = members[at].drawn.kind
    own = [fault.name for fault in FAULTS.values() if kind in fault.kinds]
    of_files = ["unit of one file", "file twice"]
    of_files += ["polarity of one file"] if kind in FAULTS["polarity"].kinds else []
    what = str(rng.choice([*own, *of_files]))
    clean = [recorded(rng, one.drawn) for one in members]
    if what in FAULTS:
        fault: Fault = FAULTS[what]
        # A fault of the measuring chain affects every repeat of a test, an accident only one
        # record.
        alike = fault.before and rng.random() < 0.5
        spoils = [
            one.test == members[at].test if alike else i == at for i, one in enumerate(members)
        ]
        clean = [
            spoilt(rng, one.drawn, fault) if bad else sound
            for one, bad, sound in zip(members, spoils, clean, strict=True)
        ]
        size = clean[at].size
    elif what == "file twice":
        others = [i for i, one in enumerate(members) if i != at and one.drawn.kind == kind]
        other = int(rng.choice(others)) if others else at
        clean[at] = replace(clean[other], fault=what)
        size = f"{members[at].test} is {members[other].test}"
    else:
        clean[at] = replace(OF_CAMPAIGNS[what](rng, clean[at]), fault=what)
        size = clean[at].size
    members = [replace(one, drawn=drawn) for one, drawn in zip(members, clean, strict=True)]
    return replace(made, members=tuple(members), fault=what, size=f"{members[at].test}: {size}")
