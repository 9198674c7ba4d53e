"""Faults of records: the kinds of record that can have each, its size, and how jbw should name it.

A fault of the structure or the sensors happens before noise and rounding, one of the recorder after
them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from .plants import Rng, log_uniform
from .records import KINDS, Choice, Drawn, recorded, specimen
from .simulator import Array, Plant, march, substeps_of

Edit = Callable[[Rng, Drawn], Drawn]
DRIVEN = ("sweep", "multisine", "noise")
TIMED = ("decay", *DRIVEN)
EVERY = (*TIMED, "loop")


@dataclass(frozen=True)
class Fault:
    """A fault that is put into a record.

    Attributes:
        name: Name in words.
        edit: Function that returns the record with the fault and its `size`.
        kinds: Kinds of record that can have it.
        named: Pattern of sentences that name it; any other sentence is wrong.
        before: Whether it happens before noise and rounding.
        choice: What a record needs for the fault to be visible.
    """

    name: str
    edit: Edit
    kinds: tuple[str, ...]
    named: re.Pattern[str]
    before: bool
    choice: Choice


# The fault is visible to a careful reader: neither noise nor damping hides it.
VISIBLE = Choice(zeta=(5e-4, 0.03), noise=(1e-5, 2e-2), bits=10)
OF_SWEEPS = replace(VISIBLE, zeta=(1e-3, 0.03))
IN_NOISE = Choice(zeta=(5e-4, 0.03), noise=(1e-3, 2e-2), bits=14)
FAULTS: dict[str, Fault] = {}


def _fault(
    kinds: tuple[str, ...], named: str, *, before: bool = False, choice: Choice = VISIBLE
) -> Callable[[Edit], Edit]:
    """Register a function as a fault under its own name."""

    def enter(edit: Edit) -> Edit:
        name = edit.__name__.replace("_", " ")
        FAULTS[name] = Fault(name, edit, kinds, re.compile(named, re.I), before, choice)
        return edit

    return enter


def _said(drawn: Drawn, x: Array, size: str) -> Drawn:
    return replace(drawn.with_x(x), size=size)


def _time(drawn: Drawn) -> Array:
    return np.arange(len(drawn.x)) / drawn.fs


def _largest(drawn: Drawn) -> float:
    return float(np.max(np.abs(drawn.x)))


def _place(rng: Rng, drawn: Drawn, low: float = 0.3, high: float = 1.5) -> int:
    """Draw a sample where the motion is large: early in a decay, else near the peak."""
    count = len(drawn.x)
    if drawn.kind == "decay":
        constant = drawn.per_period / (2 * np.pi * drawn.zeta)
        least, most = 6 * drawn.per_period, count - 3 * drawn.per_period - 2
        return int(min(max(rng.uniform(low, high) * constant, least), most))
    if drawn.kind == "sweep":
        peak = int(np.argmax(np.abs(drawn.x)))
        return int(np.clip(peak + rng.uniform(-0.12, 0.12) * count, 0.1 * count, 0.9 * count))
    return int(rng.uniform(0.2, 0.8) * count)


# ------------------------------------------------------------------------------- samples themselves
@_fault(
    EVERY,
    r"held|hold|repeated for|repeats (each|every|sample)|equal (neighbou?rs|samples)|lower rate|"
    r"same value",
)
def held_samples(rng: Rng, drawn: Drawn) -> Drawn:
    """Hold every second or third sample."""
    k = int(rng.integers(2, 4))
    return _said(drawn, drawn.x[np.arange(len(drawn.x)) // k * k], f"each sample {k} times")


GAP = r"gap|zero|missing|drop-?out|constant|stands still|no signal|NaN|not finite|finite|held"


@_fault(EVERY, GAP)
def gap_of_zeros(rng: Rng, drawn: Drawn) -> Drawn:
    """Replace a part of the record by zeros."""
    x, at = drawn.x.copy(), _place(rng, drawn, 0.2)
    period = drawn.facts["per_cycle"] / 10 if drawn.kind == "loop" else drawn.per_period
    count = int(rng.uniform(0.6, 10) * period)
    x[at : at + count] = 0.0
    return _said(drawn, x, f"{count} zeros from sample {at} on")


@_fault(EVERY, GAP)
def gap_of_nan(rng: Rng, drawn: Drawn) -> Drawn:
    """Replace a part of the record by NaN."""
    x, at = drawn.x.copy(), _place(rng, drawn, 0.2)
    count = int(rng.uniform(1, 50))
    x[at : at + count] = np.nan
    return _said(drawn, x, f"{count} NaN from sample {at} on")


@_fault(EVERY, r"clip|overload|range|saturat|flat")
def clipped(rng: Rng, drawn: Drawn) -> Drawn:
    """Clip the record at 40 to 80 % of its largest value."""
    top = rng.uniform(0.4, 0.8) * _largest(drawn)
    return _said(drawn, np.clip(drawn.x, -top, top), f"at {top / _largest(drawn):.0%}")


@_fault(("decay", "sweep", "noise"), r"drop-?out|spike|outlier|impuls|glitch|toward zero|gap")
def laser_drop_outs(rng: Rng, drawn: Drawn) -> Drawn:
    """Make a laser lose its signal for a few samples, many times."""
    x, count = drawn.x.copy(), int(rng.uniform(15, 60))
    for at in rng.integers(0, len(x) - 8, count):
        x[at : at + int(rng.integers(2, 6))] *= rng.uniform(0, 0.2)
    return _said(drawn, x, f"{count} drop-outs")


# --------------------------------------------------------------------------------------------- time
LOST = (
    r"lost|missing samples|samples (are )?(missing|cut)|cut out|block|"
    r"second (hit|blow|impact)|another place|jump"
)


@_fault(("decay",), LOST)
def lost_samples(rng: Rng, drawn: Drawn) -> Drawn:
    """Remove samples over a part of a period."""
    at, count = _place(rng, drawn, 0.4), max(int(rng.uniform(0.1, 0.4) * drawn.per_period), 2)
    x = np.delete(drawn.x, slice(at, at + count))
    return _said(drawn, x, f"{count} samples at {at}: {count / drawn.per_period:.2f} periods")


@_fault(("sweep", "noise"), LOST + r"|delay|clock|late|lag", choice=OF_SWEEPS)
def lost_block(rng: Rng, drawn: Drawn) -> Drawn:
    """Remove samples of the response alone, not a whole number of periods."""
    periods = rng.integers(0, 3) + rng.uniform(0.15, 0.85)
    at, count = _place(rng, drawn), max(int(periods * drawn.per_period), 2)
    x = np.delete(drawn.x, slice(at, at + count))
    return _said(drawn, x, f"{count} samples at {at}: {count / drawn.per_period:.2f} periods")


@_fault(
    DRIVEN,
    r"delay|late|lag|before (the|its) (input|drive)|start(ed|s)? (apart|later)|lead",
    choice=OF_SWEEPS,
)
def delay(rng: Rng, drawn: Drawn) -> Drawn:
    """Delay the response relative to the drive."""
    count = max(int(rng.uniform(0.08, 0.4) * drawn.per_period), 1)
    return _said(drawn, drawn.x[count:], f"{count} samples: {count / drawn.per_period:.2f} periods")


@_fault(("sweep", "noise"), r"clock|drift apart|run apart|ppm", choice=OF_SWEEPS)
def clock_error(rng: Rng, drawn: Drawn) -> Drawn:
    """Make the two clocks differ by 0.3 to 1 period over the record."""
    n, periods = np.arange(len(drawn.x)), rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)
    rate = periods * drawn.per_period / len(n)
    at = n * (1 + rate)
    x = np.interp(at[at <= n[-1]], n, drawn.x)
    return _said(drawn, x, f"{1e6 * rate:.0f} ppm: {periods:.2f} periods")


@_fault(
    ("decay", "sweep"),
    r"independent values|ends? (early|before)|short|stops|not (pass|reach)|outside",
)
def early_stop(rng: Rng, drawn: Drawn) -> Drawn:
    """End the record too early: before the end of the decay, or before the resonance."""
    count = len(drawn.x)
    if drawn.kind == "decay":
        stop = max(int(rng.uniform(0.05, 0.2) * drawn.per_period / (2 * np.pi * drawn.zeta)), 20)
    else:
        stop = int(np.argmax(np.abs(drawn.x)) - rng.uniform(0.02, 0.1) * count)
    stop = max(stop, 16)
    return _said(drawn, drawn.x[:stop], f"after {stop} of {count} samples")


# ------------------------------------------------------------------------------- what is measured
@_fault(
    ("decay",), r"second (hit|blow|impact)|struck|hit again|lost|double|rebound|rises", before=True
)
def second_blow(rng: Rng, drawn: Drawn) -> Drawn:
    """Add a second blow of the hammer."""
    x, at = drawn.x.copy(), _place(rng, drawn, 0.5, 2)
    share = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1)
    x[at:] += share * drawn.x[: len(x) - at]
    return _said(drawn, x, f"{share:.0%} of the first at sample {at}")


@_fault(("decay",), r"before|pre-?trigger|begin|quiet|settle|starts", before=True)
def quiet_before_the_blow(rng: Rng, drawn: Drawn) -> Drawn:
    """Add quiet samples before the blow."""
    count = int(rng.uniform(0.5, 3) * drawn.per_period / (2 * np.pi * drawn.zeta))
    x = np.concatenate([np.zeros(count), drawn.x])
    return _said(drawn, x, f"{count} samples")


@_fault(("decay",), r"driven|does not fall|steady|shaker|settle|tone", before=True)
def still_driven(rng: Rng, drawn: Drawn) -> Drawn:
    """Add steady motion before the shaker is switched off."""
    count = int(rng.uniform(1, 4) * drawn.per_period / (2 * np.pi * drawn.zeta))
    t = np.arange(-count, 0) / drawn.per_period * rng.uniform(0.985, 1.015)
    tone = _largest(drawn) * np.cos(2 * np.pi * t + rng.uniform(0, 6))
    return _said(drawn, np.concatenate([tone, drawn.x]), f"{count} samples")


@_fault(TIMED, r"line|hum|mains|tone|does not decay|steady", before=True)
def steady_line(rng: Rng, drawn: Drawn) -> Drawn:
    """Add a steady sine in the band, with 2 to 10 % of the largest value."""
    hz = rng.uniform(0.8, 1.2) * drawn.hz if drawn.kind == "decay" else rng.uniform(*drawn.band)
    share = rng.uniform(0.02, 0.1)
    line = share * _largest(drawn) * np.sin(2 * np.pi * hz * _time(drawn) + rng.uniform(0, 6))
    return _said(drawn, drawn.x + line, f"{share:.0%} at {hz:.6g} Hz")


@_fault(("decay",), r"window", choice=IN_NOISE)
def exponential_window(rng: Rng, drawn: Drawn) -> Drawn:
    """Multiply the record by an analyser's exponential window."""
    tau = rng.uniform(0.4, 1.5) * len(drawn.x) / drawn.fs / 3
    x = drawn.x * np.exp(-_time(drawn) / tau)
    return _said(drawn, x, f"time constant {tau:.4g} s")


