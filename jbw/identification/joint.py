"""All parameters set to update: the joint posterior of everything that was measured.

Prepared and fitted, drawn by the sampler that suits what was measured, completed by what follows
from the draws, and checked.
"""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from time import perf_counter
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Key

from jbw.campaign.settings import Identify
from jbw.errors import Attempts
from jbw.identification import accuracy
from jbw.identification.across_kinds import across_kinds, across_kinds_sentence, kinds_of
from jbw.identification.attachments import drive_sentences
from jbw.identification.between_records import between_finding, between_records
from jbw.identification.causes import cause_finding, causes, causes_sentence
from jbw.identification.equivalent import (
    Effects,
    effects,
    effects_sentence,
    hysteresis_finding,
    response_finding,
    within_response,
)
from jbw.identification.joint_answers import GROUP as JOINTS
from jbw.identification.joint_answers import joints_finding, joints_group, joints_words
from jbw.identification.leaving_out import (
    consistency_finding,
    fits_without_each_run,
    leave_one_out,
    left_out_sentence,
)
from jbw.identification.model_discrepancy import (
    discrepancy_finding,
    discrepancy_sentences,
    model_discrepancy,
)
from jbw.identification.no_joint import joint_finding, likely, may_be_absent, without_joint
from jbw.identification.one_mode_readings import NOTHING, Readings, with_readings
from jbw.identification.only_drag import drag_finding, may_be_drag, with_drag
from jbw.identification.own_joints import own_joint_sentences
from jbw.identification.prepare import Fitted, completed, weighed
from jbw.identification.reached import threshold_sentences
from jbw.identification.run_effects import runs_dataset, runs_sentence
from jbw.identification.stated_modes import (
    one_joint_sentences,
    participation_sentences,
    same_joint_sentences,
)
from jbw.identification.step import Step, attrs, finished, means_of
from jbw.identification.widening import ending, widened
from jbw.inference.fit.valley import about_valley
from jbw.inference.generator import parts_of
from jbw.inference.posterior.finding import Amendment, Finding
from jbw.inference.posterior.verdict import enough, verdict
from jbw.inference.samplers.chunked_run import Keep, Until, no_checkpoint
from jbw.inference.samplers.ladder import ROUNDS, Places, Sizes, climb
from jbw.inference.samplers.register import sampler_named
from jbw.inference.samplers.rewhitening import sample_until
from jbw.inference.space.box import box
from jbw.inference.space.problem import Target
from jbw.inference.space.reparametrisation import along_logarithms, in_box, never_zero
from jbw.inference.space.ridge import along_ridge
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.drives import NAMES, attached, named, of_part
from jbw.observables.observable import Drawn, Observable
from jbw.oscillator.laws import laws_named
from jbw.quantities import BY_NAME
from jbw.report.messages import posterior as messages
from jbw.report.messages.discrepancy import one_kind

under_way = logging.getLogger("jbw.progress")
STUCK = {"frozen_chain", "r_hat"}  # findings of a sampler that does not fit the posterior


def joint_step(
    key: Key[Array, ""],
    data: Dataset,
    earlier: Mapping[str, Step],
    settings: Identify,
    *,
    name: str = "joint",
    keep: Keep = no_checkpoint,
    at_fit: Callable[[Fitted], None] = lambda ready: None,
    readings: Readings = NOTHING,
) -> tuple[Step, Dataset]:
    """Joint posterior of all parameters of the joint, the gain and the noise, and its dataset.

    The posterior has the laws' products too; the dataset is as it was sampled, with the offsets of
    the runs, effective values and solver steps. `earlier` are the paper's steps, if they were run;
    `at_fit` is called with the fit before anything is drawn.

    Reference:
        Eq. (37), with every parameter set to update.
    """
    started = perf_counter()
    keys = parts_of(key, 5)
    estimates: dict[str, float] = {}
    for step in ("third_order_nuts", "opening_nuts"):
        if step in earlier:
            estimates |= _of_reading(means_of(earlier[step].posterior), data)
    ready = with_readings(weighed(keys[:2], data, settings, estimates | readings.known), readings)
    ready = completed(keys[1], without_absent_joint(keys[0], ready) or ready, settings)
    at_fit(ready)
    chains = sample_joint(keys[2], ready, settings, keep, name)
    if (wider := widened(chains, ready, settings.prior)) is not None:
        ready = wider
        chains = sample_joint(jax.random.fold_in(keys[2], 1), ready, settings, keep, f"{name}_wide")
    chains.attrs["substeps"] = accuracy.substeps_of(ready.data)
    posterior = with_derived(keys[3], chains, ready.data)
    groups, findings, words = posterior_checks(keys[4], posterior["posterior"].to_dataset(), ready)
    for group, arrays in groups.items():
        posterior[group] = xr.DataTree(arrays)
    by_chains = verdict(
        posterior,
        ready.box,
        chi_square=ready.chi_square,
        ending=ending(ready.box, ready.data.laws),
    )
    findings = [*by_chains.findings, *ready.findings, *findings]
    step = finished(
        name, posterior, ready.box, ready.fit, started,
        findings=findings,
        amendments=amendments_of(posterior, groups, ready),
        statements=[*ready.statements, *drawn(posterior.attrs), *words],
        held=ready.data.held,
    )  # fmt: skip
    advice = stuck(step.posterior, findings)
    return replace(step, statements=(*step.statements, *advice)), ready.data


