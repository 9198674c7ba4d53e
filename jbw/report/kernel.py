"""The third harmonic of a probing tone, and the kernel H3 measured and predicted."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jbw.errors import DataError
from jbw.report import style
from jbw.report.messages import figures as labels
from jbw.report.result import branch, frequency, quantiles, unit_of, wrap_band, wrap_degrees
from jbw.report.style import BLUE, INK, VERMILLION, Panels, finish, log_y, panels, title
from jbw.report.text import axis_label

SAMPLERS = {"paper": ("walk as published", VERMILLION), "nuts": ("NUTS", BLUE)}


def harmonic_spectrum(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does a tone come back with a third harmonic?

    Left, the response spectrum to one probing tone, ω and 3ω circled; the third harmonic has to
    stand clear of the floor. Right, the third-order kernel from every repeat: the scatter of the
    points is what the likelihood of Step 3 sees.

    Panels: amplitude spectrum, magnitude of H3, phase of H3 (3 axes).
    """
    spectrum = branch(tree, "verification/spectrum", "amplitude")
    kernel = branch(tree, "verification/h3", "measured_magnitude", "measured_phase")
    axes = panels(ax, 1, 3, height=2.7, width_ratios=[1.6, 1, 1])
    _measured_kernel(axes[0, 1:], kernel, label="one repeat")
    for panel in axes[0, 1:]:
        panel.margins(x=0.12, y=0.12)
    finish(axes, ax, "probing frequency [Hz]")
    _spectrum(axes[0, 0], spectrum)
    return axes


def _spectrum(ax: Axes, spectrum: xr.Dataset) -> None:
    freq, amplitude = frequency(spectrum), np.asarray(spectrum["amplitude"], float)
    tone = float(spectrum.attrs.get("tone_hz", freq[int(np.nanargmax(amplitude[1:])) + 1]))
    shown = (freq > 0.2 * tone) & (freq < 6.0 * tone)
    ax.plot(freq[shown], amplitude[shown], color=INK, lw=0.7)
    ax.margins(y=0.12)
    for order, text, colour in ((1, "ω", BLUE), (3, "3ω", VERMILLION)):
        at = int(np.argmin(np.abs(freq - order * tone)))
        point = (freq[at], amplitude[at])
        ax.plot(*point, "o", ms=5, mfc="none", color=colour, mew=1.3)
        look: Any = {"xytext": (5, 1), "textcoords": "offset points", "fontsize": 9}
        ax.annotate(text, point, color=colour, **look)
    unit = unit_of(spectrum["amplitude"])
    ax.set(yscale="log", xlabel="frequency [Hz]", ylabel=axis_label("response amplitude", unit))
    title(ax, f"tone of {tone:g} Hz")


def _measured_kernel(pair: Panels, kernel: xr.Dataset, label: str) -> None:
    magnitude = kernel["measured_magnitude"].transpose("repeat", ...)
    phase = wrap_degrees(kernel["measured_phase"].transpose("repeat", ...))
    look = {"color": INK, "marker": "o", "mfc": "none", "mew": 0.6, "ms": 3.2, "lw": 0}
    for panel, values in zip(pair, (magnitude, phase), strict=True):
        panel.plot(frequency(kernel), np.asarray(values).T, **look)[0].set_label(label)
    log_y(pair[0])
    pair[0].set_ylabel(axis_label("|H₃|", unit_of(magnitude)))
    pair[1].set_ylabel("arg H₃ [°]")


def kernel_bands(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model reproduce the measured kernel?

    Measured H₃ of every repeat beside the 99 % parameter bands of each sampler; below, both against
    a sampler's median, where small differences show. The bands carry the parameters' uncertainty
    only, no noise: single repeats scatter beyond them, but their middle should not lie outside.

    Panels: magnitude, phase; below, both against the median of NUTS (4 axes). The bands are drawn
    at the probing frequencies only, side by side, since nothing was measured between them.
    """
    kernel = branch(tree, "verification/h3", "measured_magnitude", "measured_phase")
    present = [name for name in SAMPLERS if f"{name}_magnitude" in kernel]
    if not present:
        raise DataError("The group /verification/h3 holds no band of the model.")
    axes = panels(ax, 2, 2, height=4.6, sharex=True)
    freq = frequency(kernel)
    step = np.min(np.diff(np.sort(freq))) if freq.size > 1 else 1.0
    for row, shown in zip(axes, (kernel, relative_to_median(kernel, present[-1])), strict=True):
        _measured_kernel(row, shown, label="measured, each repeat")
        for name, side in zip(present, (0.22, -0.22), strict=False):
            called, colour = SAMPLERS[name]
            magnitude = quantiles(shown, f"{name}_magnitude")
            phase = wrap_band(quantiles(shown, f"{name}_phase"))
            for panel, (low, middle, high) in zip(row, (magnitude, phase), strict=True):
                look = {"lw": 4, "alpha": 0.45, "label": f"{style.BAND}, {called}"}
                panel.vlines(freq + side * step, low, high, color=colour, **look)
                panel.plot(freq + side * step, middle, "_", color=INK, ms=6, mew=0.9)
        for panel in row:
            panel.margins(x=0.08, y=0.12)
    axes[1, 0].set(yscale="linear", ylabel="|H₃| over median [-]")
    axes[1, 1].set_ylabel(labels.PHASE_LESS_MEDIAN)
    return finish(axes, ax, "probing frequency [Hz]")


def relative_to_median(kernel: xr.Dataset, name: str) -> xr.Dataset:
    """Return magnitudes over, and phases within half a turn of, the median of a sampler."""
    middle = kernel.isel(quantile=1, drop=True)
    magnitude, phase = middle[f"{name}_magnitude"], middle[f"{name}_phase"]
    relative = {}
    for key, values in kernel.data_vars.items():
        if str(key).endswith("magnitude"):
            relative[key] = values / magnitude
        elif str(key).endswith("phase"):
            relative[key] = (values - phase + np.pi) % (2.0 * np.pi) - np.pi
    return kernel.assign(relative)
