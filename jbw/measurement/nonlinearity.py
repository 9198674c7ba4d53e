r"""Sentences on nonlinearity and noise in the records of a test, without a model.

The evidence is the variation of repeats and whether it is noise or another joint, harmonics by
order along a sweep, distortion against noise of multisines, and the coherence of random noise.
`jbw look` reports frequency and damping against amplitude. Repeats are described by

$$d_k = \bar d + a_k\,\bar d + b_k\,\dot{\bar d} + c_k\,t\,\dot{\bar d} + e_k$$

A changing gain, a late trigger and a shifting natural frequency each change a record along one of
three directions; the remainder is noise. If the directions explain more than chance, the repeats
differ, and averaging cannot reduce their variation below that.

Distortion of multisines is separated from noise by periods and lines. A period repeats exactly
apart from noise, whereas another realisation of its phases changes the effect of a nonlinearity.
The variation over periods is therefore noise, and the additional variation over realisations is
distortion (the robust method): the best linear approximation. Lines without excitation show even
and odd nonlinearities directly.

Along one sweep the response is demodulated with multiples of the source's phase,

$$u = A \cos\phi(t), \qquad
  y \approx \mathrm{Re} \sum_{n=1}^{N} Y_n(t)\, e^{jn\phi(t)}$$

The phase phi is that of the source's analytic signal, so that a sweep may be linear, exponential or
any other, and run up or down. Each order is fitted in windows of a few periods, linear within a
window, all orders at once. This is Farina's and Novak's separation of a sweep's orders without
their requirement of an exponential sweep; like theirs it is valid if the response follows the
sweep.

Reference:
    Schoukens, Vaes and Pintelon (2016), IEEE Control Systems Magazine 36(3), 38; Pintelon and
    Schoukens, System Identification, 2nd ed. (2012), sections 4.3 and 4.4. Farina (2000), 108th AES
    Convention, 5093; Novak, Lotton and Simon (2015), Journal of the Audio Engineering Society 63,
    786.
"""

import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import ArrayLike, NDArray
from scipy.signal import hilbert
from scipy.stats import f as f_distribution

from jbw.errors import ConfigError, DataError
from jbw.measurement.channels import Complexes, Reals, channel, same_length, sampling
from jbw.measurement.kinds import Kind
from jbw.measurement.records import INPUTS, RESPONSES, Record
from jbw.measurement.spectra import frf
from jbw.quantities import Motion
from jbw.report.messages import look as messages

# largest number of samples, of all channels of a test, that are kept in memory for a comparison
MOST_SAMPLES = 2**23
# Records do not count as repeats if their sources differ by more than this relative amount.
SAME_SOURCE = 0.1
ABOVE_NOISE = 5.0  # smallest reported harmonic, in standard deviations of its noise
ORDERS = {2: "second", 3: "third", 5: "fifth"}
BY_CHANCE = 1e-3  # p-value below which repeats are reported to differ
# number of directions along which repeats may differ for other reasons than noise: amplitude, time,
# speed
SHAPES = 3
# A spectral line counts as excited above this fraction of the source's largest line.
EXCITED = 0.05
PERIODS = 10.0  # number of periods of the source in a window
SPACING = 0.5  # distance of windows, divided by their length
QUIET = 0.02  # Below this fraction of its largest amplitude, the source drives nothing.
FEWEST = 4  # smallest number of windows in a sweep
# Largest median residual of a tone with harmonics, relative to the source, fitted in each window of
# a sweep. A source with a larger residual is not a sweep.
MOST_STRAY = 0.1


class Stated(Protocol):
    """The stated properties of a test, from a campaign's table or from the loaded test."""

    @property
    def name(self) -> str:
        """The short name of the test."""
        ...

    @property
    def traits(self) -> Kind:
        """The properties of the test's kind."""
        ...

    @property
    def periods(self) -> int:
        """The number of whole periods in a record."""
        ...

    @property
    def settle(self) -> float:
        """The time to discard at the start of a record [s]."""
        ...


