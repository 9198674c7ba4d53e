"""Figures of method studies: comparison of samplers, and ranks of a calibration."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jbw.inference.calibration.record import LEVEL, Calibration, counts_below, ecdf_envelope
from jbw.report import style
from jbw.report.messages import figures as labels
from jbw.report.style import Panels, finish, panels, shade, stacks, title
from jbw.report.text import number, symbol
from jbw.results.studies import StoredSamplers

ERRORS = 2.0  # half length of a bar, in standard errors
# distance up to which the axis is linear [standard deviations]; larger distances are compressed
NEAR = 0.3
ROW = 0.24  # height of one sampler's line [in]
STATUS = {"ok": style.GREEN, "failed": style.VERMILION}


def comparison(record: StoredSamplers, ax: Any = None) -> Panels:
    """Draw means and effective draws per second of each sampler, as `compare.json` stores them."""
    names, count = record.parameters, len(record.samplers)
    axes = panels(ax, len(names) + 1, 1, height=(len(names) + 1) * (0.55 + ROW * count))
    for panel, name in zip(axes[:-1, 0], names, strict=True):
        means(record, name, panel)
    effective_rates(record, axes[-1, 0])
    return finish(axes, ax)


def means(record: StoredSamplers, parameter: str, ax: Axes | None = None) -> Axes:
    """Plot each sampler's mean of a parameter minus the reference's mean, with Monte Carlo errors.

    Bars show +- 2 Monte Carlo errors, in standard deviations of the reference.
    """
    here = _one_line_each(record, ax)
    reference = record.reference or ""
    truth = record.samplers[reference].parameters[parameter]
    here.axvline(0.0, color=style.SOFT, lw=0.8)
    for place, sampler in enumerate(record.samplers.values()):
        row = sampler.parameters[parameter]
        look = {
            "color": STATUS.get(sampler.verdict, style.BLUE),
            "fmt": "o",
            "ms": 4,
            "capsize": 2,
        }
        if row.mean is None or truth.mean is None or not truth.sd:
            continue
        away = (row.mean - truth.mean) / truth.sd
        bar = None if row.mcse_mean is None else ERRORS * row.mcse_mean / truth.sd
        here.errorbar(away, place, xerr=bar, label=f"verdict {sampler.verdict}", **look)
    _scaled(here)
    title(here, labels.less_mean(symbol(parameter), reference.replace("_", " ")))
    here.set_xlabel(labels.DISTANCE)
    return here


def effective_rates(record: StoredSamplers, ax: Axes | None = None) -> Axes:
    """Draw effective draws per second of every sampler, with and without compilation time."""
    here = _one_line_each(record, ax)
    for shift, kind, colour, label in (
        (-0.18, "warm", style.BLUE, "compiled before"),
        (0.18, "cold", style.SOFT, "compiling included"),
    ):
        rates = [getattr(sampler, f"ess_per_s_{kind}") for sampler in record.samplers.values()]
        measured = [(place + shift, rate) for place, rate in enumerate(rates) if rate]
        if measured:
            heights, values = zip(*measured, strict=True)
            here.barh(heights, values, height=0.34, color=colour, label=label)
            here.set_xscale("log")
            least = min(here.get_xlim()[0], *values)
            here.set_xlim(left=10 ** np.floor(np.log10(least)))
    for place, sampler in enumerate(record.samplers.values()):
        if sampler.verdict == "failed":
            text = f"  failed: {', '.join(dict.fromkeys(sampler.failed))}"
            rate = sampler.ess_per_s_warm or sampler.ess_per_s_cold or here.get_xlim()[0]
            here.text(rate, place, text, va="center", fontsize=7, color=style.INK)
    title(here, labels.SPEED)
    here.set_xlabel(labels.RATE)
    return here


def _one_line_each(record: StoredSamplers, ax: Axes | None) -> Axes:
    """Return axes with one horizontal line per sampler, the first sampler on top."""
    names = [name.replace("_", " ") for name in record.samplers]
    here: Axes = panels(ax, 1, 1, height=0.55 + ROW * len(names))[0, 0]
    here.set_yticks(range(len(names)), names)
    here.set_ylim(len(names) - 0.4, -0.6)
    return here


def _scaled(ax: Axes) -> None:
    """Scale an axis linearly near zero and logarithmically beyond, with round ticks."""
    low, high = ax.get_xlim()
    reach = max(-low, high, NEAR)
    ax.set_xscale("symlog", linthresh=NEAR)
    ax.set_xlim(min(low, -NEAR), max(high, NEAR))
    steps = (0.1, 0.3) if reach < 1 else NEAR * 10.0 ** np.arange(np.log10(reach / NEAR) + 1)
    ticks = [sign * step for sign in (-1, 1) for step in steps]
    first, last = ax.get_xlim()
    shown = sorted({0.0, *(tick for tick in ticks if first <= tick <= last)})
    ax.set_xticks(shown, [f"{tick:g}" for tick in shown])
    ax.minorticks_off()


def rank_ecdfs(calibration: Calibration, ax: Any = None) -> Panels:
    """Draw the ECDF of every quantity's ranks minus i / (L + 1), with the 99 % envelope."""
    # A constant slope shows a bias; an S-shape shows a posterior that is too narrow or too wide.
    axes, stack = stacks(ax, len(calibration.names), 1, height=1.9, sharex=True, sharey=True)
    lower, upper = ecdf_envelope(len(calibration.ranks), calibration.num_ranks, LEVEL)
    even = np.arange(1, calibration.num_ranks + 1) / (calibration.num_ranks + 1)
    for (panel,), name, ranks in zip(stack, calibration.names, calibration.ranks.T, strict=True):
        ecdf = counts_below(ranks, calibration.num_ranks) / len(ranks)
        inside = bool(np.all((ecdf >= lower - 1e-12) & (ecdf <= upper + 1e-12)))
        label = labels.UNIFORM_RANKS
        shade(panel, even, lower - even, upper - even, style.SKY, label)
        colour, dashes = (style.BLUE, "-") if inside else (style.VERMILION, "--")
        label = "ranks, inside" if inside else "ranks, outside"
        panel.step(even, ecdf - even, where="mid", color=colour, ls=dashes, lw=1.2, label=label)
        called = symbol(name)
        if name.startswith("h3_"):
            called = f"|H₃| at {name.removeprefix('h3_').replace('Hz', ' Hz')}"
        p, covered = (
            number(calibration.p_ecdf[name], digits=2),
            f"{100 * calibration.coverage[name][0]:.1f}",
        )
        title(panel, f"{called}: p = {p}, holds {covered} %", 7.5)
    return finish(axes, ax, "rank / L [-]", "ECDF difference [-]")
