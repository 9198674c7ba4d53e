"""The main posterior in ArviZ's own schema, so that its functions take a run as it is.

Observations are records: what is left out by `arviz.loo`, compared by `arviz.plot_ppc_dist` and
ranked by `arviz.plot_loo_pit` is the variable `response` of one record each, with the names of
records, tests and runs for coordinates. Given the noise, and the offsets of the runs where they
have any, records are independent; so the noise's prior 1/sigma stands in `log_prior`, beside what
was read off a noise test before.
"""

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.identification.assemble import Measured, single_records
from jbw.identification.joint import JointPosterior, law_variables
from jbw.inference.generator import generator, parts_of
from jbw.inference.space.box import Box, bounds_by_name
from jbw.observables.dataset import Dataset
from jbw.observables.pointwise import RecordTerms, records_of, splits_of
from jbw.report.messages import study as messages
from jbw.verification.places import safe

NUM_PRIOR = 500  # draws of the prior
NUM_PREDICTED = 100  # of them carried through the model
SAMPLES = ("chain", "draw")
SILENCE = 1e-12  # noise of what the prior predicts: 1/sigma is no density to draw from
KEY = 200  # of the seed: no other numbers move by these
RESPONSE = {
    "units": "1",
    "long_name": messages.VARIABLES["response"],
}
LIKELIHOOD = {
    "units": "1",
    "long_name": messages.VARIABLES["log_likelihood"],
}

Groups = dict[str, xr.Dataset]
Draws = Mapping[str, Float[np.ndarray, " draw"]]


def arviz_groups(seen: Measured, joint: JointPosterior, seed: int) -> Groups:
    """All of ArviZ's groups of the joint posterior, by path."""
    posterior, data, box = joint.draws, joint.fitted.data, joint.fitted.box
    shape = posterior.sizes["chain"], posterior.sizes["draw"]
    keys = parts_of(jax.random.fold_in(jax.random.key(seed), KEY), 3)
    splits = splits_of(joint.fitted.fit.theta, data, single_records(seen))
    if all(split is None for split in splits):  # nothing but what was read off a record before
        return {}
    theta = {name: posterior[name].values.ravel() for name in box.names}
    noise = noise_of(posterior)
    flat = {label: values.ravel() for label, values in noise.items()}
    records = records_of(keys[0], theta, flat, data, splits)
    meaning = {str(name): values.attrs for name, values in posterior.data_vars.items()}
    prior = prior_draws(keys[1], box, data, meaning)
    some = {name: prior[name].values[0, :NUM_PREDICTED] for name in box.names}
    silent = {label: np.full(NUM_PREDICTED, SILENCE) for label in noise}
    with np.errstate(invalid="ignore", over="ignore"):  # where the motion cannot be solved
        before = records_of(keys[2], some, silent, at_large(data), splits)
    before = _joined(before, "predicted")
    before = before[np.all(np.isfinite(before), axis=1)]
    coords = coordinates(records)
    predicted = _joined(records, "predicted").reshape(*shape, -1)
    likelihood = _joined(records, "log_likelihood") - _joined(records, "reference")
    groups = {
        "log_prior": log_prior(posterior, box, records, data),
        "log_likelihood": _of_records(likelihood.reshape(*shape, -1), coords, LIKELIHOOD),
        "observed_data": _of_records(_joined(records, "observed"), coords, RESPONSE),
        "posterior_predictive": _of_records(predicted, coords, RESPONSE),
        "prior": prior,
        "prior_predictive": _of_records(before[None], coords, RESPONSE),
    }
    return {f"/{name}": created(group) for name, group in groups.items()}


def at_large(data: Dataset) -> Dataset:
    """The data predicted at one joint for all runs: offsets are known about the fit alone."""
    evenly = (part.evenly() for part in data.parts)
    pairs = zip(data.parts, evenly, strict=True)
    parts = tuple(part if even is None else even for part, even in pairs)
    none = np.asarray(data.scatters)[:1, :0], np.asarray(data.scatter)[:0]
    scatters, scatter = jax.device_put(none)
    return replace(data, parts=parts, scatters=scatters, scatter=scatter)


