r"""Model discrepancy: the error of a law in predicting runs that were not fitted.

The equivalent stiffness and damping of an inexact law differ from those of the joint, by an amount
that depends on amplitude. Every run r is left out of the fit in turn. One part of its residual,
$e_r$ in standard errors, is a change of natural frequency and damping ratio,

$$\hat b_r = (S_r^T S_r)^{-1} S_r^T e_r, \qquad
  V_r = (S_r^T S_r)^{-1} + P_r C_{-r} P_r^T, \quad P_r = (S_r^T S_r)^{-1} S_r^T J_r$$

where S are the derivatives of the prediction by omega_n and zeta, J those by all parameters and C
the covariance of the fit without the run. The variance of this change is common to all kinds of
test, and grows with the distance from the fitted amplitudes (`discrepancy`),

$$\hat b_r \sim N\bigl(0,\, V_r + \tau^2 (y_r / y_{max})^{2p} g_r\bigr), \quad p = 0, 1, 2.$$

$\tau$ is that of Paule and Mandel about zero. All of them are zero if chance explains frequency,
damping and the remainder together. If not, a single $\tau$ is still zero if its errors are mostly
the scatter of runs, which bands include already, and chance explains it. If no repeats determine
the noise and the residual is correlated, the law's misfit counts as noise and the effect of chance
is overestimated: then $\tau$ is used without this test. The effect of chance is that of a sum of
squares of correlated numbers: a run's noise is in the fits without the others, and

$$\mathrm{cov}(\hat b_r, \hat b_q) = -P_r C_{-r} C^{-1} C_{-q} P_q^T, \quad r \ne q$$

for a linear model, with the covariance C of the fit of all runs.

The whole error of held-out runs beyond noise, including errors of the parameters, is

$$\tau_0^2 = \mathrm{mean}_r ((\hat b_r^2 - \sigma_r^2) / g_r)$$

with the errors $\sigma_r$ due to noise alone. The remainder of $e_r$ is expressed as a share of the
response, white, beyond the part that noise and the errors of the fit without the run explain,

$$E|e|^2 = N n + |M|^2, \qquad
  \mathrm{var}|e|^2 = 2\,(N n^2 / f + N^2 n^2 / K + 2 n |M|^2 + |M^T M|^2), \\
  M = (I - S_r (S_r^T S_r)^{-1} S_r^T)\,J_r C_{-r}^{1/2}$$

for N values, of which a fraction f is independent, with the noise n of similar tests, which K
values determine. The effect of chance is that of the gamma distribution with these moments. A
variance that n runs determine is multiplied by $(t_{n, 0.995} / z_{0.995})^2$: then the 99 % band
of a normal distribution is that of Student's t.

Reference:
    Satterthwaite (1946), Biometrics Bull. 2, 110: the distribution of a sum of squares.
    Paule and Mandel (1982), J. Res. Natl. Bur. Stand. 87, 377.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float, Inexact
from scipy import stats
from scipy.optimize import root_scalar

from jbw.identification.discrepancy import (
    NO_SCATTER,
    POWERS,
    Discrepancy,
    Missed,
    Scatter,
    as_dataset,
    growth_shown,
    widened,
)
from jbw.identification.leaving_out import FitsWithout
from jbw.identification.run_effects import (
    sizes_of_runs,
    tells_apart,
)
from jbw.inference.fit.costly_fit import evaluator, from_search, residual_at, to_search
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.measurement.residual_spectra import real_rows
from jbw.observables.dataset import (
    Dataset,
    as_arrays,
    by_label,
    residual_by_label,
    size_by_label,
    stacked,
)
from jbw.observables.decay import drift_from_beginning
from jbw.observables.decay_drift import LeftOutDecay
from jbw.observables.drives import plain
from jbw.observables.effective_values import is_coloured, white_square
from jbw.observables.groups import Row
from jbw.observables.noise import fractions_counted, num_known, repeatability
from jbw.observables.observable import OFFSETS
from jbw.report.messages import discrepancy as messages

# Frequency shifts and residuals are errors of the law if chance causes such large ones with a
# probability below this.
BY_CHANCE = 0.01
NO_OFFSET = 1e-9  # factor that suppresses offsets between runs
# Smallest number of fits that each leave out one run. With fewer fits, each fit has only one or two
# levels, and the derivatives of the fit do not give the errors of its parameters.
FEWEST_FITS = 3


class NoiseSquares(NamedTuple):
    """The sum of squares that noise causes in a data group, and its degrees of freedom."""

    square: float
    known_by: float


class Rest(NamedTuple):
    """The squared residual after shifts of frequency and damping, with its expected value."""

    square: float
    mean: float
    variance: float
    noise: float = 0.0  # contribution of noise to the mean

    @property
    def is_by_chance(self) -> bool:
        """Whether chance causes so large a squared residual in more than 1 % of cases."""
        if self.mean <= 0:
            return self.square <= 0
        scale = self.variance / (2 * self.mean)
        return bool(stats.chi2.sf(self.square / scale, self.mean / scale) > BY_CHANCE)


class LeftOutRun(NamedTuple):
    """The errors of a run's prediction by the fit without this run."""

    shift: Float[np.ndarray, " own"]  # error of the law in omega_n [rad/s] and zeta
    std: Float[np.ndarray, " own"]  # standard errors of the shift; infinite if it is not determined
    rests: Mapping[str, Rest]  # squared residuals relative to the squared response, by kind of test
    is_decay: bool = False
    amplitude: float = np.nan  # amplitude relative to the largest fitted one; NaN if unknown
    grown: float = 1.0  # factor by which standard deviations grow up to `amplitude`
    noise_std: Float[np.ndarray, " own"] = np.zeros(0)  # contribution of noise to `std`
    # matrix $P C$ of the fit without the run, which gives the noise that runs share; None if there
    # is no fit without the run
    by_parameters: Float[np.ndarray, "own parameter"] | None = None


