"""Draw from a posterior in a box: one call, any sampler, one container."""

import time
import warnings
from collections.abc import Mapping
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key, PyTree

from jbw.errors import ConfigError
from jbw.inference.box import Box
from jbw.inference.chains import num_devices_for
from jbw.inference.direct import DIRECT, draw_directly
from jbw.inference.growing import Progress, Starts, grow_chains
from jbw.inference.keeping import Kept
from jbw.inference.kernels import ChainMethod, Problem, Settings
from jbw.inference.model import LogLikelihood, LogPrior
from jbw.inference.posterior import looked_at, posterior_tree
from jbw.inference.precision import require_float64
from jbw.inference.random_walk import PAPER
from jbw.inference.start import chain_starts

SAMPLERS = ("nuts", "elliptical_slice", "random_walk", "random_walk_paper", *DIRECT)
LAPLACE = ("elliptical_slice", "importance")  # draw about a Gaussian, and need it
DEFAULT_DRAWS = 1000  # of warm-up, and kept, in each chain


def sample(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: PyTree = None,
    *,
    sampler: str = "nuts",
    num_warmup: int | None = None,
    num_samples: int | None = None,
    num_chains: int = 4,
    chain_method: str = "sequential",
    start: Mapping[str, Any] | None = None,
    covariance: Float[np.ndarray, "parameter parameter"] | None = None,
    log_prior: LogPrior | None = None,
    target_accept: float | None = None,
    step_size: float | None = None,
    adapt_mass: bool | None = None,
    forward_mode: bool = False,
    max_tree_depth: int = 10,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
    progress: Progress | None = None,
    kept: Kept | None = None,
) -> xr.DataTree:
    """Sample the posterior of a log likelihood and a uniform prior in a box.

    Compiled once for a `log_likelihood`, names, shapes and options: further calls with the same
    function object run at once on other data or bounds. Under `vectorized` all chains wait for the
    longest trajectory, so where a likelihood is slow (an ODE) prefer `parallel` or `sequential`.
    Equal keys give equal draws for one chain method, machine and set of versions.

    Args:
        key: Random key.
        log_likelihood: (theta, data) to independent terms [nats], whose sum is the log likelihood;
            non-finite where a solve failed. Every draw stores its terms: return one a record or a
            point, not one a sample of a long record.
        box: Prior bounds.
        data: Whatever `log_likelihood` takes, arrays in any pytree.
        sampler: "nuts"; "elliptical_slice" (no gradient, about four evaluations a draw; needs
            `covariance` and a posterior close to that Gaussian); "random_walk" (tuned);
            "random_walk_paper" (fixed step, 85 + 765). With the evidence: "importance" (weighted
            draws about `covariance`, which it needs); "tempered_smc" and "nested" (from the whole
            box, or from heavy tails about `covariance`; a chain is a run); "quadrature" (exact, up
            to four parameters).
        num_warmup: Steps of adaptation in each chain, discarded; 1000 when None.
        num_samples: Draws kept of each chain; 1000 when None. Also the particles of a run of
            "tempered_smc", and twice the live points of "nested".
        num_chains: Chains.
        chain_method: "sequential", "vectorized", or "parallel" over the devices of JAX.
        start: Start by name, one value for all or one a chain; None: uniform in the box.
        covariance: Laplace covariance at `start` in the parameters' units: sampling is whitened by
            it and chains start two of its standard deviations out.
        log_prior: theta to a further log prior density [nats].
        target_accept: Acceptance to tune to; 0.8 for NUTS and 0.5 for the walk when None.
        step_size: Fixed step of a random walk in x; tuned when None.
        adapt_mass: Whether NUTS learns a mass matrix; when None, only without `covariance`.
        forward_mode: Whether gradients are taken in forward mode.
        max_tree_depth: Doublings of a NUTS trajectory at most.
        attrs: `units` and `long_name` by parameter, kept beside the draws.
        progress: Called with a `SoFar` after every chunk of steps; chains only.
        kept: Where unfinished chains outlive the process, to go on from as if never stopped.

    Returns:
        Groups posterior, sample_stats, log_likelihood, log_prior and timing. `failed` counts the
        walk's proposals whose likelihood was not finite; a trajectory of NUTS that meets one is
        `diverging`. The root's attributes hold num_evaluations, of the log likelihood with the
        warm-up's, and where the sampler gives them log_evidence and log_evidence_error [nats].

    Raises:
        ConfigError: An option, start or covariance that cannot be used, or a float32 session.
        ModelError: No possible start.

    Reference:
        Eqs. (32), (33), (35), (36), (37).
    """
    require_float64()
    paper = sampler == "random_walk_paper"
    draws = _default(num_samples, PAPER.num_samples if paper else DEFAULT_DRAWS)
    warmup = _default(num_warmup, PAPER.num_warmup if paper else DEFAULT_DRAWS)
    _check_options(sampler, chain_method, draws, warmup, num_chains, covariance is not None)
    settings = Settings(
        sampler="random_walk" if paper else sampler,
        num_warmup=warmup,
        chain_method=_available(chain_method, num_chains),
        target_accept=_default(target_accept, 0.8 if sampler == "nuts" else 0.5),
        step_size=_default(step_size, PAPER.step_size) if paper else step_size,
        adapt_mass=_default(adapt_mass, covariance is None),
        whitened=covariance is not None,
        forward_mode=forward_mode,
        max_tree_depth=max_tree_depth,
    )
    clock, earlier = time.perf_counter(), 0.0
    centre, spread, whitening = chain_starts(start, covariance, box, num_chains)
    problem = Problem(log_likelihood, log_prior, box, data, whitening)
    if sampler in DIRECT:
        drawn, terms, extra = draw_directly(key, problem, draws, num_chains, settings)
        (theta, stats, more, groups) = drawn
    else:
        starts = Starts(key, centre, spread)
        rows, earlier = grow_chains(starts, draws, problem, settings, progress, kept)
        (theta, stats), terms, extra = rows
        more = {**_settings_as_attributes(settings), "num_evaluations": looked_at(stats, warmup)}
        groups = {}
    seed = [int(word) for word in np.ravel(jax.random.key_data(key))]
    return posterior_tree(
        theta,
        stats,
        terms,
        extra - float(jnp.sum(jnp.log(box.upper - box.lower))),
        box,
        attrs=attrs or {},
        facts={"sampler": sampler, "seed": seed, **more},
        groups=groups,
        wall_time=time.perf_counter() - clock + earlier,
    )


