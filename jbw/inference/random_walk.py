"""The paper's sampler: random-walk Metropolis-Hastings in the unit box, as a NumPyro kernel."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, Key
from numpyro.infer.mcmc import MCMCKernel
from numpyro.infer.util import log_density

from jbw.inference.model import Unit, in_unit_box, uniform_start

AVERAGING = 0.75  # exponent of the weights of the averaged step, as in dual averaging
FORGETTING = 0.6  # exponent of the decaying gain: its sum diverges, its sum of squares converges


class PaperSettings(NamedTuple):
    """Settings of the published chain: 850 draws of which 10 % are burn-in, and sigma_p."""

    num_warmup: int = 85
    num_samples: int = 765
    step_size: float = 2.5108e-3


PAPER = PaperSettings()


class RandomWalkInfo(NamedTuple):
    """What happened in one step.

    Attributes:
        accept_prob: Acceptance probability; 0 for a proposal outside the box.
        accepted: Whether the walk moved.
        failed: Whether the log density of the proposal was not finite (a failed solve).
    """

    accept_prob: Float[Array, "..."]
    accepted: Bool[Array, "..."]
    failed: Bool[Array, "..."]


class RandomWalkState(NamedTuple):
    """Where one walk is.

    Attributes:
        i: Steps taken so far, burn-in included.
        x: Position in the unit box, by site.
        log_density: Log posterior density at x [nats].
        log_step: Logarithm of the proposal's standard deviation in x.
        log_step_average: Its average over the burn-in, used after it.
        info: What happened in the last step.
        rng_key: Key of the next step.
    """

    i: Int[Array, "..."]
    x: Unit
    log_density: Float[Array, "..."]
    log_step: Float[Array, "..."]
    log_step_average: Float[Array, "..."]
    info: RandomWalkInfo
    rng_key: Key[Array, "..."]


class RandomWalk(MCMCKernel):
    r"""Random-walk Metropolis-Hastings in the unit coordinate of a box.

    $$x' = x + \sigma_p L \eta, \quad \eta \sim N(0, I); \qquad
    P(\text{accept}) = \min\{1, p(x')/p(x)\}\ \text{inside}, \ 0\ \text{outside}$$

    A proposal outside the box is rejected and the current state repeated; clipping it onto the
    box would break detailed balance. The map to theta is linear, so there is no Jacobian.

    Args:
        model: NumPyro model whose latent sites all have bounded intervals, such as a `box_model`.
        step_size: sigma_p in x; when None, tuned during burn-in, and only there, to the target.
        target_accept: Acceptance to tune to.
        scale: L, lower-triangular, in the order of the sorted site names; identity when None.

    Reference:
        Section 3.2.
    """

    def __init__(
        self,
        model: Callable[..., None],
        step_size: float | None = None,
        target_accept: float = 0.5,
        scale: Float[Array, "parameter parameter"] | None = None,
    ) -> None:
        self._model = model
        self._tuned = step_size is None
        # Where tuning starts: wide in the box, or the optimum of a Gaussian that `scale` whitens.
        self._step_size = (0.1 if scale is None else 1.0) if step_size is None else step_size
        self._target_accept = target_accept
        self._scale = scale
        self._num_warmup = 0

    @property
    def model(self) -> Callable[..., None]:
        """The NumPyro model."""
        return self._model

    @property
    def sample_field(self) -> str:
        """Field of the state that holds the position."""
        return "x"

    def get_diagnostics_str(self, state: RandomWalkState) -> str:
        """Text beside NumPyro's progress bar."""
        accept = jnp.mean(state.info.accept_prob)
        return f"step {jnp.mean(jnp.exp(state.log_step)):.2e}, acc. prob={accept:.2f}"

    def init(
        self,
        rng_key: Key[Array, "..."],
        num_warmup: int,
        init_params: Unit | None,
        model_args: tuple[Any, ...],
        model_kwargs: dict[str, Any] | None,
    ) -> RandomWalkState:
        """First state of one walk, or of a batch of walks for a batch of keys.

        Args:
            rng_key: One key, or one a chain.
            num_warmup: Steps of burn-in.
            init_params: Start in the unit coordinate by site; uniform in the box when None.
            model_args: Arguments of the model.
            model_kwargs: Keyword arguments of the model.

        Returns:
            The state before the first step.
        """
        self._num_warmup = num_warmup

        def start(key: Key[Array, ""], x: Unit | None) -> RandomWalkState:
            key, key_start = jax.random.split(key)
            if x is None:
                x = uniform_start(key_start, self._model, model_args, model_kwargs)
            log_step = jnp.log(jnp.asarray(self._step_size, dtype=float))
            info = RandomWalkInfo(jnp.zeros(()), jnp.array(False), jnp.array(False))
            density = self._log_density(x, model_args, model_kwargs)
            return RandomWalkState(jnp.array(0), x, density, log_step, log_step, info, key)

        batched = rng_key.ndim > (0 if jnp.issubdtype(rng_key.dtype, jax.dtypes.prng_key) else 1)
        return jax.vmap(start)(rng_key, init_params) if batched else start(rng_key, init_params)

    def sample(
        self,
        state: RandomWalkState,
        model_args: tuple[Any, ...],
        model_kwargs: dict[str, Any] | None,
    ) -> RandomWalkState:
        """Advance one walk, or a batch of walks, by one step.

        Args:
            state: Where the walk is.
            model_args: Arguments of the model.
            model_kwargs: Keyword arguments of the model.

        Returns:
            The next state; the step size changes only during burn-in.
        """
        if jnp.ndim(state.i) > 0:
            return jax.vmap(lambda one: self._step(one, model_args, model_kwargs))(state)
        return self._step(state, model_args, model_kwargs)

    def postprocess_fn(
        self, model_args: tuple[Any, ...], model_kwargs: dict[str, Any] | None
    ) -> Callable[[Unit], dict[str, Array]]:
        """Map from the unit coordinate to the sites of the model."""

        def constrain(x: Unit) -> dict[str, Array]:
            _, trace = log_density(in_unit_box(self._model, x), model_args, model_kwargs or {}, {})
            return {name: trace[name]["value"] for name in x}

        return constrain

    def _log_density(
        self, x: Unit, model_args: tuple[Any, ...], model_kwargs: dict[str, Any] | None
    ) -> Float[Array, ""]:
        model = in_unit_box(self._model, x)
        return jnp.asarray(log_density(model, model_args, model_kwargs or {}, {})[0])

    def _step(
        self,
        state: RandomWalkState,
        model_args: tuple[Any, ...],
        model_kwargs: dict[str, Any] | None,
    ) -> RandomWalkState:
        rng_key, key_proposal, key_accept = jax.random.split(state.rng_key, 3)
        here, unravel = ravel_pytree(state.x)
        move = jax.random.normal(key_proposal, here.shape, here.dtype)
        there = here + jnp.exp(state.log_step) * (
            move if self._scale is None else self._scale @ move
        )
        inside = jnp.all((there >= 0) & (there <= 1))
        # The model is evaluated inside the box even for a proposal that will be rejected.
        proposed = self._log_density(
            unravel(jnp.where(inside, there, here)), model_args, model_kwargs
        )
        failed = ~jnp.isfinite(proposed)
        ratio = jnp.exp(jnp.minimum(proposed - state.log_density, 0.0))
        accept_prob = jnp.where(inside & ~failed, ratio, 0.0)
        accepted = jax.random.uniform(key_accept) < accept_prob
        log_step, average = self._tune(state, accept_prob)
        return RandomWalkState(
            state.i + 1,
            unravel(jnp.where(accepted, there, here)),
            jnp.where(accepted, proposed, state.log_density),
            log_step,
            average,
            RandomWalkInfo(accept_prob, accepted, inside & failed),
            rng_key,
        )

    def _tune(
        self, state: RandomWalkState, accept_prob: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Robbins-Monro on the logarithm of the step; the average takes over at the end."""
        if not self._tuned:
            return state.log_step, state.log_step_average
        t = state.i + 1.0
        log_step = state.log_step + 2 * t**-FORGETTING * (accept_prob - self._target_accept)
        weight = t**-AVERAGING
        average = weight * log_step + (1 - weight) * state.log_step_average
        last = state.i + 1 >= self._num_warmup
        tuning = state.i < self._num_warmup
        return (
            jnp.where(tuning, jnp.where(last, average, log_step), state.log_step),
            jnp.where(tuning, average, state.log_step_average),
        )
