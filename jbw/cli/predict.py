"""The command that predicts tests and loads: `jbw predict DIR`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import click

from jbw.cli.loads import LOADS, Quantities, SineAt, bare, predict_loads, require_alike
from jbw.cli.options import json_option, out_option, outside_option, run_argument
from jbw.cli.printing import answer
from jbw.cli.progress import computing, working
from jbw.report.messages.commands import two_numbers
from jbw.report.messages.study import further_units
from jbw.report.table import Column, Table, shares, table, words
from jbw.report.text import NOTHING, number

if TYPE_CHECKING:
    from jbw.measurement.records import Test
    from jbw.results.run import StoredTest
    from jbw.verification.predictive_basis import Basis


class FromTo(click.ParamType):
    """Option type for a pair of frequencies with a colon between them."""

    name = "from:to"

    def convert(self, value: Any, *of: Any) -> tuple[float, float]:
        """Return the two frequencies [Hz] in an option's text `first:last`."""
        try:
            first, last = map(float, value.split(":"))
        except ValueError:
            self.fail(two_numbers(repr(value)), *of)
        return first, last


@click.command()
@run_argument
@click.option(
    "--campaign",
    type=click.Path(path_type=Path),
    help="Campaign file of the tests; by default that of the run.",
)
@click.option("--test", "names", multiple=True, help="Name of a test; by default all tests.")
@click.option("--sweep", type=FromTo(), help="A sweep that was not measured, from:to [Hz].")
@click.option(
    "--stepped", type=FromTo(), help="A stepped sine that was not measured, from:to [Hz]."
)
@click.option("--tone", type=float, help="A tone that was not measured [Hz].")
@click.option(
    "--response", type=FromTo(), help="Response curves under sine excitation, from:to [Hz]."
)
@click.option("--psd", type=click.Path(path_type=Path), help="Random profile: a CSV file.")
@click.option("--sine", type=SineAt(), help="A sine added to the random profile, such as 30:2g.")
@click.option("--shock", help="A shock, such as 20g,11ms or 20g,11ms,sawtooth.")
@click.option("--notch", type=Quantities(), help="Largest response of the curves, such as 5g.")
@click.option("--base", is_flag=True, help="Levels are accelerations of the base, such as 2g.")
@click.option(
    "--participation",
    type=float,
    default=float("nan"),
    help="Participation of the mode in the motion of the base; by default as identified if "
    "the base moved, else 1.",
)
@click.option(
    "--shape",
    type=float,
    default=1.0,
    show_default=True,
    help="Motion of the measured point in the mode, for a moving base.",
)
@click.option("--unit", default="", help="Unit of the response, such as g; by default as measured.")
@click.option(
    "--level",
    "levels",
    type=Quantities(),
    multiple=True,
    help="Amplitudes of sweeps, tones and curves, in the unit of the source; 0.1,0.2 for two.",
)
@click.option(
    "--duration",
    type=float,
    default=64.0,
    show_default=True,
    help="Duration of the sweep or of the random motion [s].",
)
@click.option(
    "--fs", type=float, default=1024.0, show_default=True, help="Sampling rate of the sweep [Hz]."
)
@click.option(
    "--without-noise",
    is_flag=True,
    help="Include only the uncertainty of the parameters in the bands.",
)
@click.option(
    "--draws",
    type=int,
    help="Draws from which bands are computed; by default 100 for tests and 200 for loads.",
)
@out_option("DIR/predictions")
@json_option
@outside_option
def predict(folder: Path, campaign: Path | None, **stated: Any) -> None:
    """Predict tests from the finished run in DIR: 99 % bands, coverage, error.

    DIR may also be the folder of `jbw laws`: then all laws predict, each with its weight. Or it may
    be the folder of `jbw population`: then the tests of new, unmeasured units are predicted, at the
    torque of the population.

    The tests are those of a campaign, which the run need not contain, or tests that were not
    measured: a linear sweep from rest that fades out over its last 2 %, a stepped sine, or a tone.
    predictions.nc contains the bands by test, predictions.json the table, and figures/ one figure
    per test. The output says if a test exceeds the fitted displacements.

    Other loads need only the joint: --response computes response curves with their jumps, --psd
    random vibration, --shock a shock, each as a force or as an acceleration of the base, and
    --notch the level that keeps a response within a limit. loads.nc contains their bands,
    loads.json the results; each load has a CSV file and a figure.
    """
    options = SimpleNamespace(**stated)
    loads = any(stated[name] is not None for name in LOADS)
    require_alike(options, loads=loads, campaign=campaign)
    with computing() as say:
        from jbw.campaign.load import load_campaign
        from jbw.campaign.tables import force_per_unit
        from jbw.law_comparison.stack import holds_laws
        from jbw.population.basis import holds_population, require_same_torque
        from jbw.study.store import save_predictions
        from jbw.study.study import campaign_of, inputs_of
        from jbw.verification import predict as predicting

        say(f"Reading {folder}")
        basis = basis_in(folder)
        if loads:
            return predict_loads(folder, basis, basis_inputs(folder), options, say)
        # Planned tests use the unit of the run's source, whatever gain the campaign states.
        request = predicting.Request(noise=not options.without_noise)
        if options.draws is not None:
            request = replace(request, num_draws=options.draws)
        requests = [(test, request) for test in _planned(basis, options)]
        inputs = basis_inputs(folder)
        if campaign is None and (options.names or not requests):
            if holds_laws(folder):
                raise click.UsageError(
                    "Give --campaign, the campaign on which the laws were compared."
                )
            if holds_population(folder):
                raise click.UsageError(
                    "Give --campaign, the campaign of the unit to predict, or --sweep."
                )
            campaign = campaign_of(folder)
        if campaign is not None:
            say(f"Reading {campaign}")
            loaded = load_campaign(campaign, allow_outside=options.allow_outside)
            require_same_torque(folder, loaded.assembly.torque)
            of_units = replace(request, gain=force_per_unit(loaded))
            inputs |= inputs_of(loaded)
            tests = predicting.chosen(loaded.tests, options.names, "--test")
            requests = [*((test, of_units) for test in tests), *requests]
        with working(say, options.out or folder / "predictions") as job:
            out, parts, predictions = job.folder, job.parts(inputs, say), {}
            for number, (test, test_request) in enumerate(requests):
                say(f"Predicting {test.name}")
                predicted = partial(predicting.predict, basis, test, test_request)
                predictions[test.name] = parts(f"test {number}", predicted)
            rows = [predicting.row_of(prediction) for prediction in predictions.values()]
            for sentence in (sentence for row in rows for sentence in row["warnings"]):
                say(f"warning: {sentence}")
            say("Writing figures")
            save_predictions(out, predictions, rows)
    by_noise: dict[str, list[str]] = {}
    for row in rows:
        by_noise.setdefault(row["noise"], []).append(row["test"])
    how = [
        f"Noise: {noise.removeprefix('noise ')} ({', '.join(named)})"
        for noise, named in by_noise.items()
    ]
    if holds_population(folder):
        how.insert(0, _of_population(require_same_torque(folder, None), requests))
    record = {"run": str(folder), "predictions": rows}
    place = f"Predictions: {out / 'predictions.nc'}"
    answer(options.json_, record, prediction_table(rows), *how, saved=place)


