"""The content of a study's `summary.json`: steps, verdict, predictions, inputs and versions."""

import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr

from jbw.campaign.load import Campaign
from jbw.identification.across_kinds import across_kinds_record, kinds_of
from jbw.identification.assemble import Measured, entered, fitted_repeats
from jbw.identification.discrepancy import unscored_levels
from jbw.identification.instruments import Sensors, spread_of, with_instruments
from jbw.identification.joint_answers import JOINTS, joints_record
from jbw.identification.linear_step import NAMES, LinearStep, units_of
from jbw.identification.modal import ModalFit
from jbw.identification.procedure import Identification
from jbw.identification.run_effects import runs_summary
from jbw.identification.step import Step
from jbw.identification.tied_joints import tied_record
from jbw.inference.posterior.quantiles import HALF_99
from jbw.inference.posterior.summary import as_plain, correlations, posterior_draws, summarise
from jbw.inference.space.stated import StatedDensities
from jbw.measurement.records import INPUTS, Test
from jbw.observables.dataset import Dataset
from jbw.report.messages import study as messages
from jbw.report.result import node, verified
from jbw.results.attributes import PredictedTest, StoredVariable
from jbw.results.run import RunSummary, StoredParameter, StoredStep
from jbw.results.stored import finite
from jbw.sources import sources_of
from jbw.study.order import Order
from jbw.study.study import input_hashes

VERSIONED = ("jbw", "jax", "numpyro", "diffrax", "optimistix", "arviz", "numpy", "scipy")
ERRORS = (
    "coverage", "num_values", "nrmse", "nrmse_own_frequency", "half_width", "nrmse_linear",
    "nrmse_cubic", "extrapolation",
)  # fmt: skip

# Steps whose prior includes the densities that the campaign states.
OF_ALL = ("joint", "decay")


def record_of(
    order: Order,
    measured: Measured,
    found: Identification,
    tree: xr.DataTree,
    *,
    compared: Mapping[str, Any],
    wide: xr.Dataset | None = None,
    **more: Any,
) -> RunSummary:
    """Return the content of `summary.json` for an identification.

    `compared` is the comparison of the routes; `wide` is the main posterior with the errors of the
    instruments, where they are stated; `more` are additional entries.
    """
    campaign, truth = order.campaign, order.truth
    steps = {} if found.linear is None else {"linear": _linear(found.linear, truth or {})}
    stated = None if found.data is None else found.data.stated
    steps |= {
        name: step_record(
            step,
            truth or {},
            wide if name == found.main.name else None,
            stated if name in OF_ALL else None,
        )
        for name, step in found.steps.items()
    }
    record = {
        "campaign": campaign.name,
        "verdict": found.main.verdict.stored(),
        "main": found.main.name,
        "steps": steps,
        "comparison": compared,
        "tests": fitted_and_held_out(measured),
        "predictions": _predictions(tree),
        "across_kinds": _across_kinds(tree),
        "unscored": _unscored(tree, found.data),
        "loops": _loops(tree),
        **_joints(tree),
        **_turning(campaign.tests),
        "versions": {package: version(package) for package in VERSIONED},
        "sources": sources_of("jbw"),
        "seed": order.seed,
        "inputs": input_hashes(campaign),
        "assembly": _assembly(campaign),
        "command": order.command or " ".join(["jbw", *sys.argv[1:]]),
        "wall_time_s": round(perf_counter() - order.started, 2),
    }
    return RunSummary.read(record | more)


def _turning(tests: Iterable[Test]) -> dict[str, str]:
    """Return the unit rad as the unit of motion if all tests are torsional; otherwise nothing."""
    units = {record.units.get(record.response, "") for test in tests for record in test.records}
    turns = units and all(unit.startswith("rad") for unit in units)
    return {"motion_unit": "rad"} if turns else {}


