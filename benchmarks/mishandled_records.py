"""Are mishandled records named by `jbw check`, and sound ones left alone?

Sound records come from closed forms and from an integrator that shares nothing with jbw: decays
whose damping and frequency go with their size, sweeps and noise of a mode with a Bouc-Wen joint by
RK4. Frequency (0.2 Hz to 15 kHz), damping, noise, length, sampling and band are drawn at random.
Each mutation is made once to its own sound record. A record is silent where `jbw check` says
nothing of it; a sound one is doubted falsely where it says anything. Every record is looked at once
more with its time scaled by 1e-3 to 1e5: what is said must be the same.

    python benchmarks/mishandled_records.py [--calls 200] [--seed 0] [--only WORD] [--json FILE]

Seeds 0 to 2 served to choose thresholds; a figure to quote comes from another one.
"""

import json
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import timing

from jbw.campaign.check import findings
from jbw.campaign.tables import TestSpec
from jbw.measurement.files.assemble import unwindowed
from jbw.measurement.records import Record

Samples = np.ndarray[Any, np.dtype[np.float64]]
SUB_STEPS = 3  # of RK4 between two samples
SEED_APART = 100_000  # records of one seed, at the most


class Made(NamedTuple):
    """A record, its kind, and what a mutation needs to know of it."""

    kind: str
    fs: float
    channels: dict[str, Samples]
    hz: float  # natural frequency
    decay_s: float  # time constant of a decay
    band: tuple[float, float]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sound_decay(rng: np.random.Generator) -> Made:
    """dA/dt = -(a A + b A^2) in closed form, frequency f (1 - c A), a mode elsewhere, noise."""
    hz, zeta = log_uniform(rng, 0.2, 15e3), log_uniform(rng, 5e-4, 1e-2)
    a = zeta * 2 * np.pi * hz
    b, softening = a * rng.uniform(0.01, 2), rng.uniform(0, 0.02)
    fs = hz * rng.uniform(8, 40)
    size = min(int(rng.uniform(4, 12) / a * fs), 400_000)
    t = np.arange(size) / fs
    amplitude = a / ((a + b) * np.exp(a * t) - b)
    area = np.log((a + b - b * np.exp(-a * t)) / a) / b
    x = amplitude * np.cos(2 * np.pi * hz * (t - softening * area) + rng.uniform(0, 6))
    other = rng.uniform(1.8, 3) * hz
    rate = 2 * np.pi * other * log_uniform(rng, 5e-4, 2e-2)
    x += rng.uniform(0, 1) * np.exp(-rate * t) * np.cos(2 * np.pi * other * t)
    x += log_uniform(rng, 1e-5, 1e-2) * rng.standard_normal(size)
    width = rng.uniform(0.15, 0.5)
    band = (hz * (1 - width), hz * (1 + width))
    return Made("decay", fs, {"velocity": 1e-2 * x}, hz, 1 / a, band)


def bouc_wen(u: Samples, per_period: float, zeta: float, share: float, reach: float) -> Samples:
    """Displacement and velocity under u, both by RK4, of a mode of 1 rad/s: shape (2, time)."""
    step = 2 * np.pi / per_period / SUB_STEPS
    stiffness, damping, opening, closing = 1 - share, 2 * zeta, 0.4 * reach, 0.6 * reach

    def rate(y: float, v: float, z: float, force: float) -> tuple[float, float, float]:
        dz = share * v - opening * abs(v) * z - closing * v * abs(z)
        return v, force - damping * v - stiffness * y - z, dz

    y = v = z = 0.0
    found = np.zeros((2, len(u)))
    forces = [*u.tolist(), float(u[-1])]
    for i, force in enumerate(forces[:-1]):
        found[0, i], found[1, i] = y, v
        slope = (forces[i + 1] - force) / SUB_STEPS
        for j in range(SUB_STEPS):
            begin = force + slope * j
            a1, b1, c1 = rate(y, v, z, begin)
            h = step / 2
            a2, b2, c2 = rate(y + h * a1, v + h * b1, z + h * c1, begin + slope / 2)
            a3, b3, c3 = rate(y + h * a2, v + h * b2, z + h * c2, begin + slope / 2)
            a4, b4, c4 = rate(y + step * a3, v + step * b3, z + step * c3, begin + slope)
            y += step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            v += step / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
            z += step / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return found


