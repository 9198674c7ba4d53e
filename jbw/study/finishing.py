"""The last lines of every identification: instruments, summary, opening sentences, the tree."""

from collections.abc import Mapping
from time import perf_counter
from typing import Any

import xarray as xr

from jbw.identification.assemble import entered
from jbw.identification.instruments import as_recorded, instruments_sentence, sensors_of
from jbw.identification.procedure import Identification
from jbw.report.messages.instruments import BESIDE_MATRICES
from jbw.report.opening import opening
from jbw.study.assembly_group import GROUP as ASSEMBLY
from jbw.study.assembly_group import assembly_group
from jbw.study.comparisons import Comparisons
from jbw.study.identifiability import as_group
from jbw.study.look import look_groups
from jbw.study.order import Order
from jbw.study.prepared import PreparedTests
from jbw.study.study import Study
from jbw.study.summary import record_of, steps_group, widened_by_instruments
from jbw.verification.predictive_basis import AS_RECORDED


def finished_study(
    order: Order,
    prepared: PreparedTests,
    identification: Identification,
    comparisons: Comparisons,
    *,
    notes: Mapping[str, Any] | None = None,
) -> Study:
    """The study of what was identified, as `posterior.nc` and `summary.json` hold it.

    `notes` is what else stands in the summary.
    """
    measured = prepared.measured
    sensors = sensors_of(measured.chosen)
    wide = widened_by_instruments(order.campaign, sensors, identification, order.seed)
    groups = measured_groups(order, prepared, comparisons.tree, wide)
    tree = xr.DataTree.from_dict(groups)
    facts = record_of(order, measured, identification, tree, compared=comparisons.routes, wide=wide)
    facts |= {"look": prepared.look.record, **(notes or {})}
    record = {**facts, "opening": list(opening(facts, tree))}
    groups["/procedure"] = steps_group(record)
    if (known := comparisons.identifiability) is not None:
        groups["/identifiability"] = as_group(known)
        record["identifiability"] = known.summary()
    record["wall_time_s"] = round(perf_counter() - order.started, 2)
    return Study(xr.DataTree.from_dict(groups), record, order.campaign, identification)


def measured_groups(
    order: Order, prepared: PreparedTests, tree: xr.DataTree, wide: xr.Dataset | None
) -> dict[str, xr.Dataset]:
    """Groups of the tree, the instruments' errors in it, and what was seen without a model.

    `wide` is the main posterior with the stated errors of the instruments, None where none are.
    """
    groups: dict[str, xr.Dataset] = {str(path): group for path, group in tree.to_dict().items()}
    if wide is not None:
        groups |= _with_instruments(tree["posterior"].to_dataset(), wide)
    groups |= look_groups(prepared.look, entered(prepared.measured))
    if order.campaign.joints is not None:
        modes = tree["joints"].to_dataset()["frequency_hz"].values if "joints" in tree else ()
        groups[f"/{ASSEMBLY}"] = assembly_group(order.campaign.joints.model, tuple(modes))
    return groups


def about_instruments(order: Order, prepared: PreparedTests) -> str:
    """What the intervals include of the errors of sensors and clock."""
    if order.campaign.joints is not None:
        return BESIDE_MATRICES
    sensors = sensors_of(prepared.measured.chosen)
    return instruments_sentence(order.campaign.instruments, sensors)


def _with_instruments(recorded: xr.Dataset, wide: xr.Dataset) -> dict[str, xr.Dataset]:
    """The posterior with the instruments' errors, and that of the records beside it."""
    widened = {n: wide[n].assign_attrs(x.attrs) for n, x in recorded.data_vars.items()}
    return {
        f"/{AS_RECORDED}": as_recorded(recorded, wide),
        "/posterior": recorded.assign(widened),
    }