def _assembly(campaign: Campaign) -> dict[str, Any]:
    """Return the name, torque, tightening number and temperature that a campaign states."""
    stated = campaign.assembly
    of_tests = {test.assembly for test in campaign.tests if test.assembly}
    name = stated.name or (of_tests.pop() if len(of_tests) == 1 else "")
    numbers = {key: stated[key] for key in ("torque", "sequence", "temperature")}
    return {"assembly": name, **{key: value for key, value in numbers.items() if value is not None}}


def steps_group(summary: RunSummary) -> xr.Dataset:
    """Return verdict, ESS and R-hat of each step for the diagram of steps; NaN without draws."""
    # Durations are not stored: equal runs must give equal groups.
    steps = summary.steps.values()
    ess = [min(step.known("ess_bulk"), default=np.nan) for step in steps]
    r_hat = [max(step.known("r_hat"), default=np.nan) for step in steps]
    return xr.Dataset(
        {
            "verdict": ("step", np.asarray([step.verdict.status for step in steps], object)),
            "ess": ("step", np.array(ess, float), {"units": "1"}),
            "r_hat": ("step", np.array(r_hat, float), {"units": "1"}),
        },
        {"step": np.asarray(list(summary.steps), object)},
        {"main": summary.main},
    )


def fitted_and_held_out(seen: Measured) -> list[dict[str, Any]]:
    """Return kind, level and fitted repeats of each test of a campaign."""
    used, repeats = entered(seen), fitted_repeats(seen)
    return [
        {
            "test": test.name,
            "kind": test.kind,
            "level": finite(test.level),
            "level_unit": _unit_of_source(test),
            "run": test.run or None,
            "assembly": test.assembly or None,
            "repeats": len(test.records),
            "fitted": len(chosen),
            "fitted_repeats": chosen,
        }
        for test in seen.tests
        for chosen in [repeats[test.name] if used[test.name] else []]
    ]


def _unit_of_source(test: Test) -> str:
    units = test.records[0].units
    return next((units[role] for role in INPUTS if role in units), "")


def _linear(step: LinearStep, truth: Mapping[str, float]) -> dict[str, Any]:
    """Return the parameters of the linear FRF fit (Step 2) as plain values."""
    std = np.sqrt(np.diag(step.pooled.covariance))
    units = units_of(step)
    parameters = {
        name: {
            "map": float(mean),
            "mean": float(mean),
            "sd": float(sd),
            "cv": finite(cv),
            "q005": float(mean - HALF_99 * sd),
            "q995": float(mean + HALF_99 * sd),
            "unit": units[name],
            "truth": truth.get(name),
        }
        for name, mean, sd, cv in zip(NAMES, step.pooled.mean, std, step.pooled.cv, strict=True)
    }
    repeats = step.pooled.num_repeats
    words = messages.step_2(step.y_rms, repeats)
    if step.modal is None:
        return {"parameters": parameters, "statements": [words]}
    statements = [words, _modes_sentence(step.modal)]
    return {"parameters": parameters, "statements": statements, "modes": _modes(step.modal)}


def _modes(fit: ModalFit) -> list[dict[str, float]]:
    """Return every mode of the FRF fit with standard deviations, the joint's own mode first."""
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
    hertz = [float(omega / (2 * np.pi)) for omega in fit.omega]
    modes = list(zip(hertz, map(float, fit.zeta), strict=True))
    return messages.neighbours(modes, float(fit.misfit[0]))


def widened_by_instruments(
    campaign: Campaign, sensors: Sensors | None, found: Identification, seed: int
) -> xr.Dataset | None:
    """Return the main posterior widened by stated instrument errors; None if none are stated."""
    if sensors is None or not campaign.instruments.is_stated:
        return None
    main = found.main
    best = main.fit if main.name == "joint" else None
    posterior = posterior_draws(main.posterior)
    return with_instruments(
        posterior, campaign.instruments, sensors, seed=seed, best=best, data=found.data
    )


