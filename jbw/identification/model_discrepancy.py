r"""Model discrepancy: what a law leaves on runs that its fit has not seen, by amplitude.

A law that is not quite right has another equivalent stiffness and damping than the joint, and the
difference runs with amplitude. Every run r is left out of the fit in turn. Of what this leaves on
it, $e_r$ in standard errors, one part is a change of natural frequency and damping ratio,

$$\hat b_r = (S_r^T S_r)^{-1} S_r^T e_r, \qquad
  V_r = (S_r^T S_r)^{-1} + P_r C_{-r} P_r^T, \quad P_r = (S_r^T S_r)^{-1} S_r^T J_r$$

where S are the derivatives of the prediction by omega_n and zeta, J those by all parameters and C
the covariance of the fit without the run. Its variance is shared by all kinds of test, and grows
with the distance from the amplitudes that were fitted,

$$\hat b_r \sim N\bigl(0,\, V_r + \tau^2 (y_r / y_{max})^{2p} g_r\bigr), \quad p = 0, 1, 2, \\
  \sqrt{g(y)} = 1 + d(y) / h, \\
  d = \max(\ln y / y_{max},\, \ln y_{min} / y,\, 0), \quad
  h = \tfrac12 \max(\ln y_{max} / y_{min}, \ln 2)$$

as an error that is linear in the logarithm of the amplitude grows. Below, a joint that moves less
and less sticks, and what a law misses of it tends to a limit: $\sqrt g$ is three at most. A run
that is left out there may miss as little as an error that is linear in the amplitude itself would,
$\sqrt{g_r} = 1 + 2 (y_{min} - y_r) / \max(y_{max} - y_{min}, y_{min})$, and counts by that. $\tau$
is that of Paule and Mandel about zero. All are none where chance makes as much, of frequency,
damping and the rest together; where they are not, one whose errors are for the most part the
scatter of runs, which bands hold already, is none where chance makes it. Where no repeats tell the
noise and what a fit leaves is coloured, the law's misfit counts as noise, and chance is too large:
there $\tau$ is taken as it is. Chance is that of a sum of squares of correlated numbers: a run's
noise is in the fits without the others, and

$$\mathrm{cov}(\hat b_r, \hat b_q) = -P_r C_{-r} C^{-1} C_{-q} P_q^T, \quad r \ne q$$

of a linear model, with the covariance C of the fit of all runs.

Beyond the largest amplitude fitted the errors of the parameters are no longer those of a law that
holds: they answer for its misfit at the amplitudes that were fitted. So all that the runs left out
miss beyond noise, $\tau_0^2 = \mathrm{mean}_r ((\hat b_r^2 - \sigma_r^2) / g_r)$ with the errors
$\sigma_r$ of noise alone, grows outward,

$$\tau^2(y) = \tau^2 + \max(\tau, \tau_0)^2 \bigl(g(y)\,(y / y_{max})^4 - 1\bigr), \quad
  y > y_{max}$$

with the square of the amplitude, as the equivalent stiffness of a cubic spring does: of the powers
p above the steepest, since runs below cannot tell which one holds beyond them. Farther above the
fitted amplitudes than these are apart, in the logarithm, the discrepancy is not stated.

The rest of $e_r$ is a share of the
response, white, beyond what noise and the errors of the fit without the run leave of it,

$$E|e|^2 = N n + |M|^2, \qquad
  \mathrm{var}|e|^2 = 2\,(N n^2 / f + N^2 n^2 / K + 2 n |M|^2 + |M^T M|^2), \\
  M = (I - S_r (S_r^T S_r)^{-1} S_r^T)\,J_r C_{-r}^{1/2}$$

of N values, of which a fraction f is independent, with the noise n that a test like it would be
taken to have and K values tell; chance is that of the gamma distribution with these moments. A
variance that n runs tell is taken $(t_{n, 0.995} / z_{0.995})^2$ times: then the 99 % band of a
normal distribution is that of Student's t.

Reference:
    Satterthwaite (1946), Biometrics Bull. 2, 110: the distribution of a sum of squares.
    Kennedy and O'Hagan (2001), J. R. Stat. Soc. B 63, 425: a discrepancy beside a calibrated model.
    Paule and Mandel (1982), J. Res. Natl. Bur. Stand. 87, 377.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float, Inexact
from scipy import stats
from scipy.optimize import root_scalar

from jbw.identification.accuracy import another_law
from jbw.identification.leaving_out import FitsWithout
from jbw.identification.run_effects import (
    sizes_of_runs,
    tells_apart,
)
from jbw.inference.fit.costly_fit import evaluator, from_search, residual_at, to_search
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.inference.space.box import Box
from jbw.observables.dataset import (
    Dataset,
    as_arrays,
    by_label,
    fractions_counted,
    left_by_label,
    size_by_label,
    stacked,
)
from jbw.observables.decay_drift import LeftOutDecay
from jbw.observables.drives import plain
from jbw.observables.effective_values import is_coloured
from jbw.observables.observable import OFFSETS, Row
from jbw.observables.spectra import real_rows
from jbw.report.messages import discrepancy as messages

LEAST_RANGE = float(np.log(2.0))  # of the logarithm of amplitude: the least that a slope is over
BY_CHANCE = 0.01  # probability below which shifts and residuals are taken for the law's
NO_OFFSET = 1e-9  # of the scatter of runs: room for no offset
POWERS = (0, 1, 2)  # of the amplitude: a change of stiffness, friction, a cubic spring
MOST_GROWN = 3.0  # of a standard deviation by the logarithm of the amplitude: the whole range
# Fits without runs: of fewer, each sees a level or two, and the errors of its parameters are not
# those of its derivatives.
FEWEST_FITS = 3
FEWEST_DEGREES = 3  # of freedom of a variance that runs tell: fewer say no more
UPPER = 0.995  # where a 99 % band ends
COUNTS = 1e-3  # of the response at resonance: linearity of a good sensor, which hides less
ONE_LEVEL = 1.1  # of amplitudes: within, runs are repeats of one level


class Scatter(NamedTuple):
    """Standard deviation at the largest amplitude fitted, and the power of amplitude it runs by.

    `whole` is that of all that is missed, errors of the parameters included, which grows outward.
    """

    std: float
    power: int = 0
    whole: float = 0.0


NO_SCATTER = Scatter(0.0)


class Missed(NamedTuple):
    """What a law misses within the amplitudes that were fitted."""

    frequency: Scatter  # of the natural frequency, over itself [-]
    damping: Scatter  # of the damping ratio [-]


class AtAmplitude(NamedTuple):
    """Standard deviations of what a law misses at one amplitude."""

    frequency: float  # of the natural frequency, over itself [-]
    damping: float  # of the damping ratio [-]
    share: float  # factor of the share of the response that is missed otherwise
    beyond: float = 0.0  # factor of what grows outward, of all that is missed of that


NOTHING = AtAmplitude(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Discrepancy:
    """What a law leaves beyond noise on tests that were not fitted."""

    forced: Missed
    decays: Missed  # the natural frequency over that of the beginning of a record
    share: Mapping[str, Scatter]  # the rest over the rms of the response, by kind of test
    y_low: float  # smallest and largest amplitude of a run that was fitted [m]; 0 where not known
    y_high: float
    in_noise: bool = False  # whether what counts as noise of the fitted tests hides some of it

    @property
    def is_nothing(self) -> bool:
        """Whether the law leaves nothing beyond noise."""
        scatters = (*self.forced, *self.decays, *self.share.values())
        return not any(scatter.std or scatter.whole for scatter in scatters)

    def at(self, y: float | None, *, of_decay: bool = False) -> AtAmplitude:
        """Standard deviations at an amplitude [m]; where it is not known, at the largest fitted."""
        grown, beyond = growth(y, self.y_low, self.y_high), outward(y, self.y_low, self.y_high)
        ratio = y / self.y_high if y is not None and self.y_high > 0 else 1.0
        within = 1.0 if beyond else grown

        def std_of(scatter: Scatter) -> float:
            inside = within * scatter.std * min(ratio, 1.0) ** scatter.power
            return float(np.hypot(inside, beyond * scatter.whole))

        frequency, damping = map(std_of, self.decays if of_decay else self.forced)
        return AtAmplitude(frequency, damping, within, beyond)

    def is_stated(self, y: float) -> bool:
        """Whether the discrepancy can be stated at an amplitude [m].

        No farther above the amplitudes that were fitted, in the logarithm, than these are apart, or
        one octave: runs left out show nothing of what lies beyond. Where they show nothing since
        what the law misses counts as noise, nothing grows, and no larger amplitude is stated.
        """
        if self.is_nothing:
            return not (self.in_noise and y > ONE_LEVEL * self.y_high > 0)
        return growth(y, self.y_low, self.y_high) <= MOST_GROWN

    def share_of(self, kind: str, missed: AtAmplitude) -> float:
        """Share of the response that a test of a kind leaves: its kind's, else the largest."""
        shares = {name: _at(scatter, missed) for name, scatter in self.share.items()}
        return shares.get(kind, max(shares.values(), default=0.0))