def amendments_of(
    posterior: xr.DataTree, groups: Mapping[str, xr.Dataset], ready: Fitted
) -> list[Amendment | None]:
    """What the errors of the fit, of fits without each run, and the response say of findings."""
    residuals = dataset.left_by_label(ready.fit.residual, ready.data)
    amendments = [accuracy.within_misfit(dataset.error_by_label(residuals, ready.data))]
    if (left_out := groups.get("leave_one_out")) is not None:
        errors = left_out["fitted"].values.tolist(), left_out["error"].values.tolist()
        amendments.append(
            accuracy.within_unseen(accuracy.OF_MISFIT, *errors, messages.EACH_FROM_OTHERS)
        )
    draws, data = posterior["posterior"].to_dataset(), ready.data
    return [*amendments, within_response(draws, data.held, ready.y_peak, data.laws)]


def without_absent_joint(key: Key[Array, ""], ready: Fitted) -> Fitted | None:
    """The structure without its joint, where the fit sees none; None where it may see one.

    Asked as soon as noise, run effects and residual terms are settled: coordinates and solver steps
    of a joint that is not there are not looked for.

    Along the ridge of a joint that the data do not see there is nothing to draw: what a joint may
    do at most is told by the points about the fit that the data do not rule out.
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


def seen_drag(added: Effects, ready: Fitted, *, misses: bool) -> Finding | None:
    """Whether drag fits as well as the laws of hysteresis; None where these soften as slip does."""
    best, data, y_peak = ready.fit, ready.data, ready.y_peak
    zeta = {**data.held, **best.theta}["zeta"]
    if data.modes is not None or not may_be_drag(added, zeta, data.laws):
        return None
    damping = float(zeta * np.median(added.damping))
    drag = with_drag(best, ready.box, data, damping, y_peak)
    return drag_finding(drag, added, y_peak, misses=misses)


def names_of_laws(data: Dataset) -> set[str]:
    """Names of the parameters of the laws and their products."""
    laws = laws_named(data.laws)
    names = {quantity.name for law in laws for quantity in law.table}
    return names | {product.quantity.name for law in laws for product in law.products}


def _of_reading(means: Mapping[str, float], data: Dataset) -> dict[str, float]:
    """What the paper's steps know, under the names of the drive of the noise that they read."""
    drive = next((part.drive for part in data.parts if part.is_linear), "")
    is_attached = drive in attached(data.parts)
    return {
        named(n, drive) if is_attached and n in NAMES else n: value for n, value in means.items()
    }


def sample_joint(
    key: Key[Array, ""], ready: Fitted, settings: Identify, keep: Keep, name: str
) -> xr.DataTree:
    """Draws by the settings' sampler, or by the ladder of samplers.

    Coordinates are chosen by looking: the box's own, the logarithms of what cannot be zero, or
    those along the ridge of the fit, from wall to wall of the box; where none of them do, along the
    valley that the profile of the least known parameter follows. A named sampler draws along the
    ridge where the fit leaves a direction open or runs into a wall, slices otherwise along the
    logarithms; slices whose chains disagree are drawn again about their own moments.
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
    return sample_until(
        key, target, coordinates=place, rounds=ROUNDS if slices else 0,
        until=None if sampler.is_fixed else until,
        keep=lambda i: keep(f"{name}_{i}" if i else name),
        sampler=sampler.name, num_chains=settings.num_chains,
        num_warmup=num_warmup, num_samples=num_samples,
        chain_method="parallel" if jax.device_count() > 1 else "sequential",
        options={"adapt_mass": True}, attrs=attrs(data.laws),
    )  # fmt: skip


def drawn(facts: Mapping[Any, Any]) -> list[str]:
    """How the ladder drew: coordinates, evaluations and evidence, in words."""
    if "coordinates" not in facts:
        return []
    counted = facts["num_evaluations"]
    sentences = [messages.sampler(facts["sampler"], counted, facts["coordinates"])]
    if "log_evidence" in facts:
        sentences += [messages.evidence(facts["log_evidence"], facts["log_evidence_error"])]
    return [" ".join(sentences)]


def are_enough(
    draws: Mapping[str, Float[np.ndarray, "chain draw"]], data: Dataset, y_peak: float
) -> bool:
    """Whether chains agree on every parameter, product and response band up to `y_peak` [m]."""
    sampled = xr.Dataset({name: (("chain", "draw"), x) for name, x in draws.items()})
    all_variables = sampled.assign(law_variables(sampled, data))
    if not enough({str(name): x.values for name, x in all_variables.data_vars.items()}):
        return False
    bands = response_finding(all_variables, data.held, y_peak, data.laws)
    return bands is None or bands.status != "failed"


def stuck(posterior: xr.DataTree, findings: Iterable[Finding]) -> list[str]:
    """What to do where elliptical slices do not mix, in words; nothing where they do."""
    failed = {finding.code for finding in findings if finding.status != "ok"}
    if posterior.attrs.get("sampler") != "elliptical_slice" or not failed & STUCK:
        return []
    return [messages.TOO_CURVED]


def with_derived(key: Key[Array, ""], tree: xr.DataTree, data: Dataset) -> xr.DataTree:
    """The posterior with the noise of each group, the laws' own parameters and their products."""
    posterior = tree["posterior"].to_dataset()
    terms = tree["log_likelihood"].to_dataset()["terms"].values
    derived = draw_noise_std(key, every_parameter(posterior, data), terms, data)
    derived |= law_variables(posterior, data)
    for name, text in zip(data.stated.names, data.stated.texts, strict=True):
        posterior[name].attrs["prior"] = text
    return tree.assign(posterior=xr.DataTree(posterior.assign(derived)))


