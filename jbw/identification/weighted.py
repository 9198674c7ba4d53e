"""Weighted complex least squares: parameters of a model of lines, and their covariance."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from jbw.errors import DataError


def floored(variance: NDArray[np.float64], h: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Variance kept off zero: a noise-free line would outweigh all others."""
    typical = np.mean(variance[np.isfinite(variance)]) if np.isfinite(variance).any() else 0.0
    return np.maximum(variance, max(1e-6 * typical, (1e-12 * np.abs(h).max()) ** 2))


def least_squares(
    model: Callable[[NDArray[np.float64]], NDArray[np.complex128]],
    data: NDArray[np.complex128],
    variance: NDArray[np.float64],
    start: NDArray[np.float64],
    typical: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.complex128], float]:
    """Parameters, complex Jacobian of the model and chi-square, weighted by the variance."""
    weight = np.sqrt(2 / variance)  # each component has half of the variance

    def misfit(x: NDArray[np.float64]) -> NDArray[np.float64]:
        r = weight * (model(x * typical) - data)
        return np.concatenate([r.real, r.imag])

    low = np.full(len(start), -np.inf)
    low[1] = 1e-6  # a damping of zero has no steady response
    high = np.full(len(start), np.inf)
    high[1] = 0.999 / typical[1]
    x0 = np.clip(start / typical, low + 1e-9, high)
    # Widths of zeta's size matter in omega_n too, so its step is scaled down.
    size = np.ones(len(start))
    size[0] = typical[1]
    found = optimize.least_squares(
        misfit, x0, jac="3-point", x_scale=size, bounds=(low, high), xtol=1e-14, ftol=1e-14,
        gtol=1e-14,
    )  # fmt: skip
    if not (np.all(np.isfinite(found.x)) and found.x[1] > 2e-6):
        raise DataError(
            "The fit of the oscillator to the FRF found no positive damping.",
            remedy="Check `delay`, `band` and which channel is the input.",
        )
    half = len(data)
    jacobian = (found.jac[:half] + 1j * found.jac[half:]) / weight[:, None] / typical
    return found.x * typical, jacobian, float(2 * found.cost)


def covariance_of(
    jacobian: NDArray[np.complex128],
    variance: NDArray[np.float64],
    of_sum: Callable[[NDArray[np.complex128]], NDArray[np.float64]] | None,
) -> NDArray[np.float64]:
    """Covariance of weighted least squares; of correlated lines where `of_sum` knows them."""
    scale = np.linalg.norm(jacobian, axis=0)
    weighted = (jacobian / scale).conj().T * (2 / variance)
    inverse = np.linalg.inv((weighted @ (jacobian / scale)).real) / np.outer(scale, scale)
    return inverse if of_sum is None else of_sum(inverse @ (weighted * scale[:, None]))
