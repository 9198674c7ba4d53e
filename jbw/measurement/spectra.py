"""Frequency response functions (FRFs) from records, with the variance of the estimate."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, signal

from jbw.errors import ConfigError, DataError, did_you_mean
from jbw.measurement.channels import (
    Complexes,
    Reals,
    channel,
    lines_within,
    passband,
    same_length,
    sampling,
)
from jbw.measurement.records import RESPONSES, Record, Test
from jbw.quantities import Motion, derivative_order

Window = Literal["hann", "boxcar"]

# Half-power width of |W(f)|^2 in bins of 1 / (window length), the distance at which two lines are
# distinct.
RESOLUTION_BINS = {"hann": 1.44, "boxcar": 0.89}
# If a peak is narrower than this multiple of the resolution, its damping is estimated at least 5 %
# too high.
COARSE = 4.0
DEFAULT_SEGMENTS = 16


@dataclass(frozen=True)
class FRF:
    """An estimated receptance (displacement per input) with the settings of the estimate."""

    freq: Reals  # frequencies without zero [Hz]
    # receptance, displacement per unit of input; convention exp(+j omega t)
    h: Complexes
    coherence: Reals  # ordinary coherence, 0 to 1
    # E|error|^2 of `h`: the *sum* of the variances of its real and imaginary parts, which are equal
    variance: Reals
    input_spectrum: Reals  # one-sided power spectral density [unit^2/Hz]
    output_spectrum: Reals  # density of the measured response
    # number of independent averages that is equivalent to the overlapping segments
    num_averages: float
    num_segments: int  # segments of each repeat
    num_repeats: int  # number of averaged repeats
    nperseg: int  # samples per segment
    noverlap: int  # samples shared by neighbouring segments
    fs: float  # sampling frequency [Hz]
    window: Window
    estimator: Literal["h1", "h2"]
    response: Motion  # kind of measured response: displacement, velocity or acceleration

    @property
    def omega(self) -> Reals:
        """The angular frequencies [rad/s]."""
        return 2 * np.pi * self.freq

    @property
    def window_s(self) -> float:
        """The duration of a segment [s]."""
        return self.nperseg / self.fs

    @property
    def resolution_hz(self) -> float:
        """The half-power width of the window's own spectral peak [Hz]."""
        return RESOLUTION_BINS[self.window] / self.window_s


@overload
def frf(
    u: ArrayLike,
    y: ArrayLike,
    fs: float,
    *,
    response: Motion = "displacement",
    window: Window = "hann",
    window_s: float | None = None,
    nperseg: int | None = None,
    overlap: float | None = None,
    estimator: Literal["h1", "h2"] = "h1",
    delay: float = 0.0,
    band: tuple[float, float] | None = None,
) -> FRF: ...


@overload
def frf(
    record: Record | Sequence[Record] | Test,
    source: str,
    response: str,
    /,
    *,
    window: Window = "hann",
    window_s: float | None = None,
    nperseg: int | None = None,
    overlap: float | None = None,
    estimator: Literal["h1", "h2"] = "h1",
    delay: float | None = None,
    band: tuple[float, float] | None = None,
) -> FRF: ...


