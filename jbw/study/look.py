"""Frequency and damping against amplitude, as records show them without a model of the joint.

Every driven record is read near its resonance as that of a linear oscillator. Free decays are read
along their envelopes, steady tones and response curves from their harmonics, force loops by their
secant stiffness. The readings show whether the structure is nonlinear, how much, and from which
motion on.
"""

import logging
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.special import fdtrc

from jbw.campaign.load import Campaign
from jbw.campaign.tables import TestSpec, force_per_unit, gain_of
from jbw.errors import DataError, JbwError
from jbw.identification.shaker import read_shaker, shaker_sentence
from jbw.measurement.channels import rms
from jbw.measurement.curves import ForcedLoop, forced_loop
from jbw.measurement.delays import on_time
from jbw.measurement.envelopes import bands_of
from jbw.measurement.faults.begins_late import blows_seen
from jbw.measurement.faults.examine import examined_sweep, read_decays
from jbw.measurement.faults.unlike_gains import FAR_OFF
from jbw.measurement.faults.unlike_gains import UNITS as FACTORS
from jbw.measurement.loops import readings_of_cycles
from jbw.measurement.nonlinearity import coherence_at_resonance, seen_in
from jbw.measurement.readings.statement import (
    LEAST_RANGE,
    RECORDS,
    AmplitudeTrend,
    RecordTable,
    in_steady_motion,
    laws_with,
    nearby,
    trend,
)
from jbw.measurement.readings.table import ModeReading
from jbw.measurement.records import INPUTS, Record, Test, drive_of
from jbw.measurement.resonances import (
    MISSED,
    WIDE,
    Reading,
    driven_lines,
    locked_sentence,
    read_curve,
    read_lines,
    readings_of_points,
)
from jbw.observables.harmonic_groups import groups_of
from jbw.quantities import UNIT_OF, per
from jbw.report.messages import look as messages
from jbw.report.messages.look import NO_OSCILLATOR
from jbw.report.messages.study import no_shaker
from jbw.results.run import StoredCycle, StoredLook, StoredLoop, StoredReading
from jbw.results.stored import finite
from jbw.verification.places import place

if TYPE_CHECKING:
    import xarray as xr

logger = logging.getLogger("jbw")
# If the standard deviation between records, relative to the rms of their mean, exceeds this, the
# records are no repeats.
CHANGED = 0.5
# A record is in another unit if the variation of the frequency between records falls below this
# fraction with the unit's factor, and with no factor of another record. It takes three records to
# tell which one it is; of more, those farthest from the others are tried.
AGREES, LEAST_FOR_UNIT, MOST_FOR_UNIT = 0.1, 3, 3
# A record that raises one of these errors is listed as unreadable; the others are evaluated.
UNREADABLE = (DataError, ValueError, np.linalg.LinAlgError)
NUM_SHOWN = 2000  # largest number of spectral lines that a figure of a response shows
UNITS = {"y": "m", "frequency_hz": "Hz", "damping": "1", "frequency_sd": "Hz", "damping_sd": "1"}
MEANING = {
    "y": "motion", "frequency_hz": "natural frequency", "damping": "damping ratio",
    "frequency_sd": "standard deviation of frequency",
    "damping_sd": "standard deviation of damping",
}  # fmt: skip
# Relative change of secant stiffness during equal cycles. The test rig alone causes changes below
# this.
WORN = 0.02
# Change of frequency divided by the half width of the resonance, or relative change of damping.
# Noise in a clear resonance causes changes below this.
CLEAR = 0.2
# probability below which offsets of records are not random but depend on their order or run
RISES = 1e-3
ORDERED = 4  # smallest number of records for which a dependence on their order is tested
# smallest number of values below an amplitude that show the structure to be linear there
PLATEAU = 3


class ShownResponse(NamedTuple):
    """A measured frequency response: displacement per unit of the source."""

    freq_hz: Float[np.ndarray, " line"]
    magnitude: Float[np.ndarray, " line"]
    unit: str


@dataclass(frozen=True)
class Look:
    """The result of `look`: the stored record; measured values, tables and responses by test."""

    record: StoredLook
    readings: dict[str, list[Reading]]
    tables: dict[str, list[RecordTable]]
    responses: dict[str, ShownResponse]

    def steady(self, test: Test) -> list[RecordTable]:
        """Return the tables of a test with the damping of a steady motion; none if unread."""
        tables = self.tables.get(test.name, [])
        return [in_steady_motion(t) for t in tables] if test.traits.is_free else tables


