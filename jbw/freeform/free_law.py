r"""The law without an assumed form, from frequency and damping: evidence, bands, least damping.

Laws without a form differ in the springs parallel to the sliders, and in whether damping is tied to
the stiffness. Bands combine, in equal parts, all of these laws whose evidence is within 5 nats of
the largest. Masing's rule is tested by

$$B = \log \sum_k Z_{loose, k} - \log \sum_k Z_{free, k}$$

over the same springs k; a decision needs 5 nats. The least damping at an amplitude is that of any
strengths w >= 0, without a prior, whose sum of squares is within 6.63 of the least (99 %).

Reference:
    Lawson and Hanson (1974), Solving Least Squares Problems, for non-negative least squares.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.optimize import nnls

from jbw.freeform.posterior import StrengthPosterior, posterior_of
from jbw.freeform.rows import ReadingRows, rows_of
from jbw.freeform.sliders import Reals
from jbw.freeform.tempering import PARTICLES, Tempered, temper
from jbw.measurement.readings.statement import RecordTable

QUANTILES = 0.005, 0.5, 0.995
CALLED = 5.0  # difference of evidence [nats] with which Masing's rule counts as valid or broken
INSIDE = 6.63  # rise of the weighted sum of squares that bounds the 99 % interval of one quantity
# sets of springs that act in parallel to the sliders
SPRINGS = (), ("cubic",), ("cubic", "quintic")
SPRINGS_OF_NAMED = (), ("cubic",)
WITHOUT_FORM = "free", "loose"
NAMED = "linear", "power", "iwan4"
NAMES = {"power": "masing_power"}  # laws with another name here than in the table of priors
# weight, relative to the data, of the constraint that fixes the loss at a trial value while the
# bound of the loss is searched
PENALTY = 1e5
# growth of the steps that bracket a bound, number of halvings of the bracket, and first relative
# step
WIDER, HALVINGS, FIRST_TRY = 1.7, 30, 0.05
MOST_TRIES = 60

Bands = Float[np.ndarray, "quantile amplitude"]


@dataclass(frozen=True)
class FreeLaw:
    """The law of a joint without a prescribed formula, from frequency and damping alone.

    Attributes:
        rows: The readings.
        log_evidence: Logarithm of the evidence of every law, by name [nats].
        masing: Evidence against Masing's rule [nats]; positive if damping is not tied to stiffness.
        posteriors: Posteriors of the laws without a form, with their draws.
    """

    rows: ReadingRows
    log_evidence: Mapping[str, float]
    masing: float
    posteriors: Sequence[tuple[StrengthPosterior, Tempered]]

    @property
    def rule(self) -> str:
        """The verdict on Masing's rule: "holds", "broken", or "open" if the data do not decide."""
        if self.masing >= CALLED:
            return "broken"
        return "holds" if self.masing <= -CALLED else "open"

    @property
    def scatter(self) -> float:
        """The relative standard deviation of frequency between records (posterior median)."""
        best = max(self.posteriors, key=lambda found: found[1].log_evidence)
        return float(np.exp(np.median(best[1].theta[:, -1])))

    def bands(self, amplitude: ArrayLike, seed: int = 0) -> tuple[Bands, Bands]:
        """Return the bands of frequency [Hz] and damping ratio at given amplitudes [m]."""
        rng = np.random.default_rng(seed)
        logs = np.array([drawn.log_evidence for _, drawn in self.posteriors])
        weights = (logs > logs.max() - CALLED) / np.sum(logs > logs.max() - CALLED)
        most = max(len(drawn.theta) for _, drawn in self.posteriors)
        curves = []
        for (posterior, drawn), weight in zip(self.posteriors, weights, strict=True):
            if count := round(weight * most):
                chosen = rng.choice(len(drawn.theta), count, replace=False)
                curves.append(posterior.curves(drawn.theta[chosen], amplitude, rng))
        hz, zeta = (np.concatenate(values) for values in zip(*curves, strict=True))
        return np.quantile(hz, QUANTILES, axis=0), np.quantile(zeta, QUANTILES, axis=0)

    def least_damping(self, amplitude: ArrayLike) -> Reals:
        """Return the smallest damping ratio that a Masing law can have at given amplitudes [m]."""
        _, _, hz_high = self.bands(amplitude)[0]
        omega_sq = (2 * np.pi * hz_high) ** 2 / self.rows.unit
        return least_loss(self.rows, amplitude, omega_sq) / (2 * omega_sq)


