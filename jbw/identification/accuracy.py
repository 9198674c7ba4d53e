"""The checks that the verdict needs in addition to the chains: solver error, coloured residuals."""

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
from jbw.observables.dataset import Dataset, by_label, halved, log_likelihood
from jbw.observables.effective_values import LEAST_VALUES, coloured_from, correlation_at_one
from jbw.observables.noise import num_known, repeatability
from jbw.report.messages import residuals as messages
from jbw.report.messages.remedies import OTHER_LAWS, beside_other_laws

SHIFT = 0.1  # of a posterior standard deviation: what the solver may move a posterior mean
NUM_DRAWS = 32
CLOSE = 0.05  # of every test: a law that leaves no more may be used within it
OF_MISFIT = ("coloured_residual", "repeatability", "chi_square")  # findings that this may qualify
MOST_BEYOND = 1.5  # times the fitted error: what tests that were not fitted may be missed by
TINY = np.finfo(float).tiny


def solver_finding(posterior: xr.Dataset, data: Dataset) -> Finding | None:
    r"""Check whether the solver's step could have moved the posterior; None without a solver.

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
    """Return the most steps of the solver between two samples."""
    return max((part.substeps or 1 for part in data.parts), default=1)


def another_law(laws: Sequence[str]) -> str:
    """Return the line to paste that adds a cubic spring; if the laws have one, name other laws."""
    if SPRING in laws:
        return OTHER_LAWS
    return beside_other_laws(put("joint", "laws", [*laws, SPRING]))


def solver_change(
    theta: Mapping[str, Float[np.ndarray, "..."]], data: Dataset
) -> NDArray[np.float64] | None:
    """Return draws' change of log likelihood with half the solver step; None without a solver."""
    finer = halved(data)
    if finer is None:
        return None
    terms = (at_points(log_likelihood, theta, discretised) for discretised in (finer, data))
    fine, coarse = (term.sum(axis=1) for term in terms)
    return fine - coarse


def thinned(
    posterior: xr.Dataset, names: tuple[str, ...] | None = None, num_draws: int = NUM_DRAWS
) -> dict[str, np.ndarray]:
    """Return a few draws of the parameters, evenly spaced over all chains."""
    keep = evenly_spaced(posterior, num_draws)
    chosen = names or tuple(str(name) for name in posterior.data_vars)
    return {name: posterior[name].values.ravel()[keep] for name in chosen}


def residual_finding(
    residuals: Mapping[str, np.ndarray],
    counted: Mapping[str, float],
    error: Mapping[str, float],
    laws: Sequence[str] = (),
) -> Finding | None:
    """Return the largest lag-one correlation of what a fit leaves of a group of 16 values or more.

    By label: the `residuals`, the fraction of values `counted`, the relative `error`; `laws` are
    those fitted.
    """
    long = {label: row for label, row in residuals.items() if len(row) >= 2 * LEAST_VALUES}
    lag_one = {label: correlation_at_one(row) for label, row in long.items()}
    if not lag_one:
        return None
    # By what white noise of so many values reaches; one that cannot be had is the worst of all.
    ratio = {label: abs(value) / coloured_from(long[label]) for label, value in lag_one.items()}
    worst = max(ratio, key=lambda label: np.nan_to_num(ratio[label], nan=np.inf))
    coloured = sum(not value < 1 for value in ratio.values())
    values = {
        "coloured": coloured, "count": len(lag_one), "test": worst, "error": error[worst],
        "correlation": lag_one[worst], "counted": counted[worst],
    }  # fmt: skip
    remedy = {"another_law": another_law(laws)}
    return checked("coloured_residual", not coloured, values, lag_one[worst], remedy)


def shape_finding(error: Mapping[str, float], data: Dataset) -> Finding | None:
    """Check the group with the largest fit error relative to its limit; None without any limit."""
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
    """Return chi-square and degrees of freedom of a fit over groups with noise from repeats."""
    sizes = num_known(data)
    if sum(sizes.values()) <= len(first.x):  # as many parameters explain any data
        return None
    rows = by_label(first.residual, data)
    total = sum(float(np.sum(rows[label] ** 2)) for label in sizes)
    return total, int(sum(sizes.values())) - len(first.x)


def within_misfit(error: Mapping[str, float]) -> Amendment | None:
    """Return the amendment that rates a small misfit usable; None where the misfit is large.

    A law that leaves more than noise of long or precise records, but a few per cent of each, is
    wrong in what it leaves and right in the rest; the intervals have this in them.
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
    """Return the amendment that quotes errors of unseen tests where findings call the law usable.

    Errors are relative to the rms of their tests. Where they exceed the fitted ones by a factor of
    1.5 in rms, what was usable within the fitted error is not.

    Args:
        codes: Codes of the findings that quote them.
        fitted: Errors of the tests as they were fitted.
        unseen: Errors of tests as predicted by a fit without them; None follows where there are
            none.
        which: What these tests are, for the sentence: "held-out tests".
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
    """Compare the fit error of the worst group with the scatter of that group's repeats.

    A law that leaves more than they scatter predicts a record worse than its neighbour does.
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