def _at(share: Scatter, missed: AtAmplitude) -> float:
    return float(np.hypot(missed.share * share.std, missed.beyond * share.whole))


class NoiseSquares(NamedTuple):
    """Sum of squares that noise leaves of a group, and the independent values that tell it."""

    square: float
    known_by: float


class Rest(NamedTuple):
    """Square of what no shift explains of a response, and what chance makes of that."""

    square: float
    mean: float
    variance: float
    noise: float = 0.0  # of the mean: that of noise alone

    @property
    def is_by_chance(self) -> bool:
        """Whether a sum of squares with these moments is as large in more than 1 % of cases."""
        if self.mean <= 0:
            return self.square <= 0
        scale = self.variance / (2 * self.mean)
        return bool(stats.chi2.sf(self.square / scale, self.mean / scale) > BY_CHANCE)


class LeftOutRun(NamedTuple):
    """What one run shows of the discrepancy when it is left out of the fit."""

    shift: Float[np.ndarray, " own"]  # of omega_n [rad/s] and zeta, that the law misses
    std: Float[np.ndarray, " own"]  # their standard errors; infinite where the run knows nothing
    rests: Mapping[str, Rest]  # over the square of the response, by kind
    is_decay: bool = False
    amplitude: float = np.nan  # over the largest fitted; NaN where it is not known
    grown: float = 1.0  # factor of standard deviations at its amplitude, by those of the others
    noise_std: Float[np.ndarray, " own"] = np.zeros(0)  # of `std` that of noise, not of parameters
    # $P C$ of the fit without it, by which it shares noise with others; None of no such fit.
    by_parameters: Float[np.ndarray, "own parameter"] | None = None


