"""Sound records of every kind, drawn at random, with channels in SI.

A `Drawn` first contains what a perfect recorder would write; `recorded` adds noise and rounding.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.fft

from .plants import COMMON, LAWS, Rng, Truth, draw_plant, log_uniform, steady_truth, truth_of
from .simulator import Array, Plant, force_along, free_decay, march, substeps_of

RESPONSES = ("displacement", "velocity", "acceleration")
HZ = (0.2, 2e4)  # range of natural frequencies [Hz], before a usual sampling rate is chosen
SAMPLES = 60_000  # largest number of samples of a record
PERIODS = (5, 5000)  # range of the number of periods of a decay
SEEN = 3.0  # smallest ratio of amplitude to noise over the first three periods of a decay
# Sampling rates of recorders [Hz]; half of all records have one of these, the others any rate.
RATES = (
    *(51200 / n for n in (1, 2, 3, 5, 7, 11, 13, 14, 25, 31)), 102400.0, 2441.40625, 12207.03125,
    4882.8125, 1000.0, 1024.0, 2048.0, 8192.0, 44100.0, 48000.0, 500.0, 100.0, 50.0, 128.0,
    20000.0, 1652.0, 615.0,
)  # fmt: skip


@dataclass(frozen=True)
class Drawn:
    """A record, with everything that was drawn for it.

    Attributes:
        kind: decay, sweep, multisine, noise or loop.
        law: Name in `plants.LAWS`.
        plant: Oscillator in units of 1 rad/s and of `length`.
        hz: Natural frequency, fully stuck [Hz].
        length: Displacement that is an amplitude of one in the plant [m].
        mass: Modal mass [kg].
        per_period: Samples per natural period.
        channels: Channels by role, in SI.
        band: Lowest and highest frequency of interest [Hz].
        top: Largest displacement amplitude, in units of the plant.
        noise: Standard deviation of the noise over the largest response.
        facts: Everything else that was drawn.
        fault: Name of the fault; empty for a sound record.
        size: Size of the fault, in words.
    """

    kind: str
    law: str
    strong: bool
    plant: Plant
    hz: float
    length: float
    mass: float
    per_period: float
    fs: float
    response: str
    channels: Mapping[str, Array]
    band: tuple[float, float]
    top: float
    noise: float
    bits: int
    facts: Mapping[str, Any] = field(default_factory=dict)
    fault: str = ""
    size: str = ""

    @property
    def order(self) -> int:
        """The order of the response: 0 for displacement, 1 for velocity, 2 for acceleration."""
        return RESPONSES.index(self.response)

    @property
    def zeta(self) -> float:
        """The viscous damping ratio."""
        return self.plant.zeta

    @property
    def x(self) -> Array:
        """The response, or for a loop the restoring force."""
        return self.channels["restoring_force" if self.kind == "loop" else self.response]

    @property
    def drive(self) -> str | None:
        """The role of the channel that drives the structure."""
        named = {"decay": None, "loop": "displacement"}
        return named.get(self.kind, "force")

    def with_channels(self, **channels: Array) -> "Drawn":
        """Return the record with other channels, all cut to the length of the shortest."""
        every = {**self.channels, **channels}
        shortest = min(map(len, every.values()))
        return replace(self, channels={name: x[:shortest] for name, x in every.items()})

    def with_x(self, x: Array) -> "Drawn":
        """Return the record with another response (for a loop, another force)."""
        return self.with_channels(
            **{"restoring_force" if self.kind == "loop" else self.response: x}
        )

    def truth(self) -> Truth:
        """Return the true values: of a free decay for decays, of steady loops for driven tests."""
        find = truth_of if self.kind == "decay" else steady_truth
        # computed up to the same amplitude for all levels
        return find(self.plant, max(self.top, 1.0))

    def true_at(self, displacement: Array) -> tuple[Array, Array]:
        """Return true frequency [Hz] and damping ratio at given displacement amplitudes [m]."""
        omega, zeta = self.truth().at(np.asarray(displacement) / self.length, 0)
        return omega * self.hz, zeta


@dataclass(frozen=True)
class Choice:
    """The properties of a record that are not left to chance.

    Attributes:
        law: One of `plants.LAWS`; drawn if None.
        strong: Whether the law is strong; drawn if None.
        zeta: Range of the damping ratio; depends on the law if None.
        noise: Range of the noise; if None, there may be no noise.
        bits: Smallest number of bits.
        laws: Laws from which one is drawn.
    """

    law: str | None = None
    strong: bool | None = None
    zeta: tuple[float, float] | None = None
    noise: tuple[float, float] | None = None
    bits: int = 8
    laws: tuple[str, ...] = COMMON


ANY = Choice()


@dataclass(frozen=True)
class Specimen:
    """A structure with its instruments, which all records of a campaign share.

    Attributes:
        law: Name in `plants.LAWS`.
        plant: Oscillator in units of 1 rad/s and of `length`.
        hz: Natural frequency, fully stuck [Hz].
        per_period: Samples per natural period.
        noise: Standard deviation over the largest response at a level of one.
        response: Quantity that the sensor measures.
        mass: Modal mass [kg].
        length: Displacement that is an amplitude of one in the plant [m].
    """

    law: str
    strong: bool
    plant: Plant
    hz: float
    per_period: float
    noise: float
    bits: int
    response: str
    mass: float
    length: float

    @property
    def zeta(self) -> float:
        """The viscous damping ratio."""
        return self.plant.zeta

    @property
    def fs(self) -> float:
        """The sampling frequency [Hz]."""
        return self.hz * self.per_period

    @property
    def rate(self) -> float:
        """The number of samples per unit of the plant's time."""
        return self.per_period / (2 * np.pi)

    def record(self, kind: str, motion: Array, u: Array | None, level: float, **more: Any) -> Drawn:
        """Return a record from motion (displacement, velocity, acceleration) and force, in SI."""
        w = 2 * np.pi * self.hz
        order = RESPONSES.index(self.response)
        channels = {self.response: motion[order] * self.length * w**order}
        if u is not None:
            channels = {"force": u * self.mass * self.length * w**2, **channels}
        return Drawn(
            kind, self.law, self.strong, self.plant, self.hz, self.length, self.mass,
            self.per_period, self.fs, self.response, channels, bits=self.bits,
            noise=self.noise / level, top=float(np.max(np.abs(motion[0]))), **more,
        )  # fmt: skip


