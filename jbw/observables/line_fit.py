r"""Step 2's fit of omega_n, zeta and gain to weak random motion, as a likelihood term.

Random motion of rms s has Rayleigh-distributed amplitudes. In it the joint acts as a spring and a
damper,

$$K = \frac{E[F_1(Y)\,Y]}{E[Y^2]}, \qquad \omega_{eq}^2 = k + \mathrm{Re}\,K,
  \qquad 2\zeta_{eq}\omega_{eq}^2 = 2\zeta\omega_n\omega_{eq} + \mathrm{Im}\,K$$

so that a record at 14 um rms gives an omega_n of the joint of Teloli et al. that is 7e-5 too low,
many times its own error. The average neglects that the joint remembers larger amplitudes: a
fiftieth of the shift.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.observables.groups import read_before
from jbw.observables.observable import KnownReading, Laws, Shown, Theta
from jbw.observables.samples import joints_at
from jbw.oscillator.oscillator import Oscillator, oscillator_of
from jbw.quantities import DEFAULT_LAWS

# largest amplitude of random motion, divided by its rms; higher ones have a probability of 1e-8
MOST = 6.0
NUM_NODES = 24
# ratio of amplitude to rms that 99 % of the peaks of narrow-band noise do not exceed
LARGEST = float(np.sqrt(-2 * np.log(0.01)))
MARGIN = 0.05  # standard deviation of neglected effects, relative to the effect of the joint
READ = ("omega_n", "zeta", "gain")
# smallest number of spectral lines for an oscillator, because it has three unknowns and each line
# gives two numbers
LEAST_LINES = 2
# If the response changes between two points by more than this fraction, it has jumped to another
# branch.
JUMP = 0.5


class LineReading(KnownReading):
    """A line fit's omega_n [rad/s], zeta [-] and gain at rms motion `y_rms` [m].

    The covariance is that of these readings; the gain is in N/kg per unit of the input. `solution`
    contains precomputed predictions at the requested points; None if there are none.
    """

    is_linear: ClassVar[bool] = True

    covariance: Float[Array, "read read"]
    y_rms: Float[Array, ""]
    solution: Float[Array, "*point 1 read"] | None = None

    @classmethod
    def of(
        cls,
        mean: Float[np.ndarray, " read"],
        covariance: Float[np.ndarray, "read read"],
        y_rms: float,
        run: str = "",
        *,
        laws: Laws = DEFAULT_LAWS,
    ) -> Self:
        """Build the likelihood term from a line fit's omega_n, zeta and gain at rms motion [m]."""
        arrays = np.asarray(mean)[None], np.asarray(covariance), float(y_rms)
        read, spread, rms = jax.device_put(arrays)
        # The noise is known in advance, as for data with repeats.
        groups = read_before(f"line fit of {run}", run, len(READ), num_repeats=2)
        return cls(spread, rms, mean=read, groups=groups, laws=laws)

    def predict(self, theta: Theta) -> Float[Array, "1 read"]:
        """Predict a line fit's omega_n [rad/s], zeta and gain by Eqs. (23), (39) of the paper."""
        if self.solution is not None:
            return self.solution
        equivalent = _equivalent(oscillator_of(theta, self.laws), self.y_rms)
        return jnp.stack([*equivalent, theta["gain"]])[None]

    def solved(
        self,
        theta: Mapping[str, Float[np.ndarray, " point"]],
        threads: int,
        *,
        writes: bool,
        rows: Float[np.ndarray, "group row value"] | None = None,
    ) -> Self | None:
        """Return this likelihood term, with predictions computed in advance at parameter points.

        One program serves all datasets. None is returned for several modes, and for laws that the
        exact step does not support.
        """
        if (joints := joints_at(theta, self.laws)) is None:
            return None
        equivalent = [
            np.asarray(row)[: len(theta["gain"])] for row in _equivalents(joints, self.y_rms)
        ]
        read = np.stack([*equivalent, np.asarray(theta["gain"])], axis=-1)[:, None]
        return replace(self, laws=(), solution=jax.device_put(read))

    def whitened(
        self, theta: Theta
    ) -> tuple[Float[Array, "1 read"], Float[Array, "1 own read"], Float[Array, ""]]:
        """Return residuals and derivatives in standard deviations, and the log density's constant.

        The term is minus the logarithm of the product of the standard deviations.
        """
        predicted = self.predict(theta)
        linear = jnp.stack([theta[name] for name in READ])
        # Add the variance of effects that averaging over the amplitude neglects.
        margin = jnp.diag((MARGIN * (predicted[0] - linear)) ** 2)
        # If this estimate is held out, its effective number of values is almost zero, and its
        # variance is therefore very large.
        counted = self.groups.num_values[0] / self.groups.num_counted[0]
        scale = self.groups.noise_std[0] ** 2 / counted
        root = jnp.linalg.cholesky(scale * self.covariance + margin)
        columns = jnp.column_stack([(self.mean - predicted).T, self.groups.directions[0].T])
        whitened = jax.scipy.linalg.solve_triangular(root, columns, lower=True)
        return whitened[None, :, 0], whitened[:, 1:].T[None], -jnp.sum(jnp.log(jnp.diag(root)))

    def shown(self, omega_n: float = 1.0) -> Shown:
        """Return the line fit's estimates, and the amplitude [m] that 1 % of all peaks exceed."""
        values = {name: float(x) for name, x in zip(READ, np.asarray(self.mean)[0], strict=True)}
        gain_std = float(np.sqrt(np.asarray(self.covariance)[2, 2]))
        return Shown(lambda: values, gain_std=gain_std, y_peak=float(LARGEST * self.y_rms))


