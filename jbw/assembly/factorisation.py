"""Factorisation of symmetric matrices: solutions, and the number of negative eigenvalues."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse.linalg

from jbw.errors import ModelError

DENSE_BELOW = 500  # number of degrees of freedom below which matrices are treated as dense
# This is a `scipy.sparse.csc_array`, which type checkers cannot follow.
Sparse = Any
# function that solves for one load, or for several loads as columns
Solve = Callable[[np.ndarray], np.ndarray]


def solver_of(matrix: Sparse) -> Solve:
    """Return a solver for a positive definite matrix, which is factored only once.

    Raises:
        ModelError: The matrix is singular.
    """
    try:
        if matrix.shape[0] < DENSE_BELOW:
            factor = scipy.linalg.cho_factor(matrix.toarray(), lower=True)
            return lambda load: scipy.linalg.cho_solve(factor, load)
        return _factored(matrix).solve
    except (RuntimeError, np.linalg.LinAlgError) as error:
        raise ModelError(
            "The matrix K + |shift| M must be positive definite, but it cannot be factored.",
            why="A degree of freedom without mass and without stiffness moves freely.",
            remedy="Constrain this degree of freedom, or leave its row out of the export.",
        ) from error


def negative_pivots(matrix: Sparse) -> np.ndarray:
    """Return rows with negative pivots of L D L^T; their number is that of negative eigenvalues.

    This is Sylvester's law of inertia.

    If the elimination must leave the diagonal, the only row is that of the largest component of the
    lowest eigenvector, and there is none if its eigenvalue is positive.
    """
    try:
        factor = _factored(matrix)
        if np.array_equal(factor.perm_r, factor.perm_c):
            pivots = factor.U.diagonal()
            return np.sort(np.argsort(factor.perm_c)[pivots < 0])
    except RuntimeError:  # raised if a pivot is exactly zero
        pass
    if matrix.shape[0] < DENSE_BELOW:
        values, vectors = np.linalg.eigh(matrix.toarray())
    else:
        values, vectors = scipy.sparse.linalg.eigsh(matrix, k=1, which="SA")
    return np.argmax(np.abs(vectors[:, values < 0]), axis=0)


def _factored(matrix: Sparse) -> scipy.sparse.linalg.SuperLU:
    """Factor a symmetric matrix along its diagonal, in an order with little fill-in."""
    return scipy.sparse.linalg.splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
