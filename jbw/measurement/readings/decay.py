r"""A free decay of one mode in a band: its filtered samples, and its fitted change of amplitude.

$$t = \int \frac{d \ln a}{-\sigma(a)}, \qquad \varphi = \int \frac{\omega(a)}{\sigma(a)}\,d\ln a$$

The integrals are quadratures over ln a. The filter's response at the complex frequency
$i\omega - \sigma$ is part of the model, so that nothing has to settle. The samples are fitted
instead of their logarithm: noise remains additive, and a noisy tail has no weight.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import least_squares
from scipy.signal import fftconvolve

from jbw.measurement.channels import Complexes, Reals, whole_down, whole_up
from jbw.measurement.readings.slow_flow import (
    BASES,
    FULLY,
    LEAST_RATIO,
    NEAR_BEST,
    AmplitudeBasis,
    ModeFit,
    converter_step,
    filtered_step,
    slopes_of_cause,
    strongest_line,
)  # fmt: skip

BETA = 7.0  # shape of the Kaiser window that filters the band
# relative error of the model for a sound joint, from averaging and from truncated powers
LAW_ERROR = 1e-3
QUANTUM_NOISE = 0.02  # variance of quantisation, divided by the square of half a converter step
# A blow counts if the envelope exceeds this fraction of its largest value; a later one may be
# stronger.
FIRST_BLOW = 0.6
QUADRATURE = 160  # number of amplitudes in the quadrature
MOMENTS = 24  # number of even moments of the filter, which give its response to 1e-12 in its band
FEWEST_POWERS = 14  # smallest number of values for a fit of a power of the amplitude
# A further power of the amplitude is kept if it reduces the sum of squares to at most this
# fraction.
WORTH_A_TERM = 0.9
NO_MODEL = 1e3  # value of an invalid model, relative to the signal
# Without dither, a signal smaller than this many half steps of the AD converter leaves no trace in
# the record.
FADED = 2.4
QUIETEST = 0.3  # amplitude relative to the noise at which a decay ends
LOUD = 4.0  # multiple of the noise's amplitude that noise alone exceeds in one of 10^7 values
FEWEST_KEPT = 24
LEAST_FALL = 1e-3  # smallest damping rate of a linear decay during the fit, in units of `scale`
# Lines at which the filter's gain exceeds the first number determine the noise. The second number
# is the smallest allowed count of these lines.
HALF_GAIN, FEWEST_LINES = 0.5, 12
SAFE = 1.15  # safety factor on noise that is estimated from few lines


class Jump(NamedTuple):
    """A jump of a decay from one state to another: time [s], changes of log amplitude and phase."""

    time_s: float
    growth: float
    turn: float


class DecayCause(NamedTuple):
    """An additional cause that shapes a record, fitted together with the mode.

    Attributes:
        start: Starting values of the parameters.
        apply: Function of signal, model and parameters that returns the model with the cause; None
            for a jump, which changes the flow itself.
    """

    start: Reals
    apply: Callable[["DecaySignal", Complexes, Reals], Complexes] | None = None


@dataclass(frozen=True)
class DecaySignal:
    """A record of a decay, filtered about the centre of its band and thinned.

    Attributes:
        raw: Samples of the record after `settle`.
        fs: Sampling frequency [Hz].
        centre_hz: Frequency that was moved to zero [Hz].
        half_width_hz: Half the width of the band [Hz].
        taps: Impulse response of the filter, with sum 1.
        moments: Even moments of the filter over (2k)! [s^2k].
        a0: Amplitude at the start, which is the reference of relative amplitudes.
        z: Envelope values, in the unit of the samples.
        time: Times of the values, from the first value [s].
        begins: Time of the first value in `raw` [s].
        step_s: Time between two values [s].
        quantum: Step of the converter.
        tail: Noise amplitude in the band at the end of the record.
        order: Order of the derivative of displacement that was measured.
        unit: Factor from the unit of the samples to that of the record.
    """

    raw: Reals
    fs: float
    centre_hz: float
    half_width_hz: float
    taps: Reals
    moments: Reals
    a0: float
    z: Complexes
    time: Reals
    begins: float
    step_s: float
    quantum: float
    tail: float
    order: int
    unit: float = 1.0

    @property
    def half(self) -> int:
        """The number of samples on either side of the filter's middle tap."""
        return len(self.taps) // 2

    @property
    def size(self) -> Reals:
        """The amplitude of every envelope value."""
        return np.abs(self.z)

    def first(self) -> tuple[float, float]:
        """Return a first estimate of damping rate and frequency above the band's centre [rad/s]."""
        size = self.size
        loud = np.flatnonzero(size > max(0.1 * size[0], 3 * min(self.tail, 0.02 * size[0])))
        stop = max(int(loud[-1]) + 1 if loud.size else len(size), min(6, len(size)))
        turn = float(np.angle(np.sum(self.z[1:stop] * np.conj(self.z[: stop - 1])))) / self.step_s
        rate = -np.polyfit(self.time[:stop], np.log(size[:stop] + 1e-300), 1)[0]
        return max(float(rate), 1e-3 / self.time[-1]), turn

    def passed(self, turn: float) -> float:
        """Return the filter's gain for a steady line, at its frequency above the centre [rad/s]."""
        return float(np.abs(np.exp(_log_response(self, np.array([1j * turn]))[0]))[0])

    def until(self, count: int) -> "DecaySignal":
        """Return the decay signal cut to its first `count` values."""
        return replace(self, z=self.z[:count], time=self.time[:count])

    def filtered_step(self, at_s: float) -> Reals:
        """Return the filtered signal of a unit step at a given time [s]."""
        return filtered_step(self.taps, (self.time - at_s) * self.fs)