def _equivalent(
    joint: Oscillator, y_rms: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return omega_eq [rad/s] and zeta_eq of a joint in random motion of rms `y_rms` [m]."""
    x, weights = np.polynomial.legendre.leggauss(NUM_NODES)
    size = MOST * (x + 1) / 2
    density = weights * size * np.exp(-(size**2) / 2)
    loops = jax.vmap(joint.loop)(y_rms * size)
    share = density * size**2 / np.sum(density * size**2)
    squared = joint.k + share @ loops.stiffness
    omega = jnp.sqrt(squared)
    zeta = joint.zeta * joint.omega_n / omega + share @ loops.damping / (2 * squared)
    return omega, jnp.asarray(zeta)


@eqx.filter_jit
def _equivalents(
    joints: Oscillator, y_rms: Float[Array, ""]
) -> tuple[Float[Array, " lane"], Float[Array, " lane"]]:
    return jax.vmap(_equivalent, (0, None))(joints, y_rms)


def at_quadrature(
    omega: NDArray[np.float64], u: NDArray[np.complex128], y: NDArray[np.complex128], gain: float
) -> tuple[float, float, float] | None:
    r"""Return amplitude [m], frequency [rad/s] and damping where the response lags by 90 degrees.

    $$\arg (Y/U) = -\tfrac{\pi}{2}: \qquad \omega = \omega(|Y|), \qquad
      \zeta(|Y|) = \frac{g\,|U|}{2 \omega^2 |Y|}$$

    as for the first harmonics of any joint. Between two points a straight line is used. None is
    returned if no two consecutive points lie on either side, or if the motion jumps between them.
    """
    ratio = y / u
    (turns,) = np.nonzero((ratio.real[:-1] > 0) != (ratio.real[1:] > 0))
    for i in turns:
        pair = slice(i, i + 2)
        if np.ptp(np.abs(ratio[pair])) > JUMP * np.abs(ratio[i]) or np.any(ratio.imag[pair] >= 0):
            continue
        part = ratio[i].real / (ratio[i].real - ratio[i + 1].real)
        w, size, moved = (
            series[i] + part * (series[i + 1] - series[i])
            for series in (omega, np.abs(u), -ratio.imag)
        )
        return float(size * moved), float(w), float(gain / (2 * w**2 * moved))
    return None
