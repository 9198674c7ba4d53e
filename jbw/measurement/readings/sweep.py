r"""A mode passed by a sweep, modelled as a linear filter of the drive that varies with time.

In the frame of the drive's phase $\phi(t)$ the mode's complex amplitude follows

$$\dot z = (i\omega(a) - \sigma(a) - i\dot\phi)\,z + g u$$

with the amplitude a of the motion *given*: the measured one, smoothed by the model. The equation is
then linear, a trial of $\omega$ and $\sigma$ takes two bidiagonal solves, and gains are projected
out. A jump between branches does no harm, because no amplitude is integrated; the phase is that of
the joint.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex
from scipy.linalg import lapack
from scipy.optimize import least_squares
from scipy.signal import fftconvolve, firwin

from jbw.measurement.channels import Complexes, Reals, whole_down
from jbw.measurement.readings.slow_flow import (
    BASES,
    FULLY,
    LEAST_RATIO,
    NEAR_BEST,
    ModeFit,
    converter_step,
    filtered_step,
    slopes_of_cause,
)  # fmt: skip

# relative error of the model for a sound joint, from averaging and from truncated powers
LAW_ERROR = 3e-3
# This function solves a triangular band; SciPy's stubs do not list it.
SOLVE: Any = vars(lapack)["ztbtrs"]
DRIVEN = 0.2  # Below this fraction of its largest amplitude, the drive excites nothing.
# A further power of the amplitude is kept if it reduces the sum of squares to at most this
# fraction.
WORTH_A_TERM = 0.9
# Above this multiple of the noise, the filter uses the measured amplitude; below it, that of the
# model.
CLEAR = 30.0
IN_PHASE = (1, 3, 5)  # imaginary parts of the gains of the mode and of modes outside the band
# limits of the ratio of the motion to (response / frequency^order) in free vibration of the mode
MODES_OWN = (0.5, 2.0)

Columns = Complex[np.ndarray, "value column"]
Slopes = Complex[np.ndarray, "value slope"]


class SweepCause(NamedTuple):
    """An additional cause of a sweep's response, fitted together with the mode.

    Attributes:
        start: Starting values of the parameters.
        apply: Function of signal, columns of the model and parameters that returns the columns with
            the cause: each column after the same linear map, followed by columns of the cause.
    """

    start: Reals
    apply: Callable[["SweepSignal", Columns, Reals], Columns]


@dataclass(frozen=True)
class SweepSignal:
    """Drive and response of a sweep, filtered, thinned, and rotated by the drive's phase.

    Attributes:
        raw: Samples of the response.
        fs: Sampling frequency [Hz].
        centre_hz: Centre of the retained band [Hz].
        taps: Impulse response of the filter, with sum 1.
        time: Times of the values [s].
        u: Drive in its own frame, where it is real and slow.
        z: Response in the frame of the drive.
        phase: Phase of the drive [rad].
        rate: Frequency of the drive [rad/s].
        step_s: Time between two values [s].
        quantum: Step of the response's converter.
        order: Order of the derivative of displacement that the response is.
        lag_s: Stated lag of the response [s].
        is_force: Whether the drive is the force itself, in phase with the force on the mode.
        amplitude: Amplitude of the motion, in the unit of the response at resonance; the filter
            varies with it.
        a0: Largest value of `amplitude`.
        unit: Factor from the unit of the response to that of the record.
        drive_unit: Factor from the unit of the drive to that of the record.
    """

    raw: Reals
    fs: float
    centre_hz: float
    taps: Reals
    time: Reals
    u: Complexes
    z: Complexes
    phase: Reals
    rate: Reals
    step_s: float
    quantum: float
    order: int
    lag_s: float
    is_force: bool
    amplitude: Reals
    a0: float
    unit: float = 1.0
    drive_unit: float = 1.0

    @property
    def top(self) -> int:
        """The index of the value with the largest motion."""
        return int(np.argmax(np.abs(self.z) / self.rate**self.order))

    @property
    def mean_period_s(self) -> float:
        """The period of the drive at the middle of the sweep [s]."""
        return float(2 * np.pi / np.median(self.rate))

    def filtered_step(self, at_s: float) -> Reals:
        """Return the filtered signal of a unit step at a given time [s]."""
        return filtered_step(self.taps, (self.time - at_s) * self.fs)

    def at_amplitude(self, amplitude: Reals) -> "SweepSignal":
        """Return the sweep with new amplitudes of motion, on which the fitted mode depends."""
        return replace(self, amplitude=amplitude)


def sweep_signal(
    u: Reals,
    y: Reals,
    fs: float,
    band_hz: tuple[float, float],
    order: int,
    *,
    lag_s: float = 0.0,
    is_force: bool = True,
) -> SweepSignal:
    """Filter drive and response about a band and rotate both back by the drive's phase.

    Args:
        u: Samples of the drive.
        y: Samples of the response.
        fs: Sampling frequency [Hz].
        band_hz: Lowest and highest frequency of the retained band [Hz].
        order: Order of the derivative of displacement that the response is.
        lag_s: Stated lag of the response [s].
        is_force: Whether the drive is a force; a voltage is out of phase with the force.
    """
    low, high = band_hz
    centre, half_width = 0.5 * (low + high), 0.5 * (high - low)
    edge = 0.5 * min(half_width, low)  # The filter is flat up to the edges of the band.
    num_taps = min(whole_down(7.3 * fs / edge) | 1, (len(u) // 8) | 1)
    cutoff = min(half_width + 0.2 * edge, 0.999 * fs / 2)
    window: Any = ("kaiser", 6.5)
    taps = np.asarray(firwin(num_taps, cutoff, window=window, fs=fs), float)
    carrier = np.exp(-2j * np.pi * centre / fs * np.arange(len(u)))
    every = max(whole_down(fs / (5.2 * half_width)), 1)
    time = (np.arange(len(u) - num_taps + 1)[::every] + num_taps // 2) / fs
    turn = np.exp(2j * np.pi * centre * time)
    drive, response = (2 * fftconvolve(x * carrier, taps, "valid")[::every] * turn for x in (u, y))
    loud = np.flatnonzero(np.abs(drive) > DRIVEN * np.abs(drive).max())
    kept = slice(int(loud[0]), int(loud[-1]) + 1)
    drive, response, time = drive[kept], response[kept], time[kept]
    slow = np.unwrap(np.angle(drive * np.exp(-2j * np.pi * centre * time)))
    phase = slow + 2 * np.pi * centre * time
    back = np.exp(-1j * phase)
    step_s = every / fs
    width = max(len(phase) // 200, 3) | 1
    rate = np.gradient(phase, step_s)
    rate = np.convolve(np.pad(rate, width // 2, "edge"), np.ones(width) / width, "valid")
    z = response * back
    size = np.abs(z)
    top = int(np.argmax(size / rate**order))
    motion = size * (rate[top] / rate) ** order
    return SweepSignal(
        raw=y, fs=fs, centre_hz=centre, taps=taps, time=time, u=drive * back, z=z,
        phase=phase, rate=rate, step_s=step_s, quantum=converter_step(y), order=order,
        lag_s=lag_s, is_force=is_force, amplitude=motion, a0=float(np.quantile(motion, 0.999)),
    )  # fmt: skip


def sweep_columns(
    signal: SweepSignal, pole: Complexes, mirror: Complexes, slopes: Slopes | None = None
) -> tuple[Columns, Complex[np.ndarray, "value pair"], Reals]:
    r"""Return the columns of a sweep whose mode has the pole $p = -\sigma + i\omega$.

    $$\dot s = (p - i\dot\phi)\,s + u, \qquad
      y = \frac{p^m s - \bar p^m \bar s_-}{2 i \omega}, \qquad
      \dot s' = (p - i\dot\phi)\,s' + p' s$$

    with the part s_- of the conjugate pole, the m-th derivative y of the displacement, and the
    derivative s' with respect to a parameter that changes the pole by p'.

    Args:
        signal: Sweep from `sweep_signal`.
        pole: Pole of the mode at every time [1/s].
        mirror: Part of the conjugate pole, from `mirror_of`.
        slopes: Derivatives of the pole, one column per parameter; None without parameters.

    Returns:
        Columns with unknown gains: the response of the mode to the drive, of modes outside the band
        (two columns), and to an initial state; the derivatives of the first and last column, in
        pairs for each parameter; and the amplitude of the motion, divided by that of the response.
    """
    if slopes is None:
        slopes = np.zeros((len(pole), 0), complex)
    u, order = signal.u, signal.order
    growth, first, second, first_slope, second_slope = _moments(signal, pole)
    state = _marched(growth, np.append(0.0, _forced(signal, first, second)))
    moved = growth * state[:-1] + _forced(signal, first_slope, second_slope)
    moves = _middle(slopes) * signal.step_s
    none = np.zeros((1, slopes.shape[1]))
    states = _marched(growth, np.concatenate([none, moves * moved[:, None]]))
    power, omega = pole**order, pole.imag
    main = (power * state - np.conj(power) * mirror) / (2j * omega)
    with np.errstate(divide="ignore", invalid="ignore"):
        motion = np.abs(state - mirror) / np.abs(main * 2 * omega)
    free = power * np.cumprod(np.append(1.0, growth))
    free = free / (np.abs(free).max() + 1e-300)
    # Modes outside the band follow the drive, with displacements in phase with it.
    away = signal.rate / signal.rate.mean() - 1
    beyond = (1j * signal.rate / signal.rate.mean()) ** order * u
    columns = np.stack([main, beyond, beyond * away, free], axis=1)
    turned = order * pole ** max(order - 1, 0)
    of_main = (turned * state)[:, None] * slopes - (np.conj(turned) * mirror)[
        :, None
    ] * slopes.conj()
    of_main = (of_main + power[:, None] * states) / (2j * omega)[:, None]
    of_main -= (main / omega)[:, None] * np.imag(slopes)
    grown = np.concatenate([none, np.cumsum(moves, axis=0)]) + order * slopes / pole[:, None]
    both = np.stack([of_main, free[:, None] * grown], axis=2).reshape(len(pole), -1)
    if signal.lag_s:
        columns, both = (late(x, signal.rate, signal.lag_s) for x in (columns, both))
    return columns, both, np.nan_to_num(motion, nan=0.0, posinf=0.0)


def mirror_of(signal: SweepSignal, pole: Complexes) -> Complexes:
    """Return the response of the conjugate pole, which is nearly equal for all similar poles."""
    growth, first, second, *_ = _moments(signal, np.conj(pole))
    begins = signal.u[0] / (1j * signal.rate[0] - np.conj(pole[0]))
    return _marched(growth, np.append(begins, _forced(signal, first, second)))


def _middle(values: Any) -> Any:
    return 0.5 * (values[1:] + values[:-1])


def late(columns: Columns, rate: Reals, lag_s: Any) -> Columns:
    """Return response columns delayed by a lag [s], which is constant or given for every time."""
    return columns * np.exp(-1j * rate * lag_s)[:, None]


def _moments(signal: SweepSignal, pole: Complexes) -> tuple[Complexes, ...]:
    """Return exp(x), the integrals of exp(x s) and (1 - s) exp(x s), and slopes, safe at zero.

    x is the change of the logarithm of a state in each step.
    """
    x = _middle(pole) * signal.step_s - 1j * np.diff(signal.phase)
    growth = np.exp(x)
    is_small = np.abs(x) < 1e-4
    safe = np.where(is_small, 1.0, x)
    first = np.where(is_small, 1 + x / 2, (growth - 1) / safe)
    second = np.where(is_small, 0.5 + x / 6, (first - 1) / safe)
    first_slope = np.where(is_small, 0.5 + x / 3, (growth - first) / safe)
    second_slope = np.where(is_small, 1 / 6 + x / 12, (first_slope - second) / safe)
    return growth, first, second, first_slope, second_slope


def _forced(signal: SweepSignal, first: Complexes, second: Complexes) -> Complexes:
    """Return the drive's contribution to each time step; the drive is linear within a step."""
    u = signal.u
    return signal.step_s * (u[:-1] * (first - second) + u[1:] * second)


