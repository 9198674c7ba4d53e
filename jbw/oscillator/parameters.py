"""Types of parameters, and the records with which a law is described."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.quantities import Quantity
from jbw.report.messages import joint as messages

# A caller may give NumPy's; inside of what is traced all is JAX's, which pyright cannot know.
Scalar = Float[Array, "..."] | Float[np.ndarray, "..."] | float
Restoring = Callable[[Scalar], Scalar]


@runtime_checkable
class Hysteresis(Protocol):
    """Whatever holds the parameters of Eq. (2): the record `BoucWen`, or the law alone."""

    alpha: Any
    delta: Any
    gamma: Any
    nu: Any


def batched(function: Callable[..., Any], *arguments: Any) -> Any:
    """Apply a function of scalar leaves over the broadcast shape of all leaves."""
    leaves, structure = jax.tree.flatten(arguments)
    leaves = jnp.broadcast_arrays(*(jnp.asarray(leaf, float) for leaf in leaves))
    shape = leaves[0].shape
    flat = jax.tree.unflatten(structure, [leaf.ravel() for leaf in leaves])
    results = jax.vmap(function)(*flat)
    return jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), results)


Powers = Mapping[str, int]
Bounds = dict[str, tuple[float, float]]

# Frequency of a motion that no force of the velocity resists [rad/s].
SLOW = 1e-12
MOST_SOFTENING = 10.0  # stiffness at rest over the secant of the widest loop, at most


class Scales(NamedTuple):
    """Scales of the motion, from before any law is fitted.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s]; where tests are `forced`, that of the
            secant of the stiffest loop.
        zeta: Damping ratio [-].
        y_peak: Largest displacement measured [m].
        forced: Whether all tests prescribe the displacement, so that nothing else than the joint
            need carry.
    """

    omega_n: float
    zeta: float
    y_peak: float
    forced: bool = False


class Monomial(NamedTuple):
    r"""A quantity that is a product of powers of others, $\prod_i \theta_i^{p_i}$.

    Attributes:
        quantity: The quantity: name, symbol, unit, meaning.
        powers: Whole exponents by name of the factor.
    """

    quantity: Quantity
    powers: Powers

    @property
    def name(self) -> str:
        """Name of the quantity."""
        return self.quantity.name

    def of(self, theta: Mapping[str, Any]) -> Any:
        """Return the monomial's value: multiply the positive powers, then divide by the others."""
        value: Any = 1.0
        for name, power in sorted(self.powers.items(), key=lambda item: item[1] < 0):
            factor = theta[name] ** abs(power) if abs(power) != 1 else theta[name]
            value = value * factor if power > 0 else value / factor
        return value


class Coordinates(NamedTuple):
    """Another parametrisation in which a law is sampled, one to one with its parameters.

    Attributes:
        name: Name in `[identify] coordinates`, such as "products".
        forward: The law's parameters, as powers of the coordinates and omega_n.
        inverse: The coordinates, as powers of the law's parameters and omega_n.
    """

    name: str
    forward: tuple[Monomial, ...]
    inverse: tuple[Monomial, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(monomial.name for monomial in self.inverse)

    @property
    def table(self) -> tuple[Quantity, ...]:
        """The coordinates' quantities."""
        return tuple(monomial.quantity for monomial in self.inverse)

    def to_parameters(self, theta: Mapping[str, Any]) -> dict[str, Any]:
        """Return the same point in the law's own parameters; everything else in theta as it is."""
        rest = {name: value for name, value in theta.items() if name not in self.names}
        return rest | {monomial.name: monomial.of(theta) for monomial in self.forward}

    def from_parameters(self, theta: Mapping[str, Any]) -> dict[str, Any]:
        """Return the same point in these coordinates; everything else in theta as it is."""
        law_names = {monomial.name for monomial in self.forward}
        rest = {name: value for name, value in theta.items() if name not in law_names}
        return rest | {monomial.name: monomial.of(theta) for monomial in self.inverse}

    def powers(self, powers: Powers) -> dict[str, int]:
        """Convert powers of the law's parameters to powers of the coordinates and omega_n."""
        forward = {monomial.name: monomial.powers for monomial in self.forward}
        total: dict[str, int] = {}
        for name, power in powers.items():
            for factor, inner in forward.get(name, {name: 1}).items():
                total[factor] = total.get(factor, 0) + power * inner
        return {name: power for name, power in total.items() if power}


class Threshold(NamedTuple):
    """A displacement beyond which a mechanism of a law acts that smaller motions do not identify.

    Attributes:
        what: The mechanism that begins there, such as "macroslip".
        y: The displacement [m].
        rests: What the prior alone determines where no motion reaches it.
    """

    what: str
    y: Scalar
    rests: str


class Loop(NamedTuple):
    r"""Steady loop of a law for y = Y cos(theta), F = Re sum F_n exp(j n theta).

    Attributes:
        stiffness: Equivalent stiffness, Re F_1 / Y [1/s^2].
        damping: Equivalent damping times omega, Im F_1 / Y = E / (pi Y^2) [1/s^2].
    """

    stiffness: Float[Array, "..."]
    damping: Float[Array, "..."]

    def energy(self, y_peak: Scalar) -> Float[Array, "..."]:
        """Return the energy dissipated in a cycle, E [J/kg]."""
        return jnp.pi * self.damping * jnp.asarray(y_peak) ** 2


class Material(NamedTuple):
    """A uniaxial material of OpenSees, in N, m and kg.

    Attributes:
        kind: Its name there, such as `ElasticPP`.
        arguments: What follows its tag, words among them.
    """

    kind: str
    arguments: tuple[Scalar | str, ...]


class Conversion(NamedTuple):
    """An oscillator in the convention of another program.

    Attributes:
        values: Its parameters by their names there.
        units: Their units.
        materials: The law's own force in OpenSees, without the spring beside it; in parallel.
    """

    values: Mapping[str, float]
    units: Mapping[str, str]
    materials: tuple[Material, ...] = ()


def of_opensees(*materials: Material) -> dict[str, Conversion]:
    """Return the conversions of a law that only OpenSees has, as materials."""
    return {"OpenSees": Conversion({}, {}, materials)}


def beyond_all_motion(name: str, bounds: tuple[float, float], y_peak: float) -> str | None:
    """Return a warning of a prior on a gap that is wider than the largest motion [m], or None."""
    least, most = bounds
    return None if most <= y_peak else messages.prior_beyond_motion(name, least, most, y_peak)
