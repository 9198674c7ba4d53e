"""Bands of responses to sines: curves, resonances, and the level that keeps a limit."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import xarray as xr

from jbw.forced.curves import exact_points, peaks, resonance
from jbw.forced.equivalent import Values
from jbw.forced.sweeps import held_ratio, swept, whole_curve
from jbw.quantities import derivative_order
from jbw.report.messages import loads as messages
from jbw.study.loads import (
    TAU,
    Complexes,
    Load,
    Member,
    Prepared,
    SeenResponse,
    Zone,
    bands,
    by_zones,
    checked_band,
    checked_levels,
    labelled,
    level_of,
    measured_of,
    peak_of,
    prepared,
    response_of,
    zones_of,
)
from jbw.verification.predictive_basis import Basis

NUM_FREQ = 241  # number of frequencies of a response curve
# number of rounds, and relative error, of the search for the displacement at the limit
MOST_ROUNDS, CLOSE = 8, 1e-6


def resonances_in(
    basis: Basis, load: Load, band_hz: tuple[float, float]
) -> Iterator[tuple[str, Load]]:
    """Yield a name and the load of each mode in a band; ignore the band if there is one mode."""
    low, high = (TAU * end for end in checked_band(band_hz))
    zones = zones_of(basis, load)
    for zone in zones:
        if len(zones) == 1 or low <= zone.omega <= high:
            name = "resonance" if len(zones) == 1 else f"resonance of mode {zone.mode}"
            yield name, replace(load, mode=zone.mode)


def resonance_of(basis: Basis, levels: Iterable[float], load: Load) -> xr.Dataset:
    """Return the bands of the resonance at each level of a sine: see `Study.resonance`."""
    levels = checked_levels(levels)
    seen, columns, warnings = measured_of(basis, load), [], []
    for level in levels:
        ready = prepared(basis, load, peak_of(level), messages.sine(level, seen.source))
        rows = [_resonance(member, ready.load, seen, level) for member in ready.members]
        warnings += _isolated([row.pop("isolated") for row in rows], level, seen)
        named = {name: [row[name] for row in rows] for name in rows[0]}
        column = {name: bands(draws, withheld=ready.withheld) for name, draws in named.items()}
        folds = np.mean(np.isfinite(np.concatenate(named["jump_up"])))
        known = {"folds": folds, "reach": ready.reach, "withheld": float(ready.withheld)}
        columns.append({**column, **known})
        warnings += ready.warnings
    units = messages.units_of_resonance(seen.unit, seen.name)
    variables = {
        name: (
            ("quantile", "level") if np.ndim(columns[0][name]) else "level",
            np.stack([column[name] for column in columns], -1),
            units[name],
        )
        for name in columns[0]
    }
    found = labelled(variables, {"level": ("level", levels, {"units": seen.source})}, load, seen)
    return found.assign_attrs(warnings="\n".join(warnings))


def _resonance(member: Member, load: Load, seen: SeenResponse, level: float) -> dict[str, Values]:
    """Return each draw's resonance: frequency, peak, quality factor, width and jumps."""
    found = resonance(member.motion, level_of(member, level))
    top = exact_points(member.motion, found.peak, np.zeros_like(found.peak.y))
    phasor = np.asarray(top.y * np.exp(1j * top.phase), complex)
    response = response_of(member, load, seen, level, top.omega, phasor)
    return {
        "frequency": found.peak.omega[:, 0] / TAU,
        "peak": np.abs(response)[:, 0],
        "displacement": member.measured(found.peak.y, found.peak.omega)[:, 0],
        "quality": found.quality[:, 0],
        "half_power_width": found.width[:, 0] / TAU,
        "jump_up": found.jump_up[:, 0] / TAU,
        "jump_down": found.jump_down[:, 0] / TAU,
        "isolated": np.asarray(found.peak.isolated[:, 0], float),
    }


def _isolated(parts: Iterable[Values], level: float, seen: SeenResponse) -> list[str]:
    """Return a warning if a share of the draws has a branch that a slow sweep never reaches."""
    share = float(np.mean(np.concatenate([np.ravel(part) for part in parts])))
    what = messages.sine(level, seen.source)
    return [messages.isolated(what, share)] if share > 0.0 else []


