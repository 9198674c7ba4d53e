r"""Masing laws of a given virgin (first-loading) curve, such as from a contact model.

$$F_b(x) = s_F\, B(x / s_x)$$

B interpolates the given points by monotone cubic pieces (PCHIP) and continues with its last slope.
The two scales are the law's parameters; with both equal to 1 the curve is the given one.

Reference:
    Fritsch, Carlson (1980) for the pieces; Lacayo, Allen (2019) for such curves.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from scipy.interpolate import PchipInterpolator

from jbw.errors import ConfigError
from jbw.oscillator.law import Bounds, Scales
from jbw.oscillator.laws.masing import Masing
from jbw.oscillator.parameters import Scalar
from jbw.quantities import Quantity

FEWEST_POINTS = 3
# Prior range of the factors on force and displacement: a computed curve is assumed to be correct
# within a factor of 5.
SCALE = (0.2, 5.0)
_RISES = 1e-9  # relative rise of the curve's slope that counts as rounding


class GivenBackbone(Masing):
    r"""The base class of Masing laws with a given virgin curve, made by `given_backbone`.

    Attributes:
        knots: Displacements of the points, from 0 [m]; a class variable.
        pieces: Coefficients of the lag $K x - B$ in each piece, by powers of the distance from its
            knot; the last piece is straight; a class variable. `integrals` holds the integral of
            the lag from 0 to each knot.
    """

    knots: ClassVar[np.ndarray]
    pieces: ClassVar[np.ndarray]
    integrals: ClassVar[np.ndarray]
    at_zero: ClassVar[float]

    scale_force: Scalar
    scale_displacement: Scalar

    @classmethod
    def prior(cls, scales: Scales) -> Bounds:
        """Return prior bounds of the factors on the curve's force and displacement: from 1/5 to 5.

        The factor on force is also limited to keep the law no stiffer than the structure.
        """
        stiffest = scales.omega_n**2 / cls.at_zero
        return {
            cls.names()[0]: (SCALE[0] * min(1.0, stiffest), min(SCALE[1], stiffest)),
            cls.names()[1]: SCALE,
        }

    @classmethod
    def build(cls, theta: Any) -> "GivenBackbone":
        """Return the law from a dictionary of its factors on force and displacement."""
        return cls(*(theta[name] for name in cls.names()))

    def parameters(self) -> dict[str, Any]:
        """Return the factors on force and displacement by name."""
        return dict(zip(self.names(), (self.scale_force, self.scale_displacement), strict=True))

    def stiffness(self) -> Scalar:
        """Return the initial slope of the scaled force-displacement curve [1/s^2]."""
        return self.at_zero * self.scale_force / self.scale_displacement

    def lag(self, x: Scalar) -> tuple[Scalar, Scalar]:
        """Return the force lost to slip at x, K x - F_b, and the slope of this lost force."""
        c, t, _ = self._piece(x)
        lag = c[0] + t * (c[1] + t * (c[2] + t * c[3]))
        slope = c[1] + t * (2.0 * c[2] + 3.0 * t * c[3])
        return self.scale_force * lag, self.scale_force / self.scale_displacement * slope

    def lag_integral(self, x: Scalar) -> Scalar:
        """Return the integral of K x - F_b, the force lost to slip, from 0 to x [J/kg]."""
        c, t, before = self._piece(x)
        scaled_integral = before + t * (c[0] + t * (c[1] / 2.0 + t * (c[2] / 3.0 + t * c[3] / 4.0)))
        return self.scale_force * self.scale_displacement * scaled_integral

    def _piece(self, x: Scalar) -> tuple[Float[Array, "4 ..."], Scalar, Scalar]:
        """Return the polynomial at x, the distance from its knot, and the integral to its knot."""
        way = jnp.asarray(x, float) / self.scale_displacement
        knots = jnp.asarray(self.knots)
        index = jnp.sum(stop_gradient(way)[..., None] >= knots[1:], -1)
        coefficients = jnp.asarray(self.pieces)[index]
        return (
            jnp.moveaxis(coefficients, -1, 0),
            way - knots[index],
            jnp.asarray(self.integrals)[index],
        )


def given_backbone(name: str, x: Sequence[float], force: Sequence[float]) -> type[GivenBackbone]:
    r"""Return the law class for a given virgin curve, ready for `register`.

    Args:
        name: Name of the law, such as `lap_joint`; its parameters are `NAME_force` and
            `NAME_displacement`, the two scales.
        x: Displacements of the joint, increasing from 0 [m].
        force: Force at each displacement per unit modal mass, from 0 [N/kg]; the slope must never
            rise.

    Raises:
        ConfigError: Too few points, points out of order, no force at all, or a curve that stiffens,
            which no array of sliders can represent.
    """
    if not name.isidentifier():
        raise ConfigError(f"The name of a law must be a word such as `lap_joint`, not {name!r}.")
    points, values = (np.asarray(column, float) for column in (x, force))
    _require_curve(points, values)
    curve = PchipInterpolator(points, values)
    _require_softening(curve, points, values)
    at_zero, last = float(curve(0.0, 1)), float(curve(points[-1], 1))
    cubic, square, slope, start = curve.c
    lag = np.stack([at_zero * points[:-1] - start, at_zero - slope, -square, -cubic], -1)
    lag[0, :2] = 0.0
    beyond = [at_zero * points[-1] - values[-1], at_zero - last, 0.0, 0.0]
    widths = np.diff(points)
    areas = np.sum(lag * widths[:, None] ** np.arange(1, 5) / np.arange(1, 5), -1)
    members = {
        "__doc__": f"Masing's law of the given curve {name}.",
        "__module__": __name__,
        "name": name,
        "table": (
            Quantity(f"{name}_force", f"s_F,{name}", "1", f"scale of {name}'s force", 0.0),
            Quantity(
                f"{name}_displacement",
                f"s_x,{name}",
                "1",
                f"scale of {name}'s reach",
                0.0,
                is_open=True,
            ),
        ),
        "knots": points,
        "pieces": np.vstack([lag, beyond]),
        "integrals": np.concatenate([[0.0], np.cumsum(areas)]),
        "at_zero": at_zero,
    }
    return type(f"{name.title().replace('_', '')}Backbone", (GivenBackbone,), members)


def _require_curve(x: np.ndarray, force: np.ndarray) -> None:
    if x.ndim != 1 or x.shape != force.shape or len(x) < FEWEST_POINTS:
        raise ConfigError(
            f"A virgin curve must have at least {FEWEST_POINTS} displacements and as many forces, "
            f"but the arrays have the shapes {x.shape} and {force.shape}."
        )
    if not (np.isfinite(x).all() and np.isfinite(force).all()):
        raise ConfigError(
            "A virgin curve must have finite points: leave out NaN and infinite values."
        )
    if x[0] != 0.0 or force[0] != 0.0 or (np.diff(x) <= 0.0).any():
        raise ConfigError(
            "A virgin curve must begin at (0, 0) and continue with increasing displacements, "
            f"but it begins at ({x[0]:g}, {force[0]:g}) with steps from {np.diff(x).min():g} m."
        )


def _require_softening(curve: PchipInterpolator, x: np.ndarray, force: np.ndarray) -> None:
    chords = np.diff(force) / np.diff(x)
    if chords[0] <= 0.0 or chords[-1] < 0.0:
        raise ConfigError(
            "The force of a virgin curve must rise from 0 and never fall, but its slope goes from "
            f"{chords[0]:g} to {chords[-1]:g} 1/s^2. End the curve at the peak of the force."
        )
    rises = np.flatnonzero(np.diff(chords) > _RISES * chords[0])
    if len(rises):
        raise ConfigError(
            f"The slope of a virgin curve must not rise, as it does at {x[rises[0] + 1]:g} m: "
            "sliders do not stiffen. Describe the stiffening by a separate law, such as `cubic` or "
            "`stop`."
        )
