"""The figure of a fleet: every unit beside the others, and where a new one would lie."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jbw.report.style import BLUE, INK, VERMILLION, Panels, finish, panels, shade

HALF_99 = 2.5758  # sd of a normal interval of 99 %


def population_figure(
    record: Mapping[str, Any],
    mean: np.ndarray,
    sd: np.ndarray,
    at: np.ndarray,
    new: np.ndarray,
    ax: Any = None,
) -> Panels:
    """Draw each coordinate of every unit against torque, or in order where there is no trend.

    Args:
        record: Of `population_of`.
        mean: Logarithms, axes (unit, coordinate).
        sd: Their errors.
        at: Torques at which the population is drawn [N m], or two ends of the order.
        new: 99 % bands of a new unit there, logarithms, axes (quantile, place, coordinate).
        ax: Axes to draw in.
    """
    rows, trend = record["parameters"], "torque" in record["columns"]
    axes = panels(ax, len(rows), 1, height=1.7 * len(rows))
    place = np.array(record["torque"]) if trend else np.arange(1.0, len(mean) + 1)
    odd = np.array([p < 0.01 / len(mean) for p in record["belongs"].values()])
    for i, (each, row) in enumerate(zip(axes[:, 0], rows.values(), strict=True)):
        low, middle, high = np.exp(new[:, :, i])
        shade(each, at, low, high, BLUE, "99 % of a new unit", alpha=0.15)
        each.plot(at, middle, color=BLUE, lw=1.0)
        value = np.exp(mean[:, i])
        error = [value - np.exp(mean[:, i] - HALF_99 * sd[:, i]),
                 np.exp(mean[:, i] + HALF_99 * sd[:, i]) - value]  # fmt: skip
        each.errorbar(place, value, error, fmt="o", color=INK, ms=4, lw=1.0, label="unit, 99 %")
        each.plot(place[odd], value[odd], "s", color=VERMILLION, ms=8, mfc="none")
        each.set_ylabel(f"{row['symbol']} [{row['unit']}]" if row["unit"] != "1" else row["symbol"])
        if not trend:
            each.set_xticks(place, record["units"] if i == len(rows) - 1 else [""] * len(place))
    axes[-1, 0].set_xlabel("tightening torque [N m]" if trend else "unit")
    return finish(axes, ax)