# ranges by kind: samples per period, damping of linear plants, damping of other plants
RANGES: dict[str, tuple[tuple[float, float], tuple[float, float], tuple[float, float]]] = {
    "decay": ((8, 40), (5e-4, 0.2), (5e-4, 0.1)),
    "sweep": ((8, 30), (1e-3, 0.2), (1e-3, 0.05)),
    "multisine": ((8, 20), (2e-3, 0.1), (2e-3, 0.05)),
    "noise": ((8, 20), (2e-3, 0.1), (2e-3, 0.05)),
    "loop": ((8, 40), (1e-3, 0.01), (1e-3, 0.01)),
    "mixed": ((9, 20), (2e-3, 0.05), (2e-3, 0.03)),
}


def specimen(rng: Rng, kind: str, choice: Choice = ANY) -> Specimen:
    """Draw a structure and its instruments for records of a kind."""
    per_period, of_linear, of_others = RANGES[kind]
    law = choice.law or _law(rng, choice.laws)
    strong = bool(rng.integers(2)) if choice.strong is None else choice.strong
    zeta = log_uniform(rng, *(choice.zeta or (of_linear if law == "linear" else of_others)))
    per = rng.uniform(*per_period)
    hz = log_uniform(rng, *HZ)
    if rng.random() < 0.5:
        usual = [rate for rate in RATES if HZ[0] < rate / per < HZ[1]]
        hz = float(rng.choice(usual)) / per
    noise = 0.0 if rng.random() < 0.1 else log_uniform(rng, 1e-5, 0.1)
    if choice.noise:
        noise = log_uniform(rng, *choice.noise)
    bits = max(int(rng.choice([8, 10, 12, 14, 16, 24])), choice.bits)
    # realistic acceleration of a laboratory, realistic motion of a bench
    length = min(log_uniform(rng, 0.1, 500) / (2 * np.pi * hz) ** 2, log_uniform(rng, 1e-3, 3e-2))
    mass = log_uniform(rng, 0.05, 50.0)
    if kind == "loop":  # the joint in a testing machine is given by its stiffness
        length, mass = log_uniform(rng, 1e-5, 1e-2), log_uniform(rng, 1e5, 1e9)
        mass /= (2 * np.pi * hz) ** 2
    plant = draw_plant(rng, law, zeta, strong=strong)
    response = RESPONSES[rng.integers(3)]
    return Specimen(law, strong, plant, hz, per, noise, bits, response, mass, length)


