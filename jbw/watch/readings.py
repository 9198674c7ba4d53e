r"""Frequency and damping of a free decay at fixed amplitudes, comparable between records.

Parameters of laws fitted to whole records vary with the force of the hammer, since no law is
exactly that of the structure. Frequency and damping at one amplitude A that every record passes do
not. Their trend with torque, $dy/d\ln T$ at fixed amplitudes, comes from a fleet.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError
from jbw.measurement.channels import lines_within
from jbw.measurement.demodulation import band_filter, demodulate
from jbw.measurement.envelopes import filter_of
from jbw.measurement.faults.examine import read_decays
from jbw.measurement.readings.table import ModeReading
from jbw.measurement.records import Record, Test
from jbw.population.coordinates import unit_names
from jbw.population.population import population_of, require_torque
from jbw.population.prediction import new_units
from jbw.population.prior import WRENCH
from jbw.quantities import derivative_order
from jbw.report.messages import watch
from jbw.results.attributes import DrawnPosterior, StoredFleet
from jbw.verification.backbone import curves_of_response
from jbw.verification.predicted import carry
from jbw.watch.statement import Trend

# Other modes are searched in the time in which the amplitude falls from this multiple of the
# measured amplitude to the measured amplitude.
WIDTH = np.sqrt(1.4)
FEWEST = 64  # smallest number of samples in which other modes can be searched
# largest allowed amplitude of other modes, relative to that of the monitored mode
OTHER_MODES = 0.02
# A chosen amplitude must differ by this factor from the largest and from the smallest measured
# amplitude.
SPARE = 1.05
PER_AMPLITUDE = 2  # number of values per amplitude: frequency and logarithm of the damping ratio
RAISED = 1.1  # factor by which the torque is raised to compute the trend with torque


class RecordReading(NamedTuple):
    """The frequency and damping of one free decay at amplitudes A1 < A2 < ...

    Attributes:
        values: f(A1) [Hz], ln zeta(A1); then for each other amplitude f(A) - f(A1), ln zeta(A).
        covariance: Covariance of the values, from the record's own table.
        other_modes: Largest amplitude outside the band relative to the mode's, over all amplitudes.
    """

    values: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    other_modes: float


def names_of(amplitudes: Sequence[float], unit: str) -> list[str]:
    """Return the name of each frequency and damping value of a record, with amplitude and unit."""
    first, *rest = [f"{a:g} {unit}" for a in amplitudes]
    names = [f"f({first}) [Hz]", f"ln zeta({first})"]
    return names + [n for a in rest for n in (f"f({a}) - f({first}) [Hz]", f"ln zeta({a})")]


def common_amplitude(test: Test) -> float:
    """Return the lowest amplitude that all records of a test pass after other modes have died out.

    Raises:
        DataError: The records share no amplitude.
    """
    tables = [_table(record, test) for record in test.records]
    lowest = max(table.amplitude.min() for table in tables)
    highest = min(table.amplitude.max() for table in tables)
    amplitude = SPARE * WIDTH * lowest
    if SPARE * amplitude * WIDTH > highest:
        raise DataError(
            f"The records of test `{test.name}` have no common amplitude: one record ends at "
            f"{lowest:.3g}, another record begins at {highest:.3g}.",
            why="Frequency and damping can only be compared at the same amplitude.",
            remedy="Leave the weakest hit or the shortest record out with `exclude`, or record "
            "longer.",
        )
    return float(f"{amplitude:.3g}")


def reading(record: Record, test: Test, amplitudes: Sequence[float]) -> RecordReading:
    """Measure frequency and damping of a free decay at given peak amplitudes of its response.

    Raises:
        DataError: The record cannot be compared: its response is another one, it does not pass the
            amplitudes, does not decay, or contains other modes.
    """
    if not test.traits.is_free:
        raise DataError(
            f"`{record.name}` belongs to test `{test.name}` of kind `{test.kind}`, which is no "
            "free decay.",
            why="Frequency and damping are measured at fixed amplitudes along a decay.",
            remedy="Monitor a run with tests of kind `decay`.",
        )
    table, unit = _table(record, test), record.units.get(record.response, "")
    highest, lowest = table.amplitude[[0, -1]]
    for amplitude in amplitudes:
        if not lowest <= amplitude <= highest:
            raise DataError(
                f"`{record.name}` has frequency and damping from {highest:.3g} to {lowest:.3g} "
                f"{unit}, but not at {amplitude:g} {unit}.",
                why="Frequency and damping can only be compared at the same amplitude.",
                remedy="Hit harder, shorten `settle` or record longer, or begin a watch at another "
                "--amplitude.",
            )
    read = table.at(np.array(amplitudes))
    other_modes = [
        _other_modes(record, test, *row) for row in zip(amplitudes, read.hz, read.zeta, strict=True)
    ]
    for amplitude, share in zip(amplitudes, other_modes, strict=True):
        if share > OTHER_MODES:
            raise DataError(
                f"In `{record.name}` other modes contribute {share:.1%} of the displacement at "
                f"{amplitude:g} {unit}; at most {OTHER_MODES:.0%} is allowed.",
                why="Other modes add to the motion of the joint, which then dissipates more.",
                remedy="Use a lower amplitude, at which other modes have decayed.",
            )
    return RecordReading(*_compared(read), max(other_modes))


def _table(record: Record, test: Test) -> ModeReading:
    """Measure frequency and damping along a record, in the channel and band of a test."""
    response = test.records[0].response
    if response not in record.channels:
        raise DataError(
            f"`{record.name}` has no {response}, which is the response of test `{test.name}`.",
            remedy="Give a record with the same channels as the records of the run.",
        )
    filter_of(test)  # For a test without a band, this line raises an error.
    alone = replace(test, records=(record,), name=record.name)
    # For a record without measurable frequency and damping, this line raises an error.
    (table,) = (read for read in read_decays(alone) if read is not None)
    return table


def _compared(read: ModeReading) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Return f and ln zeta at A1, then f(A) - f(A1) and ln zeta(A), with their covariance."""
    size = len(read.hz)
    values = np.stack([read.hz, np.log(read.zeta)], axis=1).ravel()
    values[2::2] -= values[0]
    by_hz, by_zeta = np.zeros((2, 2 * size, size))
    by_hz[::2], by_zeta[1::2] = np.eye(size), np.diag(1 / read.zeta)
    by_hz[2::2, 0] -= 1.0
    covariance = by_hz @ read.hz_covariance @ by_hz.T + by_zeta @ read.zeta_covariance @ by_zeta.T
    return values, covariance


