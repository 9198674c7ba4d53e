"""Draws of the posterior carried through the model, a few at a time."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key, PyTree
from numpy.typing import NDArray

from jbw.inference.posterior.summary import evenly_spaced
from jbw.measurement.records import Record
from jbw.observables.observable import OFFSETS
from jbw.observables.samples import motion_under
from jbw.oscillator.laws import quantities_of
from jbw.quantities import LETTER_OF

NUM_DRAWS = 100  # outer quantiles of 99 % bands need about as many
LANES = 8  # draws carried through the model at once
Draws = dict[str, NDArray[np.float64]]
Laws = tuple[str, ...]
References = Mapping[str, tuple[Mapping[str, float], Laws]]  # parameters and laws, by name


def parameter_names(laws: Laws) -> tuple[str, ...]:
    """Names of the oscillator's parameters, those of its laws, and `gain`."""
    own = tuple(quantity.name for quantity in quantities_of(laws))
    return ("omega_n", "zeta", *own, "gain")


def thin(
    posterior: xr.Dataset,
    num_draws: int,
    held: Mapping[str, float] | None = None,
    laws: Laws | None = None,
) -> Draws:
    """Evenly spaced draws over all chains, with what was held beside them.

    Args:
        posterior: Posterior group with dimensions (chain, draw).
        num_draws: Draws to keep at most.
        held: Parameters that were not updated, the same in every draw.
        laws: Laws of the joint; those of runs that do not name theirs when None.

    Returns:
        Each parameter of the joint, and `gain`, to its draws.
    """
    keep = evenly_spaced(posterior, num_draws)
    fixed = {name: np.full(len(keep), float(value)) for name, value in (held or {}).items()}
    wanted = parameter_names(unnamed_laws(posterior) if laws is None else laws)
    names = [name for name in wanted if name in posterior]
    return {**fixed, **{name: posterior[name].values.ravel()[keep] for name in names}}


def unnamed_laws(posterior: xr.Dataset) -> Laws:
    """Laws of a run that does not name them: until 0.1 there was one, and a spring beside it."""
    return ("bouc_wen", "cubic") if "cubic" in posterior else ("bouc_wen",)


def count_of(draws: Mapping[str, Any]) -> int:
    """How many draws there are."""
    return len(next(iter(draws.values())))


def over_draws(f: Callable[[Mapping[str, Array]], PyTree], draws: Draws) -> PyTree:
    """Results of f for every draw, `LANES` at a time: f is compiled once for any number of draws.

    Args:
        f: Vectorised function of `LANES` draws by name, compiled.
        draws: Parameters of the joint and gain, one value a draw.

    Returns:
        What f returns, in NumPy, the draws along the first axis.
    """
    count = count_of(draws)
    lanes = min(LANES, count)
    parts = []
    for first in range(0, count, lanes):
        # The last lanes repeat the last draw, so that every call has the same shape.
        chosen = np.minimum(np.arange(first, first + lanes), count - 1)
        parts.append(f({name: jnp.asarray(values[chosen]) for name, values in draws.items()}))
    return jax.tree.map(lambda *rows: np.concatenate(rows)[:count], *parts)


@partial(jax.jit, static_argnames=("fs", "response", "substeps", "laws"))
def _respond(
    draws: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    response: str,
    substeps: int,
    laws: Laws,
) -> tuple[Float[Array, "draw time"], Float[Array, " draw"]]:
    def one(theta: Mapping[str, Array]) -> tuple[Float[Array, " time"], Float[Array, ""]]:
        motion = motion_under(theta, source, fs, laws=laws, substeps=substeps)
        return getattr(motion, LETTER_OF[response]), jnp.max(jnp.abs(motion.y))

    return jax.vmap(one)(dict(draws))


def predict_motion(
    draws: Draws, record: Record, laws: Laws, *, substeps: int = 2
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Response of every draw to the measured input of a record, from rest.

    Args:
        draws: Parameters of the joint and gain, one value a draw.
        record: The record whose input to use.
        laws: Laws of the joint.
        substeps: Steps of the solver between samples.

    Returns:
        Responses of shape (draw, time), in the unit of the measured response, and the peak
        displacement of every draw [m].
    """
    source = jnp.asarray(record.channels[record.source])
    return over_draws(
        lambda theta: _respond(theta, source, record.fs, record.response, substeps, laws), draws
    )


@eqx.filter_jit
def _carried(
    predict: Callable[[Mapping[str, Array], Any], Array], draws: Mapping[str, Array], data: PyTree
) -> Array:
    return jax.vmap(lambda theta: predict(theta, data))(dict(draws))


def carry(
    predict: Callable[[Mapping[str, Array], Any], Array], draws: Draws, data: PyTree
) -> NDArray[Any]:
    """Prediction of every draw for the reduced data of a test.

    Args:
        predict: (theta, data) to what the observable predicts.
        draws: Parameters of the joint and gain, one value a draw.
        data: The reduced data.

    Returns:
        Predictions, the draws along the first axis.
    """
    return over_draws(lambda theta: _carried(predict, theta, data), draws)


def scattered(key: Key[Array, ""], draws: Draws, scatter: Float[Array, " own"]) -> Draws:
    r"""Draws of the joint as a further run would show it, offset from the joint of all runs.

    $$\omega_n + b_1, \quad \zeta + b_2, \qquad b \sim N(0, \mathrm{diag}(s^2))$$

    Args:
        key: Random key.
        draws: Parameters of the joint and gain.
        scatter: Standard deviation over runs of omega_n [rad/s] and zeta [-]; empty where runs
            have no offsets, and the draws stay as they are.
    """
    if not scatter.size:
        return draws
    b = np.asarray(scatter * jax.random.normal(key, (count_of(draws), len(OFFSETS))))
    moved = {name: draws[name] + b[:, i] for i, name in enumerate(OFFSETS)}
    # Damping cannot leave the law: an offset beyond it stops at a hundredth of the draw.
    return {**draws, **moved, "zeta": np.maximum(moved["zeta"], 0.01 * draws["zeta"])}


def with_references(
    carried: Callable[[Draws, Laws], PyTree], draws: Draws, laws: Laws, references: References
) -> tuple[PyTree, dict[str, PyTree]]:
    """Predictions of the draws, and of every oscillator that they are compared with.

    Args:
        carried: Draws of an oscillator, and its laws, to their predictions, the draws along the
            first axis of every array.
        draws: Parameters of the joint and gain.
        laws: Laws of the joint.
        references: The oscillators, by name.

    Returns:
        Predictions of the draws, and one of each oscillator by its name.
    """
    others = {}
    for name, (parameters, own) in references.items():
        alone = {key: np.array([value]) for key, value in parameters.items()}
        others[name] = jax.tree.map(lambda rows: rows[0], carried(alone, own))
    return carried(draws, laws), others