def _law(rng: Rng, laws: tuple[str, ...]) -> str:
    """Draw a law; a fifth of the time from all laws."""
    if laws == COMMON and rng.random() < 0.2:
        return str(rng.choice(list(LAWS)))
    return str(rng.choice(laws))


# ------------------------------------------------------------------------------------------ decays
def decay(rng: Rng, one: Specimen, level: float = 1.0) -> Drawn:
    """Draw a free decay after a blow or a release, half of the time with a second distant mode."""
    z = one.zeta
    enough = np.exp(-2 * np.pi * 3 * z) / SEEN  # noise at which three periods are clearly above it
    one = replace(one, noise=min(one.noise, enough * level))
    periods = np.clip(log_uniform(rng, 3, 40) / (2 * np.pi * z), *PERIODS)
    count = int(min(periods * one.per_period, SAMPLES))
    released = rng.random() < 0.3
    # A blow hits a joint without force, a release begins with a loaded joint.
    first = (level, 0.0) if released else (0.0, level)
    motion = free_decay(one.plant, count, one.per_period, first, pulled=released)
    ahead = 0 if rng.random() < 0.5 else int(rng.uniform(0, 1) * one.per_period)
    width = rng.uniform(0.25, 0.5) if z < 0.02 else rng.uniform(0.5, 0.7)
    facts = {"released": released, "time_constants": count / one.per_period * 2 * np.pi * z}
    band = (one.hz * (1 - width), one.hz * (1 + width))
    drawn = one.record("decay", motion[:3, ahead:], None, level, band=band, facts=facts)
    share = rng.uniform(0.0, 0.5) if rng.random() < 0.5 else 0.0
    return _with_mode_elsewhere(rng, drawn, share)


def _with_mode_elsewhere(rng: Rng, drawn: Drawn, share: float) -> Drawn:
    """Add the decay of a mode with 1.9 to 3 times the frequency."""
    hz = rng.uniform(1.9, 3) * drawn.hz
    if share == 0 or hz > 0.45 * drawn.fs:
        return drawn
    zeta, t = log_uniform(rng, 5e-4, 2e-2), np.arange(len(drawn.x)) / drawn.fs
    phase = rng.uniform(0, 2 * np.pi)
    other = np.exp(-2 * np.pi * hz * zeta * t) * np.cos(2 * np.pi * hz * t + phase)
    added = drawn.with_x(drawn.x + share * np.max(np.abs(drawn.x)) * other)
    facts = {**drawn.facts, "elsewhere": {"hz": hz, "zeta": zeta, "share": share}}
    return replace(added, facts=facts)


# ---------------------------------------------------------------------------------- driven records
def sweep_drive(
    count: int, per_period: float, substeps: int, ends: tuple[float, float], fade: float,
    *, linear: bool,
) -> Array:  # fmt: skip
    """Return a sweep of amplitude one at every half step; `ends` are over the natural frequency."""
    size = 2 * substeps * (count - 1) + 1
    s = np.arange(size) / (size - 1)
    cycles = (count - 1) / per_period
    first, last = ends
    if linear:
        phase = cycles * (first * s + (last - first) / 2 * s**2)
    else:
        phase = cycles * first * np.expm1(np.log(last / first) * s) / np.log(last / first)
    return np.sin(2 * np.pi * phase) * np.minimum(1, np.minimum(s, 1 - s) / fade)