NoiseOf = Mapping[str, NoiseSquares]  # by label


def growth(y: float | None, y_low: float, y_high: float) -> float:
    r"""The factor $\sqrt g$ of a standard deviation at an amplitude y [m].

    It grows by the logarithm of the amplitude; below, where a joint sticks, to three at most.
    """
    if y is None or not (0 < y_low <= y_high and y > 0):
        return 1.0
    wide = max(np.log(y_high / y_low), LEAST_RANGE)
    above, below = 1 + 2 * np.log([y / y_high, y_low / y]) / wide
    return float(max(above, min(below, MOST_GROWN), 1.0))


def growth_shown(y: float | None, y_low: float, y_high: float) -> float:
    r"""The factor $\sqrt{g_r}$ by which a run counts that is left out of others.

    Below these it grows by the amplitude: what a run misses there is no more than that explained.
    """
    if y is None or not 0 < y < y_low <= y_high:
        return growth(y, y_low, y_high)
    return 1 + 2 * (y_low - y) / max(y_high - y_low, y_low)


def outward(y: float | None, y_low: float, y_high: float) -> float:
    r"""The factor $\sqrt{g (y / y_{max})^4 - 1}$ of all that is missed; 0 within the fitted."""
    if y is None or not 0 < y_low <= y_high < y:
        return 0.0
    grown = growth(y, y_low, y_high) * (y / y_high) ** max(POWERS)
    return float(np.sqrt(grown**2 - 1))


def scatter_by_amplitude(
    shift: Float[np.ndarray, " run"],
    std: Float[np.ndarray, " run"],
    amplitude: Float[np.ndarray, " run"],
    grown: Float[np.ndarray, " run"],
    num_fits: int,
    correlation: Float[np.ndarray, "run run"],
    *,
    judged: bool = True,
) -> Scatter:
    r"""The likeliest of scatters that are constant, or run with the amplitude or its square.

    $$\log p = -\tfrac12 \sum_r \Bigl[\log v_r + \frac{b_r^2}{v_r}\Bigr], \qquad
      v_r = \sigma_r^2 + \tau^2 g_r (y_r / y_{max})^{2p}, \quad p = 0, 1, 2$$
    """
    relative = np.where(np.isfinite(amplitude), amplitude, 1.0)
    candidates: list[tuple[float, Scatter]] = []
    for power in POWERS:
        factor = grown * relative**power
        scatter = scatter_about_zero(shift, std, factor, num_fits, correlation, judged=judged)
        variance = std**2 + scatter**2 / widened(num_fits) * factor**2
        finite = np.isfinite(variance)
        terms = np.log(variance[finite]) + shift[finite] ** 2 / variance[finite]
        candidates.append((float(np.sum(terms)), Scatter(scatter, power)))
    likeliest = min(candidates, key=lambda pair: pair[0])[1]
    return likeliest if likeliest.std > 0 else NO_SCATTER


def correlation_of(
    shown: Sequence[LeftOutRun],
    covariance: Float[np.ndarray, "parameter parameter"],
    quantity: int,
) -> Float[np.ndarray, "run run"]:
    r"""Correlation of the shifts of runs in one quantity, $-P_r C_{-r} C^{-1} C_{-q} P_q^T$.

    Decays, which are predicted from their own beginnings, share nothing with others here.

    Args:
        shown: What the runs show.
        covariance: That of the parameters of the fit of all runs.
        quantity: 0 of the natural frequency, 1 of the damping ratio.
    """
    unshared = np.zeros(len(covariance))
    rows = [x.by_parameters[quantity] if x.by_parameters is not None else unshared for x in shown]
    std = np.array([run.std[quantity] for run in shown])
    scaled = np.reshape(rows, (len(shown), -1)) / std[:, None]
    size = np.sqrt(np.diag(covariance))
    precision = np.linalg.pinv(covariance / np.outer(size, size), hermitian=True)
    shared = -(scaled / size) @ precision @ (scaled / size).T
    np.fill_diagonal(shared, 1.0)
    return np.clip(shared, -1.0, 1.0)


def missed_in_all(
    shift: Float[np.ndarray, " run"],
    noise_std: Float[np.ndarray, " run"],
    grown: Float[np.ndarray, " run"],
    num_fits: int,
) -> float:
    r"""The $\tau_0$ of all that runs miss beyond noise, widened for few runs.

    $$\tau_0^2 = \Bigl(\frac{t_{m, 0.995}}{z_{0.995}}\Bigr)^2\,
      \mathrm{mean}\,\frac{b_r^2 - \sigma_r^2}{g_r}$$
    """
    finite = np.isfinite(noise_std)
    if not np.any(finite):
        return 0.0
    beyond = (shift[finite] ** 2 - noise_std[finite] ** 2) / grown[finite] ** 2
    return float(np.sqrt(max(np.mean(beyond), 0.0) * widened(num_fits)))


