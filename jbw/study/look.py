"""What the records show without any model of the joint: frequency and damping by amplitude.

Every driven record is read near its resonance as a linear oscillator's, decays along their
envelopes, steady tones and response curves from their harmonics, force loops by their secant. The
readings say whether the structure is nonlinear, how much, and from which motion on.
"""

import logging
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jbw.campaign.gains import force_per_unit, gain_of
from jbw.campaign.load import Campaign
from jbw.campaign.tables import TestSpec
from jbw.errors import DataError, JbwError
from jbw.identification.diagnosis import diagnose
from jbw.identification.shaker import read_shaker, shaker_sentence
from jbw.measurement.channels import rms
from jbw.measurement.curves import ForcedLoop, forced_loop
from jbw.measurement.delays import on_time
from jbw.measurement.envelopes import bands_of, readings
from jbw.measurement.loops import readings_of_cycles
from jbw.measurement.nonlinearity import coherence_at_resonance, seen_in
from jbw.measurement.records import INPUTS, Record, Test, drive_of
from jbw.measurement.resonances import (
    WIDE,
    AmplitudeCurve,
    Reading,
    driven_lines,
    locked_sentence,
    read_curve,
    read_lines,
    readings_of_points,
)
from jbw.measurement.spectra import strongest_line
from jbw.observables.harmonic_groups import groups_of
from jbw.quantities import UNIT_OF, derivative_order, per
from jbw.report.messages import effects
from jbw.report.messages import look as messages
from jbw.report.messages.look import NO_OSCILLATOR
from jbw.report.messages.study import no_shaker
from jbw.verification.places import place

if TYPE_CHECKING:
    import xarray as xr

logger = logging.getLogger("jbw")
CHANGED = 0.5  # scatter of repeats over their mean from where on they are no repeats
# What a record that shows nothing ends a reading with: it is named, and the others are read.
UNREADABLE = (DataError, ValueError, np.linalg.LinAlgError)
NUM_SHOWN = 2000  # lines of a response that are drawn
UNITS = {"y": "m", "frequency_hz": "Hz", "damping": "1"}
MEANING = {"y": "motion", "frequency_hz": "natural frequency", "damping": "damping ratio"}
Values = Float[np.ndarray, " reading"]
Band = tuple[float, float, float]  # ends and middle of 99 %
# Of the frequency, and of the damping at rest: below, leakage and noise may make it.
LEAST_CHANGE = (1e-4, 0.03)
SURE = 3.0  # standard deviations from where on a change is none of chance
WORN = 0.02  # of the secant stiffness of equal cycles: less is how a rig repeats
CLEAR = 0.2  # of half width and of damping: no noise that leaves a resonance to be read does it


class ShownResponse(NamedTuple):
    """Displacement over the source along frequency."""

    freq_hz: Float[np.ndarray, " line"]
    magnitude: Float[np.ndarray, " line"]
    unit: str


@dataclass(frozen=True)
class Look:
    """Result of `look`: `record` in plain values, readings and responses by test."""

    record: dict[str, Any]
    readings: dict[str, list[Reading]]
    responses: dict[str, ShownResponse]


def look(campaign: Campaign, report: Callable[[str], Any] = logger.info) -> Look:
    """Read frequency and damping against amplitude from every test, without a model of the joint.

    Args:
        campaign: From `jbw.load_campaign`.
        report: Called with one sentence a test.
    """
    readings_of: dict[str, list[Reading]] = {}
    responses: dict[str, ShownResponse] = {}
    rows, unread, per_unit = [], {}, force_per_unit(campaign)
    campaign = replace(campaign, tests=tuple(_of_first_mode(campaign)))
    for name, tests in _curves(campaign.tests).items():
        report(f"Reading {name}")
        try:
            read, response = _read(tests, gain_of(per_unit, drive_of(tests[0])))
            held = [reading for reading in read if reading.holds]
            if len(held) < len(read):
                left_out = f"{len(read) - len(held)} of {len(read)} readings of {name}"
                unread[left_out] = NO_OSCILLATOR
            if not held:
                continue
            rows.append(_row(name, tests[0], held))
        except UNREADABLE as why:
            unread[name] = str(why).splitlines()[0]
            continue
        readings_of[name] = held
        if response is not None:
            responses[name] = response
    loops = []
    for test in campaign.tests:
        if test.traits.is_prescribed:
            try:
                loops.append(_loop_row(test))
            except UNREADABLE as why:
                unread[test.name] = str(why).splitlines()[0]
    record = {
        "campaign": campaign.name,
        "tests": sorted(rows, key=lambda row: row["y"]),
        "loops": loops,
        "unread": unread,
        "seen": [sentence for test in campaign.tests for sentence in _seen(test)],
    }
    sentences = statements(record, readings_of, _modes_hz(campaign))
    return Look(record | {"statements": sentences}, readings_of, responses)