def look(campaign: Campaign, report: Callable[[str], Any] = logger.info) -> Look:
    """Measure frequency and damping against amplitude for every test, without a model of the joint.

    Args:
        campaign: A campaign from `jbw.load_campaign`.
        report: A function that is called with one sentence per test.
    """
    readings_of: dict[str, list[Reading]] = {}
    tables_of: dict[str, list[RecordTable]] = {}
    responses: dict[str, ShownResponse] = {}
    rows, unread, per_unit = [], {}, force_per_unit(campaign)
    campaign = replace(campaign, tests=tuple(_of_first_mode(campaign)))
    for name, tests in _curves(campaign.tests).items():
        report(f"Reading {name}")
        try:
            read, response = _read(tests, gain_of(per_unit, drive_of(tests[0])))
            held = [kept for one in read if (kept := _holding(one)) is not None]
            count, num = (sum(len(one.rows) for one in some) for some in (held, read))
            if count < num:
                left_out = f"{num - count} of {num} readings of {name} (left out)"
                unread[left_out] = NO_OSCILLATOR
            if not held:
                continue
            rows.append(_row(name, tests[0], held))
        except UNREADABLE as why:
            unread[name] = str(why).splitlines()[0]
            continue
        readings_of[name] = [row for one in held for row in one.rows]
        tables_of[name] = [one.table for one in held]
        if response is not None:
            responses[name] = response
    loops = []
    for test in campaign.tests:
        if test.traits.is_prescribed:
            try:
                loops.append(_loop_row(test))
            except UNREADABLE as why:
                unread[test.name] = str(why).splitlines()[0]
    record = StoredLook(
        campaign=campaign.name,
        tests=sorted(rows, key=lambda row: row.y),
        loops=loops,
        unread=unread,
        seen=[sentence for test in campaign.tests for sentence in _seen(test)],
    )
    sentences, laws = statements(record, tables_of, _modes_hz(campaign))
    record = record.replaced(statements=sentences, laws=list(laws))
    return Look(record, readings_of, tables_of, responses)


def _modes_hz(campaign: Campaign) -> tuple[float, ...]:
    """Return the frequencies of the elastic modes [Hz], from the campaign or its matrices."""
    if campaign.joints is not None:
        return tuple(float(hz) for hz in campaign.joints.model.frequencies_hz if hz > 0)
    return () if campaign.structure is None else campaign.structure.modes


def _of_first_mode(campaign: Campaign) -> Iterator[Test]:
    """Yield the tests of a campaign; restrict free decays to the band of the first mode."""
    structure = campaign.structure
    modes_hz = () if structure is None else structure.modes
    for test in campaign.tests:
        if len(modes_hz) < 2 or not test.traits.is_free or test.band_hz is None:
            yield test
        else:
            yield replace(test, band_hz=bands_of(modes_hz, test)[0])


def look_quietly(campaign: Campaign) -> Look:
    """Measure a campaign's frequency and damping without repeating warnings given earlier."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return look(campaign, report=lambda _: None)


def look_groups(looked: Look, fitted: Mapping[str, bool] | None = None) -> "dict[str, xr.Dataset]":
    """Return each test's measured frequency, damping and response as groups of a result.

    `fitted` gives by test name whether a posterior was fitted to records of the test.
    """
    import xarray as xr  # This import is slow and needed only here.

    groups, fitted = {}, fitted or {}
    for row in looked.record.tests:
        readings = looked.readings[row.test]
        columns = {name: [getattr(reading, name) for reading in readings] for name in UNITS}
        variables = {
            name: ("reading", np.array(values), {"units": UNITS[name], "long_name": MEANING[name]})
            for name, values in columns.items()
        }
        response = looked.responses.get(row.test)
        if response is not None:
            attrs = {"units": response.unit, "long_name": "displacement over source"}
            variables["response"] = ("freq", response.magnitude, attrs)
            # "freq" is the coordinate of the response.
            variables["freq"] = ("freq", response.freq_hz, {"units": "Hz"})
        stated = {"test": row.test, "kind": row.kind, "level": row.level, "drive": row.drive}
        if row.test in fitted:  # A group of tones that was analysed together has no entry.
            stated["fitted"] = int(fitted[row.test])
        attrs = {key: value for key, value in stated.items() if value is not None}
        groups[place("look", row.test)] = xr.Dataset(variables, attrs=attrs)
    return groups


def _seen(test: Test) -> list[str]:
    """Return sentences on a test's repeats, harmonics and noise, or on its phase control."""
    if test.traits.is_locked:
        return [locked_sentence(test)]
    blows = blows_seen(test.name, [record.provenance for record in test.records])
    return [*blows, *seen_in(test, test.records)]


