r"""What two runs say of their joints: which has changed, and whether two modes share one.

Of the parameters $\theta_j$ of joint j in two independent posteriors, whatever the others are,

$$d_j^2 = (\bar\theta_A - \bar\theta_B)^T\,(\Sigma_A + \Sigma_B)^{-1}\,
          (\bar\theta_A - \bar\theta_B)$$

is a chi-square by chance, of as many degrees of freedom as there are parameters, where nothing has
changed and posteriors are Gaussian.

A joint that moves by $x = h\,y$ is to the mode's y a law of the same kind, whose parameters hold
the unknown h. The ratio of the second product to the first does not: of Bouc-Wen's law

$$\frac{\alpha_i\gamma_i}{\alpha_i\delta_i} = \frac{\gamma}{\delta}, \qquad i = 1, 2$$

so that modes of one joint must agree in it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from jbw.inference.posterior.summary import QUANTILES
from jbw.oscillator.laws import laws_named, quantities_of
from jbw.oscillator.parameters import Monomial
from jbw.quantities import Quantity, are_at_joints, per, split
from jbw.report.messages import differences as messages
from jbw.report.text import interval

BY_CHANCE = 0.01  # probability that any of the joints is named although none has changed
APART = 1.1  # times the other's natural frequency: runs of two modes, not of two days

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
    varying = [
        name
        for name in names
        if name in first and name in second and np.std(first[name]) + np.std(second[name]) > 0
    ]
    if not varying:
        return 0.0, 0
    means, covariances = [], []
    for draws in (first, second):
        table = np.array([draws[name] for name in varying])
        means.append(table.mean(axis=1))
        covariances.append(np.atleast_2d(np.cov(table)))
    away = means[0] - means[1]
    std = np.sqrt(np.diag(covariances[0] + covariances[1]))
    correlation = (covariances[0] + covariances[1]) / np.outer(std, std)
    return float((away / std) @ np.linalg.solve(correlation, away / std)), len(varying)


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


class Ratio(NamedTuple):
    """The second product of a law over the first, and the first."""

    ratio: Monomial
    first: Monomial


def ratios(laws: Sequence[str]) -> list[Ratio]:
    """Of every law that has two products."""
    pairs = [law.products for law in laws_named(tuple(laws)) if len(law.products) == 2]
    return [Ratio(_over(second, first), first) for first, second in pairs]


def _over(second: Monomial, first: Monomial) -> Monomial:
    """One product over another, named by what does not cancel."""
    names = dict.fromkeys((*second.powers, *first.powers))
    powers = {name: second.powers.get(name, 0) - first.powers.get(name, 0) for name in names}
    powers = {name: power for name, power in powers.items() if power}
    above, below = (
        "*".join(n if abs(p) == 1 else f"{n}^{abs(p)}" for n, p in powers.items() if p * sign > 0)
        for sign in (1, -1)
    )
    units = second.quantity.unit, first.quantity.unit
    unit = "1" if units[0] == units[1] else per(*units)
    name = f"{above or 1}/{below}" if below else above
    return Monomial(Quantity(name, name, unit, f"{second.name} over {first.name}"), powers)


def of_draws(ratio: Ratio, draws: Draws) -> Float[np.ndarray, " draw"] | None:
    """Draws of a ratio; None where a parameter is not among them, or the first product may be 0."""
    if not ratio.first.powers.keys() | ratio.ratio.powers.keys() <= draws.keys():
        return None
    low, _, high = np.quantile(ratio.first.of(draws), QUANTILES)
    return None if low <= 0.0 <= high else np.asarray(ratio.ratio.of(draws))


def are_two_modes(first: Draws, second: Draws) -> bool:
    """Whether two runs are of different modes, by their natural frequencies."""
    both = [float(np.median(draws["omega_n"])) for draws in (first, second) if "omega_n" in draws]
    return len(both) == 2 and max(both) > APART * min(both)


def sentence(row: Mapping[str, Any], *, sure: bool) -> str:
    """Whether two modes may have one joint, by the row of a ratio."""
    a, b = interval(*row["a"]), interval(*row["b"])
    return messages.one_joint(row["name"], a, b, sure=sure)