@_fault(
    ("decay", "sweep", "noise"),
    r"second mode|two modes|another mode|close|beat|modes",
    before=True,
    choice=OF_SWEEPS,
)
def close_second_mode(rng: Rng, drawn: Drawn) -> Drawn:
    """Add a linear mode at a distance of some damping ratios."""
    off = rng.choice([-1.0, 1.0]) * rng.uniform(4, 12) * drawn.zeta
    zeta = drawn.zeta * rng.uniform(0.6, 1.6)
    share = rng.uniform(0.3, 1.0)
    if drawn.kind == "decay":
        w, t = 2 * np.pi * drawn.hz, _time(drawn)
        other = np.exp(-zeta * w * t) * np.cos((1 + off) * w * t + rng.uniform(0, 6))
    else:
        other = _response(Plant(omega_n=1 + off, zeta=zeta), drawn)
    other *= share * _largest(drawn) / np.max(np.abs(other))
    size = f"{share:.0%} at {(1 + off) * drawn.hz:.6g} Hz, damping {zeta:.3%}"
    return _said(drawn, drawn.x + other, size)


def _response(plant: Plant, drawn: Drawn) -> Array:
    """Return a mode's response to the force of a record, in an arbitrary unit."""
    sub = substeps_of(drawn.per_period)
    u = drawn.channels["force"]
    n = np.arange(len(u))
    # The force is linear between samples, which is accurate enough for an additional linear mode.
    fine = np.interp(np.arange(2 * sub * (len(u) - 1) + 1) / (2 * sub), n, u)
    return march(plant, fine, drawn.per_period / (2 * np.pi), sub)[drawn.order]


