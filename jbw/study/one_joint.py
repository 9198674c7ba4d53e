r"""Is it one joint that two modes share? What its law's products say apart from the modes' shapes.

A joint that moves by $x = h\,y$ is to the mode's y a law of the same kind, whose parameters hold
the unknown h. The ratio of the second product to the first does not: of Bouc-Wen's law

$$\frac{\alpha_i\gamma_i}{\alpha_i\delta_i} = \frac{\gamma}{\delta}, \qquad i = 1, 2$$

so that modes of one joint must agree in it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.inference.posterior.summary import QUANTILES
from jbw.oscillator.laws import laws_named
from jbw.oscillator.parameters import Monomial
from jbw.quantities import Quantity, per
from jbw.report.messages.differences import one_joint
from jbw.report.text import interval

APART = 1.1  # times the other's natural frequency: runs of two modes, not of two days

Draws = Mapping[str, Float[np.ndarray, " draw"]]


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


def of_draws(one: Ratio, draws: Draws) -> Float[np.ndarray, " draw"] | None:
    """Draws of a ratio; None where a parameter is not among them, or the first product may be 0."""
    if not one.first.powers.keys() | one.ratio.powers.keys() <= draws.keys():
        return None
    low, _, high = np.quantile(one.first.of(draws), QUANTILES)
    return None if low <= 0.0 <= high else np.asarray(one.ratio.of(draws))


def are_two_modes(first: Draws, second: Draws) -> bool:
    """Whether two runs are of different modes, by their natural frequencies."""
    both = [float(np.median(draws["omega_n"])) for draws in (first, second) if "omega_n" in draws]
    return len(both) == 2 and max(both) > APART * min(both)


def sentence(row: Mapping[str, Any], *, sure: bool) -> str:
    """Whether two modes may have one joint, by the row of a ratio."""
    a, b = interval(*row["a"]), interval(*row["b"])
    return one_joint(row["name"], a, b, sure=sure)
