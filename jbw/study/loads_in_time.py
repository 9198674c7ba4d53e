"""Bands of the response to loads that vary in time: random profiles and shocks."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from jbw.errors import ConfigError, ModelError
from jbw.forced.equivalent import Values, joint_secants
from jbw.forced.profiles import RandomProfile
from jbw.forced.random import RandomResponse, random_response
from jbw.forced.shock import Pulse, ShockResponse, shock_response, shock_spectrum
from jbw.forced.sine_on_random import SineOnRandom, sine_on_random
from jbw.oscillator.modes.structure import Structure
from jbw.quantities import derivative_order
from jbw.report.messages import loads as messages
from jbw.study.loads import (
    TAU,
    Complexes,
    Load,
    Member,
    Prepared,
    SeenResponse,
    bands,
    checked_levels,
    has_several,
    labelled,
    measured_of,
    prepared,
    response_of,
    together,
    zones_of,
)
from jbw.verification.predictive_basis import Basis

# number of frequencies on each side of the resonance; their spacing grows with distance
FEW = 240
# Largest relative change of a mode's damping by the simultaneous motion of other modes, computed
# without the order of the load reversals. The rms of the mode then changes by at most 1 %.
COUPLED = 0.005
Modes = Sequence[tuple[Member, RandomResponse]]  # motion of every mode for one law's draws
MOST_TIMES = 2000  # approximate number of times at which a response is stored


def random_of(
    basis: Basis,
    profile: RandomProfile,
    duration: float,
    load: Load,
    sine: tuple[float, float] | None = None,
) -> xr.Dataset:
    """Return the bands of the response to a random profile: see `Study.random`.

    The model discrepancy is taken at twice the rms displacement.
    """
    (duration,) = checked_levels([duration])
    seen = measured_of(basis, load)
    stated = profile.in_unit(seen.source)
    what = messages.random(stated.rms, seen.source)

    at_sine = None if sine is None else tuple(checked_levels(sine))

    def moved(member: Member) -> SineOnRandom:
        share = np.abs(member.share)
        if at_sine is None:
            return SineOnRandom(random_response(member.motion, stated.at, share), 0.0j * share)
        hz, level = at_sine
        return sine_on_random(member.motion, stated.at, share, level * share, TAU * hz)

    def amplitude(member: Member) -> Values:
        found = moved(member)
        return 2.0 * found.random.rms()[:, None] + np.abs(found.sine)

    zones = zones_of(basis, load)
    # If no mode is driven, the prediction of the first mode raises the error.
    driven = [zone for zone in zones if stated.at(np.array(zone.omega / TAU)) > 0.0] or zones[:1]
    by_mode = [prepared(basis, replace(load, mode=zone.mode), amplitude, what) for zone in driven]
    members = [list(of_law) for of_law in zip(*(one.members for one in by_mode), strict=True)]
    found = [[(member, moved(member)) for member in of_law] for of_law in members]
    laws = [[(member, one.random) for member, one in of_law] for of_law in found]
    for modes in laws:
        _require_alone(modes, what)
    band = float(stated.freq_hz[0]), float(stated.freq_hz[-1])
    near = [_frequencies(one.frequency_hz, one.damping, band, FEW) for _, one in laws[0]]
    freq_hz, ready = np.unique(np.concatenate(near)), together(by_mode)
    density = stated.at(freq_hz)
    rows = [_random(modes, load, seen, density, freq_hz, duration) for modes in laws]
    if at_sine is not None:
        hz, level = at_sine
        for row, ((member, one), *_) in zip(rows, found, strict=True):
            omega = np.full(one.sine.shape, TAU * hz)
            response = response_of(member, load, seen, level, omega, one.sine)
            row["largest_displacement"] += np.abs(one.sine)[:, 0]
            row["sine"] = np.abs(response)[:, 0]
    units = messages.units_of_random(seen.unit, seen.name)
    variables = {
        name: (
            ("quantile", "freq") if name == "psd" else "quantile",
            bands([row[name] for row in rows], withheld=ready.withheld),
            units[re.sub(r"_\d+$", "", name)],
        )
        for name in rows[0]
    }
    coords = {"freq": ("freq", freq_hz, {"units": "Hz"})}
    facts = {"duration": duration, "profile_rms": stated.rms, **ready.facts}
    if at_sine is not None:
        facts |= {"sine_frequency": at_sine[0], "sine_level": at_sine[1]}
    return labelled(variables, coords, ready.load, seen).assign_attrs(facts)


def _random(
    modes: Modes,
    load: Load,
    seen: SeenResponse,
    density: Values,
    freq_hz: Values,
    duration: float,
) -> dict[str, Values]:
    """Return the statistics and spectrum of each draw's response, from all modes of one law."""
    mean, spread = _transfer(modes, freq_hz)
    omega = TAU * freq_hz

    def spectrum(order: int) -> Values:
        return density * omega ** (2 * order) * (np.abs(mean) ** 2 + spread)

    if load.is_base:
        gain = load.shape * omega**2
        response = density * (np.abs(1.0 + gain * mean) ** 2 + gain**2 * spread)
    else:
        response = spectrum(derivative_order(seen.name))
    response = seen.factor**2 * response
    relative = np.sqrt(np.trapezoid(spectrum(0), freq_hz))
    # The largest values of independent modes combine as the root of the sum of their squares, as
    # rms values do.
    largest = np.sqrt(sum(one.largest(duration) ** 2 for _, one in modes))
    each = [(f"_{member.motion.mode + 1}" if modes[1:] else "", one) for member, one in modes]
    return {
        "rms": np.sqrt(np.trapezoid(response, freq_hz)),
        "displacement": relative,
        "largest_displacement": largest,
        "peak_factor": largest / relative,
        **{f"frequency{mode}": one.frequency_hz for mode, one in each},
        **{f"damping{mode}": one.damping for mode, one in each},
        "psd": response,
    }