def seen_in(test: Stated, records: Sequence[Record]) -> list[str]:
    """Return sentences on nonlinearity and noise in the complete records of a test, if any.

    The list is empty unless `records` have one length and sampling frequency.
    """
    traits = test.traits
    shapes = {(record.num_samples, record.fs) for record in records}
    if traits.is_curve or len(shapes) != 1 or not all(record.valid.all() for record in records):
        return []
    driven = traits.is_driven and any(role in records[0].channels for role in INPUTS)
    role = next(filter(records[0].channels.__contains__, RESPONSES), None)
    if not driven or role is None:
        return []
    fs = records[0].fs
    u = np.stack([record.channels[record.source] for record in records])
    y = np.stack([record.channels[role] for record in records])
    sentences: list[str] = []
    try:
        if traits.is_periodic and test.periods > 1:
            sentences += _multisine(test, u, y, fs)
        elif traits.is_broadband:
            coherence = coherence_at_resonance(u, y, fs, role)
            sentences.append(messages.coherence_of_noise(*coherence))
        else:
            sentences += _repeats(u, y)
            sentences += _sweep(u, y, fs) if traits.is_transient else []
    # For example, a record may be too short, which `jbw identify` rejects.
    except DataError as error:
        sentences.append(messages.not_assessed(str(error).splitlines()[0]))
    return [f"{test.name}: {sentence}" for sentence in sentences]


def _same_source(u: NDArray[np.float64]) -> bool:
    """Return whether the source is the same in all records."""
    mean = u.mean(axis=0)
    return float(np.std(u - mean)) <= SAME_SOURCE * float(np.std(mean))


def _repeats(u: NDArray[np.float64], y: NDArray[np.float64]) -> Iterator[str]:
    if len(y) < 2 or not _same_source(u):
        return
    scatter = repeatability(y)
    how = messages.AS_NOISE
    if scatter.differ:
        how = messages.more_than_noise(scatter.noise, scatter.p, scatter.size)
    yield messages.repeats(len(y), scatter.scatter, scatter.floor, how)


def _sweep(u: NDArray[np.float64], y: NDArray[np.float64], fs: float) -> Iterator[str]:
    together = (u, y) if _same_source(u) else (u[:1], y[:1])
    harmonics = swept_harmonics(*together, fs)
    shares = {order: largest_share(harmonics, order) for order in ORDERS}
    shown = [
        messages.harmonic(ORDERS[order], share, hz)
        for order, (share, error, hz) in shares.items()
        if np.isfinite(share) and share > ABOVE_NOISE * error
    ]
    noise = max((error for _, error, _ in shares.values()), default=0.0)
    yield messages.harmonics(shown, noise)


def _multisine(
    test: Stated, u: NDArray[np.float64], y: NDArray[np.float64], fs: float
) -> Iterator[str]:
    """Yield sentences on a multisine's distortion and noise, from periods and unexcited lines."""
    size, rest = divmod(u.shape[1], test.periods)
    skipped = int(np.ceil(test.settle * fs / size - 1e-6))
    if rest or skipped >= test.periods:
        return
    steady = (x[:, skipped * size :].reshape(len(x), -1, size) for x in (u, y))
    (u, y), is_repeated = steady, _same_source(u)
    if is_repeated:  # Repeats of one realisation count as additional periods.
        u, y = (x.reshape(1, -1, size) for x in (u, y))
    best = best_linear_approximation(u, y, fs)
    gain = np.sqrt(np.mean(np.abs(best.h) ** 2))
    noise, distortion = (
        np.sqrt(np.mean(std**2)) / gain for std in (best.noise_std, best.distortion_std)
    )
    if np.isfinite(noise) and best.num_realisations > 1:
        yield messages.distortion(noise, distortion, best.num_realisations)
    elif np.isfinite(noise):
        yield messages.noise_of_periods(noise, best.num_periods)
    idle = detection_lines(u[0], y[0])
    shares = {"even": (idle.even, idle.num_even), "odd": (idle.odd, idle.num_odd)}
    present = [(name, share) for name, (share, count) in shares.items() if count]
    if present:
        yield messages.idle_lines(present, idle.noise)


