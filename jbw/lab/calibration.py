"""Calibration of an identification step by `jbw.sbc`: how often its intervals contain the truth."""

import logging
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import xarray as xr

from jbw.campaign.joints import require_one_joint
from jbw.campaign.load import Campaign
from jbw.errors import ConfigError
from jbw.identification.procedure import Report
from jbw.identification.step import attrs
from jbw.inference.calibration.record import Calibration
from jbw.inference.calibration.replications import Model, Prior, Simulate, calibrate, own_model
from jbw.inference.samplers.register import SAMPLERS, Sampler, options_of, sampler_named
from jbw.inference.space.box import require_float64
from jbw.inference.space.problem import LogLikelihood
from jbw.lab import designs, models
from jbw.parts import Parts, unkept
from jbw.quantities import BY_NAME, attrs_of
from jbw.report.messages import study as messages
from jbw.report.studies import rank_ecdfs
from jbw.results.studies import StoredCalibration
from jbw.run.netcdf import write_tree
from jbw.study.store import Write, save_outputs, write_figure, write_json

logger = logging.getLogger("jbw")
OWN = "own"  # name of the step if the posterior is the user's own
REPLICATIONS = {"linear": 1000, "third_order": 1000, "opening": 1000, "joint": 200}
NOISES = ("unknown", "known")
# For each step: short tests on the virtual rig, tests of a campaign, and the step's posterior.
DESIGNS = {
    "third_order": (designs.probing, designs.probing_of, models.third_order),
    "opening": (designs.opening, designs.opening_of, models.opening),
    "joint": (designs.joint, designs.joint_of, models.joint),
}
# Draws and warm-up draws per chain: for chains that start near a fit, and for chains that start
# anywhere in the prior.
SHORT = {"num_warmup": 30, "num_samples": 125}
LONG = {"num_warmup": 500, "num_samples": 500}
COUNTS = {
    "amis": {"num_samples": 250},
    "importance": {"num_samples": 250, "num_draws": 4096, "num_rounds": 2},
    "tempered_smc": {"num_samples": 512, "num_chains": 2},
    "nested": {"num_samples": 250, "num_chains": 2},
    "quadrature": {"num_samples": 250},
    "random_walk_paper": {},
}
STEPPED = {"importance": {"num_samples": 128, "num_draws": 2048}}


@dataclass(frozen=True)
class Sbc:
    """The result of a simulation-based calibration by `sbc`."""

    calibration: Calibration  # ranks, coverage, failures and the verdict
    tree: xr.DataTree  # the ranks, with labels
    record: dict[str, Any]  # all numbers as plain values, as in `sbc.json`

    @property
    def result(self) -> StoredCalibration:
        """The content of `record` as typed objects."""
        return StoredCalibration.read(self.record)


