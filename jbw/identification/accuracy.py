"""Checks of a fit: solver error, correlated residuals, misfit, and variation between repeats."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.campaign.settings import SPRING
from jbw.inference.fit.fitting import Fit
from jbw.inference.lanes import at_points
from jbw.inference.posterior.finding import Amendment, Finding, checked, usable_within
from jbw.inference.posterior.remedies import put
from jbw.inference.posterior.summary import evenly_spaced
from jbw.measurement.channels import rms
from jbw.observables.dataset import (
    Dataset,
    by_label,
    error_by_label,
    halved,
    log_likelihood,
    residual_by_label,
    size_by_label,
)
from jbw.observables.effective_values import (
    LEAST_VALUES,
    coloured_from,
    correlation_at_one,
    is_coloured,
    white_square,
)
from jbw.observables.noise import fractions_counted, num_known, repeatability
from jbw.report.messages import residuals as messages
from jbw.report.messages.remedies import OTHER_LAWS, beside_other_laws

# largest shift of a posterior mean by the solver's error, in posterior standard deviations
SHIFT = 0.1
NUM_DRAWS = 32
CLOSE = 0.05  # A law is still rated usable if no test's relative error exceeds this.
# codes of the findings whose status is changed if the error is below CLOSE
OF_MISFIT = ("coloured_residual", "repeatability", "chi_square")
MOST_BEYOND = 1.5  # largest relative error of held-out tests, divided by that of the fitted tests
TINY = np.finfo(float).tiny


def solver_finding(posterior: xr.Dataset, data: Dataset) -> Finding | None:
    r"""Check whether the solver's time step may have shifted the posterior; None without steps.

    Halving the step changes the log likelihood by $\Delta\ell(\theta)$ and so a posterior mean by
    $\mathrm{Cov}(\theta, \Delta\ell)$, at most $\mathrm{sd}(\Delta\ell)$ standard deviations.
    """
    change = solver_change(thinned(posterior), data)
    if change is None:
        return None
    shift = np.std(change)
    values, remedy = {"shift": shift, "limit": SHIFT}, {"substeps": 2 * substeps_of(data)}
    return checked("solver_error", shift < SHIFT, values, shift, remedy)


def substeps_of(data: Dataset) -> int:
    """Return the largest number of solver steps per sample in a dataset."""
    return max((part.substeps or 1 for part in data.parts), default=1)


def another_law(laws: Sequence[str]) -> str:
    """Return the campaign file's line that adds a cubic spring, or the advice to try other laws."""
    if SPRING in laws:
        return OTHER_LAWS
    return beside_other_laws(put("joint", "laws", [*laws, SPRING]))


def solver_change(
    theta: Mapping[str, Float[np.ndarray, "..."]], data: Dataset
) -> NDArray[np.float64] | None:
    """Return the change of each draw's log likelihood when the solver's step is halved, or None."""
    finer = halved(data)
    if finer is None:
        return None
    terms = (at_points(log_likelihood, theta, discretised) for discretised in (finer, data))
    fine, coarse = (term.sum(axis=1) for term in terms)
    return fine - coarse


def thinned(
    posterior: xr.Dataset, names: tuple[str, ...] | None = None, num_draws: int = NUM_DRAWS
) -> dict[str, np.ndarray]:
    """Return a few parameter draws, evenly spaced over all chains."""
    keep = evenly_spaced(posterior, num_draws)
    chosen = names or tuple(str(name) for name in posterior.data_vars)
    return {name: posterior[name].values.ravel()[keep] for name in chosen}


def residual_finding(
    residuals: Mapping[str, np.ndarray],
    counted: Mapping[str, float],
    error: Mapping[str, float],
    laws: Sequence[str] = (),
) -> Finding | None:
    """Check for each data group whether the residuals of a fit are correlated (lag one).

    All mappings are by the label of the group: its values of `residuals`, the fraction of its
    values that is `counted`, and its relative `error`. `laws` are the fitted laws.
    """
    long = {label: row for label, row in residuals.items() if len(row) >= 2 * LEAST_VALUES}
    lag_one = {label: correlation_at_one(row) for label, row in long.items()}
    if not lag_one:
        return None
    # Compare each correlation with the largest one that white noise of the same length has. A
    # correlation that cannot be computed counts as the worst.
    ratio = {label: abs(value) / coloured_from(long[label]) for label, value in lag_one.items()}
    worst = max(ratio, key=lambda label: np.nan_to_num(ratio[label], nan=np.inf))
    coloured = sum(not value < 1 for value in ratio.values())
    values = {
        "coloured": coloured, "count": len(lag_one), "test": worst, "error": error[worst],
        "correlation": lag_one[worst], "counted": counted[worst],
    }  # fmt: skip
    remedy = {"another_law": another_law(laws)}
    return checked("coloured_residual", not coloured, values, lag_one[worst], remedy)


