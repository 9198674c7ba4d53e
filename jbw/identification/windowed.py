"""What a window does to the FRF of an oscillator: its smeared mean and the errors it leaves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from jbw.measurement.spectra import FRF
from jbw.quantities import derivative_order

HALF_WIDTH = 32  # bins of the window's transform that are carried; it falls as bins^-3
NEIGHBOURS = 6  # lines further apart than this have independent errors

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def receptance(omega: Real, omega_n: float, zeta: float, gain: float) -> Complex:
    """Receptance of the linear oscillator, gain / (omega_n^2 - omega^2 + 2j zeta omega_n omega).

    Displacement per unit of input [m per unit], with omega [rad/s] and gain [N/kg per unit].

    Reference:
        Eq. (23).
    """
    return gain / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)


def smeared(
    omega: Real, omega_n: float, zeta: float, gain: float, window_s: float, order: int
) -> Complex:
    r"""Mean of H1 under Hann windows and white input, in the response as measured.

    $$\mathrm{E}\,\hat H(\omega) = \int_0^T h(\tau)\,w_a(\tau)\,e^{-j\omega\tau}\,\mathrm{d}\tau,
      \qquad h = \frac{\mathrm{d}^p}{\mathrm{d}\tau^p}
      \frac{g\,(e^{s\tau} - e^{\bar s\tau})}{2j\omega_d},\quad
      w_a = \Big(1-\frac\tau T\Big)\frac{2+\cos(2\pi\tau/T)}{3} + \frac{\sin(2\pi\tau/T)}{2\pi}$$

    with s = -zeta omega_n + j omega_d, zeta < 1: the receptance convolved with |W|^2, in closed
    form. T is `window_s` [s]; p, the `order`, is 0 for a receptance, 1 mobility, 2 accelerance.
    """
    omega_d = omega_n * np.sqrt(1 - zeta**2)
    s = -zeta * omega_n + 1j * omega_d
    mean = s**order * _hann_transform(s - 1j * omega, window_s)
    mean = mean - s.conjugate() ** order * _hann_transform(s.conjugate() - 1j * omega, window_s)
    direct = gain if order == 2 else 0.0  # the impulse itself, in an acceleration
    return direct + gain / (2j * omega_d) * mean


def _hann_transform(p: Complex, window_s: float) -> Complex:
    """Integral from 0 to T of exp(p tau) w_a(tau)."""
    turn = 2j * np.pi / window_s

    def ramp(q: Complex) -> Complex:  # of (1 - tau / T) exp(q tau)
        x = q * window_s
        return window_s * (np.exp(x) - 1 - x) / x**2

    def flat(q: Complex) -> Complex:  # of exp(q tau)
        return (np.exp(q * window_s) - 1) / q

    ramps = 4 * ramp(p) + ramp(p + turn) + ramp(p - turn)
    return ramps / 6 + (flat(p + turn) - flat(p - turn)) / (4j * np.pi)


@dataclass(frozen=True)
class LineErrors:
    """Errors of an FRF's lines, over (2 NEIGHBOURS + 1, line), q from -NEIGHBOURS on."""

    hermitian: Complex  # E[d_i conj(d_{i+q})]
    symmetric: Complex  # E[d_i d_{i+q}], which leakage makes differ from zero

    @property
    def variance(self) -> Real:
        """E|d_i|^2 of each line."""
        return np.abs(self.hermitian[len(self.hermitian) // 2])

    def of_sum(self, weights: Complex) -> Real:
        """Covariance of Re sum_i G_ai d_i by G (parameter, line), over parameters."""
        total = np.zeros((len(weights), len(weights)), complex)
        reach = len(self.hermitian) // 2
        num_lines = weights.shape[-1]
        for q in range(-reach, reach + 1):
            i = np.arange(max(0, -q), min(num_lines, num_lines - q))
            mine, theirs = weights[:, i], weights[:, i + q]
            total += (mine * self.hermitian[q + reach, i]) @ theirs.conj().T
            total += (mine * self.symmetric[q + reach, i]) @ theirs.T
        return np.real(total + total.T) / 4


def line_errors(
    frf: FRF, noise_ratio: Real, theta: tuple[float, float, float], leakage: bool
) -> LineErrors:
    r"""Errors of the lines of an H1 estimate and their neighbours, in the response as measured.

    For Gaussian input and noise the error of a line is sum_k R_k conj(U_k) / sum_k |U_k|^2, with
    R_k the part of segment k's response that H times its input does not explain. Hence

    $$\mathrm{E}[d_i \bar d_j] = \sum_m \frac{K-|m|}{K^2}\,
      \frac{\mathrm{E}[R_k(i)\bar R_{k+m}(j)]\,\mathrm{E}[\bar U_k(i)U_{k+m}(j)]}{S_{uu}^2}$$

    R holds what leaks in through the window (known from the oscillator), noise of the sensor
    (white in the response measured) and disturbing forces (white, through the oscillator); the
    levels of the last two are read from the coherence. Where both are far below the leakage the
    reading errs upwards, and with it the errors of omega_n and gain (not of zeta).

    The lines of `frf` are evenly spaced, under a Hann window, which leaks where the input is
    random. `noise_ratio` is unexplained over input power, `theta` is (omega_n, zeta, gain).
    """
    order = derivative_order(frf.response)
    memory = 1 / (theta[1] * theta[0] * frf.window_s)  # in windows
    per_bin = int(np.clip(np.ceil(3 + 8 * memory), 4, 24))
    offset = np.arange(-HALF_WIDTH * per_bin, HALF_WIDTH * per_bin + 1) / per_bin
    near = frf.omega[:, None] + 2 * np.pi * offset / frf.window_s
    h = receptance(near, *theta) * (1j * near) ** order
    mean = smeared(frf.omega, *theta, frf.window_s, order) if leakage else None
    step = 1 - frf.noverlap / frf.nperseg
    lags = np.arange(-int(np.ceil(1 / step)) + 1, int(np.ceil(1 / step)))
    lags = lags[np.abs(lags) < frf.num_segments]
    share = (frf.num_segments - np.abs(lags)) / (frf.num_segments**2 * frf.num_repeats)
    phase: Complex = np.exp(2j * np.pi * np.outer(offset, lags * step))
    kernels = [
        phase * (_hann(offset) * _hann(offset - q) / per_bin)[:, None]
        for q in range(-NEIGHBOURS, NEIGHBOURS + 1)
    ]
    own = np.sum(_hann(offset) ** 2) / per_bin
    parts = [_parts(h, mean, kernel, q - NEIGHBOURS) for q, kernel in enumerate(kernels)]
    leak, through = (np.array([part[i] for part in parts]) for i in (0, 1))
    symmetric = np.array([part[2] for part in parts])
    white = np.array([kernel.sum(axis=0) for kernel in kernels])
    sensor, force = _noise_levels(
        noise_ratio - leak[NEIGHBOURS][:, lags == 0][:, 0].real / own,
        through[NEIGHBOURS][:, lags == 0][:, 0].real / own,
        noise_ratio,
    )
    residual = leak + force * through + sensor * white[:, None, :]
    hermitian = np.sum(residual * white[:, None, :].conj() * share, axis=-1) / own**2
    return LineErrors(hermitian, np.sum(symmetric * share, axis=-1) / own**2)


def _hann(bins: Real) -> Real:
    """Transform of the Hann window about its middle, in units of its duration."""
    # At bins = +-1 the limit of sinc / (1 - bins^2) is a half.
    regular = np.abs(np.abs(bins) - 1) > 1e-9
    safe = np.where(regular, bins, 0.0)
    return np.where(regular, np.sinc(safe) / (1 - safe**2), 0.5) / 2


def _parts(
    h: Complex, mean: Complex | None, kernel: Complex, q: int
) -> tuple[Complex, Complex, Complex]:
    """Leakage, force noise (E[R conj R]) and leakage (E[R U*] E[R U*]) of lines i and i + q."""
    through = np.abs(h) ** 2 @ kernel
    if mean is None:
        return np.zeros_like(through), through, np.zeros_like(through)
    mine, theirs = mean[:, None], np.roll(mean, -q)[:, None]
    white, ahead, behind = kernel.sum(axis=0), h @ kernel, h @ kernel.conj()
    leak = through - theirs.conj() * ahead - mine * behind.conj() + mine * theirs.conj() * white
    symmetric = (ahead - mine * white) * (behind - theirs * white.conj())
    return leak, through, symmetric


def _noise_levels(excess: Real, through: Real, noise_ratio: Real) -> tuple[float, float]:
    """Levels of sensor and force noise, over the input's, that explain what does not leak."""
    model = np.full_like(excess, max(noise_ratio.mean(), np.finfo(float).tiny))
    levels = np.zeros(2)
    for _ in range(4):
        columns = np.column_stack([np.ones_like(through), through]) / model[:, None]
        scale = np.linalg.norm(columns, axis=0)
        levels = optimize.nnls(columns / scale, excess / model)[0] / scale
        model = levels[0] + levels[1] * through + (noise_ratio - excess)
        model = np.maximum(model, 1e-9 * noise_ratio.mean())
    return float(levels[0]), float(levels[1])
