"""The commands that study samplers: `jbw compare DIR` and `jbw sbc`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jbw.cli.options import json_option, out_option, outside_option, seed_option
from jbw.cli.printing import NOT_TRUSTED, answer, verdict_lines
from jbw.cli.progress import computing, working
from jbw.report.messages.commands import sampler_distances
from jbw.report.table import Column, Table, field, table, words
from jbw.report.text import NOTHING

if TYPE_CHECKING:  # these modules load pydantic
    from jbw.results.studies import (
        SampledParameter,
        StoredCalibration,
        StoredSampler,
        StoredSamplers,
    )


@click.command()
@click.argument("source", metavar="DIR", type=click.Path(exists=True, path_type=Path))
@click.option("--step", default="joint", show_default=True, help="joint, third_order or opening.")
@click.option(
    "--samplers", help="Names separated by commas; by default all suitable samplers.",
    callback=lambda _, __, value: value and [name.strip() for name in value.split(",")],
)  # fmt: skip
@click.option("--campaign", type=click.Path(path_type=Path), help="The run's campaign file.")
@click.option(
    "--chains", "num_chains", default=4, show_default=True, help="Chains of each sampler."
)
@click.option(
    "--once", is_flag=True, help="Run each sampler once; the times then include compilation."
)
@seed_option("run")
@out_option("DIR/compare-STEP")
@json_option
@outside_option
def compare(
    source: Path, campaign: Path | None, once: bool, step: str, seed: int | None, out: Path | None,
    json_: bool, allow_outside: bool, **options: Any,
) -> None:  # fmt: skip
    """Compare samplers on one posterior of the finished run in DIR, or of the campaign file DIR.

    The result gives for every parameter the mean, standard deviation and quantiles, with their
    distance from a reference in Monte Carlo standard errors (the reference is a quadrature, or the
    sampler with the most effective draws); effective draws per second, with and without
    compilation; numbers of evaluations; and the evidence. compare.json contains all numbers,
    compare.png the means and rates.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.lab.samplers import compare as compare_samplers
        from jbw.lab.samplers import save_comparison
        from jbw.results.run import RunSummary
        from jbw.study.study import campaign_of, inputs_of, known_of, require_same_inputs

        path, summary, run_knowledge = source, RunSummary(), None
        if source.is_dir():
            path, summary, run_knowledge = campaign_of(source, campaign), *known_of(source)
        place = source if source.is_dir() else source.parent
        with working(say, out or place / f"compare-{step}") as job:
            folder = job.folder
            options |= {"step": step, "seed": summary.seed if seed is None else seed}
            say(f"Reading {path}")
            loaded = load_campaign(path, allow_outside=allow_outside)
            require_same_inputs(loaded, summary)
            reports = {"report": say, "watch": say.chains}
            parts = job.parts({**inputs_of(loaded), "known": repr(run_knowledge)}, say)
            comparison = compare_samplers(
                loaded, twice=not once, known=run_knowledge, parts=parts, **reports, **options
            )
            save_comparison(folder, comparison)
    reports = comparison_lines(comparison.result)
    answer(json_, comparison.record, *reports, saved=f"Comparison: {folder / 'compare.json'}")


def comparison_lines(record: "StoredSamplers") -> tuple[Table | str, ...]:
    """Return a table of samplers, a table of parameters by sampler, and rejected samplers."""
    samplers = record.samplers.values()
    rows = [
        row.parameters[parameter].replaced(parameter=parameter, sampler=row.name)
        for parameter in record.parameters
        for row in samplers
    ]
    quantities = {"mean": "mean", "sd": "sd", "1 %": "q010", "50 %": "q500", "99 %": "q990"}
    return (
        table(
            f"{record.posterior} posterior of {record.campaign}",
            samplers,
            words("sampler", "name"),
            words("draws", "draws", "right"),
            _number("ESS", "ess"),
            _number("ESS/s", "ess_per_s_warm"),
            _number("ESS/s cold", "ess_per_s_cold"),
            words("evaluations", "num_evaluations", "right"),
            _number("warm [s]", "wall_warm_s"),
            _number("cold [s]", "wall_cold_s"),
            Column("log evidence", _evidence),
            _number("furthest [MCSE]", "furthest", 2),
            Column("verdict", _verdict, align="left"),
        ),
        table(
            sampler_distances(record.reference or ""),
            rows,
            words("parameter", "parameter"),
            words("sampler", "sampler"),
            *(Column(heading, partial(_distance, key)) for heading, key in quantities.items()),
            _number("ESS bulk", "ess_bulk"),
            _number("ESS tail", "ess_tail"),
        ),
        *(f"{name}: {reason}" for name, reason in record.refused.items()),
    )


