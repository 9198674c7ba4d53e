"""What readings of frequency and damping say: nonlinear or not, how much, from which motion."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.identification.diagnosis import diagnose
from jbw.measurement.channels import rms
from jbw.measurement.resonances import AmplitudeCurve, Reading
from jbw.report.messages import effects, look

Values = Float[np.ndarray, " reading"]
Band = tuple[float, float, float]  # ends and middle of 99 %
# Of the frequency, and of the damping at rest: below, leakage and noise may make it.
LEAST_CHANGE = (1e-4, 0.03)
SURE = 3.0  # standard deviations from where on a change is none of chance
WORN = 0.02  # of the secant stiffness of equal cycles: less is how a rig repeats
CLEAR = 0.2  # of half width and of damping: no noise that leaves a resonance to be read does it


def statements(
    record: Mapping[str, Any], by_test: Mapping[str, list[Reading]], modes_hz: Sequence[float] = ()
) -> list[str]:
    """Whether the structure is linear over the levels, and how frequency and damping change.

    Of several modes each is told by itself, by the readings that are nearest to its frequency.
    """
    readings = sorted(
        (reading for test in by_test.values() for reading in test), key=lambda reading: reading.y
    )
    sentences = []
    for hz, of_mode in _by_mode(readings, modes_hz).items():
        rows = [row for row in record["tests"] if _nearest(row["frequency_hz"], modes_hz) == hz]
        answer = nonlinear(of_mode)
        answers = [answer.sentence, *(onset(rows, of_mode) if answer.is_seen else [])]
        sentences += answers if hz is None else [look.of_mode(hz, sentence) for sentence in answers]
    sentences += days(record["tests"])
    coherent = [row for row in record["tests"] if row["coherence"] is not None]
    if len(coherent) > 1:
        ends = [(row["coherence"], row["test"]) for row in (coherent[0], coherent[-1])]
        sentences.append(look.coherence(*ends))
    loops = sorted(record["loops"], key=lambda row: row["y"])
    if len(loops) > 1:
        first, last = loops[0], loops[-1]
        change = last["stiffness"] / first["stiffness"] - 1
        unit = "mrad" if first["unit"] == "rad" else "mm"
        sentences.append(look.secant(first["y"], last["y"], change, unit))
    sentences += [sentence for loop in loops if (sentence := _worn(loop))]
    reasons: dict[str, list[str]] = {}
    for name, why in record["unread"].items():
        reasons.setdefault(why, []).append(name)
    return [*sentences, *(look.not_read(names, why) for why, names in reasons.items())]


def _by_mode(
    readings: Sequence[Reading], modes_hz: Sequence[float]
) -> dict[float | None, list[Reading]]:
    """Readings by the frequency of the mode that they are nearest to, in the order of these."""
    groups = {
        mode_hz: [] for mode_hz in (_nearest(mode_hz, modes_hz) for mode_hz in modes_hz or (1.0,))
    }
    for reading in readings:
        groups[_nearest(reading.frequency_hz, modes_hz)].append(reading)
    return {hz: group for hz, group in groups.items() if group}


def _nearest(frequency_hz: float, modes_hz: Sequence[float]) -> float | None:
    """The nearest of several modes [Hz]; None where there is one alone."""
    if len(modes_hz) < 2:
        return None
    return min(modes_hz, key=lambda hz: abs(np.log(frequency_hz / hz)))


class Nonlinear(NamedTuple):
    """Whether frequency or damping are seen to change with amplitude, and the sentence on it."""

    is_seen: bool
    sentence: str


def _worn(loop: Mapping[str, Any]) -> str | None:
    """How far the stiffness of equal cycles has fallen, or risen; None where it has hardly."""
    cycles = [cycle for cycle in loop["cycles"] if cycle["retained"] is not None]
    if not cycles:
        return None
    last = max(cycles, key=lambda cycle: abs(cycle["retained"] - 1))
    change = last["retained"] - 1
    if abs(change) < WORN:
        return None
    return look.worn(loop["test"], loop["cycles"].index(last) + 1, change)


def nonlinear(readings: Sequence[Reading]) -> Nonlinear:
    """Whether frequency or damping change with amplitude, of readings in its order."""
    columns = (np.array([getattr(row, name) for row in readings]) for name in Reading._fields[:3])
    y, frequency, damping = columns
    diagnosis = diagnose(AmplitudeCurve(y, 2 * np.pi * frequency, damping))
    if diagnosis is None:
        return _between_ends(y, frequency, damping)
    turn, softening = diagnosis.turn, diagnosis.softening
    least_damping = LEAST_CHANGE[1] * abs(float(damping[0]))
    changes = [
        effects.turning(*turn)
        if turn is not None
        else _change("frequency", softening, LEAST_CHANGE[0], diagnosis.softening_exponent),
        _change("damping ratio", diagnosis.damping, least_damping, diagnosis.damping_exponent),
    ]
    unchanged = [look.no_change("frequency"), look.no_change("damping ratio")]
    is_seen = turn is not None or changes != unchanged
    return Nonlinear(is_seen, look.nonlinear(is_seen, y.tolist(), changes))


def _change(what: str, band: Band, least: float, power: Band) -> str:
    """How one quantity changes, as a part of a sentence; a softening falls where it is positive."""
    low, middle, high = sorted(band)
    if low <= 0.0 <= high or abs(middle) < least:
        return look.no_change(what)
    size = sorted(100 * abs(x) for x in band)
    falls = (middle > 0.0) == (what == "frequency")
    unit = "" if what == "frequency" else " of critical damping"
    return look.change(what, (size[0], size[1], size[2]), power, falls=falls, unit=unit)


def _between_ends(y: Values, frequency: Values, damping: Values) -> Nonlinear:
    """The same of too few readings for an exponent: the last held against the first."""
    half_width = abs(float(damping[0]))
    if len(frequency) < 2:
        return Nonlinear(False, look.one_reading(float(y[0])))
    shift, growth = float(frequency[-1] / frequency[0] - 1), float(damping[-1] / damping[0] - 1)
    shifts, grows = abs(shift) > CLEAR * half_width, abs(growth) > CLEAR
    kind = ("softens" if shift < 0 else "hardens") if shifts else "changes its damping"
    ends = float(damping[0]), float(damping[-1])
    kind = kind if shifts or grows else ""
    sentence = look.between_ends(y.tolist(), shift, abs(shift) / half_width, ends, kind)
    return Nonlinear(shifts or grows, sentence)


def onset(rows: Sequence[Mapping[str, Any]], readings: Sequence[Reading]) -> list[str]:
    """From which motion on the frequency differs from that of the weakest, as records scatter."""
    scattering = [row for row in rows if row["frequency_sd"]]
    if len(scattering) > 1:
        y, frequency = (np.array([row[key] for row in scattering]) for key in ("y", "frequency_hz"))
        sd = frequency * rms([row["frequency_sd"] / row["frequency_hz"] for row in scattering])
        names = [row["test"] for row in scattering]
    elif len(readings) > 3:
        y, frequency = (
            np.array([getattr(row, key) for row in readings]) for key in Reading._fields[:2]
        )
        # Of neighbours that a curve joins, what the second differences leave.
        sd = np.full(len(y), np.std(np.diff(frequency, 2)) / np.sqrt(6.0))
        names = [""] * len(y)
    else:
        return []
    least = np.maximum(SURE * np.hypot(sd, sd[0]), LEAST_CHANGE[0] * frequency[0])
    change = frequency - frequency[0]
    shifted = np.where(np.abs(change) > least, np.sign(change), 0.0)
    if not shifted[-1]:
        return []
    first = _last_onset(shifted)
    return [look.onset(float(y[first]), names[first], SURE)]


def _last_onset(shifted: Values) -> int:
    """From which reading on all are shifted, -1 or 1, but where the shift changes its sign."""
    at = np.flatnonzero(shifted)
    is_broken = (np.diff(at) > 1) & (np.diff(shifted[at]) == 0)
    return int(at[0] if not np.any(is_broken) else at[1 + np.flatnonzero(is_broken)[-1]])


def days(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Scatter of records within a day against that between days, or assemblies, of one level."""
    groups: dict[tuple[Any, ...], dict[tuple[Any, ...], list[Mapping[str, Any]]]] = {}
    for row in rows:
        day = row["assembly"], row["run"]
        if any(day):
            of_level = groups.setdefault((row["kind"], row["level"]), {})
            of_level.setdefault(day, []).append(row)
    several = [list(group.values()) for group in groups.values() if len(group) > 1]
    within = [row for group in several for day in group for row in day if row["frequency_sd"]]
    if not within:
        return []
    scatter = []
    for name, key in (("frequency", "frequency_hz"), ("damping", "damping")):
        inner = rms([row[f"{name}_sd"] / row[key] for row in within])
        means = [[np.mean([row[key] for row in day]) for day in group] for group in several]
        outer = rms([float(np.std(level, ddof=1) / np.mean(level)) for level in means])
        scatter.append((name, inner, outer))
    return [look.session_scatter(max(map(len, several)), scatter)]