def scatter_about_zero(
    shift: Float[np.ndarray, " run"],
    std: Float[np.ndarray, " run"],
    grown: Float[np.ndarray, " run"],
    num_fits: int,
    correlation: Float[np.ndarray, "run run"],
    *,
    judged: bool = True,
) -> float:
    r"""The $\tau$ of Paule and Mandel about zero, widened for few runs; 0 where chance makes it.

    $$\sum_r \frac{b_r^2}{\sigma_r^2 + \tau^2 g_r} = n, \qquad \tau\, t_{m, 0.995} / z_{0.995}$$

    for m fits, each without one of the runs, or without several of n. It is 0 where chance makes as
    much in more than 1 % of cases, or, of a scatter that is not judged, where as much is expected.
    The sum of squares of n normal numbers of a correlation R has the mean n and the variance
    $2\,\mathrm{tr}\,R^2$.
    """
    finite = np.isfinite(std)
    b, variance, g = shift[finite] ** 2, std[finite] ** 2, grown[finite] ** 2
    count = len(b)
    chi_square = float(np.sum(b / variance))
    of_chance = 2 * float(np.sum(correlation[np.ix_(finite, finite)] ** 2))
    by_chance = judged and Rest(chi_square, count, of_chance).is_by_chance
    if chi_square <= count or by_chance:
        return 0.0
    most = float(np.sum(b / g))  # of which the sum is n at most
    solution = root_scalar(
        lambda square: float(np.sum(b / (variance + square * g))) - count,
        bracket=(0.0, most),
        rtol=1e-12,
    )
    return float(np.sqrt(solution.root * widened(num_fits)))


def widened(num_runs: int) -> float:
    r"""Factor of a variance that so many runs tell, $(t_{n, 0.995} / z_{0.995})^2$, three at least.

    The 99 % band of a normal distribution of that variance is the one of Student's t.
    """
    degrees = max(num_runs, FEWEST_DEGREES)
    return float((stats.t.ppf(UPPER, degrees) / stats.norm.ppf(UPPER)) ** 2)