@_fault(("sweep", "noise", "multisine", "loop"), r"sign|polarity|turned|opposite|-1|energy")
def polarity(rng: Rng, drawn: Drawn) -> Drawn:
    """Reverse the sign of the response, as by a reversed cable."""
    return _said(drawn, -drawn.x, "sign changed")


@_fault(("decay",), r"drift|offset|trend|baseline|mean|zero line", before=True)
def offset_and_drift(rng: Rng, drawn: Drawn) -> Drawn:
    """Add an offset and a slow drift of the sensor."""
    size, t = _largest(drawn), _time(drawn)
    offset, drift = rng.uniform(0.5, 5), rng.uniform(0.5, 3)
    x = drawn.x + size * (offset + drift * t / t[-1])
    return _said(drawn, x, f"offset {offset:.1f}, drift {drift:.1f} of the largest value")


@_fault(
    ("sweep",),
    r"drop|force.*noise|noise.*(force|drive|input)|drive.*(noise|small|weak)|bias",
    before=True,
    choice=replace(OF_SWEEPS, zeta=(1e-3, 1e-2)),
)
def force_drop_off(rng: Rng, drawn: Drawn) -> Drawn:
    """Drive by a shaker whose force falls to its noise at resonance."""
    mu = rng.uniform(0.3, 1.0)
    shaker = replace(
        drawn.plant, armature_mass=mu, armature_stiffness=mu * rng.uniform(0.2, 0.8),
        armature_damping=mu * rng.uniform(0.1, 0.5),
    )  # fmt: skip
    sub, n = substeps_of(drawn.per_period), np.arange(len(drawn.x))
    scale = drawn.mass * drawn.length * (2 * np.pi * drawn.hz) ** 2
    u = drawn.channels["force"] / scale / (2 * drawn.zeta)
    fine = np.interp(np.arange(2 * sub * (len(u) - 1) + 1) / (2 * sub), n, u)
    # The same motion needs a force for the damping and inertia of structure and armature.
    fine *= 2 * drawn.zeta + shaker.armature_damping
    y, v, a, *_ = march(shaker, fine, drawn.per_period / (2 * np.pi), sub)
    drive = fine[:: 2 * sub]
    k, c = shaker.armature_stiffness, shaker.armature_damping
    force = (drive - mu * a - c * v - k * y) * scale
    spread = rng.uniform(1e-2, 3e-2)
    force = force + spread * np.max(np.abs(force)) * rng.standard_normal(len(force))
    w = 2 * np.pi * drawn.hz
    x = (y, v, a)[drawn.order] * drawn.length * w**drawn.order
    changed = drawn.with_channels(force=force, **{drawn.response: x})
    return replace(
        changed, top=float(np.max(np.abs(y))),
        size=f"armature {mu:.0%} of the mass, force noise {spread:.1%} of its largest",
    )  # fmt: skip


