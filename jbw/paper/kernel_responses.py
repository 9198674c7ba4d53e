r"""The responses of the polynomial oscillator from its Volterra kernels, to tones and to records.

The response to several tones is computed line by line, Eqs. (19)-(22). The input is $u(t) =
\mathrm{Re}\sum_i A_i e^{j\omega_i t}$ with complex peak amplitudes, so that phases are free. A line
is a combination of the tones' frequencies, $N\omega_a + M\omega_b + L\omega_c$.

The response to a record, Eqs. (16), (17), is computed as $y = y_1 + y_2 + y_3 + \dots$ by three
methods. The multiple convolutions with the kernels in time are the definition and cost memory^order
per sample. For this system they reduce to a cascade of linear oscillators, which costs a few linear
responses. The same cascade in frequency serves for one period of a periodic record.
"""

from collections.abc import Sequence
from functools import partial
from itertools import combinations_with_replacement
from math import factorial, prod
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact, Int
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.oscillator.checks import is_concrete
from jbw.oscillator.linear import Moments, impulse_moments
from jbw.oscillator.parameters import Scalar
from jbw.paper.impulse import impulse_1, impulse_2, impulse_3
from jbw.paper.polynomial import PolynomialOscillator, kernel_1, nonlinear_force, require_no_pole
from jbw.paper.probing import kernel


def tones(
    omega: Float[ArrayLike, " tone"],
    amplitude: Inexact[ArrayLike, " _tone"],
    t: Float[ArrayLike, "..."],
) -> Float[Array, "..."]:
    r"""Return an input that is a sum of tones, $u(t) = \mathrm{Re}\sum_i A_i e^{j\omega_i t}$.

    Args:
        omega: Angular frequencies of the tones [rad/s]; the paper has three.
        amplitude: Complex peak amplitudes of the tones [N/kg].
        t: Time [s].

    Returns:
        Input [N/kg].

    Raises:
        ConfigError: `omega` and `amplitude` are not two rows of equal length.

    Reference:
        Eq. (19), as printed; here for any number of tones.
    """
    omega, amplitude = _rows(omega, amplitude)
    phase = jnp.asarray(t)[..., None] * omega
    return jnp.sum(jnp.real(amplitude * jnp.exp(1j * phase)), axis=-1)


def multinomial(powers: Sequence[int]) -> int:
    r"""Return the number of orders of a term's factors, $\eta!/(p!\,q!\,r!\,s!\,v!\,w!)$.

    Args:
        powers: The powers p, q, r, s, v, w, whose sum is eta; any number of them.

    Returns:
        The multinomial coefficient [-].

    Raises:
        ConfigError: A power is negative.

    Reference:
        Eq. (21), as printed.
    """
    if min(powers, default=0) < 0:
        raise ConfigError(f"`powers` must be 0 or more, but are {tuple(powers)}.")
    return factorial(sum(powers)) // prod(map(factorial, powers))


def repeated_kernel(
    system: PolynomialOscillator, omega: Float[ArrayLike, " tone"], powers: Sequence[int]
) -> Complex[Array, ""]:
    r"""Return the Volterra kernel whose arguments repeat the frequencies of given tones.

    $$H_\eta(\underbrace{\omega_a, \dots}_{p}, \underbrace{-\omega_a, \dots}_{q},
      \underbrace{\omega_b, \dots}_{r}, \dots)$$

    Args:
        system: Polynomial oscillator.
        omega: Angular frequencies of the tones [rad/s].
        powers: Number of repetitions of each frequency and of its negative: (p, q, r, s, v, w) for
            three tones.

    Returns:
        Kernel [m^(1-n) s^(2n)] of order n, the sum of the powers.

    Raises:
        ConfigError: There are not two powers for each tone, or their sum is below 1.

    Reference:
        Eq. (22), as printed.
    """
    omega = jnp.asarray(omega)
    if len(powers) != 2 * omega.size:
        raise ConfigError(
            f"`powers` must contain two numbers for each of the {omega.size} tones, "
            f"but is {tuple(powers)}."
        )
    signed = jnp.stack([omega, -omega], axis=1).ravel()
    return kernel(system, *jnp.repeat(signed, jnp.asarray(powers), total_repeat_length=sum(powers)))


