"""`jbw.identify`: a campaign in; a posterior with its verdict, bands and summary out."""

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.campaign.gains import force_per_unit
from jbw.campaign.load import Campaign
from jbw.errors import Attempts
from jbw.identification.assemble import Measured, entered, fitted_repeats, measured_in
from jbw.identification.instruments import (
    Sensors,
    as_recorded,
    instruments_sentence,
    sensors_of,
    spread_of,
    with_instruments,
)
from jbw.identification.linear_step import NAMES, LinearStep, units_of
from jbw.identification.modal import ModalFit
from jbw.identification.paper.sequential_vs_joint import compare_routes
from jbw.identification.procedure import Identification, Report, run_procedure
from jbw.identification.run_effects import runs_summary
from jbw.identification.step import Step
from jbw.identification.usable import usable
from jbw.inference.posterior.finding import Verdict, answers
from jbw.inference.posterior.summary import as_plain, correlations, summarise
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.inference.space.box import require_float64
from jbw.measurement.records import INPUTS, Test, drive_of
from jbw.observables.drives import named
from jbw.quantities import gain_unit
from jbw.report.opening import opening
from jbw.report.result import node, verified
from jbw.study.collect import collect
from jbw.study.identifiability import as_group, look_again, plain
from jbw.study.look import look_groups, look_quietly
from jbw.study.study import Study, input_hashes
from jbw.study.surroundings import constants_sentence
from jbw.verification.predictive_basis import AS_RECORDED
from jbw.verification.verify import with_predictions

logger = logging.getLogger("jbw")
VERSIONED = ("jbw", "jax", "numpyro", "diffrax", "optimistix", "arviz", "numpy", "scipy")
ERRORS = (
    "coverage", "num_values", "nrmse", "half_width", "nrmse_linear", "nrmse_cubic", "extrapolation",
)  # fmt: skip


def identify(
    campaign: Campaign,
    *,
    seed: int | None = None,
    truth: Mapping[str, float] | None = None,
    report: Report = logger.info,
    keep: Keep = no_checkpoint,
    command: str | None = None,
) -> Study:
    """Identify the joint from a campaign: the procedure, verification and validation.

    Args:
        campaign: From `jbw.load_campaign` or the virtual rig.
        seed: Seed of everything random; the campaign's, or 0, when None.
        truth: True parameters of a virtual joint, written beside the results; never used.
        report: Called with one sentence at every stage.
        keep: Where the chains of each posterior outlive the process.
        command: What was typed, for the summary; this process's when None.

    Raises:
        ConfigError: A float32 session, or settings that do not fit the tests.
        DataError: Tests that do not allow the procedure.

    Reference:
        Fig. 2, the procedure.
    """
    require_float64()
    started = perf_counter()
    seed = campaign.settings.seed if seed is None else seed
    gain = force_per_unit(campaign)
    several = campaign.structure is not None and len(campaign.structure.modes) > 1
    tests, left_out = usable(campaign.tests, campaign.settings, gain, several_modes=several)
    for sentence in left_out:
        report(sentence)
    # Before anything is sampled: what is wrong with a record then costs no result.
    report("Reading the records without a model")
    looked = look_quietly(replace(campaign, tests=tests))
    seen = measured_in(campaign, report, tests)
    found = run_procedure(seen, seed=seed, report=report, keep=keep)
    source = _name_gain_unit(tests, found)
    # From here on the posterior is drawn: what cannot be made of it is left out and said.
    attempts = Attempts(report)
    known = attempts.make(
        "The study of identifiability", lambda: look_again(found, campaign.settings, report), None
    )
    tree = collect(seen, found, seed, truth, report, campaign.settings, attempts)
    main = found.main
    verdict = with_predictions(main.verdict, tree)
    outside = attempts.make(
        "The constant of the modes outside the band",
        lambda: constants_sentence(main.posterior["posterior"].to_dataset(), main.held, source),
        None,
    )
    compared = attempts.make("The comparison of the routes", lambda: compare_routes(found), {})
    said = (*left_out, *main.statements, *([outside] if outside else []), *attempts.said)
    fitted = [test for test in seen.chosen if len(test.records)]
    sensors = sensors_of(fitted)
    said = (*said, instruments_sentence(campaign.instruments, sensors))
    main = replace(main, verdict=verdict, statements=said)
    found = replace(found, steps={**found.steps, main.name: main})
    steps = {} if found.linear is None else {"linear": _linear(found.linear, truth or {})}
    wide = _with_instruments(campaign, sensors, found, seed)
    steps |= {
        name: _step(step, truth or {}, wide if name == main.name else None)
        for name, step in found.steps.items()
    }
    if wide is not None:
        recorded = tree["posterior"].to_dataset()
        attrs = {name: values.attrs for name, values in recorded.data_vars.items()}
        tree[AS_RECORDED] = xr.DataTree(as_recorded(recorded, wide))
        widened = {name: wide[name].assign_attrs(attrs[name]) for name in recorded.data_vars}
        tree["posterior"] = xr.DataTree(recorded.assign(widened))
    record = {
        "campaign": campaign.name,
        "verdict": _verdict(verdict),
        "main": main.name,
        "steps": steps,
        "comparison": compared,
        "tests": _tests(seen),
        "predictions": _predictions(tree),
        "loops": _loops(tree),
        "versions": {package: version(package) for package in VERSIONED},
        "seed": seed,
        "inputs": input_hashes(campaign),
        "assembly": _assembly(campaign),
        "command": command or " ".join(["jbw", *sys.argv[1:]]),
        "wall_time_s": round(perf_counter() - started, 2),
    }
    record["look"] = looked.record
    tree = xr.DataTree.from_dict({**tree.to_dict(), **look_groups(looked, entered(seen))})
    record["opening"] = list(opening(record, tree))
    tree["procedure"] = xr.DataTree(steps_group(record))
    if known is not None:
        tree["identifiability"] = xr.DataTree(as_group(known))
        record["identifiability"] = known.summary()
    return Study(tree, record, campaign, found)