def _modes_hz(campaign: Campaign) -> tuple[float, ...]:
    """Frequencies of the elastic modes that a campaign states, or its matrices tell [Hz]."""
    if campaign.joints is not None:
        return tuple(float(hz) for hz in campaign.joints.model.frequencies_hz if hz > 0)
    return () if campaign.structure is None else campaign.structure.modes


def _of_first_mode(campaign: Campaign) -> Iterator[Test]:
    """Tests of a campaign; decays of several modes in a band of the first alone."""
    structure = campaign.structure
    modes_hz = () if structure is None else structure.modes
    for test in campaign.tests:
        if len(modes_hz) < 2 or not test.traits.is_free or test.band_hz is None:
            yield test
        else:
            yield replace(test, band_hz=bands_of(modes_hz, test)[0])


def look_quietly(campaign: Campaign) -> Look:
    """The same beside an identification, where what is doubtful was said at the door."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return look(campaign, report=lambda _: None)


def look_groups(looked: Look, fitted: Mapping[str, bool] | None = None) -> "dict[str, xr.Dataset]":
    """Readings and response of every test in the order of the motion, as groups of a result.

    `fitted` tells by name of which tests a posterior saw something, where there is one.
    """
    import xarray as xr  # takes long to load, and a look without a figure needs none

    groups, fitted = {}, fitted or {}
    for row in looked.record["tests"]:
        readings = looked.readings[row["test"]]
        columns = {name: [getattr(reading, name) for reading in readings] for name in UNITS}
        variables = {
            name: ("reading", np.array(values), {"units": UNITS[name], "long_name": MEANING[name]})
            for name, values in columns.items()
        }
        response = looked.responses.get(row["test"])
        if response is not None:
            attrs = {"units": response.unit, "long_name": "displacement over source"}
            variables["response"] = ("freq", response.magnitude, attrs)
            variables["freq"] = ("freq", response.freq_hz, {"units": "Hz"})  # its coordinate
        columns_read = {
            key: row[key] for key in ("test", "kind", "level", "drive") if row[key] is not None
        }
        if row["test"] in fitted:  # of no family of tones
            columns_read["fitted"] = int(fitted[row["test"]])
        groups[place("look", row["test"])] = xr.Dataset(variables, attrs=columns_read)
    return groups


def _seen(test: Test) -> list[str]:
    """What a test shows of repeats, harmonics and noise, and points at a phase of the frequency."""
    if test.traits.is_locked:
        return [locked_sentence(test)]
    return seen_in(test, test.records)


def _curves(tests: Sequence[Test]) -> dict[str, list[Test]]:
    """Tests that are read together: single tones of a level are one curve."""
    groups_of_tests: dict[str, list[Test]] = {}
    for test in tests:
        if not test.traits.is_prescribed:
            name = f"tones at {test.level:g}" if test.is_single_tone else test.name
            groups_of_tests.setdefault(name, []).append(test)
    return groups_of_tests


def _read(tests: Sequence[Test], gain: float | None) -> tuple[list[Reading], ShownResponse | None]:
    traits = tests[0].traits
    if traits.is_controlled:
        return [reading for test in tests for reading in readings_of_points(test, gain)], None
    if traits.is_free:
        return [reading for test in tests for reading in _of_decays(test)], None
    if traits.is_steady or traits.is_curve:
        return _of_harmonics(tests)
    if not traits.is_driven or traits.is_plain:
        raise DataError(f"Tests of kind {tests[0].kind} show no resonance without a model.")
    timely = [on_time(test) for test in tests]
    lines = [driven_lines(record, test.band_hz) for test in timely for record in test.records]
    lines_read = [read_lines(reading) for reading in lines]
    return lines_read, _shown(*lines[0][:3], lines_read[0], tests[0])


def _of_decays(test: Test) -> Iterator[Reading]:
    """Along the envelopes of a test's decays, in its band or in one about its strongest line."""
    record = test.records[0]
    if test.band_hz is None:
        peak = strongest_line(record.channels[record.response], record.fs, window="boxcar")
        test = replace(test, band_hz=((1 - WIDE) * peak, (1 + WIDE) * peak))
    order = derivative_order(record.response)
    for reading in readings(test):
        y = reading.amplitude / (2 * np.pi * reading.frequency_hz) ** order
        yield from map(Reading, y.tolist(), reading.frequency_hz.tolist(), reading.damping.tolist())


