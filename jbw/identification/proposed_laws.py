r"""The choice of a law from measured frequency and damping, if a campaign states none.

The exponents with which frequency and damping depend on amplitude propose laws before anything is
fitted. If there are several proposals, the steady loops of each, and of Bouc-Wen, are fitted to the
readings, with the covariance C of their errors. The chosen law has the largest score

$$-r^T C^{-1} r - k \ln n$$

with residual r, k parameters and n readings.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from jbw.errors import JbwError
from jbw.freeform.rows import rows_of
from jbw.identification.assemble import Measured, Report
from jbw.identification.coordinates import joint_box
from jbw.identification.curve_fit import fit_curve, rows_with_errors
from jbw.measurement.readings.statement import RecordTable, trend
from jbw.oscillator.parameters import Scales
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import laws as messages

LEAST_DAMPING = 1e-4  # smallest damping ratio for the scale of a prior


def proposed(
    seen: Measured, tables: Sequence[RecordTable], read: Sequence[str], seed: int, report: Report
) -> tuple[Measured, str]:
    """Choose the law that fits frequency and damping best; return tests under it, and why.

    Args:
        seen: Tests under the default law.
        tables: Readings of the fitted records.
        read: Laws that the readings propose, the simplest first. The simplest is chosen if there
            are too few readings to compare.
        seed: Random seed.
        report: Function that is called with one sentence at every stage.
    """
    scores: dict[str, float] = {}
    if len(read) > 1:  # Bouc-Wen's law may fit as well as laws of sliders
        scores = scores_of(seen, tables, list(dict.fromkeys([*read, *DEFAULT_LAWS])), seed)
    order = sorted(scores, key=scores.__getitem__, reverse=True) or [read[0]]
    margins = [(name, scores[order[0]] - scores[name]) for name in order[1:]]
    report(sentence := messages.chosen_by_reading(order[0], margins))
    return replace(seen, laws=(order[0],)), sentence


def scores_of(
    seen: Measured, tables: Sequence[RecordTable], laws: Sequence[str], seed: int
) -> dict[str, float]:
    """Return the score of each law that can be fitted to frequency and damping."""
    try:
        rows = rows_of(tables)
    except JbwError:
        return {}
    omega_n, zeta = 2 * np.pi * trend(tables, "hz").at_rest, trend(tables, "zeta").at_rest
    scales = Scales(omega_n, max(zeta, LEAST_DAMPING), float(rows.y.max()))
    white, scores = rows_with_errors(rows), dict[str, float]()
    for law in laws:
        prior = joint_box(seen.settings, scales, None, (law,), linear=False)
        try:
            best = fit_curve(jax.random.key(seed), (law,), prior, white)
        except JbwError:  # the law has no steady loop at any start
            continue
        chi_square, _ = best.chi_square
        scores[law] = -chi_square - len(best.x) * float(np.log(len(best.residual)))
    return scores
