r"""What repeats of a test would tell: Fisher information, spread of parameters, gain in nats.

Parameters enter as relative changes, $\theta_i = \theta_{0,i} + s_i x_i$ with $s = \theta_0$ where
a parameter is positive, so that the standard deviations of x are coefficients of variation. The
noise, which the identification integrates out, costs the parameters nothing at this order.
"""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.observables.dataset import Dataset, stacked

Matrices = Float[np.ndarray, "... parameter parameter"]


@eqx.filter_jit
def fisher(
    theta: Mapping[str, Array],
    names: tuple[str, ...],
    scale: Float[Array, " parameter"],
    data: Dataset,
    kept: Float[Array, " value"],
) -> Float[Array, "parameter parameter"]:
    r"""Fisher information of a test about relative changes of the parameters.

    $$F = J^T J, \qquad J = \partial r / \partial x$$

    r being the residual in standard errors, whose derivative does not depend on what is measured.

    Args:
        theta: All parameters by name, in their units.
        names: Those that are inferred.
        scale: Units of their relative changes.
        data: The test as it would be reduced; one repeat, its noise as `noise_std`.
        kept: 1 for values that are measured, 0 for those that only fill up the record.

    Returns:
        F [-], in the order of `names`.
    """

    def moved(x: Float[Array, " parameter"]) -> Float[Array, " value"]:
        changed = {n: theta[n] + d for n, d in zip(names, scale * x, strict=True)}
        return stacked({**theta, **changed}, data)

    slope = kept[:, None] * jax.jacfwd(moved)(jnp.zeros(len(names)))
    return slope.T @ slope


class Modes(NamedTuple):
    r"""Prior and information of one repeat, made diagonal together.

    Attributes:
        values: Information f_k of one repeat along each mode, in units of the prior's.
        shares: Prior variance w_ik^2 of parameter i along mode k.
    """

    values: Float[np.ndarray, "*joint mode"]
    shares: Float[np.ndarray, "*joint parameter mode"]


def modes(precision: Matrices, information: Matrices) -> Modes:
    r"""Modes of a prior and of the information of one repeat.

    $$P = L L^T, \quad L^{-1} F L^{-T} = U\,\mathrm{diag}(f)\,U^T, \quad w = L^{-T} U$$

    Args:
        precision: Prior information P.
        information: Information F of one repeat, joint by joint.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(precision))
    transposed = np.swapaxes(inverse, -1, -2)
    values, vectors = np.linalg.eigh(inverse @ information @ transposed)
    return Modes(np.maximum(values, 0.0), (transposed @ vectors) ** 2)


def spread(found: Modes, repeats: float) -> Float[np.ndarray, "*joint parameter"]:
    r"""Standard deviation of each parameter after R repeats, relative to its value.

    $$\mathrm{CV}_i^2 = [(P + R F)^{-1}]_{ii} = \sum_k \frac{w_{ik}^2}{1 + R f_k}$$

    Args:
        found: From `modes`.
        repeats: R.
    """
    return np.sqrt(np.sum(found.shares / (1.0 + repeats * found.values[..., None, :]), axis=-1))


def covariance(precision: Matrices) -> Matrices:
    """Inverse of an information matrix, its parameters brought to one scale first."""
    scale = 1 / np.sqrt(np.diagonal(precision, axis1=-2, axis2=-1))
    both = scale[..., :, None] * scale[..., None, :]
    return both * np.linalg.inv(both * precision)


def worst_decile(values: Float[np.ndarray, " joint *n"]) -> Float[np.ndarray, "*n"]:
    """The least value that nine joints in ten do not exceed."""
    return np.quantile(values, 0.9, axis=0, method="inverted_cdf")


def repeats_needed(found: Modes, wanted: list[int], cv: float, most: int) -> int | None:
    """Fewest repeats after which nine joints in ten know every wanted parameter to the wished CV.

    The spread falls with every repeat, so the number is found by halving.

    Args:
        found: Modes of each joint, along the first axis.
        wanted: Positions of the wanted parameters.
        cv: Wished coefficient of variation [-].
        most: Largest number of repeats.

    Returns:
        The number, from 1 on; None where `most` repeats do not suffice.
    """

    def enough(repeats: int) -> bool:
        return bool(np.all(worst_decile(spread(found, repeats))[wanted] <= cv))

    if not enough(most):
        return None
    low, high = 0, most
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def information_gain(precision: Matrices, information: Matrices) -> Float[np.ndarray, "*joint"]:
    r"""Expected information gain of a test, where the posterior is near Gaussian.

    $$I = \tfrac12 \log\det(1 + \Sigma F), \qquad \Sigma = P^{-1}$$

    Args:
        precision: Information P that there is already.
        information: Information F of the test.

    Returns:
        I [nats].
    """
    return 0.5 * (_log_det(precision + information) - _log_det(precision))


def wanted_gain(
    precision: Matrices, information: Matrices, wanted: list[int]
) -> Float[np.ndarray, "*joint"]:
    r"""Expected information gain about some of the parameters, the others unknown beside them.

    $$I_w = \tfrac12 \left(\log\det \Sigma_{ww} - \log\det \Sigma'_{ww}\right), \qquad
      \Sigma' = (P + F)^{-1}$$

    Args:
        precision: Information P that there is already.
        information: Information F of the test.
        wanted: Positions of the parameters.

    Returns:
        I_w [nats].
    """
    before, after = (
        covariance(p)[..., wanted, :][..., wanted] for p in (precision, precision + information)
    )
    return 0.5 * (_log_det(before) - _log_det(after))


def _log_det(matrix: Matrices) -> Float[np.ndarray, "*joint"]:
    return np.linalg.slogdet(matrix)[1]
