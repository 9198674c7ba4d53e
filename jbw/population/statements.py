"""What a population states: which sentences of the catalogue hold, with their numbers."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jbw.population.prior import TORQUE, WRENCH
from jbw.population.record import FEWEST_FREE
from jbw.report.messages import population

ODD = 0.01  # probability, over the number of units, from which one does not belong
OWN = 2.0  # a unit's own error over the scatter, above which its normal summary stands for it
TOGETHER = 0.95  # correlation of torque and number of the tightening that hides one by the other
Record = Mapping[str, Any]


def statements(record: Record) -> list[str]:
    """Sentences of a record: how far to trust it first, then what it says."""
    topics = (_few_units, _failed, _confounded, _no_logarithm, _trends, _ratios, _runs, _odd,
              _stands, _weak, _saturates, _wrench)  # fmt: skip
    return [sentence for topic in topics for sentence in topic(record)]


def _few_units(record: Record) -> Iterator[str]:
    num, columns = len(record["units"]), record["columns"]
    free = num - len(columns)
    if record["status"] == "not assessed":
        yield population.mostly_prior(num, free, trend=len(columns) > 1)
    elif free < FEWEST_FREE:
        yield population.wide_intervals(num, free)
    if record["status"] == "failed":
        sampling = record["sampling"]
        yield population.not_converged(sampling["r_hat"], sampling["divergences"])


def _failed(record: Record) -> Iterator[str]:
    if failed := record["failed"]:
        yield population.failed_runs(failed, len(record["units"]))


def _confounded(record: Record) -> Iterator[str]:
    correlation = record["correlation"]
    if correlation is not None and abs(correlation) > TOGETHER:
        yield population.confounded(correlation)


def _no_logarithm(record: Record) -> Iterator[str]:
    for name, units in record["no_logarithm"].items():
        yield population.no_logarithm(name, units)


def _trends(record: Record) -> Iterator[str]:
    for name, row in record["parameters"].items():
        slope = row.get("slope_torque")
        if slope is not None and not _holds_zero(slope):
            yield population.trend(name, slope, rises=slope["q005"] > 0)


def _ratios(record: Record) -> Iterator[str]:
    for name, slope in record["ratios"].items():
        yield population.ratio_trend(name, slope, depends=not _holds_zero(slope))


def _runs(record: Record) -> Iterator[str]:
    scattering = [
        (name, row["run_scatter"], row["scatter"]["median"])
        for name, row in record["parameters"].items()
        if row["run_scatter"] is not None
    ]
    if scattering:
        yield population.scatter(scattering)


def _odd(record: Record) -> Iterator[str]:
    limit = ODD / len(record["units"])
    if odd := [name for name, p in record["belongs"].items() if p < limit]:
        yield population.outliers(odd)


def _stands(record: Record) -> Iterator[str]:
    num, weighed = len(record["units"]), record["weighed"]
    if weighed:
        yield population.weighed(len(weighed), num, min(weighed.values()))
    if rest := [name for name in record["units"] if name not in weighed]:
        yield population.approximated(rest)


def _weak(record: Record) -> Iterator[str]:
    weak = [n for n, row in record["parameters"].items() if row["own_over_scatter"] > OWN]
    if weak:
        yield population.weak(weak, OWN)


def _saturates(record: Record) -> Iterator[str]:
    if (torque := record.get("saturation_torque")) is not None:
        yield population.saturates(record["saturating"], torque)


def _wrench(record: Record) -> Iterator[str]:
    """Berkson's error of a torque that is set, and the attenuation of one that is read."""
    if TORQUE not in record["columns"]:
        return
    rows = record["parameters"].items()
    name, slope = max(
        ((name, abs(row["slope_torque"]["median"])) for name, row in rows), key=lambda pair: pair[1]
    )
    attenuation = WRENCH**2 / (np.var(np.log(record["torque"])) + WRENCH**2)
    yield population.wrench(name, WRENCH, WRENCH * slope, float(attenuation))


def _holds_zero(slope: Mapping[str, float]) -> bool:
    """Whether a 99 % interval holds zero."""
    return slope["q005"] <= 0.0 <= slope["q995"]
