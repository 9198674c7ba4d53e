"""Whatever was measured, in one likelihood of one joint."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.offsets import Estimate, run_numbers, shrunk
from jbw.inference.scatter import Levels, log_density_of_offsets
from jbw.observables import decay_likelihood, harmonics, linear, loops, response
from jbw.observables.decay import Decays
from jbw.observables.harmonics import Points
from jbw.observables.linear import LineReading
from jbw.observables.loops import Loops
from jbw.observables.repeats import OFFSETS, estimate_of, weighted
from jbw.observables.response import Records
from jbw.observables.runs import assemblies_of
from jbw.observables.spectral_lines import values_of

Repeated = Records | Points | Loops
Part = Repeated | LineReading | Decays
_COMPARE = {Records: response.compare, Points: harmonics.compare, Loops: loops.compare}


class Evidence(eqx.Module):
    """All that the joint posterior is made from.

    Attributes:
        parts: The reduced data of each kind of test.
        held: Parameters held at their values, by name; any others are being inferred.
        scatters: Nodes of the prior of the runs' scatter of omega_n [rad/s] and zeta [-], and of
            their assemblies' where there are any; no columns where runs have no offsets.
        scatter: The scatter assumed in least squares.
    """

    parts: tuple[Part, ...]
    held: dict[str, Float[Array, ""]]
    scatters: Float[Array, "node level_own"]
    scatter: Float[Array, " own"]


def evidence(parts: Sequence[Part], held: Mapping[str, float] | None = None) -> Evidence:
    """Gather parts whose runs have no offsets of their own.

    Args:
        parts: The reduced data.
        held: Parameters that are not updated.
    """
    fixed = {name: jnp.asarray(float(value)) for name, value in (held or {}).items()}
    return Evidence(tuple(parts), fixed, jnp.zeros((1, 0)), jnp.zeros(0))


def log_likelihood(theta: Mapping[str, Array], data: Evidence) -> Float[Array, " term"]:
    """Terms of the log likelihood: one a group, then that of the runs' offsets.

    The noise of every group is integrated out, and so are the offsets.

    Args:
        theta: Parameters by name.
        data: The evidence.

    Returns:
        Terms [nats], up to a constant.

    Reference:
        Eqs. (36), (37).
    """
    everything = {**data.held, **theta}
    if not offsets_of(data):
        return jnp.concatenate([_terms_alone(everything, part) for part in data.parts])
    found = estimates(everything, data)
    offsets = log_density_of_offsets(found, levels_of(data), data.scatters)
    return jnp.append(found.log_density, offsets)


def _terms_alone(theta: Mapping[str, Array], part: Part) -> Float[Array, " term"]:
    if isinstance(part, Decays):  # whose records always have a shift of their own
        return decay_likelihood.log_likelihood(theta, part)
    return _estimate(theta, part).log_density


def estimates(theta: Mapping[str, Array], data: Evidence) -> Estimate:
    """What every group says of the offsets of its run."""
    found = [_estimate(theta, part) for part in data.parts]
    return jax.tree.map(lambda *rows: jnp.concatenate(rows), *found)


def _estimate(theta: Mapping[str, Array], part: Part) -> Estimate:
    if isinstance(part, LineReading):
        return linear.estimate_of(theta, part)
    if isinstance(part, Decays):
        return decay_likelihood.estimate_of(theta, part, len(OFFSETS))
    return estimate_of(compare(theta, part), part.repeats)


def compare(theta: Mapping[str, Array], part: Repeated) -> Float[Array, "group value"]:
    """Means less predictions of every group of a part."""
    return _COMPARE[type(part)](theta, part)


def residual(theta: Mapping[str, Array], data: Evidence) -> Float[Array, " values"]:
    """Residuals in standard errors, the runs' offsets at their best, for least squares.

    Reference:
        Eqs. (38), (41), (42).
    """
    everything = {**data.held, **theta}
    left, offsets = _beside_offsets(everything, data)
    rows = [row.ravel() for row in (*left, offsets)]
    rows += [
        decay_likelihood.residual(everything, part)
        for part in data.parts
        if isinstance(part, Decays)
    ]
    return jnp.concatenate(rows)


def _beside_offsets(
    theta: Mapping[str, Array], data: Evidence
) -> tuple[list[Float[Array, "group value"]], Float[Array, "run own"]]:
    """Residuals of everything but decays in standard errors, and the runs' offsets over scatter."""
    others = [part for part in data.parts if not isinstance(part, Decays)]
    pairs = [_weighted(theta, part) for part in others]
    left = [pair[0] for pair in pairs]
    if not (offsets_of(data) and others):
        return left, jnp.zeros((0, 0))
    names = run_numbers(tuple(name for part in others for name in _runs(part)))
    return shrunk(left, [pair[1] for pair in pairs], names, data.scatter)


