"""The loads of `jbw predict`: response curves, random profiles, shocks, notches."""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import click

from jbw.cli.printing import answer
from jbw.cli.progress import working
from jbw.errors import ConfigError
from jbw.report.messages import loads as messages

if TYPE_CHECKING:
    import xarray as xr

    from jbw.study.loads import Load
    from jbw.verification.predictive_basis import Basis

LOADS = ("response", "psd", "shock", "notch")
Found = dict[str, "xr.Dataset"]


class Quantities(click.ParamType):
    """Option type for numbers, separated by commas, with or without a unit."""

    name = "value"

    def convert(self, value: Any, *of: Any) -> list[tuple[float, str]]:
        """Return the (value, unit) pairs in the text of an option."""
        if not isinstance(value, str):
            return value
        found = []
        for part in value.split(","):
            match = re.fullmatch(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S*)\s*", part)
            if match is None:
                self.fail(messages.no_quantity(part), *of)
            found.append((float(match[1]), match[2]))
        return found


class SineAt(click.ParamType):
    """Option type for a sine: its frequency [Hz], a colon, and its amplitude."""

    name = "hz:value"

    def convert(self, value: Any, *of: Any) -> tuple[float, tuple[float, str]]:
        """Return the frequency and the (value, unit) pair in the text of an option."""
        try:
            hz, amplitude = value.split(":")
            (quantity,) = Quantities().convert(amplitude, *of)
            return float(hz), quantity
        except ValueError:
            self.fail(messages.no_sine(value), *of)


def in_unit(quantity: tuple[float, str], unit: str, option: str) -> float:
    """Convert a value to a unit; a value without a unit counts as being in that unit already."""
    from jbw.units import measured, plain

    value, stated = quantity
    if not stated:
        return value
    have, want = measured(plain(stated)), measured(plain(unit))
    if have is None or want is None or have[1] != want[1]:
        raise ConfigError(
            f"Option {option} must be in {unit}, but is in {stated}.",
            remedy=f"Give {option} in {unit}; for an acceleration of the base, add --base.",
        )
    return value * have[0] / want[0]


def bare(quantities: tuple[list[tuple[float, str]], ...]) -> list[float]:
    """Return the levels of planned tests as numbers; raise an error if a level has a unit."""
    values = [quantity for some in quantities for quantity in some]
    for _, unit in values:
        if unit:
            raise click.UsageError(messages.bare_level(unit))
    return [value for value, _ in values]


def require_alike(options: SimpleNamespace, *, loads: bool, campaign: Path | None) -> None:
    """Raise an error if tests and other loads are requested together, or --base without a load."""
    tests = options.names or options.sweep or options.stepped or options.tone or campaign
    if loads and tests:
        raise click.UsageError(messages.LOADS_OR_TESTS)
    if options.base and not loads:
        raise click.UsageError(messages.BASE_NEEDS)
    if options.sine is not None and options.psd is None:
        raise click.UsageError(messages.SINE_NEEDS)


def predict_loads(
    folder: Path, basis: "Basis", inputs: Mapping[str, str], options: SimpleNamespace, say: Any
) -> None:
    """Predict the loads that the options request, save them, and print the results.

    Args:
        folder: Folder of the run, comparison of laws or population that predicts.
        basis: Basis of predictions, as read from the folder.
        inputs: SHA-256 of each input file, by name.
        options: Options of the command.
        say: Function that is called with one sentence at every stage.
    """
    from jbw.measurement.records import BASE
    from jbw.report.load_section import load_rows, load_table
    from jbw.run.files import hash_of
    from jbw.study.loads import LOAD_DRAWS, Load, load_on
    from jbw.study.store import save_loads
    from jbw.verification.predict import warnings_of

    load = Load(
        drive=BASE if options.base else "force",
        draws=LOAD_DRAWS if options.draws is None else options.draws,
        participation=options.participation, shape=options.shape, unit=options.unit,
    )  # fmt: skip
    load = load_on(basis, load)
    if (profile := options.psd) is not None and profile.is_file():
        inputs = {**inputs, str(profile): hash_of(profile)}
    with working(say, options.out or folder / "predictions") as job:
        found: Found = {}
        parts = job.parts(inputs, say)
        for name, make in _loads(basis, load, options):
            found[name] = parts(name, make)
            say(f"Predicted: {name}")
        warnings = [line for dataset in found.values() for line in warnings_of(dataset)]
        for sentence in dict.fromkeys(warnings):
            say(f"warning: {sentence}")
        rows = [row for name, dataset in found.items() for row in load_rows(name, dataset)]
        say("Writing figures")
        save_loads(job.folder, found, rows, inputs.get("posterior.nc"))
    says = [messages.contains(**next(iter(found.values())).attrs)]
    place = f"Predictions: {job.folder / 'loads.nc'}"
    if options.out is None and (folder / "report.html").is_file():
        says.append(messages.in_report(str(folder)))
    plain = [row.plain() for row in rows]
    record = {"run": str(folder), "loads": plain, "warnings": list(dict.fromkeys(warnings))}
    answer(options.json_, record, load_table(rows), *says, saved=place)


def _loads(
    basis: "Basis", load: "Load", options: SimpleNamespace
) -> "Iterator[tuple[str, Callable[[], xr.Dataset]]]":
    """Yield the name of every requested prediction, with the function that computes it."""
    from jbw.forced.profiles import read_profile
    from jbw.forced.shock import pulse_of
    from jbw.study.loads import measured_of
    from jbw.study.loads_in_time import random_of, shock_of
    from jbw.study.loads_of_sines import (
        notch_of,
        resonance_of,
        resonances_in,
        response_curve_of,
    )

    seen, band = measured_of(basis, load), options.response
    stated = [quantity for some in options.levels for quantity in some]
    levels = [in_unit(quantity, seen.source, "--level") for quantity in stated]
    if (band is not None and not levels) or (options.notch and not (band and levels)):
        raise click.UsageError(messages.RESPONSE_NEEDS)
    if band is not None:
        for name, of_mode in resonances_in(basis, load, band):
            yield name, partial(resonance_of, basis, levels, of_mode)
        for level in levels:
            curve = partial(response_curve_of, basis, level, band, load)
            yield f"response at {level:.6g} {seen.source}", curve
            for quantity in options.notch or ():
                limit = in_unit(quantity, seen.unit, "--notch")
                notch = partial(notch_of, basis, level, limit, band, load)
                yield f"notch of {level:.6g} {seen.source} at {limit:.6g} {seen.unit}", notch
    if options.psd is not None:
        profile = read_profile(options.psd)
        sine = None
        if options.sine is not None:
            hz, amplitude = options.sine
            sine = hz, in_unit(amplitude, seen.source, "--sine")
        yield "random", partial(random_of, basis, profile, options.duration, load, sine)
    if options.shock is not None:
        yield "shock", partial(shock_of, basis, pulse_of(options.shock), load)
