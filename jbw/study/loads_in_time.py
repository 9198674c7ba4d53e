"""Bands under loads in time: random profiles and shocks."""

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from jbw.errors import ConfigError
from jbw.forced.equivalent import Values
from jbw.forced.profiles import Profile
from jbw.forced.random import random_response
from jbw.forced.shock import Pulse, shock_response, shock_spectrum
from jbw.quantities import derivative_order
from jbw.report.messages import loads as messages
from jbw.study.loads import (
    TAU,
    Load,
    Member,
    bands,
    checked_levels,
    labelled,
    measured_of,
    prepared,
)
from jbw.verification.predictive_basis import Basis


def random_of(basis: Basis, profile: Profile, duration: float, load: Load) -> xr.Dataset:
    """Return the response to a random profile: see `Study.random`.

    The model discrepancy is that at twice the rms displacement.
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
    few, wide = 240, (float(stated.freq_hz[0]), float(stated.freq_hz[-1]))
    freq_hz: Values = np.array([])
    parts: dict[str, list[Values]] = {}
    for member in ready.members:
        found = random_response(member.motion, stated.at, np.abs(member.share))
        if not freq_hz.size:
            freq_hz = _frequencies(found.frequency_hz, found.damping, wide, few)
        if load.is_base:
            spectrum = found.base_spectrum(freq_hz, load.participation, load.shape)
        else:
            spectrum = found.spectrum(freq_hz, derivative_order(seen.name))
        spectrum = seen.factor**2 * spectrum
        relative = np.sqrt(np.trapezoid(found.spectrum(freq_hz), freq_hz))
        largest = found.largest(duration)
        rows = {
            "rms": np.sqrt(np.trapezoid(spectrum, freq_hz)),
            "displacement": relative,
            "largest_displacement": largest,
            "peak_factor": largest / relative,
            "frequency": found.frequency_hz,
            "damping": found.damping,
            "psd": spectrum,
        }
        for name, values in rows.items():
            parts.setdefault(name, []).append(values)
    units = messages.units_of_random(seen.attrs)
    variables = {
        name: (
            ("quantile", "freq") if name == "psd" else "quantile",
            bands(draws, withheld=ready.withheld),
            units[name],
        )
        for name, draws in parts.items()
    }
    found = labelled(variables, {"freq": ("freq", freq_hz, {"units": "Hz"})}, ready.load, seen)
    facts = {"duration": duration, "profile_rms": stated.rms, **ready.facts}
    return found.assign_attrs(facts)


def _frequencies(centre: Values, damping: Values, band: tuple[float, float], few: int) -> Values:
    """Return frequencies over a band that resolve every draw's resonance."""
    step = 0.4 * float(np.min(damping * centre))
    width = 12.0 * float(np.max(damping * centre))
    low, high = float(np.min(centre)) - width, float(np.max(centre)) + width
    near = np.linspace(low, high, min(int((high - low) / step) + 2, 4000))
    # Towards both ends in steps that grow with the distance from the resonance.
    away = width * np.geomspace(1.0, max(band[1] / width, 2.0), few)
    every = np.concatenate([near, low + width - away, high - width + away, band])
    return np.unique(every[(every >= band[0]) & (every <= band[1])])


def shock_of(basis: Basis, pulse: Pulse, load: Load) -> xr.Dataset:
    """Return the motion under a shock: see `Study.shock`."""
    seen = measured_of(basis, load)
    if pulse.unit != seen.source:
        raise ConfigError(
            f"The shock must be in {seen.source}, but is in {pulse.unit}.",
            remedy='Give a force, or `drive="base"` for an acceleration of the base.',
        )
    signed = replace(load, harmonics=1)

    def moved(member: Member) -> Any:
        share = -member.share if load.is_base else member.share
        return shock_response(member.motion, pulse, share)

    def largest(member: Member) -> Values:
        return np.max(np.abs(moved(member).y), -1)

    ready = prepared(basis, signed, largest, messages.shock(seen.source, pulse))
    motions = [moved(member) for member in ready.members]
    responses = []
    for motion in motions:
        order = derivative_order(seen.name)
        relative = (motion.y, motion.v, motion.a)[order]
        absolute = load.shape * relative + (motion.source if load.is_base else 0.0)
        responses.append(seen.factor * absolute)
    t, fs = motions[0].t, motions[0].fs
    lowest = float(np.min(ready.members[0].motion.omega_n)) / TAU
    freq_hz = np.geomspace(0.25 * lowest, min(20.0 * lowest, 0.1 * fs), 60)
    step = max(1, len(t) // 2000)
    unit = seen.attrs
    variables = {
        "response": (("quantile", "time"), bands([r[:, ::step] for r in responses]), unit),
        "largest": ("quantile", bands([np.max(np.abs(r), -1) for r in responses]), unit),
        "displacement": (
            "quantile", bands([np.max(np.abs(m.y), -1) for m in motions]), {"units": "m"}
        ),
    }  # fmt: skip
    if seen.name == "acceleration":
        spectra = [shock_spectrum(r, fs, freq_hz) for r in responses]
        variables["srs"] = (("quantile", "freq"), bands(spectra), unit)
    coords = {
        "time": ("time", t[::step], {"units": "s"}),
        "freq": ("freq", freq_hz, {"units": "Hz"}),
    }
    found = labelled(variables, coords, ready.load, seen)
    return found.assign_attrs(ready.facts)
