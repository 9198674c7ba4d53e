r"""Simulation of many models at once under the same record, by one compiled program.

A model is an oscillator, or a structure of several modes and joints.

A record is marched in pieces with a limited number of sample intervals. The march starts at rest,
and the state is carried from each piece to the next. The number of intervals, the sampling rate and
the steps between two samples are arguments: the program depends only on the laws, the measured
derivative and the number of lanes. All solves of a campaign can share it: fits, weights, draws,
checks, predictions. On the way it sums

$$r_n = d_n - x_n - \sum_k a_k J_{kn}, \qquad Q = \sum_n r_n^2, \qquad s_k = \sum_n J_{kn} r_n$$

which a likelihood needs. It has no derivatives; for these, use `jbw.simulate`.
"""

import weakref
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jbw.kept_programs import KeptProgram, returned
from jbw.oscillator.hold import HeldInput
from jbw.oscillator.law import packed, unpacked
from jbw.oscillator.modes.response import output_of
from jbw.oscillator.modes.step import ModalState, ModalStepping, modal_stepping
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.parameters import Scalar
from jbw.oscillator.rare import unshared
from jbw.oscillator.residual_sums import response_of
from jbw.oscillator.solver import Stepping, stepping
from jbw.oscillator.step import State

LANES = 32  # number of models in a batch; a smaller batch takes as long as a full one
INTERVALS = 4096  # sample intervals per piece of a record, few enough for the cache
# A batch fills the processor's widest registers; XLA's own choice is half as wide.
WIDE = {"xla_cpu_prefer_vector_width": 512}
# number of directions on which a residual is projected; missing ones are filled with zeros
NUM_DIRECTIONS = 2
NUM_POWERS = 6  # number of coefficients of a band-limited input's polynomials

# A structure must have one row per joint in `h`, and two rows in `c`: the output whose largest
# displacement is returned, and the measured output.
Model = Oscillator | Structure


class MeasuredResponse(NamedTuple):
    """A measured response to compare with the simulated one, from sample `first` on.

    Attributes:
        values: Measured response d [m, m/s or m/s^2].
        directions: Rows J, two at most.
        first: First compared sample.
    """

    values: Float[Any, "*record time"]
    directions: Float[Any, "*record direction time"]
    first: int = 0


class Motions(NamedTuple):
    """The simulated motion of all models: responses, peaks, sums over the compared samples.

    Attributes:
        response: Displacement [m], velocity [m/s] or acceleration [m/s^2] at the samples; None if
            it was not requested.
        y_peak: Largest displacement [m].
        square: Sum Q over the compared samples; without a measured response, that of the response.
        along: Sums s_k over the same samples.
        peak: Largest response at the same samples.
        products: Sums of the response times each row of the record; None if it has no rows.
    """

    response: Any  # Float[np.ndarray, "lane time"] | None
    y_peak: Float[np.ndarray, " lane"]
    square: Float[np.ndarray, " lane"]
    along: Float[np.ndarray, "lane direction"]
    peak: Float[np.ndarray, " lane"]
    products: Float[np.ndarray, "lane row"] | None = None


@returned
class _Totals(NamedTuple):
    """The sums and peaks that are carried from one piece of a record to the next."""

    square: Any
    along: tuple[Any, ...]
    peak: Any
    y_peak: Any


class _Piece(NamedTuple):
    """One piece of a record, as arrays over samples or sample intervals, padded with zeros."""

    polynomials: Float[Array, "interval power"]
    samples: Float[Array, " sample"]
    # measured response d in the first column, then the rows J
    measured: Float[Array, "sample column"]


class _Lanes(NamedTuple):
    """The values that differ between the models of a batch: model, input gain, and all a_k."""

    models: Model
    gain: Float[Any, " lane"]  # gain of the input
    # coefficients a_k of the rows J_k that are subtracted from the residual
    parts: Float[Any, "lane direction"]


class _Span(NamedTuple):
    """The step counts of a piece of a record, traced by JAX: new counts need no compilation."""

    fs: Any  # sampling rate [Hz]
    substeps: Any  # steps between two samples
    num_steps: Any
    first: Any  # first compared sample, counted from the start of the piece
    begins: Any  # whether the sample before the first step of the piece is compared, too


