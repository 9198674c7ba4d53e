r"""Sampling along the direction that the data leave open, from wall to wall of the box.

Where only a combination is known, as alpha delta from one kernel, the posterior is a thin ridge
that ends at the walls of the box. Among the parameters that have a part in it, along the weakest
direction v of a fit and across it,

$$s = s_0 + B\,w + \bigl[\tau_- + r\,(\tau_+ - \tau_-)\bigr]\,v, \qquad 0 < r < 1$$

where s are those parameters, by their logarithms where they are positive, in units of the box, and
tau_-, tau_+ is where the line through s_0 + B w meets the walls. In (w, r) the ridge is straight,
and the wall a bound of r alone. The other parameters stay, by their logarithms. The density is
carried over with its Jacobian:

$$p(w, r) = p(\theta)\,(\tau_+ - \tau_-) \prod_i \theta_i$$
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.inference.box import Box, box
from jbw.inference.fitting import Fit
from jbw.inference.logarithms import LOG, from_logs, log_box, log_start
from jbw.inference.model import LogLikelihood
from jbw.inference.posterior import in_parameters
from jbw.inference.sampling import sample

ALONG = "along"
ACROSS = "across {}"
PART = 0.3  # a parameter is of the ridge from this share of its largest component on
NARROW = 1e-9  # component of the direction below which a wall is parallel to it
MIDDLE = (0.05, 0.95)  # where along the ridge chains start, though the optimum be at a wall


class Ridge(eqx.Module):
    """The coordinates about a ridge; called with a point, their log prior density.

    Attributes:
        box: The prior box, positive parameters by their logarithms.
        members: Places of the ridge's parameters in it; static.
        origin: s_0, in units of the box.
        across: B, orthonormal columns.
        along: v, a unit vector.
        constant: What makes the density over the coordinates' own box integrate to one [nats].
    """

    box: Box
    members: tuple[int, ...] = eqx.field(static=True)
    origin: Float[Array, " member"]
    across: Float[Array, "member across"]
    along: Float[Array, " member"]
    constant: Float[Array, ""]

    def __call__(self, point: Mapping[str, Array]) -> Float[Array, ""]:
        """Log density at a point, over that of its own box, of the parameters' uniform prior."""
        low, high = walls(_across(point, self), self)
        inner = parameters_by_logs(point, self)
        jacobian = sum(value for name, value in inner.items() if name.startswith(LOG))
        length = jnp.where(high > low, high - low, 1.0)
        density = self.constant + jacobian + jnp.log(length)
        return jnp.where(high > low, density, -jnp.inf)


class About(NamedTuple):
    """Where the sampler starts in the coordinates of a ridge, and how wide it is there.

    Attributes:
        box: Bounds of the coordinates.
        start: Optimum.
        covariance: Of the coordinates.
    """

    box: Box
    start: dict[str, float]
    covariance: Float[np.ndarray, "parameter parameter"]


def ridge_of(best: Fit, prior: Box) -> tuple[Ridge, About]:
    """The coordinates about a fit, whose least known direction is the ridge.

    Args:
        best: The fit.
        prior: Its box.
    """
    logs = tuple(n for n, low in zip(prior.names, prior.lower, strict=True) if low > 0)
    inner = log_box(prior, logs, best.theta)
    start, covariance = log_start(best, prior, logs)
    width, lower = np.asarray(inner.upper - inner.lower), np.asarray(inner.lower)
    weakest = np.abs(np.linalg.eigh(covariance / np.outer(width, width))[1][:, -1])
    members = np.flatnonzero(weakest > PART * weakest.max())
    others = np.flatnonzero(weakest <= PART * weakest.max())
    own = width[members]
    origin = (np.array([start[inner.names[i]] for i in members]) - lower[members]) / own
    block = covariance[np.ix_(members, members)] / np.outer(own, own)
    across, along = np.split(np.linalg.eigh(block)[1], [len(members) - 1], axis=1)
    corners = (np.array(list(product((0.0, 1.0), repeat=len(members)))) - origin) @ across
    spans = {ACROSS.format(i + 1): (c.min(), c.max()) for i, c in enumerate(corners.T)}
    kept = {inner.names[i]: (lower[i], lower[i] + width[i]) for i in others}
    volume = np.prod([b - a for a, b in {**kept, **spans}.values()]) * np.prod(own)
    constant = np.log(volume / np.prod(np.asarray(prior.upper - prior.lower)))
    found = (jnp.asarray(one) for one in (origin, across, along[:, 0], constant))
    ridge = Ridge(inner, tuple(int(i) for i in members), *found)
    low, high = (float(wall) for wall in walls(ridge.origin, ridge))
    length = max(high - low, NARROW)  # zero for an optimum in a corner
    middle = {name: start[name] for name in kept} | dict.fromkeys(spans, 0.0)
    turn = np.zeros((len(width), len(width)))  # from the parameters by logs to the coordinates
    turn[range(len(others)), others] = 1.0
    turn[np.ix_(range(len(others), len(width)), members)] = np.hstack([across, along]).T / own
    turn[-1] /= length
    turned = turn @ covariance @ turn.T
    shrink = np.ones(len(width))
    shrink[-1] = min(1.0, 1 / np.sqrt(12 * turned[-1, -1]))  # r is no wider than uniform
    return ridge, About(
        box({**kept, **spans, ALONG: (0.0, 1.0)}),
        {**middle, ALONG: float(np.clip(-low / length, *MIDDLE))},
        turned * np.outer(shrink, shrink),
    )


