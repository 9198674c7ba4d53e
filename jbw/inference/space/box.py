"""The prior box: names, lower and upper bounds, and the unit coordinate x inside it."""

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jbw.errors import ConfigError


class Box(eqx.Module):
    r"""Independent uniform priors, $\theta_i \sim U[\theta_{min,i}, \theta_{max,i}]$.

    Attributes:
        names: Parameter names, in the order of the arrays; static.
        lower: Lower bounds, in each parameter's unit.
        upper: Upper bounds, in each parameter's unit.

    Reference:
        Section 3.2.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]


def box(bounds: Mapping[str, tuple[float, float]]) -> Box:
    """Check the bounds of every parameter and make the box.

    Args:
        bounds: Parameter name to (lower, upper), in the parameter's unit.

    Returns:
        The box, in the order of `bounds`.

    Raises:
        ConfigError: No parameter, not a pair of finite numbers, or lower not below upper.
    """
    if not bounds:
        raise ConfigError(
            "The prior box must name at least one parameter, but it is empty.",
            remedy="Give bounds such as {'zeta': (0.003, 0.006)}.",
        )
    pairs = {name: _checked(name, pair) for name, pair in bounds.items()}
    lower, upper = zip(*pairs.values(), strict=True)
    return Box(tuple(pairs), jnp.asarray(lower), jnp.asarray(upper))


def _checked(name: str, pair: Any) -> tuple[float, float]:
    try:
        lower, upper = (float(bound) for bound in pair)
    except (TypeError, ValueError):
        raise ConfigError(
            f"Prior bounds of `{name}` must be a pair of numbers, but {pair!r} was given.",
            remedy=f"Write {name} = [lower, upper].",
        ) from None
    if not (math.isfinite(lower) and math.isfinite(upper)):
        raise ConfigError(
            f"Prior bounds of `{name}` must be finite, but [{lower:g}, {upper:g}] was given.",
            remedy="Give the widest range that the physics admits.",
        )
    if lower >= upper:
        raise ConfigError(
            f"Prior bounds of `{name}` must have lower < upper, "
            f"but [{lower:g}, {upper:g}] was given.",
            remedy="Swap the bounds, or fix the parameter instead of giving it a prior.",
        )
    return lower, upper


def to_unit(
    theta: Mapping[str, Float[Array, "..."] | float], box: Box
) -> Float[Array, "... parameter"]:
    r"""Unit coordinate of parameters.

    $$x = (\theta - \theta_{min}) / (\theta_{max} - \theta_{min})$$

    Returns:
        x [-], in the order of `box.names` along the last axis.
    """
    stacked = jnp.stack([jnp.asarray(theta[name]) for name in box.names], axis=-1)
    return (stacked - box.lower) / (box.upper - box.lower)


def from_unit(x: Float[Array, "... parameter"], box: Box) -> dict[str, Float[Array, "..."]]:
    r"""Parameters of a unit coordinate.

    $$\theta = \theta_{min} + x\,(\theta_{max} - \theta_{min})$$

    Args:
        x: Unit coordinate [-], in the order of `box.names` along the last axis.
        box: The prior box.

    Returns:
        Parameters by name, in their units.
    """
    theta = box.lower + x * (box.upper - box.lower)
    return {name: theta[..., i] for i, name in enumerate(box.names)}