def step_record(
    step: Step,
    truth: Mapping[str, float],
    wide: xr.Dataset | None = None,
    stated: StatedDensities | None = None,
) -> StoredStep:
    """Return a step's posterior as stored values: parameters, statements, correlations.

    `wide` is the posterior with the errors of the instruments, where they are stated; `stated` are
    the prior densities other than the box.
    """
    rows = summarise(step.posterior, step.box, stated)
    drawn = step.posterior
    if wide is not None:
        drawn = step.posterior.assign(posterior=xr.DataTree(wide))
        rows = spread_of(rows, summarise(drawn, step.box, stated))
    rows = as_plain(rows)
    posterior = posterior_draws(step.posterior)
    runs = step.posterior.children.get("runs")
    return StoredStep(
        verdict=step.verdict.stored(),
        parameters={
            name: _parameter(row, StoredVariable.of(posterior[name]).units or "1", truth.get(name))
            for name, row in rows.items()
        },
        statements=list(step.statements),
        correlation=correlations(drawn),
        **({} if runs is None else {"runs": runs_summary(runs.to_dataset())}),
        wall_time_s=round(step.wall_s, 2),
    )


def _parameter(row: dict[str, Any], unit: str, truth: float | None) -> StoredParameter:
    """Return a parameter's row with unit and distance from the rig's true value [sd]."""
    parameter = StoredParameter(**row, unit=unit, truth=truth, z=None)
    mean, sd = parameter.mean, parameter.sd
    if truth is None or mean is None or not sd:
        return parameter
    return parameter.replaced(z=(mean - truth) / sd)


def _predictions(tree: xr.DataTree) -> dict[str, Any]:
    """Return the coverage and error of each test's prediction, and a linear model's error.

    A number is None if it is unknown.
    """
    predictions = {}
    for kind, name, test in verified(tree, "nrmse"):
        attrs = PredictedTest.of(test)
        # Groups of different kinds of test may have the same name.
        called = name if name not in predictions else f"{name} ({kind})"
        predictions[called] = {
            "kind": kind,
            "level": finite(attrs.level),
            "level_unit": attrs.level_unit,
            "fitted": bool(attrs.fitted),
            **{key: finite(test.attrs.get(key)) for key in ERRORS},
            **({"withheld": True} if attrs.withheld else {}),
        }
    return predictions


def _across_kinds(tree: xr.DataTree) -> dict[str, Any]:
    """Return the error of predicting each kind of test from the other kinds; empty if unknown."""
    group = node(tree, "across_kinds")
    return {} if group is None else across_kinds_record(group.to_dataset())


def _unscored(tree: xr.DataTree, data: Dataset | None) -> dict[str, str]:
    """Return the reasons why errors at other levels or kinds of test are unknown, if any."""
    missed = node(tree, "discrepancy")
    if missed is None or data is None or "run" not in missed.coords:  # as in a first answer
        return {}
    tests = [(kind, PredictedTest.of(test).fitted) for kind, _, test in verified(tree, "fitted")]
    held_out = {kind for kind, is_fitted in tests if not is_fitted}
    fitted = {kind for kind, is_fitted in tests if is_fitted}
    kinds = tuple(kinds_of(data))
    return {
        "levels": "" if held_out else unscored_levels(missed.to_dataset()),
        "kind": kinds[0] if len(kinds) == 1 and held_out <= fitted else "",
    }


def _joints(tree: xr.DataTree) -> dict[str, Any]:
    """Return the effect of each joint on each mode of a run; empty for a single joint."""
    group = node(tree, JOINTS)
    if group is None:
        return {}
    tied = tied_record(group.attrs)
    joints = joints_record(group.to_dataset())
    return {"joints": joints if tied is None else {**(joints or {}), "tied": tied}}


def _loops(tree: xr.DataTree) -> dict[str, Any]:
    loops = node(tree, "validation/loops")
    return {
        name: {
            "level": finite(PredictedTest.of(test).level),
            "tone_hz": PredictedTest.of(test).tone_hz,
            **{
                str(key): area.values.tolist()
                for key, area in test.data_vars.items()
                if "area" in str(key)
            },
        }
        for name, test in ({} if loops is None else loops.children).items()
    }
