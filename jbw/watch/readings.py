r"""Frequency and damping of a free decay at a fixed amplitude: what is comparable between records.

Parameters of fits to whole records scatter with how hard the hammer hit, for no law is quite the
structure's. Read at one amplitude A, from a window of amplitudes about it that every record passes,
$$f(A),\quad \zeta(A) = -\frac{d\ln|X|/dt}{2\pi f}$$
of the envelope X(t) do not: parabolas through its logarithm in the window, whatever the law. How
they go with torque, $dy/d\ln T$ at fixed amplitudes, a fleet says.
"""

import json
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Complex, Float

from jbw.errors import DataError
from jbw.measurement.channels import lines_within
from jbw.measurement.demodulation import BandFilter, band_filter, demodulate
from jbw.measurement.envelopes import filter_of
from jbw.measurement.records import Record, Test, share_clock
from jbw.population.coordinates import unit_names
from jbw.population.population import Population, population_of, require_torque
from jbw.population.prediction import new_units
from jbw.population.prior import WRENCH
from jbw.quantities import derivative_order
from jbw.report.messages import watch
from jbw.verification.backbone import curves_of_response
from jbw.verification.predicted import carry
from jbw.watch.statement import Trend

WIDTH = np.sqrt(1.4)  # of a window: from A over it to A times it
LEAST_VALUES = 8  # independent values of an envelope within a window
OTHER_MODES = 0.02  # of the mode's amplitude: as much as other modes may have in a window
SPARE = 1.05  # between an amplitude of the records and the end of a window that is chosen
PER_AMPLITUDE = 2  # values: frequency and logarithm of the damping
RAISED = 1.1  # times the torque, over which a slope is taken


class RecordReading(NamedTuple):
    """One record, read at amplitudes A1 < A2 < ...

    Attributes:
        values: f(A1) [Hz], ln zeta(A1); then for each other amplitude f(A) - f(A1), ln zeta(A).
        covariance: Of these, by what the parabolas leave.
        other_modes: Largest amplitude outside the band over that of the mode, in any window.
    """

    values: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    other_modes: float


def names_of(amplitudes: Sequence[float], unit: str) -> list[str]:
    """What each value of a reading is, with its unit."""
    first, *rest = [f"{a:g} {unit}" for a in amplitudes]
    names = [f"f({first}) [Hz]", f"ln zeta({first})"]
    return names + [n for a in rest for n in (f"f({a}) - f({first}) [Hz]", f"ln zeta({a})")]


def common_amplitude(test: Test) -> float:
    """The lowest amplitude whose window every record of a test passes, where other modes are gone.

    Raises:
        DataError: The records share no window.
    """
    chosen = filter_of(test)
    sizes = [np.abs(_envelope(record, test, chosen)[1]) for record in test.records]
    lowest = max(size[-chosen.step :].mean() for size in sizes)
    highest = min(size.max() for size in sizes)
    amplitude = SPARE * WIDTH * lowest
    if SPARE * amplitude * WIDTH > highest:
        raise DataError(
            f"The records of test `{test.name}` pass no common window of amplitudes: one ends at "
            f"{lowest:.3g}, another begins at {highest:.3g}.",
            why="Readings can be compared at one and the same amplitude only.",
            remedy="Leave the weakest hit or the shortest record out with `exclude`, or record "
            "longer.",
        )
    return float(f"{amplitude:.3g}")


def reading(record: Record, test: Test, amplitudes: Sequence[float]) -> RecordReading:
    """A record of a test's kind, band and settling, read at peak amplitudes of its response.

    Raises:
        DataError: A record that cannot be compared: of another response, outside a window, too few
            values in it, not decaying, or with other modes in it.
    """
    if not test.traits.is_free:
        raise DataError(
            f"`{record.name}` belongs to test `{test.name}` of kind `{test.kind}`, which is no "
            "free decay.",
            why="Frequency and damping are read at fixed amplitudes along a decay.",
            remedy="Watch a run of kind `decay`.",
        )
    chosen = filter_of(test)
    times, envelope = _envelope(record, test, chosen)
    parts, shares = [], []
    for amplitude in amplitudes:
        inside = _window(np.abs(envelope), amplitude, chosen, record, test)
        shares.append(_other_modes(record, times[inside], chosen, test))
        if shares[-1] > OTHER_MODES:
            raise DataError(
                f"`{record.name}` has other modes of {shares[-1]:.1%} of its displacement at "
                f"{amplitude:g} {_unit(record)}; at most {OTHER_MODES:.0%} are admitted.",
                why="The joint then moves by more than its own mode, and dissipates more.",
                remedy="Read at a lower amplitude, where other modes have died.",
            )
        samples = slice(inside.start, inside.stop, chosen.step)
        parts.append(_at(times[samples], envelope[samples], amplitude, chosen, record))
    return _joined(parts, max(shares))


