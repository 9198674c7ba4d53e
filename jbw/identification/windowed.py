"""The effect of a window on an oscillator's FRF: its smeared mean, and correlated errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from jbw.measurement.spectra import FRF
from jbw.quantities import derivative_order

HALF_WIDTH = 32  # number of bins of the window's transform, on each side, that are used
NEIGHBOURS = 6  # Errors of spectral lines that are farther apart than this are independent.

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]
Modes = Sequence[tuple[float, float, float]]  # (omega_n, zeta, gain) of each mode


def receptance(omega: Real, omega_n: float, zeta: float, gain: float) -> Complex:
    """Return the receptance of an oscillator, gain / (omega_n^2 - omega^2 + 2j zeta omega_n omega).

    It is displacement per unit of input [m per unit], with omega [rad/s] and gain [N/kg per unit].

    Reference:
        Eq. (23).
    """
    return gain / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)


def smeared(
    omega: Real, omega_n: float, zeta: float, gain: float, window_s: float, order: int
) -> Complex:
    r"""Return the expected H1 estimate of a mode's measured response (Hann windows, white input).

    $$\mathrm{E}\,\hat H(\omega) = \int_0^T h(\tau)\,w_a(\tau)\,e^{-j\omega\tau}\,\mathrm{d}\tau,
      \qquad h = \frac{\mathrm{d}^p}{\mathrm{d}\tau^p}
      \frac{g\,(e^{s\tau} - e^{\bar s\tau})}{2j\omega_d},\quad
      w_a = \Big(1-\frac\tau T\Big)\frac{2+\cos(2\pi\tau/T)}{3} + \frac{\sin(2\pi\tau/T)}{2\pi}$$

    with s = -zeta omega_n + j omega_d, zeta < 1: this is the receptance convolved with |W|^2, in
    closed form. T is `window_s` [s]; p, the `order`, is 0 for a receptance, 1 for mobility, 2 for
    accelerance.
    """
    omega_d = omega_n * np.sqrt(1 - zeta**2)
    s = -zeta * omega_n + 1j * omega_d
    mean = s**order * _hann_transform(s - 1j * omega, window_s)
    mean = mean - s.conjugate() ** order * _hann_transform(s.conjugate() - 1j * omega, window_s)
    direct = gain if order == 2 else 0.0  # immediate response of an acceleration to an impulse
    return direct + gain / (2j * omega_d) * mean


def _hann_transform(p: Complex, window_s: float) -> Complex:
    """Return the integral from 0 to T of exp(p tau) w_a(tau)."""
    turn = 2j * np.pi / window_s

    def ramp(q: Complex) -> Complex:  # integral of (1 - tau / T) exp(q tau)
        x = q * window_s
        return window_s * (np.exp(x) - 1 - x) / x**2

    def flat(q: Complex) -> Complex:  # integral of exp(q tau)
        return (np.exp(q * window_s) - 1) / q

    ramps = 4 * ramp(p) + ramp(p + turn) + ramp(p - turn)
    return ramps / 6 + (flat(p + turn) - flat(p - turn)) / (4j * np.pi)


@dataclass(frozen=True)
class LineErrors:
    """Second moments of the errors d of FRF lines, between outputs and neighbouring lines.

    Axes are (output, output, 2 NEIGHBOURS + 1, line), with the distance q in ascending order. The
    first output is that of line i, the second that of line i + q.
    """

    hermitian: Complex  # E[d_i conj(d_{i+q})]
    symmetric: Complex  # E[d_i d_{i+q}], which leakage makes differ from zero

    @property
    def variance(self) -> Real:
        """The variance E|d_i|^2 of each line, output by output."""
        outputs = range(len(self.hermitian))
        middle = self.hermitian.shape[2] // 2
        return np.concatenate([np.abs(self.hermitian[o, o, middle]) for o in outputs])

    def of_sum(self, weights: Complex) -> Real:
        """Return the covariance of parameters that are sums Re sum_i G_ai d_i of line errors."""
        total = np.zeros((len(weights), len(weights)), complex)
        reach = self.hermitian.shape[2] // 2
        num_lines = self.hermitian.shape[-1]
        by_output = np.split(weights, len(self.hermitian), axis=-1)
        for q in range(-reach, reach + 1):
            i = np.arange(max(0, -q), min(num_lines, num_lines - q))
            for (a, ours), (b, others) in product(enumerate(by_output), repeat=2):
                mine, theirs = ours[:, i], others[:, i + q]
                total += (mine * self.hermitian[a, b, q + reach, i]) @ theirs.conj().T
                total += (mine * self.symmetric[a, b, q + reach, i]) @ theirs.T
        return np.real(total + total.T) / 4


def line_errors(
    outputs: Sequence[FRF], noise_ratio: Real, modes: Sequence[Modes], leakage: bool
) -> LineErrors:
    r"""Estimate the covariance of errors between neighbouring lines of H1 estimates.

    For Gaussian input and noise, the error of a line is sum_k R_k conj(U_k) / sum_k |U_k|^2, where
    R_k is the part of segment k's response that H times its input does not explain. Hence

    $$\mathrm{E}[d_i \bar d_j] = \sum_m \frac{K-|m|}{K^2}\,
      \frac{\mathrm{E}[R_k(i)\bar R_{k+m}(j)]\,\mathrm{E}[\bar U_k(i)U_{k+m}(j)]}{S_{uu}^2}$$

    R contains leakage through the window (known from the modes), noise of the sensor (white in the
    measured response) and disturbing forces (white, through the modes); the levels of the last two
    are estimated from the coherence. If both are far below the leakage, they are overestimated, and
    with them the errors of omega_n and gain (not of zeta). Outputs of one input share the leakage
    and the disturbing forces; the noise of their sensors is independent.

    The `outputs` have the same, evenly spaced lines under a Hann window, which leaks if the input
    is random. `noise_ratio` is unexplained over input power, output by output. `modes` are the
    (omega_n, zeta, gain) of each mode in each output.
    """
    frf = outputs[0]
    # decay time of the slowest mode, in window lengths
    memory = 1 / (min(zeta * omega for omega, zeta, _ in modes[0]) * frf.window_s)
    per_bin = int(np.clip(np.ceil(3 + 8 * memory), 4, 24))
    offset = np.arange(-HALF_WIDTH * per_bin, HALF_WIDTH * per_bin + 1) / per_bin
    near = frf.omega[:, None] + 2 * np.pi * offset / frf.window_s
    responses = [
        _response(output, output_modes, near, leakage)
        for output, output_modes in zip(outputs, modes, strict=True)
    ]
    step = 1 - frf.noverlap / frf.nperseg
    lags = np.arange(-int(np.ceil(1 / step)) + 1, int(np.ceil(1 / step)))
    lags = lags[np.abs(lags) < frf.num_segments]
    share = (frf.num_segments - np.abs(lags)) / (frf.num_segments**2 * frf.num_repeats)
    phase: Complex = np.exp(2j * np.pi * np.outer(offset, lags * step))
    distance = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    shape = _hann(offset) * _hann(offset - distance[:, None]) / per_bin
    kernels: Complex = phase * shape[..., None]
    power = np.sum(_hann(offset) ** 2) / per_bin
    white = kernels.sum(axis=1)[:, None, :]
    parts = {
        (a, b): _by_neighbour(mine, theirs, kernels)
        for (a, mine), (b, theirs) in product(enumerate(responses), repeat=2)
    }
    levels = []
    for o, unexplained in enumerate(np.split(noise_ratio, len(outputs))):
        leak, through = (
            part[NEIGHBOURS][:, lags == 0][:, 0].real / power for part in parts[o, o][:2]
        )
        levels.append(_noise_levels(unexplained - leak, through, unexplained))
    hermitian, symmetric = (
        np.empty((len(outputs), len(outputs), *white.shape[:1], len(frf.freq)), complex)
        for _ in range(2)
    )
    for (a, b), (leak, through, twice) in parts.items():
        force = levels[a][1] if a == b else np.sqrt(levels[a][1] * levels[b][1])
        residual = leak + force * through + (levels[a][0] if a == b else 0.0) * white
        hermitian[a, b] = np.sum(residual * white.conj() * share, axis=-1) / power**2
        symmetric[a, b] = np.sum(twice * share, axis=-1) / power**2
    return LineErrors(hermitian, symmetric)


def _response(frf: FRF, modes: Modes, near: Real, leakage: bool) -> tuple[Complex, Complex | None]:
    """Return one output's response near every line, and its windowed mean if there is leakage."""
    order = derivative_order(frf.response)
    h = sum(receptance(near, *mode) for mode in modes) * (1j * near) ** order
    means = (smeared(frf.omega, *mode, frf.window_s, order) for mode in modes)
    return h, sum(means) if leakage else None  # pyright: ignore[reportReturnType]


