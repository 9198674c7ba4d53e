"""Which sampler gives most effective draws per second for Step 3, Step 4 and the joint posterior?

Three posteriors come from one virtual rig with a poor laser: zeta, alpha and delta from the
third-order kernel at five tones; gamma alone from two short sweeps; all six parameters from both
sweeps and the noise. Every sampler draws from the same likelihood in the same box, with four
chains; agreement is measured against quadrature where there is one. Further tables show the
effective draws in chains of 850 draws as published, and the other samplers' rates of effective
draws relative to the published walk, which here runs until it mixes.

    python benchmarks/samplers.py [--calls 1] [--json FILE] [--steps third_order,opening,joint]
"""

import logging
import os
import warnings
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any

# Two host devices let two chains run side by side; JAX reads this once, when it starts.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=2")

import jax
import numpy as np
from timing import Table, Target, options, show, targets

from jbw import rig
from jbw.identification.assemble import measured
from jbw.identification.procedure import STEPS, Posterior, posterior_of
from jbw.inference.posterior.summary import diagnose
from jbw.inference.samplers.sampling import sample
from jbw.lab.samplers import compare, suited
from jbw.rig.generator import Noise, Sweep

LASER_NOISE = 1e-3  # [m/s]; so large that the posterior is wide enough to sample
TONES = ("tone_5p00Hz", "tone_5p50Hz", "tone_6p00Hz", "tone_6p50Hz", "tone_6p75Hz")
TESTS = ("noise_0p005V", *TONES, "sweep_0p05V", "sweep_0p20V")
REPEATS = 4
PUBLISHED = 64  # number of chains of 850 draws
LONG = 400_000  # draws of each of four chains, until the published walk mixes
# required rate of effective draws, relative to the published walk's
REACH = {"nuts": 30.0, "random_walk": 100.0}
COLUMNS = {
    "sampler": "", "draws": "d", "ESS": ".4g", "ESS / s": ".4g", "ESS / s, cold": ".4g",
    "evaluations / ESS": ".3g", "log evidence": "", "furthest, MCSE": ".2g", "verdict": "",
}  # fmt: skip


def shortened(plan: Any) -> Any:
    """Return a plan with 64 s of noise, sweeps of 4 s, and 4 s of decay."""
    change = {Noise: {"duration": 64.0}, Sweep: {"burst": 4.0, "duration": 8.0}}
    excitation = replace(plan.excitation, **change.get(type(plan.excitation), {}))
    return replace(plan, excitation=excitation)


def rig_campaign() -> rig.RigCampaign:
    """Return the campaign of the virtual rig behind all three posteriors."""
    plans = tuple(shortened(plan) for plan in rig.LABORATORY.plans)
    preset = replace(rig.LABORATORY, name="samplers", plans=plans)
    return rig.measure(preset, tests=TESTS, repeats=REPEATS, noise_std=LASER_NOISE)


def table_of(posterior: Posterior, calls: int) -> Table:
    """Return the table of all samplers on one posterior, with the best of several warm times."""
    named = (*suited(posterior), "nested") if posterior.stepped else None
    records = [compare(posterior, samplers=named, seed=i).record for i in range(calls)]
    first = records[0]
    for record in records[1:]:
        for name, one in record["samplers"].items():
            kept = first["samplers"][name]
            if (one["ess_per_s_warm"] or 0.0) > (kept["ess_per_s_warm"] or 0.0):
                kept["ess_per_s_warm"] = one["ess_per_s_warm"]
    rows = [row_of(name, one) for name, one in first["samplers"].items()]
    d = len(posterior.box.names)
    title = f"{posterior.name}: {d} parameters, beside {first['reference']}"
    return Table(title, COLUMNS, rows)


def row_of(name: str, one: Mapping[str, Any]) -> tuple[Any, ...]:
    evidence = None
    if one["log_evidence"] is not None:
        evidence = f"{one['log_evidence']:.2f} ± {one['log_evidence_error']:.1g}"
    cost = None if not one["ess"] else one["num_evaluations"] / one["ess"]
    told = one["verdict"]
    if one["failed"]:
        told += f" ({', '.join(dict.fromkeys(one['failed']))})"
    return (
        name, one["draws"], one["ess"], one["ess_per_s_warm"], one["ess_per_s_cold"],
        cost, evidence, one["furthest"], told,
    )  # fmt: skip


def published(posteriors: Mapping[str, Posterior]) -> Table:
    """Return the number of effective draws in one published chain of 850, from many chains."""
    rows = []
    for name, posterior in posteriors.items():
        if posterior.stepped:
            continue
        tree = sample(
            jax.random.key(0), posterior.log_likelihood, posterior.box, posterior.data,
            sampler="random_walk_paper", num_chains=PUBLISHED, chain_method="vectorized",
            start=posterior.fit.theta,
        )  # fmt: skip
        for parameter in posterior.box.names:
            chains = tree["posterior"].to_dataset()[parameter].values
            worth = [diagnose(chain[None])["ess_bulk"] for chain in chains]
            low, middle, high = np.nanquantile(worth, [0.1, 0.5, 0.9])
            rows.append((name, parameter, middle, low, high))
    columns = {"posterior": "", "parameter": "", "ESS": ".1f", "10 %": ".1f", "90 %": ".1f"}
    return Table("What 850 published-style draws are worth, started at the fit", columns, rows)


def mixed(posterior: Posterior) -> float:
    """Return the effective draws per second of the published walk, run until its chains mix."""
    options = {"num_warmup": 20_000, "num_samples": LONG, "chain_method": "vectorized"}
    about = posterior.log_likelihood, posterior.box, posterior.data
    rates = []
    for seed in range(2):  # The first call compiles.
        started = perf_counter()
        tree = sample(jax.random.key(seed), *about, sampler="random_walk_paper", **options)
        elapsed = perf_counter() - started
        chains = [tree["posterior"].to_dataset()[name].values for name in posterior.box.names]
        worth = [min(row["ess_bulk"], row["ess_tail"]) for row in map(diagnose, chains)]
        rates.append(min(worth) / elapsed)
    return rates[-1]


def beside_published(table: Table, posterior: Posterior) -> Table:
    """Return the samplers' rates of effective draws on Step 3, relative to the published walk's."""
    least, rate = mixed(posterior), list(COLUMNS).index("ESS / s")
    found = {row[0]: row[rate] for row in table.rows}
    return targets(
        [
            Target(
                f"Step 3: {name} / published walk that mixes",
                found[name] / least,
                reach,
                None,
                False,
            )
            for name, reach in REACH.items()
        ]
    )


def main() -> None:
    parser = options(__doc__, calls=1)
    parser.add_argument("--steps", default=",".join(STEPS[1:] + STEPS[:1]))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    logging.getLogger("jax").setLevel(logging.ERROR)
    warnings.simplefilter("ignore")
    campaign = rig_campaign()
    posteriors = {
        step: posterior_of(step, measured(campaign.tests, campaign.settings))
        for step in arguments.steps.split(",")
    }
    tables = {step: table_of(one, arguments.calls) for step, one in posteriors.items()}
    more = [published(posteriors)]
    if "third_order" in posteriors:
        more.append(beside_published(tables["third_order"], posteriors["third_order"]))
    show([*tables.values(), *more], ("numpyro", "blackjax"), arguments.json)


if __name__ == "__main__":
    main()
