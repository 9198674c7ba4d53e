r"""Consistency of runs, records and modes: fits without each run, and of each record alone.

If the law of the joint is wrong, or runs shift, each level needs different parameters, and the fit
of all is a compromise with a narrow interval. So the fit is repeated without each run, and its
change is compared with what chance allows,

$$z = \frac{\hat\theta_{-r} - \hat\theta}{\sqrt{\sigma_{-r}^2 - \sigma^2}}, \qquad
  |\hat\theta_{-r} - \hat\theta| \le \sigma_{-r} \sqrt{\chi^2_{-r}(\hat\theta) -
  \chi^2_{-r}(\hat\theta_{-r})}$$

A change is limited by the gain of the other runs: along a curved direction that none of them
determines, a fit moves far without gain.

A slightly wrong law needs different products at different amplitudes, but a posterior of all
records is as narrow as if they agreed. So every free decay is fitted alone, and the scatter $\tau$
between them is that of Paule and Mandel (1982): for relative estimates $q_i$ with errors $s_i$,

$$\sum_i \frac{(q_i - \bar q)^2}{s_i^2 + \tau^2} = n - 1, \qquad
  \bar q = \frac{\sum q_i / (s_i^2 + \tau^2)}{\sum 1 / (s_i^2 + \tau^2)}$$

with $\tau = 0$ where the sum is smaller already. The mean of n records is then determined to
$\sqrt{\sigma^2 + \tau^2 / n}$ only.

One scalar joint has one softening and one loss for all modes, up to a factor per mode. The model of
one joint is rejected for a mode that a separate joint fits clearly better, with the other modes
filtered out.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import root_scalar

from jbw.campaign.settings import Identify
from jbw.identification.accuracy import another_law
from jbw.identification.coordinates import box_of
from jbw.identification.curve_fit import from_amplitude_curve
from jbw.identification.first_fit import middle_but, rough
from jbw.identification.held_out import HeldOut, held_out, labels_by_run
from jbw.identification.run_effects import errors_with_own_frequency
from jbw.inference.fit.costly_fit import residual_at
from jbw.inference.fit.fitting import Fit, to_first_order
from jbw.inference.posterior.finding import Finding, checked
from jbw.inference.space.box import Box
from jbw.observables.dataset import (
    Dataset,
    as_arrays,
    measured_parts,
    residual_by_label,
    size_by_label,
    stacked,
)
from jbw.observables.decay import Decays, matched
from jbw.observables.decay_envelopes import NUM_OWN
from jbw.observables.drives import of_drive
from jbw.observables.effective_values import correlated_fraction
from jbw.observables.modal_decays import errors_by_mode
from jbw.observables.noise import fractions_counted
from jbw.oscillator.laws import laws_named
from jbw.quantities import are_at_joints
from jbw.report.messages import modes, stages
from jbw.report.messages import residuals as messages
from jbw.results.attributes import StoredErrors

# fits without some runs, by the names of these runs
FitsWithout = Mapping[tuple[str, ...], HeldOut]
# Runs contradict each other if a parameter changes by this many standard deviations when one of
# them is omitted.
MOVES = 4.0
# A parameter depends on a test if its standard deviation from a fit without the test is this many
# times the standard deviation from the fit to all tests.
WIDER = 5.0
# A parameter's change is tested if the omitted run reduces its variance by at least this fraction.
LEAST_GAIN = 0.01
FEWEST = 3  # smallest number of records for which their variation is computed
BY_CHANCE = 0.01  # probability of so large a variation by chance, if records agree
MATTERS = 1.2  # The variation is not reported if it widens the interval by less than this factor.
REACH = float(stats.norm.isf(0.005))  # half-width of a 99 % interval in standard deviations
# Separate joints are clearly better than a common joint if, with the common joint, a mode's error
# is this many times the error with a separate joint.
CLEARLY = 1.25


def fits_without_each_run(best: Fit, prior: Box, data: Dataset) -> FitsWithout:
    """Repeat the fit without each run in turn; return nothing for fewer than two runs.

    Runs consist of records, harmonics or loops. Free decays are left out only if there are no other
    tests, in three groups from the weakest third to the strongest: a record without a similar one
    would not test other amplitudes.
    """
    decays_alone = all(part.own_shifts for part in data.parts)
    parts = [p for p in measured_parts(data) if decays_alone or not p.own_shifts]
    runs = tuple(dict.fromkeys(run for part in parts for run in part.groups.runs))
    groups = _thirds(data) if decays_alone else [(run,) for run in runs]
    if len(groups) < 2:
        return {}
    labels = labels_by_run(data)
    pieces = {group: [label for run in group for label in labels[run]] for group in groups}
    return held_out(pieces, best, prior, data, stages.WITHOUT_RUN)


def _thirds(data: Dataset) -> list[tuple[str, ...]]:
    """Return the run names of free decays, divided into three groups from weak to strong."""
    sizes = {run: y for part in data.parts for run, y in part.shown().begins.items()}
    order = sorted(sizes, key=lambda run: sizes[run])
    parts = np.array_split(np.arange(len(order)), min(len(order), 3))
    return [tuple(order[i] for i in part) for part in parts]


def leave_one_out(
    best: Fit, prior: Box, data: Dataset, without_each: FitsWithout
) -> xr.Dataset | None:
    """Compare, for each run, the fit without this run with the fit to all runs.

    `without_each` comes from `fits_without_each_run`. `z` is NaN where a run adds nothing; `error`
    is that of a run predicted by the fit without it. At least two runs must remain, so that no fit
    is of one level alone: None with fewer than two such runs, fewer than three runs in all, or free
    decays alone.
    """
    decays_alone = all(part.own_shifts for part in data.parts)
    if decays_alone or len(without_each) < 2 or len(set(data.runs)) < 3:
        return None
    runs, pieces = [run for (run,) in without_each], list(without_each.values())
    fits = [piece.fit for piece in pieces]
    growth = np.array([_gained(best, piece, prior) for piece in pieces])
    estimate = np.array([list(fit.theta.values()) for fit in fits])
    std = np.array([np.sqrt(np.diag(fit.covariance)) for fit in fits])
    variance = np.diag(best.covariance)
    gained = std**2 - variance
    is_gained = gained > LEAST_GAIN * variance
    change = estimate - np.array(list(best.theta.values()))
    most = np.sqrt(growth)[:, None] * std
    z = np.clip(change, -most, most) / np.sqrt(np.where(is_gained, gained, np.nan))
    sizes, as_fitted = size_by_label(data), errors_with_own_frequency(best, prior, data)
    predicted = [errors_with_own_frequency(fit, prior, data) for fit in fits]
    error = [_error(x.labels, row, sizes) for x, row in zip(pieces, predicted, strict=True)]
    fitted = [_error(piece.labels, as_fitted, sizes) for piece in pieces]
    dims = ("run", "parameter")
    return xr.Dataset(
        {
            "estimate": (dims, estimate, {"long_name": "optimum without the run"}),
            "std": (dims, std, {"long_name": "its standard deviation"}),
            "error": (
                "run",
                error,
                {
                    "units": "1",
                    "long_name": "error without the run",
                    "own_frequency": int(data.has_offsets),
                },
            ),
            "fitted": ("run", fitted, {"units": "1", "long_name": "error with it"}),
            "z": (dims, z, {"units": "1", "long_name": messages.Z_SCORE}),
            "wider": (
                dims,
                std / np.sqrt(variance),
                {"units": "1", "long_name": messages.WIDER_WITHOUT},
            ),
        },
        {"run": list(runs), "parameter": list(best.theta)},
    )


def _gained(best: Fit, piece: HeldOut, prior: Box) -> float:
    """Return how much the other runs' chi-square falls if one run is held out of the fit."""
    before = float(np.sum(residual_at(stacked, best.x, prior, piece.rest) ** 2))
    return max(before - 2 * piece.fit.cost, 0.0)


