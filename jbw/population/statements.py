"""What a population says in sentences."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jbw.population.prior import TORQUE, WRENCH
from jbw.population.record import FEWEST_FREE

ODD = 0.01  # probability, over the number of units, from which one does not belong
OWN = 2.0  # a unit's own error over the scatter, above which its normal summary stands for it
TOGETHER = 0.95  # correlation of torque and number of the tightening that hides one by the other
Record = Mapping[str, Any]


def statements(record: Record) -> list[str]:
    """Sentences of a record: how far to trust it first, then what it says."""
    topics = (_enough, _failed, _confounded, _no_logarithm, _trends, _ratios, _runs, _odd, _stands,
            _weak, _saturates, _wrench)  # fmt: skip
    return [sentence for topic in topics for sentence in topic(record)]


def _enough(record: Record) -> Iterator[str]:
    num, columns = len(record["units"]), record["columns"]
    free = num - len(columns)
    if record["status"] == "not assessed":
        trend = f" and a trend, {free} degrees of freedom being left" if len(columns) > 1 else ""
        yield (
            f"{num} units say too little of a scatter{trend}: what stands here is mostly the "
            "priors'."
        )
    elif free < FEWEST_FREE:
        yield f"{num} units leave {free} degrees of freedom: intervals are wide."
    if record["status"] == "failed":
        sampling = record["sampling"]
        yield (
            f"The sampler did not converge (R-hat {sampling['r_hat']:.3f}, "
            f"{sampling['divergences']} divergences): no number here is to be trusted."
        )


def _failed(record: Record) -> Iterator[str]:
    if failed := record["failed"]:
        yield (
            f"{len(failed)} of {len(record['units'])} units have runs that failed and are pooled "
            f"with the others: {', '.join(failed)}. Mend them (jbw explain), or leave them out."
        )


def _confounded(record: Record) -> Iterator[str]:
    together = record["correlation"]
    if together is not None and abs(together) > TOGETHER:
        way = "rose together" if together > 0 else "went against each other"
        yield (
            f"Torque and number of the tightening {way} (correlation {together:.2f}): only their "
            "joint effect is known, and the priors part it between them."
        )


def _no_logarithm(record: Record) -> Iterator[str]:
    for name, units in record["no_logarithm"].items():
        yield (
            f"{name} has no logarithm in {', '.join(units)}, not being known or positive there: it "
            "is in no coordinate, and in every unit keeps its run's prior, uniform in itself."
        )


def _trends(record: Record) -> Iterator[str]:
    for name, row in record["parameters"].items():
        if (slope := row.get("slope_torque")) is not None:
            way = "rises" if slope["q005"] > 0 else "falls" if slope["q995"] < 0 else None
            if way:
                yield f"{name} {way} with torque, as torque^{_interval(slope)}."


def _ratios(record: Record) -> Iterator[str]:
    for name, slope in record["ratios"].items():
        held = slope["q005"] <= 0.0 <= slope["q995"]
        yield f"{name} goes as torque^{_interval(slope)}" + (
            ": no dependence on torque is seen." if held else ": it depends on torque."
        )


def _runs(record: Record) -> Iterator[str]:
    scattering = {n: r for n, r in record["parameters"].items() if r["run_scatter"] is not None}
    if scattering:
        parts = (
            f"{name} by {100 * row['run_scatter']:.2g} % between runs of a unit and by "
            f"{100 * row['scatter']['median']:.2g} % between units"
            for name, row in scattering.items()
        )
        yield f"Scatter: {', '.join(parts)}."


def _odd(record: Record) -> Iterator[str]:
    limit = ODD / len(record["units"])
    if odd := [name for name, p in record["belongs"].items() if p < limit]:
        yield f"Does not belong with the others: {', '.join(odd)}."


def _stands(record: Record) -> Iterator[str]:
    num, weighed = len(record["units"]), record["weighed"]
    if weighed:
        yield (
            f"{len(weighed)} of {num} units enter by their own draws, reweighted: the effective "
            f"sample size is {100 * min(weighed.values()):.0f} % of the draws or more."
        )
    if rest := [name for name in record["units"] if name not in weighed]:
        yield f"Of {', '.join(rest)} a normal approximation of the posterior enters."


def _weak(record: Record) -> Iterator[str]:
    weak = [n for n, row in record["parameters"].items() if row["own_over_scatter"] > OWN]
    if weak:
        yield (
            f"Of {', '.join(weak)} a unit's own error is more than {OWN:g} times the scatter: the "
            "normal shape of its posterior decides there."
        )


def _saturates(record: Record) -> Iterator[str]:
    if (at := record.get("saturation_torque")) is not None:
        yield (
            f"{', '.join(record['saturating'])} was said to saturate with torque, and does so over "
            f"{_interval(at)} N m: a power is told from it only by torques far apart."
        )


def _wrench(record: Record) -> Iterator[str]:
    """Berkson's error of a torque that is set, and the attenuation of one that is read."""
    if TORQUE not in record["columns"]:
        return
    rows = record["parameters"].items()
    name, slope = max(
        ((name, abs(row["slope_torque"]["median"])) for name, row in rows), key=lambda pair: pair[1]
    )
    part = WRENCH**2 / (np.var(np.log(record["torque"])) + WRENCH**2)
    yield (
        f"Where a wrench sets the torque to within {100 * WRENCH:.0f} %, the exponents stay "
        f"unbiased, and the wrench adds a scatter of {100 * WRENCH * slope:.2g} % to {name}. Where "
        f"the torque is read with that error, every exponent is about {100 * part:.1g} % too small."
    )


def _interval(row: Mapping[str, float]) -> str:
    return f"{row['median']:.2g} [{row['q005']:.2g}, {row['q995']:.2g}]"
