"""One test at the virtual rig: the excitation, the sensors and the recorder."""

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.measurement.kinds import kind_named
from jbw.measurement.records import Record, Test
from jbw.quantities import BY_NAME
from jbw.rig.conditions import Conditions, digitise, stream
from jbw.rig.generator import (
    Excitation,
    Multisine,
    Noise,
    Steps,
    Tone,
    Voltage,
    analog,
    draw_phases,
)
from jbw.rig.integrator import GRID, Specimen, respond
from jbw.rig.prescribed_motion import (
    Growth,
    Held,
    HeldPoints,
    Locked,
    held_points,
    holding_force,
    locked_points,
    pulled,
)
from jbw.rig.presets import Plan, Preset
from jbw.rig.structure import Assembled, RigMotion, Shapes, move, of_day

CELL_NOISE, POINT_NOISE = 2e-4, 1e-3  # noise of a force cell [N], and of an accelerometer [m/s^2]
POINT_RANGE = 512.0  # full scale of the accelerometer [m/s^2]
Samples = NDArray[np.float64]
Channels = dict[str, Samples]


@dataclass(frozen=True)
class Bench:
    """A planned test, with the rig that measures the test and the disturbances of its records."""

    plan: Plan
    rig: Preset
    conditions: Conditions

    def stream(self, repeat: int, channel: int) -> np.random.Generator:
        """Return the random number generator of one channel in one repeat."""
        return stream(self.conditions, zlib.crc32(self.plan.name.encode()), repeat, channel)

    def sensed(
        self, role: str, analog: Samples, noise_std: float, full_scale: float, key: tuple[int, int]
    ) -> Samples:
        """Return a channel with sensor noise, digitised; `key`: numbers of repeat and channel."""
        return digitise(
            analog,
            noise_std=noise_std,
            full_scale=full_scale,
            bits=self.conditions.bits,
            rng=self.stream(*key),
            channel=f"`{role}` of {self.plan.name}",
        )


def record_test(
    plan: Plan, rig: Preset, days: Sequence[Specimen], conditions: Conditions
) -> list[tuple[Test, Sequence[Samples]]]:
    """Record a planned test, with demanded signals [V or N]; divide it by day if days differ."""
    excitation = plan.excitation
    channels, demands = _recorded(Bench(plan, rig, conditions), days)
    by_lines = isinstance(excitation, Held | Locked | HeldPoints)
    records = [
        Record(
            fs=float("nan") if by_lines else conditions.fs,
            channels=record_channels,
            units={role: BY_NAME[role].unit for role in record_channels},
            name=f"{plan.name}_{r + 1:02d}",
            provenance={"reader": "jbw.rig", "preset": rig.name, "seed": str(conditions.seed)},
        )
        for r, record_channels in enumerate(channels)
    ]
    test = Test(
        kind=plan.kind,
        records=tuple(records),
        name=plan.name,
        level=excitation.level,
        tones_hz=_tones(excitation),
        band_hz=plan.band_hz,
        dwell=excitation.dwell if isinstance(excitation, Steps) else float("nan"),
        settle=plan.settle,
        delay=conditions.delay if "velocity" in channels[0] else 0.0,
        periods=excitation.periods if isinstance(excitation, Multisine) else 1,
        drive=plan.drive,
        locked_phase=excitation.phase if isinstance(excitation, Locked) else -90.0,
        amplitude_std=getattr(excitation, "amplitude_noise", 0.0),
    )
    return list(_by_day(test, demands)) if conditions.varies else [(test, demands)]


def _recorded(bench: Bench, days: Sequence[Specimen]) -> tuple[list[Channels], Sequence[Samples]]:
    """Return the channels of every repeat, and the demanded signals if a shaker is used."""
    plan, rig, excitation = bench.plan, bench.rig, bench.plan.excitation
    if not isinstance(excitation, Growth | Held | Locked | HeldPoints):
        if rig.shapes is not None:
            return _shaken_structure(bench, rig.shapes, excitation, days)
        return _shaken(bench, excitation, days)
    if rig.source != "force":
        raise ConfigError(
            f"Test `{plan.name}` measures newtons, so the rig must measure the shaker's `force`, "
            f"but measures its `{rig.source}`.",
            remedy='Give the preset source = "force" and the inverse of the modal mass as gain.',
        )
    repeats = range(plan.repeats)
    if isinstance(excitation, Growth):
        return [_pulled(bench, excitation, days[r], r) for r in repeats], []
    if isinstance(excitation, Locked):
        return [_locked(bench, excitation, days[r], r) for r in repeats], []
    if isinstance(excitation, HeldPoints):
        return [_points(bench, excitation, days[r], r) for r in repeats], []
    return [_held(bench, excitation, days[r], r) for r in repeats], []


