"""The commands on a campaign: `jbw identifiability`, `jbw identify`, `jbw demo`, `jbw resume`."""

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.text import Text

from jbw.cli.drawing import DrawingProcess
from jbw.cli.options import (
    campaign_argument,
    campaigns_given,
    figures_option,
    given_argument,
    json_option,
    out_option,
    outside_option,
    run_argument,
    seed_option,
    strict_option,
    verbose_option,
)
from jbw.cli.printing import (
    NOT_TRUSTED,
    answer,
    duration,
    exit_code_of,
    following,
    verdict_line,
    verdict_lines,
)
from jbw.cli.progress import computing
from jbw.cli.result import save_brief
from jbw.cli.status import outcomes_table
from jbw.errors import JbwError
from jbw.report.messages import commands as messages
from jbw.report.messages.opening import headline
from jbw.report.messages.stages import SAVED
from jbw.report.table import Table
from jbw.run.checkpoints import INTERRUPTED
from jbw.run.folder import OF_RIG, Run, begin, reopen, require_same
from jbw.run.manifest import KEPT, Keep, Manifest, command_line

if TYPE_CHECKING:
    from jbw.results.run import RunSummary, StoredVerdict  # loads pydantic

Say = Callable[[str], None]


@click.command()
@campaign_argument
@click.option("--profiles", is_flag=True, help="Compute the profile likelihood of every parameter.")
@seed_option("campaign")
@json_option
@outside_option
def identifiability(
    campaign: Path, profiles: bool, seed: int | None, json_: bool, allow_outside: bool
) -> None:
    """Show which parameters the data of the campaign file CAMPAIGN determine.

    The joint is fitted by least squares, without drawing from the posterior. The result gives the
    combinations of parameters that the data determine better than the prior, how well each
    parameter and product is determined, and with --profiles the profile likelihoods: how far each
    parameter can move while the others compensate for it.
    """
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.report.identifiability import directions_table, quantities_table
        from jbw.study import identifiability as study

        say(f"Reading {campaign}")
        loaded = load_campaign(campaign, allow_outside=allow_outside)
        found = study.identifiability(loaded, profiles=profiles, seed=seed, report=say).stored()
        say("Done")
    tables = directions_table(found, {}), quantities_table(found, {})
    answer(json_, found.plain(), *tables, *found.statements)


@click.command()
@out_option("demo")
@seed_option(default=0)
@click.option(
    "--preset",
    type=click.Choice(["everyday", "laboratory", "paper"]),
    default="everyday",
    show_default=True,
    help="What is measured. everyday: three days, with noise and with differences between the "
    "days. laboratory: sweeps from weak to strong hysteresis, with almost no noise. paper: as "
    "laboratory, at the paper's voltages.",
)
@click.option(
    "--paper",
    "preset",
    flag_value="laboratory",
    help="Measure the programme of Teloli et al. with sweeps from weak to strong hysteresis, and "
    "run its Steps 2 to 4 in addition to the joint posterior; the same as --preset laboratory. "
    "--preset paper has the voltages of the article.",
)
@figures_option
@strict_option
@json_option
@verbose_option
def demo(
    out: Path | None, seed: int, preset: str, figures: tuple[str, ...], strict: bool, json_: bool,
    verbose: bool,
) -> int:  # fmt: skip
    """Measure the cantilever of Teloli et al. on the virtual rig and identify it.

    The measurement has three assemblies on three days, with the noise of a laboratory. The records
    and their campaign file are written to OUT/campaign, the results to OUT. With --paper the
    paper's tests are measured and evaluated step by step, and its Table 1 is printed next to the
    true values; its Step 3 is expected to fail, and the report explains why. The exit code refers
    to the joint posterior.
    """
    manifest = Manifest(command_line(), OF_RIG, seed=seed, preset=preset, figures=figures)
    programme = preset != "everyday"
    return run_to_end(
        begin(out or Path("demo"), manifest), json_=json_, verbose=verbose, steps=programme,
        strict=strict,
    )  # fmt: skip


