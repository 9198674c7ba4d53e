"""The command that plans tests: `jbw plan`."""

from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jbw.cli.options import json_option, out_option
from jbw.cli.printing import answer, duration, plain_values
from jbw.cli.progress import computing, working
from jbw.report.messages import planning
from jbw.report.table import Column, Table, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jbw.planning.plan import (
        CandidateRow,
        Combination,
        Expected,
        FleetDesign,
        MeasurementPlan,
    )


@click.command()
@click.argument(
    "source", metavar="[PLAN.toml | DIR]", required=False, type=click.Path(path_type=Path)
)
@click.option(
    "--limits",
    type=click.Path(path_type=Path),
    help="For DIR: a plan file without the joint, with limits, noise, required accuracy and "
    "candidates.",
)
@out_option("none")
@json_option
@click.option("--example", is_flag=True, help="Only print a commented plan file.")
@click.option(
    "--population",
    "fleet",
    is_flag=True,
    help="Compare how well plans with different numbers of assemblies and torques determine a "
    "trend with torque, before you tighten any joint.",
)
@click.option(
    "--torques", default="2:12", show_default=True, help="Torques of a fleet, from:to [N m]."
)
@click.option(
    "--scatter",
    type=float,
    default=0.1,
    show_default=True,
    help="For a fleet: expected standard deviation between assemblies, relative to a parameter.",
)
def plan(
    source: Path | None,
    limits: Path | None,
    out: Path | None,
    json_: bool,
    example: bool,
    fleet: bool,
    torques: str,
    scatter: float,
) -> None:
    """Plan tests that determine the joint with a wanted coefficient of variation (CV).

    PLAN.toml states ranges for the joint, the wanted accuracy and the possible tests; DIR is a
    finished run, after which the next tests are planned. Without either, an example is printed.
    With --out, plan.json contains all numbers, and an interrupted plan continues.
    """
    if fleet:
        _plan_fleet(torques, scatter, json_)
        return
    if example or source is None:
        from jbw.planning import EXAMPLE

        click.echo(EXAMPLE, nl=False)
        return
    if limits is not None and not source.is_dir():
        raise click.UsageError("--limits is for a run's folder; PLAN.toml contains its own limits.")
    with computing() as say, nullcontext() if out is None else working(say, out) as job:
        from jbw.parts import unkept
        from jbw.planning.making import plan_tests
        from jbw.report.result import read_result
        from jbw.run.files import hash_of
        from jbw.study.store import save_outputs, write_json

        read = [source / "posterior.nc" if source.is_dir() else source, *filter(None, [limits])]
        tree = read_result(source)[1] if source.is_dir() else None
        parts = job.parts({str(path): hash_of(path) for path in read}, say) if job else unkept
        description = source if tree is None else limits
        planned = plan_tests(description, tree, report=say, parts=parts)
        if job is not None:
            numbers = partial(write_json, value=plain_values(asdict(planned)))
            save_outputs(job.folder, {"plan.json": numbers}, {})
    before = planning.before({name: _spread(cv) for name, cv in planned.before.items()})
    # objections to single tests, by the number of each test in the table
    remarks = [f"  {i + 1}: {'; '.join(r.notes)}." for i, r in enumerate(planned.rows) if r.notes]
    recommended = _recommended(planned.combination, planned)
    answer(
        json_, asdict(planned), plan_table(planned), *remarks, *recommended, before, *planned.notes
    )


def _plan_fleet(torques: str, scatter: float, json_: bool) -> None:
    """Print the table of designs for a fleet of assemblies."""
    from jbw.planning.plan import fleet_designs

    try:
        low, high = map(float, torques.split(":"))
    except ValueError:
        raise click.UsageError(
            f"--torques must be from:to in N m, for example 2:12, but is {torques}."
        ) from None
    if not scatter > 0.0:
        raise click.UsageError(f"--scatter must be positive, for example 0.1, but is {scatter:g}.")
    designs = fleet_designs((low, high))
    rows = [design._asdict() for design in designs]
    small, large = designs[1], designs[4]
    answer(
        json_,
        {"torques": [low, high], "scatter": scatter, "designs": rows},
        fleet_table(designs, scatter),
        planning.fleet_designs(
            (small.assemblies, small.levels), large.levels, large.slope / small.slope
        ),
        planning.FLEET_NOISE,
    )


def fleet_table(designs: "Sequence[FleetDesign]", scatter: float) -> Table:
    """Return the table of fleet designs with one line per design."""
    return table(
        planning.fleet_title(scatter),
        designs,
        Column("torques x assemblies", lambda row: f"{row.levels} x {row.assemblies}"),
        Column("power of torque", lambda row: f"+-{scatter * row.slope:.2g}"),
        Column("new assembly", lambda row: f"+-{100 * scatter * row.new_unit:.2g} %"),
    )


def plan_table(planned: "MeasurementPlan") -> Table:
    """Return the table of candidate tests, one line per test."""
    wish = planned.wish

    def cv(name: str) -> Column:
        return Column(f"CV {name}", lambda numbered: f"{numbered[1].cv[name].worst_decile:.2g}")

    def repeats(numbered: "tuple[int, CandidateRow]") -> str:
        return f"> {wish.max_repeats}" if numbered[1].repeats is None else str(numbered[1].repeats)

    return table(
        planning.title(wish.cv, wish.wanted, planned.num_joints),
        enumerate(planned.rows, start=1),
        Column("", lambda numbered: str(numbered[0]), align="left"),
        Column("test", lambda numbered: numbered[1].test, align="left"),
        Column(f"input [{wish.input_unit}]", lambda numbered: f"{numbered[1].level:.4g}"),
        Column("peak [m]", lambda numbered: f"{numbered[1].y_peak_largest:.3g}"),
        Column("repeats", repeats),
        Column(
            "time",
            lambda numbered: "" if numbered[1].seconds is None else duration(numbered[1].seconds),
        ),
        *map(cv, wish.wanted),
        Column("gain [nats]", lambda numbered: f"{numbered[1].information_gain:.3g}"),
        Column("status", lambda numbered: numbered[1].status, align="left"),
    )


def _recommended(combination: "Combination", planned: "MeasurementPlan") -> list[str]:
    """Return the recommended combination of tests as lines, with the accuracy that it reaches."""
    wish = planned.wish
    if combination.met and not combination.tests:
        best = max(planned.rows, key=lambda row: row.information_gain / row.seconds_each)
        gain = planning.most_per_second(best.test, best.level, wish.input_unit)
        return [planning.NO_TEST_NEEDED, gain]
    if not combination.met and not combination.tests:
        lines = [planning.NO_TEST_ADMITTED]
    else:
        tests = [
            f"  {chosen.repeats} x {chosen.test}, {chosen.level:g} {wish.input_unit}"
            for chosen in combination.tests
        ]
        cvs = {name: _spread(combination.cv[name]) for name in wish.wanted}
        time = duration(combination.seconds)
        lines = (
            planning.recommended(tests, cvs, time)
            if combination.met
            else planning.not_reached(tests, cvs, time, wish.max_repeats)
        )
    return [*lines, *map(planning.together, combination.notes)]


def _spread(value: "Expected") -> str:
    return planning.with_median(value.worst_decile, value.median)