class Terms(eqx.Module):
    r"""The terms of one order of a response to tones: $y_\eta(t) = \sum c\,e^{j\Omega t}$.

    Attributes:
        exponents: The powers (p, q, r, s, v, w) of (A, A*, B, B*, C, C*) [-].
        weight: Multinomial coefficient, eta! / (p! q! r! s! v! w!) [-].
        combination: Multiples of the tones, (p - q, r - s, v - w) [-].
        omega: Frequency Omega of the term [rad/s].
        coefficient: Complex coefficient c [m].
    """

    exponents: Int[ArrayLike, "term slot"]
    weight: Int[ArrayLike, " term"]
    combination: Int[ArrayLike, "term tone"]
    omega: Float[Array, " term"]
    coefficient: Complex[Array, " term"]


class Lines(eqx.Module):
    r"""The spectral lines of a response to tones, $y(t) = \mathrm{Re}\sum Y\,e^{j\Omega t}$.

    Attributes:
        combination: Multiples of the tones; the first nonzero one is positive [-].
        omega: Frequency Omega of the line, which may be negative [rad/s].
        amplitude: Complex peak amplitude Y; for the line with all multiples zero the mean [m].
    """

    combination: Int[ArrayLike, "line tone"]
    omega: Float[Array, " line"]
    amplitude: Complex[Array, " line"]


def tone_terms(
    system: PolynomialOscillator,
    omega: Float[ArrayLike, " tone"],
    amplitude: Inexact[ArrayLike, " _tone"],
    order: int,
) -> Terms:
    r"""Return the terms of one order in the Volterra response to a few tones.

    $$y_\eta = \frac{1}{2^\eta}\sum_{p+q+r+s+v+w=\eta} \frac{\eta!}{p!\,q!\,r!\,s!\,v!\,w!}
      A^p \bar A^q B^r \bar B^s C^v \bar C^w\, H_\eta\, e^{j(N\omega_a+M\omega_b+L\omega_c)t}$$

    with N = p - q, M = r - s, L = v - w, and H_eta at p times omega_a, q times -omega_a, and so
    on.

    Args:
        system: Polynomial oscillator.
        omega: Angular frequencies of the tones [rad/s].
        amplitude: Complex peak amplitudes of the tones [N/kg].
        order: Order eta.

    Returns:
        The terms, with positive and negative frequencies.

    Raises:
        ConfigError: `order` is less than 1, or the tones are not two rows of equal length.
        ModelError: The oscillator has no damping and a sum of tones meets its natural frequency.

    Reference:
        Eq. (20), corrected: N = p - q, M = r - s, L = v - w; the print uses N, M, L for the powers
        as well.
    """
    omega, amplitude = _rows(omega, amplitude)
    if order < 1:
        raise ConfigError(f"`order` must be 1 or more, but is {order}.")
    slots, exponents = _slots(omega.size, order)
    # A term contains the receptance at each partial sum of its frequencies.
    for lower in range(1, order + 1):
        _, parts = _slots(omega.size, lower)
        sums = (parts[:, 0::2] - parts[:, 1::2]) @ omega
        require_no_pole(system.stiffness, system.damping, sums)
    weight = np.array([multinomial(row) for row in exponents.tolist()])
    combination = exponents[:, 0::2] - exponents[:, 1::2]
    coefficient = _coefficients(system, omega, amplitude, slots, weight)
    return Terms(exponents, weight, combination, jnp.asarray(combination) @ omega, coefficient)