@click.command()
@given_argument
@out_option(messages.RUN_FOLDER)
@click.option(
    "--quick", is_flag=True, help="Stop after the fit, which takes seconds; intervals and "
    "bands come from the covariance of the fit. `jbw resume` continues from the fit.",
)  # fmt: skip
@click.option(
    "--final", is_flag=True, help="Fit all tests after the held-out tests have shown the "
    "error of the law. In the campaign file this is the key "
    "`final`.",
)  # fmt: skip
@click.option(
    "--brief", is_flag=True, help="Also write brief.pdf: one page with the verdict, "
    "frequency, damping ratio and Q.",
)  # fmt: skip
@click.option(
    "--mass", type=float, metavar="KG", help="Modal mass, written into the campaign file that "
    "is drafted from RECORDs; `jbw predict` then "
    "accepts forces in N.",
)  # fmt: skip
@click.option(
    "--workers", type=click.IntRange(1), help="Number of processes for several campaigns; by "
    "default half the processors.",
)  # fmt: skip
@click.option(
    "--scheduler", metavar="ADDRESS", help="Address of a running Dask scheduler, such as "
    "tcp://host:8786, whose workers identify the campaigns.",
)  # fmt: skip
@click.option(
    "--keep", type=click.Choice(KEPT), default="report", show_default=True,
    help="What to write: the posterior alone, or also the report with its figures.",
)  # fmt: skip
@seed_option("campaign")
@figures_option
@strict_option
@json_option
@verbose_option
@outside_option
def identify(
    given: tuple[Path, ...], out: Path | None, quick: bool, final: bool, brief: bool,
    mass: float | None, workers: int | None, scheduler: str | None, keep: Keep, seed: int | None,
    figures: tuple[str, ...], strict: bool, json_: bool, verbose: bool, allow_outside: bool,
) -> int:  # fmt: skip
    """Identify the joint from one CAMPAIGN, or from each of several.

    CAMPAIGN is a campaign file, its folder, or a folder of such folders. From RECORDs, or from a
    folder of records, a campaign file is drafted first, as by `jbw init`.

    Exit code: 0 if the verdict on the main posterior is ok or usable, otherwise 4 (with --strict
    also if it is usable), and 5 after an interruption. `jbw resume` continues an interrupted run,
    and also one that crashed.

    With --quick the result is that of the fit alone: the verdict is "not assessed" and the exit
    code 0. The same command without --quick, or `jbw resume`, replaces it by a full identification.

    With --final the held-out tests are fitted, too, at the end. The verdict remains that of the fit
    before, which they tested.

    Several campaigns run in parallel, each with its own folder in --out; if one fails, the others
    continue. The same command again continues interrupted runs and does not repeat finished ones.
    The exit code is that of the first failure; otherwise 4 if a verdict is neither ok nor usable.
    `jbw status DIR` shows how far they are.
    """
    if figures and keep == "posterior":
        raise click.UsageError("--figures draws figures, which --keep posterior leaves out.")
    campaigns = campaigns_given(given, mass)
    campaign, *others = campaigns
    if others:
        if final:
            raise click.UsageError("--final is for one campaign: run each campaign separately.")
        place = out or Path("runs")
        asked = {
            "seed": seed, "allow_outside": allow_outside, "figures": figures, "quick": quick,
            "keep": keep,
        }  # fmt: skip
        return identify_several(
            campaigns, place, json_, strict, asked, workers=workers, scheduler=scheduler,
            brief=brief,
        )  # fmt: skip
    if workers is not None or scheduler is not None:
        option = "--workers" if workers is not None else "--scheduler"
        raise click.UsageError(
            f"{option} is for several campaigns; a single campaign runs in one process."
        )
    source = str(campaign.resolve())
    manifest = Manifest(
        command_line(), source, seed=seed, allow_outside=allow_outside, quick=quick, final=final,
        figures=figures, keep=keep,
    )  # fmt: skip
    run = begin(out or Path(f"{campaign.stem}-run"), manifest)
    return run_to_end(run, json_=json_, verbose=verbose, strict=strict, brief=brief)


def identify_several(
    campaigns: Sequence[Path], out: Path, json_: bool, strict: bool, asked: Mapping[str, Any], *,
    workers: int | None = None, scheduler: str | None = None, brief: bool = False,
) -> int:  # fmt: skip
    """Identify several campaigns in parallel with the options in `asked`; print each outcome."""
    if workers is not None and scheduler is not None:
        raise click.UsageError("--scheduler has its own workers: leave out --workers.")
    try:
        with computing() as say, ExitStack() as open_:
            from jbw.study.many import identify_many
            from jbw.study.workers import dask_executor

            executor = open_.enter_context(dask_executor(scheduler)) if scheduler else None
            say(messages.identifying(len(campaigns)))

            def ended(sentence: str) -> None:
                say.remark(sentence)
                say.within(sentence.partition(":")[0])

            outcomes = identify_many(
                campaigns, out, executor=executor, workers=workers, report=ended,
                command=command_line(), **asked,
            )  # fmt: skip
    except KeyboardInterrupt:
        click.echo(SAVED, err=True)
        return INTERRUPTED
    rows = [asdict(outcome) for outcome in outcomes]
    if brief:
        for outcome in outcomes:
            if outcome.status == "done":
                save_brief(Path(outcome.folder))
    answer(
        json_, {"out": str(out), "campaigns": rows}, outcomes_table(outcomes), saved=f"Runs: {out}"
    )
    failed = [outcome.exit_code for outcome in outcomes if outcome.status == "failed"]
    if failed:
        return failed[0]
    if asked.get("quick"):  # a quick run assesses nothing
        return NOT_TRUSTED if strict else 0
    return max(exit_code_of(outcome.verdict, strict=strict) for outcome in outcomes)