class MarchedRecord(NamedTuple):
    """A record in pieces for `march`; made by `record_of`, or by `released` for free motion."""

    pieces: tuple[_Piece, ...]
    num_intervals: int
    first: int
    # rows by which the responses are multiplied before they are summed, such as weights of spectral
    # lines
    rows: Float[np.ndarray, "row time"] | None = None
    # displacement [m] at which the motion begins, on the steady loop of that amplitude; None for a
    # motion from rest
    y_peak: float | None = None


def march(
    models: Model,
    gains: Float[np.ndarray, " lane"],
    record: MarchedRecord,
    fs: float,
    substeps: int,
    order: int,
    *,
    known: Float[np.ndarray, "lane direction"] | None = None,
    writes: bool = True,
) -> Motions:
    """Return the motion of many models under one sampled input, from rest or released.

    Args:
        models: The models, at most `LANES` along the first axis of every leaf; the exact step must
            support their laws.
        gains: Gain of the input for each model.
        record: The input, and the measured response to compare with; a structure starts at rest.
        fs: Sampling rate [Hz].
        substeps: Steps between samples.
        order: Derivative that is returned: 0 displacement, 1 velocity, 2 acceleration.
        known: Known parts a of the directions, which are no residual; None for zero.
        writes: Whether to return the responses in addition to the sums.
    """
    count = len(gains)
    models, gain = filled_up((models, gains))
    parts = np.zeros((LANES, NUM_DIRECTIONS))
    if known is not None:
        parts[:count, : known.shape[1]] = known
    lanes = jax.device_put(_Lanes(models, gain, parts))
    if record.y_peak is None:
        state = _at_rest(lanes.models)
    else:
        state = _at_tips(lanes.models, jax.device_put(np.float64(record.y_peak)))
    totals = jax.device_put(_none())
    written_rows, rows = [], record.rows
    products = np.zeros((count, 0 if rows is None else len(rows)))
    for number, piece in enumerate(record.pieces):
        done = number * INTERVALS
        size = min(INTERVALS, record.num_intervals - done)
        steps = _Span(
            np.float64(fs), np.int32(substeps), np.int32(size * substeps),
            np.int32(record.first - done), np.bool_(number == 0),
        )  # fmt: skip
        state, totals, written = _marched(order, lanes, piece, jax.device_put(steps), state, totals)
        # A piece begins with the last sample of the previous piece.
        begin = 0 if number == 0 else 1
        if rows is not None:  # Multiply here, because the piece is still in the cache.
            response = np.asarray(written)[begin : size + 1]
            products += (rows[:, done + begin : done + size + 1] @ response).T[:count]
        if writes:
            written_rows.append(np.asarray(written)[begin : size + 1, :count])
    along = np.stack([np.asarray(row) for row in totals.along], axis=-1)[:count]
    square, peak, y_peak = (
        np.asarray(x)[:count] for x in (totals.square, totals.peak, totals.y_peak)
    )
    whole = np.concatenate([row.T for row in written_rows], axis=1) if writes else None
    return Motions(whole, y_peak, square, along, peak, None if rows is None else products)


def compile_ahead(models: Model, order: int) -> None:
    """Compile the simulation of the models' laws before a record is known; return when done.

    Args:
        models: Models with these laws and any parameters.
        order: Measured derivative.
    """
    models, piece = filled_up(models), _silent_piece()
    none = np.int32(0)
    lanes = _Lanes(models, np.zeros(LANES), np.zeros((LANES, NUM_DIRECTIONS)))
    steps = _Span(np.float64(1.0), np.int32(1), none, none, np.bool_(False))
    lanes, steps, totals = jax.device_put((lanes, steps, _none()))
    _marched(order, lanes, piece, steps, _at_rest(lanes.models), totals)


def filled_up(values: PyTree) -> PyTree:
    """Pad values along the first axis to a multiple of `LANES` by repeating the last one."""

    def filled(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf, float)
        wide = [(0, -len(leaf) % LANES), *[(0, 0)] * (leaf.ndim - 1)]
        return np.pad(leaf, wide, "edge")

    return jax.tree.map(filled, values)


def released(y_peak: float, num_samples: int) -> MarchedRecord:
    """Return a record without input: free motion from the tip of the steady loop to y_peak [m]."""
    num_pieces = len(_starts(num_samples))
    pieces = (_silent_piece(),) * num_pieces
    return MarchedRecord(pieces, num_samples - 1, 0, y_peak=float(y_peak))


