r"""The expected coordinates of units by torque: powers of the torque, or curves that saturate.

$$E\,\varphi_k = B x_k \qquad\text{or}\qquad
  a + b\,u\,(1 - e^{(1 - T_k / T_{ref})/u}), \quad u = T_0 / T_{ref}$$

of a coordinate that is said to saturate, as the natural frequency does where a joint closes:
$a - d\,e^{-T/T_0}$, written by its slope b on ln T at the reference, which is what the line's is.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jbw.errors import ConfigError, DataError, did_you_mean
from jbw.population.prior import TORQUE, CovariateDesign

SPREAD = 0.7  # sd of ln(T_0/T_ref): over 2 to 12 N m a power is like a curve of 3 T_ref to 3 %

Reals = Float[Array, "..."] | Float[np.ndarray, "..."]


def saturating(ratio: Reals, u: Reals) -> Float[Array, "..."]:
    """Return the curve at T/T_ref = `ratio`: zero there, with the slope 1 on ln T."""
    return jnp.asarray(u * (1.0 - jnp.exp((1.0 - ratio) / u)))


def expected(
    line: Reals, x: Reals, design: CovariateDesign, u: Reals | None
) -> Float[Array, "... unit d"]:
    """Return the coordinates of units at their covariates, axes (..., unit, d).

    Args:
        line: Axes (..., d, covariate).
        x: Covariates.
        design: What they are, and which coordinates saturate.
        u: Of the curve, axes (...); None where nothing saturates.
    """
    straight = jnp.einsum("kp,...dp->...kd", x, line)
    if u is None:
        return straight
    j = design.columns.index(TORQUE)
    slope = jnp.asarray(line)[..., j] * design.saturates
    return straight + bent(x[:, j], jnp.asarray(u)[..., None])[..., None] * slope[..., None, :]


def bent(log_ratio: Reals, u: Reals) -> Float[Array, "..."]:
    """Return the saturating curve of slope 1 minus its power law's line, at ln(T/T_ref)."""
    return saturating(jnp.exp(jnp.asarray(log_ratio)), u) - jnp.asarray(log_ratio)


def mask_of(
    saturating: Sequence[str], names: Sequence[str], columns: Sequence[str]
) -> Bool[np.ndarray, " d"]:
    """Return which coordinates saturate, from the names of saturating coordinates."""
    for name in saturating:
        if name not in names:
            raise ConfigError(
                f"Nothing called {name} is pooled that could saturate.",
                remedy=f"{did_you_mean(name, names)}Pooled are {', '.join(names)}.",
            )
    if len(saturating) and TORQUE not in columns:
        raise DataError(
            "All units of the fleet have one torque, or state none: no parameter can saturate with "
            "torque.",
            remedy="Collect units of several torques, or leave --saturating out.",
        )
    return np.array([name in saturating for name in names])