def _curves(tests: Sequence[Test]) -> dict[str, list[Test]]:
    """Group tests that are analysed together: all single tones of one level form a curve."""
    groups_of_tests: dict[str, list[Test]] = {}
    for test in tests:
        if not test.traits.is_prescribed:
            name = f"tones at {test.level:g}" if test.is_single_tone else test.name
            groups_of_tests.setdefault(name, []).append(test)
    return groups_of_tests


class RecordRead(NamedTuple):
    """Frequency and damping measured in one record: rows for a report, and a table with errors."""

    rows: tuple[Reading, ...]
    table: RecordTable


def _read(
    tests: Sequence[Test], gain: float | None
) -> tuple[list[RecordRead], ShownResponse | None]:
    traits = tests[0].traits
    if traits.is_controlled:
        return [_of_rows([row]) for test in tests for row in readings_of_points(test, gain)], None
    if traits.is_free:
        # A decay is measured in its band, or at its strongest line if it has no band.
        decays = (read for test in tests for read in read_decays(test))
        return [_of_reading(read) for read in decays if read is not None], None
    if traits.is_steady or traits.is_curve:
        return _of_harmonics(tests)
    if not traits.is_driven or traits.is_plain:
        raise DataError(
            f"Frequency and damping of tests of kind {tests[0].kind} cannot be determined without "
            "a model of the joint.",
            remedy="Identify the joint: jbw identify CAMPAIGN.toml.",
        )
    timely = [on_time(test) for test in tests]
    lines = [driven_lines(record, test.band_hz) for test in timely for record in test.records]
    linear = [read_lines(reading) for reading in lines]
    of_records = [_of_rows([row]) for row in linear]
    if traits.is_transient:
        records = [(record, test) for test in tests for record in test.records]
        of_records = [
            _of_sweep(record, test) or alone
            for (record, test), alone in zip(records, of_records, strict=True)
        ]
    return of_records, _shown(*lines[0][:3], linear[0], tests[0])


def _of_rows(rows: Sequence[Reading]) -> RecordRead:
    y, hz, zeta, hz_sd, zeta_sd = (
        np.array([getattr(row, name) for row in rows], float)
        for name in ("y", "frequency_hz", "damping", "frequency_sd", "damping_sd")
    )
    of_hz, of_zeta = (np.diag(np.nan_to_num(sd) ** 2) for sd in (hz_sd, zeta_sd))
    return RecordRead(tuple(rows), RecordTable(y, hz, zeta, of_hz, of_zeta))


def _of_reading(read: ModeReading) -> RecordRead:
    """Return frequency and damping along a decay or sweep as rows and as a table by amplitude."""
    table = read.table()
    sds = (np.sqrt(np.diag(x)) for x in (table.hz_covariance, table.zeta_covariance))
    columns = table.y, table.hz, table.zeta, *sds
    rows = tuple(
        Reading(y, hz, zeta, read.linear_residual, np.nan, hz_sd, zeta_sd, read.residual)
        for y, hz, zeta, hz_sd, zeta_sd in zip(*(x.tolist() for x in columns), strict=True)
    )
    return RecordRead(rows, table)


def _of_sweep(record: Record, test: Test) -> RecordRead | None:
    """Measure frequency and damping of a sweep; return None if it is no sweep or the fit is bad."""
    read = examined_sweep(record, test.band_hz, test.delay).reading
    return None if read is None or read.residual > MISSED else _of_reading(read)


