"""Data groups of harmonics in steady motion: tones, stepped sines, response curves."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from jbw.errors import DataError
from jbw.measurement.curves import MeasuredCurve, displacement_of, response_curve
from jbw.measurement.harmonics import harmonics
from jbw.measurement.records import Test, run_of
from jbw.quantities import UNIT_OF, derivative_order, per

# number of odd harmonics in the harmonic balance; omitted harmonics are below 1e-6 of the first
NUM_HARMONICS = 4
# orders of harmonics that are compared; other orders only give starting values
ORDERS = (1, 3)
HIGHEST = 2 * NUM_HARMONICS - 1
# A harmonic is used if its frequency is below this fraction of the sampling frequency.
BELOW_NYQUIST = 0.499
NO_AMPLITUDE = 1e-9  # amplitude that replaces zero, in the unit of the source
# A controller held the response if it varies by less than this fraction of the source's variation.
CONTROLLED = 1 / 3


class MeasuredHarmonic(NamedTuple):
    """One measured harmonic of one test, from which a data group is formed.

    Attributes:
        omega: Frequencies [rad/s].
        load: Odd harmonics of the source, with phases relative to its first [unit of the source].
        motion: Odd harmonics of the displacement, zero if not measured [m].
        order: Order of the harmonic of the response or, with `of_force`, of the force.
        repeats: Values of every repeat.
        factor: Factor from metres, or N/kg, to the unit of the values.
        unit: Unit of the values.
    """

    label: str
    run: str
    omega: Float[np.ndarray, " value"]
    load: Complex[np.ndarray, "value harmonic"]
    motion: Complex[np.ndarray, "value harmonic"]
    order: int
    repeats: Complex[np.ndarray, "repeat value"]
    factor: Complex[np.ndarray, " value"]
    of_force: bool = False
    unit: str = ""

    @property
    def values(self) -> Complex[np.ndarray, " value"]:
        """The mean of the measured values over the repeats."""
        return self.repeats.mean(axis=0)


def groups_of(tests: Sequence[Test]) -> list[MeasuredHarmonic]:
    """Return the data groups of steady tests (tone, stepped sine, FRF) whose noise is known."""
    single = [test for test in tests if test.kind == "tones" and len(test.tones_hz) == 1]
    groups = tone_groups(single)
    for test in tests:
        if test.kind == "stepped":
            groups += stepped_groups(test)
        elif test.kind == "frf":
            groups.append(curve_group(test))
    lone = [group.label for group in groups if group.repeats.size < 2]
    if lone:
        warnings.warn(
            f"Not fitted, because one frequency and one repeat do not determine the noise: "
            f"{', '.join(lone)}. Measure repeats, or more tones at the same level.",
            stacklevel=2,
        )
    return [group for group in groups if group.label not in lone]


def tone_groups(tests: Sequence[Test]) -> list[MeasuredHarmonic]:
    """Return the harmonics of single-tone tests, with one data group per level and run."""
    families: dict[tuple[float, str, int], list[Test]] = {}
    for test in tests:
        run = run_of(test) if test.assembly or test.run else ""
        families.setdefault((test.level, run, len(test.records)), []).append(test)
    groups = []
    for (_, run, _), family in families.items():
        label = family_of(family[0]) if len(family) > 1 else family[0].name
        omega = 2 * np.pi * np.array([test.tones_hz[0] for test in family])
        spans = [
            [(record, (test.settle, record.num_samples / record.fs)) for record in test.records]
            for test in family
        ]
        groups += _groups(label, run or label, omega, spans, [test.delay for test in family])
    return groups


def family_of(test: Test) -> str:
    """Return the common name of a level's single-tone tests; an empty text for other tests."""
    return f"tones {test.level:g}" if test.is_single_tone else ""


def harmonic_label(name: str, order: int) -> str:
    """Return the label of the data group of a harmonic of a test."""
    return f"{name} order {order}"


def stepped_groups(test: Test) -> list[MeasuredHarmonic]:
    """Return the harmonics at each frequency of a stepped sine; omit its transients."""
    needed = len(test.tones_hz) * test.dwell
    for record in test.records:
        if record.num_samples / record.fs < needed - 0.5 / record.fs:
            raise DataError(
                f"Record `{record.name}` must contain {len(test.tones_hz)} steps of "
                f"{test.dwell:g} s, but lasts {record.num_samples / record.fs:g} s.",
                remedy="Check `tones` and `dwell` of the test.",
            )
    starts = test.dwell * np.arange(len(test.tones_hz))
    spans = [
        [(record, (start + test.settle, start + test.dwell)) for record in test.records]
        for start in starts
    ]
    omega = 2 * np.pi * np.array(test.tones_hz)
    return _groups(test.name, run_of(test), omega, spans, [test.delay] * len(spans))


