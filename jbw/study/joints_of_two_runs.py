r"""Which of several joints has changed from one run to another?

Of the parameters $\theta_j$ of joint j in two independent posteriors, whatever the others are,

$$d_j^2 = (\bar\theta_A - \bar\theta_B)^T\,(\Sigma_A + \Sigma_B)^{-1}\,
          (\bar\theta_A - \bar\theta_B)$$

is a chi-square by chance, of as many degrees of freedom as there are parameters, where nothing has
changed and posteriors are Gaussian.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import stats

from jbw.oscillator.laws import quantities_of
from jbw.quantities import are_at_joints, split
from jbw.report.messages import differences as messages

BY_CHANCE = 0.01  # probability that any of the joints is named although none has changed

Draws = Mapping[str, Float[np.ndarray, " draw"]]


def changed_joints(first: Draws, second: Draws, laws: Sequence[str]) -> list[dict[str, Any]]:
    """A row for every joint, or joints of a tie: chi-square, its degrees of freedom, p, answer.

    Args:
        first: Draws of the first run's parameters by name.
        second: Draws of the second run's.
        laws: Names of the laws that both runs have; of one joint there are no rows.
    """
    if not are_at_joints(laws):
        return []
    groups = list(dict.fromkeys(split(law)[1] for law in laws))
    rows = []
    for joints in groups:
        of_joints = tuple(law for law in laws if split(law)[1] == joints)
        names = [quantity.name for quantity in quantities_of(of_joints)]
        square, degrees = _distance(first, second, names)
        p = float(stats.chi2.sf(square, degrees)) if degrees else 1.0
        has_changed = p < BY_CHANCE / len(groups)
        rows.append(
            {
                "joint": " and ".join(joints),
                "chi_square": square,
                "degrees_of_freedom": degrees,
                "p": p,
                "changed": has_changed,
            }
        )
    return rows


def _distance(first: Draws, second: Draws, names: Sequence[str]) -> tuple[float, int]:
    """Squared distance of the means in the sum of the covariances, over what scatters in both."""
    known = [
        name
        for name in names
        if name in first and name in second and np.std(first[name]) + np.std(second[name]) > 0
    ]
    if not known:
        return 0.0, 0
    means, covariances = [], []
    for draws in (first, second):
        table = np.array([draws[name] for name in known])
        means.append(table.mean(axis=1))
        covariances.append(np.atleast_2d(np.cov(table)))
    away = means[0] - means[1]
    std = np.sqrt(np.diag(covariances[0] + covariances[1]))
    correlation = (covariances[0] + covariances[1]) / np.outer(std, std)
    return float((away / std) @ np.linalg.solve(correlation, away / std)), len(known)


def joint_statements(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Which joints have changed, and which may be the same; nothing of one joint."""
    sentences = [
        messages.joint_changed(row["joint"], row["chi_square"], row["degrees_of_freedom"])
        for row in rows
        if row["changed"]
    ]
    if rest := {row["joint"]: row["p"] for row in rows if not row["changed"]}:
        sentences.append(messages.joints_may_be_same(rest))
    return sentences
