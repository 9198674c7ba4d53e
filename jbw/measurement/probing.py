"""The third-order kernel measured with a single tone, corrected for the source's harmonics."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from jbw.errors import DataError
from jbw.measurement.channels import Complexes, Reals, channel, same_length, sampling
from jbw.measurement.harmonics import NOISE_FLOOR, Harmonics, harmonics
from jbw.quantities import Motion
from jbw.report.messages import reading as messages

# number of points per period; a peak between two points is missed by at most 3e-7 n^2
PERIOD_POINTS = 4096
LARGE_SOURCE = 0.1


@dataclass(frozen=True)
class ThirdOrder:
    """The third-order kernel at three equal frequencies, with one complex amplitude per repeat."""

    omega: float  # probing frequency [rad/s]
    h3: Complexes  # H3 = 4 Y(3 omega) / A^3 [m per unit^3]
    amplitude: Complexes  # A, the input's first harmonic including its phase [unit]
    u_3: Complexes  # the input's third harmonic [unit]; NaN if not measured
    y_1: Complexes  # Y(omega) [m]
    # Y(3 omega), after subtraction of the source's contribution if that was possible [m]
    y_3: Complexes
    y_peak: Reals  # largest displacement in a period [m]
    # "removed", "measured" (not removed, since `h1_3omega` was not given) or "unmeasured"
    source: str
    source_ratio: float  # largest |H1(3 omega) U(3 omega)| / |Y_3|; NaN if unknown
    std: float  # standard deviation of `h3` over repeats, per real component; NaN with one repeat
    std_expected: float  # the part of `std` that the noise of the records explains
    # covariance of (Re, Im) of the mean of `h3`, from the variation over repeats if possible
    covariance: Reals
    above_noise: bool  # whether |mean Y_3| exceeds three standard errors, so that it may be fitted
    notes: tuple[str, ...]  # remarks that a reader of the result must know

    @property
    def mean(self) -> complex:
        """The mean of H3 over the repeats [m per unit^3]."""
        return complex(self.h3.mean())


def third_order_kernel(
    u: ArrayLike | None,
    y: ArrayLike,
    fs: float,
    omega: float,
    *,
    amplitude: complex | None = None,
    h1_3omega: complex | None = None,
    response: Motion = "displacement",
    delay: float = 0.0,
    start: float = 0.0,
    num_harmonics: int = 7,
    also: Sequence[float] = (),
) -> ThirdOrder:
    r"""Estimate the third-order kernel at three equal frequencies from a test with one tone.

    $$H_3(\omega) = \frac{4\,[Y(3\omega) - H_1(3\omega)\,U(3\omega)]}{A^3}, \qquad A = U(\omega)$$

    A is complex, so that the phase is relative to the input. The second term is the response to the
    source's own third harmonic; at -60 dB it is as large as that of the joint. "H3" depends on the
    amplitude, because Bouc-Wen is not analytic: report `y_peak` with it.

    Args:
        u: Measured input, shape (time,) or (repeat, time); None if it was not measured.
        y: Response, of the same shape.
        fs: Sampling frequency [Hz].
        omega: Probing frequency [rad/s].
        amplitude: Demanded input amplitude, used only when `u` is None [unit].
        h1_3omega: Receptance at 3 omega, per unit of `u` [m per unit].
        response: Kind of `y`: displacement, velocity or acceleration.
        delay: Lag of the response channel behind the input channel [s].
        start: Time to discard at the start [s].
        num_harmonics: Highest fitted order, limited by the sampling frequency; at least 3.
        also: Angular frequencies that are present in addition to the tone [rad/s].

    Raises:
        DataError: A channel is invalid, 3 omega exceeds Nyquist, or the input amplitude is missing.

    Reference:
        Eqs. (29), (30).

    Examples:
        A third harmonic of 4 um under a tone of 2 N/kg gives the kernel 4 * 4e-6 / 2^3:

        >>> import jbw
        >>> import numpy as np
        >>> t = np.arange(8192) / 1024.0
        >>> u, y = 2.0 * np.cos(40.0 * t), 1e-3 * np.cos(40.0 * t) + 4e-6 * np.cos(120.0 * t)
        >>> kernel = jbw.third_order_kernel(u, y, fs=1024.0, omega=40.0)
        >>> print(f"{kernel.mean.real:.3g}")
        2e-06
    """
    y = np.atleast_2d(channel(y, "y"))
    num_harmonics = max(3, min(num_harmonics, int(0.999 * np.pi * sampling(fs) / omega)))
    fitted = partial(
        harmonics, fs=fs, omega=omega, num_harmonics=num_harmonics, start=start, also=also
    )
    filtered = fitted(y, response=response, delay=delay)
    y_1, y_3 = filtered.amplitudes[:, 0], filtered.amplitudes[:, 2]
    variance = filtered.variance[:, 2]
    if u is None:
        u_1, u_3 = _demanded(amplitude, len(y))
        relative = np.zeros(len(y))
    else:
        u = np.atleast_2d(channel(u, "u"))
        same_length(u=u, y=y)
        source = fitted(u)
        _require_tone(source, omega)
        u_1, u_3 = source.amplitudes[:, 0], source.amplitudes[:, 2]
        relative = 9 * source.variance[:, 0] / np.abs(u_1) ** 2
        if h1_3omega is not None:
            y_3 = y_3 - h1_3omega * u_3
            variance = variance + np.abs(h1_3omega) ** 2 * source.variance[:, 2]
    part = np.nan if h1_3omega is None else h1_3omega
    ratio = float(np.max(np.abs(part * u_3) / np.abs(y_3)))
    handling = "unmeasured" if u is None else "measured" if h1_3omega is None else "removed"
    h3 = 4 * y_3 / u_1**3
    expected = np.mean(16 * variance / np.abs(u_1) ** 6 + relative * np.abs(h3) ** 2) / 2
    std = float(np.sqrt(np.var(h3, ddof=1) / 2)) if len(h3) > 1 else np.nan
    scatter = np.var(y_3, ddof=1) / 2 if len(y_3) > 1 else 0.0
    # The error has two estimates: from the noise of the records, and from the variation of repeats.
    standard_error = np.sqrt(max(np.mean(variance) / 2, scatter) / len(y_3))
    above = bool(np.abs(y_3.mean()) > NOISE_FLOOR * standard_error)
    return ThirdOrder(
        omega=float(omega), h3=h3, amplitude=u_1, u_3=u_3, y_1=y_1, y_3=y_3,
        y_peak=peak_displacement(filtered), source=handling, source_ratio=ratio, std=std,
        std_expected=float(np.sqrt(expected)),
        covariance=np.eye(2) * (std**2 if len(h3) > 1 else expected) / len(h3),
        above_noise=above, notes=_notes(omega, handling, ratio, above),
    )  # fmt: skip


def _demanded(amplitude: complex | None, num_repeats: int) -> tuple[Complexes, Complexes]:
    """Return an unmeasured input's harmonics 1 and 3: the requested amplitude, and NaN."""
    if amplitude is None or not abs(amplitude) > 0:
        raise DataError(
            "The input's amplitude must be known, but neither `u` nor `amplitude` was given.",
            why="H3 is Y(3 omega) divided by the cube of the input's amplitude.",
            remedy="Measure the input with the response, or give the demanded `amplitude`.",
        )
    return np.full(num_repeats, complex(amplitude)), np.full(num_repeats, complex(np.nan))


