"""Samplers side by side: do they agree, and which gives the most effective draws a second?"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jbw.report.style import BLUE, GREEN, INK, SOFT, VERMILLION, Panels, legend, panels, title
from jbw.report.text import symbol

ERRORS = 2.0  # standard errors that a bar shows to either side
NEAR = 0.3  # standard deviations that are drawn to scale; what lies further is compressed
ROW = 0.24  # height of one sampler's line [in]
STATUS = {"ok": GREEN, "failed": VERMILLION}


def comparison(record: Mapping[str, Any], ax: Any = None) -> Panels:
    """Draw the mean of every parameter by every sampler, and their effective draws a second.

    Args:
        record: As `compare.json` holds it.
        ax: One axes a parameter and one more, or None.

    Returns:
        The axes, in one column.
    """
    names, count = record["parameters"], len(record["samplers"])
    height = (len(names) + 1) * (0.55 + ROW * count)
    axes = panels(ax, len(names) + 1, 1, height=height)
    for each, name in zip(axes[:-1, 0], names, strict=True):
        means(record, name, each)
    effective_rates(record, axes[-1, 0])
    legend(axes, ax)
    return axes


def means(record: Mapping[str, Any], parameter: str, ax: Axes | None = None) -> Axes:
    """Draw one parameter's mean by every sampler, in the reference's standard deviations.

    Bars are two Monte Carlo standard errors to either side.

    Args:
        record: As `compare.json` holds it.
        parameter: Its name.
        ax: Axes of the caller, or None.
    """
    here = panels(ax, 1, 1, height=0.55 + ROW * len(record["samplers"]))[0, 0]
    truth = record["samplers"][record["reference"]]["parameters"][parameter]
    here.axvline(0.0, color=SOFT, lw=0.8)
    for place, one in enumerate(record["samplers"].values()):
        row = one["parameters"][parameter]
        error = row.get("mcse_mean")
        look = {"color": STATUS.get(one["verdict"], BLUE), "fmt": "o", "ms": 4, "capsize": 2}
        label = f"verdict {one['verdict']}"
        away = (row["mean"] - truth["mean"]) / truth["sd"]
        bar = None if error is None else ERRORS * error / truth["sd"]
        here.errorbar(away, place, xerr=bar, label=label, **look)
    _scaled(here)
    _named(here, record)
    title(
        here,
        f"{symbol(parameter)}: mean less that of {_plain(record['reference'])}, "
        "bars of two Monte Carlo standard errors",
    )
    here.set_xlabel("distance [standard deviations of the posterior]")
    return here


def effective_rates(record: Mapping[str, Any], ax: Axes | None = None) -> Axes:
    """Draw effective draws a second by every sampler, compiled and from a cold start.

    Args:
        record: As `compare.json` holds it.
        ax: Axes of the caller, or None.
    """
    here = panels(ax, 1, 1, height=0.55 + ROW * len(record["samplers"]))[0, 0]
    for shift, kind, colour in ((-0.18, "warm", BLUE), (0.18, "cold", SOFT)):
        rates = [one[f"ess_per_s_{kind}"] for one in record["samplers"].values()]
        known = [(place + shift, rate) for place, rate in enumerate(rates) if rate]
        label = "compiled before" if kind == "warm" else "compiling included"
        if known:
            places, values = zip(*known, strict=True)
            here.barh(places, values, height=0.34, color=colour, label=label)
            here.set_xscale("log")
            least = min(here.get_xlim()[0], *values)
            here.set_xlim(left=10 ** np.floor(np.log10(least)))
    for place, one in enumerate(record["samplers"].values()):
        if one["verdict"] == "failed":
            told = f"  failed: {', '.join(dict.fromkeys(one['failed']))}"
            rate = one["ess_per_s_warm"] or one["ess_per_s_cold"] or here.get_xlim()[0]
            here.text(rate, place, told, va="center", fontsize=7, color=INK)
    _named(here, record)
    title(here, "speed, by the worst parameter")
    here.set_xlabel("effective draws a second [1/s]")
    return here


def _scaled(ax: Axes) -> None:
    """Distances to scale near zero, compressed further off, with ticks at round numbers."""
    low, high = ax.get_xlim()
    reach = max(-low, high, NEAR)
    ax.set_xscale("symlog", linthresh=NEAR)
    ax.set_xlim(min(low, -NEAR), max(high, NEAR))
    steps = (0.1, 0.3) if reach < 1 else NEAR * 10.0 ** np.arange(np.log10(reach / NEAR) + 1)
    ticks = [sign * step for sign in (-1, 1) for step in steps]
    left, right = ax.get_xlim()
    shown = sorted({0.0, *(tick for tick in ticks if left <= tick <= right)})
    ax.set_xticks(shown, [f"{tick:g}" for tick in shown])
    ax.minorticks_off()


def _named(ax: Axes, record: Mapping[str, Any]) -> None:
    """One line a sampler, the first on top."""
    names = list(record["samplers"])
    ax.set_yticks(range(len(names)), [_plain(name) for name in names])
    ax.set_ylim(len(names) - 0.4, -0.6)


def _plain(sampler: str) -> str:
    return sampler.replace("_", " ")
