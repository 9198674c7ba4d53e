"""What the joint posterior's chains leave to be derived: noise by group, products, parameters."""

from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.observables.dataset import Dataset
from jbw.observables.observable import Observable
from jbw.oscillator.laws import laws_named
from jbw.quantities import BY_NAME

Draws = Float[np.ndarray, "chain draw"]


def draw_noise_std(
    key: Key[Array, ""],
    theta: dict[str, Float[np.ndarray, "..."]],
    terms: Float[np.ndarray, "chain draw term"],
    data: Dataset,
) -> dict[str, Draws]:
    """One exact draw of each group's noise for every draw of the parameters, by label."""
    labelled = {label: terms[..., i] for i, label in enumerate(data.labels)}
    found: dict[str, Draws] = {}
    for part in data.parts:
        if part.dimension:
            key, now = jax.random.split(key)
            found |= part.draw_noise(now, theta, labelled, data.num_offsets)
    return found


def with_derived(key: Key[Array, ""], tree: xr.DataTree, data: Dataset) -> xr.DataTree:
    """The posterior with the noise of each group, the laws' own parameters and their products."""
    posterior = tree["posterior"].to_dataset()
    terms = tree["log_likelihood"].to_dataset()["terms"].values
    held = {name: np.asarray(value) for name, value in data.held.items()}
    theta = {**held, **{str(n): v.values for n, v in posterior.data_vars.items()}}
    derived = _noise_variables(draw_noise_std(key, theta, terms, data), data)
    for law in laws_named(data.laws):
        own = {name: np.asarray(v) for name, v in law.of(theta).parameters().items()}
        named = [(quantity, own[quantity.name]) for quantity in law.table]
        named += [(product.quantity, product.of({**theta, **own})) for product in law.products]
        for quantity, value in named:
            if quantity.name not in posterior:
                derived[quantity.name] = (("chain", "draw"), value, quantity.attrs)
    groups = {name: node.to_dataset() for name, node in tree.children.items()}
    complete = xr.DataTree.from_dict({**groups, "posterior": posterior.assign(derived)})
    complete.attrs.update(tree.attrs)
    return complete


def _noise_variables(noise: dict[str, Draws], data: Dataset) -> dict[str, Any]:
    """Variables of the noise, a row a group, by the observables' suffixes and dimensions."""
    derived: dict[str, Any] = {}
    for part in data.parts:
        if not part.dimension:
            continue
        name, dim, number = f"noise_std{part.suffix}", part.dimension, 2
        while name in derived:
            name, dim = f"noise_std{part.suffix}_{number}", f"{part.dimension}_{number}"
            number += 1
        stacked = np.stack([noise[label] for label in part.labels], axis=-1)
        derived[name] = (("chain", "draw", dim), stacked, _attrs(part, name))
        derived[dim] = (dim, list(part.labels))
    return derived


def _attrs(part: Observable, name: str) -> dict[str, str]:
    attrs = BY_NAME["noise_std"].attrs
    attrs["symbol"] += name.removeprefix("noise_std").replace("_", ", ", 1)
    if not part.unit:  # a group is in volts, newtons or metres: no unit holds for all
        del attrs["units"]
        return {**attrs, "long_name": f"{attrs['long_name']}, in the unit of its group"}
    return {**attrs, "units": part.unit}
