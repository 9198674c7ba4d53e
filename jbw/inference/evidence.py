"""The evidence of independent runs, with its standard error."""

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp


def pooled_evidence(
    log_evidence: Float[np.ndarray, " run"], variance: Float[np.ndarray, " run"]
) -> dict[str, float]:
    r"""Evidence of all runs together, and the standard error of its logarithm.

    $$\log\hat Z = \log \frac1R \sum_r Z_r, \qquad
    \mathrm{se}^2 = \max\!\left(\bar{s^2},\ \mathrm{var}_r \log Z_r\right) / R$$

    What each run says of its own error may leave something out, and the scatter of few runs may
    be small by chance: the larger of the two is taken.

    Args:
        log_evidence: Of each run [nats].
        variance: Of each, as the run itself knows it [nats^2].

    Returns:
        log_evidence and log_evidence_error [nats].
    """
    count = len(log_evidence)
    scatter = float(np.var(log_evidence, ddof=1)) if count > 1 else 0.0
    return {
        "log_evidence": float(logsumexp(log_evidence) - np.log(count)),
        "log_evidence_error": float(np.sqrt(max(float(np.mean(variance)), scatter) / count)),
    }