def _error(labels: Sequence[str], errors: Mapping[str, float], sizes: Mapping[str, float]) -> float:
    """Return the relative error of several data groups, computed over all their values together."""
    sized = [label for label in labels if label in sizes]
    size = np.array([sizes[label] for label in sized])
    missed = size * [errors[label] for label in sized]
    return float(np.linalg.norm(missed) / np.linalg.norm(size))


def left_out_sentence(left_out: xr.Dataset) -> str:
    """Return the sentence on how well each run is predicted from the others."""
    of_runs = left_out["error"]
    errors = [f"{error.run.item()} {100 * error.item():.2g} %" for error in of_runs]
    proviso = messages.WITH_FREQUENCY * StoredErrors.of(of_runs).own_frequency
    return messages.each_session(proviso, errors, identified_alone(left_out["wider"]))


def identified_alone(wider: xr.DataArray) -> dict[str, list[str]]:
    """Return, for each test, the parameters that no other test determines.

    `wider` contains the standard deviations without the test over those with it.
    """
    left_out, parameters = (wider[str(dim)].values.tolist() for dim in wider.dims)
    return {
        name: [parameter for parameter, x in zip(parameters, row, strict=True) if not x < WIDER]
        for name, row in zip(left_out, wider.values, strict=True)
    }