def _assembly(campaign: Campaign) -> dict[str, Any]:
    """Assembly, torque, sequence and temperature, as far as the campaign states them."""
    stated = campaign.assembly
    of_tests = {test.assembly for test in campaign.tests if test.assembly}
    name = stated.name or (of_tests.pop() if len(of_tests) == 1 else "")
    numbers = {key: stated[key] for key in ("torque", "sequence", "temperature")}
    return {"assembly": name, **{key: one for key, one in numbers.items() if one is not None}}


def _name_gain_unit(tests: Sequence[Test], found: Identification) -> str:
    """Write the unit of the gain, which the returned one of the source decides, into posteriors."""
    driven = [test for test in tests if not set(INPUTS).isdisjoint(test.records[0].channels)]
    units = {drive_of(t): t.records[0].units[t.records[0].source] for t in reversed(driven)}
    for step in found.steps.values():
        draws = step.posterior["posterior"]
        own = {drive: named("gain", drive) for drive in units if named("gain", drive) in draws}
        rest = [drive for drive in map(drive_of, driven) if drive not in own]
        if rest and "gain" in draws:
            draws["gain"].attrs["units"] = gain_unit(units[rest[0]])
        for drive, name in own.items():
            draws[name].attrs["units"] = gain_unit(units[drive])
    return next(iter(units.values()), "")


def steps_group(record: Mapping[str, Any]) -> xr.Dataset:
    """What the summary says of each step, for the flow diagram; NaN where it drew nothing."""
    # No durations: equal runs leave equal groups.
    steps = record["steps"]
    parameters = [(step.get("parameters") or {}).values() for step in steps.values()]

    def worst(what: str, choose: Callable[..., float]) -> NDArray[np.float64]:
        known = ([row[what] for row in rows if row.get(what) is not None] for rows in parameters)
        return np.array([choose(numbers, default=np.nan) for numbers in known], float)

    verdicts = [(step.get("verdict") or {}).get("status", "") for step in steps.values()]
    return xr.Dataset(
        {
            "verdict": ("step", np.asarray(verdicts, object)),
            "ess": ("step", worst("ess_bulk", min), {"units": "1"}),
            "r_hat": ("step", worst("r_hat", max), {"units": "1"}),
        },
        {"step": np.asarray(list(steps), object)},
        {"main": str(record["main"])},
    )


def _verdict(found: Verdict) -> dict[str, Any]:
    findings = [{**asdict(one), "number": plain(one.number)} for one in found.findings]
    told = {name: asdict(answer) for name, answer in answers(found.findings)}
    return {"status": found.status, "answers": told, "findings": findings}


def _linear(step: LinearStep, truth: Mapping[str, float]) -> dict[str, Any]:
    """Step 2 in the form of the others: a Gaussian about the pooled mean."""
    std = np.sqrt(np.diag(step.pooled.covariance))
    units = units_of(step)
    parameters = {
        name: {
            "map": float(mean),
            "mean": float(mean),
            "sd": float(sd),
            "cv": plain(cv),
            "q005": float(mean - 2.5758 * sd),
            "q995": float(mean + 2.5758 * sd),
            "unit": units[name],
            "truth": truth.get(name),
        }
        for name, mean, sd, cv in zip(NAMES, step.pooled.mean, std, step.pooled.cv, strict=True)
    }
    repeats = step.pooled.num_repeats
    counted = "one record has no CV" if repeats < 2 else f"CV is over {repeats} repeats"
    words = (
        f"Read at {step.y_rms:.2g} m rms of displacement: omega_n is the oscillator's at that "
        f"amplitude, which the joint's softening lowers; {counted}."
    )
    found: dict[str, Any] = {"parameters": parameters, "statements": [words]}
    if step.modal is not None:
        found["modes"] = _modes(step.modal)
        found["statements"].append(_modes_sentence(step.modal))
    return found


