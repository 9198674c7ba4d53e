"""The result of a run as one labelled data tree with units: posteriors, verification, validation.

The main posterior has ArviZ's own schema, so that ArviZ's functions accept a run as it is. One
observation is one record: `arviz.loo` leaves out, `arviz.plot_ppc_dist` compares and
`arviz.plot_loo_pit` ranks the variable `response` of one record each; its coordinates are the names
of records, tests and runs. Given the noise, and the offsets of the runs where there are any,
records are independent. The prior 1/sigma of the noise is therefore in `log_prior`, next to the
densities of what a noise test determined before.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.errors import Attempts
from jbw.identification.assemble import Measured
from jbw.identification.joint import JointPosterior, law_variables
from jbw.identification.joint_answers import JOINTS
from jbw.identification.linear_step import LinearStep, linear_dataset, modes_dataset
from jbw.identification.paper import step3, step4
from jbw.identification.paper.step3 import KernelFit
from jbw.identification.procedure import Posteriors
from jbw.identification.selection import Sweeps, probing_tests
from jbw.identification.step import Step
from jbw.identification.tied_joints import tied_evidence, tied_laws
from jbw.inference.generator import generator, parts_of
from jbw.inference.lanes import in_background
from jbw.inference.posterior.summary import posterior_draws, running_mean, shape_of
from jbw.inference.space.box import Box, bounds_by_name
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset, measured_parts
from jbw.observables.decay import Decays
from jbw.observables.noise import evenly
from jbw.observables.pointwise import RecordTerms, records_of
from jbw.observables.records import SUBSTEPS, Records
from jbw.quantities import DEFAULT_LAWS, derivative_order
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.results.attributes import StoredVariable
from jbw.study.order import Order
from jbw.verification.backbone import backbone_group
from jbw.verification.bands import QUANTILE_AXIS, polar
from jbw.verification.in_time import responses_at
from jbw.verification.places import safe
from jbw.verification.predictive_basis import NUM_DRAWS, basis_attrs, basis_of, decay_attrs
from jbw.verification.verify import Groups, verify

# number that is added to the seed for the evidence for one law of all joints
TIED_KEY = 300
SPECTRUM = 4.2  # highest frequency of the displayed spectrum, as a multiple of the tone's frequency
NUM_PRIOR = 500  # number of stored draws from the prior
NUM_PREDICTED = 100  # number of prior draws that are propagated through the model
SAMPLES = ("chain", "draw")
# Predictions from the prior get this noise level, because the improper prior 1/sigma cannot be
# drawn from.
SILENCE = 1e-12
# number that is added to the seed, so that random numbers here are independent of those elsewhere
KEY = 200
RESPONSE = {
    "units": "1",
    "long_name": messages.RMS_OF_RESPONSE,
}
LIKELIHOOD = {
    "units": "1",
    "long_name": messages.LIKELIHOOD_OF_RECORD,
}

Draws = Mapping[str, Float[np.ndarray, " draw"]]


def collect(
    order: Order, measured: Measured, posteriors: Posteriors, attempts: Attempts
) -> xr.DataTree:
    """Collect posteriors, verification and validation in one labelled data tree with units.

    A group that accompanies the posteriors is left out if its computation fails; `attempts` records
    why.
    """
    tests, joint, seed = measured.tests, posteriors.joint, order.seed
    groups = _drawn_groups(measured, posteriors, order.truth or {})
    linear, kernel, sweeps = measured.linear, posteriors.paper.kernel, measured.sweeps
    steps = posteriors.paper.steps
    if linear is not None and kernel is not None:
        groups |= attempts.make(
            stages.KERNEL, lambda: _kernel_groups(tests, linear, kernel, steps), {}
        )
    if sweeps is not None:
        groups |= attempts.make(stages.ENERGY, lambda: _conv_of_velocity(steps, sweeps), {})
    basis = basis_of(xr.DataTree.from_dict(groups))
    # For a structure that behaves linearly, predictions of single records contain nothing about a
    # joint.
    has_records = not posteriors.checks.sees_no_joint and measured_parts(joint.fitted.data)
    with in_background(lambda: arviz_groups(joint, seed) if has_records else {}) as by_record:
        groups |= attempts.make(
            stages.TESTS, lambda: verify(measured, posteriors, basis, seed, attempts), {}
        )
        curve = attempts.make(
            stages.BACKBONE,
            lambda: backbone_group(
                basis.thinned(NUM_DRAWS), basis.y_peak, basis.laws, basis.discrepancy
            ),
            None,
        )
        if has_records:
            attempts.report(stages.SINGLE_RECORDS)
        record_groups = attempts.make(stages.RECORD_LIKELIHOOD, by_record.result, {})
    if curve is not None:
        groups["/verification/backbone"] = curve
    drawn = {name: created(groups[name]) for name in ("/posterior", "/sample_stats")}
    groups |= drawn | record_groups
    return xr.DataTree.from_dict(groups | _tied_joints(order, joint, groups, attempts))


def _drawn_groups(measured: Measured, posteriors: Posteriors, truth: Mapping[str, float]) -> Groups:
    """Return the result groups of the FRF fit (Step 2) and of each posterior, by path."""
    joint = posteriors.joint
    facts = joint.tree.attrs | run_attrs(
        measured.tests, joint, posteriors.free.data, measured.rivals
    )
    groups: Groups = {"/": xr.Dataset(attrs=facts)}
    if measured.linear is not None:
        groups["/steps/linear"] = linear_dataset(measured.linear)
        modes = modes_dataset(measured.linear)
        groups |= {} if modes is None else {"/modes": modes}
    free = posteriors.free.step
    drawn = {f"/steps/{name}": groups_in(step.posterior) for name, step in
             posteriors.paper.steps.items()}  # fmt: skip
    drawn[""] = {**groups_in(joint.tree), **posteriors.checks.groups}
    drawn |= {} if free is None else {f"/steps/{free.name}": groups_in(free.posterior)}
    for place, parts in drawn.items():
        groups |= {f"{place}/{name}": part for name, part in _with_truth(parts, truth).items()}
    return groups


def groups_in(tree: xr.DataTree) -> Groups:
    """Return the groups of one posterior's result tree, by name."""
    return {name: node.to_dataset() for name, node in tree.children.items()}