def every_parameter(posterior: xr.Dataset, data: Dataset) -> dict[str, np.ndarray]:
    """Draws by name, and what was held."""
    held = {name: np.asarray(value) for name, value in data.held.items()}
    return {**held, **{str(n): v.values for n, v in posterior.data_vars.items()}}


def law_variables(posterior: xr.Dataset, data: Dataset) -> dict[str, Any]:
    """The laws' own parameters and their products, where they were not sampled."""
    theta, derived = every_parameter(posterior, data), {}
    for law in laws_named(data.laws):
        parameters = {name: np.asarray(v) for name, v in law.of(theta).parameters().items()}
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
    """One exact draw of each group's noise for every draw of the parameters, a row a group."""
    labelled = {label: terms[..., i] for i, label in enumerate(data.labels)}
    derived: dict[str, Any] = {}
    for part in data.parts:
        if not part.dimension:
            continue
        key, part_key = parts_of(key, 2)
        noise = part.draw_noise(part_key, of_part(theta, part), labelled, data.num_offsets)
        name, dim, number = f"noise_std{part.suffix}", part.dimension, 2
        while name in derived:
            name, dim = f"noise_std{part.suffix}_{number}", f"{part.dimension}_{number}"
            number += 1
        stacked = np.stack([noise[label] for label in part.labels], axis=-1)
        derived[name] = (("chain", "draw", dim), stacked, _attrs(part, name))
        derived[dim] = (dim, list(part.labels))
    return derived


def _attrs(part: Observable, name: str) -> dict[str, Any]:
    attrs = BY_NAME["noise_std"].attrs
    attrs["symbol"] += name.removeprefix("noise_std").replace("_", ", ", 1)
    if not part.unit:  # a group is in volts, newtons or metres: no unit holds for all
        del attrs["units"]
        group_units = {"group_units": list(part.units)} if all(part.units) else {}
        return {
            **attrs,
            **group_units,
            "long_name": messages.in_group_unit(attrs["long_name"]),
        }
    return {**attrs, "units": part.unit}


