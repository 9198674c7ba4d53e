"""How frequency and damping of the identified joint depend on the amplitude."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes

from jbw.report.result import branch, laws_of, quantiles, unit_of
from jbw.report.style import (
    BAND,
    INK,
    LEVELS,
    MODEL,
    SKY,
    SOFT,
    Panels,
    legend,
    panels,
    plain,
    shade,
)
from jbw.report.text import axis_label, number

GROUP = "verification/backbone"
PERCENT = 100.0
LITTLE = 0.2  # of the hysteretic force: below, only what slip changes can be seen
PREFIXES = ((1.0, "m"), (1e3, "mm"), (1e6, "µm"), (1e9, "nm"))


def length_unit(largest: float) -> tuple[float, str]:
    """Return factor and unit that write a length [m] with digits before the point."""
    return next((each for each in PREFIXES if largest * each[0] >= 1.0), PREFIXES[-1])


def backbone(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw natural frequency and equivalent damping against amplitude, with 99 % bands.

    Panels: frequency, damping (2 axes); grey beyond the amplitudes that were fitted.
    """
    found = branch(tree, GROUP, "frequency", "damping")
    axes = panels(ax, 1, 2, height=3.0)
    amplitude, end = np.asarray(found["amplitude"], float), float(found.attrs["y_fitted"])
    factor, unit = length_unit(end)
    for each, name, scale, label in (
        (axes[0, 0], "frequency", 1.0, axis_label("natural frequency", "Hz")),
        (axes[0, 1], "damping", PERCENT, axis_label("equivalent damping ratio", "%")),
    ):
        low, middle, high = scale * quantiles(found, name)
        shade(each, factor * amplitude, low, high, MODEL, BAND, alpha=0.4)
        each.plot(factor * amplitude, middle, color=MODEL, lw=1.1, label="median of the model")
        each.axvspan(
            factor * end, factor * amplitude[-1], color=SOFT, alpha=0.15, lw=0,
            label="beyond what was fitted",
        )  # fmt: skip
        each.set(xlim=(0.0, factor * amplitude[-1]), ylabel=label)
        each.set_xlabel(axis_label("amplitude of displacement", unit))
        each.ticklabel_format(axis="y", useOffset=False)
    legend(axes, ax)
    return axes


def steady_loops(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """Draw the hysteretic force of the identified joint along cycles of three amplitudes.

    Where slip changes it by less than a fifth, only the change is drawn.
    """
    axes = panels(ax, 1, 1, height=3.4)
    draw_loops(tree, axes[0, 0])
    legend(axes, ax)
    return axes[0, 0]


def draw_loops(tree: xr.DataTree, only: Axes) -> None:
    """Draw what `steady_loops` shows on given axes, without a legend."""
    found = branch(tree, GROUP, "loop_y", "loop_z", "loop_slip", "stuck")
    y = np.asarray(found["loop_y"].transpose("loop", "phase"), float)
    z, slip = (
        np.asarray(found[name].transpose("quantile", "loop", "phase"), float)[1]
        for name in ("loop_z", "loop_slip")
    )
    stiffness = "α" if laws_of(tree)[:1] == ("bouc_wen",) else "K"
    small = bool(np.nanmax(np.abs(slip)) < LITTLE * np.nanmax(np.abs(z)))
    factor, unit = length_unit(float(y.max()))
    if not small:
        stuck = float(found["stuck"].isel(quantile=1))
        _stuck(only, factor, stuck, float(y.max()), 1.15 * float(np.nanmax(z)), stiffness)
    for x, force, colour in zip(y, slip if small else z, LEVELS, strict=False):
        label = f"slipping, {number(factor * x.max())} {unit}"
        closed = np.append(force, force[0])
        only.plot(np.append(x, x[0]) * factor, closed, color=colour, lw=1.2, label=label)
    only.set_xlabel(axis_label("displacement y", unit))
    what = f"taken by slip, Z − {stiffness} y" if small else "hysteretic force Z"
    only.set_ylabel(axis_label(what, "N/kg"))


def _stuck(
    ax: Axes, factor: float, stiffness: float, reach: float, top: float, symbol: str
) -> None:
    """Draw Z = K y, the joint without slip, no higher than `top` [N/kg]."""
    end = min(reach, top / abs(stiffness)) if stiffness else reach
    line: Float[np.ndarray, " point"] = np.array([-end, end])
    label = f"stuck, Z = {symbol} y"
    ax.plot(factor * line, stiffness * line, color=SOFT, lw=1.0, ls="--", label=label)


def amplitude_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Draw frequency and damping against amplitude, read from the records and of the model.

    Panels: frequency, damping.
    """
    found = branch(
        tree,
        "verification/amplitude",
        "measured_amplitude",
        "measured_frequency",
        "measured_damping",
        "model_frequency",
        "model_damping",
    )
    axes = panels(ax, 1, 2, height=3.2)
    amplitude = np.asarray(found["amplitude"], float)
    fitted = np.asarray(found["fitted"], int) if "fitted" in found else None
    for each, name, factor, label in (
        (axes[0, 0], "frequency", 1.0, axis_label("frequency", "Hz")),
        (axes[0, 1], "damping", PERCENT, axis_label("damping ratio", "%")),
    ):
        low, middle, high = factor * quantiles(found, f"model_{name}")
        shade(each, amplitude, low, high, MODEL, BAND, alpha=0.4)
        each.plot(amplitude, middle, color=MODEL, lw=1.0)
        for i in range(found.sizes["record"]):
            known = fitted is None or bool(fitted[i])
            each.plot(
                np.asarray(found["measured_amplitude"][i], float),
                factor * np.asarray(found[f"measured_{name}"][i], float),
                ".",
                color=INK if known else SKY,
                ms=4,
                label="fitted records" if known else "held-out records",
            )
        unit = unit_of(found["amplitude"])
        response = plain(found["amplitude"].attrs.get("long_name", "response"))
        each.set_xlabel(axis_label(f"amplitude of {response}", unit))
        each.set_ylabel(label)
    legend(axes, ax)
    return axes
