"""`jbw.sbc`: does a step of the procedure hold the truth as often as it says?"""

import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import xarray as xr

from jbw.campaign.load import Campaign
from jbw.errors import ConfigError
from jbw.identification.procedure import Report
from jbw.identification.step import attrs
from jbw.inference.calibration.record import Calibration
from jbw.inference.calibration.replications import Model, calibrate
from jbw.inference.samplers.register import SAMPLERS, Sampler, options_of
from jbw.inference.samplers.register import sampler_named as registered
from jbw.inference.space.box import require_float64
from jbw.quantities import BY_NAME, attrs_of
from jbw.report.studies import rank_ecdfs
from jbw.study import calibration_designs as designs
from jbw.study import calibration_models as models
from jbw.study.store import write_figure, write_json

logger = logging.getLogger("jbw")
STEPS = ("linear", "third_order", "opening", "joint")
REPLICATIONS = {"linear": 1000, "third_order": 1000, "opening": 1000, "joint": 200}
NOISES = ("unknown", "known")
# Of chains that start about a fit, and of those that cross the box.
SHORT = {"num_warmup": 30, "num_samples": 125}
LONG = {"num_warmup": 500, "num_samples": 500}
COUNTS = {
    "importance": {"num_samples": 250, "num_draws": 4096, "num_rounds": 2},
    "tempered_smc": {"num_samples": 512, "num_chains": 2},
    "nested": {"num_samples": 250, "num_chains": 2},
    "quadrature": {"num_samples": 250},
    "random_walk_paper": {},
}
STEPPED = {"importance": {"num_samples": 128, "num_draws": 2048}}


@dataclass(frozen=True)
class Sbc:
    """Result of `sbc`.

    Attributes:
        calibration: Ranks, coverage, failures and the verdict.
        tree: The ranks as a labelled tree.
        record: All numbers in plain values, as `sbc.json` holds them.
    """

    calibration: Calibration
    tree: xr.DataTree
    record: dict[str, Any]


def sbc(
    campaign: Campaign | None = None,
    *,
    step: str = "third_order",
    num_replications: int | None = None,
    sampler: str | None = None,
    noise: str = "unknown",
    seed: int = 0,
    report: Report = logger.info,
) -> Sbc:
    """Draw truths from the prior, simulate, identify, and rank each truth in its posterior.

    Args:
        campaign: Whose tests, noise and prior are taken; short tests of the virtual rig when None.
            Step 2 knows no campaign, and the joint posterior is that of its sweeps alone.
        step: "linear" (Step 2), "third_order" (Step 3), "opening" (Step 4) or "joint".
        num_replications: Truths; 1000, of the joint posterior 200, when None.
        sampler: One of those that `[identify] sampler` takes; the cheapest that crosses the
            posterior when None.
        noise: Whether the likelihood of Step 3 has to learn the noise from the repeats ("unknown",
            as a campaign is identified) or is told ("known", as the paper supposes).
        seed: Seed of everything random.
        report: Called with one sentence as the work proceeds.

    Returns:
        Ranks, p-values, coverage of 99 % intervals, failures and the verdict.

    Raises:
        ConfigError: An unknown step, sampler or noise, or a float32 session.
        DataError: A campaign whose tests do not allow the step.

    Reference:
        Talts et al. (2018), arXiv:1804.06788; Modrak et al. (2023), Bayesian Analysis 20, 461.
    """
    require_float64()
    _check(step, sampler, noise)
    count = REPLICATIONS[step] if num_replications is None else num_replications
    started, key = perf_counter(), jax.random.key(seed)

    def progress(done: int) -> None:
        report(f"{step}: {done} of {count} replications")

    if step == "linear":
        name = "line_fit"
        found = models.calibrate_linear(
            key, *designs.lines(), num_replications=count, report=progress
        )
    else:
        chosen = _step(step, campaign, noise == "known", report)
        name = sampler or chosen.sampler
        found = calibrate(
            key, *suited(chosen, name), num_replications=count, batch=chosen.batch, report=progress
        )
    record = {
        "step": step,
        "campaign": None if campaign is None else campaign.name,
        "sampler": name,
        "noise": noise if step == "third_order" else None,
        "seed": seed,
        "wall_time_s": round(perf_counter() - started, 2),
        "replications": len(found.ranks),
        "ranks": found.num_ranks,
        "failures": {reason: int(each.sum()) for reason, each in found.failures.items()},
        "failed": int(found.failed.sum()),
        "quantities": {
            quantity: {
                "p_chi_square": found.p_chi_square[quantity],
                "p_ecdf": found.p_ecdf[quantity],
                "coverage_99": found.coverage[quantity][0],
                "coverage_99_lower": found.coverage[quantity][1],
                "coverage_99_upper": found.coverage[quantity][2],
            }
            for quantity in found.names
        },
        "verdict": asdict(found.verdict),
    }
    return Sbc(found, _tree(found, record), record)