def _transfer(modes: Modes, freq_hz: Values) -> tuple[Complexes, Values]:
    """Return mean and variance of the measured displacement per unit of the source, (draw, freq).

    Modes without power at their resonance add the response of stuck joints to the mean.
    """
    members = [member for member, _ in modes]
    moments = [(member.share, *one.transfer(freq_hz)) for member, one in modes]
    mean = np.sum([share * mean for share, mean, _ in moments], axis=0)
    spread = np.sum(
        [share**2 * (square - np.abs(mean) ** 2) for share, mean, square in moments], axis=0
    )
    joint, omega = members[0].motion.joint, TAU * freq_hz
    if isinstance(joint, Structure):
        own = [member.motion.mode for member in members]
        omega_n, zeta, b, c = (
            np.delete(np.asarray(part), own, -1)[..., None]
            for part in (joint.omega_n, joint.zeta, joint.b, np.asarray(joint.c)[:, 0])
        )
        stuck = b * c / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)
        mean = mean + members[0].theta["gain"][:, None] * np.sum(stuck, 1)
    return mean, spread


def _require_alone(modes: Modes, what: str) -> None:
    """Raise if the simultaneous motion of modes changes their damping at the joints.

    The damping of each mode at its rms amplitude is compared with that at the joints' rms of all
    modes together.
    """
    joint = modes[0][0].motion.joint
    if len(modes) < 2 or not isinstance(joint, Structure):
        return
    h, p = np.abs(np.asarray(joint.h)), np.abs(np.asarray(joint.p))
    rms = [np.sqrt(2.0) * one.rms()[:, None] * h[..., m.motion.mode] for m, one in modes]
    total = np.sqrt(np.sum(np.square(rms), axis=0))
    for (member, response), own in zip(modes, rms, strict=True):
        mode, omega = member.motion.mode, TAU * response.frequency_hz
        weights = p[:, mode] * h[..., mode]
        alone, beside = (
            np.sum(weights * np.imag(joint_secants(joint, x, omega)), -1) for x in (own, total)
        )
        change = (beside - alone) / (member.motion.viscous[:, 0] * omega + alone)
        if np.median(np.abs(change)) > COUPLED:
            raise ModelError(
                f"{what} must move the joint by one mode at a time, but the motion of the other "
                f"modes changes the damping of mode {mode + 1} by "
                f"{100 * float(np.median(change)):.2g} %.",
                why="Random vibration is predicted mode by mode, as if each mode moved alone.",
                remedy="Restrict the profile to the frequencies of one mode, or simulate the "
                f"structure of {messages.ONE_DRAW}, by `jbw.simulate` with samples of the force.",
            )


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
    if has_several(basis.posterior, basis.laws):
        raise ModelError(
            "The run must have one mode with one joint for the prediction of a shock, but has "
            "several.",
            remedy=f"Simulate the structure of {messages.ONE_DRAW}, by `jbw.simulate`.",
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