@_fault(
    ("sweep", "noise"), r"base|support|absolute|foundation|table", before=True, choice=OF_SWEEPS
)
def base_motion(rng: Rng, drawn: Drawn) -> Drawn:
    """State the acceleration of a moving base as force, and record absolute acceleration."""
    w = 2 * np.pi * drawn.hz
    u = drawn.channels["force"] / (drawn.mass * drawn.length * w**2)
    relative = _of_plant(drawn)  # Under -u the motion of an odd law only changes its sign.
    x = (u - relative) * drawn.length * w**2
    # The base's acceleration [m/s^2] is written as if it were newtons.
    changed = replace(drawn, response="acceleration")
    channels = {"force": u * drawn.length * w**2, "acceleration": x}
    return replace(changed, channels=channels, size="force is the table's acceleration")


def _of_plant(drawn: Drawn) -> Array:
    """Return the acceleration of the plant under its force, in the plant's units."""
    if drawn.response == "acceleration":
        return drawn.x / (drawn.length * (2 * np.pi * drawn.hz) ** 2)
    sub, n = substeps_of(drawn.per_period), np.arange(len(drawn.x))
    u = drawn.channels["force"] / (drawn.mass * drawn.length * (2 * np.pi * drawn.hz) ** 2)
    fine = np.interp(np.arange(2 * sub * (len(u) - 1) + 1) / (2 * sub), n, u)
    return march(drawn.plant, fine, drawn.per_period / (2 * np.pi), sub)[2]


