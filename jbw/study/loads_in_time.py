"""Bands of the response to loads that vary in time: random profiles and shocks."""

from dataclasses import replace

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.forced.equivalent import Values
from jbw.forced.profiles import RandomProfile
from jbw.forced.random import RandomResponse, random_response
from jbw.forced.shock import Pulse, ShockResponse, shock_response, shock_spectrum
from jbw.quantities import derivative_order
from jbw.report.messages import loads as messages
from jbw.study.loads import (
    TAU,
    Load,
    Member,
    Prepared,
    SeenResponse,
    bands,
    checked_levels,
    labelled,
    measured_of,
    prepared,
)
from jbw.verification.predictive_basis import Basis

# number of frequencies on each side of the resonance; their spacing grows with distance
FEW = 240
MOST_TIMES = 2000  # approximate number of times at which a response is stored


def random_of(basis: Basis, profile: RandomProfile, duration: float, load: Load) -> xr.Dataset:
    """Return the bands of the response to a random profile: see `Study.random`.

    The model discrepancy is taken at twice the rms displacement.
    """
    (duration,) = checked_levels([duration])
    seen = measured_of(basis, load)
    stated = profile.in_unit(seen.source)
    ready = prepared(
        basis,
        load,
        lambda member: 2.0 * random_response(member.motion, stated.at, member.share).rms()[:, None],
        messages.random(stated.rms, seen.source),
    )
    found = [random_response(m.motion, stated.at, np.abs(m.share)) for m in ready.members]
    band = float(stated.freq_hz[0]), float(stated.freq_hz[-1])
    freq_hz = _frequencies(found[0].frequency_hz, found[0].damping, band, FEW)
    rows = [_random(response, load, seen, freq_hz, duration) for response in found]
    units = messages.units_of_random(seen.unit, seen.name)
    variables = {
        name: (
            ("quantile", "freq") if name == "psd" else "quantile",
            bands([row[name] for row in rows], withheld=ready.withheld),
            units[name],
        )
        for name in rows[0]
    }
    coords = {"freq": ("freq", freq_hz, {"units": "Hz"})}
    facts = {"duration": duration, "profile_rms": stated.rms, **ready.facts}
    return labelled(variables, coords, ready.load, seen).assign_attrs(facts)


def _random(
    found: RandomResponse, load: Load, seen: SeenResponse, freq_hz: Values, duration: float
) -> dict[str, Values]:
    """Return the statistics and spectrum of each draw's response to a random load."""
    if load.is_base:
        spectrum = found.base_spectrum(freq_hz, load.participation, load.shape)
    else:
        spectrum = found.spectrum(freq_hz, derivative_order(seen.name))
    spectrum = seen.factor**2 * spectrum
    relative = np.sqrt(np.trapezoid(found.spectrum(freq_hz), freq_hz))
    largest = found.largest(duration)
    return {
        "rms": np.sqrt(np.trapezoid(spectrum, freq_hz)),
        "displacement": relative,
        "largest_displacement": largest,
        "peak_factor": largest / relative,
        "frequency": found.frequency_hz,
        "damping": found.damping,
        "psd": spectrum,
    }


def _frequencies(centre: Values, damping: Values, band: tuple[float, float], few: int) -> Values:
    """Return frequencies [Hz] in a band that are dense near the resonance of every draw."""
    step = 0.4 * float(np.min(damping * centre))
    width = 12.0 * float(np.max(damping * centre))
    low, high = float(np.min(centre)) - width, float(np.max(centre)) + width
    near = np.linspace(low, high, min(int((high - low) / step) + 2, 4000))
    # Away from the resonance, the spacing of the frequencies grows with their distance from it.
    away = width * np.geomspace(1.0, max(band[1] / width, 2.0), few)
    every = np.concatenate([near, low + width - away, high - width + away, band])
    return np.unique(every[(every >= band[0]) & (every <= band[1])])


def shock_of(basis: Basis, pulse: Pulse, load: Load) -> xr.Dataset:
    """Return the bands of the motion under a shock: see `Study.shock`."""
    seen = measured_of(basis, load)
    if pulse.unit != seen.source:
        raise ConfigError(
            f"The shock must be in {seen.source}, but is in {pulse.unit}.",
            remedy='Give a force, or `drive="base"` for an acceleration of the base.',
        )
    single = replace(load, harmonics=1)  # A shock is integrated in time and needs no harmonics.

    def moved(member: Member) -> ShockResponse:
        share = -member.share if load.is_base else member.share
        return shock_response(member.motion, pulse, share)

    def largest(member: Member) -> Values:
        return np.max(np.abs(moved(member).y), -1)

    ready = prepared(basis, single, largest, messages.shock(seen.source, pulse))
    motions = [moved(member) for member in ready.members]
    lowest = float(np.min(ready.members[0].motion.omega_n)) / TAU
    return _shock(motions, ready, seen, lowest)


def _shock(
    motions: list[ShockResponse], ready: Prepared, seen: SeenResponse, lowest: float
) -> xr.Dataset:
    """Return the bands of a shock response over time, of its largest value and of its spectrum."""
    load, order, withheld = ready.load, derivative_order(seen.name), ready.withheld
    responses = []
    for motion in motions:
        relative = (motion.y, motion.v, motion.a)[order]
        total = load.shape * relative + motion.source if load.is_base else relative
        responses.append(seen.factor * total)
    t, fs = motions[0].t, motions[0].fs
    step = max(1, len(t) // MOST_TIMES)
    largest = [np.max(np.abs(response), -1) for response in responses]
    displacement = [np.max(np.abs(motion.y), -1) for motion in motions]
    thinned = [response[:, ::step] for response in responses]
    variables = {
        "response": (("quantile", "time"), bands(thinned, withheld=withheld), seen.attrs),
        "largest": ("quantile", bands(largest, withheld=withheld), seen.attrs),
        "displacement": ("quantile", bands(displacement, withheld=withheld), {"units": "m"}),
    }
    coords = {"time": ("time", t[::step], {"units": "s"})}
    if seen.name == "acceleration":
        freq_hz = np.geomspace(0.25 * lowest, min(20.0 * lowest, 0.1 * fs), 60)
        spectra = [shock_spectrum(response, fs, freq_hz) for response in responses]
        variables["srs"] = (("quantile", "freq"), bands(spectra, withheld=withheld), seen.attrs)
        coords["freq"] = ("freq", freq_hz, {"units": "Hz"})
    return labelled(variables, coords, load, seen).assign_attrs(ready.facts)