def _settings_as_attributes(settings: Settings) -> dict[str, str | int | float]:
    """The settings as netCDF can store them: truth values as 0 and 1, absent ones left out."""
    values = {name: v for name, v in settings._asdict().items() if v is not None}
    del values["sampler"]  # the caller's word says more
    return {name: int(v) if isinstance(v, bool) else v for name, v in values.items()}


def _default(value: Any, otherwise: Any) -> Any:
    return otherwise if value is None else value


def _available(method: str, num_chains: int) -> str:
    if method != "parallel" or num_devices_for(num_chains) > 1 or num_chains == 1:
        return method
    warnings.warn(
        f"Chain method `parallel` needs devices that share {num_chains} chains evenly, but JAX has "
        f"{jax.device_count()}: the chains run one after the other. Set XLA_FLAGS="
        "--xla_force_host_platform_device_count=2 before JAX starts to use two processor cores.",
        stacklevel=3,
    )
    return "sequential"


def _check_options(
    sampler: str,
    chain_method: str,
    num_samples: int,
    num_warmup: int,
    num_chains: int,
    whitened: bool,
) -> None:
    for name, word, known in (
        ("sampler", sampler, SAMPLERS),
        ("chain_method", chain_method, get_args(ChainMethod)),
    ):
        if word not in known:
            raise ConfigError(f"Argument `{name}` must be one of {', '.join(known)}, not {word!r}.")
    least = {"num_samples": 1, "num_warmup": 0, "num_chains": 1}
    given = {"num_samples": num_samples, "num_warmup": num_warmup, "num_chains": num_chains}
    for name, value in given.items():
        if value < least[name]:
            raise ConfigError(f"Argument `{name}` must be at least {least[name]}, but is {value}.")
    if sampler in LAPLACE and not whitened:
        raise ConfigError(
            f"Argument `covariance` must be given for the sampler {sampler}, but is None.",
            why="It draws from a Gaussian and corrects what the posterior differs from it.",
            remedy='Pass the start and covariance of a fit, or use sampler="nuts".',
        )
