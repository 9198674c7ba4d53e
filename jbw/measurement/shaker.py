r"""A shaker's attachment, identified from its voltage, its force and the drive point's motion.

$$F = g\,e^{-j\omega\tau}\,V - (k_a + j\omega c_a - \omega^2 m_a)\,X_d$$

is linear in (g, g tau, m_a, c_a, k_a) if the delay is short: least squares over the lines of one
level determine them. The lines of one mode do not: its force is a sum of the same columns,
$F = (\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega)\,X_d / \phi^2$, so that gain and attachment
trade for each other. The band has to contain several modes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jbw.errors import DataError
from jbw.measurement.channels import (
    Complexes,
    Reals,
    channel,
    lines_within,
    passband,
    same_length,
    sampling,
)
from jbw.quantities import Motion, derivative_order

DEGENERATE = 1e7  # largest condition number of the columns, each scaled to unit size
NAMES = ("gain", "delay", "mass", "damping", "stiffness")


@dataclass(frozen=True)
class ShakerFit:
    """A shaker as a gain and a linear attachment at the drive point, at one level."""

    gain: float  # force per voltage g [N/V]; negative if the polarity is inverted
    delay: float  # delay tau of the force relative to the voltage [s]
    mass: float  # m_a [kg]
    damping: float  # c_a [N s/m]
    stiffness: float  # stiffness k_a [N/m]
    # standard deviations of gain, delay, mass, damping and stiffness, from the residual of
    # independent lines
    std: Float[np.ndarray, " 5"]
    leftover: float  # residual of the force's spectral lines, divided by their magnitude
    leftover_gain: float  # residual divided by magnitude for a fit of only a constant gain
    num_lines: int
    band_hz: tuple[float, float]


def fit_attachment(
    voltage: ArrayLike,
    force: ArrayLike,
    response: ArrayLike,
    fs: float,
    band: tuple[float, float],
    *,
    kind: Motion = "acceleration",
) -> ShakerFit:
    """Fit gain, delay and attachment of a shaker by least squares over a band's lines.

    Args:
        voltage: Voltage at the shaker, shape (time,) [V], from rest to rest or of whole periods.
        force: Measured force of the shaker [N].
        response: Measured motion of the drive point [m, m/s or m/s^2].
        fs: Sampling frequency [Hz].
        band: Lowest and highest frequency [Hz]; it must contain several modes to separate mass and
            stiffness.
        kind: Kind of `response`: displacement, velocity or acceleration.

    Raises:
        DataError: A sample is NaN, lengths differ, values are too few, or the voltage is constant.

    Examples:
        A shaker of 5 N/V with an armature of 0.2 kg on a spring of 2000 N/m drives two modes:

        >>> import jbw
        >>> import numpy as np
        >>> voltage = np.random.default_rng(0).standard_normal(4096)
        >>> V, s = np.fft.rfft(voltage), 2j * np.pi * np.fft.rfftfreq(4096, 1 / 1024.0)
        >>> H = 1 / (s**2 + s + 118.0**2) + 1 / (s**2 + 3 * s + 360.0**2)
        >>> F = 5.0 * V / (1 + H * (0.2 * s**2 + 2000.0))
        >>> force, y = np.fft.irfft(F), np.fft.irfft(H * F)
        >>> found = jbw.fit_attachment(voltage, force, y, 1024.0, (10.0, 80.0), kind="displacement")
        >>> print(f"{found.gain:.2f} N/V, {found.mass:.3f} kg, {found.stiffness:.0f} N/m")
        5.00 N/V, 0.200 kg, 2000 N/m
    """
    v, f, x = (channel(samples, name) for samples, name in (
        (voltage, "voltage"), (force, "force"), (response, "response")))  # fmt: skip
    same_length(voltage=v, force=f, response=x)
    if v.ndim != 1:
        raise DataError(f"Channel `voltage` must be one record, but its shape is {v.shape}.")
    if np.ptp(v) == 0 or np.ptp(x) == 0:
        dead = "voltage" if np.ptp(v) == 0 else "response"
        raise DataError(
            f"Channel `{dead}` is constant, so that the attachment cannot be determined.",
            remedy=f"Check the sensor of `{dead}`, or give another channel.",
        )
    freq = np.fft.rfftfreq(len(v), 1 / sampling(fs))
    low, high = passband(band, fs / 2)
    keep = (freq > 0) & lines_within(freq, (low, high))
    if 2 * keep.sum() <= len(NAMES):
        raise DataError(
            f"The band {low:g} to {high:g} Hz must contain {len(NAMES) // 2 + 1} lines or more for "
            f"{len(NAMES)} unknowns, but contains {keep.sum()}.",
            remedy="Widen the band, or give a longer record.",
        )
    jw = 2j * np.pi * freq[keep]
    fed, force_lines, moved = (np.fft.rfft(samples - samples.mean())[keep] for samples in (v, f, x))
    moved = moved / jw ** derivative_order(kind)
    columns = np.column_stack([fed, -jw * fed, -(jw**2) * moved, -jw * moved, -moved])
    coefficients, inverse, residual = _solved(columns, force_lines)
    if np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) > DEGENERATE:
        raise DataError(
            f"The band {low:g} to {high:g} Hz must contain a second mode, but the voltage is a sum "
            "of the drive point's motion, velocity and acceleration, which shows a single mode.",
            why="With a single mode, gain and attachment cannot be separated.",
            remedy="Widen the band, or give a record that drives several modes.",
        )
    residual_of_gain = _solved(columns[:, :1], force_lines)[2]
    gain = coefficients[0]
    variance = np.sum(np.abs(residual) ** 2) / (2 * len(residual) - len(coefficients))
    std = np.sqrt(variance * np.diag(inverse)) / np.array([1, abs(gain), 1, 1, 1])
    size = np.linalg.norm(force_lines)
    return ShakerFit(
        float(gain), float(coefficients[1] / gain), *map(float, coefficients[2:]), std=std,
        leftover=float(np.linalg.norm(residual) / size),
        leftover_gain=float(np.linalg.norm(residual_of_gain) / size), num_lines=int(keep.sum()),
        band_hz=(float(freq[keep][0]), float(freq[keep][-1])),
    )  # fmt: skip


def _solved(columns: Complexes, target: Complexes) -> tuple[Reals, Reals, Complexes]:
    """Return real coefficients, the inverse normal matrix, and the residual of the lines."""
    scale = np.linalg.norm(columns, axis=0)
    real = np.concatenate([np.real(columns / scale), np.imag(columns / scale)])
    coefficients = (
        np.linalg.lstsq(real, np.concatenate([np.real(target), np.imag(target)]))[0] / scale
    )
    inverse = np.linalg.pinv(real.T @ real) / np.outer(scale, scale)
    return coefficients, inverse, target - columns @ coefficients
