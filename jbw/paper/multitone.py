r"""Response of the polynomial oscillator to several tones, line by line, Eqs. (19)-(22).

The input is $u(t) = \mathrm{Re}\sum_i A_i e^{j\omega_i t}$ with complex peak amplitudes, so phases
are free. A line is a combination of the tones' frequencies, $N\omega_a + M\omega_b + L\omega_c$.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement
from math import factorial, prod

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, Inexact, Int
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.paper.polynomial import PolynomialOscillator, require_no_pole
from jbw.paper.probing import kernel


def tones(
    omega: Float[ArrayLike, " tone"],
    amplitude: Inexact[ArrayLike, " _tone"],
    t: Float[ArrayLike, "..."],
) -> Float[Array, "..."]:
    r"""Input of several tones, $u(t) = \mathrm{Re}\sum_i A_i e^{j\omega_i t}$.

    Args:
        omega: Angular frequencies of the tones [rad/s]; the paper has three.
        amplitude: Complex peak amplitudes of the tones [N/kg].
        t: Time [s].

    Returns:
        Input [N/kg].

    Raises:
        ConfigError: The tones are not two equal rows.

    Reference:
        Eq. (19), as printed; here for any number of tones.
    """
    omega, amplitude = _rows(omega, amplitude)
    phase = jnp.asarray(t)[..., None] * omega
    return jnp.sum(jnp.real(amplitude * jnp.exp(1j * phase)), axis=-1)


def multinomial(powers: Sequence[int]) -> int:
    r"""Number of ways to order the factors of a term, $\eta!/(p!\,q!\,r!\,s!\,v!\,w!)$.

    Args:
        powers: The powers p, q, r, s, v, w, of sum eta; any number of them.

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
    r"""Kernel at repeated frequencies of a few tones, as the response to them needs it.

    $$H_\eta(\underbrace{\omega_a, \dots}_{p}, \underbrace{-\omega_a, \dots}_{q},
      \underbrace{\omega_b, \dots}_{r}, \dots)$$

    Args:
        system: Polynomial oscillator.
        omega: Angular frequencies of the tones [rad/s].
        powers: How often each frequency and its negative stand: (p, q, r, s, v, w) for three tones.

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
            f"`powers` must hold two numbers for each of the {omega.size} tones, "
            f"but is {tuple(powers)}."
        )
    signed = jnp.stack([omega, -omega], axis=1).ravel()
    return kernel(system, *jnp.repeat(signed, jnp.asarray(powers), total_repeat_length=sum(powers)))


class Terms(eqx.Module):
    r"""Every term of one order: $y_\eta(t) = \sum c\,e^{j\Omega t}$, conjugates included.

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
    r"""Lines of a response, $y(t) = \mathrm{Re}\sum Y\,e^{j\Omega t}$.

    Attributes:
        combination: Multiples of the tones; the first that is not zero is positive [-].
        omega: Frequency Omega of the line; negative ones may occur [rad/s].
        amplitude: Complex peak amplitude Y; the mean for the line of zero multiples [m].
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
    r"""Terms of one homogeneous order in the response to a few tones.

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
        The terms, two-sided.

    Raises:
        ConfigError: If `order` is less than 1, or the tones are not two equal rows.
        ModelError: The oscillator has no damping and a sum of tones meets its natural frequency.

    Reference:
        Eq. (20), corrected: N = p - q, M = r - s, L = v - w; the print uses N, M, L for the powers
        as well.
    """
    omega, amplitude = _rows(omega, amplitude)
    if order < 1:
        raise ConfigError(f"`order` must be 1 or more, but is {order}.")
    slots, exponents = _slots(omega.size, order)
    for lower in range(1, order + 1):  # a term has the receptance at every part of its sum
        _, parts = _slots(omega.size, lower)
        sums = (parts[:, 0::2] - parts[:, 1::2]) @ omega
        require_no_pole(system.stiffness, system.damping, sums)
    weight = np.array([multinomial(row) for row in exponents.tolist()])
    combination = exponents[:, 0::2] - exponents[:, 1::2]
    coefficient = _coefficients(system, omega, amplitude, slots, weight)
    return Terms(exponents, weight, combination, jnp.asarray(combination) @ omega, coefficient)


def _slots(num_tones: int, order: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Every choice of `order` factors of (A, A*, B, B*, ...), and their powers."""
    slots = np.array(list(combinations_with_replacement(range(2 * num_tones), order)))
    return slots, (slots[:, :, None] == np.arange(2 * num_tones)).sum(axis=1)


def _rows(omega: ArrayLike, amplitude: ArrayLike) -> tuple[Array, Array]:
    """Frequencies and amplitudes as arrays, one value of each for every tone."""
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
    """Coefficients of the terms that take these slots of (A, A*, B, B*, ...)."""
    signed = jnp.stack([omega, -omega], axis=1).ravel()
    half = jnp.stack([amplitude, jnp.conj(amplitude)], axis=1).ravel() / 2.0
    return jnp.asarray(weight) * jnp.prod(half[slots], axis=1) * kernel(system, *signed[slots].T)


def tone_response(
    system: PolynomialOscillator,
    omega: Float[ArrayLike, " tone"],
    amplitude: Inexact[ArrayLike, " _tone"],
    max_order: int = 3,
) -> Lines:
    r"""Steady response to one, two, three or more tones, through a given order.

    $$y(t) = y_1 + \dots + y_\eta = \mathrm{Re}\sum_{N,M,L} Y_{NML}\,
      e^{j(N\omega_a+M\omega_b+L\omega_c)t}$$

    Terms of all orders on one combination are summed. The error is of the next order in the
    amplitude (the next but one without `rho`), where the series converges at all.

    Args:
        system: Polynomial oscillator.
        omega: Angular frequencies of the tones [rad/s].
        amplitude: Complex peak amplitudes of the tones [N/kg].
        max_order: Highest order kept.

    Returns:
        One line for each combination, in lexical order from the mean up.

    Raises:
        ConfigError: If `max_order` is less than 1, or the tones are not two equal rows.

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
    r"""Sum the lines that fall on one frequency, as with tones at omega and 3 omega.

    Negative frequencies are turned positive by $\mathrm{Re}\,Y e^{j\Omega t} =
    \mathrm{Re}\,\bar Y e^{-j\Omega t}$. Not under `jit`: which lines meet depends on values.

    Args:
        lines: Lines as `tone_response` returns them.
        tolerance: Lines closer than this, over the highest frequency, are one [-].

    Returns:
        Lines in rising frequency; each keeps the combination of least order.

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
    r"""Response in time from its lines, $y(t) = \mathrm{Re}\sum Y\,e^{j\Omega t}$.

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
