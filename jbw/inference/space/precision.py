"""The floating-point precision that inference needs."""

import jax

from jbw.errors import ConfigError


def require_float64() -> None:
    """Refuse a float32 session.

    Raises:
        ConfigError: JAX runs in float32.
    """
    if not jax.config.jax_enable_x64:
        raise ConfigError(
            "Inference needs float64, but JAX runs in float32.",
            why="Posteriors as narrow as 1e-6 of the box are lost in single precision.",
            remedy="Call jbw.enable_x64() before any array is made.",
        )
