"""Uniform priors between bounds, normalised coordinates, products of powers of parameters."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import ConfigError


class Box(eqx.Module):
    r"""Uniform priors $\theta_i \sim U[\theta_{min,i}, \theta_{max,i}]$ with units, section 3.2."""

    names: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, " parameter"]
    upper: Float[Array, " parameter"]


def bounds_by_name(box: Box) -> dict[str, tuple[float, float]]:
    """Return the lower and upper bound of each parameter by name."""
    pairs = zip(box.lower.tolist(), box.upper.tolist(), strict=True)
    return dict(zip(box.names, pairs, strict=True))


def box(bounds: Mapping[str, tuple[float, float]]) -> Box:
    """Build uniform priors from parameter names and (lower, upper) bounds, in order.

    Raises:
        ConfigError: There is no parameter, bounds are not a pair of finite numbers, or lower is not
            below upper.
    """
    if not bounds:
        raise ConfigError(
            "The prior box must name at least one parameter, but it is empty.",
            remedy="Give bounds such as {'zeta': (0.003, 0.006)}.",
        )
    pairs = {name: _checked(name, pair) for name, pair in bounds.items()}
    lower, upper = zip(*pairs.values(), strict=True)
    return Box(tuple(pairs), *jax.device_put((np.array(lower), np.array(upper))))


def bounds_about(value: float, lower: float, upper: float) -> tuple[float, float]:
    """Return `lower` and `upper` times `value` as bounds, in ascending order."""
    ends = lower * value, upper * value
    return min(ends), max(ends)


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
            remedy="Exchange the bounds, or fix the parameter instead of giving it a prior.",
        )
    return lower, upper


def from_unit(x: Float[Any, "... parameter"], box: Box) -> dict[str, Any]:
    r"""Return parameters $\theta_{min} + x\,(\theta_{max} - \theta_{min})$ by name, with units."""
    lower, upper = box.lower, box.upper
    if isinstance(x, np.ndarray):  # NumPy avoids compiling a program
        lower, upper = np.asarray(lower), np.asarray(upper)
    return named(lower + x * (upper - lower), box)


def named(values: Float[Any, "... parameter"], box: Box) -> dict[str, Any]:
    """Return the parameters by name, from the last axis of an array of their values."""
    return {name: values[..., i] for i, name in enumerate(box.names)}


def require_float64() -> None:
    """Raise a ConfigError in a float32 session."""
    if not jax.config.jax_enable_x64:
        raise ConfigError(
            "Inference needs float64, but JAX runs in float32.",
            why="Single precision does not resolve posteriors as narrow as 1e-6 of the prior "
            "range.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )


class Product(NamedTuple):
    r"""A product of powers of parameters, $\prod_i \theta_i^{p_i}$."""

    name: str
    text: str
    powers: Mapping[str, float]
    factors: tuple[str, ...] = ()


def alone(name: str) -> Product:
    """Return a single parameter in the form of a product of powers."""
    return Product(name, name, {name: 1.0})


def value_of(product: Product, theta: Mapping[str, Any]) -> Any:
    """Return the product's value at one point, or for each of several draws."""
    return math.prod(theta[name] ** power for name, power in product.powers.items())


def gradient_of(
    product: Product, theta: Mapping[str, float], names: tuple[str, ...]
) -> Float[np.ndarray, " parameter"]:
    r"""Return derivatives $p_i\,\theta_i^{p_i - 1} \prod_{j \ne i} \theta_j^{p_j}$, finite at 0."""
    gradient = np.zeros(len(names))
    for name, power in product.powers.items():
        lowered = product._replace(powers={**product.powers, name: power - 1})
        gradient[names.index(name)] = power * value_of(lowered, theta)
    return gradient


def prior_of(product: Product, box: Box) -> tuple[float, float]:
    r"""Return the mean and standard deviation of a product of powers under uniform priors.

    $$E[\theta^p] = \frac{u^{p+1} - l^{p+1}}{(p + 1)(u - l)}, \qquad
      E[\theta^{-1}] = \frac{\log(u/l)}{u - l}$$

    multiplied over the parameters; infinite if a negative power meets a bound at zero.
    """
    missing = [name for name in product.powers if name not in box.names]
    if missing:
        raise ConfigError(
            "Argument `product` must name parameters of the prior, but names "
            f"{', '.join(missing)}.",
            remedy=f"Use parameters of the prior: {', '.join(box.names)}.",
        )
    mean, square, bounds = 1.0, 1.0, bounds_by_name(box)
    for name, power in product.powers.items():
        mean *= _moment(power, *bounds[name])
        square *= _moment(2 * power, *bounds[name])
    if not math.isfinite(square):
        return mean, math.inf
    return mean, math.sqrt(max(square - mean**2, 0.0))


def prior_std(lower: float, upper: float) -> float:
    """Return the prior standard deviation of log theta; of theta itself if it may be negative."""
    if lower <= 0:
        return (upper - lower) / math.sqrt(12)
    # In units of the geometric mean, theta ranges from 1/r to r.
    r = math.sqrt(upper / lower)
    log_r, width = math.log(r), r - 1 / r
    # For a narrow range the moments would cancel; log theta is then uniform to 1e-6.
    if log_r < 1e-3:
        return log_r / math.sqrt(3)
    first = (r + 1 / r) * log_r / width - 1
    second = log_r**2 + 2 - 2 * (r + 1 / r) * log_r / width
    return math.sqrt(second - first**2)


def log_prior_std(lower: float, upper: float) -> float:
    """Return the standard deviation of log theta between positive bounds; 1 if one is zero."""
    return prior_std(lower, upper) if lower > 0 else 1.0


def log_prior_of(product: Product, box: Box) -> float:
    r"""Return the prior sd of a product's log, $\sqrt{\sum p_i^2\,\mathrm{var}(\log\theta_i)}$."""
    bounds = bounds_by_name(box)
    powers = product.powers.items()
    return math.hypot(*(power * log_prior_std(*bounds[name]) for name, power in powers))


def _moment(power: float, lower: float, upper: float) -> float:
    if power < 0 and lower <= 0 <= upper:
        return math.inf
    if power == -1:
        return math.log(upper / lower) / (upper - lower)
    return (upper ** (power + 1) - lower ** (power + 1)) / ((power + 1) * (upper - lower))