def walls(
    foot: Float[Array, " parameter"], ridge: Ridge
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Where the line along the ridge through a point enters and leaves the box.

    Args:
        foot: The point s_0 + B w.
        ridge: The coordinates.

    Returns:
        tau_- and tau_+; the second is not above the first where the line misses the box.
    """
    v = ridge.along
    parallel = jnp.abs(v) < NARROW
    slope = jnp.where(parallel, 1.0, v)
    ends = jnp.stack([(0 - foot) / slope, (1 - foot) / slope])
    low = jnp.max(jnp.where(parallel, -jnp.inf, ends.min(axis=0)))
    high = jnp.min(jnp.where(parallel, jnp.inf, ends.max(axis=0)))
    inside = jnp.all(~parallel | ((foot > 0) & (foot < 1)))
    return low, jnp.where(inside, high, low)


def _across(point: Mapping[str, Array], ridge: Ridge) -> Float[Array, " parameter"]:
    count = ridge.across.shape[1]
    w = jnp.stack([point[ACROSS.format(i + 1)] for i in range(count)]) if count else jnp.zeros(0)
    return ridge.origin + ridge.across @ w


def parameters_by_logs(point: Mapping[str, Array], ridge: Ridge) -> dict[str, Array]:
    """Parameters at a point, the positive ones by their logarithms."""
    foot = _across(point, ridge)
    low, high = walls(foot, ridge)
    s = foot + (low + point[ALONG] * (high - low)) * ridge.along
    members = np.array(ridge.members)
    lower, upper = ridge.box.lower[members], ridge.box.upper[members]
    value = dict(zip(ridge.members, lower + s * (upper - lower), strict=True))
    return {name: value[i] if i in value else point[name] for i, name in enumerate(ridge.box.names)}


def parameters(point: Mapping[str, Array], ridge: Ridge) -> dict[str, Array]:
    """Parameters at a point."""
    return from_logs(parameters_by_logs(point, ridge))


@lru_cache
def along_ridge(log_likelihood: LogLikelihood) -> LogLikelihood:
    """The log likelihood of a point and of (ridge, data); one function for each."""

    def carried(point: Mapping[str, Array], data: Any) -> Float[Array, " term"]:
        ridge, inner = data
        return log_likelihood(parameters(point, ridge), inner)

    return carried


def sample_along(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    prior: Box,
    data: Any,
    best: Fit,
    *,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
    draw: Callable[..., xr.DataTree] = sample,
    **options: Any,
) -> xr.DataTree:
    """Sample a posterior along the ridge of its fit, and return it in the parameters.

    Args:
        key: Random key.
        log_likelihood: As of `sample`.
        prior: The box.
        data: What the log likelihood takes.
        best: The fit.
        attrs: `units` and `long_name` by parameter.
        draw: `sample`, or what takes and returns the same.
        options: Further ones of it.
    """
    ridge, about = ridge_of(best, prior)
    tree = draw(
        key, along_ridge(log_likelihood), about.box, (ridge, data),
        start=about.start, covariance=about.covariance, log_prior=ridge, **options,
    )  # fmt: skip
    drawn = {str(n): jnp.asarray(v.values) for n, v in tree["posterior"].data_vars.items()}
    back = jax.vmap(jax.vmap(lambda point: parameters(point, ridge)))(drawn)
    return in_parameters(tree, {n: np.asarray(v) for n, v in back.items()}, prior, attrs or {})