def _slots(num_tones: int, order: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return each choice of `order` factors from the tones, with the powers of each tone."""
    slots = np.array(list(combinations_with_replacement(range(2 * num_tones), order)))
    return slots, (slots[:, :, None] == np.arange(2 * num_tones)).sum(axis=1)


def _rows(omega: ArrayLike, amplitude: ArrayLike) -> tuple[Array, Array]:
    """Return the frequencies and amplitudes of tones as arrays, after checking their shapes."""
    omega, amplitude = jnp.asarray(omega), jnp.asarray(amplitude)
    if omega.ndim != 1 or omega.shape != amplitude.shape:
        raise ConfigError(
            "`omega` and `amplitude` must hold one value for each tone, but have shapes "
            f"{omega.shape} and {amplitude.shape}."
        )
    return omega, amplitude


@jax.jit
def _coefficients(
    system: PolynomialOscillator,
    omega: Float[Array, " tone"],
    amplitude: Inexact[Array, " tone"],
    slots: Int[ArrayLike, "term order"],
    weight: Int[ArrayLike, " term"],
) -> Complex[Array, " term"]:
    """Return the coefficient of each term; `slots` selects the amplitudes in the coefficient."""
    signed = jnp.stack([omega, -omega], axis=1).ravel()
    half = jnp.stack([amplitude, jnp.conj(amplitude)], axis=1).ravel() / 2.0
    return jnp.asarray(weight) * jnp.prod(half[slots], axis=1) * kernel(system, *signed[slots].T)


def tone_response(
    system: PolynomialOscillator,
    omega: Float[ArrayLike, " tone"],
    amplitude: Inexact[ArrayLike, " _tone"],
    max_order: int = 3,
) -> Lines:
    r"""Return the steady Volterra response to one or more tones, up to a given order.

    $$y(t) = y_1 + \dots + y_\eta = \mathrm{Re}\sum_{N,M,L} Y_{NML}\,
      e^{j(N\omega_a+M\omega_b+L\omega_c)t}$$

    Terms of all orders with one combination are summed. Where the series converges, the error is of
    the next order in the amplitude (without `rho` of the next but one).

    Args:
        system: Polynomial oscillator.
        omega: Angular frequencies of the tones [rad/s].
        amplitude: Complex peak amplitudes of the tones [N/kg].
        max_order: Highest order included.

    Returns:
        One line for each combination, in lexical order from the mean up.

    Raises:
        ConfigError: `max_order` is less than 1, or the tones are not two rows of equal length.

    Reference:
        Eq. (16), as printed, for an input of tones; y_0 there is the mean, not the threshold.
    """
    if max_order < 1:
        raise ConfigError(f"`max_order` must be 1 or more, but is {max_order}.")
    terms = [tone_terms(system, omega, amplitude, order) for order in range(1, max_order + 1)]
    combination = np.concatenate([np.asarray(part.combination) for part in terms])
    coefficient = jnp.concatenate([part.coefficient for part in terms])
    one_sided = np.array([tuple(row) >= (0,) * len(row) for row in combination.tolist()])
    lines, place = np.unique(combination[one_sided], axis=0, return_inverse=True)
    total = jnp.zeros(len(lines), coefficient.dtype).at[place].add(coefficient[one_sided])
    sides = np.where(lines.any(axis=1), 2.0, 1.0)
    return Lines(lines, jnp.asarray(lines) @ jnp.asarray(omega), jnp.asarray(sides) * total)


def merge_lines(lines: Lines, tolerance: float = 1e-9) -> Lines:
    r"""Add the spectral lines of a response that have the same frequency.

    Negative frequencies become positive by $\mathrm{Re}\,Y e^{j\Omega t} = \mathrm{Re}\,\bar Y
    e^{-j\Omega t}$. The function cannot run under `jit`, as the lines to sum depend on values.

    Args:
        lines: Lines as `tone_response` returns them.
        tolerance: Largest distance of lines that are summed, relative to the highest frequency [-].

    Returns:
        Lines in order of rising frequency; each keeps the combination of lowest order.

    Reference:
        Eq. (20), as printed, where several combinations meet.
    """
    omega, amplitude = np.asarray(lines.omega), np.asarray(lines.amplitude)
    combination = np.asarray(lines.combination)
    turned = omega < 0.0
    omega = np.abs(omega)
    amplitude = np.where(turned, amplitude.conj(), amplitude)
    combination = np.where(turned[:, None], -combination, combination)
    by_frequency = np.argsort(omega, kind="stable")
    gaps = np.diff(omega[by_frequency]) > tolerance * omega.max()
    groups = np.split(by_frequency, np.flatnonzero(gaps) + 1)
    least = [min(group, key=lambda i: np.abs(combination[i]).sum()) for group in groups]
    total = np.array([amplitude[group].sum() for group in groups])
    at_rest = omega[least] <= tolerance * omega.max()
    merged = np.where(at_rest, np.real(total), total)
    return Lines(combination[least], jnp.asarray(omega[least]), jnp.asarray(merged))


def synthesize(lines: Lines, t: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    r"""Return a response in time from its spectral lines, $y = \mathrm{Re}\sum Y\,e^{j\Omega t}$.

    Args:
        lines: Lines of the response.
        t: Time [s].

    Returns:
        Displacement [m].

    Reference:
        Eq. (16), as printed, from the lines.
    """
    phase = jnp.asarray(t)[..., None] * lines.omega
    return jnp.sum(jnp.real(lines.amplitude * jnp.exp(1j * phase)), axis=-1)


Hold = Literal["first", "zero"]


class VolterraResponse(eqx.Module):
    """The contribution of each order to a Volterra response; their sum is the response.

    Attributes:
        t: Time, which is 0 at the first sample [s].
        y: Displacement of each order, from order 1 [m].
        v: Velocity of each order, from order 1 [m/s].
    """

    t: Float[Array, " time"]
    y: Float[Array, "order time"]
    v: Float[Array, "order time"]


def volterra_response(
    system: PolynomialOscillator,
    u: Float[ArrayLike, "..."],
    fs: float,
    *,
    hold: Hold = "first",
    substeps: int = 1,
    max_order: int = 3,
) -> VolterraResponse:
    r"""Compute the Volterra response to a record, from rest, as a cascade of linear oscillators.

    $$y_1 = h_1 * u, \quad y_2 = -h_1 * \rho y_1^2, \quad
      y_3 = -h_1 * (2\rho y_1 y_2 + \lambda_3 y_1^3)$$

    The result equals the convolutions with h_2 and h_3, which are the kernels of this cascade. y_1
    is exact for the interpolated input. The inputs of the higher orders are known at the samples,
    with their rates, and interpolated by cubics: their error decreases with the fourth power of the
    step. With m steps per cycle of omega_0, y_2 and y_3 are accurate to about (2.5/m)^4 of their
    peaks.

    Args:
        system: Polynomial oscillator.
        u: Input at the samples [N/kg].
        fs: Sampling rate [Hz].
        hold: Input between samples: "first" interpolates linearly, "zero" keeps u[n] on [n, n + 1).
        substeps: Steps per sample, with the same interpolated input.
        max_order: Highest order returned.

    Returns:
        Time, and displacement and velocity of each order, at the samples.

    Raises:
        ConfigError: `hold` is unknown, or `substeps` or `max_order` is less than 1.
        DataError: `u` is not one finite record of at least two samples.

    Reference:
        Eq. (16), corrected: y_0 there is the mean and not the threshold of the loop; here zero.
        Eq. (17), corrected: the printed product sign is superfluous.
    """
    if hold not in get_args(Hold):
        raise ConfigError(f'`hold` must be "first" or "zero", but is {hold!r}.')
    if substeps < 1 or max_order < 1:
        raise ConfigError(
            f"`substeps` and `max_order` must be 1 or more, but are {substeps} and {max_order}."
        )
    u = _record(u)
    y, v = _cascade(system, u, 1.0 / fs, hold, substeps, max_order)
    return VolterraResponse(jnp.arange(u.size) / fs, y, v)


@partial(jax.jit, static_argnames=("hold", "substeps", "max_order"))
def _cascade(
    system: PolynomialOscillator,
    u: Float[Array, " time"],
    dt: Scalar,
    hold: Hold,
    substeps: int,
    max_order: int,
) -> tuple[Float[Array, "order time"], Float[Array, "order time"]]:
    """Return each order's displacement and velocity at the samples, by a cascade of oscillators."""
    step = dt / substeps
    moments = impulse_moments(system.stiffness, system.damping, step, 4)
    y, v = _propagate(moments, _held(_refined(u, hold, substeps), hold))
    parts, rates = [y], [v]
    while len(parts) < max_order:
        force, rate = jax.jvp(lambda *y: nonlinear_force(system, y), tuple(parts), tuple(rates))
        y, v = _propagate(moments, -_hermite(force, step * rate))
        parts, rates = [*parts, y], [*rates, v]
    return jnp.stack(parts)[:, ::substeps], jnp.stack(rates)[:, ::substeps]


def _held(f: Float[Array, " time"], hold: Hold) -> Float[Array, "step 4"]:
    """Return each step's polynomial of an input that is constant ("zero") or linear ("first")."""
    slope = f[1:] - f[:-1] if hold == "first" else jnp.zeros_like(f[1:])
    none = jnp.zeros_like(slope)
    return jnp.stack([f[:-1], slope, none, none], axis=-1)


def _hermite(f: Float[Array, " time"], rise: Float[Array, " time"]) -> Float[Array, "step 4"]:
    """Return each step's cubic polynomial of an input whose samples and rates are known."""
    change, start, end = f[1:] - f[:-1], rise[:-1], rise[1:]
    return jnp.stack([f[:-1], start, 3 * change - 2 * start - end, start + end - 2 * change], -1)


def _propagate(
    moments: Moments, polynomials: Float[Array, "step 4"]
) -> tuple[Float[Array, " time"], Float[Array, " time"]]:
    """Return an oscillator's motion from rest under an input that is a polynomial in each step."""
    push = polynomials @ moments.y, polynomials @ moments.v

    def advance(state: tuple, push: tuple) -> tuple:
        (y, v), (push_y, push_v) = state, push
        after_y = y + moments.f_11 * y + moments.f_12 * v + push_y
        after_v = v + moments.f_21 * y + moments.f_22 * v + push_v
        return (after_y, after_v), (after_y, after_v)

    rest = jnp.zeros((), polynomials.dtype)
    _, (y, v) = jax.lax.scan(advance, (rest, rest), push)
    return jnp.concatenate([rest[None], y]), jnp.concatenate([rest[None], v])


def periodic_response(
    system: PolynomialOscillator, u: Float[ArrayLike, "..."], fs: float, *, max_order: int = 3
) -> VolterraResponse:
    r"""Return the steady Volterra response to one period of a band-limited record.

    $$Y_1 = H_1 U, \qquad Y_\eta(\omega) = -H_1(\omega)\,\mathcal F\bigl[\rho \sum y_i y_k
      + \lambda_3 \sum y_i y_k y_l\bigr](\omega)$$

    which sums H_eta over all ways to obtain omega from eta lines of U. The products are taken on a
    grid max_order + 1 times as fine, so that none of their lines is aliased. At the samples the
    response is that to the input's own Fourier series.

    Args:
        system: Polynomial oscillator.
        u: Input at the samples of one period [N/kg].
        fs: Sampling rate [Hz].
        max_order: Highest order returned.

    Returns:
        Time, and displacement and velocity of each order, at the samples.

    Raises:
        ConfigError: `max_order` is less than 1.
        DataError: `u` is not one finite record of at least two samples.
        ModelError: The oscillator has no damping and a line of the record is at its pole.

    Reference:
        Eq. (16), as printed; every term is (17) transformed by (18).
    """
    if max_order < 1:
        raise ConfigError(f"`max_order` must be 1 or more, but is {max_order}.")
    u = _record(u)
    fine = (max_order + 1) * u.size
    omega = 2 * jnp.pi * fs * jnp.arange(fine // 2 + 1) / u.size
    y, v = _lines_response(kernel_1(system, omega), omega, u, system, max_order)
    return VolterraResponse(jnp.arange(u.size) / fs, y, v)


@partial(jax.jit, static_argnames="max_order")
def _lines_response(
    receptance: Complex[Array, " line"],
    omega: Float[Array, " line"],
    u: Float[Array, " time"],
    system: PolynomialOscillator,
    max_order: int,
) -> tuple[Float[Array, "order time"], Float[Array, "order time"]]:
    """Return each order's displacement and velocity at the samples, from the input spectrum."""
    oversampling, fine = max_order + 1, (max_order + 1) * u.size
    lines = jnp.fft.rfft(u) * oversampling
    # On the finer grid, the spectral line at the old Nyquist frequency gets a mirror image.
    if u.size % 2 == 0:
        lines = lines.at[-1].divide(2.0)
    spectrum = jnp.zeros(omega.size, lines.dtype).at[: lines.size].set(lines)
    parts, rates = [], []
    while len(parts) < max_order:
        moved = receptance * spectrum
        parts.append(jnp.fft.irfft(moved, fine))
        rates.append(jnp.fft.irfft(1j * omega * moved, fine))
        spectrum = -jnp.fft.rfft(nonlinear_force(system, parts))
    return jnp.stack(parts)[:, ::oversampling], jnp.stack(rates)[:, ::oversampling]


def volterra_sums(
    system: PolynomialOscillator, u: Float[ArrayLike, "..."], fs: float, memory: int
) -> Float[Array, "order time"]:
    r"""Return the first three orders of a record's response, from rest, as multiple convolutions.

    $$y_\eta(t) = \int\!\cdots\!\int h_\eta(\tau_1,\dots,\tau_\eta)\,
      u(t-\tau_1)\cdots u(t-\tau_\eta)\,d\tau_1\cdots d\tau_\eta$$

    by the trapezoid rule at the samples, which suits a linearly interpolated input: the error
    decreases with the square of the step. Work and memory grow as memory^3, so that it is for short
    records, to check or to teach; use `volterra_response` for data.

    Args:
        system: Polynomial oscillator, underdamped.
        u: Input at the samples, zero before the first [N/kg].
        fs: Sampling rate [Hz].
        memory: Number of samples of the kernels; with the length of u nothing is truncated.

    Returns:
        Displacement of orders 1, 2 and 3 [m].

    Raises:
        ConfigError: `memory` is less than 1.
        DataError: `u` is not one finite record of at least two samples.

    Reference:
        Eq. (17), corrected: the printed product sign is superfluous.
    """
    if memory < 1:
        raise ConfigError(f"`memory` must be 1 sample or more, but is {memory}.")
    u = _record(u)
    return _sums(system, u, 1.0 / fs, memory)


@partial(jax.jit, static_argnames="memory")
def _sums(
    system: PolynomialOscillator, u: Float[Array, " time"], dt: Scalar, memory: int
) -> Float[Array, "order time"]:
    """Return the multiple convolutions at each sample, over the last `memory` samples."""
    # At the record's first sample, the trapezoidal rule has only one half interval.
    padded = jnp.concatenate([jnp.zeros(memory - 1), u.at[0].divide(2.0)])
    past = dt * padded[jnp.arange(u.size)[:, None] + memory - 1 - jnp.arange(memory)]
    tau = dt * jnp.arange(memory)
    y_1 = past @ impulse_1(system, tau)
    y_2 = jnp.sum((past @ impulse_2(system, tau[:, None], tau)) * past, axis=1)
    inner = impulse_3(system, tau[:, None, None], tau[:, None], tau) @ past.T
    y_3 = jnp.einsum("ikn,ni,nk->n", inner, past, past)
    return jnp.stack([y_1, y_2, y_3])


def _record(u: Float[ArrayLike, "..."]) -> Float[Array, " time"]:
    """Return a record as an array; raise an error if it is invalid."""
    u = jnp.asarray(u, dtype=float)
    if u.ndim != 1 or u.size < 2:
        raise DataError(
            f"`u` must be one record of at least two samples, but has shape {u.shape}.",
            remedy="Map over several records with jax.vmap.",
        )
    if is_concrete(u) and not bool(jnp.isfinite(u).all()):
        first = int(jnp.argmin(jnp.isfinite(u)))
        raise DataError(f"`u` must be finite, but `u[{first}]` is {u[first]}.")
    return u


def _refined(u: Float[Array, " time"], hold: Hold, substeps: int) -> Float[Array, " fine"]:
    """Return the input, interpolated on a grid `substeps` times as fine, up to the last sample."""
    if hold == "zero":
        return jnp.concatenate([jnp.repeat(u[:-1], substeps), u[-1:]])
    fine = u[:-1, None] + (u[1:] - u[:-1])[:, None] * jnp.arange(substeps) / substeps
    return jnp.concatenate([fine.ravel(), u[-1:]])
