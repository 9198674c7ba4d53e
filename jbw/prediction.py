"""Draws of the posterior carried through the model to the records of a test, as 99 % bands."""

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
from scipy.stats import norm

from jbw.inference.summary import QUANTILES, evenly_spaced
from jbw.measurement.records import Record
from jbw.observables.joint import JOINT
from jbw.observables.repeats import OFFSETS, Repeats
from jbw.observables.response import LETTER, motion_under

UNITS = {"displacement": "m", "velocity": "m s-1", "acceleration": "m s-2"}
LANES = 8  # draws carried through the model at once
Draws = dict[str, NDArray[np.float64]]


def thin(posterior: xr.Dataset, num_draws: int, held: Mapping[str, float] | None = None) -> Draws:
    """Evenly spaced draws over all chains, with what was held beside them.

    Args:
        posterior: Posterior group with dimensions (chain, draw).
        num_draws: Draws to keep at most.
        held: Parameters that were not updated, the same in every draw.

    Returns:
        Each parameter of the joint, and `gain`, to its draws.
    """
    keep = evenly_spaced(posterior, num_draws)
    fixed = {name: np.full(len(keep), float(value)) for name, value in (held or {}).items()}
    names = [name for name in (*JOINT, "gain", "cubic") if name in posterior]
    return {**fixed, **{name: posterior[name].values.ravel()[keep] for name in names}}


@partial(jax.jit, static_argnames=("fs", "response", "substeps"))
def _respond(
    draws: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    response: str,
    substeps: int,
) -> tuple[Float[Array, "draw time"], Float[Array, " draw"]]:
    def one(theta: Mapping[str, Array]) -> tuple[Float[Array, " time"], Float[Array, ""]]:
        motion = motion_under(theta, source, fs, substeps=substeps)
        return getattr(motion, LETTER[response]), jnp.max(jnp.abs(motion.y))

    return jax.vmap(one)(dict(draws))


def over_draws(f: Callable[[Mapping[str, Array]], PyTree], draws: Draws) -> PyTree:
    """Results of f for every draw, `LANES` at a time: f is compiled once for any number of draws.

    Args:
        f: Vectorised function of `LANES` draws by name, compiled.
        draws: Parameters of the joint and gain, one value a draw.

    Returns:
        What f returns, in NumPy, the draws along the first axis.
    """
    count = len(next(iter(draws.values())))
    found = []
    for first in range(0, count, LANES):
        chosen = np.minimum(np.arange(first, first + LANES), count - 1)
        found.append(f({name: jnp.asarray(values[chosen]) for name, values in draws.items()}))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)


def predict_record(draws: Draws, record: Record, *, substeps: int = 2) -> NDArray[np.float64]:
    """Response of every draw to the measured input of a record, from rest.

    Args:
        draws: Parameters of the joint and gain, one value a draw.
        record: The record whose input to use.
        substeps: Steps of the solver between samples.

    Returns:
        Responses of shape (draw, time), in the unit of the measured response.
    """
    return predict_motion(draws, record, substeps=substeps)[0]


def predict_motion(
    draws: Draws, record: Record, *, substeps: int = 2
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """As `predict_record`, and beside it the peak displacement of every draw [m]."""
    source = jnp.asarray(record.channels[record.source])
    return over_draws(
        lambda theta: _respond(theta, source, record.fs, record.response, substeps), draws
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
    b = np.asarray(scatter * jax.random.normal(key, (len(draws["zeta"]), len(OFFSETS))))
    moved = {name: draws[name] + b[:, i] for i, name in enumerate(OFFSETS)}
    # Damping cannot leave the law: an offset beyond it stops at a hundredth of the draw.
    return {**draws, **moved, "zeta": np.maximum(moved["zeta"], 0.01 * draws["zeta"])}


def beside(
    carried: Callable[[Draws], NDArray[Any]],
    draws: Draws,
    references: Mapping[str, Mapping[str, float]],
) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Predictions of the draws, and of every oscillator that they are compared with.

    Args:
        carried: Draws to their predictions, the draws along the first axis.
        draws: Parameters of the joint and gain.
        references: Parameters of the oscillators, by name.

    Returns:
        Predictions of the draws, and one of each oscillator by its name.
    """
    # One that needs no more parameters than the draws goes along with them, compiled already.
    along = [n for n, one in references.items() if "cubic" in draws or not one.get("cubic")]
    every = {
        name: np.append(values, [references[one][name] for one in along])
        for name, values in draws.items()
    }
    values = carried(every)
    count = len(values) - len(along)
    others = dict(zip(along, values[count:], strict=True))
    for name in references.keys() - others.keys():
        alone = {key: np.array([value]) for key, value in references[name].items()}
        others[name] = carried(alone)[0]
    return values[:count], {name: others[name] for name in references}


def noise_of_mean(repeats: Repeats, group: int = 0) -> float | None:
    """Noise of the mean of a group's repeats; None where there is one repeat only."""
    count, within = float(repeats.num_repeats[group]), float(repeats.within[group])
    if count < 2:
        return None
    return float(np.sqrt(within / (float(repeats.size[group]) * (count - 1) * count)))


def error(measured: NDArray[Any], predicted: NDArray[Any]) -> float:
    """Error of a prediction, root mean square, over the root mean square of what was measured."""
    return float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))


def errors(
    measured: NDArray[np.float64],
    model: Float[np.ndarray, "draw value"],
    others: Mapping[str, NDArray[np.float64]],
    noise_std: float | None,
) -> dict[str, float]:
    r"""How far a test lies from the model, and from the oscillators it is compared with.

    Args:
        measured: Mean of the repeats.
        model: Its prediction by every draw.
        others: Its prediction by other oscillators, by their names.
        noise_std: Noise of the mean, where it is known.

    Returns:
        `nrmse`, the error of the median; `nrmse_linear` and so on, of the others; and `coverage`,
        the share of the `num_values` values inside the predictive band, `gaussian_band`.
    """
    median = np.median(model, axis=0)
    found = {"nrmse": error(measured, median)}
    found |= {f"nrmse_{name}": error(measured, one) for name, one in others.items()}
    if noise_std is not None:
        low, _, high = gaussian_band(model, noise_std)
        inside = (measured >= low) & (measured <= high)
        found |= {"coverage": float(np.mean(inside)), "num_values": inside.size}
    return found


def band(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quantiles 0.5 %, 50 % and 99.5 % along the first axis: a 99 % band about its median."""
    return np.quantile(values, QUANTILES, axis=0)


def gaussian_band(
    model: Float[np.ndarray, "draw *value"], noise_std: float | Float[np.ndarray, "*value"]
) -> NDArray[np.float64]:
    r"""The 99 % band of what is to be measured: the draws' variance and the noise's together.

    $$m \pm 2.576 \sqrt{\mathrm{var}_\theta + \sigma^2}$$

    Args:
        model: Prediction by every draw, whose median over draws is m.
        noise_std: Noise sigma; 0 for the parameters alone.

    Returns:
        Lower edge, median and upper edge along a new first axis.
    """
    reach = norm.ppf(QUANTILES[-1]) * np.sqrt(model.var(axis=0) + noise_std**2)
    median = np.median(model, axis=0)
    return np.stack([median - reach, median, median + reach])
