"""What `summary.json` holds: every step and parameter in numbers, and what they mean in words."""

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr

from jbw.identification.linear_step import NAMES, LinearStep, units_of
from jbw.identification.paper.sequential_vs_joint import compare_routes
from jbw.identification.procedure import Identification
from jbw.identification.run_effects import runs_summary
from jbw.identification.step import Step
from jbw.inference.posterior.summary import as_plain, correlations, summarise
from jbw.inference.posterior.verdict import Verdict
from jbw.report.result import node

VERSIONED = ("jbw", "jax", "numpyro", "diffrax", "optimistix", "arviz", "numpy", "scipy")
ERRORS = ("coverage", "num_values", "nrmse", "nrmse_linear", "nrmse_cubic", "extrapolation")
PREDICTED = ("sweep", "curve", "loop", "multisine", "decay")


def summarise_study(
    name: str,
    found: Identification,
    tree: xr.DataTree,
    *,
    seed: int,
    inputs: Mapping[str, str],
    truth: Mapping[str, float] | None,
    command: str,
    wall_s: float,
) -> dict[str, Any]:
    """The summary of a study, plain values only.

    Args:
        name: The campaign's name.
        found: What the procedure found.
        tree: The collected result.
        seed: Seed of the run.
        inputs: Input files and their hashes.
        truth: True parameters where the campaign is virtual.
        command: What was typed.
        wall_s: Duration of the whole study [s].

    Returns:
        A dictionary for JSON.
    """
    truth = truth or {}
    steps = {} if found.linear is None else {"linear": _linear(found.linear, truth)}
    steps |= {key: _step(step, truth) for key, step in found.steps.items()}
    return {
        "campaign": name,
        "verdict": _verdict(found.main.verdict),
        "main": found.main.name,
        "steps": steps,
        "comparison": compare_routes(found),
        "predictions": _predictions(tree),
        "loops": _loops(tree),
        "versions": {package: version(package) for package in VERSIONED},
        "seed": seed,
        "inputs": dict(inputs),
        "command": command,
        "wall_time_s": round(wall_s, 2),
    }


def _verdict(found: Verdict) -> dict[str, Any]:
    findings = [asdict(finding) for finding in found.findings]
    for finding in findings:
        finding["number"] = _plain(finding["number"])
    return {"status": found.status, "findings": findings}


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _counted(num_repeats: int) -> str:
    if num_repeats < 2:
        return "one record has no CV"
    return f"CV is over {num_repeats} repeats"


def _linear(step: LinearStep, truth: Mapping[str, float]) -> dict[str, Any]:
    """Step 2 in the form of the others: a Gaussian about the pooled mean."""
    std = np.sqrt(np.diag(step.pooled.covariance))
    units = units_of(step)
    parameters = {
        name: {
            "map": float(mean),
            "mean": float(mean),
            "sd": float(sd),
            "cv": _plain(cv),
            "q005": float(mean - 2.5758 * sd),
            "q995": float(mean + 2.5758 * sd),
            "unit": units[name],
            "truth": truth.get(name),
        }
        for name, mean, sd, cv in zip(NAMES, step.pooled.mean, std, step.pooled.cv, strict=True)
    }
    words = (
        f"Read at {step.y_rms:.2g} m rms of displacement: omega_n is the oscillator's at that "
        f"amplitude, which the joint's softening lowers; {_counted(step.pooled.num_repeats)}.",
    )
    return {"parameters": parameters, "statements": list(words)}


def _step(step: Step, truth: Mapping[str, float]) -> dict[str, Any]:
    rows = as_plain(summarise(step.posterior, step.box))
    posterior = step.posterior["posterior"].to_dataset()
    for name, row in rows.items():
        row["unit"] = posterior[name].attrs.get("units", "unit of the group")
        row["truth"] = truth.get(name)
        known = row["truth"] is not None and row["sd"]
        row["z"] = (row["mean"] - row["truth"]) / row["sd"] if known else None
    return {
        "verdict": _verdict(step.verdict),
        "parameters": rows,
        "statements": list(step.statements),
        "correlation": correlations(step.posterior),
        **_runs(step),
        "wall_time_s": round(step.wall_s, 2),
    }


def _runs(step: Step) -> dict[str, Any]:
    """Every run's own values and their scatter, where runs have offsets."""
    if "runs" not in step.posterior.children:
        return {}
    return {"runs": runs_summary(step.posterior["runs"].to_dataset())}


def _predictions(tree: xr.DataTree) -> dict[str, Any]:
    """Coverage and error by test, beside a linear oscillator's; None where not known."""
    found = {}
    for kind in PREDICTED:
        for name, test in _tests(tree, f"verification/{kind}").items():
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
    return _plain(float(attrs[name])) if name in attrs else None


def _loops(tree: xr.DataTree) -> dict[str, Any]:
    return {
        name: {
            "level": _known(node.attrs, "level"),
            "tone_hz": float(node.attrs["tone_hz"]),
            **{
                str(key): [float(value) for value in area.values]
                for key, area in node.data_vars.items()
                if "area" in str(key)
            },
        }
        for name, node in _tests(tree, "validation/loops").items()
    }


def _tests(tree: xr.DataTree, path: str) -> dict[str, xr.DataTree]:
    """The tests under a group, none where the group is absent."""
    found = node(tree, path)
    return {} if found is None else dict(found.children)