def _require_tone(source: Harmonics, omega: float) -> None:
    """Raise a DataError if the input has no tone at the stated frequency."""
    if np.any(np.abs(source.amplitudes[:, 0]) ** 2 <= NOISE_FLOOR**2 * source.variance[:, 0]):
        raise DataError(
            f"Channel `u` contains no tone at {omega / (2 * np.pi):.4g} Hz above the noise of `u`.",
            remedy="Check `omega` (rad/s) and which channel is the input.",
        )


def peak_displacement(filtered: Harmonics) -> Reals:
    """Return the largest displacement in a period, from its harmonics, shape (...) [m]."""
    n = np.arange(1, filtered.amplitudes.shape[-1] + 1)
    turn = np.exp(2j * np.pi * np.outer(n, np.arange(PERIOD_POINTS) / PERIOD_POINTS))
    return np.max(np.abs((filtered.amplitudes @ turn).real), axis=-1)


def _notes(omega: float, handling: str, ratio: float, above: bool) -> tuple[str, ...]:
    f = f"{omega / (2 * np.pi):.4g} Hz"
    notes = []
    if handling == "unmeasured":
        notes.append(messages.input_unknown(f))
    if handling == "measured":
        notes.append(messages.harmonic_kept(f))
    if ratio > LARGE_SOURCE:
        notes.append(messages.large_harmonic(f, ratio))
    if not above:
        notes.append(messages.harmonic_in_noise(f))
    return tuple(notes)
