"""The types of parameters, and the tables that describe a law."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.quantities import Quantity
from jbw.report.messages import joint as messages

# Users may pass NumPy values; in traced functions all values are JAX's, which pyright cannot know.
Scalar = Float[Array, "..."] | Float[np.ndarray, "..."] | float
Restoring = Callable[[Scalar], Scalar]


@runtime_checkable
class Hysteresis(Protocol):
    """Any object with the Bouc-Wen parameters of Eq. (2): a `BoucWen`, or the law alone."""

    alpha: Any
    delta: Any
    gamma: Any
    nu: Any


def batched(function: Callable[..., Any], *arguments: Any) -> Any:
    """Apply a function of scalars to every element of arrays, with broadcasting."""
    leaves, structure = jax.tree.flatten(arguments)
    leaves = jnp.broadcast_arrays(*(jnp.asarray(leaf, float) for leaf in leaves))
    shape = leaves[0].shape
    flat = jax.tree.unflatten(structure, [leaf.ravel() for leaf in leaves])
    results = jax.vmap(function)(*flat)
    return jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), results)


Powers = Mapping[str, int]
Bounds = dict[str, tuple[float, float]]

# Frequency [rad/s] of motion so slow that velocity-dependent forces are negligible.
SLOW = 1e-12
# Largest ratio of the stiffness at rest to the secant stiffness of the widest loop.
MOST_SOFTENING = 10.0


class Scales(NamedTuple):
    """Scales of the measured motion, which are known before any fit.

    Attributes:
        omega_n: Natural frequency at small amplitude [rad/s]; if `forced`, the frequency that
            belongs to the secant stiffness of the stiffest loop.
        zeta: Damping ratio [-].
        y_peak: Largest displacement measured [m].
        forced: Whether all tests prescribe the displacement, so that the joint may carry all of the
            force.
    """

    omega_n: float
    zeta: float
    y_peak: float
    forced: bool = False


class Monomial(NamedTuple):
    r"""A quantity that is a product of powers of other quantities, $\prod_i \theta_i^{p_i}$.

    Attributes:
        quantity: The quantity: name, symbol, unit, meaning.
        powers: Integer exponents by name of the factor.
    """

    quantity: Quantity
    powers: Powers

    @property
    def name(self) -> str:
        """The name of the quantity."""
        return self.quantity.name

    def of(self, theta: Mapping[str, Any]) -> Any:
        """Return the value of the product of powers."""
        value: Any = 1.0
        for name, power in sorted(self.powers.items(), key=lambda item: item[1] < 0):
            factor = theta[name] ** abs(power) if abs(power) != 1 else theta[name]
            value = value * factor if power > 0 else value / factor
        return value


class Coordinates(NamedTuple):
    """Another parametrisation of a law, in which it may be sampled.

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
        """The names of the coordinates."""
        return tuple(monomial.name for monomial in self.inverse)

    @property
    def table(self) -> tuple[Quantity, ...]:
        """The quantities of the coordinates: name, symbol, unit and meaning."""
        return tuple(monomial.quantity for monomial in self.inverse)

    def to_parameters(self, theta: Mapping[str, Any]) -> dict[str, Any]:
        """Convert these coordinates to the law's own parameters; keep all other entries."""
        rest = {name: value for name, value in theta.items() if name not in self.names}
        return rest | {monomial.name: monomial.of(theta) for monomial in self.forward}

    def from_parameters(self, theta: Mapping[str, Any]) -> dict[str, Any]:
        """Convert the law's own parameters to these coordinates; keep all other entries."""
        law_names = {monomial.name for monomial in self.forward}
        rest = {name: value for name, value in theta.items() if name not in law_names}
        return rest | {monomial.name: monomial.of(theta) for monomial in self.inverse}

    def powers(self, powers: Powers) -> dict[str, int]:
        """Return powers of the law's parameters as powers of the coordinates and omega_n."""
        forward = {monomial.name: monomial.powers for monomial in self.forward}
        total: dict[str, int] = {}
        for name, power in powers.items():
            for factor, inner in forward.get(name, {name: 1}).items():
                total[factor] = total.get(factor, 0) + power * inner
        return {name: power for name, power in total.items() if power}


class Threshold(NamedTuple):
    """A displacement above which a mechanism of a law, such as slip, acts.

    Attributes:
        what: Mechanism that begins at this displacement, such as "macroslip".
        y: The displacement [m].
        rests: Quantities that only the prior determines if no motion reaches the displacement.
    """

    what: str
    y: Scalar
    rests: str


class Loop(NamedTuple):
    r"""The steady loop of a law for y = Y cos(theta), F = Re sum F_n exp(j n theta).

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
    """A uniaxial material of OpenSees, in units of N, m and kg.

    Attributes:
        kind: Name of the material in OpenSees, such as `ElasticPP`.
        arguments: Arguments after the material's tag; some may be words.
    """

    kind: str
    arguments: tuple[Scalar | str, ...]


class Conversion(NamedTuple):
    """An oscillator in the convention of another program.

    Attributes:
        values: Parameters by their names in the other program.
        units: Units of these parameters.
        materials: The law's own force as OpenSees materials in parallel, without the parallel
            spring.
    """

    values: Mapping[str, float]
    units: Mapping[str, str]
    materials: tuple[Material, ...] = ()


def of_opensees(*materials: Material) -> dict[str, Conversion]:
    """Return the conversion of a law that only OpenSees has."""
    return {"OpenSees": Conversion({}, {}, materials)}


def beyond_all_motion(name: str, bounds: tuple[float, float], y_peak: float) -> str | None:
    """Return a warning if the prior includes gaps wider than the largest motion [m]."""
    least, most = bounds
    return None if most <= y_peak else messages.prior_beyond_motion(name, least, most, y_peak)
