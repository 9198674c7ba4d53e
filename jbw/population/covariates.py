"""The covariates of units, as stated or from a table: torque, sequence, assembly, temperature."""

import csv
from collections.abc import Mapping
from math import isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple

from jbw.errors import ConfigError, DataError, did_you_mean

NUMBERS = ("torque", "sequence", "temperature")
NAMES = (*NUMBERS, "assembly")


class Covariates(NamedTuple):
    """The covariates of a unit: torque, tightening sequence, temperature and assembly."""

    torque: float = nan  # tightening torque [N m]
    sequence: float = nan  # how often the unit had been tightened, counting this time
    temperature: float = nan  # temperature of the unit [degC]
    assembly: str = ""


def covariates_of(
    assemblies: Mapping[str, Mapping[str, Any]], overrides: Mapping[str, Mapping[str, Any]]
) -> dict[str, Covariates]:
    """Return each run's covariates from its stated assembly; `overrides` take precedence."""
    for run in overrides:
        if run not in assemblies:
            raise ConfigError(
                f"Covariates are given for the run `{run}`, which is not among the runs.",
                remedy=f"{did_you_mean(run, assemblies)}The runs are {', '.join(assemblies)}.",
            )
    return {
        run: _checked(run, {**assembly, **overrides.get(run, {})})
        for run, assembly in assemblies.items()
    }


def _checked(run: str, stated: Mapping[str, Any]) -> Covariates:
    for name in stated:
        if name not in NAMES:
            raise ConfigError(
                f"Run {run}: `{name}` is not a covariate.",
                remedy=f"{did_you_mean(name, NAMES)}The covariates are {', '.join(NAMES)}.",
            )
    numbers = {n: _number(run, n, stated[n]) for n in NUMBERS if stated.get(n) not in (None, "")}
    if not numbers.get("torque", 1.0) > 0:
        raise ConfigError(
            f"Run {run}: `torque` must be positive, but is {numbers['torque']:g}.",
            why="The joint's parameters are modelled as functions of the logarithm of the torque.",
            remedy="State `torque` in N m.",
        )
    return Covariates(**numbers, assembly=str(stated.get("assembly") or ""))


def _number(run: str, name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = nan
    if not isfinite(number):
        raise ConfigError(
            f"Run {run}: `{name}` must be a finite number, but is {value!r}.",
            remedy=f"Correct `{name}`, or leave `{name}` out if the value is unknown.",
        )
    return number


def require_torque_of_all(stated: Mapping[str, Covariates]) -> None:
    """Raise an error if only some of the units state a torque."""
    lacking = [run for run, covariates in stated.items() if covariates.torque != covariates.torque]
    if lacking and len(lacking) < len(stated):
        raise DataError(
            f"`torque` is stated for {len(stated) - len(lacking)} of {len(stated)} runs; it is "
            f"missing for {', '.join(lacking)}.",
            why="A slope over the torque needs the torque of every unit.",
            remedy="State `torque` for all runs, in [assembly] of their campaigns or in a table "
            f"given with --covariates, or leave out {', '.join(lacking)}.",
        )


def read_covariates(path: Path) -> dict[str, dict[str, str]]:
    """Read the covariates of runs from a CSV file with a column `run` and columns of covariates.

    Raises:
        ConfigError: The file or its column `run` does not exist, or a run occurs twice.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(
            f"The covariates {path} cannot be read: {error}.", remedy="Give a CSV file in UTF-8."
        ) from error
    covariates: dict[str, dict[str, str]] = {}
    for number, row in enumerate(rows, start=2):
        run = (row.pop("run", None) or "").strip()
        if not run or run in covariates or None in row:
            raise ConfigError(
                f"{path.name}, line {number}: must name a run that no earlier line names, and must "
                "not have more values than the header has columns.",
                remedy=f"Begin the file with the line: run,{','.join(NAMES)}.",
            )
        covariates[run] = {name.strip(): (value or "").strip() for name, value in row.items()}
    return covariates
