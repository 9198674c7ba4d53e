r"""Residual terms of a unit that nobody measured: what other modes would add to its response.

They may have either sign, so that no logarithm of theirs is pooled. Of K units that all have the
constants c_k a further one has, by the normal theory of a mean and a covariance that are not known,

$$c = \bar c + \sqrt{\frac{1 + 1/K}{\chi^2_{K-1}}}\,\sum_k g_k (c_k - \bar c), \qquad
  g_k \sim N(0, 1)$$

each Student's t with K - 1 degrees of freedom, together as the units have them; c_k are draws of
the units' posteriors. A term that only some units have, and linear neighbours, whose place belongs
to one structure, are left out, and named.

Reference:
    Gelman et al. (2013), Bayesian Data Analysis, 3rd ed., sections 3.2 and 3.6.
"""

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.population.coordinates import unit_names
from jbw.quantities import CONSTANT_TERMS, RESIDUAL_TERMS

CONSTANTS = tuple(quantity.name for quantity in CONSTANT_TERMS)
TERMS = tuple(quantity.name for quantity in RESIDUAL_TERMS)


def new_terms(
    fleet: xr.DataTree, rng: np.random.Generator, num: int
) -> dict[str, Float[np.ndarray, " unit"]]:
    """Constants of `num` further units, of those that every unit has."""
    names, units = terms_of(fleet)[0], unit_names(fleet)
    if not names:
        return {}
    groups = [fleet[unit].to_dataset() for unit in units]
    unit_draws = [np.stack([group[name].values for name in names], axis=-1) for group in groups]
    sampled = np.stack(
        [values[rng.integers(len(values), size=num)] for values in unit_draws], axis=1
    )
    middle, count = sampled.mean(axis=1), len(units)
    g = rng.standard_normal((num, count))
    stretch = np.sqrt((1.0 + 1.0 / count) / rng.chisquare(count - 1, num))
    away = np.einsum("nk,nkj->nj", g, sampled - middle[:, None])
    return dict(zip(names, (middle + stretch[:, None] * away).T, strict=True))


def terms_of(fleet: xr.DataTree) -> tuple[list[str], list[str]]:
    """Names of the terms that a further unit has, and of those that it does not though some do."""
    held = [set(map(str, fleet[unit].data_vars)) & set(TERMS) for unit in unit_names(fleet)]
    every = [name for name in CONSTANTS if all(name in unit_terms for unit_terms in held)]
    return every, [name for name in TERMS if name not in every and any(name in o for o in held)]
