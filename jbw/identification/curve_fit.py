"""Fits of laws to frequency and damping against amplitude: no solve in time, many starts."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jbw.freeform.rows import ReadingRows
from jbw.inference.fit.costly_fit import costly_fit, parameters_at
from jbw.inference.fit.fitting import Fit
from jbw.inference.generator import generator
from jbw.inference.space.box import Box
from jbw.measurement.resonances import AmplitudeCurve
from jbw.oscillator.oscillator import oscillator_of
from jbw.oscillator.steady.backbone import backbone

STARTS = 8
FREQUENCY_STD, DAMPING_STD = 1e-4, 0.03  # relative, where a curve's own errors are not to be used


class WhiteRows(NamedTuple):
    """Stiffness and loss against amplitude, with what whitens their errors.

    Attributes:
        y: Amplitudes [m].
        values: omega^2 and then 2 zeta omega^2, over `unit`.
        white: Inverse root of the covariance of the values.
        unit: Mean of omega^2 [rad^2/s^2].
    """

    y: Float[Array, " amplitude"]
    values: Float[Array, " row"]
    white: Float[Array, "row row"]
    unit: float


def rows_with_errors(rows: ReadingRows) -> WhiteRows:
    """Return rows of readings, whitened by their covariance."""
    white = np.linalg.inv(np.linalg.cholesky(rows.with_scatter))
    return WhiteRows(*jax.device_put((rows.y, rows.values, white)), rows.unit)


def rows_of_curve(curve: AmplitudeCurve) -> WhiteRows:
    """Return the rows of a curve with fixed errors, 2e-4 of stiffness and 3 % of the most loss."""
    square = curve.omega**2
    unit = float(np.mean(square))
    stiffness, loss = square / unit, 2 * curve.zeta * square / unit
    std = np.append(2 * FREQUENCY_STD * stiffness, np.full(len(loss), DAMPING_STD * np.max(loss)))
    values = np.append(stiffness, loss)
    return WhiteRows(*jax.device_put((curve.y, values, np.diag(1 / std))), unit)


class CurveMisfit(eqx.Module):
    r"""The error of laws in stiffness and loss against amplitude, in standard deviations.

    $$\omega(Y)^2 = k + \sum_l K_l(Y), \qquad
      2\,\zeta(Y)\,\omega(Y)^2 = 2\zeta\omega_n\omega(Y) + \sum_l C_l(Y)$$

    with K and C of the steady loops. Instances of equal laws are equal, so that code compiled for
    one serves all.
    """

    laws: tuple[str, ...] = eqx.field(static=True)

    def __call__(self, theta: Mapping[str, Array], seen: WhiteRows) -> Float[Array, " row"]:
        """Return the whitened errors of all rows."""
        model = backbone(oscillator_of(theta, self.laws), seen.y)
        stiffness = model.omega**2 / seen.unit
        made = jnp.concatenate([stiffness, 2 * model.zeta * stiffness])
        return seen.white @ (seen.values - made)


def fit_curve(key: Key[Array, ""], laws: tuple[str, ...], prior: Box, rows: WhiteRows) -> Fit:
    """Fit laws to rows from starts that are spread over the prior.

    Raises:
        ModelError: At none of the starts is there a steady loop.
    """
    starts = parameters_at(generator(key).random((STARTS, len(prior.names))), prior)
    return costly_fit(CurveMisfit(laws), prior, rows, starts=starts)
