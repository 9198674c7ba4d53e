r"""Prediction of each kind of test (decays, sweeps, loops) from a fit to the other kinds.

A wrong law may fit sweeps with parameters that a decay does not constrain. So the fit is repeated
without all tests of one kind, which it then predicts with the relative error

$$e_k = \frac{\lVert d_k - m_k(\hat\theta_{-k}) \rVert}{\lVert d_k \rVert}$$

The result names parameters that the other tests do not determine. A large error may then be due to
the lack of tests as well as to the law.
"""

from typing import Any

import numpy as np
import xarray as xr

from jbw.identification.held_out import held_out
from jbw.identification.leaving_out import identified_alone
from jbw.identification.run_effects import errors_with_own_frequency
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.measurement.channels import rms
from jbw.observables.dataset import Dataset, measured_parts
from jbw.report.messages import residuals as messages
from jbw.report.messages import stages
from jbw.results.attributes import StoredErrors

WORDS = {
    "sweep": "sweeps and multisines", "tones": "tones and curves", "loop": "loops",
    "decay": "decays",
}  # fmt: skip


def kinds_of(data: Dataset) -> dict[str, tuple[str, ...]]:
    """Return the labels of the fitted data groups, by kind of test."""
    labels: dict[str, list[str]] = {}
    for part in measured_parts(data):
        kind = WORDS.get(part.kinds[0], part.kinds[0])
        labels.setdefault(kind, []).extend(part.groups.labels)
    return {kind: tuple(of_kind) for kind, of_kind in labels.items()}


def across_kinds(best: Fit, prior: Box, data: Dataset) -> xr.Dataset | None:
    """Predict each kind of test from the other kinds; return the errors, or None for one kind."""
    kinds = kinds_of(data)
    if len(kinds) < 2:
        return None
    as_fitted = errors_with_own_frequency(best, prior, data)
    error, fitted, wider = [], [], []
    for piece in held_out(kinds, best, prior, data, stages.WITHOUT_KIND).values():
        predicted = errors_with_own_frequency(piece.fit, prior, data)
        error.append(rms([predicted[label] for label in piece.labels]))
        fitted.append(rms([as_fitted[label] for label in piece.labels]))
        wider.append(np.sqrt(np.diag(piece.fit.covariance) / np.diag(best.covariance)))
    return xr.Dataset(
        {
            "error": ("kind", error, {"units": "1", "long_name": messages.ERROR_FROM_REST}),
            "fitted": ("kind", fitted, {"units": "1", "long_name": "error as fitted"}),
            "wider": (
                ("kind", "parameter"), wider,
                {"units": "1", "long_name": messages.SD_RATIO},
            ),
        },
        {"kind": list(kinds), "parameter": list(best.theta)},
        {"own_frequency": int(data.has_offsets)},
    )  # fmt: skip


def across_kinds_sentence(predicted: xr.Dataset) -> str:
    """Return the sentence on how well each kind of test is predicted from the others."""
    kinds = across_kinds_record(predicted)
    errors = {kind: (row["error"], row["fitted"]) for kind, row in kinds.items()}
    identified = {kind: row["rests_on"] for kind, row in kinds.items()}
    own_frequency = StoredErrors.of(predicted).own_frequency
    return messages.across_kinds(errors, identified, own_frequency=own_frequency)


def across_kinds_record(predicted: xr.Dataset) -> dict[str, dict[str, Any]]:
    """Return the prediction error of each kind of test from the other kinds, as plain values."""
    needed = identified_alone(predicted["wider"])
    return {
        str(kind): {
            "error": float(predicted["error"].sel(kind=kind)),
            "fitted": float(predicted["fitted"].sel(kind=kind)),
            "rests_on": needed[str(kind)],
        }
        for kind in predicted["kind"].values
    }
