"""What records show without a model, as a figure."""

from typing import Any

import xarray as xr
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report import style
from jbw.report.result import node
from jbw.report.style import Panels, finish, log_y, panels, plain, title
from jbw.report.text import axis_label, length_unit

MOST_NAMED = 12  # tests in a legend
DOTS = {"ls": "", "marker": ".", "ms": 4}


def look_figure(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Is the structure nonlinear, before any model?

    Left, where a test is driven, the response of each about its resonance, displacement over
    source: that of a linear structure is one curve for all levels. Beside it frequency and damping
    of every record, each read as a linear oscillator's, against the motion: a linear structure's do
    not change with it. Each colour is a test, or the tests of one kind and level on several days.
    """
    look = node(tree, "look")
    if look is None or not look.children:
        raise DataError("The result has no readings of the records by themselves.")
    tests = [group.to_dataset() for group in look.children.values()]
    is_driven = any("response" in test for test in tests)
    widths = [1.2, 1, 1] if is_driven or ax is not None else [1, 1]
    axes = panels(ax, 1, len(widths), height=3.4, width_ratios=widths)
    factor, unit = length_unit(max(float(test["y"].max()) for test in tests))
    names = _families(tests)
    shown = list(dict.fromkeys(names))
    colours = [style.LEVELS[shown.index(name) % len(style.LEVELS)] for name in names]
    if len(widths) > 2:
        _responses(axes[0, 0], tests, colours)
    for only, name, scale, label in (
        (axes[0, -2], "frequency_hz", 1.0, "frequency [Hz]"),
        (axes[0, -1], "damping", 100.0, "damping ratio [%]"),
    ):
        for test, family, colour in zip(tests, names, colours, strict=True):
            called = plain(family) if shown.index(family) < MOST_NAMED else "_further"
            only.plot(factor * test["y"], scale * test[name], color=colour, label=called, **DOTS)
        only.set(ylabel=label, xlabel=f"motion [{unit}]")
        only.ticklabel_format(axis="y", useOffset=False)
    return finish(axes, ax)


def _families(tests: list[xr.Dataset]) -> list[str]:
    """What each test goes under: kind and level where several are alike, else its own name."""
    kind_and_level = [(test.attrs["kind"], test.attrs.get("level")) for test in tests]
    return [
        f"{kind}, {level:g}" if level is not None and kind_and_level.count((kind, level)) > 1
        else str(test.attrs["test"])
        for test, (kind, level) in zip(tests, kind_and_level, strict=True)
    ]  # fmt: skip


def _responses(only: Axes, tests: list[xr.Dataset], colours: list[str]) -> None:
    """Each test's response over its source."""
    driven = [pair for pair in zip(tests, colours, strict=True) if "response" in pair[0]]
    for test, colour in driven:
        only.plot(test["freq"], test["response"], color=colour, lw=0.8)
    units = {str(test["response"].attrs["units"]) for test, _ in driven}
    label = axis_label("displacement over source", units.pop() if len(units) == 1 else "")
    only.set(xlabel="frequency [Hz]", ylabel=label)
    title(only, "" if driven else "no driven test")
    if driven:
        log_y(only)