def _holding(one: RecordRead) -> RecordRead | None:
    """Remove unphysical values of frequency and damping; return None if none remains."""
    holds = np.array([row.holds for row in one.rows])
    if np.all(holds):
        return one
    kept = np.flatnonzero(holds)
    if not len(kept):
        return None
    square = np.ix_(kept, kept)
    table = one.table
    return RecordRead(
        tuple(one.rows[i] for i in kept),
        table._replace(
            y=table.y[kept], hz=table.hz[kept], zeta=table.zeta[kept],
            hz_covariance=table.hz_covariance[square],
            zeta_covariance=table.zeta_covariance[square],
        ),
    )  # fmt: skip


def _of_harmonics(tests: Sequence[Test]) -> tuple[list[RecordRead], ShownResponse]:
    """Measure frequency and damping from response curves near their largest motion."""
    groups = [group for group in groups_of(list(tests)) if group.order == 1]
    if not groups:
        raise DataError(
            f"Test {tests[0].name} must contain a response to a single tone, but does not.",
            remedy=f"Leave out {tests[0].name}, or measure a response to one tone at a time.",
        )
    readings_found = []
    for group in groups:
        # If a test controls the amplitude of the response, the motion is stored as real numbers.
        y = group.motion[:, 0].astype(complex)
        top = int(np.argmax(np.abs(y)))
        third = abs(group.motion[top, 1] / y[top]) if group.motion.shape[1] > 1 else 0.0
        read = read_curve(group.omega, group.load[:, 0].astype(complex), y)
        readings_found.append(_of_rows([read._replace(third=float(third) or np.nan)]))
    first = groups[0]
    load, motion = (x[:, 0].astype(complex) for x in (first.load, first.motion))
    return readings_found, _shown(first.omega, load, motion, readings_found[0].rows[0], tests[0])


def _row(name: str, test: Test, records: Sequence[RecordRead]) -> StoredReading:
    """Return a test's frequency and damping at its largest motion, as means over its records.

    An error combines that of a single record with the standard deviation between records.
    """
    tops = [max(one.rows, key=lambda row: row.y) for one in records]
    columns = {key: np.array([getattr(row, key) for row in tops]) for key in Reading._fields}
    spread = {
        key: finite(np.hypot(np.std(columns[of], ddof=1) if len(tops) > 1 else 0.0,
                              np.mean(columns[key])))
        for key, of in (("frequency_sd", "frequency_hz"), ("damping_sd", "damping"))
    }  # fmt: skip
    means: dict[str, Any] = {key: finite(np.mean(values)) for key, values in columns.items()}
    return StoredReading(
        test=name,
        kind=test.kind,
        drive=drive_of(test),
        level=finite(test.level),
        records=len(test.records),
        run=test.run or None,
        assembly=test.assembly or None,
        **{**means, **spread},
        y_min=min(row.y for one in records for row in one.rows),
        y_max=max(row.y for row in tops),
        noise=_scatter(test),
        coherence=_coherence(test),
    )


def _scatter(test: Test) -> float | None:
    """Return repeats' standard deviation over the rms of their mean; None if not comparable."""
    records = test.records
    sizes = {record.num_samples for record in records}
    if len(records) < 2 or len(sizes) > 1 or not (test.traits.is_transient):
        return None
    x = np.stack([record.channels[record.response] for record in records])
    noise = np.sqrt(np.nanmean(np.nanvar(x, axis=0, ddof=1)))
    size = np.sqrt(np.nanmean(np.nanmean(x, axis=0) ** 2))
    return float(noise / size) if noise < CHANGED * size else None


def _coherence(test: Test) -> float | None:
    """Return the coherence of source and response at resonance; None if the noise is periodic."""
    if not test.traits.is_broadband or test.periods > 1:
        return None
    first = test.records[0]
    records = [record for record in test.records if record.num_samples == first.num_samples]
    u, y = (
        np.stack([record.channels[role] for record in records])
        for role in (first.source, first.response)
    )
    return coherence_at_resonance(u, y, first.fs, first.response)[1]


