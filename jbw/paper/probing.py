r"""The Volterra kernels of the polynomial oscillator at any order, by harmonic probing.

Kernels are symmetric in their frequencies; the frequencies of one call broadcast.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from math import factorial

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float

from jbw.errors import ConfigError
from jbw.paper.polynomial import PolynomialOscillator, kernel_1, nonlinear_force


def kernel(system: PolynomialOscillator, *omega: Float[ArrayLike, "..."]) -> Complex[Array, "..."]:
    r"""Return the symmetric Volterra kernel whose order is the number of given frequencies.

    With $G(S) = |S|!\,H_{|S|}$ on a set S of frequencies with sum $\omega_S$,

    $$G(S) = -H_1(\omega_S)\Bigl[2\rho\sum_{\{A,B\}} G(A)G(B)
      + 6\lambda_3\sum_{\{A,B,C\}} G(A)G(B)G(C)\Bigr],$$

    with sums over the ways to divide S into two or three sets. The work grows like 4^order.

    Args:
        system: Polynomial oscillator.
        *omega: Angular frequencies, one per order [rad/s].

    Returns:
        Kernel [m^(1-n) s^(2n)] of order n, complex.

    Raises:
        ConfigError: No frequency is given.

    Reference:
        Eqs. (18), (27), as printed; here to any order.
    """
    if not omega:
        raise ConfigError("A kernel needs at least one frequency `omega`, but none was given.")
    everything = tuple(range(len(omega)))
    probed: dict[tuple[int, ...], Array] = {}
    for size in range(1, len(omega) + 1):
        for subset in combinations(everything, size):
            linear = kernel_1(system, sum(jnp.asarray(omega[i]) for i in subset))
            if size == 1:
                probed[subset] = linear
                continue
            pairs = sum(probed[a] * probed[b] for a, b in _partitions(subset, 2))
            triples = sum(probed[a] * probed[b] * probed[c] for a, b, c in _partitions(subset, 3))
            probed[subset] = -linear * (2 * system.rho * pairs + 6 * system.lambda_3 * triples)
    return probed[everything] / factorial(len(omega))


def _partitions(items: tuple[int, ...], blocks: int) -> Iterator[tuple[tuple[int, ...], ...]]:
    """Yield every way to divide `items` into `blocks` non-empty sets, each only once."""
    if blocks == 1:
        yield (items,)
        return
    first, rest = items[0], items[1:]
    for size in range(len(items) - blocks + 1):
        for mates in combinations(rest, size):
            others = tuple(i for i in rest if i not in mates)
            for tail in _partitions(others, blocks - 1):
                yield ((first, *mates), *tail)


def leading_diagonals(
    system: PolynomialOscillator, omega: Float[ArrayLike, "..."], max_order: int = 5
) -> tuple[Complex[Array, "..."], ...]:
    r"""Return the leading diagonals $H_n(\omega,\dots,\omega)$ of the Volterra kernels.

    $$H_n = -H_1(n\omega)\Bigl[\rho\sum_{i+k=n} H_i H_k
      + \lambda_3\sum_{i+k+l=n} H_i H_k H_l\Bigr]$$

    Args:
        system: Polynomial oscillator.
        omega: Angular frequency [rad/s].
        max_order: Highest order returned.

    Returns:
        (H_1, ..., H_max_order) [m^(1-n) s^(2n)], complex.

    Reference:
        Eq. (28), as printed; here with rho and to any order.
    """
    omega = jnp.asarray(omega)
    diagonals = [kernel_1(system, omega)]
    for order in range(2, max_order + 1):
        force = nonlinear_force(system, diagonals)
        diagonals.append(-kernel_1(system, order * omega) * force)
    return tuple(diagonals)


def cross_kernel(
    system: PolynomialOscillator,
    omega: Sequence[Float[ArrayLike, "..."]],
    inputs: Sequence[int],
) -> Complex[Array, "..."]:
    r"""Return the symmetric Volterra kernel for inputs u (excitation) and u_0 (square wave).

    $$H_\eta^{(i_1\dots i_\eta)} = (-1)^{\#0}\,H_\eta$$

    u_0 is on the left of the equation of motion and thus drives it as -u_0, at the same point.

    Args:
        system: Polynomial oscillator.
        omega: Angular frequencies, one per order [rad/s].
        inputs: Input of each frequency: 1 for u, 0 for u_0.

    Returns:
        Kernel [m^(1-n) s^(2n)] of order n, complex.

    Raises:
        ConfigError: `inputs` does not name 0 or 1 for each frequency.

    Reference:
        Eq. (18), as printed; the sign of each input u_0 is that of (14).
    """
    if len(inputs) != len(omega) or not set(inputs) <= {0, 1}:
        raise ConfigError(
            f"`inputs` must name 0 (u_0) or 1 (u) for each of the {len(omega)} frequencies, "
            f"but is {tuple(inputs)}."
        )
    return (-1) ** list(inputs).count(0) * kernel(system, *omega)