def coherence_at_resonance(
    u: NDArray[np.float64], y: NDArray[np.float64], fs: float, role: Motion
) -> tuple[float, float]:
    """Return the frequency of the strongest response [Hz], and the mean coherence around it.

    The mean is over the lines whose power exceeds a quarter of the largest. `u` and `y` have the
    shape (repeat, time); `role` is the role of the response.
    """
    with warnings.catch_warnings():
        # The warning concerns the window, which is chosen in Step 2 (FRF fit).
        warnings.simplefilter("ignore")
        estimate = frf(u, y, fs, response=role)
    power = np.abs(estimate.h) ** 2 * estimate.input_spectrum
    near = power > power.max() / 4
    return float(estimate.freq[np.argmax(power)]), float(np.mean(estimate.coherence[near]))


class Repeatability(NamedTuple):
    """The variation of repeats of one test, relative to the root mean square of their mean."""

    scatter: float  # total standard deviation of one repeat
    noise: float  # standard deviation that no change of amplitude, time or speed explains
    size: float  # standard deviation of the repeats' amplitude
    p: float  # p-value of the variation along the three directions, if there were only noise
    num_repeats: int

    @property
    def differ(self) -> bool:
        """Whether the repeats differ by more than noise."""
        return self.p < BY_CHANCE

    @property
    def floor(self) -> float:
        """The relative standard error of the repeats' mean; smaller effects cannot be detected."""
        return self.scatter / self.num_repeats**0.5


def repeatability(y: ArrayLike) -> Repeatability:
    """Measure the variation of repeats (repeat, time) of the same excitation with equal starts.

    Raises:
        DataError: A sample is NaN, there are fewer than two repeats, or the channel is constant.
    """
    rows = channel(y, "y")
    if rows.ndim != 2 or len(rows) < 2 or rows.shape[1] <= SHAPES:
        raise DataError(
            f"Channel `y` must hold two repeats of more than {SHAPES} samples, (repeat, time), but "
            f"has the shape {rows.shape}.",
            remedy="Measure the test again, with nothing changed.",
        )
    count, length = rows.shape
    mean = rows.mean(axis=0)
    power = float(np.mean(mean**2))
    if power == 0:
        raise DataError("Channel `y` is constant.", why="A constant channel shows no response.")
    slope, t = np.gradient(mean), np.linspace(-1.0, 1.0, length)
    basis = np.linalg.qr(np.column_stack([mean, slope, t * slope]))[0]
    deviations = rows - mean
    along = deviations @ basis
    explained = float(np.sum(along**2))
    rest = max(float(np.sum(deviations**2)) - explained, 0.0)
    degrees = SHAPES * (count - 1), (length - SHAPES) * (count - 1)
    noise = rest / degrees[1]
    # Coloured noise is stronger where the response is, so the comparison is within its band.
    ratio = explained / degrees[0] / max(_in_band(deviations, mean), noise, 1e-300)
    num_values = 2 * int(np.sum(_band(mean)))  # the band's lines are complex
    return Repeatability(
        scatter=float(np.sqrt(np.sum(deviations**2) / ((count - 1) * length) / power)),
        noise=float(np.sqrt(noise / power)),
        size=float(np.std(along[:, 0], ddof=1) / np.sqrt(length * power)),
        p=float(f_distribution.sf(ratio, degrees[0], max(num_values * (count - 1), 1))),
        num_repeats=count,
    )


def _band(mean: np.ndarray) -> np.ndarray:
    """Return a mask of the response's spectral lines above a hundredth of the largest line."""
    size = np.abs(np.fft.rfft(mean))
    return size > 0.01 * size.max()


def _in_band(deviations: np.ndarray, mean: np.ndarray) -> float:
    """Return the variance per sample of white noise with the median level in a response's band."""
    band = _band(mean)
    power = np.sum(np.abs(np.fft.rfft(deviations))[:, band] ** 2, axis=0) / (len(deviations) - 1)
    # The ratio of the median to the mean of a chi-square variable with 2 k degrees of freedom is
    # that of Wilson and Hilferty.
    k = len(deviations) - 1
    return float(np.median(power) / deviations.shape[1] / (1 - 1 / (9 * k)) ** 3)


