"""What records show without a model, as a table and as a figure."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes

from jbw.report import style
from jbw.report.style import Panels, finish, log_y, panels, plain, title
from jbw.report.text import length_unit

MOST_NAMED = 12  # tests in a legend
DOTS = {"ls": "", "marker": ".", "ms": 4}


def look_figure(found: Any, ax: Any = None) -> Panels:
    """Draw the responses of all tests about their resonance, and frequency and damping by motion.

    `found` is what `jbw.study.look.look` returns.
    """
    axes = panels(ax, 1, 3, height=3.4, width_ratios=[1.2, 1, 1])
    names = [row["test"] for row in found.record["tests"]]
    colours = {name: style.LEVELS[i % len(style.LEVELS)] for i, name in enumerate(names)}
    largest = max((one.y for each in found.readings.values() for one in each), default=1e-3)
    factor, unit = length_unit(largest)
    _responses(axes[0, 0], found.responses, colours)
    for only, name, scale, label in (
        (axes[0, 1], "frequency_hz", 1.0, "frequency [Hz]"),
        (axes[0, 2], "damping", 100.0, "damping ratio [%]"),
    ):
        for i, test in enumerate(names):
            each = found.readings[test]
            x, values = (
                [factor * one.y for one in each],
                [scale * getattr(one, name) for one in each],
            )
            called = plain(test) if i < MOST_NAMED else "_further"
            only.plot(x, values, color=colours[test], label=called, **DOTS)
        only.set(ylabel=label, xlabel=f"motion [{unit}]")
        only.ticklabel_format(axis="y", useOffset=False)
    return finish(axes, ax)


def _responses(only: Axes, found: Mapping[str, Any], colours: Mapping[str, str]) -> None:
    """Each test's response over its source; that of a linear structure is one for all levels."""
    for name, one in found.items():
        look = {"color": colours[name], "lw": 0.8}
        only.plot(one.freq_hz, one.magnitude, **look)
    only.set(xlabel="frequency [Hz]", ylabel="displacement over source")
    title(only, "" if found else "no driven test")
    if found:
        log_y(only)
