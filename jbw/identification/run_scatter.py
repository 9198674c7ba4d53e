"""Every run's own natural frequency and damping, and how far runs and assemblies scatter."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.identification.accuracy import thinned
from jbw.inference.groups.scatter import Spread, draw_offsets
from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.dataset import Dataset, estimates
from jbw.observables.observable import OFFSETS
from jbw.quantities import BY_NAME

NUM_DRAWS = 200
PLURAL = {"run": "runs", "assembly": "assemblies"}


def runs_dataset(
    key: Key[Array, ""], posterior: xr.Dataset, names: tuple[str, ...], data: Dataset
) -> xr.Dataset | None:
    """Draws of every run's omega_n and zeta, and of their standard deviation over runs.

    omega_n and zeta of the posterior are the population's mean. Of each draw of the parameters the
    scatter and the offsets are drawn from their density given the data.

    Args:
        key: Random key.
        posterior: Draws of the parameters.
        names: The parameters that were sampled.
        data: The dataset.

    Returns:
        `omega_n` and `zeta` over (draw, run), `spread_omega_n` and `spread_zeta` over (draw), with
        the suffix `_assembly` over assemblies where there are any; None where runs have no offsets.
    """
    if not data.has_offsets:
        return None
    theta = {name: jnp.asarray(v) for name, v in thinned(posterior, names, NUM_DRAWS).items()}
    num_draws = len(theta[names[0]])
    drawn = _draws(jax.random.split(key, num_draws), theta, data)
    runs = list(dict.fromkeys(data.runs))
    centre = {**data.held, **theta}
    found = {}
    for i, name in enumerate(OFFSETS):
        own = np.asarray(drawn.offset[:, :, i]) + np.reshape(centre[name], (-1, 1))
        attrs = {**BY_NAME[name].attrs, "long_name": f"{name} of each run"}
        found[name] = (("draw", "run"), own, attrs)
        unit = BY_NAME[name].unit
        for level, over in enumerate(list(PLURAL)[: drawn.scatter.shape[1] // len(OFFSETS)]):
            suffix = "" if over == "run" else f"_{over}"
            spread = np.asarray(drawn.scatter[:, len(OFFSETS) * level + i])
            attrs = {"units": unit, "long_name": f"sd of {name} over {PLURAL[over]}"}
            found[f"spread_{name}{suffix}"] = ("draw", spread, attrs)
    return xr.Dataset(found, {"run": runs, "draw": np.arange(num_draws)})


@eqx.filter_jit
def _draws(
    keys: Key[Array, " draw"], theta: Mapping[str, Float[Array, " draw"]], data: Dataset
) -> Spread:
    def one(pair: tuple[Array, Mapping[str, Array]]) -> Spread:
        key, some = pair
        found = estimates({**data.held, **some}, data)
        return draw_offsets(key, found, data.levels, data.scatters)

    return jax.lax.map(one, (keys, dict(theta)))


def runs_summary(runs: xr.Dataset) -> dict[str, dict[str, dict[str, float]]]:
    """Mean, sd and 99 % interval of every run's values, and of the spreads, plain values only."""
    rows = {}
    for name, values in runs.data_vars.items():
        each = {"": values} if values.ndim == 1 else {r: values.sel(run=r) for r in runs.run.values}
        rows[str(name)] = {str(key): _row(one.values) for key, one in each.items()}
    return rows


def _row(draws: Float[np.ndarray, " draw"]) -> dict[str, float]:
    low, middle, high = np.quantile(draws, QUANTILES)
    return {
        "mean": float(draws.mean()), "sd": float(draws.std(ddof=1)),
        "q005": float(low), "median": float(middle), "q995": float(high),
    }  # fmt: skip


def runs_sentence(runs: xr.Dataset) -> str:
    """How far omega_n scatters, in words."""
    told = []
    for over, plural in PLURAL.items():
        name = "spread_omega_n" + ("" if over == "run" else f"_{over}")
        if name in runs:
            low, middle, high = np.quantile(runs[name].values, QUANTILES) / (2 * np.pi)
            told.append(f"{middle:.2g} Hz [{low:.2g}, {high:.2g}] over {plural}")
    return (
        "The natural frequency of the posterior is the population's mean; it scatters by "
        f"{' and '.join(told)} (standard deviation, 99 % interval)."
    )
