"""The joint posterior: all parameters from all measured tests of a campaign.

The sequence is a problem, its fit, and draws by a sampler that suits the data, completed by derived
quantities. Each of these objects is immutable.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.campaign.settings import Identify
from jbw.identification import accuracy
from jbw.identification.assemble import Measured, Report, assemble
from jbw.identification.equivalent import effects, effects_sentence, response_finding
from jbw.identification.gain_units import with_gain_units
from jbw.identification.no_joint import joint_finding, likely, may_be_absent, without_joint
from jbw.identification.one_mode_readings import (
    NOTHING,
    Readings,
    joint_readings,
    with_readings,
)
from jbw.identification.prepare import Fitted, completed, weighed
from jbw.identification.size import announced
from jbw.identification.step import attrs
from jbw.identification.widening import widened
from jbw.inference.fit.valley import about_valley
from jbw.inference.generator import parts_of
from jbw.inference.posterior.summary import posterior_draws
from jbw.inference.posterior.verdict import enough
from jbw.inference.samplers.chunked_run import Keep, Until, no_checkpoint
from jbw.inference.samplers.ladder import ROUNDS, Places, Sizes, climb
from jbw.inference.samplers.register import sampler_named
from jbw.inference.samplers.rewhitening import sample_until
from jbw.inference.samplers.sampling import SamplingRequest
from jbw.inference.space.box import box
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import along_logarithms, in_box, never_zero
from jbw.inference.space.ridge import along_ridge
from jbw.measurement.records import Test
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.drives import OWN, attached, named, of_drive
from jbw.observables.noise import Drawn, draw_noise
from jbw.observables.observable import Observable
from jbw.oscillator.laws import laws_named
from jbw.quantities import BY_NAME
from jbw.report.messages import posterior as messages
from jbw.report.messages import stages

READINGS_KEY = 200  # number from which the random key of the single-mode fits is derived


@dataclass(frozen=True)
class JointProblem:
    """The input of a joint posterior: the data, the settings, and results of earlier fits."""

    data: Dataset  # the data of all fitted tests
    settings: Identify
    # starting values from the line fit and the kernel fit (Steps 2 to 4)
    known: Mapping[str, float] = field(default_factory=dict)
    readings: Readings = NOTHING  # results of single-mode fits, for several joints
    tests: tuple[Test, ...] = ()  # the tests; the kind of drive determines the unit of a gain
    # parameters of an earlier fit to the same data, from which the fit starts
    start: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class JointPosterior:
    """The draws of all parameters, gains and noise levels, with the fit that preceded them."""

    name: str  # "joint", or "decay" for free decays alone
    # the result tree, with the noise levels, the laws' parameters and their products
    tree: xr.DataTree
    fitted: Fitted  # the fit that preceded the draws, with their prior
    wall_s: float  # time for fit, draws and compilation [s]

    @property
    def draws(self) -> xr.Dataset:
        """The draws of every parameter, with dimensions (chain, draw)."""
        return posterior_draws(self.tree)

    @property
    def held(self) -> dict[str, float]:
        """The fixed parameters, which were not inferred."""
        return {name: float(value) for name, value in self.fitted.data.held.items()}


def joint_problem(
    seen: Measured,
    known: Mapping[str, float],
    *,
    seed: int,
    report: Report,
    start: Mapping[str, float] | None = None,
) -> JointProblem:
    """Assemble a campaign's data and starting values, from earlier steps or single-mode fits.

    Raises:
        DataError: If no test is left to fit the joint to.
    """
    data = assemble(seen)
    announced(report, stages.joint_posterior, data)
    readings = joint_readings(jax.random.fold_in(jax.random.key(seed), READINGS_KEY), seen)
    known = of_reading(known, data)
    return JointProblem(data, seen.settings, known, readings, seen.tests, start or {})


def fit_problem(keys: Sequence[Key[Array, ""]], problem: JointProblem) -> Fitted:
    """Fit the joint; determine noise, differences of runs, whether a joint exists, coordinates."""
    started, readings = perf_counter(), problem.readings
    known = {**problem.known, **readings.known}
    ready = weighed(keys, problem.data, problem.settings, known, start=problem.start)
    ready = with_readings(ready, readings)
    ready = without_absent_joint(keys[0], ready) or ready
    ready = completed(keys[1], ready, problem.settings)
    return replace(ready, wall_s=perf_counter() - started)


def draw_joint(
    keys: Sequence[Key[Array, ""]],
    problem: JointProblem,
    ready: Fitted,
    *,
    keep: Keep = no_checkpoint,
    name: str = "joint",
) -> JointPosterior:
    """Draw the joint posterior; repeat with a wider default prior if draws reach its bounds.

    The draws also contain the noise of every group and the laws' own parameters and products.

    Reference:
        Eq. (37), with every parameter set to update.
    """
    started, settings = perf_counter(), problem.settings
    chains = sample_joint(keys[0], ready, settings, keep, name)
    if (wider := widened(chains, ready, settings.prior)) is not None:
        ready = wider
        chains = sample_joint(jax.random.fold_in(keys[0], 1), ready, settings, keep, f"{name}_wide")
    chains.attrs["substeps"] = accuracy.substeps_of(ready.data)
    tree = with_gain_units(with_derived(keys[1], chains, ready.data), problem.tests)
    return JointPosterior(name, tree, ready, ready.wall_s + perf_counter() - started)


def without_absent_joint(key: Key[Array, ""], ready: Fitted) -> Fitted | None:
    """Return the fit without the joint if the data show no joint; otherwise None.

    This is decided as soon as noise, run effects and residual terms are determined, before
    coordinates and solver steps are chosen, which an absent joint does not need.

    A posterior along the ridge of an undetected joint is not worth drawing. Points near the fit
    that the data do not rule out show the largest possible effect of a joint.
    """
    prior, best, data = ready.box, ready.fit, ready.data
    if not data.laws or data.modes is not None or "omega_n" not in prior.names:
        return None
    theta = likely(key, best, prior, data)
    draws = xr.Dataset({name: (("chain", "draw"), x[None]) for name, x in theta.items()})
    all_variables = draws.assign(law_variables(draws, data))
    added = effects(all_variables, data.held, ready.y_peak, data.laws)
    if added is None or not may_be_absent(added):
        return None
    nested = without_joint(best, prior, data)
    finding = joint_finding(nested, added, ready.y_peak)
    if finding.status == "ok":
        return None
    statement = f"{effects_sentence(added, ready.y_peak)} {messages.WITHOUT_JOINT}"
    bare = replace(data, parts=tuple(replace(part, laws=()) for part in data.parts))
    bare = replace(bare, held={k: v for k, v in data.held.items() if k not in names_of_laws(data)})
    structure_box = box(nested.bounds)
    return replace(
        ready,
        fit=nested.fit,
        box=structure_box,
        data=bare,
        statements=(*ready.statements, statement),
        findings=(*ready.findings, finding),
    )


def names_of_laws(data: Dataset) -> set[str]:
    """Return the names of the laws' parameters, and of the products of these parameters."""
    laws = laws_named(data.laws)
    names = {quantity.name for law in laws for quantity in law.table}
    return names | {product.quantity.name for law in laws for product in law.products}