def _other_modes(record: Record, test: Test, amplitude: float, hz: float, zeta: float) -> float:
    """Return the largest spectral line outside the mode's band, relative to the largest inside it.

    The spectrum is that of the displacement, which makes the joint slip, over the time in which it
    falls by a sixth.
    """
    x = record.channels[record.response][round(test.settle * record.fs) :]
    chosen = band_filter(filter_of(test).band_hz, record.fs)
    above = np.flatnonzero(np.abs(demodulate(x, chosen)[1]) >= amplitude * WIDTH)
    start = chosen.half + (int(above[-1]) if len(above) else 0)
    x = x[start : start + max(round(np.log(WIDTH) / (2 * np.pi * hz * zeta) * record.fs), FEWEST)]
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    freq = np.fft.rfftfreq(len(x), 1 / record.fs)
    spectrum[1:] /= freq[1:] ** derivative_order(record.response)
    (low, high), half = chosen.band_hz, (chosen.band_hz[1] - chosen.band_hz[0]) / 2
    within = lines_within(freq, (low, high))
    # A Hann window spreads a line, and also the error of a removed mean, over four lines.
    smear = 4 * record.fs / len(x)
    outside = ((freq < low - half) | (freq > high + half)) & (freq > smear)
    if not (within.any() and outside.any()):
        return 0.0
    return float(spectrum[outside].max() / spectrum[within].max())


def trend_of(
    fleet: xr.DataTree,
    torque: float | None,
    amplitudes: Sequence[float],
    test: Test,
    *,
    report: Callable[[str], None] = print,
) -> Trend:
    """Return the dependence of a fleet's frequency and damping on torque, at given amplitudes.

    Args:
        fleet: A fleet from `jbw.fleet_of` or `jbw.read_fleet`.
        torque: Torque of the monitored joint before any change [N m].
        amplitudes: Peak amplitudes of the response at which readings are taken.
        test: Free decays of the monitored joint.
        report: A function that is called with one sentence at every stage.

    Raises:
        DataError: No torque is stated, the whole fleet has one torque, the population is not
            reliable, or the units of the fleet did not reach an amplitude.
    """
    if torque is None:
        raise DataError(
            "The run's campaign does not state the torque of its joint.",
            remedy="State the torque in [assembly] torque, or leave --population out.",
        )
    _require_known(fleet, amplitudes, test)
    population = population_of(fleet, report=report)
    require_torque(population.design, torque)
    if (status := population.result.status) != "ok":
        raise DataError(
            f"The status of the population is {status}.",
            why="A population that fails its checks does not determine a change of torque.",
            remedy="Collect more units, look at the findings of jbw population, or omit "
            "--population.",
        )
    laws: Any = tuple(StoredFleet.of(fleet).laws)
    centre, order = _response_of(test)

    def readings_at(tightening: float) -> Float[np.ndarray, "draw p"]:
        """Predict frequency and damping of new units at a torque [N m], from the population."""
        draws = new_units(population, fleet, tightening)
        frequency, damping, _ = carry(
            curves_of_response, draws, jnp.asarray(amplitudes), centre, order, laws
        )
        values = np.stack([np.asarray(frequency), np.log(np.asarray(damping))], axis=-1)
        values[:, 1:, 0] -= values[:, :1, 0]  # The order of values is that of `names_of`.
        return values.reshape(len(values), -1)

    before, raised = readings_at(torque), readings_at(RAISED * torque)
    torques = np.array(population.result.torque, float)
    part = WRENCH**2 / (np.var(np.log(torques)) + WRENCH**2)
    report(watch.attenuated(WRENCH, part))
    slopes = (raised - before) / np.log(RAISED)
    return Trend(torque, slopes, float(torques.min()), float(torques.max()))


def _require_known(fleet: xr.DataTree, amplitudes: Sequence[float], test: Test) -> None:
    """Raise an error if some units of a fleet were not tested up to the monitored amplitudes."""
    peaks = np.array([DrawnPosterior.of(fleet[name]).y_peak for name in unit_names(fleet)], float)
    centre, order = _response_of(test)
    highest, reached_by_all = max(amplitudes) / centre**order, np.min(peaks)
    if not highest <= reached_by_all:
        says = watch.furthest(None if np.isnan(reached_by_all) else float(reached_by_all))
        raise DataError(
            f"The watch uses a displacement of {highest:.3g} m, but not all units of the fleet "
            f"were tested up to this displacement: {says}.",
            why="The effect of torque on a joint is known only at tested displacements.",
            remedy="Begin a watch at a lower --amplitude, or leave --population out.",
        )


def _response_of(test: Test) -> tuple[float, int]:
    """Return the centre of a test's band [rad/s], and the derivative order of its response."""
    return 2 * np.pi * filter_of(test).centre_hz, derivative_order(test.records[0].response)
