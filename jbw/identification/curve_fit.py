"""Fits of joint laws to frequency and damping against amplitude, without simulation."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.inference.fit.costly_fit import costly_fit, parameters_at
from jbw.inference.fit.fitting import Fit
from jbw.inference.generator import generator
from jbw.inference.space.box import Box
from jbw.measurement.resonances import AmplitudeCurve
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import backbone

STARTS = 8
# relative errors of frequency and damping, in place of those that a curve states
FREQUENCY_STD, DAMPING_STD = 1e-4, 0.03


class WhiteRows(NamedTuple):
    """Stiffness and loss at each amplitude, with the matrix that scales their errors to one.

    Attributes:
        y: Amplitudes [m].
        values: All omega^2, then all 2 zeta omega^2, divided by `unit`.
        white: Inverse Cholesky factor of the covariance of the values.
        unit: Mean of omega^2 [rad^2/s^2].
    """

    y: Float[Array, " amplitude"]
    values: Float[Array, " row"]
    white: Float[Array, "row row"]
    unit: float


def rows_of_curve(curve: AmplitudeCurve) -> WhiteRows:
    """Return a curve's stiffness and loss; assumed errors are 2e-4 and 3 % of the largest loss."""
    square = curve.omega**2
    unit = float(np.mean(square))
    stiffness, loss = square / unit, 2 * curve.zeta * square / unit
    std = np.append(2 * FREQUENCY_STD * stiffness, np.full(len(loss), DAMPING_STD * np.max(loss)))
    rows = curve.y, np.append(stiffness, loss), np.diag(1 / std)
    y, values, white = jax.device_put(rows)
    return WhiteRows(y, values, white, unit)


class CurveMisfit(eqx.Module):
    r"""The errors of laws in stiffness and loss against amplitude, in the data's standard errors.

    $$\omega(Y)^2 = k + \sum_l K_l(Y), \qquad
      2\,\zeta(Y)\,\omega(Y)^2 = 2\zeta\omega_n\omega(Y) + \sum_l C_l(Y)$$

    K and C are those of the laws' steady loops. Instances with equal laws are equal, so that
    compiled code is reused.
    """

    laws: tuple[str, ...] = eqx.field(static=True)

    def __call__(self, theta: Mapping[str, Array], seen: WhiteRows) -> Float[Array, " row"]:
        """Return the normalised errors of stiffness and loss at all amplitudes."""
        model = backbone(oscillator_of(theta, self.laws), seen.y)
        stiffness = model.omega**2 / seen.unit
        made = jnp.concatenate([stiffness, 2 * model.zeta * stiffness])
        return seen.white @ (seen.values - made)


def fit_curve(key: Key[Array, ""], laws: tuple[str, ...], prior: Box, rows: WhiteRows) -> Fit:
    """Fit laws to stiffness and loss against amplitude, from starts over the whole prior.

    Raises:
        ModelError: None of the starts has a steady loop.
    """
    starts = parameters_at(generator(key).random((STARTS, len(prior.names))), prior)
    return costly_fit(CurveMisfit(laws), prior, rows, starts=starts)
