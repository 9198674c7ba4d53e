r"""The expected coordinates of units as functions of torque: power laws, or saturating curves.

$$E\,\varphi_k = B x_k \qquad\text{or}\qquad
  a + b\,u\,(1 - e^{(1 - T_k / T_{ref})/u}), \quad u = T_0 / T_{ref}$$

The second form is that of a coordinate that saturates, as the natural frequency does where a joint
closes: $a - d\,e^{-T/T_0}$, written with its slope b on ln T at the reference, which is the slope
of the line.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jbw.errors import ConfigError, DataError, did_you_mean
from jbw.population.prior import TORQUE, CovariateDesign

# prior standard deviation of ln(T_0/T_ref), where T_0 is the saturation torque; over 2 to 12 N m,
# T_0 = 3 T_ref differs from a power law by 3 %
SPREAD = 0.7

Reals = Float[Array, "..."] | Float[np.ndarray, "..."]


def saturating(ratio: Reals, u: Reals) -> Float[Array, "..."]:
    """Return the saturating curve at T/T_ref = `ratio`; at 1 it is 0, with slope 1 against ln T."""
    return jnp.asarray(u * (1.0 - jnp.exp((1.0 - ratio) / u)))


def expected(
    line: Reals, x: Reals, design: CovariateDesign, u: Reals | None
) -> Float[Array, "... unit d"]:
    """Return the units' expected coordinates at their covariates, according to the population.

    Args:
        line: Coefficients, with axes (..., d, covariate).
        x: Covariates of the units.
        design: Names of the covariates, and which coordinates saturate.
        u: Parameter of the saturating curve, with axes (...); None where nothing saturates.
    """
    straight = jnp.einsum("kp,...dp->...kd", x, line)
    if u is None:
        return straight
    j = design.columns.index(TORQUE)
    slope = jnp.asarray(line)[..., j] * design.saturates
    return straight + bent(x[:, j], jnp.asarray(u)[..., None])[..., None] * slope[..., None, :]


def bent(log_ratio: Reals, u: Reals) -> Float[Array, "..."]:
    """Return the saturating curve minus a power law of exponent 1, at given ln(T/T_ref)."""
    return saturating(jnp.exp(jnp.asarray(log_ratio)), u) - jnp.asarray(log_ratio)


def mask_of(
    saturating: Sequence[str], names: Sequence[str], columns: Sequence[str]
) -> Bool[np.ndarray, " d"]:
    """Return a mask of those coordinates that saturate with torque, from their names."""
    for name in saturating:
        if name not in names:
            raise ConfigError(
                f"{name} cannot saturate, because no pooled quantity has this name.",
                remedy=f"{did_you_mean(name, names)}The pooled quantities are {', '.join(names)}.",
            )
    if len(saturating) and TORQUE not in columns:
        raise DataError(
            "All units of the fleet have the same torque, or state none: no parameter can saturate "
            "with torque, because the fleet contains no change of torque.",
            remedy="Collect units of several torques, or leave --saturating out.",
        )
    return np.array([name in saturating for name in names])