def _marched(growth: Complexes, right: Any) -> Any:
    """Solve the recursion z[n] = growth[n - 1] z[n - 1] + right[n] for each column."""
    if not right.size:
        return right
    bands = np.ones((2, len(right)), complex)
    bands[1, :-1], bands[1, -1] = -growth, 0.0
    return np.asarray(SOLVE(bands, right, uplo="L", diag="U")[0]).reshape(right.shape)


def fit_sweep(
    signal: SweepSignal,
    name: str,
    start: Reals,
    scale: float,
    weight: Reals,
    cause: SweepCause | None = None,
) -> ModeFit:
    """Fit a mode to a sweep, with a rate and a frequency that vary by given powers of amplitude.

    If the drive is a force, all gains except that of the initial state are real.

    Args:
        signal: Sweep from `sweep_signal`.
        name: Name of the basis, one of `BASES`.
        start: Coefficients of the damping rate and of the frequency above the centre, both over
            `scale`; then the exponent.
        scale: Unit of rates [1/s].
        weight: Weight of every value: one over its standard deviation.
        cause: Additional cause that may have shaped the record.
    """
    basis, count = BASES[name], len(start)
    mirror = mirror_of(signal, pole_of(signal, np.asarray(start, float), name, scale)[0])
    kept: Any = []  # the last evaluation, reused for the derivative at the same point

    def projected(theta: Reals) -> Projected:
        if not kept or not np.array_equal(kept[0], theta):
            pole, slopes = pole_of(signal, theta[:count], name, scale)
            columns, slopes, _ = sweep_columns(signal, pole, mirror, slopes)
            kept[:] = theta.copy(), _project(signal, columns, slopes, theta[count:], weight, cause)
        return kept[1]

    def residual(theta: Reals) -> Reals:
        left, _, _ = projected(theta)
        return np.concatenate([left.real, left.imag])

    def slopes_at(theta: Reals) -> Any:
        _, _, slopes_of = projected(theta)
        slopes = slopes_of()
        return np.concatenate([np.real(slopes), np.imag(slopes)])

    begin = np.concatenate([start, cause.start]) if cause is not None else np.array(start, float)
    lower, upper = np.full(len(begin), -np.inf), np.full(len(begin), np.inf)
    if basis.is_free:
        at = count - 1
        lower[at], upper[at] = (0.2, 4.0) if basis.terms == 2 else (0.2, 2.2)
        begin[at] = np.clip(begin[at], lower[at] + 0.05, upper[at] - 0.05)
    near = FULLY if cause is None else NEAR_BEST
    jac: Any = slopes_at  # SciPy's stubs do not accept a function here
    found: Any = least_squares(
        residual, begin, jac, bounds=(lower, upper), x_scale="jac", max_nfev=30,
        ftol=near, xtol=near,
    )  # fmt: skip
    left, gains, slopes_of = projected(found.x)
    return ModeFit(
        found.x, left / weight, -slopes_of() / weight[:, None],
        float(np.sum(np.abs(left) ** 2)), gains,
    )  # fmt: skip


