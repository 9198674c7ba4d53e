"""Shocks: classical pulses and measured records, the response, and response spectra."""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from jbw.errors import ConfigError
from jbw.forced.equivalent import EquivalentMotion, Values
from jbw.oscillator.response import simulate
from jbw.units import measured, plain

# number of samples in a pulse; linear interpolation then loses 5e-6 of a half-sine's area
SAMPLES = 400
PER_CYCLE = 64  # smallest number of samples per cycle of the mode
# Cycles of the mode that are simulated after the pulse; an oscillator with Q = 10 has then decayed
# to 5e-4.
CYCLES = 24
RAMP = 0.1  # duration of a trapezoid's rise, and of its fall, divided by that of the pulse

SHAPES: dict[str, Callable[[Values], Values]] = {
    "half-sine": lambda x: np.sin(np.pi * x),
    "sawtooth": lambda x: x,  # The peak of this pulse is at its end.
    "trapezoid": lambda x: np.minimum(np.minimum(x, 1.0 - x) / RAMP, 1.0),
}


@dataclass(frozen=True, eq=False)
class Pulse:
    """A shock as samples of a source that starts from rest.

    Attributes:
        samples: Values in `unit`, the first at t = 0.
        fs: Sampling rate [Hz].
        unit: Unit of the samples, such as `m/s^2`.

    Examples:
        A half-sine of 20 g and 11 ms changes the velocity by 2 / pi * peak * duration:

        >>> import jbw
        >>> import numpy as np
        >>> half_sine = 196.2 * np.sin(np.pi * np.linspace(0.0, 1.0, 111))
        >>> pulse = jbw.Pulse(half_sine, fs=1e4, unit="m/s^2")
        >>> print(f"{1e3 * pulse.duration:.0f} ms, {pulse.samples.sum() / pulse.fs:.3f} m/s")
        11 ms, 1.374 m/s
    """

    samples: Values
    fs: float
    unit: str

    @property
    def duration(self) -> float:
        """The duration of the pulse [s]."""
        return (len(self.samples) - 1) / self.fs


def classical_pulse(
    peak: float, duration: float, unit: str, shape: str = "half-sine", fs: float = 0.0
) -> Pulse:
    """Return a half-sine pulse, a terminal-peak sawtooth or a trapezoid.

    Args:
        peak: Largest value, in `unit`.
        duration: Duration [s].
        unit: Unit of the source.
        shape: `half-sine`, `sawtooth` or `trapezoid`, whose ramps are 10 % of the duration each.
        fs: Least sampling rate [Hz].

    Raises:
        ConfigError: Another shape, or a peak or duration that is not positive.
    """
    if shape not in SHAPES:
        raise ConfigError(
            f"Argument `shape` must be one of {', '.join(SHAPES)}, but is {shape!r}.",
            remedy="Give a shock of another shape as a measured record.",
        )
    if not (0.0 < peak < np.inf and 0.0 < duration < np.inf):
        raise ConfigError(
            f"A shock must have a positive peak and duration, but has {peak:g} {unit} and "
            f"{duration:g} s.",
            remedy="Write the shock as `20g,11ms`.",
        )
    count = max(SAMPLES, int(np.ceil(duration * fs)))
    samples = peak * SHAPES[shape](np.linspace(0.0, 1.0, count + 1))
    # At a jump to zero, the last sample is the mean of both values, which preserves the area.
    samples[-1] *= 0.5
    return Pulse(samples, count / duration, unit)


def pulse_of(text: str, fs: float = 0.0) -> Pulse:
    """Return the pulse that a text states, such as `20g,11ms` or `50 m/s^2, 6 ms, sawtooth`.

    Raises:
        ConfigError: The text does not state a peak with a unit and a duration.
    """
    parts = [part.strip() for part in text.split(",")]
    match = [re.fullmatch(r"([-+.\deE]+?)\s*([A-Za-z].*)", part) for part in parts[:2]]
    units = [measured(plain(found[2])) if found else None for found in match]
    second = measured("s")
    # pyright: ignore[reportOptionalSubscript]
    if len(parts) not in (2, 3) or None in units or not second or units[1][1] != second[1]:  # pyright: ignore[reportOptionalSubscript]
        raise ConfigError(
            f"A shock must state its peak and its duration with units, but is {text!r}.",
            remedy="Write the shock as `20g,11ms`, or with its shape as `20g,11ms,sawtooth`.",
        )
    values = [_number(found[1], text) for found in match if found]
    unit = next(
        # pyright: ignore[reportOptionalSubscript]
        (name for name in ("m/s^2", "N", "V") if measured(name)[1] == units[0][1]),  # pyright: ignore[reportOptionalSubscript]
        plain(match[0][2]),  # pyright: ignore[reportOptionalSubscript]
    )
    # pyright: ignore[reportOptionalSubscript]
    peak, duration = (value * factor[0] for value, factor in zip(values, units, strict=True))  # pyright: ignore[reportOptionalSubscript]
    return classical_pulse(peak, duration, unit, *parts[2:], fs=fs)


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError as cause:
        raise ConfigError(
            f"A shock must state a number, but {text!r} of {whole!r} is not a number.",
            remedy="Write the shock as `20g,11ms`.",
        ) from cause


