"""The posterior to draw from and the kernels that draw from it, in one coordinate."""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from numpyro.infer import NUTS
from numpyro.infer.mcmc import MCMCKernel
from numpyro.infer.util import potential_energy

from jbw.inference.box import Box, from_unit
from jbw.inference.elliptical_slice import EllipticalSlice
from jbw.inference.laplace import Whitening, from_logit
from jbw.inference.model import LogLikelihood, LogPrior, box_model
from jbw.inference.random_walk import RandomWalk

ChainMethod = Literal["sequential", "vectorized", "parallel"]


class Settings(NamedTuple):
    """What is compiled in.

    Attributes:
        sampler: "nuts", "elliptical_slice" or "random_walk".
        num_warmup: Steps of warm-up, the only ones that adapt.
        chain_method: How chains share the machine.
        target_accept: Acceptance that the step size is tuned to.
        step_size: Fixed step of the random walk in x; None to tune it.
        adapt_mass: Whether NUTS learns a dense mass matrix in warm-up.
        whitened: Whether the whitening comes from a covariance.
        forward_mode: Whether gradients are taken in forward mode.
        max_tree_depth: Doublings of a NUTS trajectory at most.
    """

    sampler: str
    num_warmup: int
    chain_method: str
    target_accept: float
    step_size: float | None
    adapt_mass: bool
    whitened: bool
    forward_mode: bool
    max_tree_depth: int


class Problem(eqx.Module):
    """A posterior to draw from.

    Attributes:
        log_likelihood: (theta, data) to independent terms [nats].
        log_prior: theta to a further log prior density [nats], or None.
        box: Prior bounds.
        data: Whatever the likelihood takes.
        whitening: Coordinate of NUTS.
    """

    log_likelihood: LogLikelihood
    log_prior: LogPrior | None
    box: Box
    data: PyTree
    whitening: Whitening

    @property
    def model(self) -> Callable[..., None]:
        """The posterior as a NumPyro model."""
        return box_model(self.log_likelihood, self.box, self.log_prior)


class Draw(NamedTuple):
    """What one step leaves: the parameters by name, and the sampler's statistics by name."""

    theta: dict[str, Float[Array, "..."]]
    stats: dict[str, Array]


def potential_of(problem: Problem) -> Callable[[Array], Array]:
    """Minus the log density of the whitened coordinate, NumPyro's Jacobian included.

    Args:
        problem: The posterior.

    Returns:
        w to minus the log density [nats], of which only |det L| is left out.
    """

    def potential(w: Float[Array, " parameter"]) -> Float[Array, ""]:
        z = problem.whitening.centre + problem.whitening.factor @ w
        sites = dict(zip(problem.box.names, z, strict=True))
        return jnp.asarray(potential_energy(problem.model, (problem.data,), {}, sites))

    return potential


def make_kernel(problem: Problem, settings: Settings) -> tuple[MCMCKernel, tuple[Any, ...]]:
    """The kernel that these settings ask for, and the arguments of its model.

    Args:
        problem: The posterior.
        settings: Kernel and options.

    Returns:
        A NumPyro kernel, not yet bound, and its `model_args`.
    """
    if settings.sampler == "nuts":
        kernel = NUTS(
            potential_fn=potential_of(problem),
            dense_mass=True,
            adapt_mass_matrix=settings.adapt_mass,
            target_accept_prob=settings.target_accept,
            max_tree_depth=settings.max_tree_depth,
            forward_mode_differentiation=settings.forward_mode,
        )
        return kernel, ()
    if settings.sampler == "elliptical_slice":
        return EllipticalSlice(potential_of(problem)), ()
    # The published walk, with its fixed step, is the same in every direction.
    shaped = settings.whitened and settings.step_size is None
    scale = _random_walk_scale(problem) if shaped else None
    kernel = RandomWalk(problem.model, settings.step_size, settings.target_accept, scale)
    return kernel, (problem.data,)


def _random_walk_scale(problem: Problem) -> Float[Array, "parameter parameter"]:
    """The whitening carried from z to x at its centre, in the order of the sorted names."""
    x = jax.nn.sigmoid(problem.whitening.centre)
    order = np.argsort(problem.box.names)
    return ((x * (1 - x))[:, None] * problem.whitening.factor)[order]


def bind_kernel(
    kernel: MCMCKernel,
    problem: Problem,
    settings: Settings,
    model_args: tuple[Any, ...],
) -> None:
    """Let a kernel bind its functions, which NumPyro does in `init`; nothing is computed.

    Args:
        kernel: A kernel that has not run.
        problem: The posterior.
        settings: Kernel and options.
        model_args: Arguments of the kernel's model.
    """
    position = kernel_position(problem.whitening.centre, problem, settings)
    init = partial(
        kernel.init, num_warmup=settings.num_warmup, model_args=model_args, model_kwargs={}
    )
    jax.eval_shape(lambda key: init(key, init_params=position), jax.random.key(0))


def kernel_position(z: Float[Array, " parameter"], problem: Problem, settings: Settings) -> PyTree:
    """A point in the kernel's own coordinate: x by site for the walk, whitened for the others.

    Args:
        z: Logit of the unit coordinate.
        problem: The posterior.
        settings: Kernel and options.

    Returns:
        What the kernel takes as `init_params`.
    """
    if settings.sampler == "random_walk":
        return dict(zip(problem.box.names, jax.nn.sigmoid(z), strict=True))
    return jnp.linalg.solve(problem.whitening.factor, z - problem.whitening.centre)


def read_draw(state: PyTree, problem: Problem, settings: Settings) -> Draw:
    """The parameters and statistics that a state of a kernel holds.

    Args:
        state: State of one chain.
        problem: The posterior.
        settings: Kernel and options.

    Returns:
        One draw.
    """
    if settings.sampler == "elliptical_slice":
        z = problem.whitening.centre + problem.whitening.factor @ state.w
        return Draw(from_logit(z, problem.box), {"n_steps": state.num_steps})
    if settings.sampler == "nuts":
        z = problem.whitening.centre + problem.whitening.factor @ state.z
        return Draw(
            from_logit(z, problem.box),
            {
                "diverging": state.diverging,
                "acceptance_rate": state.accept_prob,
                "n_steps": state.num_steps,
                "reached_max_tree_depth": state.num_steps >= 2**settings.max_tree_depth - 1,
                "energy": state.energy,
                "step_size": state.adapt_state.step_size,
            },
        )
    x = jnp.stack([state.x[name] for name in problem.box.names])
    return Draw(
        from_unit(x, problem.box),
        {
            "acceptance_rate": state.info.accept_prob,
            "accepted": state.info.accepted,
            "failed": state.info.failed,
            "step_size": jnp.exp(state.log_step),
        },
    )
