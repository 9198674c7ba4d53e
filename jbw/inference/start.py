"""Where chains start: dispersed, so that the comparison of chains can tell."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.errors import ConfigError
from jbw.inference.box import Box, from_unit, to_unit
from jbw.inference.laplace import Whitening, laplace_whitening, logit, no_whitening

OVERDISPERSION = 2.0  # standard deviations of the Laplace approximation
EDGE = 1e-6  # of the box: the logit of a start on a bound would be infinite


def chain_starts(
    start: Mapping[str, Any] | None,
    covariance: Float[np.ndarray, "parameter parameter"] | None,
    box: Box,
    num_chains: int,
) -> tuple[Float[Array, "chain parameter"], Float[Array, ""], Whitening]:
    """Centre of each chain's start, the spread about it, and the whitening that shapes it.

    Args:
        start: Start by name, one value for all chains or one a chain; None: uniform in the box.
        covariance: Laplace covariance at `start`, in the parameters' units.
        box: The prior box.
        num_chains: Chains.

    Returns:
        Logit of the centres, the spread in standard deviations, the whitening.

    Raises:
        ConfigError: Unknown or missing names, a start outside the box, a covariance without the
            one point that it was found at.
    """
    d = len(box.names)
    if start is None:
        if covariance is not None:
            raise ConfigError(
                "Argument `covariance` needs `start`, the point it was found at.",
                remedy="Pass the `theta` of the fit beside its covariance.",
            )
        return jnp.zeros((num_chains, d)), jnp.asarray(1.0), no_whitening(d)
    points = _checked_start(start, box, num_chains)
    if covariance is None:
        inside = from_unit(jnp.clip(to_unit(points, box), EDGE, 1 - EDGE), box)
        return logit(inside, box), jnp.asarray(0.0), no_whitening(d)
    if any(np.ndim(value) for value in start.values()):
        raise ConfigError("Argument `start` must be one point when `covariance` is given.")
    whitening = laplace_whitening(start, covariance, box)
    centre = jnp.broadcast_to(whitening.centre, (num_chains, d))
    return centre, jnp.asarray(OVERDISPERSION), whitening


def _checked_start(
    start: Mapping[str, Any], box: Box, num_chains: int
) -> dict[str, Float[Array, " chain"]]:
    if set(start) != set(box.names):
        raise ConfigError(
            f"Argument `start` must name {', '.join(box.names)}, "
            f"but it names {', '.join(map(str, start))}."
        )
    for name, lower, upper in zip(box.names, box.lower, box.upper, strict=True):
        value = np.asarray(start[name], dtype=float)
        if value.shape not in ((), (num_chains,)):
            raise ConfigError(
                f"Start of `{name}` must be one number or one a chain ({num_chains}), "
                f"but its shape is {value.shape}."
            )
        if not np.all((value >= lower) & (value <= upper)):
            raise ConfigError(
                f"Start of `{name}` must lie in its prior [{lower:g}, {upper:g}], but is {value}.",
                remedy="Widen the prior, or start inside it.",
            )
    return {
        name: jnp.broadcast_to(jnp.asarray(value, dtype=float), (num_chains,))
        for name, value in start.items()
    }
