"""The single-mode oscillator, with any number of force laws in parallel across its joint."""

from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial, all_leaves
from jaxtyping import Array, Float

from jbw.oscillator.law import Bounds, Law, Loop, Memory, Scales
from jbw.oscillator.laws import Kind, laws_named
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.springs import as_law
from jbw.oscillator.modes.assembled import first_mode_laws
from jbw.oscillator.parameters import SLOW, Restoring, Scalar
from jbw.quantities import are_at_joints


class Oscillator(eqx.Module):
    r"""A single-mode oscillator, per unit modal mass, with the forces F_l of its laws.

    $$\ddot y + 2\zeta\omega_n\dot y + k\,y + \sum_l F_l = u, \qquad
      k = \omega_n^2 - \sum_l K_l$$

    `omega_n` is the natural frequency at small amplitude, where each law acts with its stiffness at
    rest K_l. An oscillator without laws is linear. Leaves are scalars, or arrays of one shape for a
    batch of oscillators.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        laws: The forces across the joint.

    Reference:
        Eqs. (1), (39).

    Examples:
        The resonance [rad/s] of two parallel laws begins at omega_n and falls as the joint slips:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> law = jbw.laws.BoucWenLaw(alpha=500.0, delta=340.0, gamma=33.0)
        >>> joint = jbw.Oscillator(omega_n=100.0, zeta=0.01, laws=(law, jbw.Cubic(1e6)))
        >>> print(jbw.backbone(joint, np.array([0.0, 1e-3])).omega.round(2))
        [100.    99.67]
    """

    omega_n: Scalar
    zeta: Scalar
    laws: tuple[Law, ...] = eqx.field(default=(), converter=tuple)

    @property
    def k(self) -> Scalar:
        """The stiffness in parallel with the laws, omega_n^2 - sum K [1/s^2]."""
        return self.omega_n**2 - sum(law.stiffness() for law in self.laws)

    def at_rest(self) -> tuple[Memory, ...]:
        """Return the internal states of the laws before any motion."""
        return tuple(law.at_rest() for law in self.laws)

    def force(self, y: Scalar, v: Scalar, memory: tuple[Memory, ...]) -> Scalar:
        """Return the sum of the laws' forces [N/kg]."""
        pairs = zip(self.laws, memory, strict=True)
        return sum((law.force(y, v, law_memory) for law, law_memory in pairs), 0.0 * y)

    def move(self, y: Scalar, memory: tuple[Memory, ...], dy: Scalar) -> tuple[Memory, ...]:
        """Return the laws' internal states after a monotone move from y to y + dy."""
        pairs = zip(self.laws, memory, strict=True)
        return tuple(law.move(y, law_memory, dy) for law, law_memory in pairs)

    def follow(self, y: Scalar, memory: tuple[Memory, ...], dy: Scalar) -> tuple[Memory, ...]:
        """Return the laws' internal states after one of the many short moves along a record."""
        pairs = zip(self.laws, memory, strict=True)
        return tuple(
            getattr(law, "follow", law.move)(y, law_memory, dy) for law, law_memory in pairs
        )

    def at_tip(self, y_peak: Scalar) -> tuple[Memory, ...]:
        """Return the laws' internal states at the tip y = Y of the steady loop."""
        return tuple(law.at_tip(y_peak) for law in self.laws)

    def loop(self, y_peak: Scalar, omega: Scalar | None = None) -> Loop:
        """Return the equivalent stiffness and damping of all laws together at amplitude Y [m].

        Velocity-dependent forces are evaluated at omega [rad/s]. By default this is the resonance
        at this amplitude, with the effect of these forces on the frequency to first order. Even
        springs k_2 y^2 shift the mean by -k_2 Y^2/(2 omega_n^2) and add a second harmonic of k_2
        Y^2/(6 omega_n^2). Together these lower the stiffness by 5 k_2^2 Y^2/(6 omega_n^2).
        """
        none = 0.0 * jnp.asarray(y_peak, float)
        loops = [law.loop(y_peak) for law in self.laws]
        if any(law.feels_rate for law in self.laws):
            if omega is None:
                omega = jnp.sqrt(self.k + sum((x.stiffness for x in loops), none))
            loops = [law.loop(y_peak, omega) for law in self.laws]
        stiffness = sum((x.stiffness for x in loops), none)
        damping = sum((x.damping for x in loops), none)
        if squares := [law.force(1.0, 0.0, ()) for law in self.laws if law.is_even]:
            softening = 5.0 / 6.0 * (sum(squares) * jnp.asarray(y_peak, float) / self.omega_n) ** 2
            stiffness = stiffness - softening
        return Loop(stiffness, damping)

    @property
    def undamaged(self) -> "Oscillator":
        """The oscillator before damage, with laws that have not yet degraded."""
        laws = tuple(law.undamaged() if law.degrades else law for law in self.laws)  # pyright: ignore[reportAttributeAccessIssue]
        return Oscillator(self.omega_n, self.zeta, laws)

    def force_along(
        self, y: Float[Array, " time"], *, from_tip: bool = False
    ) -> Float[Array, " time"]:
        """Return the force k y + sum F [N/kg] along a slow path of displacement.

        The path begins at rest or, if asked, at the tip of the steady loop to its first value.
        """

        def onward(carry: tuple, y_next: Array) -> tuple[tuple, Array]:
            y_last, memory = carry
            dy = y_next - y_last
            memory = self.follow(y_last, memory, dy)
            return (y_next, memory), self.force(y_next, SLOW * dy, memory)  # pyright: ignore[reportReturnType]

        begun = (y[0], self.at_tip(y[0])) if from_tip else (0.0, self.at_rest())
        start = jax.tree.map(lambda x: jnp.asarray(x, float), begun)
        return self.k * y + jax.lax.scan(onward, start, y)[1]  # pyright: ignore[reportReturnType]

    def force_unloading(self, y_peak: Scalar, y: Float[Array, " phase"]) -> Float[Array, " phase"]:
        """Return the laws' total force [N/kg] on unloading from the tip Y of the steady loop."""
        top = self.at_tip(y_peak)
        return jax.vmap(lambda to: self.force(to, -SLOW, self.move(y_peak, top, to - y_peak)))(y)  # pyright: ignore[reportReturnType]

    def parameters(self) -> dict[str, Any]:
        """Return omega_n, zeta and the laws' parameters by name."""
        mode_parameters = {"omega_n": self.omega_n, "zeta": self.zeta}
        return mode_parameters | {
            name: x for law in self.laws for name, x in law.parameters().items()
        }