# a model whose gains are eliminated: residual, gains, and a function of the residual's derivatives
Projected = tuple[Complexes, Complexes, Callable[[], Slopes]]


def _project(
    signal: SweepSignal,
    columns: Columns,
    slopes: Slopes,
    values: Reals,
    weight: Reals,
    cause: SweepCause | None,
) -> Projected:
    r"""Solve for the gains c of the columns, some of which are real; return the residual with them.

    $$r = y - \Phi c, \quad \Phi^T r = 0, \qquad
      r' = -\Phi' c - \Phi G^{-1} (\Phi'^T r - \Phi^T \Phi' c), \quad G = \Phi^T \Phi$$

    with real and imaginary parts as separate rows. Gains of a force that act in phase with it are
    real.
    """
    number = columns.shape[1]

    def with_cause(columns: Columns, slopes: Slopes, values: Reals) -> tuple[Columns, Slopes]:
        if cause is None:
            return columns, slopes
        out = cause.apply(signal, np.concatenate([columns, slopes], axis=1), values)
        own = number + slopes.shape[1]
        return np.delete(out, slice(number, own), axis=1), out[:, number:own]

    plain = columns
    columns, slopes = with_cause(columns, slopes, values)
    size: Any = np.linalg.norm(columns * weight[:, None], axis=0) + 1e-300
    columns = columns * (weight[:, None] / size)
    target = signal.z * weight
    at, turn = np.repeat(np.arange(len(size)), 2), np.tile([1.0, 1j], len(size))
    if signal.is_force:
        at, turn = np.delete(at, IN_PHASE), np.delete(turn, IN_PHASE)
    inner = np.real(np.outer(turn.conj(), turn) * (columns.conj().T @ columns)[np.ix_(at, at)])
    # This prevents a singular matrix if columns coincide.
    inner[np.diag_indices_from(inner)] += 1e-12

    def along(columns: Columns, values: Complexes) -> Reals:
        """Return derivatives of the fit with respect to real and imaginary parts of the gains."""
        return np.real(turn.conj() * (columns.conj().T @ values)[at])

    def gains_of(right: Reals) -> Complexes:
        sums = np.zeros(len(size), complex)
        np.add.at(sums, at, turn * np.linalg.solve(inner, right))
        return sums

    gains = gains_of(along(columns, target))
    left = target - columns @ gains

    def moved(by: Columns) -> Complexes:
        """Return the change of the residual if the columns change by `by`; refit the gains."""
        change = by @ gains
        return -change - columns @ gains_of(along(by, left) - along(columns, change))

    def slopes_of() -> Slopes:
        found = []
        for j in range(0, slopes.shape[1], 2):
            by = np.zeros(columns.shape, complex)
            for at, slope in ((0, slopes[:, j]), (number - 1, slopes[:, j + 1])):
                by[:, at] = slope * weight / size[at]
            found.append(moved(by))
        if cause is not None:
            there = slopes_of_cause(lambda x: with_cause(plain, plain[:, :0], x)[0], values)
            found += [moved(by * weight[:, None] / size) for by in there]
        return np.stack(found, axis=1)

    return left, gains / size, slopes_of


