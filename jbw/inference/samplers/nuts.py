"""NumPyro's no-U-turn sampler, which follows the model's gradient, in normalised coordinates."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, PyTree
from numpyro.infer import NUTS

from jbw.inference.samplers.chains import Draw, Kernel
from jbw.inference.space.problem import Problem


class Options(NamedTuple):
    """The options of NUTS.

    If `adapt_mass` is None, a dense mass matrix is adapted unless a fit has whitened the
    coordinate.
    """

    num_warmup: int = 1000
    num_samples: int = 1000
    num_chains: int = 4
    chain_method: str = "sequential"
    target_accept: float = 0.8
    adapt_mass: bool | None = None
    forward_mode: bool = False
    max_tree_depth: int = 10


def kernel(problem: Problem, options: Options) -> Kernel:
    """Return the kernel of NUTS by Hoffman, Gelman (2014), JMLR 15, 1593.

    `diverging` marks trajectories with a large error of energy or with no finite likelihood.
    """
    adapt = not problem.located if options.adapt_mass is None else options.adapt_mass
    nuts = NUTS(
        potential_fn=lambda w: -problem.log_density(w),
        dense_mass=True,
        adapt_mass_matrix=adapt,
        target_accept_prob=options.target_accept,
        max_tree_depth=options.max_tree_depth,
        forward_mode_differentiation=options.forward_mode,
    )

    def init(key: Key[Array, ""], w: Float[Array, " parameter"]) -> PyTree:
        return nuts.init(key, options.num_warmup, w, (), {})

    # NumPyro creates its functions in `init`, which is only traced here, without computing.
    origin = jnp.zeros_like(problem.whitening.centre)
    jax.eval_shape(partial(init, w=origin), jax.random.key(0))

    def read(state: PyTree) -> Draw:
        stats = {
            "diverging": state.diverging,
            "acceptance_rate": state.accept_prob,
            "n_steps": state.num_steps,
            "reached_max_tree_depth": state.num_steps >= 2**options.max_tree_depth - 1,
            "energy": state.energy,
            "step_size": state.adapt_state.step_size,
        }
        return Draw(problem.theta(state.z), stats)

    return Kernel(init, lambda state: nuts.sample(state, (), {}), read)
