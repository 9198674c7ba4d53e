r"""Modes of the structure with fully stuck joints, and the residual of a static load.

$$K_s\phi_i = \omega_i^2 M\phi_i, \qquad \phi_i^T M\phi_j = \delta_{ij}$$

They are found by inverse iteration about a negative shift $\sigma$: $(K_s - \sigma M)$ is positive
definite even if rigid-body modes make K_s singular, or if degrees of freedom have no mass. Massless
degrees of freedom follow statically, which is their exact condensation.

The residual is contained in residual attachment modes $\Psi$, made orthogonal so that the solver
can treat them as additional modes. With the generalised eigenvectors Y of $(\Psi^TK_s\Psi,
\Psi^TM\Psi)$ the shapes $\Psi Y$ are orthogonal to each other and to the kept modes in M and in
K_s.

Reference:
    Rubin, AIAA J. 13 (1975) 995.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg
from jaxtyping import Float

from jbw.assembly.factorisation import DENSE_BELOW, Solve, Sparse, negative_pivots, solver_of
from jbw.errors import ConfigError, ModelError

_SHIFT = 0.05  # frequency of the shift, as a fraction of the limit to_hz
RIGID = 1e-4  # A mode is a rigid-body mode if its frequency is below this fraction of to_hz.
_BEYOND = 2  # number of modes that are requested above to_hz, so that none below it is missed
# number of modes that are computed first; the number is doubled until enough modes lie above to_hz
_FIRST_GUESS = 12
_SAME_FREQUENCY = 1e-6  # relative difference up to which two frequencies are equal
_MOST_SWEEPS = 50
# tolerance of Lanczos' method; its type is `Any`, because the type stubs require an integer
_TOLERANCE: Any = 1e-13
# Columns and combinations smaller than this fraction of the largest one are omitted.
_DEPENDENT = 1e-10


class StuckModes(NamedTuple):
    """The modes of the structure with fully stuck joints, up to a frequency.

    Attributes:
        omega: Natural frequencies, ascending; 0 for a rigid-body mode [rad/s].
        shapes: Mass-normalised shapes, one per column [1/sqrt(kg)].
        solve: Solver of (K_s - shift M) x = load.
        shift: Negative shift [rad^2/s^2].
    """

    omega: Float[np.ndarray, " mode"]
    shapes: Float[np.ndarray, "dof mode"]
    solve: Solve
    shift: float


def stuck_modes(stiffness: Sparse, mass: Sparse, to_hz: float) -> StuckModes:
    """Return the modes of the fully stuck structure (M, K_s) up to a frequency [Hz].

    Raises:
        ConfigError: No mode lies below `to_hz`.
        ModelError: K_s is indefinite.
    """
    shift = -((2 * np.pi * _SHIFT * to_hz) ** 2)
    shifted = sp.csc_array(stiffness - shift * mass)
    _require_positive(shifted, stiffness, mass, shift)
    solve = solver_of(shifted)
    limit = (2 * np.pi * to_hz) ** 2
    eigenvalues, shapes = _lowest(shifted, mass, solve, limit - shift)
    eigenvalues = eigenvalues + shift
    rigid = (2 * np.pi * RIGID * to_hz) ** 2
    if eigenvalues[0] < -rigid:
        raise _indefinite(float(eigenvalues[0]))
    _require_all(stiffness, mass, eigenvalues, limit)
    in_range = eigenvalues <= limit
    if not in_range.any():
        raise ConfigError(
            f"`to_hz` must lie above the first frequency, but is {to_hz:g} Hz, and the first "
            f"frequency is {np.sqrt(eigenvalues[0]) / (2 * np.pi):.4g} Hz.",
            remedy=f"Set `to_hz` to {2 * np.sqrt(eigenvalues[0]) / (2 * np.pi):.3g} Hz or more.",
        )
    omega = np.sqrt(np.where(eigenvalues > rigid, eigenvalues, 0.0)[in_range])
    return StuckModes(omega, _signed(shapes[:, in_range]), solve, shift)


def _lowest(
    shifted: Sparse, mass: Sparse, solve: Solve, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues of (shifted, M) up to a limit, and a few above, with mode shapes."""
    size = mass.shape[0]
    if size < DENSE_BELOW:
        # Solve M v = mu (K_s - shift M) v, where mu = 1/eigenvalue; mu = 0 for massless degrees of
        # freedom.
        reciprocals, vectors = scipy.linalg.eigh(mass.toarray(), shifted.toarray())
        order = np.argsort(-reciprocals)
        reciprocals, vectors = reciprocals[order], vectors[:, order]
        moving = reciprocals > 4 * np.finfo(float).eps * size * reciprocals[0]
        count = min(int(np.sum(1 / reciprocals[moving] <= limit)) + _BEYOND, int(moving.sum()))
        return 1 / reciprocals[:count], vectors[:, :count] / np.sqrt(reciprocals[:count])
    inverse = scipy.sparse.linalg.LinearOperator((size, size), matvec=solve, dtype=float)  # pyright: ignore[reportCallIssue]
    start = mass @ np.random.default_rng(0).standard_normal(size)
    count = _FIRST_GUESS
    while True:
        count = min(count, size - 1)
        values, vectors = scipy.sparse.linalg.eigsh(
            shifted, k=count, M=mass, sigma=0.0, OPinv=inverse, v0=start, tol=_TOLERANCE
        )
        order = np.argsort(values)
        values, vectors = values[order], vectors[:, order]
        if np.sum(values > limit) >= _BEYOND or count == size - 1:
            norms = np.sqrt(np.sum(vectors * (mass @ vectors), axis=0))
            return values, vectors / norms
        count *= 2