def suited(step: models.Step, name: str) -> tuple[Model, Sampler, Any]:
    """A sampler for one posterior of many, with counts that suit a calibration.

    Where time is stepped through, and for samplers that need it, least squares find the posterior
    first; the others cross the whole box, so that nothing helps them that a campaign would not.

    Returns:
        The model, the sampler and its options.

    Raises:
        ConfigError: A sampler that needs a location where there is none, or that the posterior has
            too many parameters for.
    """
    sampler, model = registered(name), step.model
    size = len(model.box.names)
    if sampler.needs_fit and model.search is None:
        raise ConfigError(
            f"Sampler {name} draws about a least-squares fit, which this step does not have."
        )
    if not sampler.suits(size):
        raise ConfigError(
            f"Sampler {name} takes at most {sampler.most_parameters} parameters, but the posterior "
            f"has {size}."
        )
    found = sampler.needs_fit or (step.stepped and not sampler.ignores_fit)
    known = COUNTS.get(name, SHORT if found else LONG)
    counts = {**known, **(STEPPED.get(name, {}) if step.stepped else {})}
    options = options_of(
        sampler, **{**counts, "chain_method": "vectorized", "adapt_mass": True, "max_tree_depth": 8}
    )
    return (model if found else model._replace(search=None)), sampler, options


def _step(step: str, campaign: Campaign | None, known_noise: bool, report: Report) -> models.Step:
    """The posterior and its simulator, from a campaign or the short tests."""
    if step == "third_order":
        probing = designs.probing_of(campaign, report) if campaign else designs.probing()
        return models.third_order(probing, known_noise=known_noise)
    if step == "opening":
        return models.opening(
            designs.opening_of(campaign, report) if campaign else designs.opening()
        )
    return models.joint(designs.joint_of(campaign, report) if campaign else designs.joint())


def _check(step: str, sampler: str | None, noise: str) -> None:
    for name, word, known in (("step", step, STEPS), ("noise", noise, NOISES)):
        if word not in known:
            raise ConfigError(f"Argument `{name}` must be one of {', '.join(known)}, not {word!r}.")
    if sampler is not None and (sampler not in SAMPLERS or step == "linear"):
        why = "Step 2 draws from its fit's normal law." if step == "linear" else ""
        raise ConfigError(
            f"Argument `sampler` must be one of {', '.join(SAMPLERS)}, not {sampler!r}.", why=why
        )


def _tree(found: Calibration, record: dict[str, Any]) -> xr.DataTree:
    """Ranks and failures by name, with units; facts of the run as attributes."""
    known = {**attrs(), **attrs_of(BY_NAME.values())}
    variables: dict[str, Any] = {
        "failed": ("replication", found.failed.astype("int8"), {"units": "1"})
    }
    for i, name in enumerate(found.names):
        stem = "h3" if name.startswith("h3_") else name  # `h3_18Hz` is the kernel there
        unit = known.get(stem, {"units": "1"})["units"]
        below = {"long_name": f"draws below the true {name}", "units": "1", "quantity_units": unit}
        inside = {"long_name": f"true {name} inside the 99 % interval", "units": "1"}
        variables[f"rank_{name}"] = ("replication", found.ranks[:, i], below)
        variables[f"inside_{name}"] = ("replication", found.inside[:, i].astype("int8"), inside)
    tree = xr.DataTree.from_dict({"ranks": xr.Dataset(variables)})
    facts = ("step", "sampler", "seed", "ranks")
    tree.attrs.update({name: record[name] for name in facts if record[name] is not None})
    return tree


def save_sbc(folder: Path, found: Sbc) -> None:
    """Write ranks.nc, sbc.png and sbc.json, the numbers last."""
    found.tree.to_netcdf(folder / "ranks.nc", engine="h5netcdf")
    write_figure(folder / "sbc.png", rank_ecdfs(found.calibration))
    write_json(folder / "sbc.json", found.record)