NoiseOf = Mapping[str, NoiseSquares]  # noise by label of the data group


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
    r"""Return the most likely standard deviation of errors: constant, or growing with amplitude.

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
    r"""Return the correlation of different runs' shifts, $-P_r C_{-r} C^{-1} C_{-q} P_q^T$.

    Decays, which are predicted from their own beginnings, share no noise with other runs here.

    Args:
        shown: Discrepancies of the runs.
        covariance: Covariance of the parameters in the fit of all runs.
        quantity: 0 for the natural frequency, 1 for the damping ratio.
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
    r"""Return $\tau_0$, the law's total error beyond noise on runs that were not fitted.

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
    r"""Return Paule and Mandel's standard deviation $\tau$ about zero; 0 if chance explains all.

    $$\sum_r \frac{b_r^2}{\sigma_r^2 + \tau^2 g_r} = n, \qquad \tau\, t_{m, 0.995} / z_{0.995}$$

    for m fits, each without one or several of n runs. The result is 0 if chance explains as much in
    more than 1 % of cases or, if not `judged`, if as much is expected. The sum of squares of n
    normal numbers of a correlation R has the mean n and the variance $2\,\mathrm{tr}\,R^2$.
    """
    finite = np.isfinite(std)
    b, variance, g = shift[finite] ** 2, std[finite] ** 2, grown[finite] ** 2
    count = len(b)
    chi_square = float(np.sum(b / variance))
    of_chance = 2 * float(np.sum(correlation[np.ix_(finite, finite)] ** 2))
    by_chance = judged and Rest(chi_square, count, of_chance).is_by_chance
    if chi_square <= count or by_chance:
        return 0.0
    # an upper bound of the variance: with this variance, the sum below is at most `count`
    most = float(np.sum(b / g))
    solution = root_scalar(
        lambda square: float(np.sum(b / (variance + square * g))) - count,
        bracket=(0.0, most),
        rtol=1e-12,
    )
    return float(np.sqrt(solution.root * widened(num_fits)))


def shift_of(
    residual: Float[np.ndarray, " value"],
    slopes: Float[np.ndarray, "value own"],
    jacobian: Float[np.ndarray, "value parameter"],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> tuple[Float[np.ndarray, " own"], Float[np.ndarray, " own"]]:
    r"""Return the change of omega_n and zeta that explains a residual, with standard errors.

    $$\hat b = (S^T S)^{-1} S^T e, \qquad V = (S^T S)^{-1} + P C P^T, \quad P = (S^T S)^{-1} S^T J$$

    The residual is in standard errors. If a derivative is zero, or the two are parallel, the errors
    are infinite.
    """
    along = coefficients_of(slopes)
    by_parameters = along @ jacobian
    spread = along @ along.T + by_parameters @ covariance @ by_parameters.T
    informed = np.any(along != 0.0, axis=1)
    return along @ residual, np.where(informed, np.sqrt(np.diag(spread)), np.inf)


def coefficients_of(slopes: Float[np.ndarray, "value own"]) -> Float[np.ndarray, "own value"]:
    """Return the least-squares operator of the slopes, $(S^T S)^{-1} S^T$; zeros if singular."""
    along, informed = np.zeros(slopes.shape[::-1]), np.any(slopes != 0.0, axis=0)
    precision = slopes[:, informed].T @ slopes[:, informed]
    if np.any(informed) and tells_apart(precision):
        along[informed] = np.linalg.solve(precision, slopes[:, informed].T)
    return along


def root_of(
    covariance: Float[np.ndarray, "parameter parameter"],
) -> Float[np.ndarray, "parameter parameter"]:
    """Return a root R of a covariance R R^T, even if rounding has made R R^T indefinite."""
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    return std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


class Slopes(NamedTuple):
    """Derivatives of predictions without run offsets, and standard deviations of the offsets."""

    data: Dataset  # the dataset without run offsets
    jacobian: Float[np.ndarray, "value parameter"]  # derivatives of the predictions
    # standard deviations of omega_n [rad/s] and zeta between runs
    scatter: Float[np.ndarray, " own"]


def slopes_of(best: Fit, prior: Box, data: Dataset) -> Slopes:
    """Return the derivatives of predictions for a new run, whose offsets are unknown."""
    if not data.has_offsets:
        return Slopes(data, -best.jacobian, np.zeros(len(OFFSETS)))
    scatter = np.asarray(data.scatter)
    bare = replace(data, scatter=jax.device_put(NO_OFFSET * scatter))
    width = np.asarray(prior.upper) - np.asarray(prior.lower)
    search = to_search(best.x, prior)
    slope = from_search(np.asarray(search), prior)[1]
    jacobian = evaluator(stacked, prior, bare)(search, 1) / slope / width
    return Slopes(bare, -jacobian, scatter[: len(OFFSETS)])


def left_out_run(run: str, fit: Fit, known: Slopes, prior: Box, noise: NoiseOf) -> LeftOutRun:
    """Return errors of frequency, damping and response of a run that the given fit leaves out."""
    data, names = known.data, list(fit.theta)
    rows = residual_at(stacked, fit.x, prior, data)
    sizes, pairs = size_by_label(data), zip(data.labels, data.runs, strict=True)
    labels = [label for label, name in pairs if name == run and label in sizes]
    columns = [[i for i, n in enumerate(names) if plain(n) == name] for name in OFFSETS]
    by_own = np.stack([known.jacobian[:, indices].sum(axis=1) for indices in columns], axis=1)
    jacobian, slopes = (
        _end_to_end(derivatives, labels, data) for derivatives in (known.jacobian, by_own)
    )
    of_run = _end_to_end(rows, labels, data)
    shift, std = shift_of(of_run, slopes, jacobian, fit.covariance)
    _, noise_std = shift_of(of_run, slopes, jacobian, np.zeros_like(fit.covariance))
    residuals = residual_by_label(rows - by_own @ shift, data)
    shift_by_parameters = coefficients_of(slopes) @ jacobian
    explained = by_own @ shift_by_parameters
    by_errors = (known.jacobian - explained) @ root_of(fit.covariance)
    moves = [residual_by_label(column, data) for column in by_errors.T]
    uncertain = {label: np.stack([move[label] for move in moves], axis=1) for label in labels}
    rests = _rests({label: residuals[label] for label in labels}, noise, data, uncertain)
    by_runs = np.hypot(std, known.scatter), np.hypot(noise_std, known.scatter)
    return LeftOutRun(
        shift,
        by_runs[0],
        rests,
        noise_std=by_runs[1],
        by_parameters=shift_by_parameters @ fit.covariance,
    )


def by_drift(of_run: LeftOutRun, decay: LeftOutDecay, omega_n: float) -> LeftOutRun:
    """Return a free decay's errors of frequency and damping: its drift from the prediction.

    The prediction starts from the measured beginning of the decay. The uncertainty of the damping
    includes the uncertainty of the parameters, taken from `of_run`.
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