def response_curve_of(
    basis: Basis, level: float, band_hz: tuple[float, float], load: Load, num_freq: int = NUM_FREQ
) -> xr.Dataset:
    """Return the response curve to a sine of one level, with bands: see `Study.response_curve`."""
    (level,), band_hz = checked_levels([level]), checked_band(band_hz)
    seen, freq_hz = measured_of(basis, load), np.linspace(*band_hz, num_freq)
    what = messages.sine(level, seen.source)

    def curves(zone: Zone, ready: Prepared) -> list[dict[str, Values]]:
        omega = zone.within(TAU * freq_hz)
        return [_curve(member, ready.load, seen, level, omega, zone) for member in ready.members]

    parts, ready = by_zones(basis, load, freq_hz, peak_of(level), what, curves)
    unit, hertz, radian = seen.attrs, {"units": "Hz"}, {"units": "rad"}
    points = {name: np.concatenate(parts[name]) for name in ("frequency", "amplitude", "phase")}
    variables = {
        name: (("draw", "point"), points[name], attrs)
        for name, attrs in (("frequency", hertz), ("amplitude", unit), ("phase", radian))
    }
    variables["stable"] = (("draw", "point"), np.concatenate(parts["stable"]), {})
    for name in ("upward", "downward"):
        banded = bands(parts[name], withheld=ready.withheld)
        variables[name] = (("quantile", "freq"), banded, unit)
    warnings = [*ready.warnings, *_isolated(parts["isolated"], level, seen)]
    facts = {"level": level, **ready.facts, "warnings": "\n".join(warnings)}
    found = labelled(variables, {"freq": ("freq", freq_hz, hertz)}, ready.load, seen)
    return found.assign_attrs(facts)


def _curve(
    member: Member, load: Load, seen: SeenResponse, level: float, omega: Values, zone: Zone
) -> dict[str, Values]:
    """Return each draw's response curve in the zone of a mode, and its response to slow sweeps."""
    peak = peaks(member.motion, level_of(member, level))
    curve = whole_curve(member.motion, peak, (float(omega[0]), float(omega[-1])))
    reached = np.where(zone.holds(curve.omega), curve.omega, np.nan)[:, 0]
    phasor = np.asarray(curve.y * np.exp(1j * curve.phase), complex)[:, 0]
    response = response_of(member, load, seen, level, reached, phasor)
    found = {
        "frequency": reached / TAU,
        "amplitude": np.abs(response),
        "phase": np.angle(response),
        "stable": curve.stable[:, 0],
        "isolated": np.asarray(peak.isolated[:, 0], float),
    }
    for name, upward in (("upward", True), ("downward", False)):
        if not upward and np.all(curve.stable):  # Without a fold, both sweeps are the same.
            found[name] = found["upward"]
            continue
        y = swept(member.motion, peak, omega, upward=upward)[:, 0]
        frequency = np.broadcast_to(omega, y.shape)
        found[name] = np.abs(response_of(member, load, seen, level, frequency, y))
    return found


def notch_of(
    basis: Basis, level: float, limit: float, band_hz: tuple[float, float], load: Load
) -> xr.Dataset:
    """Return the bands of the level that keeps a response within a limit; see `Study.notch`."""
    (level, limit), band_hz = checked_levels([level, limit]), checked_band(band_hz)
    seen, freq_hz = measured_of(basis, load), np.linspace(*band_hz, NUM_FREQ)
    what = messages.limit(limit, seen.unit)

    def displacement(member: Member, omega: Values) -> tuple[Values, Values]:
        """Return the displacement and the force at which the response equals the limit."""
        frequency = np.broadcast_to(omega, (len(member.share), len(omega)))
        y = np.broadcast_to(
            limit / seen.factor / omega ** derivative_order(seen.name), frequency.shape
        )
        # The ratio of response to displacement depends on the displacement: iterate.
        for _ in range(MOST_ROUNDS):
            before, ratio = y, held_ratio(member.motion, y, frequency)
            y = limit / seen.factor / _per_displacement(member, load, seen, ratio, y, frequency)
            if not np.any(np.abs(y / before - 1.0) > CLOSE):
                break
        return y, y * np.abs(held_ratio(member.motion, y, frequency))

    def levels(zone: Zone, ready: Prepared) -> list[dict[str, Values]]:
        omega = zone.within(TAU * freq_hz)
        forces = [displacement(member, omega)[1] / np.abs(member.share) for member in ready.members]
        return [{"allowed": force} for force in forces]

    def in_the_middle(member: Member) -> Values:
        middle = np.clip(np.pi * sum(band_hz), *TAU * freq_hz[[0, -1]])
        return displacement(member, np.array([middle]))[0][:, 0]

    parts, ready = by_zones(basis, load, freq_hz, in_the_middle, what, levels)
    allowed = parts["allowed"]
    unit = {"units": seen.source}
    variables = {
        "allowed": (("quantile", "freq"), bands(allowed, withheld=ready.withheld), unit),
        "notched": (
            ("quantile", "freq"),
            bands([np.minimum(draws, level) for draws in allowed], withheld=ready.withheld),
            unit,
        ),
    }
    found = labelled(variables, {"freq": ("freq", freq_hz, {"units": "Hz"})}, ready.load, seen)
    facts = {"limit": limit, **ready.facts}
    return found.assign_attrs(facts)


def _per_displacement(
    member: Member, load: Load, seen: SeenResponse, ratio: Complexes, y: Values, omega: Values
) -> Values:
    """Return the response per displacement of the mode, in SI, at amplitudes y."""
    output = member.motion.seen(y, omega)
    if load.is_base:
        # The response contains the acceleration of the base, which is ratio / share per unit of
        # displacement.
        return np.abs(ratio / member.share + load.shape * omega**2 * output)
    return np.abs(output) * omega ** derivative_order(seen.name)