def _groups(
    label: str, run: str, omega: NDArray[np.float64], spans: list, delays: list[float]
) -> list[MeasuredHarmonic]:
    """Return one data group per harmonic order, from the repeats at every frequency."""
    amplitudes = [_points(*span) for span in zip(spans, omega, delays, strict=True)]
    source, motion = np.moveaxis(np.array(amplitudes), 2, 0)
    power = derivative_order(spans[0][0][0].response)
    groups = []
    for order in ORDERS:
        factor = (1j * order * omega) ** power
        groups.append(
            MeasuredHarmonic(
                label=harmonic_label(label, order),
                run=run,
                omega=omega,
                load=source.mean(axis=1),
                motion=motion.mean(axis=1),
                order=order,
                repeats=factor * motion[:, :, order // 2].T,
                factor=factor,
                unit=UNIT_OF[spans[0][0][0].response],
            )
        )
    return groups


def _points(repeats: list, omega: float, delay: float) -> NDArray[np.complex128]:
    """Return odd harmonics of source and displacement per repeat; phases refer to the source."""
    amplitudes = np.zeros((len(repeats), 2, NUM_HARMONICS), complex)
    by_layout: dict[tuple[float, str, int], list[int]] = {}
    for i, (record, (start, stop)) in enumerate(repeats):
        size = len(record.channels[record.source][_span(record.fs, start, stop)])
        by_layout.setdefault((record.fs, record.response, size), []).append(i)
    for (fs, response, _), members in by_layout.items():
        count = int(min(HIGHEST, BELOW_NYQUIST * 2 * np.pi * fs / omega))
        # Transform all signals at once: the sines and cosines of many samples dominate the cost.
        rows = [
            record.channels[name][_span(fs, *span)]
            for record, span in (repeats[i] for i in members)
            for name in (record.source, record.response)
        ]
        both = harmonics(np.stack(rows), fs, omega, count).amplitudes.reshape(-1, 2, count)
        n = np.arange(1, count + 1)
        power = derivative_order(response)
        both[:, 1] *= np.exp(1j * n * omega * delay) / (1j * n * omega) ** power
        turn = np.exp(-1j * n * np.angle(both[:, :1, :1]))
        amplitudes[members, :, : (count + 1) // 2] = (turn * both)[..., ::2]
    return amplitudes


def _span(fs: float, start: float, stop: float) -> slice:
    """Return the sample range between two times [s]."""
    return slice(round(start * fs), round(stop * fs))


def curve_group(test: Test) -> MeasuredHarmonic:
    """Return the fundamental of a curve's response, or of its force at controlled response."""
    curves = [response_curve(record) for record in test.records]
    if any(not np.array_equal(curve.freq_hz, curves[0].freq_hz) for curve in curves):
        raise DataError(
            f"Repeats of test `{test.name}` must have the same frequencies.",
            remedy="Make a separate test of each.",
        )
    omega = 2 * np.pi * curves[0].freq_hz
    # The curve is compared with the linear structure at an amplitude near zero, because an FRF has
    # no amplitude.
    size = NO_AMPLITUDE if curves[0].is_ratio else 1.0
    source = size * np.array([curve.source for curve in curves])
    motion = size * np.array([displacement_of(curve) for curve in curves])
    held = response_held(curves[0]) and not curves[0].is_ratio
    if held:
        # Phases refer to the motion, whose phase is exact by definition; all noise is in the force.
        factor = np.ones(len(omega), complex)
        values = source = source * np.exp(-1j * np.angle(motion))
        motion = np.abs(motion)
    else:
        factor = (1j * omega) ** derivative_order(curves[0].response_kind) / size
        values = factor * motion
    first = np.arange(NUM_HARMONICS) == 0
    return MeasuredHarmonic(
        label=test.name,
        run=run_of(test),
        omega=omega,
        load=source.mean(axis=0)[:, None] * first.astype(complex),
        motion=motion.mean(axis=0)[:, None] * first,
        order=1,
        repeats=values,
        factor=factor,
        of_force=held,
        unit=_unit_of(curves[0], test.records[0].units[curves[0].source_kind], held=held),
    )


def _unit_of(curve: MeasuredCurve, source: str, *, held: bool) -> str:
    """Return the unit of a curve's values: of force, response, or response per unit of source."""
    response = UNIT_OF[curve.response_kind]
    return source if held else per(response, source) if curve.is_ratio else response


def response_held(curve: MeasuredCurve) -> bool:
    """Return whether a controller held the response along the curve while the force varied."""
    response, source = np.abs(curve.response), np.abs(curve.source)
    return bool(response.std() / response.mean() < CONTROLLED * source.std() / source.mean())
