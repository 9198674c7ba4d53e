"""What readings of frequency and damping say: nonlinear or not, how much, which way."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jbw.identification.diagnosis import diagnose, turning_sentence
from jbw.identification.floors import rms
from jbw.measurement.resonances import Reading
from jbw.observables.observable import AmplitudeCurve

Values = Float[np.ndarray, " reading"]
# Of the frequency, and of the damping at rest: below, leakage and noise may make it.
LEAST_CHANGE = (1e-4, 0.03)
SURE = 3.0  # standard deviations from where on a change is none of chance
CLEAR = 0.2  # of half width and of damping: no noise that leaves a resonance to be read does it


def statements(record: Mapping[str, Any], found: Mapping[str, list[Reading]]) -> list[str]:
    """Whether the structure is linear over the levels, and how frequency and damping change."""
    each = sorted((one for test in found.values() for one in test), key=lambda one: one.y)
    said = [nonlinear(each)] if each else []
    if said and said[0].startswith("Nonlinear: yes"):
        said += onset(record["tests"], each)
    said += days(record["tests"])
    told = [row for row in record["tests"] if row["coherence"] is not None]
    if len(told) > 1:
        ends = (f"{row['coherence']:.3f} ({row['test']})" for row in (told[0], told[-1]))
        said.append(f"Coherence at the resonance, smallest to largest motion: {' to '.join(ends)}.")
    loops = sorted(record["loops"], key=lambda row: row["y"])
    if len(loops) > 1:
        first, last = loops[0], loops[-1]
        part = 100 * (last["stiffness"] / first["stiffness"] - 1)
        said.append(
            f"From {1e3 * first['y']:.3g} to {1e3 * last['y']:.3g} mm the secant stiffness changes "
            f"by {part:.2g} %."
        )
    reasons: dict[str, list[str]] = {}
    for name, why in record["unread"].items():
        reasons.setdefault(why, []).append(name)
    return [*said, *(f"Not read: {', '.join(names)}. {why}" for why, names in reasons.items())]


def nonlinear(each: Sequence[Reading]) -> str:
    """Whether frequency or damping change with amplitude, of readings in its order."""
    columns = (np.array([getattr(one, name) for one in each]) for name in Reading._fields[:3])
    y, frequency, damping = columns
    known = diagnose(AmplitudeCurve(y, 2 * np.pi * frequency, damping))
    reach = f"{1e3 * y[0]:.2g} to {1e3 * y[-1]:.2g} mm"
    if known is None:
        return _between_ends(frequency, damping, reach)
    fall, add = known.softening, known.damping
    ways = (
        (fall, LEAST_CHANGE[0], known.softening_exponent, ("falls", "rises")),
        (add, LEAST_CHANGE[1] * abs(float(damping[0])), known.damping_exponent, ("rises", "falls")),
    )
    told = []
    for what, (band, least, power, verbs) in zip(("frequency", "damping ratio"), ways, strict=True):
        low, middle, high = sorted(band)
        if what == "frequency" and known.turn is not None:
            told.append(turning_sentence(known.turn))
            continue
        if low <= 0.0 <= high or abs(middle) < least:
            told.append(f"no change of the {what} is seen")
            continue
        ends = sorted(100 * abs(x) for x in band)
        told.append(
            f"the {what} {verbs[middle < 0.0]} by {ends[1]:.2g} % [{ends[0]:.2g}, {ends[2]:.2g}]"
            f"{' of critical damping' if what != 'frequency' else ''}, as amplitude^{power[1]:.2g} "
            f"[{power[0]:.2g}, {power[2]:.2g}]"
        )
    answer = "not seen" if all(one.startswith("no ") for one in told) else "yes"
    return f"Nonlinear: {answer}. From {reach} ({len(y)} readings) {'; '.join(told)}."


def _between_ends(frequency: Values, damping: Values, reach: str) -> str:
    """The same of too few readings for an exponent: the last held against the first."""
    count, half_width = len(frequency), abs(float(damping[0]))
    if count < 2:
        return f"Nonlinear: one reading ({reach[: reach.index(' to')]} mm) tells no change."
    shift, growth = float(frequency[-1] / frequency[0] - 1), float(damping[-1] / damping[0] - 1)
    shifts, grows = abs(shift) > CLEAR * half_width, abs(growth) > CLEAR
    how = ("softens" if shift < 0 else "hardens") if shifts else "changes its damping"
    answer = f"yes, it {how}" if shifts or grows else "not seen"
    return (
        f"Nonlinear: {answer}. From {reach} ({count} readings, too few for an exponent) the "
        f"frequency {'falls' if shift < 0 else 'rises'} by {100 * abs(shift):.2g} %, "
        f"{abs(shift) / half_width:.2g} of the resonance's half width, and the damping ratio goes "
        f"from {100 * damping[0]:.2g} to {100 * damping[-1]:.2g} %."
    )


def onset(rows: Sequence[Mapping[str, Any]], each: Sequence[Reading]) -> list[str]:
    """From which motion on the frequency differs from that of the weakest, as records scatter."""
    known = [row for row in rows if row["frequency_sd"]]
    if len(known) > 1:
        y, frequency = (np.array([row[key] for row in known]) for key in ("y", "frequency_hz"))
        sd = frequency * rms([row["frequency_sd"] / row["frequency_hz"] for row in known])
        names = [f" ({row['test']})" for row in known]
    elif len(each) > 3:
        y, frequency = (
            np.array([getattr(one, key) for one in each]) for key in Reading._fields[:2]
        )
        # Of neighbours that a curve joins, what the second differences leave.
        sd = np.full(len(y), np.std(np.diff(frequency, 2)) / np.sqrt(6.0))
        names = [""] * len(y)
    else:
        return []
    least = np.maximum(SURE * np.hypot(sd, sd[0]), LEAST_CHANGE[0] * frequency[0])
    shifted = np.abs(frequency - frequency[0]) > least
    if not shifted[-1]:
        return []
    first = len(y) - int(np.argmin(np.append(shifted[::-1], False)))
    where = f"{1e3 * y[first]:.2g} mm{names[first]}"
    return [
        f"The change of the frequency is seen from {where} on, beyond {SURE:g} standard deviations "
        "of a reading; below, the structure may be taken as linear."
    ]


def days(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Scatter of records within a day against that between days, or assemblies, of one level."""
    groups: dict[tuple[Any, ...], dict[tuple[Any, ...], list[Mapping[str, Any]]]] = {}
    for row in rows:
        day = row["assembly"], row["run"]
        if any(day):
            own = groups.setdefault((row["kind"], row["level"]), {})
            own.setdefault(day, []).append(row)
    apart = [list(group.values()) for group in groups.values() if len(group) > 1]
    within = [row for group in apart for each in group for row in each if row["frequency_sd"]]
    if not within:
        return []
    count = max(map(len, apart))
    parts = []
    for name, key in (("frequency", "frequency_hz"), ("damping", "damping")):
        record = rms([row[f"{name}_sd"] / row[key] for row in within])
        means = [[np.mean([row[key] for row in each]) for each in group] for group in apart]
        day = rms([float(np.std(one, ddof=1) / np.mean(one)) for one in means])
        parts.append(f"{name} {100 * record:.2g} % within and {100 * day:.2g} % between")
    return [
        f"Scatter of records within a day against that of {count} days or assemblies at one level: "
        f"{'; '.join(parts)}."
    ]