def _envelope(
    record: Record, test: Test, chosen: BandFilter
) -> tuple[Float[np.ndarray, " time"], Complex[np.ndarray, " time"]]:
    """Times since the record's start [s] and envelope in the band, after the settling time."""
    response = test.records[0].response
    if response not in record.channels:
        raise DataError(
            f"`{record.name}` has no {response}, in which test `{test.name}` is read.",
            remedy="Give a record of the same channels.",
        )
    if not share_clock(record.fs, chosen.fs):
        raise DataError(
            f"`{record.name}` is sampled at {record.fs:g} Hz, test `{test.name}` at {chosen.fs:g}.",
            why="The band's filter is of one rate, and readings through two are not comparable.",
            remedy="Resample it, or watch another run.",
        )
    chosen = chosen if record.fs == chosen.fs else band_filter(chosen.band_hz, record.fs)
    skipped = round(test.settle * record.fs)
    times, envelope = demodulate(record.channels[response][skipped:], chosen)
    return times + skipped / record.fs, envelope


def _window(
    size: Float[np.ndarray, " time"],
    amplitude: float,
    chosen: BandFilter,
    record: Record,
    test: Test,
) -> slice:
    """Where the envelope falls from the upper end of a window to the lower one."""
    high, low, unit = amplitude * WIDTH, amplitude / WIDTH, _unit(record)
    peak = int(np.argmax(size))
    below = np.flatnonzero(size[peak:] <= high)
    ended = np.flatnonzero(size[peak:] <= low)
    if size[peak] < high or not ended.size:
        raise DataError(
            f"`{record.name}` falls from {size[peak]:.3g} to {size[-1]:.3g} {unit} and does not "
            f"pass the window from {high:.3g} to {low:.3g} {unit} about {amplitude:g}.",
            why="Readings can be compared at one and the same amplitude only.",
            remedy="Hit harder, shorten `settle` or record longer, or begin a watch at another "
            "--amplitude.",
        )
    start, stop = peak + int(below[0]), peak + int(ended[0])
    if stop - start < LEAST_VALUES * chosen.step:
        raise DataError(
            f"`{record.name}` passes the window about {amplitude:g} {unit} in "
            f"{(stop - start) / chosen.fs:.3g} s; at least {LEAST_VALUES * chosen.step_s:.3g} s "
            f"are needed, for {LEAST_VALUES} independent values in the band.",
            remedy="Widen `band`, or read at an amplitude where the decay is slower.",
        )
    return slice(start, stop)


def _other_modes(
    record: Record, times: Float[np.ndarray, " time"], chosen: BandFilter, test: Test
) -> float:
    """Largest spectral line outside the band over that within, in the first half of a window.

    Of the displacement, by which the joint slips.
    """
    start = round(times[0] * record.fs)
    x = record.channels[test.records[0].response][start : start + len(times) // 2]
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    freq = np.fft.rfftfreq(len(x), 1 / record.fs)
    spectrum[1:] /= freq[1:] ** derivative_order(test.records[0].response)
    (low, high), half = chosen.band_hz, (chosen.band_hz[1] - chosen.band_hz[0]) / 2
    within = lines_within(freq, (low, high))
    # A Hann window smears a line, and a mean that is taken out, over four lines.
    smear = 4 * record.fs / len(x)
    outside = ((freq < low - half) | (freq > high + half)) & (freq > smear)
    if not (within.any() and outside.any()):
        return 0.0
    return float(spectrum[outside].max() / spectrum[within].max())


def _at(
    times: Float[np.ndarray, " step"],
    envelope: Complex[np.ndarray, " step"],
    amplitude: float,
    chosen: BandFilter,
    record: Record,
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]]:
    """Frequency and ln zeta at an amplitude, with their covariance, from parabolas through ln X."""
    middle, half = (times[0] + times[-1]) / 2, (times[-1] - times[0]) / 2
    design = np.vander((times - middle) / half, 3, increasing=True)
    log = np.stack([np.log(np.abs(envelope)), np.unwrap(np.angle(envelope))], axis=-1)
    coefficients, *_ = np.linalg.lstsq(design, log, rcond=None)
    residual = log - design @ coefficients
    spread = np.linalg.inv(design.T @ design)
    noise = np.sum(residual**2, axis=0) / (len(times) - 3)
    place = _crossing(coefficients[:, 0], np.log(amplitude))
    value, slope = np.array([1, place, place**2]), np.array([0, 1, 2 * place])
    (fall, turn), bends = slope @ coefficients, 2 * coefficients[2]
    if not fall < 0:
        raise DataError(
            f"`{record.name}` does not decay at {amplitude:g} {_unit(record)}.",
            remedy="Look at it with: jbw check CAMPAIGN --figures DIR.",
        )
    frequency = chosen.centre_hz + turn / half / (2 * np.pi)
    # By the coefficients of size and of phase: what moves the size moves the place, too, and both
    # slopes along their bends.
    place_by_size = -value / fall
    fall_by = np.concatenate([slope + bends[0] * place_by_size, np.zeros(3)])
    turn_by = np.concatenate([bends[1] * place_by_size, slope])
    frequency_by = turn_by / half / (2 * np.pi)
    jacobian = np.stack([frequency_by, fall_by / fall - frequency_by / frequency])
    values = np.array([frequency, np.log(-fall / half / (2 * np.pi * frequency))])
    return values, jacobian @ np.kron(np.diag(noise), spread) @ jacobian.T


