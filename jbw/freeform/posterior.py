r"""The posterior of slider strengths; linear coefficients are integrated out.

Stiffness and loss are linear in omega_n^2, in the strengths w and in the coefficients of springs
and dampers,

$$r = L b + G w + c\,\omega, \qquad b = (\omega_n^2, b_3, b_5, c_2)$$

with $\tfrac34 b_3 Y^2$ and $\tfrac58 b_5 Y^4$ in omega^2 and $\tfrac{8}{3\pi} c_2 \omega^2 Y$ in 2
zeta omega^2. omega_n^2 has a flat prior. The change of these values by any other term at the
largest amplitude has a normal prior, whose standard deviation is twice their measured change.
A QR factorisation of the whitened columns gives the likelihood of w. The relative frequency offset
of each record, N(0, tau^2), is integrated out as well: with U S V^T the whitened columns of the
records and e the residual,
$$-2 \ln L = e^T e - \sum_k \frac{\tau^2 s_k^2}{1 + \tau^2 s_k^2} (U_k^T e)^2
  + \sum_k \ln(1 + \tau^2 s_k^2), \qquad \log \tau \sim N(\log 2\cdot 10^{-5}, 2.3)$$
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import ArrayLike, Float

from jbw.errors import ConfigError
from jbw.freeform.prior import PRIORS, Particles, SliderStrengths, StrengthPrior
from jbw.freeform.rows import ReadingRows
from jbw.freeform.sliders import Matrix, Reals, SliderGrid

# powers of the amplitude with which springs change omega^2
SPRINGS = {"quadratic": 1, "cubic": 2, "quintic": 4}
# power of the amplitude with which a damper changes 2 zeta omega^2
DAMPERS = {"quadratic_damping": 1}
# prior sd of a spring's or damper's effect at the largest amplitude, relative to the range of the
# data
TERM = 2.0
# penalty [nats] per unit by which the sum of the sliders' strengths exceeds the whole stiffness,
# which is 1
EXHAUSTED = 1e3
STEP = 1e-6  # step of the finite differences that give derivatives for a prior with few parameters
RowColumns = Float[np.ndarray, "_ _"]
# mean and standard deviation of the prior of ln of the relative variation of frequency between
# records: a decade wide
SCATTER = np.log(2e-5), 2.3


@dataclass(frozen=True)
class StrengthPosterior:
    """The likelihood and prior of the slider strengths, given frequency and damping.

    The parameters are those of the strengths, followed by ln of the scatter between records.

    Attributes:
        rows: The readings.
        grid: Grid of the sliders' half widths.
        prior: Prior of the strengths.
        terms: Names of springs and dampers in addition to the sliders.
        white: Rows that whiten readings and the terms' priors.
        basis: Orthonormal columns of the linear terms.
        factor: R of these terms: basis times factor are the whitened columns.
        by_stiffness, by_loss, by_viscous: Whitened columns of strengths and viscous damping,
            orthogonal to the linear terms.
        own, own_sizes: U and S of the records' own frequencies, projected in the same way.
        records: Columns of the records' own frequencies, whitened and projected.
        readings: Readings, whitened and projected.
        constant: Constant of the log likelihood [nats].
    """

    rows: ReadingRows
    grid: SliderGrid
    prior: StrengthPrior
    terms: tuple[str, ...]
    white: Float[np.ndarray, "row row"]
    basis: Float[np.ndarray, "row term"]
    factor: Float[np.ndarray, "term term"]
    by_stiffness: Float[np.ndarray, "row bin"]
    by_loss: Float[np.ndarray, "row bin"]
    by_viscous: Reals
    own: Float[np.ndarray, "row size"]
    own_sizes: Float[np.ndarray, " size"]
    records: Float[np.ndarray, "row record"]
    readings: Reals
    constant: float

    def left(self, w: SliderStrengths) -> Float[np.ndarray, "particle row"]:
        """Return the whitened residual of frequency and damping for given slider strengths."""
        made = w.of_stiffness @ self.by_stiffness.T + w.of_loss @ self.by_loss.T
        return self.readings - made - w.viscous[:, None] * self.by_viscous

    @property
    def mean(self) -> Reals:
        """The means of the Gaussian prior of all parameters."""
        return np.append(self.prior.mean, SCATTER[0])

    @property
    def sd(self) -> Reals:
        """The standard deviations of the Gaussian prior of all parameters."""
        return np.append(self.prior.sd, SCATTER[1])

    def log_likelihood(self, theta: Particles) -> Float[np.ndarray, " particle"]:
        """Return the log likelihood at given parameters [nats]."""
        return self._value(theta)[0]

    def _value(self, theta: Particles) -> tuple[Reals, SliderStrengths, RowColumns, RowColumns]:
        """Return log likelihood L, strengths, residual / covariance, and dL / d ln(scatter)."""
        w = self.prior.strengths(theta[:, :-1])
        left = self.left(w)
        variance = np.exp(2 * theta[:, -1:]) * self.own_sizes**2
        along = left @ self.own
        solved = left - (variance / (1 + variance) * along) @ self.own.T
        excess = np.maximum(w.of_stiffness.sum(axis=1) - 1.0, 0.0)
        squares = np.sum(left * solved, axis=1) + np.log1p(variance).sum(axis=1)
        # derivative of minus half the sum of squares with respect to ln(s), with s the standard
        # deviation between records
        by_scatter = variance / (1 + variance) * (along**2 / (1 + variance) - 1)
        return self.constant - 0.5 * squares - EXHAUSTED * excess, w, solved, by_scatter

    def with_slopes(self, theta: Particles) -> tuple[Reals, Particles]:
        """Return the log likelihood [nats] and its derivatives with respect to the parameters."""
        value, w, solved, by_scatter = self._value(theta)
        if self.prior.slopes is None:
            steps = STEP * np.eye(theta.shape[1])
            moved = [self.log_likelihood(theta + step) - value for step in steps]
            return value, np.column_stack(moved) / STEP
        excess = EXHAUSTED * (w.of_stiffness.sum(axis=1, keepdims=True) > 1.0)
        by_log = SliderStrengths(
            (solved @ self.by_stiffness - excess) * w.of_stiffness,
            solved @ self.by_loss * w.of_loss,
            solved @ self.by_viscous * w.viscous,
        )
        return value, np.column_stack([
            self.prior.slopes(theta[:, :-1], by_log), by_scatter.sum(axis=1)
        ])  # fmt: skip

    def curves(
        self, theta: Particles, amplitude: ArrayLike, rng: np.random.Generator
    ) -> tuple[Matrix, Matrix]:
        """Return frequency [Hz] and damping ratio of each draw at given amplitudes [m].

        Linear coefficients are drawn from their Gaussian, given the strengths.
        """
        y, w = np.asarray(amplitude, float), self.prior.strengths(theta[:, :-1])
        columns = StrengthPosterior.columns(self.rows, self.grid)
        made = w.of_stiffness @ columns[0].T + w.of_loss @ columns[1].T
        made += w.viscous[:, None] * columns[2][:, 0]
        made += self._offsets(w, theta[:, -1], rng) @ self.rows.own.T
        whole = np.pad(self.rows.values - made, ((0, 0), (0, len(self.terms))))
        whole = whole @ self.white.T @ self.basis
        b = np.linalg.solve(self.factor, (whole + rng.standard_normal(whole.shape)).T).T
        springs, dampers = _term_columns(self.terms, y / self.rows.y.max())
        omega_sq = b[:, :1] - w.of_stiffness @ self.grid.softening(y).T + b[:, 1:] @ springs.T
        omega = np.sqrt(np.maximum(omega_sq, 1e-12))
        loss = w.viscous[:, None] * omega + w.of_loss @ self.grid.loss(y).T
        loss += omega_sq * (b[:, 1:] @ dampers.T)
        hz = omega * np.sqrt(self.rows.unit) / (2 * np.pi)
        return hz, loss / (2 * np.maximum(omega_sq, 1e-12))

    def _offsets(
        self, w: SliderStrengths, log_scatter: Reals, rng: np.random.Generator
    ) -> Float[np.ndarray, "particle record"]:
        """Return draws of the records' relative frequency offsets, given the strengths."""
        normal = self.records.T @ self.records
        sizes, vectors = np.linalg.eigh(normal)
        precision = np.maximum(sizes, 0.0) + np.exp(-2 * log_scatter[:, None])
        along = self.left(w) @ self.records @ vectors
        noise = rng.standard_normal(along.shape)
        return (along / precision + noise / np.sqrt(precision)) @ vectors.T

    @staticmethod
    def columns(rows: ReadingRows, grid: SliderGrid) -> tuple[RowColumns, RowColumns, RowColumns]:
        """Return the columns of the linear problem: stiffness and loss of sliders, and damping."""
        none = np.zeros((len(rows.y), len(grid.log_d)))
        return (
            np.vstack([-grid.softening(rows.y), none]),
            np.vstack([none, grid.loss(rows.y)]),
            np.concatenate([np.zeros(len(rows.y)), rows.omega])[:, None],
        )


