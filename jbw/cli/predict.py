"""The command `jbw predict DIR`."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jbw.cli.options import json_option, out_option, outside_option, run_argument
from jbw.cli.printing import NOTHING, show, show_json
from jbw.report.table import Column, Table, shares, table, words

if TYPE_CHECKING:
    from jbw.measurement.records import Test
    from jbw.verification.predictive_basis import Basis


def _pair(
    ctx: click.Context, param: click.Parameter, value: str | None
) -> tuple[float, float] | None:
    """Two numbers with a colon between them."""
    if value is None:
        return None
    try:
        first, last = map(float, value.split(":"))
    except ValueError:
        message = f"{value!r} must be two numbers in Hz with a colon, as in 10:25."
        raise click.BadParameter(message, ctx, param) from None
    return first, last


def _from_to(name: str, what: str) -> Callable[..., Any]:
    """An option of a test that nobody measured, between two frequencies."""
    told = f"A {what} nobody measured, from:to [Hz]."
    return click.option(name, callback=_pair, metavar="FROM:TO", help=told)


@click.command()
@run_argument
@click.option("--campaign", type=click.Path(path_type=Path), help="Campaign file of the tests.")
@click.option("--test", "names", multiple=True, help="A test by name; all when left out.")
@_from_to("--sweep", "sweep")
@_from_to("--stepped", "stepped sine")
@click.option("--tone", type=float, help="A tone nobody measured [Hz].")
@click.option("--level", "levels", type=float, multiple=True, help="Its amplitude, as the run's.")
@click.option("--duration", type=float, default=64.0, show_default=True, help="Of the sweep [s].")
@click.option("--fs", type=float, default=1024.0, show_default=True, help="Of the sweep [Hz].")
@click.option("--without-noise", is_flag=True, help="Bands of the parameters alone.")
@click.option("--draws", type=int, default=100, show_default=True, help="Draws carried along.")
@out_option("DIR/predictions")
@json_option
@outside_option
def predict(folder: Path, campaign: Path | None, **options: Any) -> None:
    """Predict tests from the finished run in DIR: 99 % bands, coverage, error.

    The tests are those of a campaign, which the run need never have seen, or planned ones that
    nobody measured: a linear sweep from rest, which fades out over its last 2 %, a stepped sine or
    a tone. predictions.nc has the bands by test, predictions.json the table, figures/ a figure of
    each. A test beyond the displacements that were fitted is said to be.
    """
    from jbw.cli.progress import progress
    from jbw.cli.running import prepare_jax

    prepare_jax()
    from jbw.campaign.load import force_per_unit, load_campaign
    from jbw.study.store import claim, save_predictions
    from jbw.study.study import basis_of_run
    from jbw.verification import predict as predicting

    basis = basis_of_run(folder)
    planned, tests, gain = list(_planned(basis, **options)), [], None
    if campaign is not None:
        loaded = load_campaign(campaign, allow_outside=options["allow_outside"])
        tests = list(predicting.chosen(loaded.tests, options["names"], "--test"))
        gain = force_per_unit(loaded)
    elif options["names"] or not planned:
        raise click.UsageError("Give --campaign, or --sweep, --stepped or --tone with --level.")
    out = claim(options["out"] or folder / "predictions")
    request = predicting.Request(options["draws"], not options["without_noise"])
    # Planned tests are in the run's own unit, whatever the campaign says of its gain.
    requests = [(test, replace(request, gain=gain)) for test in tests]
    requests += [(test, request) for test in planned]
    found = {}
    with progress() as say:
        for test, asked in requests:
            say(f"Predicting {test.name}")
            found[test.name] = predicting.predict(basis, test, asked)
        rows = [predicting.row_of(one) for one in found.values()]
        for sentence in (sentence for row in rows for sentence in row["warnings"]):
            say(f"warning: {sentence}")
        say("Writing figures")
        save_predictions(out, found, rows)
    if options["json_"]:
        show_json({"run": str(folder), "predictions": rows})
    else:
        by_noise: dict[str, list[str]] = {}
        for row in rows:
            by_noise.setdefault(row["noise"], []).append(row["test"])
        how = [f"Noise {noise} ({', '.join(named)})" for noise, named in by_noise.items()]
        show(prediction_table(rows), *how)
        click.echo(f"Predictions: {out / 'predictions.nc'}")


def _planned(
    basis: "Basis",
    *,
    sweep: tuple[float, float] | None,
    stepped: tuple[float, float] | None,
    tone: float | None,
    levels: Sequence[float],
    duration: float,
    fs: float,
    **_: Any,
) -> "Iterator[Test]":
    """The tests that nobody measured, at each level."""
    from jbw.verification import planned

    asked = sweep is not None or stepped is not None or tone is not None
    if asked != bool(levels):
        raise click.UsageError("--level goes with --sweep, --stepped or --tone.")
    for level in levels:
        if sweep is not None:
            yield planned.planned_sweep(basis, sweep, level, duration, fs)
        if stepped is not None:
            yield planned.planned_tones(basis, planned.steps(stepped), level)
        if tone is not None:
            yield planned.planned_tones(basis, (tone,), level)


def prediction_table(rows: Sequence[dict[str, Any]]) -> Table:
    """The predictions, a line a test."""
    from jbw.report.tables import inside, level_of  # loads matplotlib

    return table(
        "",
        rows,
        words("test", "test"),
        Column("level", level_of),
        words("kind", "kind"),
        Column("inside the band", inside),
        shares("error", "nrmse", ""),
        Column("peak displacement [m]", _peak),
        Column("of fitted", _reach, align="left"),
    )


def _peak(row: dict[str, Any]) -> str:
    if row["y_peak"] is None:
        return NOTHING
    low, middle, high = row["y_peak"].values()
    # Significant digits that show the interval's width to one digit, 3 to 8 of them.
    digits = 3
    if 0 < high - low < middle:
        digits = min(max(2 - floor(log10((high - low) / middle)), 3), 8)
    return f"{middle:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"


def _reach(row: dict[str, Any]) -> str:
    if row["extrapolation"] is None:
        return NOTHING
    return f"{row['extrapolation']:.2f}" + (" BEYOND" if row["beyond"] else "")