def of_reading(means: Mapping[str, float], data: Dataset) -> dict[str, float]:
    """Return a line fit's estimates, under the parameter names of the drive of the noise test."""
    drive = next((part.drive for part in data.parts if part.is_linear), "")
    is_attached = drive in attached(data.parts)
    return {
        named(n, drive) if is_attached and n in OWN[drive] else n: value
        for n, value in means.items()
    }


def sample_joint(
    key: Key[Array, ""], ready: Fitted, settings: Identify, keep: Keep, name: str
) -> xr.DataTree:
    """Draw the posterior by the stated sampler, or by the first sampler that is sufficient.

    The ladder compares coordinates on trial points: those of the box, logarithms of parameters that
    cannot be zero, or coordinates along the ridge of the fit, from wall to wall of the box. If none
    of them suits, it uses the valley that the profile of the least determined parameter follows. A
    named sampler uses the box. Elliptical slices use the ridge if the fit has an open direction or
    is at a bound, otherwise the logarithms; if their chains disagree, they are drawn again around
    their own moments.
    """
    prior, best, data = ready.box, ready.fit, ready.data
    optimum = best.theta, best.covariance
    parametrisations: Places = {
        "logarithms": lambda: along_logarithms(*optimum, prior, never_zero(*optimum, prior)),
        "box": lambda: in_box(prior, *optimum, settings.num_chains),
        "ridge": lambda: along_ridge(*optimum, prior),
    }
    costly_parametrisations: Places = {
        "valley": lambda: about_valley(dataset.stacked, prior, data, best)
    }
    target = Target(dataset.log_likelihood, prior, data, is_costly=data.stepped)
    until = Until(partial(are_enough, data=data, y_peak=ready.y_peak), settings.budget_s)
    until = None if settings.num_samples is not None else until
    if settings.sampler == "auto":
        return climb(
            key,
            target,
            parametrisations,
            Sizes(settings.num_chains, settings.num_samples, settings.num_warmup),
            costly_parametrisations=costly_parametrisations,
            until=until,
            keep=lambda stage: keep(f"{name}_{stage}"),
            attrs=attrs(data.laws),
        )
    sampler = sampler_named(settings.sampler)
    num_warmup, num_samples = settings.draws(sampler.draws)
    slices = sampler.name == "elliptical_slice"
    ridge = best.weak is not None or best.at_bound
    place = parametrisations[("ridge" if ridge else "logarithms") if slices else "box"]()
    request = SamplingRequest(
        sampler.name, num_warmup, num_samples, settings.num_chains,
        "parallel" if jax.device_count() > 1 else "sequential", {"adapt_mass": True},
    )  # fmt: skip
    return sample_until(
        key, target, request, coordinates=place, rounds=ROUNDS if slices else 0,
        until=None if sampler.is_fixed else until,
        keep=lambda i: keep(f"{name}_{i}" if i else name), attrs=attrs(data.laws),
    )  # fmt: skip


