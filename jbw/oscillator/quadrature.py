"""Gauss-Legendre quadrature on segments whose ends may be traced."""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real


def gauss_legendre(
    num_nodes: int, lower: Real[ArrayLike, "..."], upper: Real[ArrayLike, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Nodes and weights on [lower, upper], exact for polynomials of degree 2 num_nodes - 1.

    Args:
        num_nodes: Number of nodes.
        lower: Lower ends of the segments.
        upper: Upper ends of the segments.

    Returns:
        Nodes and weights, along a new last axis.
    """
    nodes, weights = _rule(num_nodes)
    lower, upper = jnp.broadcast_arrays(jnp.asarray(lower, float), jnp.asarray(upper, float))
    width = (upper - lower)[..., None]
    return lower[..., None] + width * nodes, width * weights


@cache
def _rule(num_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on [0, 1]."""
    nodes, _ = np.polynomial.legendre.leggauss(num_nodes)
    # Christoffel's sum of squares; numpy's own weights are off by 1e-12 at the ends.
    squares = np.polynomial.legendre.legvander(nodes, num_nodes - 1) ** 2
    weights = 1.0 / (squares @ (np.arange(num_nodes) + 0.5))
    return 0.5 * (nodes + 1.0), 0.5 * weights