class FitOfAll(NamedTuple):
    """Quantities that all held-out runs have in common."""

    num_fits: int  # number of fits, each of which omits some of the runs
    omega_n: float  # natural frequency of the fit of all runs [rad/s]
    # covariance of the parameters in the fit of all runs
    covariance: Float[np.ndarray, "parameter parameter"]
    # standard deviations of omega_n [rad/s] and zeta between runs
    scatter: Float[np.ndarray, " own"]


def model_discrepancy(best: Fit, prior: Box, data: Dataset, fits: FitsWithout) -> xr.Dataset:
    """Estimate the model discrepancy of each held-out run, and of all runs together.

    `fits` are the result of `leaving_out.fits_without_each_run`.
    """
    fits = fits if len(fits) >= FEWEST_FITS else {}
    everything_known = {**data.held, **best.theta}
    by_name = {plain(n): float(value) for n, value in reversed(everything_known.items())}
    natural = by_name.get("omega_n", 1.0)
    amplitudes, repeated = amplitudes_of_runs(data, natural), _noise_of_repeats(data)
    residuals, slopes = residual_by_label(best.residual, data), slopes_of(best, prior, data)
    noise = _noise_alike(residuals, data) | repeated
    decays = {run for part in data.parts if part.own_shifts for run in part.groups.runs}
    stay_in = decays - {run for group in fits for run in group}
    # If the decays of a test are partly held out, the remaining ones took part in the fit.
    fits_with_decays = {tuple(sorted(stay_in)): best} if stay_in else {}
    shown = {
        run: _placed(_shown_by(run, fit, slopes, prior, noise, natural), run, group, amplitudes)
        for group, fit in (fits_with_decays | {g: x.fit for g, x in fits.items()}).items()
        for run in group
    }
    as_fitted = _rests({label: residuals[label] for label in repeated}, repeated, data)
    in_noise = bool(fits) and _hides_in_noise(residuals, repeated)
    of_all = FitOfAll(len(fits), natural, best.covariance, slopes.scatter)
    learned = _learned(list(shown.values()), as_fitted, of_all, judged=not in_noise)
    if not learned.is_nothing:  # Chance alone does not explain all errors.
        learned = _learned(list(shown.values()), as_fitted, of_all, judged=False)
    sizes = size_by_label(data)
    sized_runs = {run for label, run in zip(data.labels, data.runs, strict=True) if label in sizes}
    about = {
        "omega_n": natural,
        "zeta": by_name.get("zeta", 1.0),
        "num_runs": len(sized_runs),
        "noise_by_repeats": int(set(sizes) <= set(repeated)),
        "hidden_in_noise": int(in_noise),
    }
    return _as_arrays_of_runs(shown, learned, amplitudes).assign_attrs(about)


