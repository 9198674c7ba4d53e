"""Does one joint serve all modes? What it leaves of each, beside a joint of that mode's own.

One scalar joint has one softening and one loss for all modes, up to a factor a mode. A mode that a
joint of its own follows clearly better, alone and with the others filtered out, does not obey it.
"""

from typing import Any

import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.coordinates import box_of
from jbw.identification.first_fit import from_amplitude_curve, middle_but, rough
from jbw.inference.fit.fitting import Fit
from jbw.observables.dataset import Dataset, as_arrays
from jbw.observables.decay import Decays, matched
from jbw.observables.drives import of_part
from jbw.observables.modal_decays import errors_by_mode
from jbw.quantities import are_at_joints
from jbw.report.messages import modes as messages

CLEARLY = 1.25  # times what its own joint leaves of a mode


def own_joint_sentences(key: Key[Array, ""], best: Fit, data: Dataset) -> list[str]:
    """Whether free decays reject one joint for all modes, a sentence for each part of the data."""
    if not data.laws or are_at_joints(data.laws):  # several joints are no question of one
        return []
    parts = [part for part in data.parts if part.several]
    return [_sentence(key, best, part, data) for part in parts]


def _sentence(key: Key[Array, ""], best: Fit, part: Any, data: Dataset) -> str:
    theta = of_part(as_arrays(best.theta, data), part)
    common = errors_by_mode(np.asarray(matched(theta, part).residual), part)
    own_errors = [error_alone(key, decays) for decays in part.alone]
    rows = zip(part.modes.hz, common, own_errors, strict=True)
    rejected = [(hz, shared, other) for hz, shared, other in rows if shared > CLEARLY * other]
    if not rejected:
        return messages.one_serves(CLEARLY)
    clauses = "; ".join(messages.left_by_joint(hz, shared, other) for hz, shared, other in rejected)
    return messages.rejected(clauses)


def error_alone(key: Key[Array, ""], decays: Decays) -> float:
    """What a joint of its own leaves of one mode's decays, over their size."""
    data, estimates = Dataset.of([decays], {"gain": 1.0}), decays.first_values()
    prior = box_of(Identify(), data, estimates)
    estimates = {**estimates, **from_amplitude_curve(key, data, prior, {})}
    best = rough(middle_but(estimates, prior), prior, data)
    residual = np.asarray(matched(as_arrays(best.theta, data), decays).residual)
    return float(np.linalg.norm(residual) / np.linalg.norm(np.asarray(decays.envelope)))
