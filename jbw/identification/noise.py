"""What the joint posterior's chains leave to be derived: noise by group, products, parameters."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence
from jbw.observables.harmonics import Points
from jbw.observables.joint import joint_of
from jbw.observables.linear import LineReading
from jbw.observables.loops import Loops
from jbw.observables.response import Records

ATTRS = {
    "alpha": {"units": "s-2", "long_name": "stiffness of the hysteretic part"},
    "delta": {"units": "m-1", "long_name": "softening of the hysteresis"},
    "gamma": {"units": "m-1", "long_name": "opening of the hysteresis loop"},
    "alpha_delta": {"units": "m-1 s-2", "long_name": "softening at small amplitude, alpha * delta"},
    "alpha_gamma": {"units": "m-1 s-2", "long_name": "opening at small amplitude, alpha * gamma"},
}
UNIT = {"displacement": "m", "velocity": "m s-1", "acceleration": "m s-2"}
SUFFIX = {Records: ("", "level"), Points: ("_harmonics", "harmonic"), Loops: ("_loop", "loop")}


def draw_noise_std(
    key: Key[Array, ""], terms: Float[np.ndarray, "chain draw term"], data: Evidence
) -> dict[str, Float[np.ndarray, "chain draw"]]:
    r"""One exact draw of each group's noise for every draw of the parameters.

    $$\sigma^2 \mid \theta \sim \frac{n}{NK}\,Q(\theta) / \chi^2_{n - q}, \qquad
      \log p = -\tfrac n2 \log Q$$

    so that Q is read off the stored terms of the log likelihood, without another solve. Where only
    n of the N K values are independent, Q counts all of them.

    Args:
        key: Random key.
        terms: Terms of the log likelihood of every draw; a group each, in the evidence's order.
        data: The evidence.

    Returns:
        Standard deviation of the noise of one repeat, by the group's label.
    """
    found, position = {}, 0
    for part in data.parts:
        if isinstance(part, LineReading):
            position += 1
        elif isinstance(part, Decays):
            # Alone, decays have one more term, the scatter of their shifts.
            position += len(part.names) + (data.scatters.shape[1] == 0)
        else:
            own = part.repeats
            count = np.asarray(own.num_values)
            rows = terms[..., position : position + len(count)]
            degrees = count - own.directions.shape[1]
            key, now = jax.random.split(key)
            chi_square = np.asarray(jax.random.chisquare(now, degrees, shape=rows.shape))
            share = count / np.asarray(own.size * own.num_repeats)
            noise = np.sqrt(share * np.exp(-2 * rows / count) / chi_square)
            found |= {label: noise[..., i] for i, label in enumerate(own.labels)}
            position += len(count)
    return found


def with_derived(key: Key[Array, ""], tree: xr.DataTree, data: Evidence) -> xr.DataTree:
    """The posterior with the noise of each group, the joint's own parameters and their products.

    Args:
        key: Random key of the noise.
        tree: The groups that the sampler left.
        data: The evidence.
    """
    posterior = tree["posterior"].to_dataset()
    terms = tree["log_likelihood"].to_dataset()["terms"].values
    noise = draw_noise_std(key, terms, data)
    derived: dict[str, Any] = {}
    for part in data.parts:
        if isinstance(part, Records | Points | Loops):
            suffix, dim = SUFFIX[type(part)]
            stacked = np.stack([noise[label] for label in part.repeats.labels], axis=-1)
            name = f"noise_std{suffix}"
            number = 2
            while name in derived:
                name, dim = f"noise_std{suffix}_{number}", f"{SUFFIX[type(part)][1]}_{number}"
                number += 1
            attrs = {"units": _unit(part), "long_name": "noise of one repeat"}
            derived[name] = (("chain", "draw", dim), stacked, attrs)
            derived[dim] = (dim, list(part.repeats.labels))
    held = {name: jnp.asarray(value) for name, value in data.held.items()}
    theta = {str(n): jnp.asarray(v.values) for n, v in posterior.data_vars.items()}
    joint = joint_of({**held, **theta})
    values = {name: np.asarray(getattr(joint, name)) for name in ("alpha", "delta", "gamma")}
    values |= {f"alpha_{name}": values["alpha"] * values[name] for name in ("delta", "gamma")}
    for name, value in values.items():
        if name not in posterior:
            derived[name] = (("chain", "draw"), value, ATTRS[name])
    groups = {name: node.to_dataset() for name, node in tree.children.items()}
    complete = xr.DataTree.from_dict({**groups, "posterior": posterior.assign(derived)})
    complete.attrs.update(tree.attrs)
    return complete


def _unit(part: Records | Points | Loops) -> str:
    if isinstance(part, Records):
        return UNIT[part.response]
    return "N" if isinstance(part, Loops) else "unit of the group"