def _shown_by(
    run: str, fit: Fit, slopes: Slopes, prior: Box, noise: NoiseOf, natural: float
) -> LeftOutRun:
    """Return the discrepancy of a held-out run; that of a decay is relative to its beginning."""
    of_run = left_out_run(run, fit, slopes, prior, noise)
    decay = _drift(run, fit, slopes.data)
    return of_run if decay is None else by_drift(of_run, decay, natural)


def _placed(
    of_run: LeftOutRun, run: str, group: Sequence[str], amplitudes: Mapping[str, float]
) -> LeftOutRun:
    """Return a run's discrepancy, with the run's amplitude divided by the largest fitted one."""
    others, y_high = [y for name, y in amplitudes.items() if name not in group], _y_high(amplitudes)
    lowest, highest = min(others, default=0.0), max(others, default=0.0)
    return of_run._replace(
        amplitude=amplitudes.get(run, np.nan) / y_high if y_high > 0 else np.nan,
        grown=growth_shown(amplitudes.get(run), lowest, highest),
    )


def _y_high(amplitudes: Mapping[str, float]) -> float:
    return max(amplitudes.values(), default=0.0)


def _as_arrays_of_runs(
    shown: Mapping[str, LeftOutRun], learned: "Learned", amplitudes: Mapping[str, float]
) -> xr.Dataset:
    """Return the discrepancy of each run as arrays, and that of all runs as attributes."""
    nothing = Missed(NO_SCATTER, NO_SCATTER)
    missed = learned if not learned.is_nothing else Learned(nothing, nothing, {})
    runs, y_high = shown.values(), _y_high(amplitudes)
    shape, dims = (len(shown), len(OFFSETS)), ("run", "quantity")
    shift, std, noise_std = (
        np.reshape([getattr(run, name) for run in runs], shape)
        for name in ("shift", "std", "noise_std")
    )
    units = {"group_units": ["rad/s", "1"]}
    of_all = Discrepancy(
        missed.forced or missed.decays or nothing,
        missed.decays or missed.forced or nothing,
        missed.shares,
        min((y for y in amplitudes.values() if y > 0), default=0.0),
        y_high,
    )
    return as_dataset(of_all).assign(
        {
            "amplitude": (
                "run",
                [run.amplitude * y_high for run in runs],
                {"units": "m", "long_name": "largest displacement"},
            ),
            "growth": (
                "run",
                [run.grown for run in runs],
                {"units": "1", "long_name": "factor at its amplitude"},
            ),
            "shift": (dims, shift, {**units, "long_name": messages.SHIFT_OF_RUN}),
            "std": (dims, std, {**units, "long_name": "its standard error"}),
            "noise_std": (dims, noise_std, {**units, "long_name": "that of noise alone"}),
            "run": np.array(list(shown), str),
            "quantity": list(OFFSETS),
        },
    )


