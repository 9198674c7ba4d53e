r"""Estimates of joints from single-mode fits by non-negative least squares, and a chi-square test.

$$\min_{S \ge 0}\ (BS - s)^T\Sigma^{-1}(BS - s)$$

where s_i is the reading of a fit of mode i alone, with covariance Sigma. If these joints explain
these modes, the minimum is distributed as chi-square with N - J degrees of freedom.

Reference:
    Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.stats import chi2

from jbw.assembly.separability import JointSeparability
from jbw.errors import ConfigError

# significance level: fraction of correct sets of joints that the test rejects by chance
BY_CHANCE = 0.01


@dataclass(frozen=True, eq=False)
class JointStarts:
    """The estimated softening S_j or loss O_j of all joints, from fits of single modes.

    Attributes:
        estimate: Softening S_j or loss O_j of every joint, not negative.
        standard_error: Standard errors of joints that are not at zero; NaN for the others.
        chi_square: Weighted sum of squares that the joints do not explain.
        degrees_of_freedom: Number of modes minus number of joints.
        p: Probability of a chi-square at least as large; NaN without degrees of freedom.
    """

    estimate: Float[np.ndarray, " joint"]
    standard_error: Float[np.ndarray, " joint"]
    chi_square: float
    degrees_of_freedom: int
    p: float

    @property
    def explains(self) -> bool | None:
        """Whether the estimated joints explain the modes; None if there is no degree of freedom."""
        return None if np.isnan(self.p) else self.p >= BY_CHANCE


def joint_starts(
    separability: JointSeparability,
    readings: Float[np.ndarray, " mode"],
    covariance: Float[np.ndarray, "mode mode"],
) -> JointStarts:
    """Estimate each joint's non-negative softening S_j (or loss O_j) from fits of single modes.

    Args:
        separability: Separability B of the modes that were read.
        readings: Reading of the fit of each mode alone, alpha_i delta_i (or alpha_i gamma_i) for a
            mode of unit modal mass.
        covariance: Covariance of the readings.

    Raises:
        ConfigError: Shapes differ, there are fewer modes than joints, or the covariance is not
            positive definite.

    Examples:
        Readings of two modes, each known to 5 %, give back the numbers of the two joints:

        >>> import jbw
        >>> import numpy as np
        >>> found = jbw.joint_separability(np.array([[1.0, 0.5], [0.2, 2.0]]))  # (joint, mode)
        >>> readings = found.participation @ np.array([1e5, 2e5])
        >>> starts = jbw.joint_starts(found, readings, np.diag((0.05 * readings) ** 2))
        >>> print(starts.estimate.round(), starts.standard_error.round(-2))
        [100000. 200000.] [ 5100. 10100.]
    """
    B = separability.participation
    num_modes, num_joints = B.shape
    readings, covariance = np.asarray(readings, float), np.asarray(covariance, float)
    if readings.shape != (num_modes,) or covariance.shape != (num_modes, num_modes):
        raise ConfigError(
            f"`readings` must be {num_modes} numbers, one per mode, with a covariance of "
            f"{num_modes} x {num_modes}, but the shapes are {readings.shape} and "
            f"{covariance.shape}.",
            remedy="Give one value for each row of B, that is, for each mode in `modes`.",
        )
    if num_modes < num_joints:
        raise ConfigError(
            f"Values of at least {num_joints} modes must be given for {num_joints} joints, but "
            f"there are {num_modes}.",
            remedy="Sweep more modes, or tie joints.",
        )
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise ConfigError(
            "The covariance of `readings` must be positive definite, but is not.",
            remedy="For independent values, give a diagonal matrix of their variances.",
        ) from None
    scale = B.max(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    columns = scipy.linalg.solve_triangular(lower, B / scale, lower=True)
    whitened = scipy.linalg.solve_triangular(lower, readings, lower=True)
    estimate, distance = nnls(columns, whitened)
    degrees = num_modes - num_joints
    p = float(chi2.sf(distance**2, degrees)) if degrees else float("nan")
    return JointStarts(
        estimate / scale, _errors(columns, estimate > 0) / scale, float(distance**2), degrees, p
    )  # fmt: skip


def _errors(columns: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the standard errors of those joints whose estimate is above zero."""
    errors = np.full(free.size, np.nan)
    _, triangle = np.linalg.qr(columns[:, free])
    if np.all(np.abs(np.diag(triangle)) > 0):
        errors[free] = np.linalg.norm(np.linalg.inv(triangle), axis=1)
    return errors