@dataclass(frozen=True, eq=False)
class ShockResponse:
    """The motion of every draw during and after a shock.

    Attributes:
        t: Time [s].
        y: Relative displacement, of shape (draw, time) [m].
        v: Relative velocity [m/s].
        a: Relative acceleration [m/s^2].
        source: The source at these times, in its unit.
        fs: Sampling rate [Hz].
    """

    t: Values
    y: Values
    v: Values
    a: Values
    source: Values
    fs: float


def shock_response(motion: EquivalentMotion, pulse: Pulse, share: Values) -> ShockResponse:
    """Return the motion, from rest, during a shock and for some cycles after the shock.

    Args:
        motion: The joint.
        pulse: The shock; a record that is sampled too coarsely is interpolated linearly.
        share: Force per unit mass and per unit of the source, of shape (draw, 1).
    """
    frequency = float(np.max(motion.omega_n)) / (2.0 * np.pi)
    finer = max(1, int(np.ceil(PER_CYCLE * frequency / pulse.fs)))
    count = finer * (len(pulse.samples) - 1)
    grid = np.arange(count + 1) / finer
    samples = np.interp(grid, np.arange(len(pulse.samples)), pulse.samples)
    fs = finer * pulse.fs
    lowest = float(np.min(motion.omega_n)) / (2.0 * np.pi)
    after = int(np.ceil(CYCLES * fs / lowest))
    source = np.concatenate([samples, np.zeros(after)])
    found = simulate(motion.joint, share * source, fs)
    y, v, a = (np.asarray(part) for part in (found.y, found.v, found.a))
    return ShockResponse(np.arange(len(source)) / fs, y, v, a, source, fs)


def shock_spectrum(
    acceleration: Values, fs: float, freq_hz: Values, quality: float = 10.0
) -> Values:
    r"""Return the maximax absolute acceleration of oscillators on a moving base.

    The ramp-invariant filter is used, exact for an acceleration that is linear between its samples:

    $$H(z) = \frac{1 - \sigma + 2 e^{-A}(\sigma' - \cos B) z^{-1} + (e^{-2A} - \sigma) z^{-2}}
      {1 - 2 e^{-A}\cos B\,z^{-1} + e^{-2A} z^{-2}}$$

    with $A = \omega / (2 Q f_s)$, $B = (\omega/f_s)\sqrt{1 - 1/4Q^2}$, $\sigma' = \sin B / B$ and
    $\sigma = e^{-A}\sigma'$. The record is extended by one cycle of each oscillator.

    Args:
        acceleration: Acceleration of the base on its last axis [m/s^2].
        fs: Sampling rate [Hz]; ten times the highest frequency causes errors of 5 % of a peak.
        freq_hz: Natural frequencies [Hz].
        quality: Q of the oscillators, above 1/2; infinite without damping.

    Returns:
        Shape (..., frequency), in the unit of the acceleration.

    Raises:
        ConfigError: A frequency at or above half the sampling rate, or a Q of 1/2 or less.

    Reference:
        ISO 18431-4:2007, 5.2, absolute acceleration.

    Examples:
        A half-sine of 1 m/s^2 moves an undamped oscillator by at most 1.77 m/s^2:

        >>> import jbw
        >>> import numpy as np
        >>> half_sine = np.sin(np.pi * np.linspace(0.0, 1.0, 1001))
        >>> hz = np.linspace(10.0, 500.0, 99)
        >>> print(f"{jbw.shock_spectrum(half_sine, 1e5, hz, quality=np.inf).max():.2f}")
        1.77
    """
    freq_hz = np.asarray(freq_hz, float)
    if np.any(freq_hz <= 0) or np.any(freq_hz >= 0.5 * fs) or not quality > 0.5:
        raise ConfigError(
            "A shock response spectrum must have frequencies between 0 and half the sampling rate "
            f"({0.5 * fs:g} Hz) and Q above 1/2, but reaches {np.max(freq_hz):g} Hz with Q = "
            f"{quality:g}.",
            remedy="Lower the highest frequency, or sample the record faster.",
        )
    spectrum = []
    for frequency in freq_hz:
        angle = 2.0 * np.pi * frequency / fs
        a, b = 0.5 * angle / quality, angle * np.sqrt(1.0 - 0.25 / quality**2)
        decay, ratio = np.exp(-a), np.sin(b) / b
        numerator = [
            1.0 - decay * ratio, 2.0 * decay * (ratio - np.cos(b)), decay * (decay - ratio)
        ]  # fmt: skip
        denominator = [1.0, -2.0 * decay * np.cos(b), decay**2]
        tail = np.zeros((*acceleration.shape[:-1], int(np.ceil(fs / frequency))))
        motion = lfilter(numerator, denominator, np.concatenate([acceleration, tail], -1))
        spectrum.append(np.max(np.abs(motion), -1))
    return np.stack(spectrum, -1)