def _crossing(parabola: Float[np.ndarray, " 3"], level: float) -> float:
    """Where a parabola over [-1, 1] that falls meets a level, by Newton's steps from its middle."""
    place = 0.0
    for _ in range(50):
        value = parabola @ [1, place, place**2] - level
        place -= value / (parabola[1] + 2 * parabola[2] * place)
        place = float(np.clip(place, -1.5, 1.5))
    return place


def _joined(
    parts: Sequence[tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]]], share: float
) -> RecordReading:
    """Readings at several amplitudes as one; frequencies beyond the first by their difference."""
    values = np.concatenate([part for part, _ in parts])
    covariance = np.zeros((len(values), len(values)))
    for i, (_, part_covariance) in enumerate(parts):
        covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = part_covariance
    change = np.eye(len(values))
    change[2::2, 0] = -1.0
    return RecordReading(change @ values, change @ covariance @ change.T, share)


def _unit(record: Record) -> str:
    return record.units.get(record.response, "")


def trend_of(
    fleet: xr.DataTree,
    torque: float | None,
    amplitudes: Sequence[float],
    test: Test,
    *,
    report: Callable[[str], None] = print,
) -> Trend:
    """The trend with torque of readings at amplitudes of a test's response, by a fleet.

    Args:
        fleet: From `jbw.fleet_of` or `jbw.read_fleet`.
        torque: Of the watched joint before any change [N m].
        amplitudes: Peaks of the response that are read at.
        test: Free decays of the watched joint.
        report: Called with one sentence at every stage.

    Raises:
        DataError: No torque stated, one torque in the whole fleet, a population that is not to be
            trusted, or an amplitude beyond what its units were driven to.
    """
    if torque is None:
        raise DataError(
            "The run's campaign does not state the torque of its joint.",
            remedy="State it in [assembly] torque, or leave --population out.",
        )
    _require_known(fleet, amplitudes, test)
    population = population_of(fleet, report=report)
    require_torque(population.design, torque)
    if population.record["status"] != "ok":
        raise DataError(
            f"The status of the population is {population.record['status']}.",
            why="A change of torque would be stated with more confidence than there is.",
            remedy="Collect more units, look with jbw population, or leave --population out.",
        )
    before, raised = (
        _readings_at(tightening, population, fleet, amplitudes, test)
        for tightening in (torque, RAISED * torque)
    )
    torques = np.array(population.record["torque"])
    part = WRENCH**2 / (np.var(np.log(torques)) + WRENCH**2)
    report(watch.attenuated(WRENCH, part))
    slopes = (raised - before) / np.log(RAISED)
    return Trend(torque, slopes, float(torques.min()), float(torques.max()))


def _require_known(fleet: xr.DataTree, amplitudes: Sequence[float], test: Test) -> None:
    """Refuse displacements that not every unit of a fleet was driven to."""
    peaks = [float(fleet[name].attrs.get("y_peak", np.nan)) for name in unit_names(fleet)]
    centre, order = _response_of(test)
    highest, reached_by_all = max(amplitudes) / centre**order, np.min(peaks)
    if not highest <= reached_by_all:
        says = watch.furthest(None if np.isnan(reached_by_all) else float(reached_by_all))
        raise DataError(
            f"Read is at a displacement of {highest:.3g} m, but all units of the fleet were driven "
            f"to no more than: {says}.",
            why="How a joint goes with torque is known where its units moved.",
            remedy="Begin a watch at a lower --amplitude, or leave --population out.",
        )


def _readings_at(
    torque: float,
    population: Population,
    fleet: xr.DataTree,
    amplitudes: Sequence[float],
    test: Test,
) -> Float[np.ndarray, "draw p"]:
    """What further units read at a torque, the same units whatever the torque."""
    laws: Any = tuple(json.loads(fleet.attrs["laws"]))
    draws = new_units(population, fleet, torque)
    centre, order = _response_of(test)
    frequency, damping, _ = carry(
        curves_of_response, draws, jnp.asarray(amplitudes), centre, order, laws
    )
    values = np.stack([np.asarray(frequency), np.log(np.asarray(damping))], axis=-1)
    values[:, 1:, 0] -= values[:, :1, 0]  # as `names_of` has it
    return values.reshape(len(values), -1)


def _response_of(test: Test) -> tuple[float, int]:
    """Centre of the band [rad/s], and the order of the response's derivative."""
    return 2 * np.pi * filter_of(test).centre_hz, derivative_order(test.records[0].response)