def basis_inputs(folder: Path) -> dict[str, str]:
    """Return the SHA-256 hash of each file on which a folder's predictions depend, by file name."""
    from jbw.run.files import hash_of

    files = sorted(path for path in folder.iterdir() if path.suffix in (".nc", ".json"))
    return {path.name: hash_of(path) for path in files}


def basis_in(folder: Path) -> "Basis":
    """Return the basis of a folder's predictions: a run, compared laws, or a population."""
    from jbw.law_comparison.stack import basis_of_laws, holds_laws
    from jbw.population.basis import basis_of_population, holds_population
    from jbw.study.study import basis_of_run

    if holds_laws(folder):
        return basis_of_laws(folder)
    if holds_population(folder):
        return basis_of_population(folder)
    return basis_of_run(folder)


def _of_population(torque: float | None, requests: Sequence[tuple[Any, Any]]) -> str:
    """Return the message that new units of a population are predicted, at which torque and gain."""
    of_units = all(request.gain is None for _, request in requests)
    return further_units(torque, of_units=of_units)


def _planned(basis: "Basis", options: SimpleNamespace) -> "Iterator[Test]":
    """Yield the planned, unmeasured tests that the options request, at each level."""
    from jbw.verification import planned

    sweep, stepped, tone = options.sweep, options.stepped, options.tone
    levels = bare(options.levels)
    if any(quantity is not None for quantity in (sweep, stepped, tone)) != bool(levels):
        raise click.UsageError("--level goes with --sweep, --stepped, --tone or --response.")
    for level in levels:
        if sweep is not None:
            yield planned.planned_sweep(basis, sweep, level, options.duration, options.fs)
        if stepped is not None:
            yield planned.planned_tones(basis, planned.steps(stepped), level)
        if tone is not None:
            yield planned.planned_tones(basis, (tone,), level)


def prediction_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the table of predictions, with one line per test."""
    from jbw.report.tables import inside, level_of  # loads matplotlib
    from jbw.results.run import StoredTest

    return table(
        "",
        [StoredTest.read(row) for row in rows],
        words("test", "test"),
        Column("level", level_of),
        words("kind", "kind"),
        Column("inside the band", inside),
        shares("half width", "half_width", ""),
        shares("error", "nrmse", ""),
        shares("error, own frequency", "nrmse_own_frequency", ""),
        Column("peak displacement [m]", _peak),
        Column("of fitted", _reach, align="left"),
    )


def _peak(row: "StoredTest") -> str:
    if row.y_peak is None:
        return NOTHING
    values = list(row.y_peak.values())
    low, middle, high = (number(quantile, values[2] - values[0]) for quantile in values)
    return f"{middle} [{low}, {high}]"


def _reach(row: "StoredTest") -> str:
    if row.extrapolation is None:
        return NOTHING
    return f"{row.extrapolation:.2f}" + (" BEYOND" if row.beyond else "")
