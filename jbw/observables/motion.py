"""Motion of the joint under a measured input, and the samples that it is compared with."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Array, Float

from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.response import Response, simulate
from jbw.quantities import LETTER_OF


def advance(samples: np.ndarray, delay: float, fs: float) -> np.ndarray:
    r"""Undo a channel's delay by the phase of its spectrum.

    $$x(t + \tau) \leftrightarrow X(\omega)\,e^{+j\omega\tau}$$

    Args:
        samples: Samples of one channel, at rest at both ends.
        delay: Lag tau behind the input channel [s].
        fs: Sampling frequency [Hz].

    Returns:
        The samples, `delay` seconds earlier.
    """
    if delay == 0.0:
        return samples
    omega = 2 * np.pi * np.fft.rfftfreq(len(samples), 1 / fs)
    return np.fft.irfft(np.fft.rfft(samples) * np.exp(1j * omega * delay), len(samples))


def response_to(
    theta: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    *,
    laws: tuple[str, ...] = ("bouc_wen",),
    response: str = "velocity",
    substeps: int = 2,
    periodic: bool = False,
) -> Float[Array, " time"]:
    """Response of the joint to a measured input, from rest or steady.

    Args:
        theta: The joint's parameters and `gain` [N/kg per unit of the input].
        source: Measured input [unit of the input].
        fs: Sampling frequency [Hz].
        laws: Names of the laws of the joint.
        response: displacement, velocity or acceleration.
        substeps: Steps of the solver between samples.
        periodic: Whether the input is one period of a steady test.

    Returns:
        Displacement [m], velocity [m/s] or acceleration [m/s^2].

    Reference:
        Eqs. (1), (2).
    """
    motion = motion_under(theta, source, fs, laws=laws, substeps=substeps, periodic=periodic)
    return getattr(motion, LETTER_OF[response])


def motion_under(
    theta: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    *,
    laws: tuple[str, ...] = ("bouc_wen",),
    substeps: int = 2,
    periodic: bool = False,
) -> Response:
    """Motion of the joint under a measured input, as of `response_to`.

    The input between its samples is the band-limited one that the sampling saw.
    """
    return simulate(
        oscillator_of(theta, laws),
        theta["gain"] * source,
        fs,
        hold="band_limited",
        substeps=substeps,
        periodic=periodic,
    )