def sweep(rng: Rng, one: Specimen, level: float = 1.0) -> Drawn:
    """Draw a sweep up or down through the resonance, linear or exponential, from rest."""
    z = one.zeta
    low = 1 - rng.uniform(0.12, 0.35) - min(2 * z, 0.3)
    high = 1 + rng.uniform(0.12, 0.35) + min(2 * z, 0.4)
    cycles = np.clip(log_uniform(rng, 0.5, 10) * (high - low) / z, 100, 2500)
    ends = (low, high) if rng.random() < 0.6 else (high, low)
    linear = bool(rng.random() < 0.7)
    count, substeps = int(min(cycles * one.per_period, SAMPLES)), substeps_of(one.per_period)
    drive = sweep_drive(count, one.per_period, substeps, ends, 0.02, linear=linear)
    facts = {"ends": ends, "linear": linear, "cycles": count / one.per_period}
    return driven(one, "sweep", drive, (low, high), level, facts=facts)


def driven(
    one: Specimen, kind: str, drive: Array, span: tuple[float, float], level: float, *,
    skip: int = 0, facts: Mapping[str, Any],
) -> Drawn:  # fmt: skip
    """Drive a plant so that it moves by about `level`; record from sample `skip` on.

    Args:
        one: The structure.
        kind: Kind of the record.
        drive: Drive in any unit, at every half step.
        span: Range of the drive's frequencies, relative to the natural one.
        level: Largest displacement to be reached, within a factor of 1.4.
        skip: Number of samples before the record begins.
        facts: Everything that was drawn for the drive.
    """
    substeps = substeps_of(one.per_period)
    size = 2 * one.zeta * level  # found by trial, because the response depends on the law
    for _ in range(4):
        motion = march(one.plant, size * drive, one.rate, substeps)
        top = float(np.max(np.abs(motion[0]))) / level
        if 0.7 < top < 1.4:
            break
        size /= top
    u = size * drive[:: 2 * substeps]
    low, high = span
    return one.record(
        kind, motion[:3, skip:], u[skip:], level, band=(low * one.hz, high * one.hz),
        facts={**facts, "force": size},
    )  # fmt: skip


def _band_of(rng: Rng, zeta: float, per_period: float) -> tuple[float, float]:
    low = 1 - rng.uniform(0.15, 0.6) - min(2 * zeta, 0.2)
    high = 1 + rng.uniform(0.15, 0.8) + min(2 * zeta, 0.4)
    return max(low, 0.15), min(high, 0.4 * per_period)