def frf(
    u: Any,
    y: Any,
    fs: Any,
    *,
    response: Motion = "displacement",
    window: Window = "hann",
    window_s: float | None = None,
    nperseg: int | None = None,
    overlap: float | None = None,
    estimator: Literal["h1", "h2"] = "h1",
    delay: float | None = None,
    band: tuple[float, float] | None = None,
) -> FRF:
    r"""Estimate the receptance of a record by averaging over segments (Welch).

    $$H_1 = S_{uy}/S_{uu}, \quad H_2 = S_{yy}/S_{yu}, \quad
      \mathrm{E}|\Delta H|^2 = \frac{1-\gamma^2}{\gamma^2}\,\frac{|H|^2}{K-1}$$

    with the coherence gamma^2 and K effective averages. The mean of each segment is removed, and
    frequency zero is left out. A velocity is divided by j omega, an acceleration by -omega^2, and a
    lagging response channel is advanced by exp(+j omega delay).

    With random input the window smears a narrow peak: H1 tends to the receptance convolved with
    |W|^2, whatever the number of averages; `line_fit` accounts for it. For a periodic input, use
    `window="boxcar"` with a whole number of periods per segment.

    For measured records, give channel names in place of samples: `jbw.frf(record, "force",
    "velocity")`, where `record` is a `Record`, several of equal length, or a `Test` with its
    repeats.

    Args:
        u: Input, shape (time,) or (repeat, time); repeats are averaged together.
        y: Response, of the same shape [m, m/s or m/s^2].
        fs: Sampling frequency [Hz].
        response: Kind of `y`: displacement, velocity or acceleration; a named channel implies it.
        window: hann for random records, boxcar for periodic ones.
        window_s: Duration of a segment [s]; by default the longest that gives 16 segments.
        nperseg: Number of samples per segment, in place of `window_s`.
        overlap: Shared part of neighbouring segments; by default 0.5 with hann, else 0.
        estimator: h1 (noise on the response) or h2 (noise on the input).
        delay: Lag of the response channel behind the input channel [s]; by default zero, or the
            delay of the `Test`.
        band: Lowest and highest frequency to keep [Hz].

    Returns:
        The estimated FRF. A warning is issued if the window is short for the peak.

    Raises:
        DataError: A sample is NaN, shapes differ, the input is constant, or the record is too
            short for two segments.
        ConfigError: An argument is out of its range, or a record lacks a channel.

    Examples:
        The receptance of the virtual rig peaks at 18.8 Hz:

        >>> import jbw; jbw.enable_x64()
        >>> (noise,) = jbw.rig.measure(tests=["noise_0p005V"], repeats=1).tests
        >>> frf = jbw.frf(noise, "input", "velocity", band=(10.0, 30.0))
        >>> print(f"{frf.freq[abs(frf.h).argmax()]:.1f} Hz, {frf.num_segments} segments")
        18.8 Hz, 16 segments
    """
    if isinstance(y, str):
        delay = getattr(u, "delay", 0.0) if delay is None else delay
        u, y, fs, response = _named_channels(u, y, fs)
    delay = 0.0 if delay is None else delay
    u, y, fs = channel(u, "u"), channel(y, "y"), sampling(fs)
    same_length(u=u, y=y)
    u, y = np.atleast_2d(u), np.atleast_2d(y)
    if np.any(np.ptp(u, axis=-1) == 0):
        raise DataError("Channel `u` is constant.", why="A dead input excites nothing.")
    order = derivative_order(response)
    overlap = _checked(window, estimator, overlap)
    nperseg = _segment_length(u.shape, fs, window_s, nperseg, overlap)
    noverlap = int(overlap * nperseg)
    num_segments = (u.shape[-1] - noverlap) // (nperseg - noverlap)
    averages = _effective_averages(window, nperseg, noverlap, num_segments) * len(u)
    if averages < 1.5:
        raise DataError(
            f"The record must contain at least two segments of {nperseg / fs:g} s, but is "
            f"{u.shape[-1] / fs:g} s long.",
            why="A single segment gives a coherence of one and no variance.",
            remedy=f"Measure {(2 * nperseg - noverlap) / fs:g} s or shorten `window_s`.",
        )
    how = {"fs": fs, "window": window, "nperseg": nperseg, "noverlap": noverlap}
    freq, s_uu, s_yy, s_uy = _spectra(u, y, band, how)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.clip(np.where(s_yy > 0, np.abs(s_uy) ** 2 / (s_uu * s_yy), 0.0), 0.0, 1.0)
        h = s_uy / s_uu if estimator == "h1" else np.where(s_uy != 0, s_yy / s_uy.conj(), np.inf)
        h = h * np.exp(2j * np.pi * freq * delay) / (2j * np.pi * freq) ** order
        variance = (1 - coherence) / coherence * np.abs(h) ** 2 / (averages - 1)
    estimate = FRF(
        freq=freq, h=h, coherence=coherence, variance=np.where(coherence > 0, variance, np.inf),
        input_spectrum=s_uu, output_spectrum=s_yy, num_averages=float(averages),
        num_segments=num_segments, num_repeats=len(u), nperseg=nperseg, noverlap=noverlap, fs=fs,
        window=window, estimator=estimator, response=response,
    )  # fmt: skip
    _warn_when_coarse(estimate)
    return estimate


def _named_channels(
    measured: Record | Sequence[Record] | Test, source: str, response: str
) -> tuple[Reals, Reals, float, Motion]:
    """Return input and response of every repeat, their sampling frequency and kind of motion."""
    records = measured.records if isinstance(measured, Test) else measured
    records = [records] if isinstance(records, Record) else list(records)
    rates = {record.fs for record in records}
    if len(rates) != 1:
        stated = ", ".join(f"{rate:g}" for rate in sorted(rates)) or "none"
        raise DataError(
            f"Records that are averaged must have one sampling frequency, but have {stated} Hz.",
            remedy="Estimate the FRF of each record, or resample the records.",
        )
    # The drive point's channel is an acceleration by definition.
    motion = "acceleration" if response == "drive_point" else response
    if motion not in RESPONSES:
        raise ConfigError(
            f"Argument `response` must name a motion, but is {response!r}.",
            remedy=f"Take one of: {', '.join((*RESPONSES, 'drive_point'))}.",
        )
    pairs = [(_channel(record, source), _channel(record, response)) for record in records]
    sizes = sorted({len(samples) for pair in pairs for samples in pair})
    if len(sizes) > 1:
        raise DataError(
            f"Records that are averaged must have one length, but have {sizes[0]} to {sizes[-1]} "
            "samples.",
            remedy="Cut all records to the length of the shortest, or estimate the FRF of each "
            "record.",
        )
    u, y = np.stack(pairs, axis=1)
    return u, y, rates.pop(), motion