def _loop_row(test: Test) -> StoredLoop:
    """Return the mean secant stiffness of repeated force loops at their largest displacement.

    `cycles` are those of the stiffest repeat; `unit` is the unit of the motion, m or rad.
    """
    loops = [forced_loop(record, test.delay) for record in test.records]
    secants = np.array([_secant(test, loop) for loop in loops])
    y, stiffness = np.mean(secants, axis=0)
    cycles = readings_of_cycles(loops[int(np.argmax(secants[:, 1]))])
    return StoredLoop(
        test=test.name,
        y=float(y),
        stiffness=float(stiffness),
        unit=test.records[0].units.get("displacement", "m"),
        cycles=[
            StoredCycle.read(
                {name: finite(value) for name, value in cycle._asdict().items()}
                | {"repeated": cycle.repeated}
            )
            for cycle in cycles
        ],
    )


def _secant(test: Test, loop: ForcedLoop) -> tuple[float, float]:
    """Return half the displacement between the ends of a loop [m], and its stiffness [N/m]."""
    ends = [int(np.nanargmin(loop.displacement)), int(np.nanargmax(loop.displacement))]
    (bottom, top), force = loop.displacement[ends], loop.force[ends]
    if top == bottom:
        raise DataError(
            f"The displacement of test {test.name} is constant.",
            remedy=f"Check the sensor of the displacement, or leave test {test.name} out.",
        )
    return 0.5 * (top - bottom), (force[1] - force[0]) / (top - bottom)


def _shown(
    omega: Float[np.ndarray, " line"],
    source: Complex[np.ndarray, " line"],
    y: Complex[np.ndarray, " line"],
    read: Reading,
    test: Test,
) -> ShownResponse:
    """Return that part of a frequency response that lies near the resonance, for a figure."""
    centre = 2 * np.pi * read.frequency_hz
    half = max(0.02, min(WIDE, 10 * abs(read.damping))) * centre
    near = np.flatnonzero(np.abs(omega - centre) < half)[:NUM_SHOWN]
    record = test.records[0]
    unit = next((record.units[role] for role in INPUTS if role in record.units), "N")
    shown = omega[near] / (2 * np.pi), np.abs(y[near] / source[near])
    return ShownResponse(*shown, per(UNIT_OF["displacement"], unit))


def read_of_shaker(spec: TestSpec, record: Record) -> str:
    """Return a sentence on the attachment of a shaker, or on why it is not identified."""
    test = Test(
        spec.kind, (record,), name=spec.name, band_hz=spec.band, periods=spec.periods,
        settle=spec.settle,
    )  # fmt: skip
    try:
        return shaker_sentence(spec.name, read_shaker(test))
    except JbwError as error:
        return no_shaker(spec.name, " ".join(str(error).split()))


def statements(
    record: StoredLook,
    by_test: Mapping[str, list[RecordTable]],
    modes_hz: Sequence[float] = (),
) -> tuple[list[str], tuple[str, ...]]:
    """Return sentences on measured frequency and damping, and the laws that these suggest.

    The sentences state whether records differ, and how frequency and damping depend on amplitude.
    Several modes are reported separately, each from the readings nearest to its frequency.
    """
    sentences, laws = [], ()
    labels = {row.test: row.assembly or row.run or "" for row in record.tests}
    for hz, tables in _by_mode(by_test, modes_hz).items():
        of_mode = [table for _, table in tables], [labels.get(name, "") for name, _ in tables]
        try:
            answer = nonlinear(*of_mode)
        # An identification continues even if, for example, measured values have no errors.
        except UNREADABLE:
            answer = Nonlinear(False, [messages.NOT_STATED])
        laws = laws or answer.laws
        sentences += [
            sentence if hz is None else messages.of_mode(hz, sentence)
            for sentence in answer.sentences
        ]
    sentences += days(record.tests)
    coherent = [(row.coherence, row.test) for row in record.tests if row.coherence is not None]
    if len(coherent) > 1:
        sentences.append(messages.coherence(coherent[0], coherent[-1]))
    loops = sorted(record.loops, key=lambda row: row.y)
    if len(loops) > 1:
        first, last = loops[0], loops[-1]
        change = last.stiffness / first.stiffness - 1
        unit = "mrad" if first.unit == "rad" else "mm"
        sentences.append(messages.secant(first.y, last.y, change, unit))
    sentences += [sentence for loop in loops if (sentence := _worn(loop))]
    reasons: dict[str, list[str]] = {}
    for name, why in record.unread.items():
        reasons.setdefault(why, []).append(name)
    unread = [messages.not_read(names, why) for why, names in reasons.items()]
    return [*sentences, *unread], laws


