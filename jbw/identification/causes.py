r"""Misfits that name their cause: what the law leaves, tried against what usually goes wrong.

A suspect changes the data by columns D about the fit, beside the parameters' own J. One
Gauss-Newton step with both, and one without, say how much of the misfit it would explain:

$$\min_{\Delta\theta, c} |r + J\,\Delta\theta - D\,c|^2, \qquad
  1 - \frac{|r + J\,\Delta\theta - D\,c|^2}{|r + J\,\Delta\theta|^2}$$
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jbw.identification.suspects import (
    DRIVEN,
    FACTOR,
    Spectra,
    Suspect,
    as_columns,
    factor_words,
    modes_anywhere,
    modes_at,
    suspects,
)
from jbw.inference.fit.fitting import Fit
from jbw.inference.posterior.finding import Finding
from jbw.observables.dataset import Dataset, by_label, left_by_label
from jbw.observables.drives import plain
from jbw.observables.effective_values import LEAST_VALUES, is_coloured
from jbw.observables.line_fit import oscillator_through
from jbw.observables.observable import OFFSETS
from jbw.observables.records import NEAR_PEAK
from jbw.observables.spectra import Spectrum

MOSTLY = 0.5  # of the misfit: a cause that explains more of it is a finding
WORTH_SAYING = 0.1
MOST_SAID = 3
LEAST_LINES = 6  # near a resonance, from which the gain of a group alone is read
FAR_OFF = 3.0  # times another gain: a wrong unit or sign and no joint's softening
BY_CHANCE = 2.0  # standard deviations of repeats that noise leaves of the mean of a short group


class Cause(NamedTuple):
    """What might be wrong, the share of the misfit that it would explain, and what to do."""

    text: str
    explained: float
    action: str
    mode: tuple[float, float, float] | None = None  # omega [rad/s], zeta and residue, if it is one


class Linearised(NamedTuple):
    """A fit's residual about its optimum, each group tried in units of the root mean square left.

    Attributes:
        places: Rows of each group that is tried.
        weight: Of each of them.
        left: Residual of all groups, nothing left along `basis`.
        basis: Orthonormal directions of the parameters.
        counted: Of every row, what makes it relative to its group's size; zero unless missed.
    """

    places: Mapping[str, slice]
    weight: Mapping[str, float]
    left: NDArray[np.float64]
    basis: NDArray[np.float64]
    counted: NDArray[np.float64]


def causes(best: Fit, data: Dataset) -> list[Cause]:
    """What would explain the misfit of a fit, most of it first; nothing where none is seen."""
    spectra = _spectra(best, data)
    missed = _missed(spectra, data)
    if not missed:
        return []
    about = _linearised(best, data, spectra, missed)
    columns = zip(best.theta, best.jacobian.T, strict=True)
    # Of drives side by side a row knows one of them.
    of_offset: dict[str, Any] = {}
    for name, x in columns:
        of_offset[plain(name)] = of_offset.get(plain(name), 0.0) + x
    slopes = {n: left_by_label(x, data) for n, x in of_offset.items() if n in OFFSETS}
    theta = {name: float(x) for name, x in {**data.held, **best.theta}.items()}
    tried = [(one.kind, _tried(one, about)) for one in suspects(spectra, slopes, theta["omega_n"])]
    if apart := _apart(spectra, missed):  # which a step from a fit near none would only guess
        tried = [(kind, one) for kind, one in tried if not kind.startswith(FACTOR)]
    tried += [(one.text, one) for one in [*apart, *_swapped(spectra, missed, theta)]]
    # Of a kind the best: of another mode's frequencies, for one.
    tried.sort(key=lambda pair: pair[1].explained)
    found = {kind: one for kind, one in tried if one.explained > WORTH_SAYING}
    return sorted(found.values(), key=lambda one: -one.explained)


def other_mode(best: Fit, data: Dataset, places: Iterable[float] = ()) -> Cause | None:
    """The mode that would explain most of a misfit, at some frequencies [rad/s] or anywhere.

    None where no misfit is seen of what responses there are.
    """
    spectra = _spectra(best, data)
    missed = _missed(spectra, data)
    if not missed:
        return None
    about = _linearised(best, data, spectra, missed)
    omega_n = float({**data.held, **best.theta}["omega_n"])
    tried = [*modes_at(spectra, places)] or [*modes_anywhere(spectra, omega_n)]
    found = [_tried(one, about) for one in tried]
    return max(found, key=lambda one: one.explained, default=None)


def _spectra(best: Fit, data: Dataset) -> dict[str, Spectrum]:
    """Spectra of every group whose misfit can be tried, by label."""
    left = left_by_label(best.residual, data)
    return {
        label: one._replace(source_role="force" if part.drive == "force" else "input")
        for part in data.parts
        for label, one in part.spectra(left).items()
    }


def cause_finding(found: Sequence[Cause]) -> Finding | None:
    """The first of causes, where it explains most of the misfit."""
    if not found or found[0].explained < MOSTLY:
        return None
    first = found[0]
    reason = (
        f"{first.text[0].upper()}{first.text[1:]} would explain {first.explained:.0%} of what the "
        "fit leaves."
    )
    return Finding("cause", "failed", reason, first.explained, first.action)


def causes_sentence(found: Sequence[Cause]) -> str:
    """What would explain the misfit, in words."""
    each = [f"{one.explained:.0%} {one.text}" for one in found[:MOST_SAID]]
    return f"Of what the fit leaves would explain, each alone: {'; '.join(each)}."


def _missed(spectra: Spectra, data: Dataset) -> list[str]:
    """Groups of which more is left than noise: a coloured residual, of few values a large one."""
    scatter = {label: x for part in data.parts for label, x in part.repeatability().items()}
    found = []
    for label, one in spectra.items():
        error = np.linalg.norm(one.left) / np.linalg.norm(one.values)
        is_short = len(one.left) < 2 * LEAST_VALUES
        if error > BY_CHANCE * scatter.get(label, np.inf) if is_short else is_coloured(one.left):
            found.append(label)
    return found


def _linearised(best: Fit, data: Dataset, spectra: Spectra, missed: Sequence[str]) -> Linearised:
    """All groups about the optimum: those that are tried first, then the others as fitted."""
    slopes = [left_by_label(column, data) for column in best.jacobian.T]
    fitted, slope = by_label(best.residual, data), by_label(best.jacobian, data)
    places, weight, rows, columns, counted, end = {}, {}, [], [], [], 0
    for label, one in spectra.items():
        left = as_columns(one.left)[:, 0]
        weight[label] = 1 / np.sqrt(np.mean(left**2))
        rows.append(weight[label] * left)
        columns.append(weight[label] * as_columns(*(each[label] for each in slopes)))
        size = np.linalg.norm(one.values) if label in missed else np.inf
        counted.append(np.full(len(left), 1 / (weight[label] * size)))
        places[label] = slice(end, end + len(left))
        end += len(left)
    for label in (each for each in data.layout if each not in spectra):
        rows.append(fitted[label])
        columns.append(slope[label])
        counted.append(np.zeros(len(fitted[label])))
    basis, residual = np.linalg.qr(np.concatenate(columns))[0], np.concatenate(rows)
    residual -= basis @ (basis.T @ residual)
    return Linearised(places, weight, residual, basis, np.concatenate(counted))


def _tried(suspect: Suspect, about: Linearised) -> Cause:
    """One step along a suspect's columns, and what it explains."""
    wide = next(iter(suspect.columns.values())).shape[1]
    columns = np.zeros((len(about.left), wide))
    for label, own in suspect.columns.items():
        columns[about.places[label]] = about.weight[label] * own
    columns -= about.basis @ (about.basis.T @ columns)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    found = np.linalg.lstsq(columns / scale, about.left)[0] / scale
    before, after = (
        np.sum((about.counted * left) ** 2) for left in (about.left, about.left - columns @ found)
    )
    text, action = suspect.words(found)
    mode = None if suspect.mode is None else (*suspect.mode, float(found[0]))
    return Cause(text, float(1 - after / before), action, mode)