def pole_of(signal: SweepSignal, theta: Reals, name: str, scale: float) -> tuple[Complexes, Slopes]:
    """Return a mode's pole [1/s] at every time, and its derivatives with respect to parameters."""
    basis = BASES[name]
    r = np.maximum(signal.amplitude / signal.a0, LEAST_RATIO)
    powers = basis.values(r, basis.exponent(theta)).T * scale
    terms = basis.terms
    sigma = powers @ theta[:terms]
    falls = sigma > 1e-3 * scale
    weights = 1j * theta[terms : 2 * terms] - np.outer(falls, theta[:terms])
    pole: Any = np.where(falls, -sigma, -1e-3 * scale) + 1j * (
        powers @ theta[terms : 2 * terms] + 2 * np.pi * signal.centre_hz
    )
    slopes = [-powers * falls[:, None], 1j * powers]
    if basis.is_free:  # derivative of r^(k p) with respect to p
        of_exponent = np.sum(powers * weights * np.arange(terms), axis=1) * np.log(r)
        slopes.append(of_exponent[:, None])
    return pole, np.concatenate(slopes, axis=1)


class SweepFits(NamedTuple):
    """A sweep, the amplitudes of motion at which its mode is evaluated, and its fits.

    Attributes:
        signal: Sweep with the amplitude on which the filter depends.
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

    signal: SweepSignal
    fits: dict[str, ModeFit]
    scale: float
    weight: Reals
    noise: float
    faded: float

    KIND = "sweep"
    FIRST = 0
    SECOND_ORDER = 0.05  # larger than for a decay: the amplitude changes faster in a sweep
    FLOOR = 0.01


def fit_bases(signal: SweepSignal) -> SweepFits:
    """Fit a mode to a sweep with each set of powers of amplitude; update the motion's amplitude."""
    top, order = signal.top, signal.order
    motion = (signal.rate[top] / signal.rate) ** order
    size = np.abs(signal.z)
    linear, scale = _linear_start(signal, top)
    fits: dict[str, ModeFit] = {}
    weight = np.ones(len(size)) / signal.a0
    noise = 0.0
    rounds = 3 if order else 2
    for number in range(rounds):
        linear = fit_sweep(signal, "linear", linear.theta, scale, weight)
        best = next((n for n in ("power3", "power2", "power") if n in fits), None)
        residual = linear.residual if best is None else fits[best].residual
        noise = float(np.sqrt(np.median(np.abs(residual) ** 2) / np.log(2)))
        noise = max(noise, 1e-9 * signal.a0)
        amplitude = size * motion
        weight = 1 / np.sqrt(noise**2 + (LAW_ERROR * amplitude) ** 2)
        # A ringing response has another frequency than the drive.
        if best is not None and order:
            pole, _ = pole_of(signal, fits[best].theta, best, scale)
            _, _, own = sweep_columns(signal, pole, mirror_of(signal, pole))
            own = own * signal.rate[top] ** order
            motion = np.clip(own, MODES_OWN[0] * motion, MODES_OWN[1] * motion)
            amplitude = size * motion
        smooth = np.abs(signal.z - residual) * motion
        signal = signal.at_amplitude(np.where(amplitude > CLEAR * noise, amplitude, smooth))
        fits = _bases(signal, linear, fits, scale, weight)
        linear = fits["linear"]
        if number == rounds - 1:
            sigma, turn = linear.theta.tolist()
            start = np.array([sigma, 0.0, 0.0, turn, 0.0, 0.0])
            fits["quadratic"] = fit_sweep(signal, "quadratic", start, scale, weight)
    return SweepFits(signal, fits, scale, weight, noise, 2 * signal.quantum)