def _tones(excitation: Excitation | Growth | Held | Locked | HeldPoints) -> tuple[float, ...]:
    """Return the frequencies of the tones of an excitation [Hz]; empty if it has no tones."""
    if isinstance(excitation, Tone):
        return (excitation.frequency_hz,)
    return excitation.frequencies_hz if isinstance(excitation, Steps) else ()


def _by_day(test: Test, demands: Sequence[Samples]) -> Iterator[tuple[Test, Sequence[Samples]]]:
    """Yield a separate test for each day, with its record and its demanded signal."""
    for r, record in enumerate(test.records):
        name, day = f"{test.name}_day{r + 1}", f"day {r + 1}"
        of_day = (replace(record, name=f"{name}_01"),)
        yield replace(test, records=of_day, name=name, run=day), demands[r : r + 1]


def _shaken(
    bench: Bench, excitation: Excitation, days: Sequence[Specimen]
) -> tuple[list[Channels], list[Samples]]:
    """Record channels and demanded signals under the shaker; for a free decay only the velocity."""
    rig, conditions = bench.rig, bench.conditions
    differ = conditions.varies or isinstance(excitation, Noise)
    driven = kind_named(bench.plan.kind).is_driven
    recorded: list[Channels] = []
    demands = []
    demand = source = velocity = np.empty(0)
    for r in range(bench.plan.repeats):
        if r == 0 or differ:
            demand, source, velocity = _play(bench, excitation, days[r], r)
        channels: Channels = {}
        if driven:
            noise = conditions.input_noise_std
            channels[rig.source] = bench.sensed(rig.source, source, noise, rig.input_range, (r, 1))
            demands.append(demand)
        channels["velocity"] = _by_laser(bench, velocity, r)
        recorded.append(channels)
    return recorded, demands


def _by_laser(bench: Bench, velocity: Samples, repeat: int) -> Samples:
    """Return the velocity as the laser channel records it, with noise and digitisation."""
    rig, conditions = bench.rig, bench.conditions
    noise = conditions.noise_std
    if conditions.noise_ratio is not None:
        noise = conditions.noise_ratio * float(np.sqrt(np.mean(velocity**2)))
    return bench.sensed("velocity", velocity, noise, rig.velocity_range, (repeat, 2))


def _played(
    bench: Bench, excitation: Excitation, repeat: int
) -> tuple[Callable[..., Voltage], int, int]:
    """Return the source as a function of the sampling rate, and its first and last sample."""
    fs = bench.conditions.fs
    # Every repeat of noise has new random phases, but a multisine is repeated unchanged.
    drawn = repeat if isinstance(excitation, Noise) else 0
    phases = draw_phases(excitation, bench.stream(drawn, 0), fs)
    first = round(excitation.settle * fs)
    last = first + round(excitation.duration * fs)
    return partial(analog, excitation, phases=phases, fs=fs), first, last


def _play(
    bench: Bench, excitation: Excitation, specimen: Specimen, repeat: int
) -> tuple[Samples, Samples, Samples]:
    """Return the demanded source, the source at the shaker and the velocity, before any sensor."""
    conditions, fs = bench.conditions, bench.conditions.fs
    played, first, last = _played(bench, excitation, repeat)
    demand = played(fs)(first, last)
    source = played(fs, distortion=conditions.distortion)(first, last)
    # A delayed channel shows at time t the motion at t - delay, as if its clock had started later.
    fine = played(GRID * fs, lag=conditions.delay, distortion=conditions.distortion)
    gain = bench.rig.gain
    _, velocity, _ = respond(specimen, lambda i, j: gain * fine(i, j), last, fs)
    return demand, source, velocity[first:]


def _shaken_structure(
    bench: Bench, shapes: Shapes, excitation: Excitation, days: Sequence[Specimen]
) -> tuple[list[Channels], list[Samples]]:
    """Record channels and demanded signals of a structure with several modes on a shaker."""
    rig, conditions = bench.rig, bench.conditions
    if conditions.delay:
        raise ConfigError(
            f"Argument `delay` must be 0 on the rig `{rig.name}`, but is {conditions.delay:g}.",
            why="This rig records force and drive point at the same time as the velocity.",
        )
    differ = conditions.varies or isinstance(excitation, Noise)
    recorded: list[Channels] = []
    demands: list[Samples] = []
    played = None
    for r in range(bench.plan.repeats):
        if played is None or differ:
            assembled = Assembled(of_day(shapes, days[r]), days[r].forces, rig.armature)
            played = _play_structure(bench, assembled, excitation, r)
        demand, source, motion = played
        sensors = {
            "input": (source, conditions.input_noise_std, rig.input_range, 1),
            "force": (motion.force, CELL_NOISE, rig.force_range, 3),
            "drive_point": (motion.drive_point, POINT_NOISE, POINT_RANGE, 4),
        }
        channels: Channels = {}
        for role in bench.plan.sources:
            x, noise, full_scale, number = sensors[role]
            channels[role] = bench.sensed(role, x, noise, full_scale, (r, number))
        if bench.plan.sources:
            demands.append(demand)
        channels["velocity"] = _by_laser(bench, motion.velocity, r)
        recorded.append(channels)
    return recorded, demands