class BestLinear(NamedTuple):
    """The best linear approximation at the excited lines, averaged over realisations.

    Standard deviations are of the complex number, sqrt(E|error|^2). Values that need several
    periods are NaN with one period; values that need several realisations are NaN with one
    realisation.
    """

    freq: Reals  # [Hz]
    h: Complexes  # response over source
    noise_std: Reals  # standard deviation of `h` from noise alone
    total_std: Reals  # standard deviation of `h` from noise and distortion
    # standard deviation of one realisation from distortion; zero if below the noise
    distortion_std: Reals
    num_realisations: int
    num_periods: int


class Distortion(NamedTuple):
    """The response at spectral lines between the excited lines, where a linear structure has none.

    All values are root mean squares of complex amplitudes over lines, relative to that of the
    excited lines. They are NaN if there are no such lines; the noise is NaN with one period.
    """

    odd: float
    even: float
    noise: float  # noise of the mean over the periods
    num_odd: int
    num_even: int


def best_linear_approximation(u: ArrayLike, y: ArrayLike, fs: float) -> BestLinear:
    r"""Return the best linear approximation, its noise, and the distortion of one realisation.

    $$\hat G = \frac1M \sum_m \hat G_m, \quad \hat G_m = \frac{\bar Y_m}{\bar U_m}, \quad
      \sigma_{tot}^2 = \frac{1}{M (M - 1)} \sum_m |\hat G_m - \hat G|^2, \quad
      \sigma_S^2 = M (\sigma_{tot}^2 - \sigma_n^2)$$

    where bars are means over the P periods and sigma_n comes from the variation of periods about
    them.

    Args:
        u: Source of steady periods, shape (realisation, period, time) or (period, time).
        y: Response, of the same shape.
        fs: Sampling frequency [Hz].

    Raises:
        DataError: A sample is NaN, shapes differ, or the source has no power.
    """
    (u, y), fs = _steady(u, y), sampling(fs)
    count, num_periods = u.shape[:2]
    spectra_u, spectra_y = np.fft.rfft(u), np.fft.rfft(y)
    lines = excited_lines(u)
    mean_u, mean_y = (x.mean(axis=1)[:, lines] for x in (spectra_u, spectra_y))
    ratios = mean_y / mean_u
    # The noise of source and response combined, as it affects their ratio to first order.
    residual = spectra_y[..., lines] - ratios[:, None] * spectra_u[..., lines]
    noise = np.full(ratios.shape, np.nan)
    if num_periods > 1:
        square = np.sum(np.abs(residual) ** 2, axis=1) / (num_periods - 1)
        noise = square / num_periods / np.abs(mean_u) ** 2
    h, noise = ratios.mean(axis=0), noise.mean(axis=0) / count
    total, distortion = np.full(h.shape, np.nan), np.full(h.shape, np.nan)
    if count > 1:
        total = np.sum(np.abs(ratios - h) ** 2, axis=0) / (count * (count - 1))
        distortion = np.maximum(count * (total - noise), 0.0)
    freq = lines * fs / u.shape[-1]
    roots = np.sqrt(noise), np.sqrt(total), np.sqrt(distortion)
    return BestLinear(freq, h, *roots, count, num_periods)


def detection_lines(u: ArrayLike, y: ArrayLike) -> Distortion:
    """Return the response at unexcited odd and even lines, corrected for the source's own lines.

    The correction is the source's spectrum at the line times the ratio of response to source at the
    nearest excited line. `u` and `y` are steady periods of one realisation, (period, time).
    """
    whole_u, whole_y = (x[0] for x in _steady(u, y))
    lines = excited_lines(whole_u[None])
    spectra_u, spectra_y = np.fft.rfft(whole_u), np.fft.rfft(whole_y)
    mean_u, mean_y = spectra_u.mean(axis=0), spectra_y.mean(axis=0)
    band = np.arange(lines[0], lines[-1] + 1)
    idle = np.setdiff1d(band, lines)
    nearest = lines[np.argmin(np.abs(idle[:, None] - lines[None]), axis=1)] if idle.size else idle
    ratio = mean_y[nearest] / mean_u[nearest]
    response = mean_y[idle] - ratio * mean_u[idle]
    size = _rms(mean_y[lines])
    noise = np.nan
    if len(whole_u) > 1:
        spread = spectra_y - mean_y
        variance = np.sum(np.abs(spread) ** 2, axis=0) / (len(whole_u) * (len(whole_u) - 1))
        noise = float(np.sqrt(variance[band].mean()))
    odd, even = response[idle % 2 == 1], response[idle % 2 == 0]
    return Distortion(_rms(odd) / size, _rms(even) / size, noise / size, odd.size, even.size)


