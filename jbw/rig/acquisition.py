"""A day at the rig: every planned test is played, answered, sensed and recorded."""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.measurement.records import Record, Test
from jbw.oscillator.parameters import BoucWen
from jbw.rig.bench import GRID, respond
from jbw.rig.conditions import Conditions, check, joint_of_days, stream
from jbw.rig.generator import Noise, Steps, Tone, analog, draw_phases
from jbw.rig.presets import PRIOR, TRUTH, Plan, Preset, plans_named, preset_named
from jbw.rig.sensors import digitise


@dataclass(frozen=True)
class RigCampaign:
    """A campaign in memory, with the fields of one loaded from its file.

    Attributes:
        name: Name of the campaign.
        tests: The tests; channels `input` [V] and `velocity` [m/s].
        settings: Choices for the identification, fixed before any fit.
        truth: What produced the data; for judging an identification, never for making one.
        demands: Test name to the demanded voltage of each repeat [V].
        folder: Where it was read from: nowhere.
        gain: Not given: the identification finds it [N/kg/V].
        modal_mass: Not given, the input is no force [kg].
    """

    name: str
    tests: tuple[Test, ...]
    settings: Mapping[str, Any]
    truth: Mapping[str, Any]
    demands: Mapping[str, tuple[NDArray[np.float64], ...]] = field(repr=False)
    folder: Path | None = None
    gain: float | None = None
    modal_mass: float | None = None


def measure(
    preset: str | Preset = "laboratory",
    *,
    seed: int = 0,
    joint: BoucWen = TRUTH,
    tests: Iterable[str] | None = None,
    repeats: int | None = None,
    noise_std: float = 50e-6,
    noise_ratio: float | None = None,
    input_noise_std: float = 0.5e-6,
    bits: int = 24,
    distortion_db: float | None = None,
    delay: float = 0.0,
    omega_n_cv: float = 0.0,
    zeta_cv: float = 0.0,
    fs: float = 1024.0,
) -> RigCampaign:
    """Measures the virtual specimen; equal arguments give equal bits.

    Every test has its own streams of random numbers, so a subset of the tests, or fewer repeats,
    gives the same records as the whole campaign. Repeat r of every test is taken on day r: with
    `omega_n_cv` or `zeta_cv` the joint is assembled anew each day and is the same that day in all
    tests. The paper saw 0.0018 for omega_n between assemblies.

    Args:
        preset: "laboratory", "paper" or a preset of your own.
        seed: Seed of everything random.
        joint: The specimen; nu = 1.
        tests: Names of the tests to take, in the order of the preset; all when None.
        repeats: Records of each test; as the preset plans when None.
        noise_std: Laser noise over 0 .. fs/2 [m/s].
        noise_ratio: Laser noise as a fraction of the rms velocity of each record, instead [-].
        input_noise_std: Noise of the input channel [V].
        bits: Bits of the converters.
        distortion_db: Third harmonic of the source in tones, steps and sweeps [dB]; at -60 dB it
            already rivals the joint's own.
        delay: Lag of the velocity channel, stated in the tests [s].
        omega_n_cv: Coefficient of variation of omega_n from day to day [-].
        zeta_cv: Coefficient of variation of zeta from day to day [-].
        fs: Sampling frequency [Hz].

    Returns:
        The campaign; `write` puts it into files.

    Raises:
        ConfigError: For an unknown preset or test, or a number out of its range.
        ModelError: In float32, or when the joint's response is not finite.
    """
    rig = preset_named(preset)
    conditions = Conditions(
        seed=seed, fs=fs, noise_std=noise_std, noise_ratio=noise_ratio,
        input_noise_std=input_noise_std, bits=bits, distortion_db=distortion_db, delay=delay,
        omega_n_cv=omega_n_cv, zeta_cv=zeta_cv,
    )  # fmt: skip
    check(conditions)
    if repeats is not None and repeats < 1:
        raise ConfigError(f"Argument `repeats` must be at least 1, but is {repeats}.")
    plans = [replace(p, repeats=repeats or p.repeats) for p in plans_named(rig, tests)]
    days = joint_of_days(joint, max(plan.repeats for plan in plans), conditions)
    # Two tests at once: FFT, compiled loop and random numbers all release the interpreter's lock.
    with ThreadPoolExecutor(max_workers=2) as pool:
        taken = list(pool.map(lambda plan: _take(plan, rig, days, conditions), plans))
    return RigCampaign(
        name=f"virtual rig, {rig.name}",
        tests=tuple(test for test, _ in taken),
        settings=_settings(plans),
        truth=_truth(rig, joint, days, conditions),
        demands={test.name: demands for test, demands in taken},
    )