class Learned(NamedTuple):
    """The discrepancy of all held-out runs together."""

    forced: Missed | None  # errors of frequency and damping in driven tests; None without such runs
    decays: Missed | None
    shares: Mapping[str, Scatter]  # remaining errors of the response, by kind of test

    @property
    def is_nothing(self) -> bool:
        """Whether the law has no error that exceeds the noise."""
        scatters = (*(self.forced or ()), *(self.decays or ()), *self.shares.values())
        return not any(scatter.std for scatter in scatters)


def _learned(
    runs: Sequence[LeftOutRun],
    as_fitted: Mapping[str, Rest],
    of_all: FitOfAll,
    *,
    judged: bool,
) -> Learned:
    """Combine the discrepancies of held-out runs with the residuals of repeated tests.

    If `judged`, discrepancies that chance explains are zero.
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


def _missed(shown: Sequence[LeftOutRun], of_all: FitOfAll, *, judged: bool) -> Missed | None:
    """Return the standard deviations over runs of the errors in frequency (relative) and damping.

    None if no run is given.

    The scatter of the natural frequency [rad/s] is divided by that frequency.
    """
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
        # Bands already include the variation between runs. Therefore a discrepancy that chance
        # explains is not added.
        missed = 0.0 if by_runs else missed_in_all(b, of_noise, grown, num_fits)
        scatters.append(scatter._replace(whole=max(scatter.std, missed)))
    omega_n, zeta = scatters
    relative = Scatter(omega_n.std / natural, omega_n.power, omega_n.whole / natural)
    return Missed(relative, zeta)


def amplitudes_of_runs(data: Dataset, omega_n: float) -> dict[str, float]:
    """Return each run's largest displacement [m], if it is known.

    The displacement of an observable is that of its largest run; other runs follow by the size of
    their response. If there are only free decays, it is the beginning of their envelopes. `omega_n`
    [rad/s] converts other responses to displacement.
    """
    amplitudes: dict[str, float] = {}
    for part in data.parts:
        sizes = {} if part.own_shifts else sizes_of_runs(part)
        largest, y_of_part = max(sizes.values(), default=0.0), part.shown(omega_n).y_peak
        if y_of_part > 0:
            of_runs = {run: y_of_part * size / largest for run, size in sizes.items()}
            amplitudes |= {run: max(y, amplitudes.get(run, 0.0)) for run, y in of_runs.items()}
    if amplitudes:
        return amplitudes
    return {run: y for part in data.parts for run, y in part.shown(omega_n).begins.items()}


def _drift(run: str, fit: Fit, data: Dataset) -> LeftOutDecay | None:
    """Return the drift of a free decay of one mode from its prediction; None for other runs."""
    part: Any = next(part for part in data.parts if run in part.groups.runs)
    if not part.own_shifts or part.several:
        return None
    return drift_from_beginning(as_arrays(fit.theta, data), part, run)


def _end_to_end(
    rows: Float[np.ndarray, "all ..."], labels: Sequence[str], data: Dataset
) -> Float[np.ndarray, "some ..."]:
    """Join the values of given data groups to one array."""
    labelled = by_label(rows, data)
    return np.concatenate([labelled[label] for label in labels])


def _kinds(data: Dataset) -> dict[str, tuple[str, ...]]:
    """Return the kinds of test of every data group, by label."""
    return {label: part.kinds for part in data.parts for label in part.groups.labels}


def _noise_of_repeats(data: Dataset) -> dict[str, NoiseSquares]:
    """Return, as a sum of squares, the noise in the mean of each data group with repeats."""
    sizes = size_by_label(data)
    known_by = num_known(data)
    scatter = repeatability(data, of_mean=True)
    return {
        label: NoiseSquares((x * sizes[label]) ** 2, known_by[label])
        for label, x in scatter.items()
    }


def _noise_alike(residuals: Mapping[str, Row], data: Dataset) -> dict[str, NoiseSquares]:
    """Estimate the noise of data groups without repeats from other groups of the same kind.

    The noise per value is the median mean square residual of other groups of its kind, or of the
    group itself if there are none, because bands use it as noise. The white part of a noisier
    group's residual also counts as noise.
    """
    kinds, fractions = _kinds(data), fractions_counted(data)
    square = {label: _square(row) / _count(row) for label, row in residuals.items()}
    noise = {}
    for label, row in residuals.items():
        others = [other for other in residuals if other != label and kinds[other] == kinds[label]]
        comparable = others or [label]
        known_by = sum(fractions[x] * _count(residuals[x]) for x in comparable)
        usual = _count(row) * float(np.median([square[x] for x in comparable]))
        noise[label] = NoiseSquares(max(usual, len(row) * white_square(row)), known_by)
    return noise


def _hides_in_noise(residuals: Mapping[str, Row], repeated: NoiseOf) -> bool:
    """Return whether tests without repeats have correlated residuals, which may be model error."""
    return any(is_coloured(row) for label, row in residuals.items() if label not in repeated)


def _rests(
    residuals: Mapping[str, Row],
    noise: NoiseOf,
    data: Dataset,
    uncertain: Mapping[str, Inexact[np.ndarray, "_value parameter"]] | None = None,
) -> dict[str, Rest]:
    """Return, by kind of test, squared residuals divided by the squared response."""
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
    r"""Return a squared residual, its expected value $N n + |M|^2$ from noise, and its variance."""
    moved = np.zeros((len(row), 0)) if uncertain is None else uncertain
    real = real_rows(moved)
    count, of_errors, products = _count(row), float(np.sum(real**2)), real.T @ real
    of_noise = noise.square**2 * (1 / (count * fraction) + 1 / noise.known_by)
    of_both = 2 * noise.square / count * of_errors
    variance = 2 * (of_noise + of_both + float(np.sum(products**2)))
    return Rest(_square(row), noise.square + of_errors, variance, noise.square)


def _over(rest: Rest, size: float) -> Rest:
    """Divide squared residuals by the mean square of a response."""
    square, mean, variance, noise = rest
    return Rest(square / size, mean / size, variance / size**2, noise / size)


def _sum_of(rests: Sequence[Rest]) -> Rest:
    return Rest(*np.sum(rests, axis=0).tolist())


def _pooled(shown: Sequence[LeftOutRun], *, judged: bool) -> dict[str, Scatter]:
    """Return the law's remaining relative error for each kind of test, over all runs."""
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
    r"""Return $\sqrt{\mathrm{mean}\,((|e_r|^2 - E|e_r|^2) / g_r)}$, the error beyond noise.

    If `judged`, it is 0 if chance explains as much.
    """
    if judged and _sum_of(rests).is_by_chance:
        return 0.0
    beyond = [(x.square - x.mean) / g**2 for x, g in zip(rests, grown, strict=True)]
    return float(np.sqrt(max(np.mean(beyond), 0.0)))


def _square(row: Row) -> float:
    return float(np.sum(np.abs(row) ** 2))


def _count(row: Row) -> int:
    """Return the number of real values in a row of values; a complex value counts as two."""
    return len(row) * (2 if np.iscomplexobj(row) else 1)