def _by_neighbour(
    mine: tuple[Complex, Complex | None], theirs: tuple[Complex, Complex | None], kernels: Complex
) -> tuple[Complex, Complex, Complex]:
    """Return the covariance of the errors of lines i and i + q, from leakage and force noise.

    The results are leakage and force noise of E[R conj R], and leakage of E[R U*] E[R U*]. The axes
    are q, line and lag; the first of two outputs is that of line i.
    """
    # Use one product for all distances and lags: 39 small products take ten times as long.
    flat = np.moveaxis(kernels, 1, 0).reshape(kernels.shape[1], -1)

    def along(near: Complex | Real, weights: Complex) -> Complex:
        return np.moveaxis((near @ weights).reshape(len(near), len(kernels), -1), 1, 0)

    (my_near, my_mean), (their_near, their_mean) = mine, theirs
    power = np.abs(my_near) ** 2 if mine is theirs else my_near * their_near.conj()
    through = along(power, flat)
    if my_mean is None or their_mean is None:
        return np.zeros_like(through), through, np.zeros_like(through)
    shifted = [np.roll(their_mean, NEIGHBOURS - i) for i in range(len(kernels))]
    here, neighbour = my_mean[:, None], np.array(shifted)[..., None]
    white = kernels.sum(axis=1)[:, None, :]
    ahead, behind = along(my_near, flat), along(their_near, flat.conj())
    leak = (
        through - neighbour.conj() * ahead - here * behind.conj() + here * neighbour.conj() * white
    )
    symmetric = (ahead - here * white) * (behind - neighbour * white.conj())
    return leak, through, symmetric


def _hann(bins: Real) -> Real:
    """Return the Fourier transform of a Hann window about its middle, for a duration of one."""
    # At bins = +-1, the limit of sinc / (1 - bins^2) is a half.
    regular = np.abs(np.abs(bins) - 1) > 1e-9
    safe = np.where(regular, bins, 0.0)
    return np.where(regular, np.sinc(safe) / (1 - safe**2), 0.5) / 2


def _noise_levels(excess: Real, through: Real, noise_ratio: Real) -> tuple[float, float]:
    """Fit the noise of sensor and force, relative to the input, to the power without leakage."""
    model = np.full_like(excess, max(noise_ratio.mean(), np.finfo(float).tiny))
    levels = np.zeros(2)
    for _ in range(4):
        columns = np.column_stack([np.ones_like(through), through]) / model[:, None]
        scale = np.linalg.norm(columns, axis=0)
        levels = optimize.nnls(columns / scale, excess / model)[0] / scale
        model = levels[0] + levels[1] * through + (noise_ratio - excess)
        model = np.maximum(model, 1e-9 * noise_ratio.mean())
    return float(levels[0]), float(levels[1])