def _tied_joints(order: Order, joint: JointPosterior, groups: Groups, attempts: Attempts) -> Groups:
    """Return the joints' result group, extended by the evidence that all joints share one law."""
    fitted, place = joint.fitted, f"/{JOINTS}"
    if place not in groups or tied_laws(fitted.data.laws) == fitted.data.laws:
        return {}
    attempts.report(stages.TIED)
    key = jax.random.fold_in(jax.random.key(order.seed), TIED_KEY)
    settings = order.campaign.settings
    tied = attempts.make(stages.TIED, lambda: tied_evidence(key, fitted, settings), None)
    return {} if tied is None else {place: groups[place].assign_attrs(tied.attrs)}


def run_attrs(
    tests: Sequence[Test],
    joint: JointPosterior,
    decays: Decays | None,
    rivals: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the attributes of a run that predictions need in addition to posterior draws.

    `basis_of` reads them.
    """
    posterior = joint.draws
    omega_n = float(posterior["omega_n"].mean()) if "omega_n" in posterior else 1.0
    attrs = basis_attrs(tests, joint.fitted.data, joint.held, omega_n)
    attrs |= {"rivals": json.dumps(list(rivals))} if rivals else {}
    return attrs | ({} if decays is None else decay_attrs(decays))


def _with_truth(parts: Groups, truth: Mapping[str, float]) -> Groups:
    """Return a posterior's groups with the known true values of simulated parameters."""
    groups = dict(parts)
    posterior = groups["posterior"].copy()
    for name in posterior.data_vars:
        if name in truth:
            posterior[name].attrs["truth"] = float(truth[str(name)])
    if "leave_one_out" in groups:
        left_out = groups["leave_one_out"]
        units = [StoredVariable.of(posterior[n]).units for n in left_out["parameter"].values]
        groups["leave_one_out"] = left_out.assign(
            {n: left_out[n].assign_attrs(group_units=units) for n in ("estimate", "std")}
        )
    return {**groups, "posterior": posterior}


def _kernel_groups(
    tests: tuple[Test, ...], linear: LinearStep, third_order: KernelFit, steps: Mapping[str, Step]
) -> Groups:
    """Return the result groups of Step 3 (kernel fit): kernel, spectrum and running means."""
    probing = probing_tests(tests, linear.natural_hz)
    groups: Groups = {"/verification/spectrum": _tone_spectrum(probing[len(probing) // 2])}
    posteriors = {}
    for name, prefix in (("third_order_nuts", "nuts"), ("third_order_paper", "paper")):
        posteriors[prefix] = posterior_draws(steps[name].posterior)
        energy = step3.integrals(posteriors[prefix], third_order.data)
        groups[f"/steps/{name}/sample_stats"] = _with_conv(steps[name], energy, "rad s^11/m^4")
    groups["/verification/h3"] = _kernel_verification(third_order, posteriors)
    return groups


def _kernel_verification(fitted: KernelFit, posteriors: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Return the third-order kernel measured in every repeat, with bands from both samplers."""
    data, omega = fitted.data, np.asarray(fitted.data.omega)
    shown = [k for k in fitted.kernels if np.any(np.isclose(k.omega, omega))]
    repeats = min(len(k.h3) for k in shown)
    h = np.stack([k.h3[:repeats] for k in shown], axis=-1)
    unit = {"units": "s^6/m^2", "long_name": "third-order kernel"}
    how = np.angle(h.mean(axis=0)), unit, {"units": "rad"}
    variables = polar("measured", h, *how, ("repeat", "freq"))
    variables |= {
        "correction": ("freq", [k.source_ratio for k in shown], {"units": "1"}),
        "y_peak": ("freq", np.asarray(data.y_peak), {"units": "m"}),
    }
    for prefix, posterior in posteriors.items():
        variables |= polar(prefix, step3.predicted(posterior, data), *how)
    freq = ("freq", omega / (2 * np.pi), {"units": "Hz"})
    return xr.Dataset(variables, {"freq_hz": freq, "quantile": QUANTILE_AXIS})


def _tone_spectrum(test: Test) -> xr.Dataset:
    """Return the peak-amplitude spectrum of the displacement under one tone (Hann window)."""
    record = test.records[0]
    x = record.channels[record.response][round(test.settle * record.fs) :]
    window = np.hanning(len(x))
    freq = np.fft.rfftfreq(len(x), 1 / record.fs)
    keep = (freq > 0.3 * test.tones_hz[0]) & (freq < SPECTRUM * test.tones_hz[0])
    amplitude = np.abs(np.fft.rfft(x * window))[keep] * 2 / window.sum()
    amplitude /= (2 * np.pi * freq[keep]) ** derivative_order(record.response)
    return xr.Dataset(
        {"amplitude": ("freq", amplitude, {"units": "m", "long_name": "displacement"})},
        {"freq": ("freq", freq[keep], {"units": "Hz"})},
        {"tone_hz": test.tones_hz[0], "test": test.name},
    )


def _with_conv(step: Step, energy: np.ndarray, unit: str) -> xr.Dataset:
    conv = np.stack([running_mean(chain) for chain in energy])
    attrs = {"units": unit, "long_name": messages.RUNNING_ENERGY}
    return step.posterior["sample_stats"].to_dataset().assign(conv=(("chain", "draw"), conv, attrs))


def _conv_of_velocity(steps: Mapping[str, Step], sweeps: Sweeps) -> Groups:
    """Return the running mean, over draws of Step 4, of the energy of the simulated velocity."""
    test = sweeps.fitted[-1]
    whole = replace(test, records=test.records[:1], settle=0.0, band_hz=None)
    data = Records.of([whole], laws=DEFAULT_LAWS, substeps=SUBSTEPS)

    def energy(draws: dict[str, np.ndarray]) -> np.ndarray:
        return np.sum(responses_at(draws, data)[0] ** 2, axis=-1) / data.fs

    return {
        f"/steps/{name}/sample_stats": _with_conv(
            steps[name], step4.of_draws(steps[name], energy), "m^2/s"
        )
        for name in step4.SAMPLERS
        if name in steps
    }


def arviz_groups(joint: JointPosterior, seed: int) -> Groups:
    """Return the ArviZ groups of the joint posterior, by path in the tree."""
    posterior, data, box = joint.draws, joint.fitted.data, joint.fitted.box
    shape = shape_of(posterior)
    keys = parts_of(jax.random.fold_in(jax.random.key(seed), KEY), 3)
    theta = {name: posterior[name].values.ravel() for name in box.names}
    noise = noise_of(posterior)
    flat = {label: values.ravel() for label, values in noise.items()}
    records = records_of(keys[0], theta, flat, data)
    meaning = {str(name): values.attrs for name, values in posterior.data_vars.items()}
    prior = prior_draws(keys[1], box, data, meaning)
    some = {name: prior[name].values[0, :NUM_PREDICTED] for name in box.names}
    silent = {label: np.full(NUM_PREDICTED, SILENCE) for label in noise}
    # For some draws of the prior the equation of motion cannot be solved.
    with np.errstate(invalid="ignore", over="ignore"):
        before = records_of(keys[2], some, silent, at_large(data))
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
    """Return the dataset without session offsets, so that all runs have equal parameters.

    The offsets are linearised about the fit and valid only near it.
    """
    even = (evenly(part) for part in data.parts)
    pairs = zip(data.parts, even, strict=True)
    parts = tuple(part if even is None else even for part, even in pairs)
    none = np.asarray(data.scatters)[:1, :0], np.asarray(data.scatter)[:0]
    scatters, scatter = jax.device_put(none)
    return replace(data, parts=parts, scatters=scatters, scatter=scatter)


def noise_of(posterior: xr.Dataset) -> dict[str, Float[np.ndarray, "chain draw"]]:
    """Return the draws of each data group's noise level, by label of the group."""
    return {
        str(label): values.sel({values.dims[-1]: label}).values
        for name, values in posterior.data_vars.items()
        if str(name).startswith("noise_std")
        for label in values[values.dims[-1]].values
    }


def prior_draws(
    key: Key[Array, ""], box: Box, data: Dataset, attrs: Mapping[str, Mapping[str, Any]]
) -> xr.Dataset:
    """Draw parameters, except the noise level, from their prior; add derived quantities."""
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
    """Return xarray coordinates of all records: name, test, run and repeat."""

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
    """Return each draw's log prior densities: of parameters, noise, the FRF fit and run offsets."""
    shape = shape_of(posterior)
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
    """Return a dataset in ArviZ's form with one number per record, such as a log likelihood."""
    from arviz_base import dict_to_dataset  # Only this function needs the slow import.

    dataset = dict_to_dataset(
        {"response": rows},
        coords={"record": coords["record"]},
        dims={"response": ["record"]},
        sample_dims=list(SAMPLES) if rows.ndim > 1 else [],
    )
    dataset["response"].attrs = dict(attrs)
    return dataset.assign_coords(coords)


def created(dataset: xr.Dataset) -> xr.Dataset:
    """Add to a group the attributes that ArviZ expects: library, version and date."""
    from arviz_base import make_attrs

    origin = {"inference_library": "jbw", "inference_library_version": version("jbw")}
    return dataset.assign_attrs(make_attrs({**origin, **dataset.attrs}))
