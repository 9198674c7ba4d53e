r"""The law of a campaign that states none, where its readings propose another one than Bouc-Wen.

What changes with amplitude by which power proposes laws before anything is fitted. Of several the
first are fitted beside Bouc-Wen to the same data with the same weights, and the one of the largest

$$2 \ln L_{max} - k \ln n$$

is taken, of k parameters and n values.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from jbw.identification.assemble import Measured, Report
from jbw.identification.evidence import Candidate, candidates, likelihood_at
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import laws as messages

MOST_TRIED = 3  # of the laws that the readings propose


def proposed(
    seen: Measured, read: Sequence[str], seed: int, report: Report
) -> tuple[Measured, str]:
    """Return the tests under the law that fits them best, and what to say of the choice.

    Args:
        seen: Tests under the default law.
        read: Laws that the readings propose, the simplest first.
        seed: Seed of everything random.
        report: Called with one sentence at every stage.

    Raises:
        ConfigError: None of the laws can be fitted.
    """
    tried = list(read[:MOST_TRIED])
    margins: list[tuple[str, float]] = []
    if len(tried) > 1:  # laws of sliders, of which Bouc-Wen may be as near as any
        sets = list(dict.fromkeys([*((name,) for name in tried), DEFAULT_LAWS]))
        found, _ = candidates(jax.random.key(seed), seen, sets, report)
        scores = {candidate.laws[0]: _score(candidate) for candidate in found}
        tried = sorted(scores, key=scores.__getitem__, reverse=True)
        margins = [(name, scores[tried[0]] - scores[name]) for name in tried[1:]]
    report(sentence := messages.chosen_by_reading(tried[0], margins))
    return replace(seen, laws=(tried[0],)), sentence


def _score(candidate: Candidate) -> float:
    """Return twice the maximum log likelihood minus the parameters' penalty (negative BIC)."""
    fit, data = candidate.fitted.fit, candidate.fitted.data
    return 2 * likelihood_at(fit, data) - len(fit.x) * float(np.log(len(fit.residual)))
