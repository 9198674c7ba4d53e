"""Posterior sampling: one call for every sampler, one form of the result."""

import time
import warnings
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key, PyTree
from numpy.typing import NDArray

from jbw.errors import ConfigError, did_you_mean
from jbw.inference.samplers.chains import (
    Draws,
    MakeKernel,
    Starts,
    draws_of,
    num_devices_for,
    starts_of,
    terms_at,
)
from jbw.inference.samplers.chunked_run import UNSUPERVISED, Supervision, grow_chains
from jbw.inference.samplers.evidence import require_possible
from jbw.inference.samplers.register import (
    Sampler,
    default_options,
    module_of,
    options_of,
    sampler_named,
)
from jbw.inference.space.box import Box, bounds_by_name, require_float64
from jbw.inference.space.problem import LogLikelihood, Problem, Target, log_volume, problem_of
from jbw.inference.space.reparametrisation import Reparametrisation, in_box

ChainMethod = Literal["sequential", "vectorized", "parallel"]
VERSIONED = ("jax", "jaxlib", "numpyro", "numpy")
# smallest allowed numbers of warm-up steps, draws and chains
LEAST = {"num_warmup": 0, "num_samples": 1, "num_chains": 1}
# keyword arguments in the signature of `sample`, and those that every sampler has
SIGNED = ("data", "sampler", "start", "covariance", "coordinates")
REQUESTED = (*LEAST, "chain_method")
SHARED = (*REQUESTED, "options", "attrs", *Supervision._fields)
SamplerOutput = tuple[
    Draws, NDArray[np.float64], float
]  # the draws, their log likelihoods, and the time spent in earlier runs [s]
_drawn = eqx.filter_jit(draws_of)


class SamplingRequest(NamedTuple):
    """The choice of a sampler, with its numbers of chains, warm-up steps and draws.

    Attributes:
        sampler: Name of a sampler in the register.
        num_warmup: Number of discarded steps of each chain; the sampler's own if None.
        num_samples: Number of draws of each chain; the sampler's own if None.
        num_chains: Number of chains.
        chain_method: One of the methods in `ChainMethod`.
        options: Further options of the sampler; those that it does not have are ignored.
    """

    sampler: str = "nuts"
    num_warmup: int | None = None
    num_samples: int | None = None
    num_chains: int = 4
    chain_method: str = "sequential"
    options: Mapping[str, Any] | None = None


def sample(
    key: Key[Array, ""],
    log_likelihood: LogLikelihood,
    box: Box,
    data: PyTree = None,
    *,
    sampler: str = "nuts",
    start: Mapping[str, Any] | None = None,
    covariance: Float[np.ndarray, "parameter parameter"] | None = None,
    coordinates: Reparametrisation | None = None,
    **options: Any,
) -> xr.DataTree:
    """Sample the posterior of a log likelihood, with uniform priors between bounds.

    The function is compiled once for a `log_likelihood`, names, shapes and options. Under
    `vectorized` all chains wait for the longest trajectory: if a likelihood is slow (an ODE) prefer
    `parallel` or `sequential`. Equal keys give equal draws for one chain method, machine and set of
    versions.

    Args:
        key: Random key.
        log_likelihood: Function of (theta, data) that returns independent terms [nats], whose sum
            is the log likelihood; non-finite where a solve failed. The terms of every draw are
            stored, so there should not be one per sample of a record.
        box: Prior bounds.
        data: Data argument of `log_likelihood`, arrays in any pytree.
        sampler: Name in the register: "nuts"; "elliptical_slice" (about four evaluations per draw);
            "random_walk" (tuned); "random_walk_paper" (fixed step, 85 + 765). The following ones
            also give the evidence: "importance"; "amis" (importance sampling in adaptive rounds);
            "tempered_smc" and "nested" (each chain is a run); "quadrature" (exact, up to four
            parameters). "elliptical_slice", "importance" and "amis" need `covariance`.
        start: Start by name, as one value for all or one per chain; None: uniform in the box.
        covariance: Laplace covariance at `start`, in the parameters' units: it whitens sampling.
        coordinates: Other coordinates to sample in, with their start and covariance, in place of
            `start` and `covariance`.
        **options: The amounts to draw: `num_warmup`, discarded steps of each chain;
            `num_samples`, draws of each chain, particles of "tempered_smc", or twice the live
            points of "nested" (both the sampler's own if None); `num_chains`, by default 4;
            `chain_method`, "sequential", "vectorized", or "parallel" over the devices of JAX.
            The sampler's own options by the names in its record `Options`, such as
            `target_accept`; or a mapping `options` of them, of which the sampler ignores those
            that it does not have, so that several samplers can share it.
            Also `attrs`, `units` and `long_name` by parameter, which are stored with the draws;
            and the supervision of the run by `progress`, `kept` and `until`, as in `Supervision`.

    Returns:
        Groups posterior, sample_stats, log_likelihood, log_prior and timing. The root's attributes
        contain num_evaluations, including the warm-up, and log_evidence and log_evidence_error
        [nats] if the sampler gives them.

    Raises:
        ConfigError: A keyword does not exist; an option, start or covariance cannot be used; or the
            session is in float32.
        ModelError: No start has a finite likelihood.

    Reference:
        Eqs. (32), (33), (35), (36), (37).
    """
    require_float64()
    _require_keywords(sampler_named(sampler), options)
    request = _request(sampler, options)
    _check(request)
    return draw_posterior(
        key,
        Target(log_likelihood, box, data),
        request,
        coordinates or in_box(box, start, covariance, request.num_chains),
        supervision=Supervision(**_chosen(options, Supervision._fields)),
        attrs=options.get("attrs"),
    )