def _play_structure(
    bench: Bench, structure: Assembled, excitation: Excitation, repeat: int
) -> tuple[Samples, Samples, RigMotion]:
    """Return the demanded voltage, the voltage at the shaker and the motion, before any sensor."""
    conditions, fs = bench.conditions, bench.conditions.fs
    played, first, last = _played(bench, excitation, repeat)
    motion = move(structure, played(GRID * fs, distortion=conditions.distortion), last, fs)
    demand = played(fs)(first, last)
    source = played(fs, distortion=conditions.distortion)(first, last)
    return demand, source, RigMotion(*(x[first:] for x in motion))


def _pulled(bench: Bench, growth: Growth, specimen: Specimen, repeat: int) -> Channels:
    """Return the channels of a slow loop: the prescribed displacement and the force for it."""
    rig, noise = bench.rig, bench.conditions.force_noise_std
    y, force = pulled(specimen, growth, bench.conditions.fs)
    force = force / rig.gain
    return {
        "displacement": bench.sensed("displacement", y, 0.0, rig.displacement_range, (repeat, 2)),
        "restoring_force": bench.sensed(
            "restoring_force", force, noise, rig.force_range, (repeat, 1)
        ),
    }


def _held(bench: Bench, held: Held, specimen: Specimen, repeat: int) -> Channels:
    """Return the channels of a response-controlled curve, one value per frequency."""
    # A sine fitted over T seconds has noise sigma sqrt(2 / (T f_s)) in each of its real and
    # imaginary parts.
    force = holding_force(specimen, held) / bench.rig.gain
    std = bench.conditions.force_noise_std * np.sqrt(2 / (held.dwell * bench.conditions.fs))
    real, imaginary = std * bench.stream(repeat, 1).standard_normal((2, force.size))
    force = force + real + 1j * imaginary
    return {
        "frequency": np.asarray(held.frequencies_hz),
        "force": np.abs(force),
        "displacement": np.full(force.size, held.level),
        "phase": -np.angle(force),
    }


def _locked(bench: Bench, locked: Locked, specimen: Specimen, repeat: int) -> Channels:
    """Return the channels of phase-controlled points, with errors of control and measurement."""
    held = np.full(len(locked.levels), locked.phase)
    phase = np.radians(held + locked.phase_error * _scatter(bench, repeat, 0, held))
    distortion = bench.conditions.distortion
    frequency, force = locked_points(specimen, locked, phase, distortion)
    frequency = frequency * (1.0 + locked.frequency_noise * _scatter(bench, repeat, 3, held))
    return {"frequency": frequency, **_read_points(bench, locked, force, phase, repeat)}


def _points(bench: Bench, points: HeldPoints, specimen: Specimen, repeat: int) -> Channels:
    """Return the channels of amplitude-controlled points, with measurement errors."""
    held = held_points(specimen, points, bench.conditions.distortion)
    phase = -np.angle(held) + points.force_noise * _scatter(bench, repeat, 3, held)
    frequency = np.asarray(points.frequencies_hz)
    return {"frequency": frequency, **_read_points(bench, points, np.abs(held), phase, repeat)}


def _read_points(
    bench: Bench, excitation: Locked | HeldPoints, force: Samples, phase: Samples, repeat: int
) -> Channels:
    """Return the force, amplitude and phase of points as measured, with their noise."""
    level, noise = np.asarray(excitation.levels), excitation.amplitude_noise
    read = force / bench.rig.gain
    return {
        "force": read * (1.0 + excitation.force_noise * _scatter(bench, repeat, 1, force)),
        "displacement": level * (1.0 + noise * _scatter(bench, repeat, 2, force)),
        # The component of this noise that is perpendicular to the phasor changes the phase.
        "phase": phase + noise * _scatter(bench, repeat, 4, force),
    }


def _scatter(bench: Bench, repeat: int, number: int, like: NDArray[Any]) -> Samples:
    """Return standard normal numbers, one per point, for one channel of one repeat."""
    return bench.stream(repeat, number).standard_normal(like.size)