def excited_lines(u: Float[np.ndarray, "*batch time"]) -> Int[np.ndarray, " line"]:
    """Return the spectral lines that the source excites, without the first and the last line."""
    power = np.mean(np.abs(np.fft.rfft(u)) ** 2, axis=tuple(range(u.ndim - 1)))
    power[0] = power[-1] = 0.0
    if not power.max() > 0:
        raise DataError("Channel `u` is constant.", why="A dead source excites nothing.")
    return np.flatnonzero(np.sqrt(power) > EXCITED * np.sqrt(power.max()))


def _rms(values: NDArray[np.complex128]) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if values.size else float("nan")


def _steady(u: ArrayLike, y: ArrayLike) -> tuple[Reals, Reals]:
    """Check source and response; return both with the axes realisation, period and time."""
    source, response = np.asarray(u, float), np.asarray(y, float)
    if source.shape != response.shape or not 2 <= source.ndim <= 3:
        raise DataError(
            "Channels `u` and `y` must both be (period, time) or (realisation, period, time), but "
            f"have shapes {source.shape} and {response.shape}.",
            remedy="Cut the records to whole periods, with one period per row.",
        )
    shape = (-1, *source.shape[-2:])
    for name, values in (("u", source), ("y", response)):
        channel(values.reshape(-1, source.shape[-1]), name)
    return source.reshape(shape), response.reshape(shape)


class SweptHarmonics(NamedTuple):
    """Harmonics along a sweep at the frequencies that it passes, in order of time."""

    freq: Reals  # frequency of the source [Hz]
    source: Complex[np.ndarray, "order window"]  # harmonics of the source; order 1 is its amplitude
    # peak amplitudes; phases are relative to n times the source's phase
    response: Complex[np.ndarray, "order window"]
    std: Reals  # standard deviation of a real component of `response`, from the residual of the fit


def swept_harmonics(
    u: ArrayLike, y: ArrayLike, fs: float, *, num_orders: int = 5, periods: float = PERIODS
) -> SweptHarmonics:
    """Return a response's harmonics along a sweep, in windows of several source periods.

    A harmonic below the noise has the size of the noise, which `std` gives. Orders above half the
    sampling frequency are NaN.

    Args:
        u: Source, shape (time,) or (repeat, time); repeats are averaged.
        y: Response, of the same shape.
        fs: Sampling frequency [Hz].
        num_orders: Highest harmonic order.
        periods: Length of a window; a shorter one follows a resonance better, a longer one averages
            more noise.

    Raises:
        DataError: A sample is NaN, shapes differ, the source is constant or no sweep, or the
            sweep is too short.
        ConfigError: An argument is out of its range.
    """
    u, y, fs = channel(u, "u"), channel(y, "y"), sampling(fs)
    same_length(u=u, y=y)
    if num_orders < 1 or periods < 3:
        raise ConfigError(
            f"Arguments `num_orders` and `periods` must be at least 1 and 3, but are {num_orders} "
            f"and {periods:g}."
        )
    u, y = np.atleast_2d(u).mean(axis=0), np.atleast_2d(y).mean(axis=0)
    if np.ptp(u) == 0:
        raise DataError("Channel `u` is constant.", why="A dead source excites nothing.")
    signal = np.asarray(hilbert(u - u.mean()))
    phase = np.unwrap(np.angle(signal))
    if phase[-1] < phase[0]:
        phase = -phase
    windows = _windows(np.abs(signal), phase, periods)
    if len(windows) < FEWEST:
        raise DataError(
            f"A sweep must contain {FEWEST} windows of {periods:g} periods, but contains "
            f"{len(windows)}.",
            remedy="Sweep more slowly, or reduce `periods`.",
        )
    rows = [_fitted(phase[w], u[w], y[w], fs, num_orders) for w in windows]
    freq, source, response, std, strays = (np.array(x) for x in zip(*rows, strict=True))
    if (stray := float(np.median(strays))) > MOST_STRAY:
        raise DataError(
            f"The source `u` must be a sweep, but its amplitude varies by {stray:.0%} within "
            f"{periods:g} periods.",
            why="Harmonics refer to a single phase of the source, which noise and multisines lack.",
            remedy="Give the record of a sweep or of a tone.",
        )
    return SweptHarmonics(freq, source.T, response.T, std)