@click.command()
@run_argument
@strict_option
@json_option
@verbose_option
@outside_option
def resume(folder: Path, strict: bool, json_: bool, verbose: bool, allow_outside: bool) -> int:
    """Continue the run in the folder DIR; its draws equal those of an uninterrupted run.

    All settings except --allow-outside come from DIR. The run is not continued if the campaign, its
    data, the sources of jbw or the versions of numerical packages have changed since it began.
    After `jbw identify --quick` the posterior is drawn. The exit codes are those of `jbw identify`.
    """
    run = reopen(folder, allow_outside=allow_outside)
    if run is None:
        page = folder / "report.html"
        shown = str(page) if page.exists() else ""
        click.echo(messages.finished(str(folder), shown), err=json_)
        if json_:
            click.echo((folder / "summary.json").read_text(encoding="utf-8"), nl=False)
        return 0
    try:
        if (warning := require_same(run)) is not None:
            click.echo(f"warning: {warning}", err=True)
        run.note(replace(run.manifest, quick=False))
    except BaseException:
        run.close()
        raise
    return run_to_end(run, json_=json_, verbose=verbose, strict=strict)


def run_to_end(
    run: Run, *, json_: bool = False, verbose: bool = False, steps: bool = False,
    strict: bool = False, brief: bool = False,
) -> int:  # fmt: skip
    """Run an identification to its end; if it is interrupted, print how to continue it.

    `steps` also prints the parameters of every step: the paper's Table 1. `brief` writes brief.pdf
    into the run's folder, which is also written if the folder already has one.

    Returns:
        Exit code: 0; 4 if the verdict of the main posterior is neither ok nor usable, or with
        `strict` not ok; 5 if interrupted.
    """

    def farewell() -> str:
        return messages.saved(str(run.folder), run.to_resume)

    try:
        with (
            run.interruption.heard(farewell),
            DrawingProcess(wanted=not run.manifest.quick) as beside,
            computing() as say,
        ):
            run.watch = say.chains
            from jbw.study import resumable

            summary, tree = resumable.carried_out(run, say, beside)
    except KeyboardInterrupt:
        click.echo(farewell(), err=True)
        return INTERRUPTED
    except JbwError:
        run.discard()
        raise
    finally:
        run.close()
    # Update a brief that was saved with an earlier first answer (`--quick`) of the same run.
    brief = brief or (run.folder / "brief.pdf").exists()
    pages = f"\nBrief: {save_brief(run.folder)}" if brief else ""
    shown = _all_of(summary) if verbose else short_lines(summary, tree)
    if steps and not verbose:
        from jbw.report.tables import parameters_table

        shown = (parameters_table(summary, {}), *shown)
    if summary.quick is not None:
        answer(json_, summary.plain(), *shown, saved=f"First answer: {run.folder}{pages}")
        quoted = shlex.quote(str(run.folder))
        following(f"resume {run.to_resume}", None, messages.draw_posterior(quoted))
        return NOT_TRUSTED if strict else 0
    page = run.folder / "report.html"
    saved = f"Report: {page}" if page.exists() else f"Posterior: {run.folder / 'posterior.nc'}"
    answer(json_, summary.plain(), *shown, saved=f"{saved}{pages}")
    return ended(summary.verdict, run.folder, strict=strict)


def ended(verdict: "StoredVerdict", folder: Path, *, strict: bool = False) -> int:
    """Print the command to type next, as the verdict suggests; return exit code 0 or 4."""
    quoted = shlex.quote(str(folder))
    code = exit_code_of(verdict.status, strict=strict)
    if code == 0:
        following("predict", folder, messages.or_export(quoted))
        return code
    reason = next((finding.code for finding in verdict.against), None)
    following("explain", reason, messages.or_plan(quoted))
    return code


def _all_of(summary: "RunSummary") -> Iterator[Table | Text | str]:
    yield from summary_lines(summary)
    yield from verdict_lines(summary.verdict)


def short_lines(summary: "RunSummary", tree: Any) -> Iterator[Text | str]:
    """Yield a run's law, verdict, split of tests, parameters and its report's opening sentences."""
    from jbw.report.opening import known_parameters, opening, split_sentence
    from jbw.report.result import laws_of
    from jbw.report.words import law_words

    took, is_quick = duration(summary.wall_time_s or 0.0), summary.quick is not None
    done = "a first answer" if is_quick else "identified"
    yield f"{summary.campaign}: {law_words(laws_of(tree))}, {done} in {took}"
    yield verdict_line(summary.verdict)
    if (split := split_sentence(summary)) is not None:
        yield split
    yield headline(known_parameters(summary), quick=is_quick)
    yield from opening(summary, tree)


def summary_lines(summary: "RunSummary") -> Iterator[Table | str]:
    """Yield a run's parameters (Table 1 of Teloli et al.), statements and prediction errors."""
    from jbw.report.tables import parameters_table, table_of_tests

    yield parameters_table(summary, {})
    for part, facts in (
        *summary.steps.items(),
        ("identifiability", summary.identifiability),
        ("routes", summary.comparison),
    ):
        yield from (f"{part}: {statement}" for statement in facts.statements)
    yield table_of_tests(summary)