@cache
def _silent_piece() -> _Piece:
    polynomials, samples = np.zeros((INTERVALS, NUM_POWERS)), np.zeros(INTERVALS + 1)
    return _Piece(jax.device_put(polynomials), jax.device_put(samples), _nothing())


@KeptProgram
def _at_rest(models: Model) -> State | ModalState:
    """Return all models at rest, as arrays of states for the time loop."""

    def rest(model: Model) -> State | ModalState:
        none = jnp.zeros(())
        if isinstance(model, Structure):
            none = (none,) * len(model.omega_n)  # pyright: ignore[reportArgumentType]
        memory = jax.tree.map(lambda x: jnp.asarray(x, float), model.at_rest())
        return packed(model.laws, (none, none, memory))

    return jax.vmap(rest, axis_size=LANES)(models)


@KeptProgram
def _at_tips(joints: Oscillator, y_peak: Scalar) -> State:
    """Return all oscillators at the tips of their steady loops of amplitude Y, without velocity."""

    def tip(joint: Oscillator) -> State:
        memory = jax.tree.map(lambda x: jnp.asarray(x, float), joint.at_tip(y_peak))
        return packed(joint.laws, (jnp.asarray(y_peak, float), jnp.zeros(()), memory))

    return jax.vmap(tip, axis_size=LANES)(joints)


def _none() -> _Totals:
    none = np.zeros(LANES)
    return _Totals(none, (none,) * NUM_DIRECTIONS, none, none)


def record_of(
    source: HeldInput, number: int | None = None, measured: MeasuredResponse | None = None
) -> MarchedRecord:
    """Return a record, divided into pieces on the device; cache it as long as its arrays exist.

    Args:
        source: The input, which is not periodic; its gain is ignored.
        number: Index of the record along a first axis; None if there is no such axis.
        measured: Measured response to compare with, of the same number of records.
    """
    arrays = source.polynomials, source.samples
    inputs = _CACHE.of(arrays, number, lambda: [*_input_pieces(source, number)])
    size, first = source.samples.shape[-1], 0
    compared = [_nothing()] * len(inputs)
    if measured is not None:
        first = measured.first
        arrays = measured.values, measured.directions
        compared = _CACHE.of(arrays, number, lambda: [*_measured_pieces(measured, number, size)])
    pairs = zip(inputs, compared, strict=True)
    pieces = tuple(_Piece(rows, samples, columns) for (rows, samples), columns in pairs)
    return MarchedRecord(pieces, size - 1, first)


@cache
def _nothing() -> Array:
    return jax.device_put(np.zeros((INTERVALS + 1, 1 + NUM_DIRECTIONS)))


def _input_pieces(source: HeldInput, number: int | None) -> Iterator[tuple[Array, Array]]:
    rows, samples = np.asarray(source.polynomials), np.asarray(source.samples)
    if number is not None:
        rows, samples = rows[number], samples[number]
    for start in _starts(len(samples)):
        yield (
            _filled(rows.T[start : start + INTERVALS], INTERVALS),
            _filled(samples[start : start + INTERVALS + 1], INTERVALS + 1),
        )


def _measured_pieces(measured: MeasuredResponse, number: int | None, size: int) -> Iterator[Array]:
    values, directions = np.asarray(measured.values), np.asarray(measured.directions)
    if number is not None:
        values, directions = values[number], directions[number]
    columns = np.zeros((size, 1 + NUM_DIRECTIONS))
    columns[measured.first :, 0] = values
    columns[measured.first :, 1 : 1 + len(directions)] = directions.T
    for start in _starts(size):
        yield _filled(columns[start : start + INTERVALS + 1], INTERVALS + 1)


def _starts(num_samples: int) -> range:
    return range(0, max(num_samples - 1, 1), INTERVALS)


def _filled(rows: np.ndarray, size: int) -> Array:
    """Return an array on the device, padded with zeros to `size` along its first axis."""
    filled = np.zeros((size, *rows.shape[1:]))
    filled[: len(rows)] = rows
    return jax.device_put(filled)


