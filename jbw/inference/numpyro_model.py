"""A posterior as a plain NumPyro model, with its samplers NUTS and random-walk Metropolis."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
from jaxtyping import Array, Float, Key
from numpyro.distributions import Distribution, biject_to
from numpyro.infer import NUTS, init_to_value
from numpyro.infer.mcmc import MCMCKernel

from jbw.inference.samplers.random_walk import PAPER, Options, WalkState, kernel
from jbw.inference.space.box import Box, bounds_by_name
from jbw.inference.space.problem import LOGIT_PRIOR_PRECISION, Problem

Values = Mapping[str, Any]


@dataclass(frozen=True)
class NumpyroModel:
    r"""A posterior as a NumPyro model, a function that declares its random variables.

    $$\theta_i \sim \pi_i, \qquad \log L = \log L(\theta)$$

    There is one latent site per parameter, in SI units; the factor `log_likelihood`; and
    deterministic sites of derived quantities.

    Attributes:
        prior: Distribution of every latent site: uniform within its bounds, or a stated density.
        log_likelihood: Function of the parameters by name, with noise integrated out [nats].
        derived: Function from the parameters to derived quantities, by name.
        problem: The same posterior in the coordinates of jbw's own samplers.
        optimum: The optimum of the fit, by name.
        covariance: Covariance at the optimum, including stated densities, in the order of the
            prior.
        uniform: Names of the latent sites with a uniform prior.
    """

    prior: Mapping[str, Distribution]
    log_likelihood: Callable[[Values], Float[Array, ""]]
    derived: Callable[[Values], Values]
    problem: Problem
    optimum: Mapping[str, float]
    covariance: Float[np.ndarray, "parameter parameter"]
    uniform: tuple[str, ...]

    def __call__(self) -> None:
        """Declare the model's random variables, as NumPyro's inference expects."""
        theta = {
            name: jnp.asarray(numpyro.sample(name, density)) for name, density in self.prior.items()
        }
        total = self.log_likelihood(theta)
        numpyro.factor("log_likelihood", jnp.where(jnp.isfinite(total), total, -jnp.inf))
        for name, value in self.derived(theta).items():
            numpyro.deterministic(name, value)

    def __repr__(self) -> str:
        return f"NumpyroModel({', '.join(self.prior)})"

    @property
    def box(self) -> Box:
        """The bounds outside which every prior is negligible."""
        return self.problem.box

    @property
    def start(self) -> dict[str, float]:
        """The optimum of a fit by name, kept at least one standard deviation from the bounds."""
        inside, bounds = {}, bounds_by_name(self.box)
        for name, std in zip(self.box.names, np.sqrt(np.diag(self.covariance)), strict=True):
            low, high = bounds[name]
            margin = min(float(std), 0.25 * (high - low))
            inside[name] = float(np.clip(self.optimum[name], low + margin, high - margin))
        return inside

    def nuts(self, **options: Any) -> NUTS:
        """Return NumPyro's NUTS, started at the fit, with the fit's covariance as mass matrix.

        Options are those of `numpyro.infer.NUTS` and override these.
        """
        about_fit: dict[str, Any] = {
            "init_strategy": init_to_value(values=self.start),
            "inverse_mass_matrix": {tuple(self.prior): jnp.asarray(self._covariance())},
            "dense_mass": [tuple(self.prior)],
            "adapt_mass_matrix": False,
        }
        return NUTS(self, **{**about_fit, **options})

    def random_walk(self, step_size: float | None = PAPER.step_size) -> "RandomWalk":
        """Return the Metropolis-Hastings random walk of Teloli et al., section 3.2.

        `step_size` is the standard deviation of a proposal over the width of each parameter's box,
        by default the published one. If None, the warm-up tunes it with the shape of the fit.
        """
        return RandomWalk(self.problem, step_size, self)

    def _covariance(self) -> Float[np.ndarray, "parameter parameter"]:
        r"""Return the covariance of the fit in NumPyro's unconstrained coordinates.

        $$\Sigma_z^{-1} = J\,\Sigma^{-1} J + \tfrac{3}{\pi^2} I, \qquad J = d\theta / dz$$

        with 3 / pi^2 the precision of a uniform prior's logit. A stated density adds none, because
        the fit includes it already.
        """
        slope, precision = [], []
        for name, value in self.start.items():
            transform = biject_to(self.prior[name].support)
            z = jnp.asarray(transform.inv(value))
            slope.append(float(jax.grad(lambda x, to=transform: jnp.asarray(to(x)))(z)))
            precision.append(LOGIT_PRIOR_PRECISION if name in self.uniform else 0.0)
        std = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(std, std)
        weight = np.array(slope) / std
        return np.linalg.inv(
            np.linalg.inv(correlation) * np.outer(weight, weight) + np.diag(precision)
        )


class RandomWalk(MCMCKernel):
    """The random-walk sampler as a NumPyro kernel, for `numpyro.infer.MCMC`."""

    def __init__(self, problem: Problem, step_size: float | None, model: NumpyroModel) -> None:
        self._problem, self._step_size, self._model = problem, step_size, model
        self._options = Options(step_size=step_size)

    @property
    def sample_field(self) -> str:
        """The name of the stored field of the state: the position in normalised coordinates."""
        return "x"

    @property
    def model(self) -> NumpyroModel:
        """The model of the posterior to sample."""
        return self._model

    def init(
        self,
        rng_key: Array,
        num_warmup: int,
        init_params: Any,
        model_args: Any,
        model_kwargs: Any,
    ) -> WalkState:
        """Return the initial state of every chain, at the fit."""
        self._options = self._options._replace(num_warmup=num_warmup)
        chain = kernel(self._problem, self._options)
        origin = jnp.zeros(len(self._problem.box.names))

        def begun(key: Key[Array, ""]) -> WalkState:
            return chain.init(key, origin)

        return begun(rng_key) if _is_one(rng_key) else jax.vmap(begun)(rng_key)

    def sample(self, state: WalkState, model_args: Any, model_kwargs: Any) -> WalkState:
        """Return the state after one more step of every chain."""
        step = kernel(self._problem, self._options).step
        return step(state) if _is_one(state.rng_key) else jax.vmap(step)(state)

    def postprocess_fn(self, model_args: Any, model_kwargs: Any) -> Any:
        """Return a function from normalised coordinates to the model's variables by name."""
        box = self._problem.box

        def sites(x: Float[Array, " parameter"]) -> dict[str, Any]:
            values = box.lower + x * (box.upper - box.lower)
            return {name: values[..., i] for i, name in enumerate(box.names)}

        return sites

    def get_diagnostics_str(self, state: WalkState) -> str:
        """Return the acceptance rate for the progress bar."""
        return f"acc. prob={np.mean(state.accept_prob):.2f}"


def _is_one(key: Array) -> bool:
    typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    return key.ndim == (0 if typed else 1)
