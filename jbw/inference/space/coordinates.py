r"""Changes of variable between the coordinates of a sampler and the parameters.

A coordinate maps a vector x to a vector y = f(x), in the order of the prior box, one to one and
smoothly. A density transforms with the determinant of its derivatives,

$$p(x) = p(y)\,\left|\det \frac{\partial f}{\partial x}\right|$$

so that a sampler may use any coordinate x.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Inexact
from numpyro.distributions import biject_to, constraints
from numpyro.distributions.transforms import Transform

Vector = Float[Any, " parameter"]  # a NumPy array outside of compiled code
# One point, or one point per row; complex if derivatives are taken. Changes of variable that treat
# each parameter alone accept several rows.
Points = Inexact[Any, "*point parameter"]


def namespace(values: Any) -> Any:
    """Return NumPy for NumPy arrays, which compiles nothing, otherwise JAX's NumPy."""
    return np if isinstance(values, np.ndarray) else jnp


class Coordinate(eqx.Module):
    """A change of variable; its fields are arrays, so that they may change under `jit`."""

    @abstractmethod
    def forward(self, x: Vector) -> Vector:
        """Return the point y = f(x)."""

    @abstractmethod
    def inverse(self, y: Vector) -> Vector:
        """Return the point x for which y = f(x)."""

    @abstractmethod
    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the logarithm of the absolute determinant of dy/dx at x."""


class Affine(Coordinate):
    """A linear map $y = c + L x$, such as normalisation by a covariance $L L^T$."""

    centre: Vector
    factor: Float[Array, "parameter parameter"]
    log_det: Float[Array, ""]

    def __init__(self, centre: Any, factor: Any) -> None:
        if isinstance(factor, np.ndarray):  # NumPy avoids compiling a program
            log_det = np.linalg.slogdet(factor)[1]
            self.centre, self.factor, self.log_det = jax.device_put((centre, factor, log_det))
        else:
            self.centre, self.factor = centre, factor
            self.log_det = jnp.linalg.slogdet(factor)[1]

    def forward(self, x: Vector) -> Vector:
        """Return the point c + L x."""
        return self.centre + self.factor @ x

    def inverse(self, y: Vector) -> Vector:
        """Return the point x for which y = c + L x."""
        return jnp.linalg.solve(self.factor, y - self.centre)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the logarithm of |det L|, which is constant."""
        return self.log_det


class Elementwise(Coordinate):
    """A separate change of variable for each parameter, by one of NumPyro's transforms."""

    transform: Transform

    def forward(self, x: Vector) -> Vector:
        """Return the transformed point."""
        return jnp.asarray(self.transform(x))

    def inverse(self, y: Vector) -> Vector:
        """Return the point whose transform is y."""
        return jnp.asarray(self.transform.inv(y))

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant: the sum of the logarithms of the slopes."""
        return jnp.sum(self.transform.log_abs_det_jacobian(x, self.transform(x)))


def interval(lower: Vector, upper: Vector) -> Elementwise:
    r"""Return the map from real numbers to an interval, $y = l + (u - l) / (1 + e^{-x})$."""
    return Elementwise(biject_to(constraints.interval(lower, upper)))


class Scaled(Coordinate):
    r"""The map from the unit cube to given bounds, $y = l + (u - l)\,x$."""

    lower: Vector
    width: Vector

    def forward(self, x: Points) -> Points:
        """Return the point l + (u - l) x."""
        xp = namespace(x)
        return xp.asarray(self.lower) + xp.asarray(self.width) * x

    def inverse(self, y: Vector) -> Vector:
        """Return the point (y - l) / (u - l)."""
        xp = namespace(y)
        return (y - xp.asarray(self.lower)) / xp.asarray(self.width)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant: the sum of the logarithms of the widths."""
        return jnp.sum(jnp.log(self.width))


def unit(lower: Vector, upper: Vector) -> Scaled:
    r"""Return the map from the unit cube to given bounds, $y = l + (u - l)\,x$."""
    ends = lower, upper - lower
    return Scaled(*(jax.device_put(ends) if namespace(lower) is np else ends))


class Logarithms(Coordinate):
    """Logarithms of some parameters, $y_i = e^{x_i}$; valleys of constant products are straight."""

    chosen: tuple[bool, ...] = eqx.field(static=True)

    def forward(self, x: Points) -> Points:
        """Return the point with the chosen coordinates exponentiated."""
        xp = namespace(x)
        return xp.where(self._mask, xp.exp(xp.where(self._mask, x, 0.0)), x)

    def inverse(self, y: Vector) -> Vector:
        """Return the point with the logarithms of chosen parameters."""
        xp = namespace(y)
        return xp.where(self._mask, xp.log(xp.where(self._mask, y, 1.0)), y)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant: the sum of the chosen logarithms."""
        return jnp.sum(jnp.where(self._mask, x, 0.0))

    @property
    def _mask(self) -> np.ndarray:
        return np.array(self.chosen)


class Sinh(Coordinate):
    r"""The map $y_i = c_i \sinh x_i$ of some parameters, like a logarithm that admits both signs.

    The scales are c for chosen parameters, and zero for the others, which do not change.
    """

    scale: Vector

    def forward(self, x: Points) -> Points:
        """Return the point c sinh x for chosen parameters."""
        xp = namespace(x)
        scale = xp.asarray(self.scale)
        return xp.where(scale > 0, scale * xp.sinh(xp.where(scale > 0, x, 0.0)), x)

    def inverse(self, y: Vector) -> Vector:
        """Return the point arsinh(y / c) for chosen parameters."""
        xp = namespace(y)
        scale = xp.asarray(self.scale)
        return xp.where(scale > 0, xp.arcsinh(y / xp.where(scale > 0, scale, 1.0)), y)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant: the sum of log(c cosh x) over chosen parameters."""
        chosen = self.scale > 0
        slope = jnp.where(chosen, self.scale, 1.0) * jnp.cosh(jnp.where(chosen, x, 0.0))
        return jnp.sum(jnp.log(slope))


class Composed(Coordinate):
    """Several changes of variable, applied one after the other."""

    parts: tuple[Coordinate, ...]

    def forward(self, x: Points) -> Points:
        """Return the point after all changes of variable."""
        for part in self.parts:
            x = part.forward(x)
        return x

    def inverse(self, y: Vector) -> Vector:
        """Return the point before all changes of variable."""
        for part in reversed(self.parts):
            y = part.inverse(y)
        return y

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the sum of all maps' log determinants, each at the point that the map receives."""
        total = jnp.zeros(())
        for part in self.parts:
            total = total + part.log_abs_det_jacobian(x)
            x = part.forward(x)
        return total


IDENTITY = Composed(())  # no change of variable: the coordinates are the parameters
