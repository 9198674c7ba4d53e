r"""Elliptical slice sampling around a Gaussian approximation: few evaluations per draw.

$$s \sim \Gamma^{-1}\!\left(\tfrac{\kappa + d}{2}, \tfrac{\kappa + w^T w}{2}\right), \quad
\nu \sim N(0, s I), \qquad w' = w \cos\vartheta + \nu \sin\vartheta$$
$$\log r(w) = \log p(w \mid D) - \log t_\kappa(w)$$

Moves on the ellipse preserve the normal distribution of variance s, and drawing s preserves the t
distribution of kappa = 5 degrees of freedom. So only the ratio r of posterior and reference decides
at which angle r(w') exceeds a level drawn below r(w). Nothing is tuned and no gradient is needed.
The reference has heavier tails than a posterior, so no chain stays far out.

Reference:
    Murray, Adams, MacKay (2010), AISTATS 9, 541; with the t distribution, Nishihara, Murray, Adams
    (2014), JMLR 15, 2087.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from blackjax.mcmc import elliptical_slice
from blackjax.mcmc.elliptical_slice import EllipSliceState
from jaxtyping import Array, Float, Int, Key

from jbw.inference.samplers.chains import Draw, Kernel
from jbw.inference.samplers.evidence import FORBIDDEN, HEAVY, log_ratio
from jbw.inference.space.problem import Problem

# number of ellipses per draw; the correlation of w^2 is 1/2 after one ellipse, 1/8 after three
MOVES = 3
COUNT = jnp.int32


class Options(NamedTuple):
    """The options of elliptical slice sampling; its warm-up adapts nothing."""

    num_warmup: int = 1000
    num_samples: int = 1000
    num_chains: int = 4
    chain_method: str = "sequential"


class SliceState(NamedTuple):
    """The state of one chain, with the number of points evaluated for the last draw."""

    w: Float[Array, " parameter"]
    log_ratio: Float[Array, ""]
    num_steps: Int[Array, ""]
    rng_key: Key[Array, ""]


def kernel(problem: Problem, options: Options) -> Kernel:
    """Return the kernel of the elliptical slice sampler for a problem."""

    def ratio(w: Float[Array, " parameter"]) -> Float[Array, ""]:
        # NaN would end the shrinking loop, so points of zero density have -inf.
        value = log_ratio(problem, w)
        return jnp.where(value > FORBIDDEN, value, -jnp.inf)

    def init(key: Key[Array, ""], w: Float[Array, " parameter"]) -> SliceState:
        """Return a state from which the first ellipse accepts any point of positive density."""
        return SliceState(w, jnp.array(-jnp.inf), jnp.zeros((), COUNT), key)

    def move(at: EllipSliceState, key: Key[Array, ""]) -> tuple[EllipSliceState, Array]:
        w = jnp.asarray(at.position)
        key_scale, key_move = jax.random.split(key)
        shape, rate = 0.5 * (HEAVY + w.size), 0.5 * (HEAVY + w @ w)
        variance = rate / jax.random.gamma(key_scale, shape)
        ellipse = elliptical_slice.build_kernel(variance * jnp.ones_like(w), jnp.zeros_like(w))
        at, move_info = ellipse(key_move, at, ratio)
        return at, jnp.asarray(move_info.subiter)

    def step(state: SliceState) -> SliceState:
        key, *keys = jax.random.split(state.rng_key, 1 + MOVES)
        end, looked = jax.lax.scan(move, EllipSliceState(state.w, state.log_ratio), jnp.stack(keys))
        w, value = jnp.asarray(end.position), jnp.asarray(end.logdensity)
        return SliceState(w, value, jnp.sum(looked, dtype=COUNT), key)

    def read(state: SliceState) -> Draw:
        return Draw(problem.theta(state.w), {"n_steps": state.num_steps})

    return Kernel(init, step, read)