def _apart(spectra: Spectra, missed: Sequence[str]) -> list[Cause]:
    """A group whose own gain has another sign or size: then no fit of all need be near any."""
    found = {label: _alone(one) for label, one in spectra.items()}
    alone = {label: one for label, one in found.items() if one is not None}
    missed = [label for label in missed if label in alone]
    if len(alone) < 2 or not missed:
        return []
    # Beside the median of the others, by sign and size; of two, which is wrong cannot be told.
    ratios = {
        label: gain / np.median([other for n, (other, _) in alone.items() if n != label])
        for label, (gain, _) in alone.items()
    }
    label = max(ratios, key=lambda n: abs(np.log(abs(ratios[n]))) + FAR_OFF * (ratios[n] < 0))
    if 1 / FAR_OFF < ratios[label] < FAR_OFF:
        return []
    now = {n: np.linalg.norm(spectra[n].left) / np.linalg.norm(spectra[n].values) for n in missed}
    explained = 1 - sum(alone[n][1] ** 2 for n in missed) / sum(x**2 for x in now.values())
    text, action = factor_words(label, ratios[label], spectra[label].source_role)
    return [Cause(text, float(explained), action)]


def _alone(one: Spectrum) -> tuple[float, float] | None:
    """Gain of the linear oscillator of one group alone, and what that leaves, relative."""
    x = np.divide(one.measured, one.factor, out=np.zeros_like(one.factor), where=one.factor != 0)
    driven = np.abs(one.source) > DRIVEN * np.abs(one.source).max()
    near = driven & (np.abs(x) > NEAR_PEAK * np.abs(x[driven]).max(initial=0.0))
    if near.sum() < LEAST_LINES:
        return None
    own = oscillator_through(one.omega[near], one.source[near], x[near])
    made = own["gain"] * one.factor * one.source / stiffness(own, one.omega)
    return own["gain"], float(np.linalg.norm(one.measured - made) / np.linalg.norm(one.measured))


def stiffness(mode: Mapping[str, float], omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    r"""Dynamic stiffness of a mode, $\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega$."""
    return mode["omega_n"] ** 2 - omega**2 + 2j * mode["zeta"] * mode["omega_n"] * omega


def _swapped(spectra: Spectra, missed: Sequence[str], theta: Mapping[str, float]) -> list[Cause]:
    """Groups whose input is what the mode makes of their response."""
    found = []
    for label in missed:
        one = spectra[label]
        made = one.factor * one.measured / stiffness(theta, one.omega)
        along = np.vdot(made, one.source).real / np.vdot(made, made).real
        left = np.linalg.norm(one.source - along * made) / np.linalg.norm(one.source)
        now = np.linalg.norm(one.left) / np.linalg.norm(one.values)
        if along != 0:
            text = f"{label} with input and response swapped"
            found.append(
                Cause(text, float(1 - (left / now) ** 2), f"Swap the channels of {label}.")
            )
    return found