@_fault(
    ("sweep", "loop"),
    r"high-?pass|charge|coupl|amplifier|time constant|phase lead|leads",
    before=True,
    choice=OF_SWEEPS,
)
def high_pass(rng: Rng, drawn: Drawn) -> Drawn:
    """Apply a charge amplifier's high-pass to the response (for loops: to the force)."""
    if drawn.kind == "loop":
        tau = rng.uniform(0.3, 2.0) * drawn.facts["seconds"]
    else:
        tau = 1 / (2 * np.pi * drawn.hz * rng.uniform(0.05, 0.4))
    b, a = scipy.signal.bilinear([tau, 0], [tau, 1.0], drawn.fs)
    return _said(drawn, scipy.signal.lfilter(b, a, drawn.x), f"time constant {tau:.4g} s")


# -------------------------------------------------------------------------------------------- loops
@_fault(("loop",), r"slip|jump|step|gauge", before=True)
def gauge_slip(rng: Rng, drawn: Drawn) -> Drawn:
    """Make the displacement gauge slip once."""
    y = drawn.channels["displacement"].copy()
    at, share = (
        int(rng.uniform(0.3, 0.9) * len(y)),
        rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.3),
    )
    y[at:] += share * np.max(np.abs(y))
    changed = drawn.with_channels(displacement=y)
    return replace(changed, size=f"{share:.0%} of the largest displacement at sample {at}")


@_fault(("loop",), r"late|lag|delay|behind", before=True)
def force_late(rng: Rng, drawn: Drawn) -> Drawn:
    """Record the force after a filter that the displacement does not have."""
    lag = log_uniform(rng, 0.01, 0.06) * drawn.facts["seconds"]
    t = _time(drawn)
    return _said(drawn, np.interp(t - lag, t, drawn.x), f"{lag:.4g} s")


@_fault(("loop",), r"drift|offset|zero|close|centre", before=True)
def load_cell_drift(rng: Rng, drawn: Drawn) -> Drawn:
    """Add a drift of the load cell's zero."""
    t, share = _time(drawn), rng.uniform(0.03, 0.15)
    offset = rng.uniform(0.0, 0.15)
    x = drawn.x + _largest(drawn) * (offset + share * t / t[-1])
    return _said(drawn, x, f"offset {offset:.0%}, drift {share:.0%}")


def spoilt(rng: Rng, clean: Drawn, fault: Fault) -> Drawn:
    """Return a perfect record with a fault, as its recorder would write it."""
    drawn = recorded(rng, fault.edit(rng, clean) if fault.before else clean)
    drawn = drawn if fault.before else fault.edit(rng, drawn)
    return replace(drawn, fault=fault.name)


def mishandled(rng: Rng, kind: str, name: str, choice: Choice | None = None) -> Drawn:
    """Draw a record of a kind, with the fault of a given name."""
    fault = FAULTS[name]
    while True:
        try:
            one = specimen(rng, kind, choice or fault.choice)
            return spoilt(rng, KINDS[kind](rng, one), fault)
        except FloatingPointError:
            continue
