"""The last lines of every identification: instruments, summary, opening sentences, the tree."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import xarray as xr

from jbw.identification.assemble import entered
from jbw.identification.instruments import as_recorded, instruments_sentence, sensors_of
from jbw.identification.procedure import Identification
from jbw.inference.posterior.finding import Verdict
from jbw.measurement.records import INPUTS, Test, drive_of
from jbw.observables.drives import named
from jbw.quantities import gain_unit
from jbw.report.messages.instruments import BESIDE_MATRICES
from jbw.report.opening import opening
from jbw.study.assembly_group import GROUP as ASSEMBLY
from jbw.study.assembly_group import assembly_group
from jbw.study.identifiability import Identifiability, as_group
from jbw.study.look import look_groups
from jbw.study.order import Order, ReadCampaign
from jbw.study.study import Study
from jbw.study.summary import record_of, steps_group, widened_by_instruments
from jbw.verification.predictive_basis import AS_RECORDED


def finished_study(
    order: Order,
    read: ReadCampaign,
    identification: Identification,
    tree: xr.DataTree,
    *,
    identifiability: Identifiability | None,
    compared: Mapping[str, Any] | None = None,
    notes: Mapping[str, Any] | None = None,
) -> Study:
    """The study of what was identified, as `posterior.nc` and `summary.json` hold it.

    `compared` is the comparison of the routes, `notes` what else stands in the summary.
    """
    sensors = sensors_of(read.measured.chosen)
    wide = widened_by_instruments(order.campaign, sensors, identification, order.seed)
    if wide is not None:
        tree = _with_instruments(tree, wide)
    record = record_of(
        order, read.measured, identification, tree, compared=compared or {}, wide=wide
    )
    record |= {"look": read.look.record, **(notes or {})}
    groups = look_groups(read.look, entered(read.measured))
    if order.campaign.joints is not None:
        modes = tree["joints"].to_dataset()["frequency_hz"].values if "joints" in tree else ()
        groups[f"/{ASSEMBLY}"] = assembly_group(order.campaign.joints.model, tuple(modes))
    tree = xr.DataTree.from_dict({**tree.to_dict(), **groups})
    record["opening"] = list(opening(record, tree))
    tree["procedure"] = xr.DataTree(steps_group(record))
    if identifiability is not None:
        tree["identifiability"] = xr.DataTree(as_group(identifiability))
        record["identifiability"] = identifiability.summary()
    record["wall_time_s"] = round(perf_counter() - order.started, 2)
    return Study(tree, record, order.campaign, identification)


def with_main(
    identification: Identification, verdict: Verdict, statements: Sequence[str]
) -> Identification:
    """The identification with this verdict and these statements of its main posterior."""
    main = replace(identification.main, verdict=verdict, statements=tuple(statements))
    return replace(identification, steps={**identification.steps, main.name: main})


def about_instruments(order: Order, read: ReadCampaign) -> str:
    """What the intervals include of the errors of sensors and clock."""
    if order.campaign.joints is not None:
        return BESIDE_MATRICES
    return instruments_sentence(order.campaign.instruments, sensors_of(read.measured.chosen))


def _with_instruments(tree: xr.DataTree, wide: xr.Dataset) -> xr.DataTree:
    """The tree with the instruments' errors in its posterior, and that of the records beside it."""
    recorded = tree["posterior"].to_dataset()
    widened = {n: wide[n].assign_attrs(x.attrs) for n, x in recorded.data_vars.items()}
    groups = {
        f"/{AS_RECORDED}": as_recorded(recorded, wide),
        "/posterior": recorded.assign(widened),
    }
    return xr.DataTree.from_dict({**tree.to_dict(), **groups})


def name_gain_unit(tests: Sequence[Test], found: Identification) -> str:
    """Write the unit of the gain, which the returned one of the source decides, into posteriors.

    That of a force where none drives anything: of loops, whose modal mass free decays tell.
    """
    driven = [test for test in tests if not set(INPUTS).isdisjoint(test.records[0].channels)]
    units = {drive_of(t): t.records[0].units[t.records[0].source] for t in reversed(driven)}
    for step in found.steps.values():
        draws = step.posterior["posterior"]
        gains = {drive: named("gain", drive) for drive in units if named("gain", drive) in draws}
        rest = [drive for drive in map(drive_of, driven) if drive not in gains]
        if "gain" in draws:
            draws["gain"].attrs["units"] = gain_unit(units[rest[0]] if rest else "N")
        for drive, name in gains.items():
            draws[name].attrs["units"] = gain_unit(units[drive])
    return next(iter(units.values()), "")