def _by_mode(
    by_test: Mapping[str, list[RecordTable]], modes_hz: Sequence[float]
) -> dict[float | None, list[tuple[str, RecordTable]]]:
    """Group tables of frequency and damping, with their tests, by the nearest mode [Hz]."""
    groups: dict[float | None, list[tuple[str, RecordTable]]] = {
        _nearest(mode_hz, modes_hz): [] for mode_hz in modes_hz or (1.0,)
    }
    for name, tables in by_test.items():
        for table in tables:
            groups[_nearest(float(np.mean(table.hz)), modes_hz)].append((name, table))
    return {hz: group for hz, group in groups.items() if group}


def _nearest(frequency_hz: float, modes_hz: Sequence[float]) -> float | None:
    """Return the mode nearest to a frequency [Hz]; None if the structure has only one mode."""
    if len(modes_hz) < 2:
        return None
    return min(modes_hz, key=lambda hz: abs(np.log(frequency_hz / hz)))


class Nonlinear(NamedTuple):
    """The answer whether frequency or damping depends on amplitude, with laws worth a fit."""

    is_seen: bool
    sentences: list[str]
    laws: tuple[str, ...] = ()


def _worn(loop: StoredLoop) -> str | None:
    """Return a sentence on stiffness that changes during equal cycles; None for a small change."""
    changes = {
        number: cycle.retained - 1
        for number, cycle in enumerate(loop.cycles, start=1)
        if cycle.retained is not None
    }
    last = max(changes, key=lambda number: abs(changes[number]), default=None)
    if last is None or abs(changes[last]) < WORN:
        return None
    return messages.worn(loop.test, last, changes[last])


def nonlinear(tables: Sequence[RecordTable], labels: Sequence[str] = ()) -> Nonlinear:
    """Return whether frequency and damping change with amplitude, from one table per record.

    Args:
        tables: Tables of readings, in the order in which the records were measured.
        labels: Run or assembly of each record; empty where none is stated.
    """
    y = [
        min(float(table.y.min()) for table in tables),
        max(float(table.y.max()) for table in tables),
    ]
    hz, zeta = trend(tables, "hz"), trend(tables, "zeta")
    differ = _differing(hz, zeta, labels)
    if differ and (found := in_another_unit(tables, hz)):
        differ = [messages.another_unit(*found)]
    if y[1] < LEAST_RANGE * y[0]:
        return Nonlinear(False, [*differ, messages.one_amplitude(y[1], len(tables))])
    if not (hz.is_seen or zeta.is_seen) and all(len(table.y) == 1 for table in tables):
        return _between_ends(sorted(tables, key=lambda table: float(table.y[0])), differ)
    changes = [_change("frequency", hz), _change("damping ratio", zeta)]
    is_seen = hz.is_seen or zeta.is_seen
    sentences = [*differ, messages.nonlinear(is_seen, y, len(tables), changes)]
    laws = laws_with(hz, zeta) if is_seen else ()
    if laws:
        sentences.append(messages.likely_laws(laws))
    elif is_seen:  # Laws of a near power are worth a fit, but they are not said to have this power.
        laws = laws_with(nearby(hz), nearby(zeta))
    if hz.is_seen and hz.onset is not None:
        plateau = sum(int(np.sum(table.y < hz.onset)) for table in tables)
        sentences.append(messages.onset(hz.onset, is_linear=plateau >= PLATEAU))
    return Nonlinear(is_seen, sentences, laws)


def _change(what: str, seen: AmplitudeTrend) -> str:
    unit = "" if what == "frequency" else " of critical damping"
    if not seen.is_seen:
        return messages.no_change(what, seen.change, seen.change_sd, unit)
    if seen.turn is not None:
        return messages.turning(what, *seen.turn, seen.change)
    return messages.change(what, seen.change, seen.change_sd, seen.exponent, unit)


def _differing(hz: AmplitudeTrend, zeta: AmplitudeTrend, labels: Sequence[str]) -> list[str]:
    """Return the sentence on records that differ at equal amplitude, with the likely cause."""
    seen = [
        (name, one.scatter)
        for name, one in (("frequency", hz), ("damping ratio", zeta))
        if one.records_chance < RECORDS and one.scatter > 0
    ]
    if not seen:
        return []
    offsets = np.array(
        [offset for offset, _ in (hz if seen[0][0] == "frequency" else zeta).offsets]
    )
    return [messages.records_differ(seen, _goes_with(offsets, labels))]