def errors_and_colour(best: Fit, data: Dataset) -> tuple[dict[str, float], Finding | None]:
    """Return each data group's relative error at a fit, and the finding on residual correlation."""
    residuals = residual_by_label(best.residual, data)
    error = error_by_label(residuals, data)
    return error, residual_finding(residuals, fractions_counted(data), error, data.laws)


def misfit_beyond_noise(best: Fit, data: Dataset) -> float:
    r"""Return the error of a law relative to the response, from the residual beyond white noise.

    $$\rho^2 = \mathrm{mean}_g \frac{|r_g|^2 - n_g \sigma_g^2}{|d_g|^2}$$

    over data groups of n values with residuals r, responses d and the white part sigma of the
    residuals; a group whose residual is not coloured adds nothing.
    """
    residuals, sizes = residual_by_label(best.residual, data), size_by_label(data)
    rows = {label: residuals[label] for label, size in sizes.items() if size > 0}
    squares = [
        max(np.sum(np.abs(row) ** 2) - len(row) * white_square(row), 0.0) / sizes[label] ** 2
        if is_coloured(row)
        else 0.0
        for label, row in rows.items()
    ]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def shape_finding(error: Mapping[str, float], data: Dataset) -> Finding | None:
    """Check the data group whose error is largest relative to its limit; None without limits."""
    bounded = {
        label: part.most_misfit
        for part in data.parts
        if part.most_misfit is not None
        for label in part.groups.labels
    }
    if not bounded:
        return None
    worst = max(bounded, key=lambda label: error[label] / bounded[label])
    values = {"test": worst, "error": error[worst], "limit": bounded[worst]}
    remedy = {"another_law": another_law(data.laws)}
    return checked("misfit", error[worst] < bounded[worst], values, error[worst], remedy)


def explained(first: Fit, data: Dataset) -> tuple[float, int] | None:
    """Return a fit's chi-square and degrees of freedom, from the data groups with known noise."""
    sizes = num_known(data)
    # With at least as many parameters as values, a fit explains any data.
    if sum(sizes.values()) <= len(first.x):
        return None
    rows = by_label(first.residual, data)
    total = sum(float(np.sum(rows[label] ** 2)) for label in sizes)
    return total, int(sum(sizes.values())) - len(first.x)


def within_misfit(error: Mapping[str, float]) -> Amendment | None:
    """Return a law's new rating: usable if the error of the fit is small; otherwise None.

    Long or precise records show residuals beyond noise even where these are only a few per cent of
    the record. Such a law is wrong only in that small part, and the intervals include it.
    """
    worst = max(error, key=lambda label: np.nan_to_num(error[label], nan=np.inf), default=None)
    if worst is None or not error[worst] <= CLOSE:
        return None
    return usable_within(OF_MISFIT, messages.usable_within(error[worst], worst))


def within_unseen(
    codes: tuple[str, ...],
    fitted: Sequence[float],
    unseen: Sequence[float],
    which: str,
) -> Amendment | None:
    """Return a law's new rating by its errors on tests that were not fitted: usable or failed.

    It applies where findings rate the law usable. Errors are relative to the rms of their tests. If
    their rms exceeds that of the fitted errors by more than a factor of 1.5, the amendment rates
    the law failed.

    Args:
        codes: Codes of the findings that quote the errors.
        fitted: Relative errors of the tests when they are fitted.
        unseen: Relative errors of tests predicted by a fit without them; without any, the result is
            None.
        which: Name of these tests in the sentence, such as "held-out tests".
    """
    if not len(fitted) or not len(unseen):
        return None
    fitted_error, beyond = rms(fitted), rms(unseen)
    holds = beyond <= MOST_BEYOND * fitted_error
    comparison = "" if holds else messages.worse_than_fitted(MOST_BEYOND)
    sentence = messages.unseen_errors(which, beyond, fitted_error, comparison)
    status, remedy = ("usable", "") if holds else ("failed", messages.FIT_MISSED)
    return Amendment(codes, "usable", status, sentence, remedy)


def repeatability_finding(error: Mapping[str, float], data: Dataset) -> Finding | None:
    """Compare the largest fit error of a data group with the variation between its repeats.

    If the error exceeds the scatter, another repeat predicts a record better than the law does.
    """
    scatter = repeatability(data)
    ratio = {label: error[label] / max(x, TINY) for label, x in scatter.items()}
    if not ratio:
        return None
    worst = max(ratio, key=lambda label: np.nan_to_num(ratio[label], nan=np.inf))
    values = {
        "count": len(ratio), "test": worst, "error": error[worst], "scatter": scatter[worst]
    }  # fmt: skip
    remedy = {"another_law": another_law(data.laws)}
    return checked("repeatability", ratio[worst] <= 1, values, ratio[worst], remedy)