def _of_harmonics(tests: Sequence[Test]) -> tuple[list[Reading], ShownResponse]:
    """From the first harmonics of a curve, near its largest motion."""
    groups = [group for group in groups_of(list(tests)) if group.order == 1]
    if not groups:
        raise DataError(f"Test {tests[0].name} has no response to a tone of its own.")
    readings_found = []
    for group in groups:
        y = group.motion[:, 0].astype(complex)  # of a response that is held it is real
        top = int(np.argmax(np.abs(y)))
        third = abs(group.motion[top, 1] / y[top]) if group.motion.shape[1] > 1 else 0.0
        read = read_curve(group.omega, group.load[:, 0].astype(complex), y)
        readings_found.append(read._replace(third=float(third) or np.nan))
    first = groups[0]
    load, motion = (x[:, 0].astype(complex) for x in (first.load, first.motion))
    return readings_found, _shown(first.omega, load, motion, readings_found[0], tests[0])


def _row(name: str, test: Test, readings: Sequence[Reading]) -> dict[str, Any]:
    """Means over the records of a test, and their scatter."""
    columns = {
        key: np.array([getattr(reading, key) for reading in readings]) for key in Reading._fields
    }
    scatter = len(readings) > 1 and not (test.traits.is_free or test.traits.is_controlled)
    return {
        "test": name,
        "kind": test.kind,
        "drive": drive_of(test),
        "level": None if np.isnan(test.level) else test.level,
        "records": len(test.records),
        "run": test.run or None,
        "assembly": test.assembly or None,
        **{key: _finite(np.mean(values)) for key, values in columns.items()},
        "y_max": float(columns["y"].max()),
        "frequency_sd": float(np.std(columns["frequency_hz"], ddof=1)) if scatter else None,
        "damping_sd": float(np.std(columns["damping"], ddof=1)) if scatter else None,
        "noise": _scatter(test),
        "coherence": _coherence(test),
    }


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _scatter(test: Test) -> float | None:
    """Scatter of repeats of one excitation over the rms of their mean; None of other tests."""
    records = test.records
    sizes = {record.num_samples for record in records}
    if len(records) < 2 or len(sizes) > 1 or not (test.traits.is_transient):
        return None
    x = np.stack([record.channels[record.response] for record in records])
    noise = np.sqrt(np.nanmean(np.nanvar(x, axis=0, ddof=1)))
    size = np.sqrt(np.nanmean(np.nanmean(x, axis=0) ** 2))
    return float(noise / size) if noise < CHANGED * size else None


def _coherence(test: Test) -> float | None:
    """Coherence of source and response about the resonance; None of tests without random noise."""
    if not test.traits.is_broadband or test.periods > 1:
        return None
    first = test.records[0]
    records = [record for record in test.records if record.num_samples == first.num_samples]
    u, y = (
        np.stack([record.channels[role] for record in records])
        for role in (first.source, first.response)
    )
    return coherence_at_resonance(u, y, first.fs, first.response)[1]


def _loop_row(test: Test) -> dict[str, Any]:
    """The secant stiffness of force loops at their largest displacement, the mean of repeats.

    Cycle by cycle of the stiffest repeat; `unit` is that of the motion, m or rad.
    """
    loops = [forced_loop(record) for record in test.records]
    secants = np.array([_secant(test, loop) for loop in loops])
    y, stiffness = np.mean(secants, axis=0)
    cycles = readings_of_cycles(loops[int(np.argmax(secants[:, 1]))])
    return {
        "test": test.name,
        "y": float(y),
        "stiffness": float(stiffness),
        "unit": test.records[0].units.get("displacement", "m"),
        "cycles": [
            {name: _finite(value) for name, value in cycle._asdict().items()}
            | {"repeated": cycle.repeated}
            for cycle in cycles
        ],
    }


