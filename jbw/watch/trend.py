r"""How readings of a joint go with torque, by a fleet: $dy/d\ln T$ at fixed amplitudes."""

import json
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.errors import DataError
from jbw.measurement.records import Test
from jbw.observables.decay_envelopes import filter_of
from jbw.population.coordinates import unit_names
from jbw.population.population import Population, population_of, require_torque
from jbw.population.prediction import new_units
from jbw.population.prior import WRENCH
from jbw.quantities import derivative_order
from jbw.report.messages import watch
from jbw.verification.backbone import curves_of_response
from jbw.verification.predicted import carry
from jbw.watch.torque import Trend

RAISED = 1.1  # times the torque, over which a slope is taken


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