def sbc(
    campaign: Campaign | None = None,
    *,
    step: str = "third_order",
    num_replications: int | None = None,
    sampler: str | None = None,
    noise: str = "unknown",
    seed: int = 0,
    report: Report = logger.info,
    simulate: Simulate | None = None,
    log_likelihood: LogLikelihood | None = None,
    prior: Prior | None = None,
    parts: Parts = unkept,
) -> Sbc:
    """Draw true values from the prior, simulate, identify; rank the truth among posterior draws.

    Your own posterior is calibrated with its `simulate`, `log_likelihood` and `prior`, all three;
    the samplers of jbw draw from it. The functions must be traceable by JAX, over many truths at
    once.

    Args:
        campaign: Campaign with the tests, noise and prior; the virtual rig's short tests when None.
            Step 2 ignores the campaign, and the joint posterior uses only its sweeps.
        step: "linear" (Step 2), "third_order" (Step 3), "opening" (Step 4) or "joint".
        num_replications: Number of truths; when None 1000, or 200 for the joint posterior.
        sampler: A sampler that `[identify] sampler` accepts; the cheapest that crosses the
            posterior when None.
        noise: Whether the likelihood of Step 3 estimates the noise from the repeats ("unknown", as
            for a campaign) or is given it ("known", as the paper assumes).
        seed: Seed of everything random.
        report: Function that is called with one sentence as the work proceeds.
        simulate: Function of (key, theta) that returns data, as arrays of fixed shapes; theta
            contains the parameters by name.
        log_likelihood: Function of (theta, data) that returns a number or its terms [nats].
        prior: NumPyro distribution of one real number for the name of every parameter.
        parts: Store of finished batches of replications, so that a killed calibration can continue.

    Raises:
        ConfigError: The step, sampler or noise is unknown, or JAX works in float32.
        DataError: The tests of the campaign do not allow the step.

    Reference:
        Talts et al. (2018), arXiv:1804.06788; Modrak et al. (2023), Bayesian Analysis 20, 461.

    Examples:
        Truths of a standard normal prior, measured with unit noise, have uniform ranks:

        >>> import jbw; jbw.enable_x64()
        >>> import jax
        >>> import numpyro.distributions as dist
        >>> def simulate(key, theta):
        ...     return theta["x"] + jax.random.normal(key)
        >>> def log_likelihood(theta, y):
        ...     return -0.5 * (y - theta["x"]) ** 2
        >>> own = {"simulate": simulate, "log_likelihood": log_likelihood}
        >>> found = jbw.sbc(**own, prior={"x": dist.Normal(0.0, 1.0)}, num_replications=50)
        >>> print(found.record["failed"], found.record["verdict"]["status"])
        0 ok
    """
    require_float64()
    if campaign is not None:
        require_one_joint(campaign.joints, "A calibration")
    campaign_step = _own_step(campaign, simulate, log_likelihood, prior)
    if campaign_step is not None:
        step = OWN
    steps = (*REPLICATIONS,) if campaign_step is None else (OWN,)
    for name, word, words in (("step", step, steps), ("noise", noise, NOISES)):
        if word not in words:
            raise ConfigError(f"Argument `{name}` must be one of {', '.join(words)}, not {word!r}.")
    if sampler is not None and (sampler not in SAMPLERS or step == "linear"):
        why = messages.STEP_2_DRAWS if step == "linear" else ""
        raise ConfigError(
            f"Argument `sampler` must be one of {', '.join(SAMPLERS)}, not {sampler!r}.", why=why
        )
    count = REPLICATIONS.get(step, 1000) if num_replications is None else num_replications
    started, key = perf_counter(), jax.random.key(seed)

    def progress(done: int) -> None:
        report(f"{step}: {done} of {count} replications")

    if step == "linear":
        sampler = "line_fit"
        calibration = models.calibrate_linear(
            key, *designs.lines(), num_replications=count, report=progress, parts=parts
        )
    else:
        chosen = _step_of(step, campaign, noise, report) if campaign_step is None else campaign_step
        sampler = sampler or chosen.sampler
        calibration = calibrate(
            key, *suited(chosen, sampler), num_replications=count, batch=chosen.batch,
            report=progress, parts=parts,
        )  # fmt: skip
    record = {
        "step": step,
        "campaign": None if campaign is None else campaign.name,
        "sampler": sampler,
        "noise": noise if step == "third_order" else None,
        "seed": seed,
        "wall_time_s": round(perf_counter() - started, 2),
        **_numbers_of(calibration),
    }
    return Sbc(calibration, _tree(calibration, record), record)


def _step_of(
    step: str, campaign: Campaign | None, noise: str, report: Report
) -> models.CalibratedStep:
    """Return a step of the identification with its simulated tests, ready for calibration."""
    of_rig, of_campaign, posterior = DESIGNS[step]
    design = of_rig() if campaign is None else of_campaign(campaign, report)
    noise_options = {"known_noise": noise == "known"} if step == "third_order" else {}
    return posterior(design, **noise_options)


def _own_step(
    campaign: Campaign | None,
    simulate: Simulate | None,
    log_likelihood: LogLikelihood | None,
    prior: Prior | None,
) -> models.CalibratedStep | None:
    """Return the user's own posterior as a step; None if the user gives none."""
    if simulate is None and log_likelihood is None and prior is None:
        return None
    if simulate is None or log_likelihood is None or prior is None or campaign is not None:
        raise ConfigError(
            "A user-defined posterior needs `simulate`, `log_likelihood` and `prior`, all three, "
            "and no campaign.",
        )
    return models.CalibratedStep(own_model(simulate, log_likelihood, prior), 100, "nuts")