def draw_posterior(
    key: Key[Array, ""],
    target: Target,
    request: SamplingRequest,
    coordinates: Reparametrisation | None = None,
    *,
    supervision: Supervision = UNSUPERVISED,
    attrs: Mapping[str, Mapping[str, str]] | None = None,
) -> xr.DataTree:
    """Draw from a posterior as requested, after all options have been checked.

    Args:
        key: Random key.
        target: The posterior.
        request: The sampler and the amounts to draw.
        coordinates: Coordinates to sample in, with start and covariance of a fit; the box itself if
            None.
        supervision: Listeners, checkpoint and end of the run.
        attrs: `units` and `long_name` by parameter, which the draws carry.

    Returns:
        The same tree as from `sample`.
    """
    require_float64()
    entry = sampler_named(request.sampler)
    _check(request)
    place = coordinates or in_box(target.box, None, None, request.num_chains)
    _check_suits(entry, place, target.box)
    method = _available(request.chain_method, request.num_chains)
    sizes = {name: getattr(request, name) for name in LEAST}
    chosen = options_of(entry, **sizes, chain_method=method, **(request.options or {}))
    clock = time.perf_counter()
    problem = problem_of(target.log_likelihood, target.box, target.data, place)
    module = module_of(entry)
    if entry.in_rounds:
        outcome = module.gather(key, problem, chosen, *supervision)
    elif hasattr(module, "draw"):
        outcome = _at_once(entry, key, problem, chosen)
    else:
        starts = starts_of(key, problem, place.start, request.num_chains)
        outcome = _in_chunks(starts, problem, module.kernel, chosen, supervision)
    drawn, terms, earlier = outcome
    tree = _tree(drawn, terms, target.box, attrs or {})
    spent = {"wall_s": time.perf_counter() - clock + earlier}
    # The time is stored separately, since it differs between runs that are otherwise equal.
    tree["timing"] = xr.DataTree(xr.Dataset(attrs=spent))
    tree.attrs |= {
        **_plain(chosen._asdict()),
        "chain_method": method,
        "whitened": int(problem.located),
        "sampler": request.sampler,
        "seed": [int(word) for word in np.ravel(jax.random.key_data(key))],
        **_plain(drawn.facts),
        **{f"version_{name}": version(name) for name in VERSIONED},
    }
    return tree


def seconds_of(tree: xr.DataTree) -> float:
    """Return the time in which draws were made [s]."""
    return tree["timing"].attrs["wall_s"]


def _require_keywords(entry: Sampler, keywords: Mapping[str, Any]) -> None:
    """Raise a ConfigError for keywords that neither `sample` nor the sampler knows."""
    names = dict.fromkeys((*SIGNED, *SHARED, *default_options(entry)._fields))
    for keyword in keywords:
        if keyword not in names:
            raise ConfigError(
                f"Argument `{keyword}` does not exist: neither `sample` nor the sampler "
                f"{entry.name} has it.",
                remedy=f"{did_you_mean(keyword, names)}The arguments are {', '.join(names)}.",
            )


def _request(sampler: str, keywords: Mapping[str, Any]) -> SamplingRequest:
    """Return the request from keywords of `sample`, merged with options of the sampler."""
    sampler_options = {name: value for name, value in keywords.items() if name not in SHARED}
    options = {**(keywords.get("options") or {}), **sampler_options}
    return SamplingRequest(sampler, **_chosen(keywords, REQUESTED), options=options)