def _windows(amplitude: Reals, phase: Reals, periods: float) -> list[slice]:
    """Return half-overlapping windows of equally many source periods, where the source is on."""
    loud = np.flatnonzero(amplitude > QUIET * amplitude.max())
    turns = np.maximum.accumulate(phase) / (2 * np.pi)
    first, last = float(turns[loud[0]]), float(turns[loud[-1]])
    starts = np.arange(first, last - periods, SPACING * periods)
    ends = np.searchsorted(turns, np.stack([starts, starts + periods]))
    return [slice(int(a), int(b)) for a, b in ends.T]


def _fitted(
    phase: Reals, u: Reals, y: Reals, fs: float, num_orders: int
) -> tuple[float, NDArray[np.complex128], NDArray[np.complex128], float, float]:
    """Return frequency [Hz], harmonics of both channels, sd of the response, source's residual."""
    x = np.linspace(-1.0, 1.0, len(phase))
    hz = float(np.polyfit(x, phase, 1)[0]) / (np.pi * (len(phase) - 1) / fs)
    shown = [n for n in range(1, num_orders + 1) if n * hz < 0.45 * fs]
    waves = [f(n * phase) for n in shown for f in (np.cos, np.sin)]
    # Within a window, amplitudes may change as parabolas and there may be a drift.
    basis = np.column_stack([w * x**k for k in range(3) for w in waves] + [x**0, x])
    weight = np.cos(np.pi * x / 2)[:, None]
    # The normal equations suffice, since the columns have similar sizes and are far from dependent.
    # There are many windows.
    rows = weight * basis
    both = np.linalg.solve(rows.T @ rows, rows.T @ (weight * np.column_stack([u, y])))
    residual = y - basis @ both[:, 1]
    stray = float(np.std(u - basis @ both[:, 0]) / np.std(u))
    degrees = max(len(y) - basis.shape[1], 1)
    std = float(np.sqrt(np.sum(residual**2) / degrees * 2 / (len(y) / 2)))
    amplitudes = np.full((2, num_orders), np.nan, complex)
    for i, n in enumerate(shown):
        amplitudes[:, n - 1] = both[2 * i] - 1j * both[2 * i + 1]
    # Phases refer to the source's fitted first harmonic instead of its analytic signal.
    turn = np.exp(-1j * np.arange(1, num_orders + 1) * np.angle(amplitudes[0, 0]))
    return hz, amplitudes[0] * turn, amplitudes[1] * turn, std, stray


def largest_share(harmonics: SweptHarmonics, order: int) -> tuple[float, float, float]:
    """Return an order's largest harmonic relative to the fundamental, its noise and its frequency.

    The possible effect of the source's own harmonic is subtracted: the size of that harmonic times
    the largest ratio of response to source.
    """
    size = np.abs(harmonics.response[0])
    row, source = np.abs(harmonics.response[order - 1]), np.abs(harmonics.source[order - 1])
    passed = np.max(size / np.abs(harmonics.source[0])) * source
    excess: Float[np.ndarray, " window"] = np.where(np.isfinite(row), row - passed, -np.inf)
    i = int(np.argmax(excess))
    share, noise = float(excess[i] / size.max()), float(harmonics.std[i] / size.max())
    return max(share, 0.0), noise, harmonics.freq[i]
