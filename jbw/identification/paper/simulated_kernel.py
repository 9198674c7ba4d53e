r"""Simulated measurements of the third-order kernel, to test the likelihood of Step 3.

Nothing here is shared with that likelihood. The formulas are written again on purpose, so that a
factor missing there is not missing here too.
"""

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Complex, Float, Key

from jbw.identification.paper import kernel
from jbw.identification.paper.kernel import KernelData
from jbw.inference.calibration.replications import Quantity
from jbw.inference.space.problem import Theta

UNKNOWN = 4.0


def measured_kernel(
    key: Key[Array, ""],
    theta: Theta,
    design: KernelData,
    num_repeats: int,
    *,
    known_noise: bool = False,
) -> KernelData:
    r"""Simulate noisy repeats of the third-order kernel; reduce them as for its fit (Step 3).

    As in a campaign, the noise is unknown. It is drawn for every frequency, uniformly in its
    logarithm over a factor `UNKNOWN` to either side of the design's. This is the prior 1/sigma of
    a likelihood that integrates the noise out, except for its two ends. Least squares use

    $$\hat\sigma_i^2 = \frac{1}{2(K - 1)} \sum_k |H_{ik} - \bar H_i|^2$$

    With `known_noise` the noise is the design's, and the likelihood knows it, as (36) assumes.
    """
    noise_std = design.noise_std
    if not known_noise:
        key, key_size = jax.random.split(key)
        spread = jax.random.uniform(key_size, (design.omega.size,), minval=-1.0)
        noise_std = noise_std * UNKNOWN**spread
    noise = jax.random.normal(key, (2, num_repeats, design.omega.size)) * noise_std
    repeats = kernel_values(theta, design) + noise[0] + 1j * noise[1]
    mean = jnp.mean(repeats, axis=0)
    within = jnp.sum(jnp.abs(repeats - mean) ** 2, axis=0)
    scatter = jnp.sqrt(within / (2 * (num_repeats - 1)))
    return replace(
        design, mean=mean, within=within, noise_std=noise_std if known_noise else scatter
    )


def kernel_values(theta: Theta, design: KernelData) -> Complex[Array, " freq"]:
    r"""Return the third-order kernel of Teloli et al. by an independent implementation.

    $$H_3(\omega) = \frac{-\alpha\,(\delta^2/6 - 35\,\delta/(96 Y))}
      {(\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega)^3\,
       (\omega_n^2 - 9\omega^2 + 6j\zeta\omega_n\omega)} \quad [m^{-2} s^6]$$

    Reference:
        Eqs. (23), (25), (31).
    """
    zeta, alpha, delta = (theta[name] for name in ("zeta", "alpha", "delta"))
    omega, omega_n = design.omega, design.omega_n
    first = omega_n**2 - omega**2 + 2j * zeta * omega_n * omega
    third = omega_n**2 - 9 * omega**2 + 6j * zeta * omega_n * omega
    cubic = alpha * delta**2 / 6 - 35 * alpha * delta / (96 * design.y_peak)
    return -cubic / (first**3 * third)


def ranked_quantities(design: KernelData) -> Mapping[str, Quantity]:
    """Return lambda_3 and |H3|, which the kernel H3 determines better than single parameters."""
    hertz = np.asarray(design.omega) / (2 * np.pi)
    tones = {f"h3_{f:.4g}Hz": Partial(_h3_magnitude, index=i) for i, f in enumerate(hertz)}
    return {"lambda_3": _lambda_3, **tones}


def _lambda_3(theta: Theta, data: KernelData) -> Float[Array, ""]:
    """Return the cubic coefficient lambda_3 of Eq. (31) at the displacement of the first tone."""
    delta, y_peak = theta["delta"], data.y_peak[0]
    return theta["alpha"] * (delta**2 / 6 - 35 * delta / (96 * y_peak))


def _h3_magnitude(theta: Theta, data: KernelData, index: int) -> Float[Array, ""]:
    return jnp.abs(kernel.predict(theta, data))[index]
