"""The joint: parameters of the single-mode Bouc-Wen oscillator."""

from collections.abc import Callable

import equinox as eqx
from jax.tree_util import Partial, all_leaves
from jaxtyping import Array, Float

Scalar = Float[Array, "..."] | float
Restoring = Callable[[Scalar], Scalar]


def _as_pytree(force: Restoring | None) -> Restoring | None:
    """A plain function as a pytree without leaves; a pytree as it is."""
    return Partial(force) if callable(force) and all_leaves([force]) else force


class BoucWen(eqx.Module):
    r"""Single-mode Bouc-Wen oscillator, per unit modal mass.

    $$\ddot y + 2\zeta\omega_n\dot y + k\,y + Z = u, \qquad k = \omega_n^2 - \alpha$$
    $$\dot Z = \alpha\dot y - \gamma|\dot y||Z|^{\nu-1}Z - \delta\dot y|Z|^\nu$$

    `omega_n` is the natural frequency at small amplitude, where the joint sticks. Leaves may be
    scalars or arrays of one shape (a batch of joints). A force f(y) of `restoring` is added to
    the left side of the first equation; None, the default, is the paper's model.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        alpha: Stiffness of the hysteretic part [1/s^2].
        delta: Softening of the hysteresis [1/m for nu = 1].
        gamma: Opening of the hysteresis loop [1/m for nu = 1].
        nu: Smoothness exponent [-]; static.
        restoring: Smooth force beside the hysteretic one, from y [m] to f(y) [N/kg], such as
            `Cubic`; a pytree whose leaves are parameters too.

    Reference:
        Eqs. (1), (2), (39).
    """

    omega_n: Scalar
    zeta: Scalar
    alpha: Scalar
    delta: Scalar
    gamma: Scalar
    nu: float = eqx.field(default=1.0, static=True)
    restoring: Restoring | None = eqx.field(default=None, converter=_as_pytree)

    @property
    def k(self) -> Scalar:
        """Stiffness beside the joint, omega_n^2 - alpha [1/s^2]."""
        return self.omega_n**2 - self.alpha
