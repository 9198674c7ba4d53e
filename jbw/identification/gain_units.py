"""Units of gains: force per mass, divided by the unit of the tests' source."""

from collections.abc import Container, Sequence

import xarray as xr

from jbw.inference.posterior.summary import posterior_draws
from jbw.measurement.records import INPUTS, Test, drive_of
from jbw.observables.drives import named
from jbw.quantities import gain_unit


def source_units(tests: Sequence[Test]) -> dict[str, str]:
    """Return the unit of the source of each drive; the drive of the last test comes first."""
    return {drive_of(test): test.records[0].units[test.records[0].source] for test in
            reversed(driven(tests))}  # fmt: skip


def driven(tests: Sequence[Test]) -> list[Test]:
    """Return the tests whose records contain an input channel."""
    return [test for test in tests if not set(INPUTS).isdisjoint(test.records[0].channels)]


def gain_units(tests: Sequence[Test], names: Container[str]) -> dict[str, str]:
    """Return the unit of every gain among the names of parameters.

    If no test has an input, the unit is that of a force, as for loops, whose modal mass free decays
    determine.
    """
    sources = source_units(tests)
    gains = {drive: named("gain", drive) for drive in sources if named("gain", drive) in names}
    units = {name: gain_unit(sources[drive]) for drive, name in gains.items()}
    if "gain" not in names:
        return units
    rest = [drive_of(test) for test in driven(tests) if drive_of(test) not in gains]
    return {"gain": gain_unit(sources[rest[0]] if rest else "N"), **units}


def with_gain_units(tree: xr.DataTree, tests: Sequence[Test]) -> xr.DataTree:
    """Return a posterior whose gains have the units of the tests' sources."""
    draws = posterior_draws(tree)
    units = gain_units(tests, draws)
    gains = {name: draws[name].assign_attrs(units=unit) for name, unit in units.items()}
    return tree.assign(posterior=xr.DataTree(draws.assign(gains)))