def _weighted(
    theta: Mapping[str, Array], part: Repeated | LineReading
) -> tuple[Float[Array, "group value"], Float[Array, "group own value"]]:
    if isinstance(part, LineReading):
        return linear.whitened(theta, part)[:2]
    return weighted(compare(theta, part), part.repeats)


def offsets_of(data: Evidence) -> bool:
    """Whether runs have offsets of their own."""
    return data.scatters.shape[1] > 0


def levels_of(data: Evidence) -> Levels:
    """Which run each group belongs to, and which assembly each run, where assemblies scatter."""
    names = run_names(data)
    assemblies = assemblies_of(tuple(dict.fromkeys(names)))
    if data.scatters.shape[1] == 2 * len(OFFSETS):
        return run_numbers(names), assemblies
    return (run_numbers(names),)


def run_names(data: Evidence) -> tuple[str, ...]:
    """Name of the run of each group, in the order of the terms."""
    return tuple(name for part in data.parts for name in _runs(part))


def labels(data: Evidence) -> tuple[str, ...]:
    """Name of each group, in the order of the terms."""
    return tuple(name for part in data.parts for name in _labels(part))


def _runs(part: Part) -> tuple[str, ...]:
    if isinstance(part, LineReading):
        return (part.run,)
    if isinstance(part, Decays):
        return part.names
    return part.repeats.runs


def _labels(part: Part) -> tuple[str, ...]:
    if isinstance(part, LineReading):
        return (f"line fit of {part.run}",)
    if isinstance(part, Decays):
        return part.names
    return part.repeats.labels


def best_offsets(theta: Mapping[str, float], data: Evidence) -> dict[str, np.ndarray]:
    """Best offsets of omega_n and zeta of each run but those of decays, at one point.

    Args:
        theta: Where the joint of all runs is.
        data: The evidence, whose runs have offsets.
    """
    everything = {**data.held, **{name: jnp.asarray(value) for name, value in theta.items()}}
    _, scaled = _beside_offsets(everything, data)
    names = [n for part in data.parts if not isinstance(part, Decays) for n in _runs(part)]
    return dict(zip(dict.fromkeys(names), np.asarray(scaled * data.scatter), strict=True))


def with_directions(
    theta: Mapping[str, float],
    data: Evidence,
    offsets: Mapping[str, Float[np.ndarray, " own"]] | None = None,
) -> Evidence:
    """The evidence with the change of every prediction by the offsets of its run, at one point.

    Args:
        theta: Where to linearise.
        data: The evidence.
        offsets: Offset of each run, by name, about which records are linearised; zero where it is
            not named.
    """
    everything = {**data.held, **{name: jnp.asarray(value) for name, value in theta.items()}}
    centre, known = np.array([float(everything[name]) for name in OFFSETS]), offsets or {}

    def placed(part: Part) -> Part:
        if isinstance(part, Records):
            own = [centre + known.get(run, 0.0) for run in part.repeats.runs]
            part = replace(part, origin=jnp.asarray(np.stack(own)))
        return _with_directions(everything, part)

    return replace(data, parts=tuple(placed(part) for part in data.parts))


@eqx.filter_jit
def _with_directions(theta: Mapping[str, Array], part: Part) -> Part:
    def shifted(offset: Float[Array, " own"]) -> dict[str, Array]:
        return {**theta, **{name: theta[name] + b for name, b in zip(OFFSETS, offset, strict=True)}}

    none = jnp.zeros(len(OFFSETS))
    if isinstance(part, Decays):
        return part
    if isinstance(part, LineReading):
        slope = jax.jacfwd(lambda offset: linear.predict(shifted(offset), part))(none)
        return replace(part, directions=slope.T)
    if isinstance(part, Records):
        slope = jax.jacfwd(
            lambda b: values_of(
                response.predict(theta, replace(part, origin=part.origin + b)), part.lines
            )
        )(none)
    else:
        slope = -jax.jacfwd(lambda offset: compare(shifted(offset), part))(none)
    found = replace(part.repeats, directions=jnp.moveaxis(slope, -1, 1))
    return replace(part, repeats=found)
