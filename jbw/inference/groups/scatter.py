r"""The standard deviation of offsets between runs and between assemblies, integrated out.

A run r of an assembly a has the offset $b_r = a_a + c_r$, $c \sim N(0, S)$, $a \sim N(0, T)$,
because a structure that is mounted again has another frequency. With one run per assembly there is
only c.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key
from scipy.special import ndtri

from jbw.inference.groups.offsets import Estimate, log_determinant, members, solve

NUM_SCATTERS = 17  # number of grid values of each standard deviation, at most half a decade apart
NUM_ASSEMBLIES = 7  # number of grid values of the standard deviation between assemblies
LOG_SD = float(np.log(2.0))  # standard deviation of the prior of a logarithm around a stated median

Levels = tuple[tuple[int, ...], ...]
"""The run number of each data group and, with assemblies, the assembly number of each run."""


class Spread(NamedTuple):
    """A draw of the standard deviations between runs and assemblies, with each run's offset."""

    scatter: Float[Array, " level_own"]
    offset: Float[Array, "run own"]


class _Information(NamedTuple):
    """A Gaussian likelihood of offsets b, exp(-b W b / 2 + h b)."""

    precision: Float[Array, "member own own"]
    pull: Float[Array, "member own"]


def scatter_grid(
    least: tuple[float, ...],
    most: tuple[float, ...],
    *,
    assemblies: bool = False,
    medians: tuple[float | None, ...] = (),
) -> Float[np.ndarray, "node level_own"]:
    """Return equally probable standard deviations between runs, and between assemblies if stated.

    The logarithm of each scatter is uniform from `least` to `most`, with one node if they are
    equal. If a median is stated, the scatter is log-normal instead, within a factor of two in two
    cases of three.
    """
    centres = medians or (None,) * len(least)
    bounds = list(zip(least, most, centres, strict=True))
    axes = [_axis(*limits, NUM_SCATTERS) for limits in bounds]
    if assemblies:
        axes += [_axis(*limits, NUM_ASSEMBLIES) for limits in bounds]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _axis(least: float, most: float, median: float | None, count: int) -> np.ndarray:
    if least == most:
        return np.array([most])  # the standard deviation is known
    if median is None:
        return np.geomspace(least, most, count)
    return median * np.exp(LOG_SD * ndtri((np.arange(count) + 0.5) / count))


def log_density_of_offsets(
    estimates: Estimate,
    levels: Levels,
    scatters: Float[Array, "node level_own"] | Float[np.ndarray, "node level_own"],
) -> Float[Array, ""]:
    r"""Return the log density [nats] of estimated run offsets whose standard deviation is unknown.

    $$\log \frac{1}{M}\sum_{S, T} \prod_a \int N(a; 0, T) \prod_{r \in a} \int N(b - a; 0, S)
      \prod_{g \in r} e^{-\frac12 (\hat b_g - b)^T W_g (\hat b_g - b)}\,db\,da$$

    up to a constant, summed over the nodes of the scatter's prior.
    """
    num_own = estimates.offset.shape[1]
    if num_own == 0:
        return jnp.zeros(())
    runs = _of_runs(estimates, levels)
    spread = jnp.sum(
        estimates.offset * jnp.einsum("gij,gj->gi", estimates.precision, estimates.offset)
    )
    nodes = _nodes(runs, levels, jnp.asarray(scatters), num_own)
    return -0.5 * spread + jax.nn.logsumexp(nodes) - np.log(len(scatters))


def draw_offsets(
    key: Key[Array, ""],
    estimates: Estimate,
    levels: Levels,
    scatters: Float[Array, "node level_own"],
) -> Spread:
    """Draw the offsets' standard deviation and every run's offset, given the groups' estimates."""
    num_own = estimates.offset.shape[1]
    runs = _of_runs(estimates, levels)
    keys = jax.random.split(key, 3)
    chosen = scatters[jax.random.categorical(keys[0], _nodes(runs, levels, scatters, num_own))]
    centre = jnp.zeros_like(runs.pull)
    if len(levels) > 1:
        member = members(levels[1])
        together = _summed(_passed_on(runs, chosen[:num_own]), member)
        centre = member @ _drawn(keys[1], together, chosen[num_own:])
    pull = runs.pull - jnp.einsum("rij,rj->ri", runs.precision, centre)
    offset = centre + _drawn(keys[2], _Information(runs.precision, pull), chosen[:num_own])
    return Spread(chosen, offset)


def _summed(parts: _Information, member: Float[Array, "part whole"]) -> _Information:
    return _Information(
        jnp.einsum("gr,gij->rij", member, parts.precision),
        jnp.einsum("gr,gi->ri", member, parts.pull),
    )


def _of_runs(estimates: Estimate, levels: Levels) -> _Information:
    pull = jnp.einsum("gij,gj->gi", estimates.precision, estimates.offset)
    return _summed(_Information(estimates.precision, pull), members(levels[0]))


def _nodes(
    runs: _Information, levels: Levels, scatters: Float[Array, "node level_own"], num_own: int
) -> Float[Array, " node"]:
    """Return the log density of the offsets for each grid value of their standard deviation."""

    def at_scatter(scatter: Float[Array, " level_own"]) -> Float[Array, ""]:
        log_density = _integrated(runs, scatter[:num_own])
        if len(levels) > 1:
            together = _summed(_passed_on(runs, scatter[:num_own]), members(levels[1]))
            log_density += _integrated(together, scatter[num_own:])
        return log_density

    return jax.vmap(at_scatter)(scatters)


def _scaled(
    data: _Information, scatter: Float[Array, " own"]
) -> tuple[Float[Array, "member own own"], Float[Array, "member own"]]:
    """Return the likelihood of x, with offsets b = s x, times the standard normal prior of x."""
    return scatter[:, None] * data.precision * scatter + jnp.eye(len(scatter)), data.pull * scatter


def _integrated(data: _Information, scatter: Float[Array, " own"]) -> Float[Array, ""]:
    r"""Return the log of $\int N(b; 0, S)\, e^{-\frac12 b^T W b + h^T b}\,db$ for offsets b."""
    precision, pull = _scaled(data, scatter)
    best = jnp.sum(pull * solve(precision, pull))
    return 0.5 * (best - jnp.sum(log_determinant(precision)))


def _passed_on(data: _Information, scatter: Float[Array, " own"]) -> _Information:
    """Return the likelihood of assembly offsets a that follows from run offsets b = a + c.

    It has the precision W - W G W and the linear term h - W G h, $G = (W + S^{-1})^{-1}$.
    """
    precision, pull = _scaled(data, scatter)
    weight = data.precision * scatter  # precision W times standard deviation s of the offsets
    gained = jax.vmap(lambda column: solve(precision, column), in_axes=2, out_axes=2)(
        jnp.swapaxes(weight, 1, 2)
    )
    return _Information(
        data.precision - weight @ gained,
        data.pull - jnp.einsum("rij,rj->ri", weight, solve(precision, pull)),
    )


def _drawn(
    key: Key[Array, ""], data: _Information, scatter: Float[Array, " own"]
) -> Float[Array, "member own"]:
    """Draw offsets of runs and assemblies, given their standard deviations."""
    precision, pull = _scaled(data, scatter)
    root = jnp.linalg.cholesky(precision)
    white = jax.random.normal(key, pull.shape)
    apart = jax.vmap(
        lambda factor, w: jax.scipy.linalg.solve_triangular(factor, w, lower=True, trans=1)
    )(root, white)
    return scatter * (solve(precision, pull) + apart)