def in_another_unit(
    tables: Sequence[RecordTable], hz: AmplitudeTrend
) -> tuple[int, int, float, str] | None:
    """Return the number of a record whose unit is wrong, of all, and its factor and unit; or None.

    With the amplitudes of this one record times the factor, the frequencies of all records agree at
    equal amplitude.
    """
    count = len(tables)
    if count < LEAST_FOR_UNIT or hz.scatter == 0:
        return None
    far = np.argsort([-abs(offset) for offset, _ in hz.offsets])[:MOST_FOR_UNIT]
    agreed: dict[int, tuple[float, float]] = {}
    for i in map(int, far):
        for factor in (each for each in FACTORS if not 1 / FAR_OFF < each < FAR_OFF):
            scaled = [t._replace(y=t.y * factor) if t is tables[i] else t for t in tables]
            found = trend(scaled, "hz")
            left = found.scatter / hz.scatter
            if found.is_seen and left < agreed.get(i, (AGREES,))[0]:
                agreed[i] = left, factor
    if len(agreed) != 1:
        return None
    ((i, (_, factor)),) = agreed.items()
    return i + 1, count, factor, FACTORS[factor]


def _goes_with(offsets: np.ndarray, labels: Sequence[str]) -> str:
    """Return "runs" if records differ from run to run, "order" if they drift, else no text."""
    count = len(offsets)
    groups = [offsets[[label == name for label in labels]] for name in dict.fromkeys(labels)]
    if 1 < len(groups) < count:
        within = sum(float(np.sum((group - group.mean()) ** 2)) for group in groups)
        total = float(np.sum((offsets - offsets.mean()) ** 2))
        ratio = (total - within) / (len(groups) - 1) / (within / (count - len(groups)) + 1e-300)
        if fdtrc(len(groups) - 1, count - len(groups), ratio) < RISES:
            return "runs"
    if count >= ORDERED:
        r = float(np.corrcoef(np.arange(count), offsets)[0, 1])
        ratio = r**2 * (count - 2) / max(1 - r**2, 1e-300)
        if fdtrc(1, count - 2, ratio) < RISES:
            return "order"
    return ""


def _between_ends(tables: Sequence[RecordTable], differ: list[str]) -> Nonlinear:
    """Compare the weakest with the strongest record, if there are too few values for a trend."""
    y, frequency, damping = (
        [float(getattr(table, name)[0]) for table in tables] for name in ("y", "hz", "zeta")
    )
    half_width = abs(damping[0])
    shift, growth = frequency[-1] / frequency[0] - 1, damping[-1] / damping[0] - 1
    shifts, grows = abs(shift) > CLEAR * half_width, abs(growth) > CLEAR
    kind = ("softens" if shift < 0 else "hardens") if shifts else "changes its damping"
    ends = damping[0], damping[-1]
    kind = kind if shifts or grows else ""
    sentence = messages.between_ends(y, shift, abs(shift) / half_width, ends, kind)
    return Nonlinear(shifts or grows, [*differ, sentence])


def days(rows: Sequence[StoredReading]) -> list[str]:
    """Return a sentence on how frequency and damping vary within a session and between sessions."""
    groups: dict[tuple[Any, ...], dict[tuple[Any, ...], list[StoredReading]]] = {}
    for row in rows:
        day = row.assembly, row.run
        if any(day):
            of_level = groups.setdefault((row.kind, row.level), {})
            of_level.setdefault(day, []).append(row)
    several = [list(group.values()) for group in groups.values() if len(group) > 1]
    within = [row for group in several for day in group for row in day if row.frequency_sd]
    if not within:
        return []
    scatter = []
    for name, key in (("frequency", "frequency_hz"), ("damping", "damping")):
        inner = rms([getattr(row, f"{name}_sd") / getattr(row, key) for row in within])
        means = [
            [np.mean([getattr(row, key) for row in day]) for day in group] for group in several
        ]
        outer = rms([float(np.std(level, ddof=1) / np.mean(level)) for level in means])
        scatter.append((name, inner, outer))
    return [messages.session_scatter(max(map(len, several)), scatter)]