def free_law(
    tables: Sequence[RecordTable],
    *,
    named: bool = True,
    seed: int = 0,
    num_particles: int = PARTICLES,
) -> FreeLaw:
    """Find a joint's law without a prescribed formula, from frequency and damping.

    Args:
        tables: Readings, one table per record.
        named: Whether to compute the evidence of named laws from the same readings, too.
        seed: Seed of the random numbers.
        num_particles: Number of particles for every law; eight times as many draws are kept.

    Raises:
        DataError: Fewer than four amplitudes, or a reading that is not finite and positive.
    """
    rows = rows_of(tables)
    candidates = [
        (prior, terms)
        for prior in (*(NAMED if named else ()), *WITHOUT_FORM)
        for terms in (SPRINGS_OF_NAMED if prior in NAMED else SPRINGS)
    ]
    evidence, without_form = {}, []
    for i, (prior, terms) in enumerate(candidates):
        posterior = posterior_of(rows, prior, terms)
        rng = np.random.default_rng([seed, i])
        drawn = temper(posterior.with_slopes, posterior.mean, posterior.sd, rng, num_particles)
        evidence[" + ".join([NAMES.get(prior, prior), *terms])] = drawn.log_evidence
        if prior in WITHOUT_FORM:
            without_form.append((posterior, drawn))
    # All laws of the first prior come before those of the second.
    bound, loose = np.logaddexp.reduce(
        np.reshape([drawn.log_evidence for _, drawn in without_form], (2, -1)), axis=1
    )
    return FreeLaw(rows, evidence, float(loose - bound), without_form)


def least_loss(rows: ReadingRows, amplitude: ArrayLike, omega_sq: Reals) -> Reals:
    """Return the smallest 2 zeta omega^2 that sliders can have at amplitudes [m], in data units.

    Springs may act in parallel. The bound is that of a quadratic program in w >= 0, found by
    bisection of the sum of squares with the loss fixed.
    """
    posterior = posterior_of(rows, "free", SPRINGS[-1])
    made = np.column_stack([posterior.by_stiffness + posterior.by_loss, posterior.by_viscous])
    best, left = nnls(made, posterior.readings, maxiter=50 * made.shape[1])
    squares = left**2 + INSIDE
    y = np.atleast_1d(np.asarray(amplitude, float))
    losses = np.column_stack([posterior.grid.loss(y), np.sqrt(omega_sq)])
    return np.array([_least(made, posterior.readings, loss, best, squares) for loss in losses])


def _least(made: np.ndarray, readings: Reals, loss: Reals, best: Reals, squares: float) -> float:
    """Return the smallest loss for which the sum of squares does not exceed a limit."""

    def is_inside(value: float) -> bool:
        rows = np.vstack([made, PENALTY * loss])
        found = nnls(rows, np.append(readings, PENALTY * value), maxiter=50 * rows.shape[1])
        return bool(found[1] ** 2 <= squares)

    inside = float(loss @ best)
    step, outside = FIRST_TRY * inside, 0.0
    if is_inside(0.0):
        return 0.0
    for _ in range(MOST_TRIES):
        outside = max(inside - step, 0.0)
        if not is_inside(outside):
            break
        inside, step = outside, WIDER * step
    for _ in range(HALVINGS):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if is_inside(middle) else (inside, middle)
    return inside