class _Cache:
    """A cache of values made from arrays, which lasts as long as the arrays exist."""

    def __init__(self) -> None:
        self._made: dict[tuple[Any, ...], Any] = {}

    def of(self, arrays: tuple[Any, ...], number: int | None, make: Callable[[], Any]) -> Any:
        """Return the cached value of row `number` of the arrays; make it on first use."""
        key = (number, *map(id, arrays))
        if (value := self._made.get(key)) is None:
            value = self._made[key] = make()
            for array in arrays:
                weakref.finalize(array, self._made.pop, key, None)
        return value


_CACHE = _Cache()


@partial(KeptProgram, options=WIDE)
def _marched(
    order: int, lanes: _Lanes, piece: _Piece, steps: _Span, state: Any, totals: _Totals
) -> tuple[Any, _Totals, Float[Array, "sample lane"]]:
    """Advance the states through a piece of the record, and add the piece's samples to the sums."""
    models, gain, parts = lanes
    fs, substeps, num_steps, first, begins = steps
    part = 1.0 / substeps
    # Every step takes its coefficients from the piece, so only their number matters here.
    unused = (jnp.zeros(0),) * piece.polynomials.shape[1]

    def stepping_of(model: Model, gain: Array) -> Stepping | ModalStepping:
        if isinstance(model, Structure):
            return modal_stepping(model, fs * substeps, gain, unused)
        return stepping(model, fs * substeps, gain, unused)

    steppings = jax.vmap(stepping_of)(models, gain)

    def seen(state: Any, totals: _Totals, sample: Array, ends: Array) -> tuple[_Totals, Array]:
        """Return the sums, updated if the sample is compared, and the response at the sample."""
        row, counts = piece.measured[sample], ends & (sample >= first)

        def of_lane(model, gain, parts, state, totals):
            full = unpacked(model.laws, state)
            response, y = _response_of(model, order, full, gain * piece.samples[sample])
            residual = row[0] - response
            for k in range(NUM_DIRECTIONS):
                residual = residual - parts[k] * row[1 + k]
            residual = jnp.where(counts, residual, 0.0)
            size = jnp.where(counts, jnp.abs(response), 0.0)
            added = _Totals(
                totals.square + residual * residual,
                tuple(x + row[1 + k] * residual for k, x in enumerate(totals.along)),
                jnp.maximum(totals.peak, size),
                jnp.maximum(totals.y_peak, jnp.where(ends, jnp.abs(y), 0.0)),
            )
            return added, response

        return jax.vmap(of_lane)(models, gain, parts, state, totals)

    def onward(step: Array, carry: Any) -> Any:
        state, totals, written = carry
        interval = step // substeps
        powers = _moved(
            tuple(piece.polynomials[interval]), (step - interval * substeps) * part, part
        )
        with unshared():  # all arguments are NumPy arrays on one device
            state = jax.vmap(lambda one, state: one.onward(state, powers))(steppings, state)
        sample = interval + 1
        totals, response = seen(state, totals, sample, step + 1 == sample * substeps)
        # Every step of an interval writes into this row, so that the last one remains.
        return state, totals, _written(written, response, sample)

    none = jnp.zeros((), jnp.int32)
    totals, response = seen(state, totals, none, begins)
    written = _written(jnp.zeros((INTERVALS + 1, LANES)), response, none)
    return jax.lax.fori_loop(0, num_steps, onward, (state, totals, written))


def _response_of(model: Model, order: int, state: Any, u: Array) -> tuple[Any, Any]:
    """Return a model's response and displacement in a state of the motion."""
    if not isinstance(model, Structure):
        return response_of(model, order, state, u), state[0]
    shown, measured = model.c  # pyright: ignore[reportGeneralTypeIssues]
    return output_of(model, measured, order, state, u), output_of(model, shown, 0, state, u)


def _written(rows: Array, row: Array, place: Array) -> Array:
    return jax.lax.dynamic_update_slice(rows, row[None], (place, jnp.zeros_like(place)))


def _moved(coefficients: tuple[Array, ...], start: Array, part: Array) -> tuple[Array, ...]:
    r"""Return the coefficients of a polynomial on a part of its interval, $p(s_0 + h s)$."""
    moved = list(coefficients)
    for lowest in range(len(moved) - 1):
        for power in reversed(range(lowest, len(moved) - 1)):
            moved[power] = moved[power] + start * moved[power + 1]
    scale = 1.0
    for power in range(1, len(moved)):
        scale = scale * part
        moved[power] = scale * moved[power]
    return tuple(moved)
