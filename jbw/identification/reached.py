"""Sentences on whether the motion reached thresholds of a law, such as macroslip."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jbw.inference.posterior.summary import QUANTILES
from jbw.oscillator.laws import laws_named
from jbw.report.messages import effects as messages


def threshold_sentences(
    theta: Mapping[str, Any], y_peak: float, laws: tuple[str, ...]
) -> list[str]:
    """Return sentences on whether the largest motion [m] exceeds thresholds of the laws.

    `theta` contains draws by name. A threshold that is not reached depends on the priors and is no
    result of the data.
    """
    if y_peak <= 0:
        return []
    sentences = []
    for law in laws_named(laws):
        thresholds = law.build(theta).thresholds()
        clauses = [
            f"{threshold.what} {_where(np.asarray(threshold.y), y_peak, threshold.rests)}"
            for threshold in thresholds
        ]
        sentences += [f"{law.name}: {'; '.join(clauses)}."] if clauses else []
    return sentences


def _where(y: Float[np.ndarray, "..."], y_peak: float, rests: str) -> str:
    low, middle, high = np.quantile(y, QUANTILES)
    return messages.threshold((low, middle, high), y_peak, rests)
