"""The command `jbw compare DIR`."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jbw.cli.printing import NOTHING, print_columns

HEADER = (
    "sampler", "draws", "ESS", "ESS/s", "ESS/s cold", "evaluations", "warm [s]", "cold [s]",
    "log evidence", "furthest [MCSE]", "verdict",
)  # fmt: skip
ROWS = ("parameter", "sampler", "mean", "sd", "1 %", "50 %", "99 %", "ESS bulk", "ESS tail")


@click.command()
@click.argument("source", metavar="DIR", type=click.Path(exists=True, path_type=Path))
@click.option("--step", default="joint", show_default=True, help="joint, third_order or opening.")
@click.option("--samplers", help="Names with commas between them; all that suit when left out.")
@click.option("--campaign", type=click.Path(path_type=Path), help="The run's campaign file.")
@click.option("--chains", default=4, show_default=True, help="Chains of each sampler.")
@click.option("--once", is_flag=True, help="Run each sampler once: no time without compiling.")
@click.option("--seed", type=int, help="Seed of everything random; the run's when left out.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="New or empty folder to write to; DIR/compare-STEP when left out.",
)
@click.option("--json", "json_", is_flag=True, help="Print the comparison as JSON.")
@click.option("--allow-outside", is_flag=True, help="Read files outside the campaign's folder.")
def compare(
    source: Path,
    step: str,
    samplers: str | None,
    campaign: Path | None,
    chains: int,
    once: bool,
    seed: int | None,
    out: Path | None,
    json_: bool,
    allow_outside: bool,
) -> None:
    """Compare samplers on one posterior of the finished run in DIR, or of the campaign file DIR.

    For every parameter mean, standard deviation, quantiles and their distance in Monte Carlo
    standard errors from a quadrature, or from the sampler with the most effective draws; effective
    draws a second, compiled and cold; evaluations; evidence. compare.json has all numbers,
    compare.png the means and rates.
    """
    from jbw.cli.progress import progress
    from jbw.cli.running import prepare_jax

    prepare_jax()
    from jbw.campaign.loading import load_campaign
    from jbw.study.comparing import compare as compare_samplers
    from jbw.study.comparing import save_comparison
    from jbw.study.known_run import campaign_of, known_of, require_same_inputs
    from jbw.study.storage import claim

    path, summary, known = source, {}, None
    if source.is_dir():
        path, summary, known = campaign_of(source, campaign), *known_of(source)
    folder = claim(out or (source if source.is_dir() else source.parent) / f"compare-{step}")
    named = None if samplers is None else [name.strip() for name in samplers.split(",")]
    with progress() as say:
        say(f"Reading {path}")
        loaded = load_campaign(path, allow_outside=allow_outside)
        require_same_inputs(loaded, summary)
        found = compare_samplers(
            loaded, step=step, samplers=named, num_chains=chains, twice=not once, known=known,
            seed=summary.get("seed") if seed is None else seed, report=say, watch=say.chains,
        )  # fmt: skip
        save_comparison(folder, found)
    if json_:
        click.echo(json.dumps(found.record, indent=1))
    else:
        print_comparison(found.record)
        click.echo(f"Comparison: {folder / 'compare.json'}")


def print_comparison(record: Mapping[str, Any]) -> None:
    """Two tables on stdout: a line a sampler, then a line a parameter and sampler."""
    click.echo(f"{record['posterior']} posterior of {record['campaign']}")
    print_columns([HEADER, *(_line(name, one) for name, one in record["samplers"].items())])
    click.echo(f"\nDistances in Monte Carlo standard errors from {record['reference']}")
    lines = [
        _numbers(parameter, name, one["parameters"][parameter])
        for parameter in record["parameters"]
        for name, one in record["samplers"].items()
    ]
    print_columns([ROWS, *lines])
    for name, reason in record["refused"].items():
        click.echo(f"{name}: {reason}")


def _line(name: str, one: Mapping[str, Any]) -> tuple[str, ...]:
    evidence = NOTHING
    if one["log_evidence"] is not None:
        evidence = f"{one['log_evidence']:.3f} +- {one['log_evidence_error']:.2g}"
    told = one["verdict"]
    if one["failed"]:
        told += f" ({', '.join(dict.fromkeys(one['failed']))})"
    columns = ("ess", "ess_per_s_warm", "ess_per_s_cold")
    return (
        name, f"{one['draws']}", *(_short(one[column]) for column in columns),
        f"{one['num_evaluations']}", _short(one["wall_warm_s"]), _short(one["wall_cold_s"]),
        evidence, _short(one["furthest"], 2), told,
    )  # fmt: skip


def _numbers(parameter: str, name: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    quantities = ("mean", "sd", "q010", "q500", "q990")
    cells = [_with_distance(row[each], row.get(f"z_{each}")) for each in quantities]
    return parameter, name, *cells, _short(row.get("ess_bulk")), _short(row.get("ess_tail"))


def _with_distance(value: float | None, z: float | None) -> str:
    shown = NOTHING if value is None else f"{value:.6g}"
    return shown if z is None else f"{shown} ({z:+.1f})"


def _short(value: float | None, digits: int = 3) -> str:
    if value is None:
        return NOTHING
    return f"{value:.0f}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g}"