def _require_positive(shifted: Sparse, stiffness: Sparse, mass: Sparse, shift: float) -> None:
    """Raise if the stiffness matrix K_s of stuck joints has an eigenvalue below the shift."""
    if negative_pivots(shifted).size == 0:
        return
    while negative_pivots(sp.csc_array(stiffness - shift * mass)).size:
        shift *= 4
        if not np.isfinite(shift):
            raise ModelError(
                "Matrix K with fully stuck joints must be positive semidefinite, but is not at "
                "degrees of freedom without mass.",
                remedy="Check the stiffness of massless degrees of freedom.",
            )
    bracket = sp.csc_array(stiffness - shift * mass)
    lowest = _lowest(bracket, mass, solver_of(bracket), 0.0)[0][0] + shift
    raise _indefinite(float(lowest))


def _indefinite(lowest: float) -> ModelError:
    return ModelError(
        "Matrix K with fully stuck joints must be positive semidefinite, but its lowest "
        f"eigenvalue is {lowest:.4g} rad^2/s^2.",
        why="The structure would be unstable: a small motion would grow.",
        remedy="Check whether K is the matrix of a preloaded, buckled structure, and whether M and "
        "K have the same system of units.",
    )


def _require_all(stiffness: Sparse, mass: Sparse, eigenvalues: np.ndarray, limit: float) -> None:
    """Raise if Lanczos' method has missed a mode, by Sylvester's count of eigenvalues."""
    if mass.shape[0] < DENSE_BELOW:
        return
    below = int(np.sum(eigenvalues <= limit))
    beyond = eigenvalues[below] if below < eigenvalues.size else 2 * limit
    between = (max(eigenvalues[below - 1], 0.0) + beyond) / 2 if below else beyond / 2
    count = negative_pivots(sp.csc_array(stiffness - between * mass)).size
    if count != below:
        raise ModelError(
            f"{count} modes must lie below {np.sqrt(between) / (2 * np.pi):.4g} Hz, but {below} "
            "were found.",
            remedy="Change `to_hz` by a few per cent, so that `to_hz` is not within a cluster of "
            "modes.",
        )


def _signed(shapes: np.ndarray) -> np.ndarray:
    """Return mode shapes with a positive largest component (the first, if several are equal)."""
    sizes = np.abs(shapes)
    first = np.argmax(sizes >= (1 - _SAME_FREQUENCY) * sizes.max(axis=0), axis=0)
    return shapes * np.sign(shapes[first, np.arange(shapes.shape[1])])


