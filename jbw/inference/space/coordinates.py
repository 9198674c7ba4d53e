r"""Changes of variable that compose: what a sampler walks in, and back to the parameters.

A coordinate maps a vector x to a vector y = f(x), in the order of the prior box, one to one and
smoothly. A density carries over with the determinant of its derivatives,

$$p(x) = p(y)\,\left|\det \frac{\partial f}{\partial x}\right|$$

so that a sampler may walk in whatever x it likes.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.distributions import biject_to, constraints
from numpyro.distributions.transforms import AffineTransform, Transform

Vector = Float[Any, " parameter"]  # NumPy's where nothing is traced


class Coordinate(eqx.Module):
    """A change of variable; its leaves are arrays, so that it may change under `jit`."""

    @abstractmethod
    def forward(self, x: Vector) -> Vector:
        """Return the point y = f(x)."""

    @abstractmethod
    def inverse(self, y: Vector) -> Vector:
        """Return the point x of which y = f(x)."""

    @abstractmethod
    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the logarithm of the absolute determinant of dy/dx at x."""


class Affine(Coordinate):
    """A linear map $y = c + L x$, such as the whitening by a covariance $L L^T$."""

    centre: Vector
    factor: Float[Array, "parameter parameter"]
    log_det: Float[Array, ""]

    def __init__(self, centre: Any, factor: Any) -> None:
        if isinstance(factor, np.ndarray):  # nothing is traced: no program to compile
            log_det = np.linalg.slogdet(factor)[1]
            self.centre, self.factor, self.log_det = jax.device_put((centre, factor, log_det))
        else:
            self.centre, self.factor = centre, factor
            self.log_det = jnp.linalg.slogdet(factor)[1]

    def forward(self, x: Vector) -> Vector:
        """Return the point c + L x."""
        return self.centre + self.factor @ x

    def inverse(self, y: Vector) -> Vector:
        """Return the point that L maps to y - c."""
        return jnp.linalg.solve(self.factor, y - self.centre)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the logarithm of |det L|, the same everywhere."""
        return self.log_det


class Elementwise(Coordinate):
    """Each parameter by itself, by one of NumPyro's transforms."""

    transform: Transform

    def forward(self, x: Vector) -> Vector:
        """Return the transformed point."""
        return jnp.asarray(self.transform(x))

    def inverse(self, y: Vector) -> Vector:
        """Return the point that is transformed to y."""
        if _namespace(y) is np:
            return np.asarray(jax.tree.map(np.asarray, self.transform).inv(y))
        return jnp.asarray(self.transform.inv(y))

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Sum of the logarithms of the slopes."""
        return jnp.sum(self.transform.log_abs_det_jacobian(x, self.transform(x)))


def interval(lower: Vector, upper: Vector) -> Elementwise:
    r"""Map all real numbers into bounds, $y = l + (u - l) / (1 + e^{-x})$."""
    return Elementwise(biject_to(constraints.interval(lower, upper)))


def unit(lower: Vector, upper: Vector) -> Elementwise:
    r"""Map the unit cube into bounds, $y = l + (u - l)\,x$."""
    ends = lower, upper - lower
    if _namespace(lower) is np:
        ends = jax.device_put(ends)
    return Elementwise(AffineTransform(*ends))


class Logarithms(Coordinate):
    """Some by their logarithms, $y_i = e^{x_i}$, where a product is a straight valley."""

    chosen: tuple[bool, ...] = eqx.field(static=True)

    def forward(self, x: Vector) -> Vector:
        """Return the point with the chosen ones exponentiated."""
        xp = _namespace(x)
        return xp.where(self._mask, xp.exp(xp.where(self._mask, x, 0.0)), x)

    def inverse(self, y: Vector) -> Vector:
        """Return the point with the logarithms of the chosen ones."""
        xp = _namespace(y)
        return xp.where(self._mask, xp.log(xp.where(self._mask, y, 1.0)), y)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Sum of the chosen logarithms."""
        return jnp.sum(jnp.where(self._mask, x, 0.0))

    @property
    def _mask(self) -> np.ndarray:
        return np.array(self.chosen)


class Sinh(Coordinate):
    r"""Some by $y_i = c_i \sinh x_i$: far from zero their logarithms, of either sign.

    Scales are those c of the chosen ones, and zero of the others, which stay as they are.
    """

    scale: Vector

    def forward(self, x: Vector) -> Vector:
        """Return the point c sinh x."""
        return jnp.where(self.scale > 0, self.scale * jnp.sinh(x), x)

    def inverse(self, y: Vector) -> Vector:
        """Return the point arsinh(y / c)."""
        xp = _namespace(y)
        scale = np.asarray(self.scale) if xp is np else self.scale
        return xp.where(scale > 0, xp.arcsinh(y / xp.where(scale > 0, scale, 1.0)), y)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Sum of log(c cosh x)."""
        chosen = self.scale > 0
        slope = jnp.where(chosen, self.scale, 1.0) * jnp.cosh(jnp.where(chosen, x, 0.0))
        return jnp.sum(jnp.log(slope))


class Composed(Coordinate):
    """One change of variable after the other, the first part first."""

    parts: tuple[Coordinate, ...]

    def forward(self, x: Vector) -> Vector:
        """Return the point after all parts."""
        for part in self.parts:
            x = part.forward(x)
        return x

    def inverse(self, y: Vector) -> Vector:
        """Return the point before all parts."""
        for part in reversed(self.parts):
            y = part.inverse(y)
        return y

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Sum over the parts, each at the point that reaches it."""
        total = jnp.zeros(())
        for part in self.parts:
            total = total + part.log_abs_det_jacobian(x)
            x = part.forward(x)
        return total


def _namespace(x: Any) -> Any:
    """Return NumPy for NumPy arrays (nothing is compiled), otherwise JAX."""
    return np if isinstance(x, np.ndarray) else jnp


IDENTITY = Composed(())  # the parameters themselves