def _take(
    plan: Plan, rig: Preset, days: Sequence[BoucWen], conditions: Conditions
) -> tuple[Test, tuple[NDArray[np.float64], ...]]:
    """One test: its records and the demanded voltages."""
    distinct = conditions.varies or isinstance(plan.excitation, Noise)
    records, demands = [], []
    demand = volts = velocity = np.empty(0)
    for r in range(plan.repeats):
        if r == 0 or distinct:
            demand, volts, velocity = _play(plan, rig.gain, days[r], r, conditions)
        records.append(_record(plan, rig, volts, velocity, r, conditions))
        demands.append(demand)
    excitation = plan.excitation
    test = Test(
        kind=plan.kind,
        records=tuple(records),
        name=plan.name,
        level=excitation.level,
        tones_hz=_tones(plan),
        band_hz=plan.band_hz,
        dwell=excitation.dwell if isinstance(excitation, Steps) else float("nan"),
        settle=plan.settle,
        delay=conditions.delay,
    )
    return test, tuple(demands)


def _play(
    plan: Plan, gain: float, joint: BoucWen, repeat: int, conditions: Conditions
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Demanded voltage, voltage at the shaker and velocity, as they are before any sensor."""
    excitation, fs = plan.excitation, conditions.fs
    phases = draw_phases(excitation, _stream(plan, repeat, 0, conditions), fs)
    first = round(excitation.settle * fs)
    last = first + round(excitation.duration * fs)
    demand = analog(excitation, fs, phases, fs=fs)(first, last)
    volts = analog(excitation, fs, phases, fs=fs, distortion=conditions.distortion)(first, last)
    # The channel that lags shows at t what the specimen did at t - delay: its clock starts later.
    fine = analog(
        excitation, GRID * fs, phases, fs=fs, lag=conditions.delay, distortion=conditions.distortion
    )
    _, velocity, _ = respond(joint, lambda i, j: gain * fine(i, j), last, fs)
    return demand, volts, velocity[first:]


def _record(
    plan: Plan,
    rig: Preset,
    volts: NDArray[np.float64],
    velocity: NDArray[np.float64],
    repeat: int,
    conditions: Conditions,
) -> Record:
    """What the two channels leave of one repeat."""
    laser = conditions.noise_std
    if conditions.noise_ratio is not None:
        laser = conditions.noise_ratio * float(np.sqrt(np.mean(velocity**2)))
    channels = {
        "input": digitise(
            volts,
            noise_std=conditions.input_noise_std,
            full_scale=rig.input_range,
            bits=conditions.bits,
            rng=_stream(plan, repeat, 1, conditions),
            channel=f"`input` of {plan.name}",
        ),
        "velocity": digitise(
            velocity,
            noise_std=laser,
            full_scale=rig.velocity_range,
            bits=conditions.bits,
            rng=_stream(plan, repeat, 2, conditions),
            channel=f"`velocity` of {plan.name}",
        ),
    }
    return Record(
        fs=conditions.fs,
        channels=channels,
        units={"input": "V", "velocity": "m/s"},
        name=f"{plan.name}_{repeat + 1:02d}",
        provenance={"reader": "jbw.rig", "preset": rig.name, "seed": str(conditions.seed)},
    )


def _stream(plan: Plan, repeat: int, channel: int, conditions: Conditions) -> np.random.Generator:
    return stream(conditions, zlib.crc32(plan.name.encode()), repeat, channel)


def _tones(plan: Plan) -> tuple[float, ...]:
    if isinstance(plan.excitation, Tone):
        return (plan.excitation.frequency_hz,)
    return plan.excitation.frequencies_hz if isinstance(plan.excitation, Steps) else ()


def _settings(plans: Sequence[Plan]) -> dict[str, Any]:
    """Held out before any fit: the middle sweep level, and half of many repeats. The prior."""
    sweeps = sorted((p for p in plans if p.kind == "sweep"), key=lambda p: p.excitation.level)
    settings: dict[str, Any] = {}
    if len(sweeps) >= 3:
        levels = [p.excitation.level for p in sweeps]
        settings["fit_levels"] = [levels[0], levels[-1]]
    if sweeps and min(p.repeats for p in sweeps) >= 8:
        settings["fit_repeats"] = min(p.repeats for p in sweeps) // 2
    return {**settings, "prior": {name: list(pair) for name, pair in PRIOR.items()}}


def _truth(
    rig: Preset, joint: BoucWen, days: Sequence[BoucWen], conditions: Conditions
) -> dict[str, Any]:
    names = ("omega_n", "zeta", "alpha", "delta", "gamma")
    return {
        "preset": rig.name,
        "gain": rig.gain,
        "joint": {name: float(getattr(joint, name)) for name in names},
        "days": [{name: float(getattr(day, name)) for name in names[:2]} for day in days],
        "conditions": asdict(conditions),
    }