def posterior_of(
    rows: ReadingRows, prior: str = "free", terms: Sequence[str] = ()
) -> StrengthPosterior:
    """Return the posterior of a law's slider strengths, given frequency and damping.

    Args:
        rows: The readings.
        prior: "free", "loose" (without Masing's rule), "power", "iwan4" or "linear".
        terms: Any of "cubic", "quintic" and "quadratic_damping".

    Raises:
        ConfigError: An unknown prior or term.
    """
    for given, known, argument in (
        ((prior,), PRIORS, "prior"),
        (terms, SPRINGS | DAMPERS, "terms"),
    ):
        if unknown := [name for name in given if name not in known]:
            raise ConfigError(
                f"Argument `{argument}` must not contain the unknown name {unknown[0]!r}.",
                remedy=f"Give names from {', '.join(known)}.",
            )
    grid, num, more = rows.grid, len(rows.y), len(terms)
    white = np.zeros((2 * num + more, 2 * num + more))
    white[: 2 * num, : 2 * num] = np.linalg.inv(np.linalg.cholesky(rows.covariance))
    white[2 * num :, 2 * num :] = np.eye(more) / (TERM * (np.ptp(rows.stiffness) + rows.loss.max()))
    springs, dampers = _term_columns(terms, rows.y / rows.y.max())
    measured = np.vstack([springs, rows.omega[:, None] ** 2 * dampers])
    stiff = np.concatenate([np.ones(num), np.zeros(num + more)])
    linear = white @ np.column_stack([stiff, np.vstack([measured, np.eye(more)])])
    basis, factor = np.linalg.qr(linear)

    def apart(columns: RowColumns) -> RowColumns:
        whitened = white @ np.pad(columns, ((0, more), (0, 0)))
        return whitened - basis @ (basis.T @ whitened)

    columns, records = StrengthPosterior.columns(rows, grid), apart(rows.own)
    own, own_sizes, _ = np.linalg.svd(records, full_matrices=False)
    readings = apart(rows.values[:, None])[:, 0]
    diagonals = np.log(np.diag(white)).sum() - np.log(np.abs(np.diag(factor))).sum()
    constant = float(diagonals) - 0.5 * np.log(2 * np.pi) * (2 * num - 1)
    x_middle = 0.5 * float(np.log(rows.y.min() * rows.y.max()))
    by_stiffness, by_loss, by_viscous = map(apart, columns)
    return StrengthPosterior(
        rows, grid, PRIORS[prior](grid, x_middle), tuple(terms), white, basis, factor, by_stiffness,
        by_loss, by_viscous[:, 0], own, own_sizes, records, readings, constant,
    )  # fmt: skip


def _term_columns(terms: Sequence[str], ratio: Reals) -> tuple[RowColumns, RowColumns]:
    """Return the effect of each spring and damper on omega^2 and 2 zeta, by relative amplitude."""
    springs = [ratio ** SPRINGS[name] if name in SPRINGS else 0 * ratio for name in terms]
    dampers = [ratio ** DAMPERS[name] if name in DAMPERS else 0 * ratio for name in terms]
    shape = len(ratio), len(terms)
    return np.reshape(springs, shape[::-1]).T, np.reshape(dampers, shape[::-1]).T