def _numbers_of(calibration: Calibration) -> dict[str, Any]:
    quantities = {}
    for name in calibration.names:
        share, lower, upper = calibration.coverage[name]
        quantities[name] = {
            "p_chi_square": calibration.p_chi_square[name],
            "p_ecdf": calibration.p_ecdf[name],
            "coverage_99": share,
            "coverage_99_lower": lower,
            "coverage_99_upper": upper,
        }
    return {
        "replications": len(calibration.ranks),
        "ranks": calibration.num_ranks,
        "failures": {reason: int(failed.sum()) for reason, failed in calibration.failures.items()},
        "failed": int(calibration.failed.sum()),
        "quantities": quantities,
        "verdict": {
            "status": calibration.verdict.status,
            "findings": [row.stored().plain() for row in calibration.verdict.findings],
        },
    }


def suited(step: models.CalibratedStep, name: str) -> tuple[Model, Sampler, Any]:
    """Return model, sampler and options, with numbers of draws that suit a calibration."""
    # A least-squares fit comes first if the model steps through time or the sampler needs a fit.
    # All other samplers start from the whole prior, as they do in a campaign.
    sampler, model = sampler_named(name), step.model
    size = len(model.box.names)
    if sampler.needs_fit and model.search is None:
        raise ConfigError(
            f"Sampler {name} needs a least-squares fit as the centre of its draws, but this step "
            "has no fit; choose a sampler that needs no fit, such as nuts."
        )
    if not sampler.suits(size):
        raise ConfigError(
            f"Sampler {name} takes at most {sampler.most_parameters} parameters, but the posterior "
            f"has {size}."
        )
    is_fitted = sampler.needs_fit or (step.stepped and not sampler.ignores_fit)
    default_counts = COUNTS.get(name, SHORT if is_fitted else LONG)
    counts = {**default_counts, **(STEPPED.get(name, {}) if step.stepped else {})}
    options = options_of(
        sampler, **{**counts, "chain_method": "vectorized", "adapt_mass": True, "max_tree_depth": 8}
    )
    return (model if is_fitted else model._replace(search=None)), sampler, options


def _tree(calibration: Calibration, record: dict[str, Any]) -> xr.DataTree:
    attrs_by_name = {**attrs(), **attrs_of(BY_NAME.values())}
    failed = calibration.failed.astype("int8")
    variables: dict[str, Any] = {"failed": ("replication", failed, {"units": "1"})}
    for i, name in enumerate(calibration.names):
        # The kernel value `h3_18Hz` has the name `h3` in the table of units.
        stem = "h3" if name.startswith("h3_") else name
        unit = attrs_by_name.get(stem, {"units": "1"})["units"]
        below = {"long_name": messages.rank_below(name), "units": "1", "quantity_units": unit}
        inside = {"long_name": messages.truth_inside(name), "units": "1"}
        variables[f"rank_{name}"] = ("replication", calibration.ranks[:, i], below)
        variables[f"inside_{name}"] = (
            "replication",
            calibration.inside[:, i].astype("int8"),
            inside,
        )
    tree = xr.DataTree.from_dict({"ranks": xr.Dataset(variables)})
    facts = ("step", "sampler", "seed", "ranks")
    tree.attrs.update({name: record[name] for name in facts if record[name] is not None})
    return tree


def save_sbc(folder: Path, found: Sbc) -> None:
    """Write the files of a calibration: ranks.nc and sbc.json, then sbc.png."""
    numbers: dict[str, Write] = {
        "ranks.nc": lambda path: write_tree(path, found.tree),
        "sbc.json": lambda path: write_json(path, found.record),
    }
    figure = {"sbc.png": lambda path: write_figure(path, rank_ecdfs(found.calibration))}
    save_outputs(folder, numbers, figure)