def _modes(fit: ModalFit) -> list[dict[str, float]]:
    """Every mode of Step 2 with standard deviations, the joint's own first."""
    columns = (*np.split(fit.theta, [len(fit.omega), 2 * len(fit.omega)]),)
    spreads = (*np.split(fit.std, [len(fit.omega), 2 * len(fit.omega)]),)
    return [
        {
            name: float(value)
            for what, values, sds in zip(
                ("omega_n", "zeta", "residue"), columns, spreads, strict=True
            )
            for name, value in ((what, values[i]), (f"{what}_sd", sds[i]))
        }
        for i in range(len(fit.omega))
    ]


def _modes_sentence(fit: ModalFit) -> str:
    told = ", ".join(
        f"{omega / (2 * np.pi):.4g} Hz ({zeta:.2%})"
        for omega, zeta in zip(fit.omega, fit.zeta, strict=True)
    )
    return (
        f"Fitted with its neighbours in the band, the joint's own mode first: {told}; they leave "
        f"{fit.misfit[0]:.2g} of the lines. The joint is fitted to the first alone."
    )


def _with_instruments(
    campaign: Campaign, sensors: Sensors | None, found: Identification, seed: int
) -> xr.Dataset | None:
    """The main posterior with the stated errors of the instruments; None where none are."""
    if sensors is None or not campaign.instruments.is_stated:
        return None
    main = found.main
    best = main.fit if main.name == "joint" else None
    posterior = main.posterior["posterior"].to_dataset()
    return with_instruments(
        posterior, campaign.instruments, sensors, seed=seed, best=best, data=found.data
    )


def _step(step: Step, truth: Mapping[str, float], wide: xr.Dataset | None = None) -> dict[str, Any]:
    """A posterior in numbers; `wide` is it with the errors of the instruments, where stated."""
    rows = summarise(step.posterior, step.box)
    drawn = step.posterior
    if wide is not None:
        drawn = step.posterior.assign(posterior=xr.DataTree(wide))
        rows = spread_of(rows, summarise(drawn, step.box))
    rows = as_plain(rows)
    posterior = step.posterior["posterior"].to_dataset()
    for name, row in rows.items():
        row["unit"] = posterior[name].attrs.get("units", "1")
        row["truth"] = truth.get(name)
        known = row["truth"] is not None and row["sd"]
        row["z"] = (row["mean"] - row["truth"]) / row["sd"] if known else None
    found = {
        "verdict": _verdict(step.verdict),
        "parameters": rows,
        "statements": list(step.statements),
        "correlation": correlations(drawn),
    }
    if "runs" in step.posterior.children:
        found["runs"] = runs_summary(step.posterior["runs"].to_dataset())
    return {**found, "wall_time_s": round(step.wall_s, 2)}


def _tests(seen: Measured) -> list[dict[str, Any]]:
    """Every test of the campaign, and how many of its repeats were fitted."""
    used, counts = entered(seen), fitted_repeats(seen)
    return [
        {
            "test": test.name,
            "kind": test.kind,
            "level": plain(test.level),
            "level_unit": _unit_of_source(test),
            "run": test.run or None,
            "assembly": test.assembly or None,
            "repeats": len(test.records),
            "fitted": counts.get(test.name, len(test.records)) if used[test.name] else 0,
        }
        for test in seen.tests
    ]


def _unit_of_source(test: Test) -> str:
    units = test.records[0].units
    return next((units[role] for role in INPUTS if role in units), "")


def _predictions(tree: xr.DataTree) -> dict[str, Any]:
    """Coverage and error by test, beside a linear oscillator's; None where not known."""
    found = {}
    for kind, name, test in verified(tree, "nrmse"):
        attrs = test.attrs
        # Tests of several kinds may share a name with another's group.
        called = name if name not in found else f"{name} ({kind})"
        found[called] = {
            "kind": kind,
            "level": _known(attrs, "level"),
            "level_unit": str(attrs.get("level_unit", "")),
            "fitted": bool(attrs["fitted"]),
            **{key: _known(attrs, key) for key in ERRORS},
        }
    return found


def _known(attrs: Mapping[Any, Any], name: str) -> float | None:
    return plain(float(attrs[name])) if name in attrs else None


def _loops(tree: xr.DataTree) -> dict[str, Any]:
    found = node(tree, "validation/loops")
    return {
        name: {
            "level": _known(test.attrs, "level"),
            "tone_hz": float(test.attrs["tone_hz"]),
            **{
                str(key): area.values.tolist()
                for key, area in test.data_vars.items()
                if "area" in str(key)
            },
        }
        for name, test in ({} if found is None else found.children).items()
    }
