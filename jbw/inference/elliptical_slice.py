"""Elliptical slice sampling about a Laplace approximation: a draw for a few evaluations."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from blackjax.mcmc import elliptical_slice
from blackjax.mcmc.elliptical_slice import EllipSliceState
from jaxtyping import Array, Float, Int, Key
from numpyro.infer.mcmc import MCMCKernel

from jbw.inference.laplace import HEAVY

MOVES = 3  # ellipses a draw: one leaves w^2 correlated by E[cos^2] = 1/2, three by 1/8


COUNT = jnp.int32


class SliceState(NamedTuple):
    """Where one chain is.

    Attributes:
        w: Position in the whitened coordinate.
        log_ratio: Log posterior less log reference density at w [nats].
        num_steps: Points that the last draw looked at.
        rng_key: Key of the next draw.
    """

    w: Float[Array, "... parameter"]
    log_ratio: Float[Array, "..."]
    num_steps: Int[Array, "..."]
    rng_key: Key[Array, "..."]


class EllipticalSlice(MCMCKernel):
    r"""Elliptical slice sampling about a Student t distribution in a whitened coordinate.

    $$s \sim \Gamma^{-1}\!\left(\tfrac{\kappa + d}{2}, \tfrac{\kappa + w^T w}{2}\right), \quad
    \nu \sim N(0, s I), \qquad w' = w \cos\vartheta + \nu \sin\vartheta$$
    $$\log r(w) = \log p(w \mid D) + \tfrac{\kappa + d}{2} \log(1 + w^T w / \kappa)$$

    The ellipse leaves the normal of variance s as it is, and s the t distribution of kappa = 5
    degrees of freedom, so that only the ratio r of posterior and reference decides: the angle is
    drawn uniformly and its bracket shrunk until r(w') exceeds a level drawn below r(w). Where the
    posterior is nearly the normal of the whitening almost every first point is taken and draws are
    nearly independent; nothing is tuned and no gradient is needed. The tails of the reference are
    heavier than a posterior's, so that no chain is left far out. A point at which the posterior is
    not finite is never taken.

    Args:
        potential: Minus log posterior density of w [nats].

    Reference:
        Murray, Adams, MacKay (2010), AISTATS 9, 541; with the t distribution, Nishihara, Murray,
        Adams (2014), JMLR 15, 2087.
    """

    def __init__(self, potential: Callable[[Array], Array]) -> None:
        self._potential = potential

    @property
    def sample_field(self) -> str:
        """Name of the field of the state that holds the draw."""
        return "w"

    def _log_ratio(self, w: Float[Array, " parameter"]) -> Float[Array, ""]:
        reference = 0.5 * (HEAVY + w.size) * jnp.log1p(w @ w / HEAVY)
        ratio = reference - self._potential(w)
        # The shrinking ends at a comparison that NaN would pass.
        return jnp.where(jnp.isfinite(ratio), ratio, -jnp.inf)

    def init(
        self,
        rng_key: Key[Array, ""],
        num_warmup: int,
        init_params: Any,
        model_args: tuple[Any, ...],
        model_kwargs: dict[str, Any],
    ) -> SliceState:
        """First state of a chain, from which the first ellipse takes any possible point.

        Args:
            rng_key: Random key.
            num_warmup: Not used.
            init_params: Start w.
            model_args: Not used.
            model_kwargs: Not used.
        """
        return SliceState(init_params, jnp.array(-jnp.inf), jnp.zeros((), COUNT), rng_key)

    def sample(
        self, state: SliceState, model_args: tuple[Any, ...], model_kwargs: dict[str, Any]
    ) -> SliceState:
        """One draw.

        Args:
            state: Where the chain is.
            model_args: Not used.
            model_kwargs: Not used.
        """

        def move(at: EllipSliceState, key: Key[Array, ""]) -> tuple[EllipSliceState, Array]:
            w = jnp.asarray(at.position)
            key_scale, key_move = jax.random.split(key)
            shape, rate = 0.5 * (HEAVY + w.size), 0.5 * (HEAVY + w @ w)
            variance = rate / jax.random.gamma(key_scale, shape)
            step = elliptical_slice.build_kernel(variance * jnp.ones_like(w), jnp.zeros_like(w))
            at, info = step(key_move, at, self._log_ratio)
            return at, jnp.asarray(info.subiter)

        key, *keys = jax.random.split(state.rng_key, 1 + MOVES)
        start = EllipSliceState(state.w, state.log_ratio)
        end, looked = jax.lax.scan(move, start, jnp.stack(keys))
        w, log_ratio = jnp.asarray(end.position), jnp.asarray(end.logdensity)
        return SliceState(w, log_ratio, jnp.sum(looked, dtype=COUNT), key)