def band_limited(
    rng: Rng, size: int, cycles: float, span: tuple[float, float], *, flat: bool
) -> Array:
    """Return periodic noise between two frequencies, with a standard deviation of one.

    Args:
        rng: Source of random numbers.
        size: Number of values.
        cycles: Number of natural periods in them.
        span: Range of frequencies, relative to the natural one.
        flat: Whether all lines have one size, as in a multisine, or random sizes.
    """
    lines = np.arange(size // 2 + 1)
    inside = (lines >= span[0] * cycles) & (lines <= span[1] * cycles) & (lines > 0)
    count = int(inside.sum())
    values = np.exp(2j * np.pi * rng.random(count))
    if not flat:
        values = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    spectrum = np.zeros(size // 2 + 1, complex)
    spectrum[inside] = values
    x = np.fft.irfft(spectrum, size)
    return x / x.std()


def multisine(rng: Rng, one: Specimen, level: float = 1.0) -> Drawn:
    """Draw several periods of a multisine, recorded after its transient."""
    span = _band_of(rng, one.zeta, one.per_period)
    substeps, periods = substeps_of(one.per_period), int(rng.integers(3, 9))
    # The distance of lines is at most a quarter of the half-power width.
    length = int(min(rng.uniform(4, 8) / (2 * one.zeta) * one.per_period, SAMPLES / periods))
    waiting = int(np.ceil(8 / (2 * np.pi * one.zeta) * one.per_period / length))
    period = band_limited(rng, 2 * substeps * length, length / one.per_period, span, flat=True)
    drive = np.append(np.tile(period, waiting + periods), period[0])
    facts = {"periods": periods, "period": length, "span": span}
    drawn = driven(one, "multisine", drive, span, level, skip=waiting * length, facts=facts)
    count = periods * length
    return replace(drawn, channels={name: x[:count] for name, x in drawn.channels.items()})


def noise(rng: Rng, one: Specimen, level: float = 1.0) -> Drawn:
    """Draw the response to band-limited noise."""
    span = _band_of(rng, one.zeta, one.per_period)
    # length in units of 1 / bandwidth: records of fewer than some hundred show little
    cycles = rng.uniform(100, 600) / (2 * one.zeta)
    count = int(min(cycles * one.per_period, SAMPLES / 2))
    fine = 2 * substeps_of(one.per_period)
    # The noise repeats itself only after the record ends, at a length that suits the transform.
    size = scipy.fft.next_fast_len(fine * count)
    cycles = size / fine / one.per_period
    drive = band_limited(rng, size, cycles, span, flat=False)[: fine * (count - 1) + 1]
    return driven(one, "noise", drive, span, level, facts={"span": span})


# ------------------------------------------------------------------------------------------- loops
def loop(rng: Rng, one: Specimen, level: float = 1.0) -> Drawn:
    """Draw slow cycles of a testing machine at several amplitudes: displacement and force.

    The machine measures the stiffness omega_n^2 mass; it is too slow for forces of viscous damping.
    """
    amplitudes = np.sort(rng.uniform(0.1, 1.0, int(rng.integers(2, 6))))
    amplitudes *= level / amplitudes[-1]
    cycles, per_cycle = int(rng.integers(2, 5)), int(rng.uniform(80, 600))
    seconds = log_uniform(rng, 0.5, 60.0)  # duration of a cycle
    plant, steps = replace(one.plant, zeta=0.0), substeps_of(per_cycle)
    count = cycles * per_cycle * len(amplitudes) + 1
    # number of cycles so far
    turns = np.arange(2 * steps * (count - 1) + 1) / (2 * steps * per_cycle)
    size = amplitudes[np.minimum((turns / cycles).astype(int), len(amplitudes) - 1)]
    sine = bool(rng.random() < 0.5)
    y = size * (np.sin(2 * np.pi * turns) if sine else 4 * np.abs((turns + 0.25) % 1 - 0.5) - 1)
    y = y if sine else -y
    fs = per_cycle / seconds
    pace = fs / (2 * np.pi * one.hz)  # samples per unit of the plant's time
    force = force_along(plant, y, np.gradient(y, 1 / (2 * steps * pace)), pace, steps)
    length, stiffness = one.length, one.mass * (2 * np.pi * one.hz) ** 2
    channels = {
        "displacement": length * y[:: 2 * steps], "restoring_force": stiffness * length * force
    }  # fmt: skip
    facts = {
        "amplitudes": (length * amplitudes).tolist(), "cycles": cycles, "per_cycle": per_cycle,
        "seconds": seconds, "sine": sine, "stiffness": stiffness,
    }  # fmt: skip
    return Drawn(
        "loop", one.law, one.strong, plant, one.hz, length, one.mass, one.per_period, fs,
        "displacement", channels, (0.0, fs / 2), level, min(one.noise, 0.03), one.bits, facts,
    )  # fmt: skip


KINDS: dict[str, Callable[..., Drawn]] = {
    "decay": decay, "sweep": sweep, "multisine": multisine, "noise": noise, "loop": loop,
}  # fmt: skip


# ---------------------------------------------------------------------------------------- recorders
def digitised(rng: Rng, x: Array, noise: float, bits: int) -> Array:
    """Add white noise, and round to the steps of a converter with at least half its range used."""
    largest = np.max(np.abs(x)) or 1.0
    x = x + noise * largest * rng.standard_normal(len(x))
    if bits >= 24:
        return x
    step = np.max(np.abs(x)) * rng.uniform(1.0, 2.0) / 2 ** (bits - 1)
    return np.round(x / step) * step


def recorded(rng: Rng, drawn: Drawn) -> Drawn:
    """Return a record as its recorder writes it; the drive has less noise than the response."""
    found = {}
    for role, x in drawn.channels.items():
        is_response = x is drawn.x
        noise = drawn.noise if is_response else min(drawn.noise, 1e-3) * rng.uniform(0, 1)
        found[role] = digitised(rng, x, noise, drawn.bits if is_response else 16)
    return replace(drawn, channels=found)


def sound(rng: Rng, kind: str, choice: Choice = ANY) -> Drawn:
    """Draw a sound record; draw again if its motion grows without bound."""
    while True:
        try:
            return recorded(rng, KINDS[kind](rng, specimen(rng, kind, choice)))
        except FloatingPointError:
            continue