def noise_of(posterior: xr.Dataset) -> dict[str, Float[np.ndarray, "chain draw"]]:
    """Draws of every group's noise, by its label."""
    return {
        str(label): values.sel({values.dims[-1]: label}).values
        for name, values in posterior.data_vars.items()
        if str(name).startswith("noise_std")
        for label in values[values.dims[-1]].values
    }


def prior_draws(
    key: Key[Array, ""], box: Box, data: Dataset, attrs: Mapping[str, Mapping[str, Any]]
) -> xr.Dataset:
    """One chain of draws of the prior, with what follows from them; noise has none to draw from."""
    rng, shape = generator(key), (1, NUM_PRIOR)
    values = {
        name: rng.uniform(low, high, shape) for name, (low, high) in bounds_by_name(box).items()
    }
    stated = zip(data.stated.names, data.stated.distributions, strict=True)
    for index, (name, density) in enumerate(stated):
        values[name] = np.asarray(density.sample(jax.random.fold_in(key, index), shape))
    drawn = {name: (SAMPLES, values[name], attrs[name]) for name in box.names}
    coords = {"chain": [0], "draw": np.arange(NUM_PRIOR)}
    sampled = xr.Dataset(drawn, coords)
    return sampled.assign(law_variables(sampled, data))


def coordinates(records: RecordTerms) -> dict[str, Any]:
    """Names of the records, and of the test, the run and the repeat of each."""

    def every(field: str) -> list[Any]:
        return [value for part in records.parts for value in getattr(part, field)]

    record_coords = {"test": every("group"), "run": every("run"), "repeat": every("repeat")}
    return {
        "record": every("name"),
        **{name: ("record", value) for name, value in record_coords.items()},
    }


def _joined(records: RecordTerms, field: str) -> Float[np.ndarray, "*draw record"]:
    return np.concatenate([getattr(part, field) for part in records.parts], axis=-1)


def log_prior(posterior: xr.Dataset, box: Box, records: RecordTerms, data: Dataset) -> xr.Dataset:
    """Log density of the prior by variable: the box, 1/sigma, a line fit, the runs' offsets."""
    shape = posterior.sizes["chain"], posterior.sizes["draw"]
    coords: dict[Any, Any] = dict(posterior.coords)
    attrs = {"units": "1", "long_name": "log prior density [nats]"}
    variables: dict[str, Any] = {
        name: (SAMPLES, np.full(shape, -np.log(high - low)), attrs)
        for name, (low, high) in bounds_by_name(box).items()
    }
    for name, density in zip(data.stated.names, data.stated.distributions, strict=True):
        variables[name] = (SAMPLES, np.asarray(density.log_prob(posterior[name].values)), attrs)
    for name, values in posterior.data_vars.items():
        if str(name).startswith("noise_std"):
            variables[str(name)] = (values.dims, -np.log(values.values), attrs)
    for label, density in records.known.items():
        variables[safe(label)] = (SAMPLES, density.reshape(shape), attrs)
    if records.offsets is not None:
        runs = list(dict.fromkeys(data.runs))
        rows = records.offsets.reshape(*shape, len(runs))
        variables["offsets"] = ((*SAMPLES, "run"), rows, attrs)
        coords["run"] = runs
    return xr.Dataset(variables, coords)


def _of_records(
    rows: Float[np.ndarray, "..."], coords: Mapping[str, Any], attrs: Mapping[str, str]
) -> xr.Dataset:
    """One number a record, by chain and draw where it is drawn."""
    from arviz_base import dict_to_dataset  # it is needed only here

    dataset = dict_to_dataset(
        {"response": rows},
        coords={"record": coords["record"]},
        dims={"response": ["record"]},
        sample_dims=list(SAMPLES) if rows.ndim > 1 else [],
    )
    dataset["response"].attrs = dict(attrs)
    return dataset.assign_coords(coords)


def created(dataset: xr.Dataset) -> xr.Dataset:
    """A group with what ArviZ writes of a group's origin."""
    from arviz_base import make_attrs

    origin = {"inference_library": "jbw", "inference_library_version": version("jbw")}
    return dataset.assign_attrs(make_attrs({**origin, **dataset.attrs}))
