"""The figure of a watch: frequency and damping at one amplitude, record by record."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import t as student

from jbw.report.style import (
    BLUE,
    INK,
    SKY,
    VERMILLION,
    Panels,
    finish,
    panels,
    shade,
    title,
)

LEVEL = 0.99  # of the band in which a further reading of an unchanged joint lies


def watch_figure(
    settings: Mapping[str, Any], readings: Sequence[Mapping[str, Any]], ax: Any = None
) -> Panels:
    """Draw the readings at the first amplitude, the band of the references, and every alarm."""
    axes = panels(ax, 2, 1, height=4.6)
    values = np.array([one["values"][:2] for one in readings]).reshape(-1, 2)
    values[:, 1] = 100 * np.exp(values[:, 1])
    number = np.arange(1, len(values) + 1)
    num = min(settings["reference"], len(values))
    alarms = np.array([bool(one.get("alarm")) for one in readings], bool)
    at = f"{settings['amplitudes'][0]:g} {settings['unit']}"
    for column, (each, name) in enumerate(
        zip(axes[:, 0], ("frequency [Hz]", "damping [%]"), strict=True)
    ):
        here = values[:, column]
        if num > 1:
            middle, sd = here[:num].mean(), here[:num].std(ddof=1)
            reach = student.ppf((1 + LEVEL) / 2, num - 1) * sd * np.sqrt(1 + 1 / num)
            ends = np.array([0.5, len(values) + 0.5])
            low, high = np.full(2, middle - reach), np.full(2, middle + reach)
            shade(each, ends, low, high, BLUE, "99 % of an unchanged joint", alpha=0.15)
        each.plot(number[:num], here[:num], "o", color=SKY, ms=4, label="reference")
        each.plot(number[num:], here[num:], "o", color=INK, ms=4, label="watched")
        each.plot(
            number[alarms], here[alarms], "s", color=VERMILLION, ms=7, mfc="none", label="alarm"
        )
        each.set_ylabel(name)
        each.ticklabel_format(axis="y", useOffset=False)
        title(each, f"{name.partition(' [')[0]} at {at}")
    return finish(axes, ax, below="record")