def _secant(test: Test, loop: ForcedLoop) -> tuple[float, float]:
    """Half of the displacement between a loop's ends [m], and the stiffness between them [N/m]."""
    ends = [int(np.nanargmin(loop.displacement)), int(np.nanargmax(loop.displacement))]
    (bottom, top), force = loop.displacement[ends], loop.force[ends]
    if top == bottom:
        raise DataError(f"Test {test.name} holds its displacement still.")
    return 0.5 * (top - bottom), (force[1] - force[0]) / (top - bottom)


def _shown(
    omega: Float[np.ndarray, " line"],
    source: Complex[np.ndarray, " line"],
    y: Complex[np.ndarray, " line"],
    read: Reading,
    test: Test,
) -> ShownResponse:
    """A response about its resonance, as it is drawn."""
    centre = 2 * np.pi * read.frequency_hz
    half = max(0.02, min(WIDE, 10 * abs(read.damping))) * centre
    near = np.flatnonzero(np.abs(omega - centre) < half)[:NUM_SHOWN]
    record = test.records[0]
    unit = next((record.units[role] for role in INPUTS if role in record.units), "N")
    shown = omega[near] / (2 * np.pi), np.abs(y[near] / source[near])
    return ShownResponse(*shown, per(UNIT_OF["displacement"], unit))


def read_of_shaker(spec: TestSpec, record: Record) -> str:
    """The shaker's attachment and the mode that it moves; or why they cannot be read."""
    test = Test(
        spec.kind, (record,), name=spec.name, band_hz=spec.band, periods=spec.periods,
        settle=spec.settle,
    )  # fmt: skip
    try:
        return shaker_sentence(spec.name, read_shaker(test))
    except JbwError as error:
        return no_shaker(spec.name, " ".join(str(error).split()))


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
        sentences += (
            answers if hz is None else [messages.of_mode(hz, sentence) for sentence in answers]
        )
    sentences += days(record["tests"])
    coherent = [row for row in record["tests"] if row["coherence"] is not None]
    if len(coherent) > 1:
        ends = [(row["coherence"], row["test"]) for row in (coherent[0], coherent[-1])]
        sentences.append(messages.coherence(*ends))
    loops = sorted(record["loops"], key=lambda row: row["y"])
    if len(loops) > 1:
        first, last = loops[0], loops[-1]
        change = last["stiffness"] / first["stiffness"] - 1
        unit = "mrad" if first["unit"] == "rad" else "mm"
        sentences.append(messages.secant(first["y"], last["y"], change, unit))
    sentences += [sentence for loop in loops if (sentence := _worn(loop))]
    reasons: dict[str, list[str]] = {}
    for name, why in record["unread"].items():
        reasons.setdefault(why, []).append(name)
    return [*sentences, *(messages.not_read(names, why) for why, names in reasons.items())]


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
    return messages.worn(loop["test"], loop["cycles"].index(last) + 1, change)


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
    unchanged = [messages.no_change("frequency"), messages.no_change("damping ratio")]
    is_seen = turn is not None or changes != unchanged
    return Nonlinear(is_seen, messages.nonlinear(is_seen, y.tolist(), changes))


def _change(what: str, band: Band, least: float, power: Band) -> str:
    """How one quantity changes, as a part of a sentence; a softening falls where it is positive."""
    low, middle, high = sorted(band)
    if low <= 0.0 <= high or abs(middle) < least:
        return messages.no_change(what)
    size = sorted(100 * abs(x) for x in band)
    falls = (middle > 0.0) == (what == "frequency")
    unit = "" if what == "frequency" else " of critical damping"
    return messages.change(what, (size[0], size[1], size[2]), power, falls=falls, unit=unit)


def _between_ends(y: Values, frequency: Values, damping: Values) -> Nonlinear:
    """The same of too few readings for an exponent: the last held against the first."""
    half_width = abs(float(damping[0]))
    if len(frequency) < 2:
        return Nonlinear(False, messages.one_reading(float(y[0])))
    shift, growth = float(frequency[-1] / frequency[0] - 1), float(damping[-1] / damping[0] - 1)
    shifts, grows = abs(shift) > CLEAR * half_width, abs(growth) > CLEAR
    kind = ("softens" if shift < 0 else "hardens") if shifts else "changes its damping"
    ends = float(damping[0]), float(damping[-1])
    kind = kind if shifts or grows else ""
    sentence = messages.between_ends(y.tolist(), shift, abs(shift) / half_width, ends, kind)
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
    return [messages.onset(float(y[first]), names[first], SURE)]


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
    return [messages.session_scatter(max(map(len, several)), scatter)]
