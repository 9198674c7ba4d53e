r"""Predict each kind of test from the others: does one joint make decays, sweeps and loops alike?

A law that is wrong may follow sweeps by parameters of which a decay knows nothing. So the fit is
repeated without all tests of one kind, and these are predicted by it,

$$e_k = \frac{\lVert d_k - m_k(\hat\theta_{-k}) \rVert}{\lVert d_k \rVert}$$

Parameters that the other tests do not identify are named: a large error then says as much of the
tests as of the law.
"""

import logging
from dataclasses import replace

import numpy as np
import xarray as xr

from jbw.identification.prepare import refit
from jbw.identification.run_effects import own_frequency_alone
from jbw.inference.fit.costly_fit import residual_at
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.observables.dataset import Dataset, left_by_label, size_by_label, stacked

under_way = logging.getLogger("jbw.progress")
WIDER = (
    5.0  # times its standard deviation by all tests: a parameter that rests on the kind left out
)
WORDS = {
    "sweep": "sweeps", "tones": "tones and curves", "loop": "loops", "decay": "decays",
}  # fmt: skip


def kinds_of(data: Dataset) -> dict[str, tuple[str, ...]]:
    """Labels of the groups of each kind of test of which a fit leaves a residual."""
    labels: dict[str, list[str]] = {}
    for part in data.parts:
        if part.sizes():
            kind = type(part).kinds[0]
            labels.setdefault(WORDS.get(kind, kind), []).extend(part.labels)
    return {kind: tuple(of_kind) for kind, of_kind in labels.items()}


def without_kind(kind: str, data: Dataset) -> Dataset:
    """The dataset in which the tests of one kind count for nothing, of the same shapes."""
    of_kind = set(kinds_of(data)[kind])
    parts = []
    for part in data.parts:
        if part.sizes() and of_kind >= set(part.labels):
            for run in dict.fromkeys(part.runs):
                part = part.silenced(run)
        parts.append(part)
    return replace(data, parts=tuple(parts))


def across_kinds(best: Fit, prior: Box, data: Dataset) -> xr.Dataset | None:
    """Error of every kind of test as the others predict it; None of fewer than two kinds."""
    kinds = kinds_of(data)
    if len(kinds) < 2:
        return None
    error, fitted, wider = [], [], []
    for number, (kind, labels) in enumerate(kinds.items(), start=1):
        under_way.info("fit without kind %d of %d", number, len(kinds))
        rest = without_kind(kind, data)
        fit = refit(best, prior, rest)
        error.append(_error(labels, fit, prior, data))
        fitted.append(_error(labels, best, prior, data))
        wider.append(np.sqrt(np.diag(fit.covariance) / np.diag(best.covariance)))
    return xr.Dataset(
        {
            "error": ("kind", error, {"units": "1", "long_name": "error predicted from the rest"}),
            "fitted": ("kind", fitted, {"units": "1", "long_name": "error as fitted"}),
            "wider": (
                ("kind", "parameter"), wider,
                {"units": "1", "long_name": "sd without the kind over that with it"},
            ),
        },
        {"kind": list(kinds), "parameter": list(best.theta)},
        {"own_frequency": int(data.has_offsets)},
    )  # fmt: skip


def _error(labels: tuple[str, ...], fit: Fit, prior: Box, data: Dataset) -> float:
    """RMS error of some groups at a fit, each over the rms of its own."""
    scored = own_frequency_alone(data)
    residual = left_by_label(residual_at(stacked, fit.x, prior, scored), scored)
    sizes = size_by_label(data)
    errors = [np.linalg.norm(residual[label]) / sizes[label] for label in labels if label in sizes]
    return float(np.sqrt(np.mean(np.square(errors))))


def rests_on(found: xr.Dataset) -> dict[str, list[str]]:
    """By kind the parameters that only its tests identify."""
    return {
        str(kind): [str(name) for name, x in zip(found["parameter"].values, row, strict=True)
                    if not x < WIDER]
        for kind, row in zip(found["kind"].values, found["wider"].values, strict=True)
    }  # fmt: skip


def across_kinds_sentence(found: xr.Dataset) -> str:
    """How well each kind of test is predicted from the others, in words."""
    errors = [
        f"{kind} {100 * error:.2g} % ({100 * fitted:.2g} % as fitted)"
        for kind, error, fitted in zip(
            found["kind"].values, found["error"].values, found["fitted"].values, strict=True
        )
    ]
    given = " and their own natural frequency" if found.attrs["own_frequency"] else ""
    sentence = f"RMS error of each kind of test, predicted from the other kinds{given}: "
    needed = [
        f"{', '.join(names)} by {kind} alone" for kind, names in rests_on(found).items() if names
    ]
    known_by = f" Identified: {'; '.join(needed)}." if needed else ""
    return f"{sentence}{'; '.join(errors)}.{known_by}"


def across_kinds_record(found: xr.Dataset) -> dict[str, dict[str, object]]:
    """The same in plain values, by kind."""
    needed = rests_on(found)
    return {
        str(kind): {
            "error": float(found["error"].sel(kind=kind)),
            "fitted": float(found["fitted"].sel(kind=kind)),
            "rests_on": needed[str(kind)],
        }
        for kind in found["kind"].values
    }