def _as_pytree(force: Restoring | None) -> Restoring | None:
    """Return a plain function as a pytree without leaves; return a pytree unchanged."""
    return Partial(force) if callable(force) and all_leaves([force]) else force


class BoucWen(eqx.Module):
    r"""A single-mode Bouc-Wen oscillator, per unit modal mass.

    $$\ddot y + 2\zeta\omega_n\dot y + k\,y + Z = u, \qquad k = \omega_n^2 - \alpha$$
    $$\dot Z = \alpha\dot y - \gamma|\dot y||Z|^{\nu-1}Z - \delta\dot y|Z|^\nu$$

    `omega_n` is the natural frequency at small amplitude, where the joint is fully stuck. Leaves
    may be scalars or arrays of one shape (a batch of joints). `restoring` adds a force f(y) to the
    left side of the first equation; None, the default, gives the model of Teloli et al.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s].
        zeta: Viscous damping ratio [-].
        alpha: Stiffness of the hysteretic part [1/s^2].
        delta: Softening of the hysteresis [1/m for nu = 1].
        gamma: Opening of the hysteresis loop [1/m for nu = 1].
        nu: Smoothness exponent [-]; static.
        restoring: Smooth force in addition to the hysteretic one, from y [m] to f(y) [N/kg], such
            as `Cubic`; a pytree whose leaves are parameters too.

    Reference:
        Eqs. (1), (2), (39).

    Examples:
        A joint that slips fully carries alpha / (delta + gamma):

        >>> import jbw; jbw.enable_x64()
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> loop = jbw.steady_loop(joint, y_peak=0.05)
        >>> print(f"{loop.z_max:.4f} N/kg")
        1.3335 N/kg
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
        """The stiffness in parallel with the joint, omega_n^2 - alpha [1/s^2]."""
        return self.omega_n**2 - self.alpha

    @property
    def laws(self) -> tuple[Law, ...]:
        """The laws across the joint: the Bouc-Wen law and, if given, that of `restoring`."""
        springs = () if self.restoring is None else (as_law(self.restoring),)
        return (BoucWenLaw(self.alpha, self.delta, self.gamma, self.nu), *springs)


Joint = Oscillator | BoucWen


def as_oscillator(joint: Joint) -> Oscillator:
    """Return a joint as an `Oscillator`; convert it if it is a `BoucWen`."""
    if isinstance(joint, Oscillator):
        return joint
    return Oscillator(joint.omega_n, joint.zeta, joint.laws)


def oscillator_of(theta: Mapping[str, Any], laws: Iterable[str | Kind]) -> Oscillator:
    """Return the oscillator with parameters given by name; several joints share its one mode."""
    laws = tuple(laws)
    if are_at_joints(laws):
        forces = first_mode_laws(theta, laws)  # pyright: ignore[reportArgumentType]
    else:
        forces = tuple(law.build(theta) for law in laws_named(laws))
    return Oscillator(theta["omega_n"], theta["zeta"], forces)


def prior_of(laws: Iterable[str | Kind], scales: Scales) -> Bounds:
    """Return wide prior bounds of all parameters of several laws, from scales of the motion."""
    bounds: Bounds = {}
    for law in laws_named(laws):
        bounds |= law.prior(scales)
    return bounds
