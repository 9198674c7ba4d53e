r"""Causes of misfit: which faults of records would explain the residual of a fit.

Every hypothesis of `measurement/faults` says by which columns D it changes the data near the
fit, in addition to the parameters' own J. One Gauss-Newton step with D, and one without, show how
much of the misfit it would explain.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.measurement.faults.hypotheses import HYPOTHESES
from jbw.measurement.faults.second_mode import SecondMode, modes_at
from jbw.measurement.faults.suspect import Cause, Misfit, Suspect, as_columns
from jbw.observables.dataset import Dataset, by_label, residual_by_label
from jbw.observables.drives import plain
from jbw.observables.effective_values import LEAST_VALUES, is_coloured
from jbw.observables.noise import repeatability
from jbw.observables.observable import OFFSETS
from jbw.report.messages import causes as messages

# A cause is reported as a finding if it explains at least this fraction of the misfit.
MOSTLY = 0.5
WORTH_SAYING = 0.1
MOST_SAID = 3
# largest error of a short data group that noise explains, in standard deviations of its repeats
BY_CHANCE = 2.0


Try = Callable[[Suspect | Cause], Cause]
"""Function that returns a suspected error as a cause, with the share of the misfit it explains."""


def causes(best: Fit, data: Dataset) -> list[Cause]:
    """Return likely causes of a fit's misfit, beginning with the one that explains most."""
    misfit = _misfit(best, data)
    if not misfit.missed:
        return []
    tried = _near_optimum(best, data, misfit)
    # Of each kind of cause, such as another mode, only the best candidate for each test is kept.
    best_of_kind: dict[tuple[str, str], Cause] = {}
    for hypothesis in HYPOTHESES:
        for suspect in hypothesis.suspects(misfit):
            cause = tried(suspect)
            kind = hypothesis.name, cause.label
            least = best_of_kind[kind].explained if kind in best_of_kind else WORTH_SAYING
            if cause.explained > least:
                best_of_kind[kind] = cause
    return sorted(best_of_kind.values(), key=lambda cause: -cause.explained)


def other_mode(best: Fit, data: Dataset, places: Iterable[float] = ()) -> Cause | None:
    """Return the additional mode that explains most of a misfit; search near `places` if given.

    `places` are the given frequencies [rad/s].

    None if no group with a spectrum has a misfit.
    """
    misfit = _misfit(best, data)
    if not misfit.missed:
        return None
    suspects = [*modes_at(misfit, places)] or SecondMode().suspects(misfit)
    found = map(_near_optimum(best, data, misfit), suspects)
    return max(found, key=lambda cause: cause.explained, default=None)


def _misfit(best: Fit, data: Dataset) -> Misfit:
    """Return a fit's residuals by group, and the groups whose residuals exceed their noise."""
    residuals = residual_by_label(best.residual, data)
    spectra = {
        label: spectrum._replace(source_role="force" if part.drive == "force" else "input")
        for part in data.parts
        for label, spectrum in part.shown().spectra(residuals).items()
    }
    # Each residual depends on the offset of only one drive, so that the drives' columns can be
    # added to one column.
    of_offset: dict[str, Any] = {}
    for name, x in zip(best.theta, best.jacobian.T, strict=True):
        if plain(name) in OFFSETS:
            of_offset[plain(name)] = of_offset.get(plain(name), 0.0) + x
    slopes = {name: residual_by_label(x, data) for name, x in of_offset.items()}
    theta = {name: float(x) for name, x in {**data.held, **best.theta}.items()}
    misfit, scatter = Misfit(spectra, (), theta, slopes), repeatability(data)

    def is_missed(label: str) -> bool:
        """Return whether a residual is correlated or, in a short data group, large."""
        residual = spectra[label].residual
        if len(residual) < 2 * LEAST_VALUES:
            return misfit.error(label) > BY_CHANCE * scatter.get(label, np.inf)
        return is_coloured(residual)

    return misfit._replace(missed=[label for label in spectra if is_missed(label)])


def cause_finding(found: Sequence[Cause]) -> Finding | None:
    """Return the finding on the most likely cause if it explains most of the misfit, or None."""
    if not found or found[0].explained < MOSTLY:
        return None
    text, share = found[0].text, found[0].explained
    values, remedy = {"text": text.what, "share": share}, {"action": text.remedy}
    return Finding("cause", "failed", values, share, remedy)


def causes_sentence(found: Sequence[Cause]) -> str:
    """Return the sentence on the likely causes of the misfit."""
    return messages.causes([(cause.explained, cause.text.what) for cause in found[:MOST_SAID]])


def _near_optimum(best: Fit, data: Dataset, misfit: Misfit) -> Try:
    """Return a function that computes how much misfit a suspected error explains near the optimum.

    The residuals of each group are scaled by their rms. Groups without a spectrum come last.
    """
    slopes = [residual_by_label(column, data) for column in best.jacobian.T]
    fitted, slope = by_label(best.residual, data), by_label(best.jacobian, data)
    places, weight, rows, directions, counted, end = {}, {}, [], [], [], 0
    for label, spectrum in misfit.spectra.items():
        group = as_columns(spectrum.residual)[:, 0]
        weight[label] = 1 / np.sqrt(np.mean(group**2))
        rows.append(weight[label] * group)
        directions.append(weight[label] * as_columns(*(column[label] for column in slopes)))
        # Divide residuals by the rms of their data groups; groups that the fit describes well do
        # not count.
        size = np.linalg.norm(spectrum.values) if label in misfit.missed else np.inf
        counted.append(np.full(len(group), 1 / (weight[label] * size)))
        places[label] = slice(end, end := end + len(group))
    others = [label for label in data.layout if label not in misfit.spectra]
    rows += [fitted[label] for label in others]
    directions += [slope[label] for label in others]
    counted += [np.zeros(len(fitted[label])) for label in others]
    basis, factor = np.linalg.qr(np.concatenate(directions))[0], np.concatenate(counted)

    def beyond(x: Any) -> Any:
        """Remove from columns their projection on the model's sensitivities to its parameters."""
        return x - basis @ (basis.T @ x)

    residual = beyond(np.concatenate(rows))
    before = np.sum((factor * residual) ** 2)

    def tried(suspect: Suspect | Cause) -> Cause:
        if isinstance(suspect, Cause):
            return suspect
        wide = next(iter(suspect.columns.values())).shape[1]
        columns = np.zeros((len(residual), wide))
        for label, group_columns in suspect.columns.items():
            columns[places[label]] = weight[label] * group_columns
        columns = beyond(columns)
        scale = np.linalg.norm(columns, axis=0)
        scale[scale == 0] = 1.0
        coefficients = np.linalg.lstsq(columns / scale, residual)[0] / scale
        after = np.sum((factor * (residual - columns @ coefficients)) ** 2)
        mode = None if suspect.mode is None else (*suspect.mode, float(coefficients[0]))
        text = suspect.text(coefficients)
        return Cause(text, float(1 - after / before), suspect.label, mode)

    return tried