def _number(heading: str, key: str, digits: int = 3) -> Column:
    """Return a table column of numbers with `digits` digits; large numbers become integers."""

    def shown(row: Any) -> str:
        value = field(row, key)
        if value is None:
            return NOTHING
        return f"{value:.0f}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g}"

    return Column(heading, shown)


def _evidence(row: "StoredSampler") -> str:
    if row.log_evidence is None:
        return NOTHING
    return f"{row.log_evidence:.3f} +- {row.log_evidence_error:.2g}"


def _verdict(row: "StoredSampler") -> str:
    failed = ", ".join(dict.fromkeys(row.failed))
    return f"{row.verdict} ({failed})" if failed else row.verdict


def _distance(key: str, row: "SampledParameter") -> str:
    """Return a value as text, with its distance from the reference in standard errors."""
    value, z = field(row, key), field(row, f"z_{key}")
    shown = NOTHING if value is None else f"{value:.6g}"
    return shown if z is None else f"{shown} ({z:+.1f})"


@click.command()
@click.argument("source", metavar="[CAMPAIGN]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--step", default="third_order", show_default=True,
    help="Step to calibrate: linear, third_order, opening or joint.",
)  # fmt: skip
@click.option(
    "--replications", "num_replications", type=int,
    help="Number of simulated true values; by default 1000, or 200 for the joint posterior.",
)  # fmt: skip
@click.option("--sampler", help="Sampler; by default the cheapest suitable one.")
@click.option(
    "--noise", default="unknown", show_default=True,
    help="Noise in Step 3: unknown, so that it is identified, or known, as the paper assumes.",
)  # fmt: skip
@seed_option(default=0)
@out_option("sbc-STEP")
@json_option
@outside_option
def sbc(
    source: Path | None, step: str, out: Path | None, json_: bool, allow_outside: bool,
    **options: Any,
) -> int:  # fmt: skip
    """Calibrate a step by simulation: do its intervals contain the true values as often as stated?

    True values are drawn from the prior, and data simulated from them are identified; the ranks of
    the true values among the posterior draws must be uniform. Tests, noise and prior are those of
    CAMPAIGN (a campaign file or the folder of a finished run), or of short tests of the virtual
    rig. Failed replications are counted and not left out. The exit code is 4 if the step is not
    calibrated.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.lab import calibration
        from jbw.study.study import campaign_of, inputs_of

        with working(say, out or Path(f"sbc-{step}")) as job:
            folder, campaign = job.folder, None
            if source is not None:
                path = campaign_of(source) if source.is_dir() else source
                say(f"Reading {path}")
                campaign = load_campaign(path, allow_outside=allow_outside)
            parts = job.parts({} if campaign is None else inputs_of(campaign), say)
            calibrated = calibration.sbc(campaign, step=step, report=say, parts=parts, **options)
            calibration.save_sbc(folder, calibrated)
    verdict = calibrated.calibration.verdict.stored().replaced(answers={})
    shown = calibration_table(calibrated.result), *verdict_lines(verdict, passed=True)
    answer(json_, calibrated.record, *shown, saved=f"Calibration: {folder / 'sbc.json'}")
    return 0 if verdict.status == "ok" else NOT_TRUSTED


def calibration_table(record: "StoredCalibration") -> Table:
    """Return the table of a calibration with one line per quantity."""
    columns = [
        Column(heading, lambda row, key=key, form=form: format(field(row, key), form))
        for heading, key, form in (
            ("p (ECDF)", "p_ecdf", ".2g"),
            ("p (chi2)", "p_chi_square", ".2g"),
            ("99 % holds", "coverage_99", ".2%"),
            ("of which", "coverage_99_lower", ".2%"),
            ("to", "coverage_99_upper", ".2%"),
        )
    ]
    return table(
        f"{record.step}: {record.replications} replications by {record.sampler}, "
        f"{record.failed} failed",
        record.quantities.values(),
        words("quantity", "name"),
        *columns,
    )