def _chosen(keywords: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Return those keyword arguments that have one of the given names."""
    return {name: keywords[name] for name in names if name in keywords}


def _in_chunks(
    starts: Starts, problem: Problem, make: MakeKernel, options: Any, supervision: Supervision
) -> SamplerOutput:
    """Run chains in chunks of steps, so that progress can be shown and saved meanwhile."""
    (draw, terms), earlier = grow_chains(starts, problem, make, options, *supervision)
    # The warm-up is assumed to need as many evaluations per step as the draws.
    evaluations = np.mean(draw.stats["n_steps"]) if "n_steps" in draw.stats else 1.0
    num_samples = next(iter(draw.theta.values())).shape[1]
    steps = options.num_chains * (options.num_warmup + num_samples)
    facts = {"num_evaluations": round(float(evaluations) * steps), "num_samples": num_samples}
    return Draws(draw.theta, draw.stats, True, True, facts), terms, earlier


def _at_once(entry: Sampler, key: Key[Array, ""], problem: Problem, options: Any) -> SamplerOutput:
    """Draw all samples in one call; return the draws and their log likelihoods."""
    drawn = _drawn(entry, key, problem, options)
    require_possible(bool(drawn.possible))
    if hasattr(module_of(entry), "require_arrival"):
        module_of(entry).require_arrival(bool(drawn.arrived))
    terms = terms_at(drawn.theta, problem)
    return jax.tree.map(lambda v: np.asarray(v) if isinstance(v, Array) else v, drawn), terms, 0.0


def _tree(
    drawn: Draws,
    terms: Float[np.ndarray, "chain draw term"],
    box: Box,
    attrs: Mapping[str, Mapping[str, str]],
) -> xr.DataTree:
    """Return the result tree of a posterior, with prior bounds as attributes of parameters."""
    dims, volume = ("chain", "draw"), float(log_volume(jax.device_get(box)))
    log_prior = np.full(terms.shape[:2], -volume)
    dimensionless = {"units": "1"}
    stats = {**drawn.stats, "lp": np.sum(terms, axis=-1) + log_prior}
    variables = {
        "posterior": {
            name: xr.Variable(
                dims, drawn.theta[name], {"lower": low, "upper": high, **attrs.get(name, {})}
            )
            for name, (low, high) in bounds_by_name(box).items()
        },
        "sample_stats": {
            name: xr.Variable(dims, values, dimensionless) for name, values in stats.items()
        },
        "log_likelihood": {"terms": xr.Variable((*dims, "term"), terms, dimensionless)},
        "log_prior": {"log_prior": xr.Variable(dims, log_prior, dimensionless)},
    }
    coords = {dim: np.arange(size) for dim, size in zip(dims, log_prior.shape, strict=True)}
    datasets = {name: xr.Dataset(content, coords) for name, content in variables.items()}
    datasets["log_likelihood"].coords["term"] = np.arange(terms.shape[-1])
    datasets |= {group: xr.Dataset(dict(content)) for group, content in drawn.groups.items()}
    return xr.DataTree.from_dict(datasets)


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values in a form that netCDF can store: booleans as 0 and 1, without None."""
    plain = {n: np.asarray(value).tolist() for n, value in values.items() if value is not None}
    return {n: int(value) if isinstance(value, bool) else value for n, value in plain.items()}


def _available(method: str, num_chains: int) -> str:
    if method != "parallel" or num_devices_for(num_chains) > 1 or num_chains == 1:
        return method
    warnings.warn(
        f"Chain method `parallel` needs devices that share {num_chains} chains evenly, but JAX has "
        f"{jax.device_count()}: the chains run one after the other. Set XLA_FLAGS="
        "--xla_force_host_platform_device_count=2 before JAX starts to use two processor cores.",
        stacklevel=4,
    )
    return "sequential"


def _check(request: SamplingRequest) -> None:
    methods = get_args(ChainMethod)
    if request.chain_method not in methods:
        raise ConfigError(
            f"Argument `chain_method` must be one of {', '.join(methods)}, "
            f"not {request.chain_method!r}."
        )
    for name, least in LEAST.items():
        value = getattr(request, name)
        if value is not None and value < least:
            raise ConfigError(f"Argument `{name}` must be at least {least}, but is {value}.")


def _check_suits(entry: Sampler, place: Reparametrisation, box: Box) -> None:
    if entry.needs_fit and place.covariance is None:
        raise ConfigError(
            f"Argument `covariance` must be given for the sampler {entry.name}, but is None.",
            why=f"Sampler {entry.name} draws from a Gaussian, and weights the draws by the "
            "posterior.",
            remedy='Pass the start and covariance of a fit, or use sampler="nuts".',
        )
    if not entry.suits(len(box.names)):
        raise ConfigError(
            f"Sampler {entry.name} takes at most {entry.most_parameters} parameters, but the "
            f"posterior has {len(box.names)}.",
            remedy="Use nested or tempered_smc, which also give the evidence.",
        )
