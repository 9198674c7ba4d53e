"""Assignment of measured quantities to a file's channels, from names, labels and units."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from jbw.errors import ConfigError
from jbw.measurement.files.tree import Leaf, load
from jbw.measurement.records import BASE, INPUTS, QUANTITIES, RESPONSES, ROLES, SENSITIVITIES, si_of
from jbw.units import TORSION, is_voltage, plain, quantity_of, si_unit

Leaves = Mapping[str, Leaf]
# patterns of channel names, and the quantity that each indicates; most specific first
HINTS = (
    (r"^t(?:_(?:s|sec|ms|us))?$|time(?!r)|zeit", "time"),
    (r"restoring|friction", "restoring_force"),
    (r"^freq|^f_?hz$|frequency|frequenz", "frequency"),
    (r"phase|^phi$", "phase"),
    (
        r"(?:^|[\W_])(?:base|table|ctrl|control)(?:$|[\W_])|(?:shak\w*|vib\w*)[\W_]*table|clamp|fixture",
        "base",
    ),
    (r"vel|laser|vib|^v$|ldv|geschwindigkeit|mobility", "velocity"),
    (r"acc|beschl|inertance|^a_(?!mp)", "acceleration"),
    (
        r"dis[pl]|receptance|compliance|lvdt|^[yx]$|pos|angle|rotation|twist|weg\b|auslenkung|stroke",
        "displacement",
    ),
    (r"force|load|^f$|torque|moment|kraft|hammer", "force"),
    (r"input|shaker|volt|drive|source|(?<!s)amp|^u$|^v1$", "input"),
)
# Units of the time of day: such columns are not a record's clock, and `m` means minutes in them.
OF_THE_DAY = r"\b(?:minutes?|hours?|seconds?|days?|minuten?|stunden?|sekunden?)\b"
# words in names of time columns that are not a date
ELAPSED = r"elapsed|relative|since|verstrichen|vergangen"
AXES = re.compile(r"(?:^|(?<=[\W_\d])|(?<=[a-z](?=[XYZ])))[xyzXYZ](?![^\W_])")
AXES_IN_SPACE = 3
TURNED = r"angle|rotation|twist|torque|moment"  # words in names of quantities of torsion
# A later channel of a quantity is preferred to an earlier one if it is stronger by this factor.
STRONGER = 3.0
MOST_SAMPLES = 4_000_000  # largest number of samples of a channel whose values are examined
MOST_RADIANS = 7.0
BY_QUANTITY = {
    "force": "force", "torque": "force", "acceleration": "acceleration",
    "angular acceleration": "acceleration", "velocity": "velocity",
    "angular velocity": "velocity", "displacement": "displacement", "voltage": "input",
    "current": "input", "force per mass": "input", "time": "time",
}  # fmt: skip


class Channel(NamedTuple):
    """The assumed quantity and unit of one channel of a file."""

    path: str
    unit: str  # unit that the file or the channel's name states
    default: str  # SI unit of the quantity, used if no unit is stated
    guessed: bool = False  # whether only the unit suggests the quantity, and not a name
    axes: tuple[str, ...] = ()  # the channels of all axes, if there are several
    sensitivity: str = ""  # example of a sensitivity, if the channel is a sensor's voltage


def last_name(path: str) -> str:
    """Return the last part of a path in lower case, without brackets."""
    return re.split(r"[./]", re.sub(r"\[[^\]]*\]", "", path))[-1].lower()


def channels_by_role(series: Leaves) -> dict[str, Channel]:
    """Return the channel of each measured quantity, determined from names, labels and units."""
    named: dict[str, list[Channel]] = {}
    rest: list[tuple[str, Leaf]] = []
    # Channels named x, y and z are axes of a quantity that the file does not state.
    unknown = {"x", "y", "z"} if {"x", "y", "z"} <= {last_name(path) for path in series} else set()
    for path, leaf in series.items():
        if re.search(OF_THE_DAY, last_name(path)) or (last_name(path) in unknown and not leaf.unit):
            continue
        texts = [text for text in (last_name(path), leaf.label.lower()) if text]
        for text in texts:
            if role_channel := _by_text(path, text, leaf.unit):
                role, channel = role_channel
                named.setdefault(role, []).append(channel)
                break
        else:
            rest.append((path, leaf))
    by_unit: set[str] = set()
    units = {path: leaf.unit or _ending(path) for path, leaf in rest}
    for path, leaf in rest:
        role = _by_unit(units[path])
        others = [other for other in units.values() if _by_unit(other) == role]
        # If there are several voltages, none of them can be identified as the source.
        is_new = role not in named or named[role][0].path in by_unit
        if role and is_new and not (role == "input" and len(others) > 1):
            # A voltage may come from any sensor, whereas other units show the measured quantity.
            is_guess = role == "input" or not leaf.unit
            named.setdefault(role, []).append(Channel(path, units[path], "", is_guess))
            by_unit.add(path)
    roles = {
        role: (_clock_of if role == "time" else _meant)(many, series)
        for role, many in named.items()
    }
    if BASE in roles and roles.keys().isdisjoint(RESPONSES):
        roles["acceleration"] = roles.pop(BASE)  # the only acceleration is the response
    elif not roles.keys().isdisjoint(INPUTS):
        roles.pop(BASE, None)  # the structure is moved by a force, not by its base
    roles = _of_a_curve(roles, series)
    if (phase := roles.get("phase")) is not None and not phase.unit:
        turned = _in_degrees(series[phase.path])
        roles |= {"phase": phase._replace(unit="deg" if turned else "")}
    if roles.keys().isdisjoint(RESPONSES) and {"frequency", "input"} <= set(roles):
        roles = _of_amplitudes(roles)
    unanswered = roles.keys().isdisjoint(RESPONSES)
    if unanswered and {"frequency", "phase", "force", "input"} <= set(roles):
        # With a force and a phase in the file, an amplitude is that of the response.
        amplitude = roles.pop("input")
        role = next((r for r in RESPONSES if _fits(r, amplitude.unit)), "acceleration")
        roles[role] = amplitude._replace(default=si_unit(role))
    return roles


def with_roles(
    channels: Mapping[str, Channel], stated: Mapping[str, str], series: Leaves
) -> dict[str, Channel]:
    """Return the channel of each quantity, with guesses replaced by what the user states.

    A channel keeps the unit in the file if that unit fits the role.
    """
    others = {role: c for role, c in channels.items() if c.path not in stated.values()}
    units = {role: series[path].unit for role, path in stated.items()}
    return others | {
        role: Channel(path, units[role] if _fits(role, units[role]) else "", _si_of_role(role))
        for role, path in stated.items()
    }


def _si_of_role(role: str) -> str:
    return si_unit(QUANTITIES[role][0])


def _of_amplitudes(roles: dict[str, Channel]) -> dict[str, Channel]:
    """Assign the amplitudes in a table of frequencies to the response that their unit indicates."""
    amplitude = roles["input"]
    for role in RESPONSES:
        unit = amplitude.unit or _behind(last_name(amplitude.path), role)
        if unit and _fits(role, unit):
            others = {name: channel for name, channel in roles.items() if name != "input"}
            return {**others, role: amplitude._replace(unit=unit, default=si_unit(role))}
    return roles


def _by_text(path: str, text: str, unit: str) -> tuple[str, Channel] | None:
    """Return the quantity that a name or label indicates, with its channel; None if unknown."""
    if plain(text) in ("ms", "us", "ns"):  # A column's name may consist of a unit only.
        return "time", Channel(path, plain(text), "s")
    by_name = [text] if text in ROLES else []
    by_name += [role for pattern, role in HINTS if re.search(pattern, text)]
    for role in by_name:
        stated = unit or _behind(text, role)
        if stated and not _fits(role, stated):
            continue
        turned = [q for q in QUANTITIES[role] if q in TORSION] if re.search(TURNED, text) else []
        return role, Channel(path, stated, si_unit((turned or QUANTITIES[role])[0]))
    sensors = [role for role in by_name if role in SENSITIVITIES]
    if sensors and is_voltage(unit):
        return sensors[0], Channel(path, "", "", sensitivity=SENSITIVITIES[sensors[0]])
    return None


def _fits(role: str, unit: str) -> bool:
    with suppress(ConfigError):
        if unit:
            si_of(role, unit)
            return True
    return False


def _behind(text: str, role: str) -> str:
    """Return the unit at the end of a name such as `disp_mm` or `frequency_Hz`; empty if none."""
    for mark in range(len(text)):
        if text[mark] != "_" or mark == 0:
            continue
        unit = text[mark + 1 :].replace("_", "/")
        for written in (unit, unit.upper(), unit.capitalize(), unit[:1] + unit[1:].upper()):
            with suppress(ConfigError):
                quantity_of(written, QUANTITIES[role])
                return plain(written)
    return ""


def _ending(path: str) -> str:
    """Return the unit at the end of any channel's name, such as `resp_g`; empty if there is none.

    A single m or s is not counted as a unit, because it also ends other names.
    """
    _, mark, unit = re.split(r"[./]", path)[-1].rpartition("_")
    return unit if mark and unit not in ("m", "s") and _by_unit(unit) else ""


def _by_unit(unit: str) -> str:
    """Return the quantity that a unit indicates; empty if it indicates none."""
    with suppress(ConfigError):
        return BY_QUANTITY.get(quantity_of(unit), "") if unit else ""
    return ""


def _meant(channels: Sequence[Channel], series: Leaves) -> Channel:
    """Choose one of several channels for a quantity: the first, or a much stronger one."""
    exact = [channel for channel in channels if last_name(channel.path) in ROLES]
    channels = exact or channels
    if len(channels) == 1:
        return channels[0]
    axes = _axes_of(channels)
    if len(axes) >= AXES_IN_SPACE:
        strongest = max(axes, key=lambda channel: strength(series[channel.path]))
        return strongest._replace(axes=tuple(channel.path for channel in axes))
    sizes = [strength(series[channel.path]) for channel in channels]
    strongest = int(np.argmax(sizes))
    return channels[strongest if sizes[strongest] > STRONGER * sizes[0] else 0]


def _axes_of(channels: Sequence[Channel]) -> list[Channel]:
    """Return the channels whose names differ from the first one only in the letter of the axis."""
    names = [channel.path.rpartition(".")[2] for channel in channels]
    bare = [AXES.sub("", name) for name in names]
    return [
        channel for channel, name, without in zip(channels, names, bare, strict=True)
        if without == bare[0] and name != without
    ]  # fmt: skip


def _clock_of(channels: Sequence[Channel], series: Leaves) -> Channel:
    """Return the time column of a record: an increasing column, preferably of elapsed time."""

    def merits(channel: Channel) -> tuple[bool, bool, bool]:
        time = load(series[channel.path])
        is_clock = time.ndim == 1 and np.isrealobj(time) and bool(np.all(np.diff(time) > 0))
        elapses = re.search(ELAPSED, channel.path.lower()) is not None
        return is_clock, elapses, bool(channel.unit)

    return channels[0] if len(channels) == 1 else max(channels, key=merits)


def strength(leaf: Leaf) -> float:
    """Return the standard deviation of a channel; 0 if it is too long or has several dimensions."""
    if int(np.prod(leaf.shape, dtype=float)) > MOST_SAMPLES or len(leaf.shape) != 1:
        return 0.0
    samples = load(leaf)
    return float(np.nanstd(samples)) if np.isfinite(samples).any() else 0.0


def _in_degrees(leaf: Leaf) -> bool:
    """Return whether phases are too large for radians, so that their unit must be degrees."""
    samples = np.abs(load(leaf)) if leaf.shape and leaf.shape[0] <= MOST_SAMPLES else np.zeros(1)
    return float(np.nanmax(samples)) > MOST_RADIANS


def _of_a_curve(roles: dict[str, Channel], series: Leaves) -> dict[str, Channel]:
    """Find frequency, response and source of a complex response curve among its channels.

    If no name indicates the response, it is the first complex channel with a unit of a response, or
    the only complex channel, classified by its phase. Without a force channel it is per newton.
    """
    complex_paths = [p for p, leaf in series.items() if is_complex(leaf)]
    if not complex_paths:
        return roles
    sizes = {series[p].shape for p in complex_paths}
    known_roles = {role: c for role, c in roles.items() if role not in ("time", *INPUTS)}
    if "frequency" not in known_roles:
        for path, leaf in series.items():
            if path not in complex_paths and leaf.shape in sizes and rises(leaf):
                hz = "rad/s" if re.fullmatch("w|omega.*", last_name(path)) else "Hz"
                known_roles["frequency"] = Channel(path, leaf.unit, hz, not leaf.unit)
                break
    if "frequency" not in known_roles:
        return known_roles
    path, *others = complex_paths
    unit = series[path].unit
    by_unit = [role for role in RESPONSES if _fits(role, unit)]
    if known_roles.keys().isdisjoint(RESPONSES) and (by_unit or not others):
        role = by_unit[0] if by_unit else _by_phase(series[path])
        axes = tuple(complex_paths) if others else ()
        known_roles[role] = Channel(path, unit if by_unit else "", "", not by_unit, axes)
    source = next((roles[role] for role in INPUTS if role in roles), None)
    is_of_curve = source is not None and series[source.path].shape in sizes
    if source is not None and is_of_curve and source.path != known_roles["frequency"].path:
        known_roles["force" if roles.get("force") == source else "input"] = source
    per = "/N" if known_roles.keys().isdisjoint(INPUTS) else ""
    return {
        role: c._replace(default=_si_of_role(role) + per) if c.path in complex_paths else c
        for role, c in known_roles.items()
    }


def _by_phase(leaf: Leaf) -> str:
    r"""Infer displacement, velocity or acceleration from a response's phase, $\arg \sum |H| H$.

    At its peak a receptance has a phase of -90 degrees, a mobility 0 and an accelerance 90.
    """
    h = np.nan_to_num(np.ravel(load(leaf))) if leaf.shape[0] <= MOST_SAMPLES else np.zeros(1)
    quarters = round(float(np.angle(np.sum(np.abs(h) * h))) / (np.pi / 2))
    return {-1: "displacement", 1: "acceleration"}.get(quarters, "velocity")


def is_complex(leaf: Leaf) -> bool:
    """Return whether an array of a file has complex values."""
    return np.issubdtype(leaf.array.dtype, np.complexfloating)


def rises(leaf: Leaf) -> bool:
    """Return whether a channel is real, not negative and strictly increasing."""
    if len(leaf.shape) != 1 or leaf.shape[0] > MOST_SAMPLES:
        return False
    samples = load(leaf)
    return bool(np.isrealobj(samples) and samples[0] >= 0 and np.all(np.diff(samples) > 0))
