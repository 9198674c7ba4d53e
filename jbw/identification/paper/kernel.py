"""The third-order kernel at the probing frequencies: reduction, prediction, likelihood."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jbw.errors import DataError
from jbw.measurement.probing import ThirdOrder
from jbw.paper.coefficients import closed_loop_stiffness
from jbw.paper.kernels import cubic_kernel
from jbw.paper.likelihoods import Repeats, kernel_log_likelihood
from jbw.paper.objectives import kernel_residual


class KernelData(eqx.Module):
    """The measured third-order kernel at the frequencies of the tones, over repeats."""

    omega: Float[Array, " freq"]  # probing frequencies [rad/s]
    mean: Complex[Array, " freq"]  # mean of H3 over the repeats [m^-2 s^6]
    within: Float[Array, " freq"]  # sum of squared deviations of the repeats from the mean
    num_repeats: Float[Array, " freq"]
    noise_std: Float[Array, " freq"]  # noise of one repeat, per real component [m^-2 s^6]
    y_peak: Float[Array, " freq"]  # largest displacement of each test [m]
    omega_n: Float[Array, ""]  # fixed natural frequency from the line fit (Step 2) [rad/s]

    @property
    def repeats(self) -> Repeats:
        """The mean and deviations of the repeats."""
        return Repeats(self.mean, self.within, self.num_repeats)


def reduce(kernels: Sequence[ThirdOrder], omega_n: float) -> KernelData:
    r"""Reduce the measured kernel to means and deviations, one entry per tone.

    $$\sigma_i^2 = \frac{S_i}{2(K_i - 1)}$$

    The kernels are for input per unit mass [N/kg]; those below the noise are omitted. omega_n
    [rad/s] is that of Step 2.
    """
    usable = [kernel for kernel in kernels if kernel.above_noise]
    if len(usable) < 2:
        raise DataError(
            f"Step 3 needs at least 2 probing frequencies with Y(3 omega) above the noise, "
            f"but found {len(usable)} of {len(kernels)}.",
            remedy="Raise the level, lengthen the records or average more repeats.",
        )
    for kernel in usable:
        if len(kernel.h3) < 2:
            raise DataError(
                f"The probing test at {kernel.omega / (2 * np.pi):.4g} Hz needs at least 2 repeats "
                f"to estimate its noise, but has {len(kernel.h3)}.",
                remedy="Measure repeats of each probing frequency.",
            )
    mean = np.array([np.mean(kernel.h3) for kernel in usable])
    within = np.array([np.sum(np.abs(k.h3 - m) ** 2) for k, m in zip(usable, mean, strict=True)])
    num_repeats = np.array([float(len(kernel.h3)) for kernel in usable])
    return KernelData(
        omega=jnp.array([kernel.omega for kernel in usable]),
        mean=jnp.array(mean),
        within=jnp.array(within),
        num_repeats=jnp.array(num_repeats),
        noise_std=jnp.array(np.sqrt(within / (2 * (num_repeats - 1)))),
        y_peak=jnp.array([np.mean(kernel.y_peak) for kernel in usable]),
        omega_n=jnp.asarray(float(omega_n)),
    )


def predict(theta: Mapping[str, Array], data: KernelData) -> Complex[Array, " freq"]:
    r"""Return the third-order kernel of Teloli et al. in closed form at the tones [m^-2 s^6].

    $$H_3(\omega) = -\lambda_3\,H_1(\omega)^3\,H_1(3\omega), \qquad
      \lambda_3 = \alpha\Bigl(\frac{\delta^2}{6} - \frac{35\,\delta}{96\,Y}\Bigr)$$

    At one amplitude it depends on alpha and delta through lambda_3 alone, so it does not determine
    them separately.

    Reference:
        Eqs. (25), (31).
    """
    lambda_3 = closed_loop_stiffness(theta["alpha"], theta["delta"], data.y_peak)
    return cubic_kernel(data.omega, data.omega_n, theta["zeta"], lambda_3)


def log_likelihood(theta: Mapping[str, Array], data: KernelData) -> Float[Array, " freq"]:
    r"""Return the log likelihood of the kernel at each tone, with its noise integrated out.

    $$\log p = -K \log\bigl(K\,|\bar H_3 - H_3(\theta)|^2 + S\bigr) + \mathrm{const}$$

    A few repeats determine their noise only roughly: if it is taken as known, as (36) is printed,
    99 % intervals from eight repeats contain the truth in 96 % of cases.

    Reference:
        Eqs. (34), (36), under the Jeffreys prior 1/sigma of every frequency.
    """
    return kernel_log_likelihood(data.repeats, predict(theta, data))


def known_noise_log_likelihood(
    theta: Mapping[str, Array], data: KernelData
) -> Float[Array, " freq"]:
    """Return the log likelihood of Eq. (36) as printed, with `noise_std` as the known noise.

    Reference:
        Eqs. (34), (36).
    """
    return kernel_log_likelihood(data.repeats, predict(theta, data), data.noise_std)


def residual(theta: Mapping[str, Array], data: KernelData) -> Float[Array, " values"]:
    """Return the residuals of the mean kernels in standard errors: real, then imaginary parts.

    Reference:
        Eq. (38), weighted by the noise of each frequency.
    """
    weight = jnp.sqrt(data.num_repeats) / data.noise_std
    return kernel_residual(data.mean, predict(theta, data), weight)
