r"""Measured frequency and damping as rows of a linear problem: omega^2 and 2 zeta omega^2.

The rows of a record share an error, the record's own frequency. Relative to the mean of omega^2,
the stiffness has

$$C_i' = C_i + (2 \tau)^2\, 1 1^T$$

where $\tau$ is the relative scatter between records at equal amplitude. Errors are widened if the
residual of the best sliders, fitted to frequency and damping separately, exceeds the errors with
the likeliest $\tau$.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import nnls

from jbw.errors import DataError
from jbw.freeform.sliders import Reals, SliderGrid, grid_for
from jbw.measurement.readings.statement import RecordTable

ROWS = 4  # number of rows that represent a record, enough because its curve is smooth
# smallest number of amplitudes, because frequency and damping need two coefficients each
FEWEST = 4
# relative errors of frequency and damping that are assumed if none is stated
FLOOR_HZ, FLOOR_ZETA = 1e-6, 3e-3
# Trial values of the relative standard deviation of frequency between records.
SCATTERS = np.concatenate([[0.0], np.geomspace(1e-7, 1e-2, 61)])
# number of rounds, each of which estimates the law first, and then the variation between records
ROUNDS = 4

Square = Float[np.ndarray, "row row"]


class ReadingRows(NamedTuple):
    """Frequency and damping of all records as rows of a linear problem, relative to mean omega^2.

    Attributes:
        y: Amplitude of the displacement [m].
        omega: Frequency over the root of `unit`.
        stiffness: omega^2 over `unit`.
        loss: 2 zeta omega^2 over `unit`.
        covariance: Covariance of stiffness and loss, one after the other, without records' offsets.
        own: Change of stiffness and loss by a relative change of each record's frequency.
        unit: The mean of omega^2 [rad^2/s^2].
        scatter: Likeliest relative standard deviation between the records' frequencies.
        inflation: Factor of the covariance: squares that no law of the amplitude explains, over the
            errors.
    """

    y: Reals
    omega: Reals
    stiffness: Reals
    loss: Reals
    covariance: Square
    own: Float[np.ndarray, "row record"]
    unit: float
    scatter: float = 0.0
    inflation: float = 1.0

    @property
    def values(self) -> Reals:
        """The stiffness and loss at all amplitudes as one array, stiffness first."""
        return np.concatenate([self.stiffness, self.loss])

    @property
    def with_scatter(self) -> Square:
        """The covariance that includes the variation of frequency between records."""
        return self.covariance + self.scatter**2 * self.own @ self.own.T

    @property
    def grid(self) -> SliderGrid:
        """The grid of sliders for these amplitudes."""
        return grid_for(float(self.y.min()), float(self.y.max()))


def rows_of(tables: Sequence[RecordTable]) -> ReadingRows:
    """Return the rows of measured frequency and damping, and the variation between records.

    Raises:
        DataError: Fewer than four amplitudes, or readings that are not finite and positive.
    """
    count = sum(len(_picked(table)) for table in tables)
    if count < FEWEST:
        raise DataError(
            f"A free-form law needs frequency and damping at {FEWEST} amplitudes or more, but has "
            f"only {count} amplitudes.",
            remedy="Add records of other levels, or a free decay.",
        )
    if not all(_is_whole(table) for table in tables):
        raise DataError(
            "A free-form law needs positive amplitudes, positive frequencies and finite damping "
            "ratios, but at least one record has an invalid value.",
            remedy="Leave out the record for which `jbw look` shows no frequency or damping.",
        )
    rows, found = _rows(tables), np.nan
    for _ in range(ROUNDS if len(tables) > 1 else 0):
        if found == rows.scatter:
            break
        found = rows.scatter
        rows = rows._replace(scatter=_scatter(rows, _left_by_any_law(rows)[0]))
    residual, freedom = _left_by_any_law(rows)
    squares = float(residual @ np.linalg.solve(rows.with_scatter, residual))
    inflation = max(1.0, squares / freedom)
    return rows._replace(covariance=inflation * rows.covariance, inflation=inflation)


def _is_whole(table: RecordTable) -> bool:
    columns = table.y, table.hz, table.zeta
    positive = bool(np.all(table.y > 0) and np.all(table.hz > 0))
    return positive and all(bool(np.all(np.isfinite(column))) for column in columns)


def _picked(table: RecordTable) -> np.ndarray:
    return np.unique(np.linspace(0, len(table.y) - 1, ROWS).astype(int))


def _rows(tables: Sequence[RecordTable]) -> ReadingRows:
    columns: list[tuple[Reals, ...]] = []
    of_hz, of_zeta = [], []
    for table in tables:
        pick = _picked(table)
        square = np.ix_(pick, pick)
        columns.append((table.y[pick], table.hz[pick], table.zeta[pick]))
        floors = (FLOOR_HZ * table.hz[pick]) ** 2, (FLOOR_ZETA * table.zeta[pick]) ** 2
        of_hz.append(table.hz_covariance[square] + np.diag(floors[0]))
        of_zeta.append(table.zeta_covariance[square] + np.diag(floors[1]))
    y, hz, zeta = (np.concatenate(column) for column in zip(*columns, strict=True))
    omega = 2 * np.pi * hz
    unit = float(np.mean(omega**2))
    by_hz = 4 * np.pi * omega / unit  # change of omega^2 per relative change of frequency
    jacobian = np.block([
        [np.diag(by_hz), np.zeros((len(y), len(y)))],
        [np.diag(2 * zeta * by_hz), np.diag(2 * omega**2 / unit)],
    ])  # fmt: skip
    covariance = jacobian @ np.asarray(block_diag(*of_hz, *of_zeta)) @ jacobian.T
    own = np.asarray(block_diag(*(np.ones((len(column[0]), 1)) for column in columns)))
    own = 2.0 * np.vstack([own, np.zeros_like(own)])
    return ReadingRows(
        y, omega / np.sqrt(unit), omega**2 / unit, 2 * zeta * omega**2 / unit, covariance, own, unit
    )


def _left_by_any_law(rows: ReadingRows) -> tuple[Reals, float]:
    """Return the residual of the best-fitting sliders, with its degrees of freedom.

    Frequency and damping are fitted separately, each with its own strengths and a cubic spring, so
    that no law of the amplitude alone fits much better.
    """
    grid, num = rows.grid, len(rows.y)
    softening, loss = grid.softening(rows.y), grid.loss(rows.y)
    cubic = (rows.y / rows.y.max()) ** 2
    of_stiffness = np.column_stack([np.ones(num), cubic, -cubic, -softening])
    design = np.asarray(block_diag(of_stiffness, np.column_stack([rows.omega, loss])))
    white = np.linalg.inv(np.linalg.cholesky(rows.with_scatter))
    found = nnls(white @ design, white @ rows.values, maxiter=50 * design.shape[1])[0]
    used = int(np.sum(found > 0))
    return rows.values - design @ found, max(len(rows.values) - used, 1.0)


def _scatter(rows: ReadingRows, residual: Reals) -> float:
    """Return the most likely variation of frequency between records, given a law's residual."""

    def penalty(scatter: float) -> float:
        covariance = rows._replace(scatter=scatter).with_scatter
        squares = residual @ np.linalg.solve(covariance, residual)
        return float(squares) + float(np.linalg.slogdet(covariance)[1])

    return float(min(SCATTERS, key=penalty))
