"""`jbw.sbc`: does a step of the procedure hold the truth as often as it says?"""

import json
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import xarray as xr

from jbw.campaign.loading import Campaign
from jbw.errors import ConfigError
from jbw.inference.calibration import calibrate
from jbw.inference.calibration_record import Calibration
from jbw.inference.lane_fit import About
from jbw.inference.lane_importance import weighted
from jbw.inference.lanes import CHAINS, LaneSampler, chains, gridded, tempered
from jbw.inference.precision import require_float64
from jbw.inference.random_walk import PAPER
from jbw.report.calibration import rank_ecdfs
from jbw.report.figures import figure_of
from jbw.study import calibration_designs as designs
from jbw.study import calibration_models as models
from jbw.study.campaign_designs import joint_design, opening_design, probing_design
from jbw.study.linear_calibration import calibrate_linear

logger = logging.getLogger("jbw")
Report = Callable[[str], None]
STEPS = ("linear", "third_order", "opening", "joint")
SAMPLERS = ("importance", "tempered_smc", "quadrature", *CHAINS)
REPLICATIONS = {"linear": 1000, "third_order": 1000, "opening": 1000, "joint": 200}
NOISES = ("unknown", "known")
UNITS = {
    "omega_n": "rad/s", "zeta": "1", "alpha": "1/s^2", "delta": "1/m", "gamma": "1/m",
    "gain": "N/kg/V", "alpha_delta": "1/(m s^2)", "alpha_gamma": "1/(m s^2)",
    "lambda_3": "1/(m^2 s^2)", "log_likelihood": "nat", "response": "m/s",
}  # fmt: skip


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
        sampler: One of "importance", "tempered_smc", "quadrature" (one parameter), "nuts",
            "random_walk", "random_walk_paper", "elliptical_slice"; the cheapest that crosses the
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

    def told(done: int) -> None:
        report(f"{step}: {done} of {count} replications")

    if step == "linear":
        frf, prior = designs.lines()
        chosen, name = None, "line_fit"
        found = calibrate_linear(key, frf, prior, num_replications=count, report=told)
    else:
        chosen = _step(step, campaign, noise == "known", report)
        name = chosen.sampler if sampler is None else sampler
        found = calibrate(
            key, chosen.model, sampler_named(name, chosen.about, stepped=step == "joint"),
            num_replications=count, batch=chosen.batch, report=told,
        )  # fmt: skip
    record = {
        "step": step,
        "campaign": None if campaign is None else campaign.name,
        "sampler": name,
        "noise": noise if step == "third_order" else None,
        "seed": seed,
        "wall_time_s": round(perf_counter() - started, 2),
        **record_of(found),
    }
    return Sbc(found, tree_of(found, record), record)


def sampler_named(name: str, about: About | None, *, stepped: bool = False) -> LaneSampler:
    """A sampler that runs under vmap, with counts that suit a calibration.

    Args:
        name: One of `SAMPLERS`.
        about: How to locate the posterior, where least squares can.
        stepped: Whether an evaluation steps through time, and costs accordingly.

    Raises:
        ConfigError: A sampler that needs a location where there is none.
    """
    if name == "quadrature":
        return gridded()
    if name == "tempered_smc":
        return tempered(about=about if stepped else None)
    if name == "importance":
        if about is None:
            raise ConfigError(
                "Sampler importance draws about a least-squares fit, which this step does not have."
            )
        return weighted(about, 2048, 512) if stepped else weighted(about)
    if name == "random_walk_paper":
        return chains(name, PAPER.num_warmup, PAPER.num_samples)
    slices = name == "elliptical_slice"
    short = (30, 125) if stepped or slices else (500, 500)
    return chains(name, *short, about=about if stepped or slices else None)


def _step(step: str, campaign: Campaign | None, known_noise: bool, report: Report) -> models.Step:
    """The posterior and its simulator, from a campaign or the short tests."""
    if step == "third_order":
        probing = designs.probing() if campaign is None else probing_design(campaign, report)
        return models.third_order(probing, known_noise=known_noise)
    if step == "opening":
        return models.opening(
            designs.opening() if campaign is None else opening_design(campaign, report)
        )
    return models.joint(designs.joint() if campaign is None else joint_design(campaign, report))


def _check(step: str, sampler: str | None, noise: str) -> None:
    for name, word, known in (("step", step, STEPS), ("noise", noise, NOISES)):
        if word not in known:
            raise ConfigError(f"Argument `{name}` must be one of {', '.join(known)}, not {word!r}.")
    if sampler is not None and (sampler not in SAMPLERS or step == "linear"):
        why = "Step 2 draws from its fit's normal law." if step == "linear" else ""
        raise ConfigError(
            f"Argument `sampler` must be one of {', '.join(SAMPLERS)}, not {sampler!r}.", why=why
        )


def record_of(found: Calibration) -> dict[str, Any]:
    """The numbers of a calibration in plain values.

    Args:
        found: The calibration.
    """
    return {
        "replications": len(found.ranks),
        "ranks": found.num_ranks,
        "failures": {reason: int(each.sum()) for reason, each in found.failures.items()},
        "failed": int(found.failed.sum()),
        "quantities": {
            name: {
                "p_chi_square": found.p_chi_square[name],
                "p_ecdf": found.p_ecdf[name],
                "coverage_99": found.coverage[name][0],
                "coverage_99_lower": found.coverage[name][1],
                "coverage_99_upper": found.coverage[name][2],
            }
            for name in found.names
        },
        "verdict": asdict(found.verdict),
    }


def tree_of(found: Calibration, record: dict[str, Any]) -> xr.DataTree:
    """Ranks and failures by name, with units.

    Args:
        found: The calibration.
        record: Facts of the run, as attributes.
    """
    variables: dict[str, Any] = {
        "failed": ("replication", found.failed.astype("int8"), {"units": "1"})
    }
    for i, name in enumerate(found.names):
        of = {"quantity_units": UNITS.get(name, "m^-2 s^6" if name.startswith("h3_") else "1")}
        long = {"long_name": f"draws below the true {name}", "units": "1", **of}
        variables[f"rank_{name}"] = ("replication", found.ranks[:, i], long)
        inside = found.inside[:, i].astype("int8")
        told = {"long_name": f"true {name} inside the 99 % interval", "units": "1"}
        variables[f"inside_{name}"] = ("replication", inside, told)
    facts = {k: record[k] for k in ("step", "sampler", "seed", "ranks") if record[k] is not None}
    tree = xr.DataTree.from_dict({"ranks": xr.Dataset(variables)})
    tree.attrs.update(facts)
    return tree


def save_sbc(folder: Path, found: Sbc) -> None:
    """Write ranks.nc, sbc.png and sbc.json, the numbers last.

    Args:
        folder: New or empty folder, as `claim` left it.
        found: The calibration.
    """
    found.tree.to_netcdf(folder / "ranks.nc", engine="h5netcdf")
    figure = figure_of(rank_ecdfs(found.calibration))
    figure.savefig(folder / "sbc.png", dpi=130, facecolor="white")
    text = json.dumps(found.record, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "sbc.json").write_text(text + "\n", encoding="utf-8")