def _channel(record: Record, role: str) -> Reals:
    if role not in record.channels:
        raise ConfigError(
            f"Record {record.name or 'given'} has no channel {role!r}.",
            remedy=f"{did_you_mean(role, record.channels)}The record has: "
            f"{', '.join(record.channels)}.",
        )
    return record.channels[role]


def _checked(window: str, estimator: str, overlap: float | None) -> float:
    """Return the overlap after checking window and estimator; raise a ConfigError if invalid."""
    if window not in RESOLUTION_BINS:
        raise ConfigError(f"Argument `window` must be hann or boxcar, but it is {window!r}.")
    if estimator not in ("h1", "h2"):
        raise ConfigError(f"Argument `estimator` must be h1 or h2, but it is {estimator!r}.")
    if overlap is None:
        return 0.5 if window == "hann" else 0.0
    if not 0 <= overlap <= 0.9:
        raise ConfigError(f"Argument `overlap` must lie in [0, 0.9], but it is {overlap:g}.")
    return float(overlap)


def _segment_length(
    shape: tuple[int, ...], fs: float, window_s: float | None, nperseg: int | None, overlap: float
) -> int:
    """Return the samples per segment: as requested, or the most that give 16 segments in total."""
    num_repeats, num_samples = shape
    if window_s is not None and nperseg is not None:
        raise ConfigError("Give `window_s` or `nperseg`, not both.")
    per_repeat = max(3, -(-DEFAULT_SEGMENTS // num_repeats))
    longest = int(num_samples / (per_repeat - (per_repeat - 1) * overlap))
    if window_s is not None:
        length = round(window_s * fs)
    elif nperseg is not None:
        length = int(nperseg)
    else:
        length = longest and (fft.prev_fast_len(longest, real=True) or longest)
    if not 8 <= length <= num_samples:
        raise DataError(
            f"A segment must have at least 8 samples and fit in the record, but it has {length} "
            f"({length / fs:g} s) and the record {num_samples} ({num_samples / fs:g} s).",
            remedy=f"Measure {max(length, 128) / fs:g} s or more, or shorten `window_s`.",
        )
    return length


def _effective_averages(window: str, nperseg: int, noverlap: int, num_segments: int) -> float:
    """Return the equivalent number of averages, K = N / (1 + 2 sum_m (N - m) / N rho_m^2)."""
    # N is the number of segments, and rho_m is the correlation of the window with itself m segments
    # later: P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73.
    w = np.asarray(signal.get_window(window, nperseg))
    step = nperseg - noverlap
    lags = np.arange(1, min(num_segments, -(-nperseg // step)))
    rho = np.array([w[m * step :] @ w[: nperseg - m * step] for m in lags]) / (w @ w)
    return float(num_segments / (1 + 2 * np.sum((num_segments - lags) / num_segments * rho**2)))


def _spectra(
    u: Reals, y: Reals, band: tuple[float, float] | None, how: dict[str, Any]
) -> tuple[NDArray[Any], ...]:
    """Return the band's frequencies, S_uu, S_yy and S_uy = E[conj(U) Y], averaged over repeats."""
    freq, s_uu, s_yy, s_uy = averaged(u, y, **how)
    nyquist = how["fs"] / 2
    low, high = passband(band or (0.0, nyquist), nyquist)
    keep = (freq > 0) & lines_within(freq, (low, high))
    if not keep.any():
        raise ConfigError(
            f"Argument `band` = ({low:g}, {high:g}) Hz must contain a spectral line, but the lines "
            f"are {how['fs'] / how['nperseg']:g} Hz apart.",
            remedy="Widen `band`, or lengthen the window.",
        )
    s_uu, s_yy, s_uy = (s.mean(axis=0)[keep] for s in (s_uu, s_yy, s_uy))
    if np.any(s_uu <= 0):
        raise DataError(
            "Channel `u` must excite every line of the band, but some lines have no power.",
            remedy="Narrow `band` to the excited frequencies.",
        )
    return freq[keep], s_uu, s_yy, s_uy


def averaged(
    u: Reals, y: Reals, *, fs: float, window: str, nperseg: int, noverlap: int
) -> tuple[NDArray[Any], ...]:
    r"""Return frequencies and one-sided spectral densities of the last axis, by Welch's segments.

    $$S_{uy} = \frac{2}{f_s \sum_n w_n^2} \langle \bar U Y \rangle, \qquad
      U = \sum_n w_n (u_n - \langle u \rangle)\, e^{-2\pi j k n / N}$$

    and half of that at frequency zero and at half of the sampling rate. The densities are S_uu,
    S_yy and S_uy; a lagging y has negative phase in S_uy. Each segment of both signals is
    transformed once.
    """
    taper = np.asarray(signal.get_window(window, nperseg))
    u, y = np.broadcast_arrays(u, y)
    starts = range(0, u.shape[-1] - nperseg + 1, nperseg - noverlap)
    s_uu, s_yy, s_uy = 0.0, 0.0, 0.0
    for start in starts:
        pair = np.stack([x[..., start : start + nperseg] for x in (u, y)])
        of_u, of_y = np.asarray(fft.rfft(taper * (pair - pair.mean(axis=-1, keepdims=True))))
        s_uu = s_uu + of_u.real**2 + of_u.imag**2
        s_yy = s_yy + of_y.real**2 + of_y.imag**2
        s_uy = s_uy + of_u.conj() * of_y
    freq = fft.rfftfreq(nperseg, 1 / fs)
    scale = np.full(freq.shape, 2 / (fs * np.sum(taper**2) * len(starts)))
    scale[0] /= 2
    if nperseg % 2 == 0:
        scale[-1] /= 2
    return freq, scale * s_uu, scale * s_yy, scale * s_uy


def stands_out(h: Complexes) -> bool:
    """Return whether an FRF has a clear peak; a flat or noisy estimate has none."""
    power = np.abs(h) ** 2
    return bool(power.max() > 10 * np.median(power))


def _warn_when_coarse(estimate: FRF) -> None:
    """Warn if the highest peak is hardly wider than the spectral peak of the window itself."""
    # A boxcar is meant for whole periods, whose lines are exact at any spacing.
    if estimate.window == "boxcar":
        return
    seen = half_power_bandwidth(estimate.freq, estimate.h)
    if not stands_out(estimate.h) or seen > COARSE * estimate.resolution_hz:
        return
    peak = estimate.freq[np.argmax(np.abs(estimate.h))]
    natural = max(seen - estimate.resolution_hz, seen / 4)  # the two widths approximately add
    longer = COARSE * RESOLUTION_BINS[estimate.window] / natural
    warnings.warn(
        f"The {estimate.window_s:g} s {estimate.window} window resolves "
        f"{estimate.resolution_hz:.3g} Hz, and the peak at {peak:.4g} Hz is {seen:.3g} Hz wide at "
        f"half power (apparent damping {seen / (2 * peak):.2%}): the window smears the peak. A "
        f"longer `window_s` ({longer:.3g} s or more) reduces the smearing; line_fit corrects for "
        "the "
        "window.",
        stacklevel=3,
    )


def strongest_line(x: Reals, fs: float, *, lowest: int = 1) -> float:
    r"""Return the frequency of the strongest line [Hz], by a parabola through logarithms of lines.

    $$f = \frac{f_s}{N}\Bigl(k + \frac{a - c}{2 (a - 2b + c)}\Bigr)$$

    with a, b, c the logarithms of the lines k - 1, k, k + 1 of the transform with a Hann window; k
    is at least `lowest`.
    """
    x = x[np.isfinite(x)]
    size = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    k = lowest + int(np.argmax(size[lowest:-1]))
    a, b, c = np.log(np.maximum(size[k - 1 : k + 2], 1e-300))
    bend = a - 2.0 * b + c
    return float(fs / len(x) * (k + (0.5 * (a - c) / bend if bend else 0.0)))


def half_power_bandwidth(freq: Reals, h: Complexes) -> float:
    """Return the highest peak's half-power width [Hz], interpolated linearly; may be infinite."""
    power = np.abs(h) ** 2
    top = int(np.argmax(power))
    below = power < power[top] / 2
    below_peak, above_peak = np.flatnonzero(below[:top]), np.flatnonzero(below[top:])
    if not (below_peak.size and above_peak.size):
        return np.inf

    def crossing(inside: int, outside: int) -> float:
        part = (power[inside] - power[top] / 2) / (power[inside] - power[outside])
        return freq[inside] + part * (freq[outside] - freq[inside])

    i, j = int(below_peak[-1]), top + int(above_peak[0])
    return float(crossing(j - 1, j) - crossing(i + 1, i))