def consistency_finding(left_out: xr.Dataset, laws: Sequence[str] = ()) -> Finding:
    """Return the finding on whether runs agree, from the largest |change| / sd of a parameter."""
    size = abs(left_out["z"])
    if size.isnull().all():
        return Finding("leave_one_out", "ok", {}, float("nan"), entry="leave_one_out.none")
    worst = size[size.argmax(...)]
    values = {
        "test": worst.run.item(), "name": worst.parameter.item(), "moves": worst.item(),
        "limit": MOVES,
    }  # fmt: skip
    remedy = {"another_law": another_law(laws)}
    return checked("leave_one_out", worst.item() < MOVES, values, worst.item(), remedy)


def between_records(best: Fit, prior: Box, data: Dataset) -> xr.Dataset | None:
    """Fit every free decay by itself; return the estimates and their variation between records.

    The estimates are those of the laws' products and zeta, relative to the fit of all records.
    Their errors follow from each record's own residual. None if there is another kind of test
    (every such fit would share it), no law, or fewer than three records.
    """
    records = data.runs
    decays_alone = all(part.own_shifts for part in data.parts)
    if not (decays_alone and data.laws and len(records) >= FEWEST):
        return None
    together, error = _known(best, data)
    others = {label: [x for x in data.labels if x != label] for label in data.labels}
    alone = held_out(others, best, prior, data)
    fits = {label: piece.fit for label, piece in alone.items()}
    by_record = [_known(fitted, data) for fitted in fits.values()]
    names = list(together)
    size = np.abs(np.array([together[name] for name in names]))
    estimate = np.array([[values[name] for name in names] for values, _ in by_record])
    std = np.array([[errors[name] for name in names] for _, errors in by_record])
    std = std * _own_errors(fits, data)[:, None]
    scatter = [
        _scatter(*columns) for columns in zip((estimate / size).T, (std / size).T, strict=True)
    ]
    dims, relative = ("record", "quantity"), {"units": "1"}
    return xr.Dataset(
        {
            "estimate": (dims, estimate / size, {**relative, "long_name": "over that of all"}),
            "std": (dims, std / size, {**relative, "long_name": "its standard deviation"}),
            "std_of_all": ("quantity", [error[name] for name in names] / size, relative),
            "scatter": ("quantity", [tau for tau, _ in scatter], relative),
            "probability": ("quantity", [p for _, p in scatter], relative),
        },
        {"record": list(records), "quantity": names},
    )


def _own_errors(fits: Mapping[str, Fit], data: Dataset) -> NDArray[np.float64]:
    r"""Return each record's standard error from its own fit, divided by that from the common fit.

    $\sqrt{(\sigma_i^2 / f) / (\sigma^2 / f_{all})}$: the residual of one law for all records is
    misfit. Little of it remains for each record alone, and a larger fraction f of that is
    independent.
    """
    residuals = {
        record: residual_by_label(fit.residual, data)[record] for record, fit in fits.items()
    }
    fraction = correlated_fraction(list(residuals.values()))
    fraction_of_all = fractions_counted(data)
    noise_stds = np.concatenate([np.asarray(part.groups.noise_std) for part in data.parts])
    noise = dict(zip(data.labels, noise_stds, strict=True))
    ratios = []
    for record, fitted in fits.items():
        values = residuals[record]
        degrees = max(2 * len(values) - NUM_OWN - len(fitted.theta), 1)
        variance = float(np.sum(np.abs(values) ** 2)) / degrees
        ratios.append(variance / noise[record] ** 2 * fraction_of_all[record] / fraction)
    return np.sqrt(ratios)