def sound_sweep(rng: np.random.Generator) -> Made:
    """A sweep up or down through the resonance, its ends faded, and the response from rest."""
    per_period, periods, zeta = rng.uniform(12, 24), rng.uniform(300, 800), rng.uniform(0.002, 0.01)
    size = int(periods * per_period)
    s = np.arange(size) / size
    ends = (rng.uniform(0.75, 0.85), rng.uniform(1.15, 1.3))
    first, last = ends if rng.random() < 0.5 else ends[::-1]
    u = np.sin(2 * np.pi * periods * (first * s + (last - first) / 2 * s**2))
    u *= np.minimum(1, np.minimum(s, 1 - s) / 0.02)
    return _driven("sweep", u, per_period, zeta, rng)


def sound_noise(rng: np.random.Generator) -> Made:
    """White noise in a band about the resonance, for long."""
    per_period, zeta = rng.uniform(8, 16), rng.uniform(0.004, 0.01)
    size = int(rng.uniform(1500, 2500) * per_period)
    spectrum = np.fft.rfft(rng.standard_normal(size))
    cycles = np.fft.rfftfreq(size) * per_period  # in natural frequencies
    spectrum[(cycles < 0.5) | (cycles > 2.0)] = 0
    u = np.fft.irfft(spectrum, size)
    return _driven("noise", u / u.std(), per_period, zeta, rng)


def _driven(
    kind: str, u: Samples, per_period: float, zeta: float, rng: np.random.Generator
) -> Made:
    hz = log_uniform(rng, 0.2, 15e3)
    # At resonance the mode moves by up to 1 / (2 zeta): there (delta + gamma) Y is below 0.3.
    y, v = bouc_wen(u, per_period, zeta, rng.uniform(0.0, 0.05), rng.uniform(0.0, 0.6) * zeta)
    role, x = (("displacement", y), ("velocity", v))[rng.integers(2)]
    noise = log_uniform(rng, 3e-4, 1e-2)
    x = x + noise * np.std(x) * rng.standard_normal(len(x))
    omega = 2 * np.pi * hz
    # A force of 1 N on 1 kg moves a mode of omega by 1 / omega^2.
    x = x / omega if role == "velocity" else x / omega**2
    channels = {"force": u, role: x}
    return Made(kind, per_period * hz, channels, hz, 1 / (zeta * omega), (0.7 * hz, 1.4 * hz))


def response_of(made: Made) -> str:
    """The role of the response."""
    return next(role for role in made.channels if role != "force")


def with_response(made: Made, x: Samples) -> Made:
    """The record with another response, its drive cut to the same length."""
    channels = {role: values[: len(x)] for role, values in made.channels.items()}
    return made._replace(channels={**channels, response_of(made): x[: len(channels_of(channels))]})


def channels_of(channels: dict[str, Samples]) -> Samples:
    """Any of the channels."""
    return next(iter(channels.values()))