def decay_signal(x: Reals, fs: float, band_hz: tuple[float, float], order: int) -> DecaySignal:
    """Filter a record of a decay about its band, starting from its first blow.

    Args:
        x: Samples after `settle`.
        fs: Sampling frequency [Hz].
        band_hz: Lowest and highest frequency of the single mode [Hz].
        order: Order of the derivative of displacement that was measured.
    """
    centre, half_width = 0.5 * sum(band_hz), 0.5 * (band_hz[1] - band_hz[0])
    wanted = whole_up(np.hypot(1, BETA / np.pi) * fs / half_width)
    taps = np.kaiser(min(wanted | 1, (len(x) // 3) | 1), BETA)
    taps /= taps.sum()
    half = len(taps) // 2
    carrier = np.exp(-2j * np.pi * centre / fs * np.arange(len(x)))
    whole = 2 * fftconvolve(x * carrier, taps, "valid")
    size = np.abs(whole)
    # The blow is half a filter length after the envelope's peak, or at the record's beginning.
    top = int(np.argmax(size > FIRST_BLOW * size.max()))
    top += int(np.argmax(size[top : top + half + 1]))
    start = 0 if top < half // 4 else top + half + half // 2
    start = min(start, max(len(whole) - 16 * half, 0))
    step = max(whole_down(fs / (3 * half_width)), 1)
    z = whole[start::step]
    quietest = whole[-max(len(whole) // 10, 8) :]
    tail = float(np.sqrt(np.mean(np.abs(quietest) ** 2)))
    tail = min(tail, _between_lines(whole[::step], taps, step))
    return DecaySignal(
        raw=x, fs=fs, centre_hz=centre, half_width_hz=half_width, taps=taps,
        moments=_moments(taps, fs), a0=float(np.abs(z[: max(len(z) // 200, 1)]).mean()), z=z,
        time=np.arange(len(z)) * step / fs, begins=(start + half) / fs, step_s=step / fs,
        quantum=converter_step(x), tail=max(tail, 1e-12 * float(size.max())), order=order,
    )  # fmt: skip


def _between_lines(z: Complexes, taps: Reals, step: int) -> float:
    r"""Return the noise amplitude in the last third of an envelope, without lines and modes.

    $$E|Z(f)|^2 = 4\sigma^2 |H(f)|^2 \sum w^2 / s, \qquad E|z|^2 = 4\sigma^2 \sum h^2$$

    where every s-th value is kept. The density is the median of the lines in the middle of the
    band; the result is infinite if these are too few.
    """
    late = z[-(len(z) // 3) :]
    window = np.hanning(len(late) + 2)[1:-1]
    freq = np.fft.fftfreq(len(late), step) if len(late) else np.zeros(0)
    response = np.abs(np.exp(2j * np.pi * np.outer(freq, np.arange(len(taps)))) @ taps)
    inner = response > HALF_GAIN
    if inner.sum() < FEWEST_LINES:
        return np.inf
    power = np.abs(np.fft.fft(late * window)) ** 2 / response**2 / np.sum(window**2)
    density = float(np.median(power[inner])) / np.log(2)
    return SAFE * float(np.sqrt(density * step * np.sum(taps**2)))


def _moments(taps: Reals, fs: float) -> Reals:
    """Return the even moments of a symmetric filter, sum h t^2k / (2k)!."""
    square = ((np.arange(len(taps)) - len(taps) // 2) / fs) ** 2
    k = np.arange(1, MOMENTS)
    factors = np.cumprod(np.append(1.0, 1 / (2 * k * (2 * k - 1))))
    return np.array([float(taps @ square**n) * factor for n, factor in enumerate(factors)])


def _log_response(signal: DecaySignal, pole: Complexes) -> tuple[Complexes, Complexes]:
    """Return the log of a filter's response to exp(s t), and its derivative with respect to s."""
    square = pole**2
    response, slope = np.full(len(pole), signal.moments[-1], complex), np.zeros(len(pole), complex)
    for moment in signal.moments[-2::-1]:
        slope = slope * square + response
        response = response * square + moment
    return np.log(response), 2 * pole * slope / response


def decay_model(
    signal: DecaySignal, theta: Reals, basis: AmplitudeBasis, scale: float, jump: Jump | None = None
) -> Complexes:
    """Return the filtered decay of a mode whose rate and frequency vary by powers of amplitude.

    `theta` contains ln a and phase at the start, the coefficients of the damping rate and of the
    frequency above the centre, both over `scale` [1/s], and the exponent.
    """
    none = np.full(len(signal.time), NO_MODEL * signal.a0 + 0j)
    if not np.all(np.isfinite(theta)) or not abs(theta[0] - np.log(signal.a0)) < 20:
        return none
    if basis.terms == 1:
        pole = (1j * theta[3] - theta[2]) * scale
        if not abs(pole.real) < _steepest(signal) or not pole.real * signal.time[-1] < 100:
            return none
        through = complex(_log_response(signal, np.array([pole]))[0][0])
        log = theta[0] + 1j * theta[1] + through + pole * signal.time
        if jump is not None:
            log = log + signal.filtered_step(jump.time_s) * (jump.growth + 1j * jump.turn)
        return np.exp(log)
    # The computed decay starts above the first amplitude and any jump, and ends below the noise.
    above = max(jump.growth, 0.0) + 0.05 if jump is not None else 0.0
    flow = _flow(signal, theta, basis, scale, above)
    if flow is None:
        return none
    course, logs = flow.course(), flow.logs
    if jump is None:
        return np.exp(course.at(signal.time) + 1j * theta[1])
    first = course.time_of(float(theta[0]))
    phase = 1j * (theta[1] - course.bare(first).imag)
    at = course.bare(min(jump.time_s + first, course.time[-1]))
    second = course.time_of(float(np.clip(at.real + jump.growth, logs[-1], logs[0])))
    phase_2 = phase + 1j * (at.imag + jump.turn - course.bare(second).imag)
    after = signal.filtered_step(jump.time_s)
    before = np.exp(course.at(signal.time + first) + phase)
    since = np.maximum(signal.time - jump.time_s + second, 0.0)
    later = np.where(after > 0, np.exp(course.at(since) + phase_2), 0)
    return before * (1 - after) + later * after


def decay_slopes(
    signal: DecaySignal, theta: Reals, basis: AmplitudeBasis, scale: float, model: Complexes
) -> Complex[np.ndarray, "value parameter"]:
    r"""Return the derivatives of a filtered decay with respect to `theta`; zero if it is invalid.

    $$\delta L = \sigma\,\delta t, \quad \delta t = \frac{\delta L_0}{\sigma(L_0)}
      - \int \frac{\delta\sigma}{\sigma^2}\,dL, \qquad
      \delta\varphi = \delta\varphi_0 - \omega\,\delta t
      + \frac{\omega(L_0)}{\sigma(L_0)}\,\delta L_0
      + \int \Big(\frac{\delta\omega}{\sigma} - \frac{\omega\,\delta\sigma}{\sigma^2}\Big) dL$$

    with L = ln a, plus the slope of the filter's response.

    Args:
        signal: From `decay_signal`.
        theta: Parameters as in `decay_model`.
        basis: Powers of the amplitude in rates and frequencies.
        scale: Unit of rates [1/s].
        model: Decay from `decay_model` for the same parameters.
    """
    slopes = np.zeros((len(model), len(theta)), complex)
    if basis.terms == 1:
        pole = np.array([(1j * theta[3] - theta[2]) * scale])
        along = (signal.time + _log_response(signal, pole)[1]) * scale
        ones = np.ones(len(model), complex)
        slopes[:] = np.stack([ones, 1j * ones, -along, 1j * along], axis=1)
        slopes *= model[:, None]
        return slopes
    if (flow := _flow(signal, theta, basis, scale)) is None:
        return slopes
    sigma, turn, step = flow.sigma, flow.turn, flow.step
    moved_t = _integral(-flow.by_sigma / sigma**2, step)
    moved_phase = _integral(flow.by_turn / sigma - turn * flow.by_sigma / sigma**2, step)
    moved_t[0], moved_phase[0] = 1 / sigma[0], turn[0] / sigma[0]
    moved = sigma * moved_t + 1j * (moved_phase - turn * moved_t)
    _, through_slope = _log_response(signal, flow.slope)
    along = np.gradient(flow.slope, -step) * sigma * moved_t
    moved += through_slope * (1j * flow.by_turn - flow.by_sigma + along)
    moved[1] = 1j
    time = flow.time
    for j, row in enumerate(moved):
        slopes[:, j] = np.interp(signal.time, time, row)
    slopes *= model[:, None]
    return slopes


def _steepest(signal: DecaySignal) -> float:
    """Return the damping rate above which the filter's moments are not accurate [1/s]."""
    return 300 * signal.fs / max(signal.half, 1)


class _Flow(NamedTuple):
    """The slow change of a decay over log amplitude: rates, their derivatives, and times [s]."""

    signal: DecaySignal
    logs: Reals
    step: float
    sigma: Reals
    turn: Reals
    by_sigma: Float[np.ndarray, "parameter knot"]
    by_turn: Float[np.ndarray, "parameter knot"]
    time: Reals

    @property
    def slope(self) -> Complexes:
        """The time derivative of ln a + j phase [1/s]."""
        rate: Any = 1j * self.turn - self.sigma
        return rate

    def course(self) -> "_Course":
        """Convert this decay from a function of log amplitude to a function of time."""
        through, _ = _log_response(self.signal, self.slope)
        phase = _integral(self.turn / self.sigma, self.step)
        return _Course(
            time=self.time, log=self.logs + 1j * phase, slope=self.slope, through=through,
            through_slope=np.gradient(through, self.time),
        )  # fmt: skip


def _flow(
    signal: DecaySignal, theta: Reals, basis: AmplitudeBasis, scale: float, above: float = 0.0
) -> _Flow | None:
    """Return rates and times of a decay against log amplitude; None if the decay is invalid."""
    terms = basis.terms
    own, turned = slice(2, 2 + terms), slice(2 + terms, 2 + 2 * terms)
    low = min(np.log(max(signal.tail, 1e-4 * signal.a0)) - 2.0, theta[0] - 3.0)
    logs = np.linspace(theta[0] + above, low, QUADRATURE)
    r = np.exp(logs) / signal.a0
    powers = basis.values(r, basis.exponent(theta)) * scale
    least = 0.02 * abs(theta[2]) * scale + 1e-9 * scale
    sigma, turn = theta[own] @ powers, theta[turned] @ powers
    falls = sigma > least
    sigma = np.where(falls, sigma, least)
    by_sigma, by_turn = np.zeros((2, len(theta), QUADRATURE))
    by_sigma[own], by_turn[turned] = powers * falls, powers
    if basis.is_free:
        by_power = np.arange(terms)[:, None] * powers * np.log(np.maximum(r, LEAST_RATIO))
        by_sigma[-1], by_turn[-1] = theta[own] @ by_power * falls, theta[turned] @ by_power
    step = float(logs[0] - logs[1])
    time = _integral(1 / sigma, step)
    if not np.all(np.diff(time) > 0) or sigma.max() > _steepest(signal):
        return None
    return _Flow(signal, logs, step, sigma, turn, by_sigma, by_turn, time)


class _Course(NamedTuple):
    """A decay over time: values of log a + j phase, their slopes, and the filter's response."""

    time: Reals
    log: Complexes
    slope: Complexes
    through: Complexes
    through_slope: Complexes

    def at(self, since: Reals) -> Complexes:
        """Return the logarithm of the filtered decay; beyond the last knot it is linear."""
        both = self.log + self.through, self.slope + self.through_slope
        late = np.maximum(since - self.time[-1], 0.0)
        return _hermite(self.time, *both, np.minimum(since, self.time[-1])) + late * self.slope[-1]

    def bare(self, since: float) -> complex:
        """Return the log amplitude + j phase of a decay at one time, before filtering."""
        return complex(_hermite(self.time, self.log, self.slope, np.array([since]))[0])

    def time_of(self, log_size: float) -> float:
        """Return the time at which a decay has a given log amplitude."""
        return float(np.interp(-log_size, -self.log.real, self.time))


def _hermite(knots: Reals, values: Complexes, slopes: Complexes, at: Reals) -> Complexes:
    i = np.clip(np.searchsorted(knots, at, "right") - 1, 0, len(knots) - 2)
    step = knots[i + 1] - knots[i]
    x = (at - knots[i]) / step
    rise = values[i + 1] - values[i]
    first, last = slopes[i] * step, slopes[i + 1] * step
    return values[i] + x * (
        first + x * (3 * rise - 2 * first - last + x * (first + last - 2 * rise))
    )


def _integral(values: Any, step: float) -> Any:
    """Return the running integral of each row by the end-corrected trapezoidal rule of order 4."""
    slope = np.gradient(values, step, axis=-1)
    pieces = step * (values[..., 1:] + values[..., :-1]) / 2
    pieces -= step**2 / 12 * (slope[..., 1:] - slope[..., :-1])
    return np.concatenate([np.zeros((*pieces.shape[:-1], 1)), np.cumsum(pieces, axis=-1)], axis=-1)


def fit_decay(
    signal: DecaySignal,
    name: str,
    start: Reals,
    scale: float,
    weight: Reals,
    cause: DecayCause | None = None,
) -> ModeFit:
    """Fit a mode to a decay, with a rate and a frequency that vary by given powers of amplitude.

    Args:
        signal: Decay from `decay_signal`.
        name: Name of the basis, one of `BASES`.
        start: Starting values, as `decay_model` takes them.
        scale: Unit of rates [1/s].
        weight: Weight of every value: one over its standard deviation.
        cause: Additional cause that may have shaped the record, such as a jump; fitted together
            with the mode.
    """
    basis, count = BASES[name], len(start)

    def model(theta: Reals) -> Complexes:
        if cause is None:
            return decay_model(signal, theta, basis, scale)
        more = theta[count:]
        if cause.apply is None:
            jump = Jump(
                float(np.clip(more[0], 0.0, 1.0)) * signal.time[-1],
                *np.clip(more[1:], -50, 50).tolist(),
            )
            return decay_model(signal, theta[:count], basis, scale, jump)
        return cause.apply(signal, decay_model(signal, theta[:count], basis, scale), more)

    def residual(theta: Reals) -> Reals:
        left = (signal.z - model(theta)) * weight
        return np.concatenate([left.real, left.imag])

    def slopes_at(theta: Reals) -> Any:
        alone = decay_model(signal, theta[:count], basis, scale)
        slopes = list(decay_slopes(signal, theta[:count], basis, scale, alone).T)
        if cause is not None and cause.apply is not None:
            slopes += slopes_of_cause(partial(cause.apply, signal, alone), theta[count:])
        weighted = -np.stack(slopes, axis=1) * weight[:, None]
        return np.concatenate([weighted.real, weighted.imag])

    jac: Any = "2-point" if cause is not None and cause.apply is None else slopes_at
    begin = np.concatenate([start, cause.start]) if cause is not None else np.array(start, float)
    lower, upper = np.full(len(begin), -np.inf), np.full(len(begin), np.inf)
    if basis.terms == 1:  # A free motion decays, although beating may look like growth.
        lower[2], begin[2] = LEAST_FALL, max(begin[2], 2 * LEAST_FALL)
    if basis.is_free:
        at = count - 1
        lower[at], upper[at] = (-1.2, 5.0) if basis.terms == 2 else (0.2, 2.2)
        begin[at] = np.clip(begin[at], lower[at] + 0.05, upper[at] - 0.05)
    near = FULLY if cause is None else NEAR_BEST
    found: Any = least_squares(
        residual,
        begin,
        jac,
        bounds=(lower, upper),
        method="trf",
        x_scale="jac",
        max_nfev=40,
        ftol=near,
        xtol=near,
    )
    size = len(signal.z)
    jacobian = -(found.jac[:size] + 1j * found.jac[size:]) / weight[:, None]
    left = signal.z - model(found.x)
    return ModeFit(found.x, left, jacobian, float(np.sum(np.abs(left * weight) ** 2)))


class DecayFits(NamedTuple):
    """A decay, cut where its noise begins, and its fits with each set of powers of amplitude.

    Attributes:
        signal: Values that were fitted.
        fits: Fit of each basis, by name.
        scale: Unit of rates [1/s].
        weight: Weight of every value.
        noise: Noise amplitude in the band.
        faded: Amplitude below which the converter shows nothing.
        KIND: Kind of the record.
        FIRST: Index of the first damping rate in theta.
        SECOND_ORDER: Factor c of the error of first-order averaging, see `table`.
        FLOOR: Smallest error of the frequency, over zeta.
    """

    signal: DecaySignal
    fits: dict[str, ModeFit]
    scale: float
    weight: Reals
    noise: float
    faded: float

    KIND = "decay"
    FIRST = 2
    SECOND_ORDER = 3e-3
    FLOOR = 0.003


def fit_bases(signal: DecaySignal) -> DecayFits:
    """Fit a mode to a decay with each set of powers of the amplitude; estimate the noise first."""
    scale, turn = signal.first()
    noise = max(signal.tail, 1e-9 * signal.a0)
    half_step = 0.5 * signal.quantum

    def weight_at(size: Reals) -> Reals:
        own = min(noise, 0.3 * signal.a0) ** 2 + QUANTUM_NOISE * half_step**2
        return 1 / np.sqrt(own + (LAW_ERROR * size) ** 2)

    # There are three starts: the mean frequency and damping rate; those of the first values; the
    # strongest spectral line. Beating modes or steady lines can mislead one of the starts.
    begun = signal.until(max(int(np.argmax(signal.size < 0.5 * signal.size[0])), 3) + 1)
    rate = max(float(np.log(begun.size[0] / begun.size[-1])) / begun.time[-1], scale)
    initial = float(np.angle(np.vdot(begun.z[:-1], begun.z[1:]))) / signal.step_s
    starts = (scale, turn), (rate, initial), (scale, strongest_line(signal.z, signal.step_s)[0])
    level, phase = np.log(signal.size[0]), np.angle(signal.z[0])
    begins = [[level, phase, *(np.array(start) / scale)] for start in starts]

    weight = weight_at(signal.size)
    tried = [fit_decay(signal, "linear", np.array(begin), scale, weight) for begin in begins]
    linear = min(tried, key=lambda fit: fit.squares)
    decaying = [fit for fit in tried if _decays(fit, scale, signal)]
    if decaying and not _decays(linear, scale, signal):
        # A steady line outlasts the mode and was fitted in its place, so it counts as noise.
        noise = float(np.sqrt(np.mean(signal.size[-max(len(signal.z) // 10, 8) :] ** 2)))
        signal = replace(signal, tail=noise)
        linear = min(decaying, key=lambda fit: fit.squares)
        linear = fit_decay(signal, "linear", linear.theta, scale, weight_at(signal.size))
    size = signal.size
    for _ in range(2):
        size = np.abs(decay_model(signal, linear.theta, BASES["linear"], scale))
        quiet = size < 0.5 * noise
        if quiet.sum() > 8:
            left = float(np.sqrt(np.mean(np.abs(linear.residual[quiet]) ** 2)))
            # Noise is at most the level at the record's end, however large the residual of a single
            # mode is.
            noise = max(min(left, signal.tail), 1e-12 * signal.a0)
        else:
            late = np.abs(linear.residual[-max(len(size) // 5, 4) :])
            noise = max(min(noise, float(np.sqrt(np.mean(late**2)))), 1e-9 * signal.a0)
    ends = int(np.searchsorted(-size, -max(QUIETEST * noise, FADED * half_step)))
    # The model of a single mode may have decayed while two beating modes continue.
    loud = np.flatnonzero(signal.size > max(LOUD * noise, FADED * half_step))
    signal = signal.until(max(ends, FEWEST_KEPT, int(loud[-1]) + 1 if loud.size else 0))
    weight = weight_at(size[: len(signal.z)])
    straight = fit_decay(signal, "linear", linear.theta, scale, weight)
    fits = {"linear": straight}
    if len(signal.z) >= FEWEST_POWERS:
        fits |= _powers(signal, straight, scale, weight)
    return DecayFits(signal, fits, scale, weight, noise, half_step)


def _decays(linear: ModeFit, scale: float, signal: DecaySignal) -> bool:
    """Return whether the amplitude of a fitted linear mode falls below 1/e within the record."""
    return bool(linear.theta[2] * scale * signal.time[-1] > 1)


def _powers(
    signal: DecaySignal, linear: ModeFit, scale: float, weight: Reals
) -> dict[str, ModeFit]:
    """Fit more and more powers of the amplitude while the residual decreases."""
    level, phase, sigma, turn = linear.theta

    def fitted(name: str, start: list[float]) -> ModeFit:
        return fit_decay(signal, name, np.array(start), scale, weight)

    begin = [level, phase, sigma, 0.0, turn, 0.0]
    power = min((fitted("power", [*begin, p]) for p in (1.0, 2.0)), key=lambda fit: fit.squares)
    start = [level, phase, sigma, 0.0, 0.0, turn, 0.0, 0.0]
    fits = {"power": power, "quadratic": fitted("quadratic", start)}
    if power.squares < WORTH_A_TERM * linear.squares:
        one = power.theta.tolist()
        second = fitted("power2", [*one[:4], 0.0, *one[4:6], 0.0, one[6]])
        fits |= {"power2": second}
        if second.squares < WORTH_A_TERM * power.squares and len(signal.z) > FEWEST_KEPT:
            two = second.theta.tolist()
            fits |= {"power3": fitted("power3", [*two[:5], 0.0, *two[5:8], 0.0, two[8]])}
    return fits