def posterior_checks(
    key: Key[Array, ""], posterior: xr.Dataset, ready: Fitted
) -> tuple[dict[str, xr.Dataset], list[Finding], list[str]]:
    """Labelled arrays to keep beside the draws by name, findings, and sentences for the reader."""
    prior, best, data = ready.box, ready.fit, ready.data
    groups: dict[str, xr.Dataset] = {}
    words: list[str] = []
    residuals = dataset.left_by_label(best.residual, data)
    error = dataset.error_by_label(residuals, data)
    y_peak = ready.y_peak
    theta = dataset.as_arrays(best.theta, data)
    attempts = Attempts()

    def checked(checks: Mapping[str, Callable[[], Finding | None]]) -> list[Finding | None]:
        outcomes = []
        for label, check in checks.items():
            under_way.info("check of %s", label)
            outcomes.append(attempts.make(messages.check_of(label), check, None))
        return outcomes

    def lack_of_fit() -> Finding | None:
        why = causes(best, data)
        words.extend([causes_sentence(why)] if why else [])
        return cause_finding(why)

    findings = checked(
        {
            messages.RESIDUAL: lambda: accuracy.residual_finding(
                residuals, dataset.fractions_counted(data), error, data.laws
            ),
            messages.SHAPE: lambda: accuracy.shape_finding(error, data),
            messages.REPEATS: lambda: accuracy.repeatability_finding(error, data),
        }
    )
    misses = any(finding is not None and finding.status != "ok" for finding in findings)
    findings += checked(
        {
            messages.SOLVER_STEPS: lambda: accuracy.solver_finding(
                posterior[list(prior.names)], data
            ),
            messages.RESPONSE_BANDS: lambda: response_finding(
                posterior, data.held, y_peak, data.laws
            ),
        }
    )
    if misses:
        findings += checked({messages.CAUSES: lack_of_fit})
    runs = attempts.make(
        messages.OFFSETS, lambda: runs_dataset(key, posterior, prior.names, data), None
    )
    if runs is not None:
        groups["runs"] = runs
        words.append(runs_sentence(runs))
    joints = attempts.make(messages.JOINT_SHARES, lambda: joints_group(posterior, data), None)
    if joints is not None:
        groups[JOINTS] = joints
        words += joints_words(joints)
        findings.append(joints_finding(joints))
    sentences: dict[str, Callable[[], Iterable[str]]] = {
        "tests": lambda: [x for part in data.parts for x in part.statements(of_part(theta, part))],
        "drives": lambda: drive_sentences(theta, data),
        messages.PARTICIPATION: lambda: participation_sentences(posterior, data.modes),
        messages.ONE_JOINT: lambda: one_joint_sentences(best, prior, data),
        messages.JOINT_DIFFERENCE: lambda: same_joint_sentences(posterior, data),
        messages.JOINT_OF_MODES: lambda: own_joint_sentences(key, best, data),
    }
    for topic, build in sentences.items():
        words += attempts.make(messages.statement_on(topic), build, ())

    added = attempts.make(
        messages.JOINT_EFFECT, lambda: effects(posterior, data.held, y_peak, data.laws), None
    )
    if added is not None:
        words += [effects_sentence(added, y_peak)] if joints is None else []
        findings += checked(effect_checks(added, ready, misses=misses))
    words += attempts.make(
        messages.THRESHOLDS,
        lambda: threshold_sentences(every_parameter(posterior, data), y_peak, data.laws),
        (),
    )

    without_each = cache(lambda: fits_without_each_run(best, prior, data))

    def each_test_left_out() -> Finding | None:
        if (left_out := leave_one_out(best, prior, data, without_each())) is None:
            return None
        groups["leave_one_out"] = left_out
        words.append(left_out_sentence(left_out))
        return consistency_finding(left_out, data.laws)

    def left_beyond_noise() -> Finding | None:
        groups["discrepancy"] = model_discrepancy(best, prior, data, without_each())
        words.extend(discrepancy_sentences(groups["discrepancy"]))
        return discrepancy_finding(groups["discrepancy"], data.laws)

    def each_kind_left_out() -> Finding | None:
        if (predicted := across_kinds(best, prior, data)) is not None:
            groups["across_kinds"] = predicted
            words.append(across_kinds_sentence(predicted))
        else:
            words.extend(map(one_kind, kinds_of(data)))
        return None

    def each_record_alone() -> Finding | None:
        if (between := between_records(best, prior, data)) is None:
            return None
        groups["between_records"] = between
        return between_finding(between)

    findings += checked(
        {
            messages.WITHOUT_EACH_TEST: each_test_left_out,
            messages.DISCREPANCY: left_beyond_noise,
            messages.WITHOUT_EACH_KIND: each_kind_left_out,
            messages.EACH_RECORD: each_record_alone,
        }
    )
    findings.append(incomplete_finding(attempts.said))
    return groups, [finding for finding in findings if finding is not None], words


def effect_checks(
    added: Effects, ready: Fitted, *, misses: bool
) -> dict[str, Callable[[], Finding | None]]:
    """Checks of what the joint adds: hysteresis, or drag in its place, and whether it is seen."""

    def joint() -> Finding | None:
        without = without_joint(ready.fit, ready.box, ready.data)
        return joint_finding(without, added, ready.y_peak)

    hysteresis = partial(seen_hysteresis, added, ready, misses=misses)
    checks: dict[str, Callable[[], Finding | None]] = {messages.HYSTERESIS: hysteresis}
    return checks | ({messages.JOINT_SEEN: joint} if may_be_absent(added) else {})


def seen_hysteresis(added: Effects, ready: Fitted, *, misses: bool) -> Finding | None:
    """Whether hysteresis is seen, or drag fits as well; None where nothing speaks against it."""
    finding = hysteresis_finding(added, ready.y_peak, ready.data.laws, misses=misses)
    return finding or seen_drag(added, ready, misses=misses)


def incomplete_finding(said: Sequence[str]) -> Finding | None:
    """Checks that could not be made, in the sentences on them; None where all were."""
    if not said:
        return None
    return Finding("incomplete_checks", "not assessed", {"sentences": said}, float(len(said)))