def noise_of(x: Samples) -> float:
    """Size of the noise at the end of a decay."""
    return float(np.std(x[-max(len(x) // 20, 8) :]))


def late(made: Made, rng: np.random.Generator) -> Made:
    """Quiet before the blow."""
    x = made.channels["velocity"]
    count = int(rng.uniform(0.3, 3) * made.decay_s * made.fs)
    quiet = noise_of(x) * rng.standard_normal(count)
    return made._replace(channels={"velocity": np.concatenate([quiet, x])})


def driven(made: Made, rng: np.random.Generator) -> Made:
    """A shaker that goes on for a while."""
    x = made.channels["velocity"]
    t = np.arange(-int(rng.uniform(1, 4) * made.decay_s * made.fs), 0) / made.fs
    tone = np.abs(x).max() * np.cos(2 * np.pi * made.hz * rng.uniform(0.985, 1.015) * t)
    tone += noise_of(x) * rng.standard_normal(len(t))
    return made._replace(channels={"velocity": np.concatenate([tone, x])})


def doubled(made: Made, rng: np.random.Generator) -> Made:
    """A second blow."""
    x = made.channels["velocity"].copy()
    later = int(rng.uniform(0.5, 2) * made.decay_s * made.fs)
    x[later:] += rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1) * x[: len(x) - later]
    return made._replace(channels={"velocity": x})


def hummed(made: Made, rng: np.random.Generator) -> Made:
    """A line in the band, of 2 to 10 % of the first amplitude."""
    x = made.channels["velocity"]
    hz = rng.uniform(*made.band)
    line = np.sin(2 * np.pi * hz * np.arange(len(x)) / made.fs + rng.uniform(0, 6))
    return made._replace(channels={"velocity": x + rng.uniform(0.02, 0.1) * np.abs(x).max() * line})


def windowed(made: Made, rng: np.random.Generator) -> Made:
    """The exponential window of an analyser."""
    x = made.channels["velocity"]
    tau = rng.uniform(0.5, 3) * made.decay_s * made.fs
    return made._replace(channels={"velocity": x / unwindowed(np.ones_like(x), tau, 0)})


def cut(made: Made, rng: np.random.Generator) -> Made:
    """Samples lost: of a decay all, of a sweep or noise those of the response alone."""
    x = made.channels[response_of(made)]
    at = int(rng.uniform(0.25, 0.75) * len(x))
    if made.kind == "decay":
        at = int(rng.uniform(0.5, 1.5) * made.decay_s * made.fs)
    lost = max(int(rng.uniform(0.1, 0.4) * made.fs / made.hz), 1)
    return with_response(made, np.concatenate([x[:at], x[at + lost :]]))


def filled(made: Made, rng: np.random.Generator) -> Made:
    """Zeros in the place of lost samples."""
    x = made.channels[response_of(made)].copy()
    at = int(rng.uniform(0.1, 0.4) * len(x))
    x[at : at + int(rng.uniform(0.5, 20) * made.fs / made.hz)] = 0.0
    return with_response(made, x)


def clipped(made: Made, rng: np.random.Generator) -> Made:
    """A range that was too small."""
    x = made.channels[response_of(made)]
    top = rng.uniform(0.4, 0.8) * np.abs(x).max()
    return with_response(made, np.clip(x, -top, top))


def turned(made: Made, rng: np.random.Generator) -> Made:
    """The polarity of the response."""
    return with_response(made, -made.channels[response_of(made)])


def shifted(made: Made, rng: np.random.Generator) -> Made:
    """Start times that differ by a part of a period."""
    x = made.channels[response_of(made)]
    count = max(int(rng.uniform(0.1, 0.4) * made.fs / made.hz), 2)
    return with_response(made, x[count:])


def clocked(made: Made, rng: np.random.Generator) -> Made:
    """Two clocks that run apart by a quarter of a period to a period along the record."""
    x = made.channels[response_of(made)]
    n = np.arange(len(x))
    rate = rng.choice([-1.0, 1.0]) * rng.uniform(0.25, 1.0) * made.fs / made.hz / len(x)
    return with_response(made, np.interp(n * (1 + rate), n, x))


SOUND: dict[str, Callable[[np.random.Generator], Made]] = {
    "decay": sound_decay, "sweep": sound_sweep, "noise": sound_noise,
}  # fmt: skip
MUTATIONS: dict[str, tuple[Callable[[Made, np.random.Generator], Made], tuple[str, ...]]] = {
    "begins before the blow": (late, ("decay",)),
    "still driven": (driven, ("decay",)),
    "second blow": (doubled, ("decay",)),
    "hum in the band": (hummed, ("decay",)),
    "exponential window": (windowed, ("decay",)),
    "samples cut out": (cut, ("decay", "sweep", "noise")),
    "zeros filled in": (filled, ("decay", "sweep", "noise")),
    "clipped": (clipped, ("decay", "sweep", "noise")),
    "turned": (turned, ("noise",)),
    "shifted": (shifted, ("sweep", "noise")),
    "clocks run apart": (clocked, ("sweep", "noise")),
}


class Said(NamedTuple):
    """What a check says of a record, and whether it says as much of the same in another time."""

    number: int  # of the record's random draws
    what: list[str]
    scales: bool


def said_and_scaled(number: int, made: Made, rng: np.random.Generator) -> Said:
    """What is said of a record, and of the same with its time scaled."""
    scale = log_uniform(rng, 1e-3, 1e5)
    low, high = made.band
    scaled = made._replace(fs=made.fs / scale, band=(low / scale, high / scale))
    what, again = said_of(made), said_of(scaled)
    return Said(number, what, len(what) == len(again))


def said_of(made: Made) -> list[str]:
    """What a check says of a record."""
    role = response_of(made)
    units = {"force": "N", "displacement": "m", "velocity": "m/s"}
    spec = TestSpec(
        kind=made.kind, files=("a.h5",), channels={name: name for name in made.channels},
        units={name: units[name] for name in made.channels}, band=made.band,
    )  # fmt: skip
    # A size that a structure may have, whatever its frequency.
    size = {"velocity": 1e-1, "displacement": 1e-3}[role] / np.abs(made.channels[role]).max()
    channels = {name: x * size if name == role else x for name, x in made.channels.items()}
    record = Record(made.fs, channels, units, "a.h5", {"path": "a.h5"})
    return [fault.what for fault in findings(record, spec)]


def rows(number: int, seed: int, only: str) -> Iterator[dict[str, Any]]:
    """Sound records and mutations by kind: how many, and how many were doubted."""
    draw = SEED_APART * seed

    def row(
        kind: str, what: str, count: int, make: Callable[[np.random.Generator], Made]
    ) -> dict[str, Any]:
        nonlocal draw
        numbers = range(draw + 1, draw + 1 + count)
        draw += count
        if only not in what:
            return {}
        said = []
        for one in numbers:
            rng = np.random.default_rng(one)
            said.append(said_and_scaled(one, make(rng), rng))
        return {
            "record": kind, "what": what, "number": count,
            "doubted": sum(bool(one.what) for one in said),
            "unscaled": sum(not one.scales for one in said),
            "silent": [one.number for one in said if not one.what],
            "said": {one.number: one.what for one in said if one.what},
        }  # fmt: skip

    for kind, sound in SOUND.items():
        count = number // len(SOUND) + (kind == "decay") * (number % len(SOUND))
        yield row(kind, "sound", count, sound)
    each = max(number // len(MUTATIONS), 1)
    for name, (mutate, kinds) in MUTATIONS.items():
        for kind in kinds:

            def mutated(rng: np.random.Generator, kind=kind, mutate=mutate) -> Made:
                return mutate(SOUND[kind](rng), rng)

            yield row(kind, name, -(-each // len(kinds)), mutated)


def main() -> None:
    """Print the table."""
    parser = timing.options(__doc__, calls=200)
    parser.add_argument("--seed", type=int, default=0, help="of the records and what is done")
    parser.add_argument("--only", default="", help="mutations whose name holds this word")
    chosen = parser.parse_args()
    print("| record | what was done | number | named | silent | otherwise in another time |")
    print("| --- | --- | --- | --- | --- | --- |")
    found = []
    for row in filter(None, rows(chosen.calls, chosen.seed, chosen.only)):
        found.append(row)
        silent = "-" if row["what"] == "sound" else row["number"] - row["doubted"]
        cells = (row["record"], row["what"], row["number"], row["doubted"], silent, row["unscaled"])
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
    sound = [row for row in found if row["what"] == "sound"]
    done = [row for row in found if row["what"] != "sound"]
    doubted, every = (sum(row[key] for row in sound) for key in ("doubted", "number"))
    silent = sum(row["number"] - row["doubted"] for row in done)
    print(f"\nSound records doubted: {doubted} of {every}. Mishandled ones not named: {silent} of "
          f"{sum(row['number'] for row in done)}.")  # fmt: skip
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
