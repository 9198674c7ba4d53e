r"""The line fit of Step 2 as an observable: what it reads is a joint in weak random motion.

Random motion of rms s has Rayleigh amplitudes. To it the joint is a spring and a damper,

$$K = \frac{E[Z_1(Y)\,Y]}{E[Y^2]}, \qquad \omega_{eq}^2 = \omega_n^2 - \alpha + \mathrm{Re}\,K,
  \qquad 2\zeta_{eq}\omega_{eq}^2 = 2\zeta\omega_n\omega_{eq} + \mathrm{Im}\,K$$

so a record at 14 um rms reads omega_n of the paper's joint 7e-5 low, many times its own error. The
average leaves out how the joint remembers larger amplitudes: a fiftieth of the shift.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.offsets import Estimate, known_estimate
from jbw.observables.harmonics import first_harmonic
from jbw.observables.joint import joint_of

MOST = 6.0  # rms: amplitudes beyond have a share of 1e-8
NUM_NODES = 24
MARGIN = 0.05  # of the joint's shift of a reading: a standard deviation for what is left out
READ = ("omega_n", "zeta", "gain")


class LineReading(eqx.Module):
    """Natural frequency, damping and gain as a line fit of random motion reads them.

    Attributes:
        mean: omega_n [rad/s], zeta [-], gain [N/kg per unit of the input].
        covariance: Theirs.
        y_rms: Displacement of the motion, rms [m].
        directions: Change of the reading by each offset of the run; no offsets, no rows.
        run: Name of the run; static.
    """

    mean: Float[Array, " read"]
    covariance: Float[Array, "read read"]
    y_rms: Float[Array, ""]
    directions: Float[Array, "own read"]
    run: str = eqx.field(static=True, default="")


def line_reading(
    mean: Float[np.ndarray, " read"],
    covariance: Float[np.ndarray, "read read"],
    y_rms: float,
    run: str = "",
) -> LineReading:
    """A line fit's result as data.

    Args:
        mean: omega_n, zeta and gain.
        covariance: Theirs.
        y_rms: Displacement, rms [m].
        run: Name of the run.
    """
    return LineReading(
        jnp.asarray(mean),
        jnp.asarray(covariance),
        jnp.asarray(float(y_rms)),
        jnp.zeros((0, len(READ))),
        run,
    )


def predict(theta: Mapping[str, Array], data: LineReading) -> Float[Array, " read"]:
    """Equivalent natural frequency and damping of the joint in random motion, and the gain.

    Args:
        theta: The joint's parameters and `gain`.
        data: The reading.

    Returns:
        omega_eq [rad/s], zeta_eq [-], gain.

    Reference:
        Eqs. (23), (39), the joint's harmonic Z_1 averaged over Rayleigh's amplitudes.
    """
    joint = joint_of(theta)
    x, weights = np.polynomial.legendre.leggauss(NUM_NODES)
    size = MOST * (x + 1) / 2
    density = weights * size * np.exp(-(size**2) / 2)
    y = data.y_rms * size
    z_1 = jax.vmap(lambda one: first_harmonic(joint, one))(y)
    share = density * size / np.sum(density * size**2)
    stiffness = share @ z_1 / data.y_rms
    squared = joint.omega_n**2 - joint.alpha + stiffness.real
    omega = jnp.sqrt(squared)
    zeta = joint.zeta * joint.omega_n / omega + stiffness.imag / (2 * squared)
    return jnp.stack([omega, zeta, theta["gain"]])


def whitened(
    theta: Mapping[str, Array], data: LineReading
) -> tuple[Float[Array, "1 read"], Float[Array, "1 own read"], Float[Array, ""]]:
    """Read less predicted, and the offsets' directions, in standard deviations.

    The covariance is the line fit's, and that of what the average over amplitudes leaves out.

    Returns:
        Residual and directions as one group, and the log of the standard deviations' product.
    """
    predicted = predict(theta, data)
    linear = jnp.stack([theta[name] for name in READ])
    margin = jnp.diag((MARGIN * (predicted - linear)) ** 2)
    root = jnp.linalg.cholesky(data.covariance + margin)
    columns = jnp.column_stack([data.mean - predicted, data.directions.T])
    left = jax.scipy.linalg.solve_triangular(root, columns, lower=True)
    return left[None, :, 0], left[:, 1:].T[None], jnp.sum(jnp.log(jnp.diag(root)))


def estimate_of(theta: Mapping[str, Array], data: LineReading) -> Estimate:
    """What the reading says, its covariance known."""
    left, directions, log_std = whitened(theta, data)
    found = known_estimate(left, directions)
    return found._replace(log_density=found.log_density - log_std)