def rotated_clusters(modes: StuckModes, loads: Float[np.ndarray, "dof load"]) -> StuckModes:
    """Rotate modes of equal frequency, so that as few as possible of them respond to each load.

    Modes of equal frequency are rotated: in a pair, only one mode moves the first load. Otherwise
    the participation factors of coincident modes are arbitrary, and change with the last digit of
    the matrices.
    """
    shapes = modes.shapes.copy()
    begin = 0
    for end in range(1, modes.omega.size + 1):
        apart = end == modes.omega.size or (
            modes.omega[end] - modes.omega[end - 1] > _SAME_FREQUENCY * modes.omega[end]
        )
        if apart:
            if end - begin > 1:
                cluster = shapes[:, begin:end]
                turn = scipy.linalg.qr((loads.T @ cluster).T)[0]
                shapes[:, begin:end] = _signed(cluster @ turn)
            begin = end
    return modes._replace(shapes=shapes)


def residual_shapes(
    stiffness: Sparse,
    mass: Sparse,
    modes: StuckModes,
    loads: Float[np.ndarray, "dof load"],
) -> Float[np.ndarray, "dof load"]:
    r"""Return residual attachment modes: the static response to loads that kept modes leave out.

    $$\Psi = K_s^{-1}W - \Phi\Lambda^{-1}\Phi^TW$$

    by sweeps $x \leftarrow x + P(K_s-\sigma M)^{-1}(P^TW - K_sx)$, $P = I - \Phi\Phi^TM$, which
    contract by $\sigma/(\omega^2-\sigma)$ of the first omitted mode. Loads minus the part that the
    kept modes carry are in equilibrium, so that rigid-body modes need no special treatment.

    Reference:
        Rubin, AIAA J. 13 (1975) 995.
    """
    phi = modes.shapes

    def complement(x: np.ndarray) -> np.ndarray:
        return x - phi @ (phi.T @ (mass @ x))

    remaining = loads - mass @ (phi @ (phi.T @ loads))
    shapes = np.zeros_like(remaining)
    for _ in range(_MOST_SWEEPS):
        change = complement(modes.solve(remaining - stiffness @ shapes))
        shapes = shapes + change
        if np.all(np.abs(change).max(axis=0) <= 1e-14 * np.abs(shapes).max(axis=0)):
            break
    return complement(shapes)


def residual_modes(
    flexibility: Float[np.ndarray, "load load"],
    mass: Float[np.ndarray, "load load"],
    whole: Float[np.ndarray, " load"],
    slowest_limit: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Return the residual modes of unit modal mass that belong to attachment modes Psi.

    A mode beyond the limit is slowed, $\omega_p \to s\omega_p$, $h_p \to sh_p$, which keeps its
    static contribution, $h_p^2/\omega_p^2$.

    Args:
        flexibility: Psi^T K_s Psi, which is the residual flexibility W^T Psi.
        mass: Psi^T M Psi.
        whole: Flexibility of each load, including the kept modes [m/N]; flexibilities that are
            round-off relative to it are omitted.
        slowest_limit: Frequency above which modes are slowed [rad/s].

    Returns:
        Ascending frequencies [rad/s]; columns Y, of which the shapes are Psi Y [1/sqrt(kg) per
        unit of Psi]; and frequencies of slowed modes before they were lowered to the limit [rad/s].
    """
    size = flexibility.shape[0]
    diagonal = np.diag(flexibility)
    present = np.flatnonzero(diagonal > _DEPENDENT * whole)
    if present.size == 0:
        return np.zeros(0), np.zeros((size, 0)), np.zeros(0)
    scale = 1 / np.sqrt(diagonal[present])
    pick = np.ix_(present, present)
    scaled = scale[:, None] * flexibility[pick] * scale
    shares, directions = np.linalg.eigh(scaled)
    independent = shares > _DEPENDENT * shares[-1]
    columns = scale[:, None] * directions[:, independent] / np.sqrt(shares[independent])
    # The columns have unit stiffness; the reduced mass is 1/omega^2.
    reciprocals, turn = scipy.linalg.eigh(columns.T @ mass[pick] @ columns)
    limited = np.maximum(reciprocals, slowest_limit**-2)
    omega = 1 / np.sqrt(limited)
    combinations = np.zeros((size, omega.size))
    combinations[present] = (columns @ turn) * omega
    order = np.argsort(omega, kind="stable")
    beyond = reciprocals < slowest_limit**-2
    with np.errstate(divide="ignore"):
        slowed = 1 / np.sqrt(np.maximum(reciprocals[beyond], 0.0))
    return omega[order], combinations[:, order], np.sort(slowed)