def _linear_start(signal: SweepSignal, top: int) -> tuple[ModeFit, float]:
    """Fit a linear mode near the largest motion from many starts; return it and its rate [1/s]."""
    above = signal.amplitude > signal.amplitude[top] / np.sqrt(2)
    width = max(abs(float(np.ptp(signal.rate[above]))), 1e-6 * float(signal.rate[top]))
    at_top = signal.rate[top] - 2 * np.pi * signal.centre_hz
    weight = np.ones(len(signal.z)) / signal.a0
    trials = [
        (fit_sweep(signal, "linear", np.array([1.0, at_top / rate + shift]), rate, weight), rate)
        for rate in (width / 8, width / 2)
        for shift in (-1.0, 0.0, 1.0)
    ]
    best, rate = min(trials, key=lambda trial: trial[0].squares)
    scale = abs(rate * best.theta[0]) or rate
    theta = np.array([np.sign(best.theta[0]), best.theta[1] * rate / scale])
    return best._replace(theta=theta), scale


def _bases(
    signal: SweepSignal,
    linear: ModeFit,
    before: Mapping[str, ModeFit],
    scale: float,
    weight: Reals,
) -> dict[str, ModeFit]:
    """Fit more and more powers of the amplitude, each starting from the previous round.

    Each next basis is tried only while the residual decreases.
    """

    def fitted(name: str, *starts: list[float]) -> ModeFit:
        begun = [before[name].theta.tolist()] if name in before else starts
        ends = [fit_sweep(signal, name, np.array(start), scale, weight) for start in begun]
        return min(ends, key=lambda fit: fit.squares)

    straight = fit_sweep(signal, "linear", linear.theta, scale, weight)
    sigma, turn = straight.theta.tolist()
    first = fitted("power", *([sigma, 0.0, turn, 0.0, p] for p in (1.0, 2.0)))
    fits = {"linear": straight, "power": first}
    if first.squares < WORTH_A_TERM * straight.squares:
        one = first.theta.tolist()
        second = fitted("power2", [*one[:2], 0.0, *one[2:4], 0.0, one[4]])
        fits |= {"power2": second}
        if second.squares < WORTH_A_TERM * first.squares:
            two = second.theta.tolist()
            fits |= {"power3": fitted("power3", [*two[:3], 0.0, *two[3:6], 0.0, two[6]])}
    return fits