def shift_of(
    residual: Float[np.ndarray, " value"],
    slopes: Float[np.ndarray, "value own"],
    jacobian: Float[np.ndarray, "value parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> tuple[Float[np.ndarray, " own"], Float[np.ndarray, " own"]]:
    r"""Change of omega_n and zeta that a residual asks for, in standard errors, and its own errors.

    $$\hat b = (S^T S)^{-1} S^T e, \qquad V = (S^T S)^{-1} + P C P^T, \quad P = (S^T S)^{-1} S^T J$$

    Of a derivative that is nothing, or two that are one, the error is infinite.
    """
    along = coefficients_of(slopes)
    by_parameters = along @ jacobian
    spread = along @ along.T + by_parameters @ covariance @ by_parameters.T
    informed = np.any(along != 0.0, axis=1)
    return along @ residual, np.where(informed, np.sqrt(np.diag(spread)), np.inf)


def coefficients_of(slopes: Float[np.ndarray, "value own"]) -> Float[np.ndarray, "own value"]:
    """What gives least-squares coefficients of the slopes, $(S^T S)^{-1} S^T$; else zeros."""
    along, informed = np.zeros(slopes.shape[::-1]), np.any(slopes != 0.0, axis=0)
    precision = slopes[:, informed].T @ slopes[:, informed]
    if np.any(informed) and tells_apart(precision):
        along[informed] = np.linalg.solve(precision, slopes[:, informed].T)
    return along


def root_of(
    covariance: Float[np.ndarray, "parameter parameter"],
) -> Float[np.ndarray, "parameter parameter"]:
    """A root R of a covariance R R^T, of one that rounding has left indefinite too."""
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    return std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


class Slopes(NamedTuple):
    """A fit's derivatives where runs have no offsets, and what these scatter by."""

    data: Dataset  # without room for offsets
    jacobian: Float[np.ndarray, "value parameter"]  # of the predictions
    scatter: Float[np.ndarray, " own"]  # of omega_n [rad/s] and zeta over runs


def slopes_of(best: Fit, prior: Box, data: Dataset) -> Slopes:
    """Derivatives of predictions of a run of which nothing is known, its frequency neither."""
    if not data.has_offsets:
        return Slopes(data, -best.jacobian, np.zeros(len(OFFSETS)))
    scatter = np.asarray(data.scatter)
    bare = replace(data, scatter=jax.device_put(NO_OFFSET * scatter))
    width = np.asarray(prior.upper) - np.asarray(prior.lower)
    search = to_search(best.x, prior)
    slope = np.asarray(from_search(jax.device_put(search), prior)[1])
    jacobian = evaluator(stacked, prior, bare)(search, 1) / slope / width
    return Slopes(bare, -jacobian, scatter[: len(OFFSETS)])


def left_out_run(run: str, fit: Fit, known: Slopes, prior: Box, noise: NoiseOf) -> LeftOutRun:
    """What a run shows at the fit without it, beyond what runs scatter by."""
    data, names = known.data, list(fit.theta)
    rows = residual_at(stacked, fit.x, prior, data)
    labels = [label for label in _labels_of(run, data) if label in size_by_label(data)]
    columns = [[i for i, n in enumerate(names) if plain(n) == name] for name in OFFSETS]
    by_own = np.stack([known.jacobian[:, indices].sum(axis=1) for indices in columns], axis=1)
    jacobian, slopes = (
        _end_to_end(derivatives, labels, data) for derivatives in (known.jacobian, by_own)
    )
    of_run = _end_to_end(rows, labels, data)
    shift, std = shift_of(of_run, slopes, jacobian, fit.covariance)
    _, noise_std = shift_of(of_run, slopes, jacobian, np.zeros_like(fit.covariance))
    residuals = left_by_label(rows - by_own @ shift, data)
    explained = by_own @ (coefficients_of(slopes) @ jacobian)
    by_errors = (known.jacobian - explained) @ root_of(fit.covariance)
    moves = [left_by_label(column, data) for column in by_errors.T]
    uncertain = {label: np.stack([move[label] for move in moves], axis=1) for label in labels}
    rests = _rests({label: residuals[label] for label in labels}, noise, data, uncertain)
    by_runs = np.hypot(std, known.scatter), np.hypot(noise_std, known.scatter)
    by_parameters = coefficients_of(slopes) @ jacobian @ fit.covariance
    return LeftOutRun(shift, by_runs[0], rests, noise_std=by_runs[1], by_parameters=by_parameters)


def by_drift(of_run: LeftOutRun, decay: LeftOutDecay, omega_n: float) -> LeftOutRun:
    """What a free decay shows when it is predicted from its beginning.

    Its damping is as uncertain as the parameters leave it, as `of_run` has that.
    """
    drift = decay.drift
    noise_std = np.array([decay.frequency_std, decay.rate_std / omega_n])
    std = noise_std.copy()
    if np.isfinite(of_run.std[1]):
        std[1] = np.hypot(std[1], of_run.std[1])
    rest = _rest(drift.rest, NoiseSquares(decay.noise, np.inf), decay.fraction)
    return of_run._replace(
        shift=np.array([drift.frequency, drift.rate / omega_n]),
        std=std,
        rests=dict.fromkeys(of_run.rests, _over(rest, _square(drift.measured))),
        is_decay=True,
        noise_std=noise_std,
        by_parameters=None,
    )


def model_discrepancy(best: Fit, prior: Box, data: Dataset, fits: FitsWithout) -> xr.Dataset:
    """What every run shows of the discrepancy when it is left out, and what all show together.

    `fits` are those of `leaving_out.fits_without_each_run`.
    """
    fits = fits if len(fits) >= FEWEST_FITS else {}
    everything_known = {**data.held, **best.theta}
    by_name = {plain(n): float(value) for n, value in reversed(everything_known.items())}
    natural = by_name.get("omega_n", 1.0)
    amplitudes, repeated = amplitudes_of_runs(data, natural), _noise_of_repeats(data)
    residuals = left_by_label(best.residual, data)
    noise = _noise_alike(residuals, data) | repeated
    y_high, slopes = max(amplitudes.values(), default=0.0), slopes_of(best, prior, data)
    shown: dict[str, LeftOutRun] = {}
    sizes = size_by_label(data)
    sized_runs = {run for label, run in zip(data.labels, data.runs, strict=True) if label in sizes}
    stay_in = _decays(data) - {run for group in fits for run in group}
    fits_with_decays = {tuple(sorted(stay_in)): best} if stay_in else {}  # decays among other tests
    for group, fit in {**fits_with_decays, **fits}.items():
        others = [y for run, y in amplitudes.items() if run not in group]
        for run in group:
            of_run = left_out_run(run, fit, slopes, prior, noise)
            if (decay := _drift(run, fit, data)) is not None:
                of_run = by_drift(of_run, decay, natural)
            lowest, highest = min(others, default=0.0), max(others, default=0.0)
            grown = growth_shown(amplitudes.get(run), lowest, highest)
            relative = amplitudes.get(run, np.nan) / y_high if y_high > 0 else np.nan
            shown[run] = of_run._replace(amplitude=relative, grown=grown)
    as_fitted = _rests({label: residuals[label] for label in repeated}, repeated, data)
    runs, nothing = list(shown.values()), Missed(NO_SCATTER, NO_SCATTER)
    of_all = FitOfAll(len(fits), natural, best.covariance, slopes.scatter)
    in_noise = bool(fits) and _hides_in_noise(residuals, repeated)
    learned = _learned(runs, as_fitted, of_all, judged=not in_noise)
    if learned.is_nothing:  # chance makes all that is missed
        missed, missed_by_decays, shares = None, None, {}
    else:
        missed, missed_by_decays, shares = _learned(runs, as_fitted, of_all, judged=False)
    shape, dims = (len(shown), len(OFFSETS)), ("run", "quantity")
    shift = np.reshape([run.shift for run in shown.values()], shape)
    std = np.reshape([run.std for run in shown.values()], shape)
    noise_std = np.reshape([run.noise_std for run in shown.values()], shape)
    amplitude = [run.amplitude * y_high for run in shown.values()]
    grown_by, units = [run.grown for run in shown.values()], {"group_units": ["rad/s", "1"]}
    of_rest = {"units": "1", "long_name": "sd over rms"}
    positive = [y for y in amplitudes.values() if y > 0]
    return xr.Dataset(
        {
            "amplitude": ("run", amplitude, {"units": "m", "long_name": "largest displacement"}),
            "growth": ("run", grown_by, {"units": "1", "long_name": "factor at its amplitude"}),
            "shift": (dims, shift, {**units, "long_name": messages.SHIFT_OF_RUN}),
            "std": (dims, std, {**units, "long_name": "its standard error"}),
            "noise_std": (dims, noise_std, {**units, "long_name": "that of noise alone"}),
            "rest": ("kind", [share.std for share in shares.values()], of_rest),
            "rest_beyond": ("kind", [share.whole for share in shares.values()], of_rest),
        },
        {
            "run": np.array(list(shown), str),
            "quantity": list(OFFSETS),
            "kind": np.array(list(shares), str),
        },
        {
            "forced": np.ravel(missed or missed_by_decays or nothing),
            "decays": np.ravel(missed_by_decays or missed or nothing),
            "y_low": min(positive, default=0.0),
            "y_high": y_high,
            "omega_n": natural,
            "zeta": by_name.get("zeta", 1.0),
            "num_runs": len(sized_runs),
            "noise_by_repeats": int(set(sizes) <= set(repeated)),
            "hidden_in_noise": int(in_noise),
        },
    )


class FitOfAll(NamedTuple):
    """What is the same of all runs that are left out."""

    num_fits: int  # without some of them
    omega_n: float  # natural frequency of the fit of all [rad/s]
    covariance: Float[np.ndarray, "parameter parameter"]  # of its parameters
    scatter: Float[np.ndarray, " own"]  # of omega_n [rad/s] and zeta over runs


class Learned(NamedTuple):
    """What runs that are left out show together."""

    forced: Missed | None  # None of no such runs
    decays: Missed | None
    shares: Mapping[str, Scatter]  # by kind of test

    @property
    def is_nothing(self) -> bool:
        """Whether nothing is missed."""
        scatters = (*(self.forced or ()), *(self.decays or ()), *self.shares.values())
        return not any(scatter.std for scatter in scatters)


def _learned(
    runs: Sequence[LeftOutRun],
    as_fitted: Mapping[str, Rest],
    of_all: FitOfAll,
    *,
    judged: bool,
) -> Learned:
    """What runs show together, beside what the fit leaves of tests with repeats.

    Of what is judged, nothing that chance makes as well.
    """
    free = [run for run in runs if run.is_decay]
    forced = [run for run in runs if not run.is_decay]
    shares = _pooled(runs, judged=judged)
    for kind, rest in as_fitted.items():
        share, known = _share_of([rest], [1.0], judged=judged), shares.get(kind, NO_SCATTER)
        shares[kind] = Scatter(max(share, known.std), 0, max(share, known.whole))
    return Learned(
        _missed(forced, of_all, judged=judged),
        _missed(free, of_all._replace(num_fits=of_all.num_fits or len(free)), judged=judged),
        {kind: share for kind, share in shares.items() if share.std or share.whole},
    )


def discrepancy_in(found: xr.Dataset) -> Discrepancy:
    """The discrepancy as predictions take it; of old runs without what grows outward."""
    names, rests = map(str, found["kind"].values), found["rest"].values.tolist()
    rests_beyond = (
        found["rest_beyond"].values.tolist() if "rest_beyond" in found else [0.0] * len(rests)
    )
    pairs = zip(names, rests, rests_beyond, strict=True)
    shares = {kind: Scatter(rest, 0, beyond) for kind, rest, beyond in pairs}
    forced, decays = (_missed_in(found.attrs[name]) for name in ("forced", "decays"))
    y_low, y_high = float(found.attrs["y_low"]), float(found.attrs["y_high"])
    in_noise = bool(found.attrs.get("hidden_in_noise", 0))
    return Discrepancy(forced, decays, shares, y_low, y_high, in_noise)


def _missed_in(numbers: Float[np.ndarray, " number"]) -> Missed:
    rows = np.reshape(numbers, (len(OFFSETS), -1)).tolist()
    return Missed(*(Scatter(std, int(power), *total) for std, power, *total in rows))


def _missed(shown: Sequence[LeftOutRun], of_all: FitOfAll, *, judged: bool) -> Missed | None:
    """Scatter of what runs show, over the natural frequency [rad/s]; None of no runs."""
    if not shown:
        return None
    shift, std, noise_std = (
        np.array([getattr(run, name) for run in shown]) for name in ("shift", "std", "noise_std")
    )
    grown = np.array([run.grown for run in shown])
    amplitude = np.array([run.amplitude for run in shown])
    scatters = []
    num_fits, natural, covariance, scatter_of_runs = of_all
    for i, (b, error, of_noise) in enumerate(zip(shift.T, std.T, noise_std.T, strict=True)):
        correlation = correlation_of(shown, covariance, i)
        by_runs = bool(scatter_of_runs[i] ** 2 > np.min(error) ** 2 / 2)
        scatter = scatter_by_amplitude(
            b, error, amplitude, grown, num_fits, correlation, judged=judged or by_runs
        )
        # Bands hold the scatter of runs already: what chance makes beside it is not added.
        missed = 0.0 if by_runs else missed_in_all(b, of_noise, grown, num_fits)
        scatters.append(scatter._replace(whole=max(scatter.std, missed)))
    omega_n, zeta = scatters
    relative = Scatter(omega_n.std / natural, omega_n.power, omega_n.whole / natural)
    return Missed(relative, zeta)


def discrepancy_finding(found: xr.Dataset, laws: Sequence[str]) -> Finding | None:
    """What the law misses of runs that were left out; None where none can be left out.

    A change of frequency by omega_n times e, or of damping by e, moves the response at resonance by
    e / zeta of itself.
    """
    if not found.sizes["run"]:
        return None
    discrepancy = discrepancy_in(found)
    if discrepancy.is_nothing:
        entry = "" if found.attrs.get("noise_by_repeats", 1) else "discrepancy.no_repeats"
        return Finding("discrepancy", "ok", {}, 0.0, entry=entry)
    shift, noise_std = found["shift"].values, found["noise_std"].values
    over_noise = np.where(np.isfinite(noise_std), np.abs(shift) / noise_std, 0.0)
    run = int(np.argmax(over_noise.max(axis=1)))
    forced = discrepancy.forced if any(x.whole for x in discrepancy.forced) else discrepancy.decays
    rest = max((share.whole for share in discrepancy.share.values()), default=0.0)
    of_modes = max(forced.frequency.whole, forced.damping.whole) / found.attrs["zeta"]
    if (error := max(of_modes, rest)) < COUNTS:
        values = {"error": error, "limit": COUNTS}
        return Finding("discrepancy", "ok", values, error, entry="discrepancy.small")
    values = {
        "frequency": forced.frequency.whole,
        "damping": forced.damping.whole,
        "rest": rest,
        "run": str(found["run"].values[run]),
        "run_frequency": float(shift[run, 0] / found.attrs["omega_n"]),
        "run_damping": float(shift[run, 1]),
    }
    remedy = {"another_law": another_law(laws)}
    largest = max(forced.frequency.whole, forced.damping.whole, rest)
    return Finding("discrepancy", "usable", values, largest, remedy)


def unscored_levels(found: xr.Dataset) -> str:
    """Why nothing shows how the law predicts other levels, by its key in `UNSCORED`; or empty."""
    if not found.sizes["run"]:
        return "two runs" if found.attrs["num_runs"] > 1 else "one run"
    y_low, y_high = float(found.attrs["y_low"]), float(found.attrs["y_high"])
    return "one level" if 0 < y_low <= y_high <= ONE_LEVEL * y_low else ""


def discrepancy_sentences(found: xr.Dataset) -> list[str]:
    """What bands of tests that were not fitted hold beside noise, and what cannot be scored."""
    reason = unscored_levels(found)
    unscored = [messages.UNSCORED[reason].sentence] if reason else []
    return unscored if discrepancy_in(found).is_nothing else [messages.IN_BANDS, *unscored]


def amplitudes_of_runs(data: Dataset, omega_n: float) -> dict[str, float]:
    """Largest displacement of every run [m], where it is known, by omega_n [rad/s].

    That of a part is of its largest run, and others go by the size of their response. Of free
    decays alone what their envelopes begin with.
    """
    amplitudes: dict[str, float] = {}
    for part in data.parts:
        sizes = {} if part.own_shifts else sizes_of_runs(part)
        largest, y_of_part = max(sizes.values(), default=0.0), part.y_peak(omega_n)
        if y_of_part > 0:
            of_runs = {run: y_of_part * size / largest for run, size in sizes.items()}
            amplitudes |= {run: max(y, amplitudes.get(run, 0.0)) for run, y in of_runs.items()}
    if amplitudes:
        return amplitudes
    return {run: y for part in data.parts for run, y in part.begins_at(omega_n).items()}


def _decays(data: Dataset) -> set[str]:
    """Names of free decays."""
    return {run for part in data.parts if part.own_shifts for run in part.runs}


def _drift(run: str, fit: Fit, data: Dataset) -> LeftOutDecay | None:
    """Drift of a run that is a free decay of one mode."""
    part = next(part for part in data.parts if run in part.runs)
    return part.drift(as_arrays(fit.theta, data), run)


def _labels_of(run: str, data: Dataset) -> list[str]:
    return [label for label, name in zip(data.labels, data.runs, strict=True) if name == run]


def _end_to_end(
    rows: Float[np.ndarray, "all ..."], labels: Sequence[str], data: Dataset
) -> Float[np.ndarray, "some ..."]:
    """Those of the rows of `stacked` that belong to some groups."""
    labelled = by_label(rows, data)
    return np.concatenate([labelled[label] for label in labels])


def _kinds(data: Dataset) -> dict[str, tuple[str, ...]]:
    """Kinds of test that the part of every group takes, by label."""
    return {label: part.kinds for part in data.parts for label in part.labels}


def _noise_of_repeats(data: Dataset) -> dict[str, NoiseSquares]:
    """What noise leaves of the mean of each group that was repeated."""
    sizes = size_by_label(data)
    known_by = {label: x for part in data.parts for label, x in part.noise_known().items()}
    scatter = {label: x for part in data.parts for label, x in part.mean_repeatability().items()}
    return {
        label: NoiseSquares((x * sizes[label]) ** 2, known_by[label])
        for label, x in scatter.items()
    }


def _noise_alike(residuals: Mapping[str, Row], data: Dataset) -> dict[str, NoiseSquares]:
    """What noise would leave of each group, were it not fitted, where no repeats tell it.

    As much a value as the fit leaves of other groups of its kind, or of itself where there are no
    others: bands take that for noise.
    """
    kinds, fractions = _kinds(data), fractions_counted(data)
    square = {label: _square(row) / _count(row) for label, row in residuals.items()}
    noise = {}
    for label, row in residuals.items():
        others = [other for other in residuals if other != label and kinds[other] == kinds[label]]
        comparable = others or [label]
        known_by = sum(fractions[x] * _count(residuals[x]) for x in comparable)
        noise[label] = NoiseSquares(
            _count(row) * float(np.mean([square[x] for x in comparable])), known_by
        )
    return noise


def _hides_in_noise(residuals: Mapping[str, Row], repeated: NoiseOf) -> bool:
    """Whether a residual without repeats is coloured: it counts as noise, and is the law's."""
    return any(is_coloured(row) for label, row in residuals.items() if label not in repeated)


def _rests(
    residuals: Mapping[str, Row],
    noise: NoiseOf,
    data: Dataset,
    uncertain: Mapping[str, Inexact[np.ndarray, "_value parameter"]] | None = None,
) -> dict[str, Rest]:
    """What is left of groups over their response, by the kinds of test that they are of."""
    kinds, sizes, fractions = _kinds(data), size_by_label(data), fractions_counted(data)
    squares: dict[str, list[tuple[Rest, float]]] = {}
    for label, row in residuals.items():
        moved = None if uncertain is None else uncertain[label]
        rest = _rest(row, noise[label], fractions[label], moved)
        for kind in kinds[label]:
            squares.setdefault(kind, []).append((rest, sizes[label] ** 2))
    return {
        kind: _over(_sum_of([rest for rest, _ in pairs]), sum(size for _, size in pairs))
        for kind, pairs in squares.items()
    }


def _rest(
    row: Row,
    noise: NoiseSquares,
    fraction: float,
    uncertain: Inexact[np.ndarray, "value parameter"] | None = None,
) -> Rest:
    r"""A row's square beside what is expected of it, $N n + |M|^2$, and the variance of that."""
    moved = np.zeros((len(row), 0)) if uncertain is None else uncertain
    real = real_rows(moved)
    count, of_errors, products = _count(row), float(np.sum(real**2)), real.T @ real
    of_noise = noise.square**2 * (1 / (count * fraction) + 1 / noise.known_by)
    of_both = 2 * noise.square / count * of_errors
    variance = 2 * (of_noise + of_both + float(np.sum(products**2)))
    return Rest(_square(row), noise.square + of_errors, variance, noise.square)


def _over(rest: Rest, size: float) -> Rest:
    """A rest over the square of a response."""
    square, mean, variance, noise = rest
    return Rest(square / size, mean / size, variance / size**2, noise / size)


def _sum_of(rests: Sequence[Rest]) -> Rest:
    """Several rests in one, each independent of the others."""
    return Rest(*np.sum(rests, axis=0).tolist())


def _pooled(shown: Sequence[LeftOutRun], *, judged: bool) -> dict[str, Scatter]:
    """Share of each kind that runs show together, widened for few runs."""
    runs: dict[str, list[LeftOutRun]] = {}
    for run in shown:
        for kind in run.rests:
            runs.setdefault(kind, []).append(run)
    return {kind: _share_of_runs(of_kind, kind, judged=judged) for kind, of_kind in runs.items()}


def _share_of_runs(runs: Sequence[LeftOutRun], kind: str, *, judged: bool) -> Scatter:
    rests, grown = [run.rests[kind] for run in runs], [run.grown for run in runs]
    widths = widened(len(runs)) ** 0.5
    size, of_noise = np.sqrt([[rest.square, rest.noise] for rest in rests]).T
    total = missed_in_all(size, of_noise, np.array(grown), len(runs))
    share = _share_of(rests, grown, judged=judged) * widths
    return Scatter(share, 0, max(share, total))


def _share_of(rests: Sequence[Rest], grown: Sequence[float], *, judged: bool) -> float:
    r"""$\sqrt{\mathrm{mean}\,((|e_r|^2 - E|e_r|^2) / g_r)}$; judged, none that chance makes."""
    if judged and _sum_of(rests).is_by_chance:
        return 0.0
    beyond = [(x.square - x.mean) / g**2 for x, g in zip(rests, grown, strict=True)]
    return float(np.sqrt(max(np.mean(beyond), 0.0)))


def _square(row: Row) -> float:
    return float(np.sum(np.abs(row) ** 2))


def _count(row: Row) -> int:
    """Real values of a row."""
    return len(row) * (2 if np.iscomplexobj(row) else 1)