def _known(fitted: Fit, data: Dataset) -> tuple[dict[str, float], dict[str, float]]:
    """Return zeta and the products of the laws' parameters at a fit, with standard deviations."""

    def quantities(point: Mapping[str, Array]) -> dict[str, Array]:
        theta = {**as_arrays(fitted.theta, data), **point}
        by_name = {"zeta": theta["zeta"]} if "zeta" in point else {}
        for law in laws_named(data.laws):
            parameters = law.build(theta).parameters()
            for product in law.products:
                by_name[product.quantity.name] = product.of({**theta, **parameters})
        return by_name

    return to_first_order(quantities, fitted)


def _scatter(
    estimate: Float[np.ndarray, " record"], std: Float[np.ndarray, " record"]
) -> tuple[float, float]:
    """Return the standard deviation between records beyond their errors, and its p-value."""
    degrees = len(estimate) - 1

    def beyond(variance: float) -> float:
        weight = 1 / (std**2 + variance)
        mean = np.sum(weight * estimate) / np.sum(weight)
        return float(np.sum(weight * (estimate - mean) ** 2)) - degrees

    # If the standard deviation is twice the range of the values, any difference between records is
    # possible.
    most = 4 * float(np.ptp(estimate)) ** 2
    variance = 0.0
    if beyond(0.0) > 0:
        variance = float(root_scalar(beyond, bracket=(0.0, most), rtol=1e-12).root)
    return float(np.sqrt(variance)), float(stats.chi2.sf(beyond(0.0) + degrees, degrees))


def between_finding(between: xr.Dataset) -> Finding:
    """Return the finding on whether records agree, from the largest relative variation."""
    count = between.sizes["record"]
    scatter, error = between["scatter"].values, between["std_of_all"].values
    wide = np.sqrt(error**2 + scatter**2 / count)
    names = [str(name) for name in between["quantity"].values]
    sure = between["probability"].values < BY_CHANCE / len(names)
    if not np.any(sure & (wide > MATTERS * error)):
        agreed = {"count": count, "names": names}
        return Finding("records_apart", "ok", agreed, 0.0)
    worst = int(np.argmax(np.where(sure, scatter, 0.0)))
    values = {
        "count": count,
        "name": names[worst],
        "scatter": float(scatter[worst]),
        "others": [
            (name, float(tau))
            for name, tau in zip(names, scatter, strict=True)
            if tau > 0 and name != names[worst]
        ],
        "within": float(REACH * error[worst]),
        "beyond": float(REACH * wide[worst]),
    }
    return Finding("records_apart", "usable", values, float(scatter[worst]))


def own_joint_sentences(key: Key[Array, ""], best: Fit, data: Dataset) -> list[str]:
    """Return sentences on whether the free decays of several modes reject a common joint."""
    # For several joints, this comparison has no meaning.
    if not data.laws or are_at_joints(data.laws):
        return []
    parts = [part for part in data.parts if part.several]
    return [_mode_sentence(key, best, part, data) for part in parts]


def _mode_sentence(key: Key[Array, ""], best: Fit, part: Any, data: Dataset) -> str:
    theta = of_drive(as_arrays(best.theta, data), part.drive)
    common = errors_by_mode(np.asarray(matched(theta, part).residual), part)
    own_errors = [error_alone(key, decays) for decays in part.alone]
    rows = zip(part.modes.hz, common, own_errors, strict=True)
    rejected = [(hz, shared, other) for hz, shared, other in rows if shared > CLEARLY * other]
    if not rejected:
        return modes.one_serves(CLEARLY)
    clauses = "; ".join(modes.left_by_joint(hz, shared, other) for hz, shared, other in rejected)
    return modes.rejected(clauses)


def error_alone(key: Key[Array, ""], decays: Decays) -> float:
    """Fit a separate joint to the decays of one mode; return the relative error of that fit."""
    data, estimates = Dataset.of([decays], {"gain": 1.0}), decays.shown().first_values()
    prior = box_of(Identify(), data, estimates)
    estimates = {**estimates, **from_amplitude_curve(key, data, prior, {})}
    best = rough(middle_but(estimates, prior), prior, data)
    residual = np.asarray(matched(as_arrays(best.theta, data), decays).residual)
    return float(np.linalg.norm(residual) / np.linalg.norm(np.asarray(decays.mean)))