def are_enough(
    draws: Mapping[str, Float[np.ndarray, "chain draw"]], data: Dataset, y_peak: float
) -> bool:
    """Return whether chains agree on parameters, products and responses up to `y_peak` [m]."""
    sampled = xr.Dataset({name: (("chain", "draw"), x) for name, x in draws.items()})
    all_variables = sampled.assign(law_variables(sampled, data))
    if not enough({str(name): x.values for name, x in all_variables.data_vars.items()}):
        return False
    bands = response_finding(all_variables, data.held, y_peak, data.laws)
    return bands is None or bands.status != "failed"


def with_derived(key: Key[Array, ""], tree: xr.DataTree, data: Dataset) -> xr.DataTree:
    """Add noise levels, the laws' parameters and their products to a posterior."""
    posterior = posterior_draws(tree)
    terms = tree["log_likelihood"].to_dataset()["terms"].values
    derived = draw_noise_std(key, every_parameter(posterior, data), terms, data)
    derived |= law_variables(posterior, data)
    for name, text in zip(data.stated.names, data.stated.texts, strict=True):
        posterior[name].attrs["prior"] = text
    return tree.assign(posterior=xr.DataTree(posterior.assign(derived)))


def every_parameter(posterior: xr.Dataset, data: Dataset) -> dict[str, np.ndarray]:
    """Return the draws of all parameters by name, including fixed ones."""
    held = {name: np.asarray(value) for name, value in data.held.items()}
    return {**held, **{str(n): v.values for n, v in posterior.data_vars.items()}}


def law_variables(posterior: xr.Dataset, data: Dataset) -> dict[str, Any]:
    """Return draws of those parameters and products of the laws that were not sampled."""
    theta, derived = every_parameter(posterior, data), {}
    for law in laws_named(data.laws):
        parameters = {name: np.asarray(v) for name, v in law.build(theta).parameters().items()}
        named = [(quantity, parameters[quantity.name]) for quantity in law.table]
        named += [
            (product.quantity, product.of({**theta, **parameters})) for product in law.products
        ]
        for quantity, value in named:
            if quantity.name not in posterior:
                derived[quantity.name] = (("chain", "draw"), value, quantity.attrs)
    return derived


def draw_noise_std(
    key: Key[Array, ""], theta: Drawn, terms: Float[np.ndarray, "chain draw term"], data: Dataset
) -> dict[str, Any]:
    """Draw the noise level of each data group for every draw of the parameters."""
    labelled = {label: terms[..., i] for i, label in enumerate(data.labels)}
    derived: dict[str, Any] = {}
    for part in data.parts:
        if not part.dimension:
            continue
        key, part_key = parts_of(key, 2)
        noise = draw_noise(part_key, of_drive(theta, part.drive), labelled, part, data.num_offsets)
        name, dim, number = f"noise_std{part.suffix}", part.dimension, 2
        while name in derived:
            name, dim = f"noise_std{part.suffix}_{number}", f"{part.dimension}_{number}"
            number += 1
        stacked = np.stack([noise[label] for label in part.groups.labels], axis=-1)
        derived[name] = (("chain", "draw", dim), stacked, _attrs(part, name))
        derived[dim] = (dim, list(part.groups.labels))
    return derived


def _attrs(part: Observable, name: str) -> dict[str, Any]:
    attrs = BY_NAME["noise_std"].attrs
    attrs["symbol"] += name.removeprefix("noise_std").replace("_", ", ", 1)
    if not part.groups.unit:  # Data groups in different units (V, N, m) cannot be one variable.
        del attrs["units"]
        group_units = {"group_units": list(part.groups.units)} if all(part.groups.units) else {}
        return {
            **attrs,
            **group_units,
            "long_name": messages.in_group_unit(attrs["long_name"]),
        }
    return {**attrs, "units": part.groups.unit}
