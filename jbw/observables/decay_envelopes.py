"""Envelopes of free decays in a band, fitted to one simulated decay of the model.

Whatever the impact, a free joint soon follows one and the same decay, which a weaker impact enters
later. Therefore the model is simulated once, from above the strongest record, and every record's
initial state is the place at which it enters (its amplitude) and a rotation (its phase).
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from jbw.errors import DataError
from jbw.measurement.demodulation import FEWEST_VALUES, BandFilter
from jbw.measurement.envelopes import envelopes, filter_of
from jbw.measurement.faults.examine import read_decays
from jbw.measurement.readings.table import ModeReading
from jbw.measurement.records import Test
from jbw.observables.groups import Groups, repeated
from jbw.observables.observable import Laws, Observable
from jbw.observables.samples import substeps_for
from jbw.oscillator.hold import namespace
from jbw.quantities import DEFAULT_LAWS, UNIT_OF, derivative_order

# number of unknowns of a record in addition to the noise: amplitude, phase, frequency shift
NUM_OWN = 3
HEADROOM = 1.02  # start amplitude of the simulated decay, relative to that of the strongest record
# duration of the simulation, relative to the duration that the measured decay rates require
SPARE = 1.3
# smallest decay rate at the start and at the end of a record, relative to its mean rate, because
# noise may hide the true rate
LEAST_RATE = 0.1
# Longest simulated time, in record lengths, until the strongest decay has fallen to the initial
# amplitude of the weakest record.
MOST_WAIT = 20.0
# The start of a record is first estimated from values above this fraction of the largest one.
LOUD = 0.3
# number of Gauss-Newton steps that find the start of a record on the simulated decay
NUM_REFINEMENTS = 3
# number of steps of the simulated decay through which a polynomial interpolates it
NODES = 6


class Envelopes(Observable):
    """The envelopes of several decays of one mode, and the filter applied to the model's decay.

    Attributes:
        mean: Peak envelope of each record about the band's centre [m/s for velocities], followed by
            zeros in shorter records; its noise is that of the real part, and of the imaginary part.
        shift_std: Scatter of the records' natural frequencies that fits assume [rad/s].
        y_start: Displacement at which the simulated decay starts [m].
        y_read: Largest displacement at which frequency and damping were read [m].
        taps: Filter of the band, for the model's samples.
        rotation: Rotation of the carrier between two values of the envelope, `step_s` [s] apart.
        stride: Number of the model's samples between two values.
        fs: Sampling frequency of the model [Hz], for `num_samples`.
        response: displacement, velocity or acceleration.
        readings: Frequency and damping along each record; None for one that cannot be read.
    """

    kinds: ClassVar[tuple[str, ...]] = ("decay",)

    shift_std: Float[Array, ""]
    y_start: Float[Array, ""]
    y_read: Float[Array, ""]
    taps: Complex[Array, " tap"]
    rotation: Complex[Array, ""]
    step_s: float = eqx.field(static=True)
    stride: int = eqx.field(static=True)
    fs: float = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    response: str = eqx.field(static=True)
    centre_hz: float = eqx.field(static=True)
    readings: Callable[[], Sequence[ModeReading | None]] = eqx.field(static=True)

    @classmethod
    def reduce(
        cls, tests: Sequence[Test], *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None
    ) -> tuple[Self, ...]:
        """Return the envelopes of the decays of each test."""
        return tuple(cls.of(test, laws=laws, substeps=substeps) for test in tests)

    @classmethod
    def of(cls, test: Test, *, laws: Laws = DEFAULT_LAWS, substeps: int | None = None) -> Self:
        """Build a test's envelopes after `settle`, with a guess of the noise."""
        chosen = filter_of(test)
        thinned = [record_envelope[:: chosen.step] for record_envelope in envelopes(test)]
        lengths = list(map(len, thinned))
        if (length := min(lengths)) < FEWEST_VALUES:
            raise DataError(
                f"Test `{test.name}` has {length} independent values in its shortest record; at "
                f"least {FEWEST_VALUES} are needed.",
                remedy="Widen `band`, shorten `settle`, or drop short records with `exclude`.",
            )
        envelope = np.stack([np.pad(row, (0, max(lengths) - len(row))) for row in thinned])
        order = derivative_order(test.records[0].response)
        consumed = round(test.settle * chosen.fs) + np.arange(2 * chosen.half + 1)
        peaks = np.array([
            np.max(np.abs(record.channels[record.response][consumed])) for record in test.records
        ])  # fmt: skip
        y_start, duration = _course(test.name, thinned, peaks, chosen, order)
        turn = 2 * np.pi * chosen.centre_hz / chosen.fs
        taps = chosen.taps[:: chosen.stride]
        n = np.arange(len(taps)) * chosen.stride
        return cls(
            laws=laws,
            mean=jax.device_put(envelope),
            groups=_groups_of(test, envelope, np.array(lengths)),
            shift_std=jax.device_put(1e-4 * 2 * np.pi * chosen.centre_hz),
            y_start=jax.device_put(y_start),
            y_read=jax.device_put(_largest_read(test, y_start)),
            taps=jax.device_put(2 * taps / taps.sum() * np.exp(-1j * turn * n)),
            rotation=jax.device_put(np.exp(-1j * turn * chosen.step)),
            step_s=chosen.step_s,
            stride=chosen.step // chosen.stride,
            fs=chosen.fs / chosen.stride,
            num_samples=round(duration * chosen.fs / chosen.stride) + len(taps),
            response=test.records[0].response,
            substeps=substeps or substeps_for(chosen.centre_hz, chosen.fs / chosen.stride, 1),
            centre_hz=chosen.centre_hz,
            readings=partial(read_decays, test),
        )

    @property
    def lengths(self) -> list[int]:
        """The number of envelope values of every record."""
        return (np.asarray(self.groups.size).astype(int) // 2).tolist()


def _largest_read(test: Test, y_start: float) -> float:
    """Return the largest displacement [m] with a measured frequency, or else `y_start`."""
    try:
        readings = read_decays(test)
    except DataError:
        return y_start
    return max(float(np.max(reading.y)) for reading in readings if reading is not None)


def _groups_of(
    test: Test,
    envelope: Complex[np.ndarray, "record step"],
    lengths: Int[np.ndarray, " record"],
) -> Groups:
    """Return one data group and one run per record; the last value is the frequency shift."""
    names = [f"{test.name} {i + 1}" for i in range(len(envelope))]
    return repeated(
        [row[None] for row in envelope],
        2.0 * lengths,
        names,
        names,
        scale=np.sqrt(np.sum(np.abs(envelope) ** 2, axis=1) / lengths),
        units=(UNIT_OF[test.records[0].response],) * len(envelope),
        longest=2 * envelope.shape[1] + 1,
        is_complex=True,
        num_own=NUM_OWN,
    )


def _course(
    name: str,
    envelope: Sequence[np.ndarray],
    peaks: np.ndarray,
    chosen: BandFilter,
    order: int,
) -> tuple[float, float]:
    """Return start amplitude and duration of a simulated decay that covers all records.

    Args:
        name: Name of the test.
        envelope: Envelope of every record.
        peaks: Largest response of every record in the time that the filter takes from it.
        chosen: Filter of the band.
        order: Order of the response's derivative.
    """
    begins = np.log(np.abs([row[0] for row in envelope]))
    strongest = int(np.argmax(begins))
    size = np.log(np.abs(envelope[strongest]))
    edge = min(8, len(size) // 2)
    duration = len(size) * chosen.step_s
    fall = float(size[0] - size[-1])
    if not fall > 0.0:
        raise DataError(
            f"Test `{name}` must decay, but its strongest record grows by a factor of "
            f"{np.exp(-fall):.3g} from its beginning to its end.",
            why="All records must lie on one decay, which is simulated from the strongest "
            "amplitude on.",
            remedy="Let `settle` begin after the blow, or correct `band`.",
        )
    # Few values determine the decay rates at the start and at the end, and noise may exceed these
    # rates. Therefore no rate is less than a fraction of the mean rate.
    first, last = (
        max(float(row[0] - row[-1]) / ((edge - 1) * chosen.step_s), LEAST_RATE * fall / duration)
        for row in (size[:edge], size[-edge:])
    )
    # The filter removes the start of the simulated decay, where the amplitude may fall up to twice
    # as fast. The simulation therefore begins at a larger amplitude, but not far above the measured
    # peak, because a softening spring may not carry a larger motion.
    lead = chosen.half / chosen.fs
    slow, fast = (np.exp(size[0] + times * first * lead) for times in (1, 2))
    start = HEADROOM * max(slow, min(fast, float(peaks[strongest])))

    def until(begin: float) -> float:
        """Return the time at which the strongest record has fallen to an amplitude [s]."""
        late_enough = np.flatnonzero(size <= begin)
        if late_enough.size:
            return float(late_enough[0] * chosen.step_s)
        return duration + float(size[-1] - begin) / last

    weakest = float(begins.min())
    if (wait := until(weakest)) > MOST_WAIT * duration:
        raise DataError(
            f"The records of test `{name}` must follow one decay, but the weakest record begins "
            f"{np.exp(size[0] - weakest):.3g} times smaller than the strongest. The "
            f"strongest record falls by a factor of {np.exp(fall):.3g} in {duration:.3g} s, and "
            f"would need {wait:.3g} s to reach the initial amplitude of the weakest record.",
            why=f"A decay of more than {MOST_WAIT:g} times the length of a record takes too "
            "long to simulate.",
            remedy="Make a separate test of the weak records, or leave these records out with "
            "`exclude`.",
        )
    # The mode's frequency need not lie in the middle of its band.
    turns = envelope[strongest][1:edge] * np.conj(envelope[strongest][: edge - 1])
    omega = 2 * np.pi * chosen.centre_hz + np.angle(turns.sum()) / chosen.step_s
    ends = (until(b) + len(row) * chosen.step_s for b, row in zip(begins, envelope, strict=True))
    return float(start / omega**order), SPARE * max(ends)


class Entry(NamedTuple):
    """The start of a record on the simulated decay: time [steps], rotation [rad], shift [rad/s]."""

    place: Float[Any, "..."]
    phase: Float[Any, "..."]
    shift: Float[Any, "..."]


class Match(NamedTuple):
    """A record fitted to the simulated decay, with the residual and its sum of squares.

    `precision` is the normal matrix of log amplitude, phase and shift, for noise of unit variance;
    `rate` is the change of the log amplitude by the place.
    """

    entry: Entry
    misfit: Float[Any, "..."]
    residual: Complex[Any, "... sample"]
    precision: Float[Any, "... own own"]
    rate: Float[Any, "..."]


def along(
    decay: Complex[Any, "... step"], place: Float[Any, "... time"]
) -> tuple[Complex[Any, "... time"], Complex[Any, "... time"]]:
    """Interpolate the logarithm of a decay between time steps; return its slope as well.

    The polynomial through the nearest `NODES` steps is continued by its tangent beyond the first
    and the last step. NumPy arrays are processed by NumPy, here and in the functions below, because
    a compiled program would be needed for every length of records.
    """
    xp, count = namespace(decay), decay.shape[-1]
    size = min(NODES, count)
    inside = xp.clip(place, 0.0, count - 1.0)
    first = xp.clip(_constant(xp.floor(inside)).astype(int) - (size - 1) // 2, 0, count - size)
    index = first[..., None] + np.arange(size)
    values = xp.take_along_axis(decay, index.reshape(*index.shape[:-2], -1), axis=-1)
    values = values.reshape(index.shape)
    offsets = np.arange(size) - (size - 1) / 2  # of the steps, about their middle
    coefficients = np.linalg.inv(np.vander(offsets, increasing=True))
    t = inside - (first + (size - 1) / 2)
    powers = [t**k for k in range(size)]
    slopes = [0.0 * t, *(k * power for k, power in enumerate(powers[:-1], start=1))]
    log, slope = (
        xp.sum((xp.stack(x, axis=-1) @ coefficients) * values, axis=-1) for x in (powers, slopes)
    )
    return log + (place - inside) * slope, slope


def follow(
    decay: Complex[Any, "... step"], entry: Entry, steps: Float[Any, " time"], step_s: Any
) -> tuple[Complex[Any, "... time"], Complex[Any, "... time"]]:
    """Return the envelope of a record that repeats part of a simulated decay, and its log slope."""
    place, phase, shift = (value[..., None] for value in entry)
    log, slope = along(decay, place + steps)
    return namespace(decay).exp(log + 1j * (phase + shift * step_s * steps)), slope


def match(
    decay: Complex[Any, "... step"],
    envelope: Complex[Any, "... sample"],
    step_s: Any,
    lengths: Any = np.inf,
) -> Match:
    """Fit a record's initial state and frequency shift to a decay with time steps `step_s` [s].

    Records and decays broadcast along their leading axes. A record's values beyond its length must
    be zero, and do not count.
    """
    xp = namespace(decay)
    steps = np.arange(envelope.shape[-1], dtype=float)
    measured = steps < xp.asarray(lengths)[..., None]
    entry = _first_entry(decay, envelope, steps, step_s)
    for _ in range(NUM_REFINEMENTS):
        # Derivatives pass only through the last step, because earlier steps have no influence at
        # the optimum.
        entry = Entry(*map(_constant, entry))
        _, precision, gradient, rate = _normal(decay, envelope, entry, measured, step_s)
        place, phase, shift = entry
        of_size, of_phase, of_shift = _solution(precision, gradient)
        entry = Entry(place + of_size / rate, phase + of_phase, shift + of_shift)
    residual, precision, _, rate = _normal(decay, envelope, entry, measured, step_s)
    misfit = xp.sum(xp.square(residual.real) + xp.square(residual.imag), axis=-1)
    return Match(entry, misfit, residual, precision, rate)


def _solution(
    matrix: Float[Any, "... 3 3"], right: Float[Any, "... 3"]
) -> tuple[Float[Any, "..."], ...]:
    """Solve three equations with a symmetric matrix by Cramer's rule, which never raises an error.

    A library's solver raises an error if one of many matrices is singular.
    """
    xp = namespace(matrix)
    first, second, third = (matrix[..., i] for i in range(3))
    determinant = xp.sum(first * xp.cross(second, third), axis=-1)
    columns = (right, second, third), (first, right, third), (first, second, right)
    return tuple(xp.sum(a * xp.cross(b, c), axis=-1) / determinant for a, b, c in columns)


def _constant(values: Any) -> Any:
    """Return values through which no derivative passes."""
    return values if isinstance(values, np.ndarray) else jax.lax.stop_gradient(values)


def _first_entry(
    decay: Complex[Any, "... step"],
    envelope: Complex[Any, "... sample"],
    steps: Float[np.ndarray, " sample"],
    step_s: Any,
) -> Entry:
    """Estimate a record's start on the simulated decay: time, frequency shift and phase.

    Each value has a place of its own. Their mean is weighted by the squares of the amplitudes, as
    in least squares, over the loud values alone, so that noise or zeros at the end of a record do
    not move it, however long that end is.
    """
    xp = namespace(decay)
    size = xp.abs(envelope)
    loud = xp.where(size >= LOUD * xp.max(size, axis=-1, keepdims=True), size, 0.0)
    interpolated = xp.vectorize(xp.interp, signature="(sample),(step),(step)->(sample)")
    places = interpolated(
        -xp.log(xp.maximum(size, np.finfo(float).tiny)),
        -decay.real,
        np.arange(decay.shape[-1], dtype=float),
    )
    weights = loud**2
    place = xp.sum(weights * (places - steps), axis=-1) / xp.sum(weights, axis=-1)
    log, _ = along(decay, place[..., None] + steps)
    # This phase must be added to that of the simulated decay.
    ratio = envelope * xp.exp(xp.conj(log))
    turn = xp.angle(xp.sum(ratio[..., 1:] * xp.conj(ratio[..., :-1]), axis=-1))
    phase = xp.angle(xp.sum(ratio * xp.exp(-1j * turn[..., None] * steps), axis=-1))
    return Entry(place, phase, turn / step_s)


def _normal(
    decay: Complex[Any, "... step"],
    envelope: Complex[Any, "... sample"],
    entry: Entry,
    measured: Bool[Any, "... sample"],
    step_s: Any,
) -> tuple[
    Complex[Any, "... sample"], Float[Any, "... own own"], Float[Any, "... own"], Float[Any, "..."]
]:
    """Return residual, normal matrix, gradient (log amplitude, phase, shift), and log slope."""
    xp, steps = namespace(decay), np.arange(envelope.shape[-1], dtype=float)
    model, slope = follow(decay, entry, steps, step_s)
    model = xp.where(measured, model, 0.0)
    residual = envelope - model
    rate = slope[..., 0].real
    columns = model[..., None, :] * xp.stack(
        xp.broadcast_arrays(slope / rate[..., None], 1j, 1j * step_s * steps), axis=-2
    )
    transposed = xp.conj(columns)
    precision = (transposed @ xp.swapaxes(columns, -1, -2)).real
    gradient = (transposed @ residual[..., None])[..., 0].real
    return residual, precision, gradient, rate
