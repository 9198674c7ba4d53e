"""The figures of predictions under other loads: response curves, notches, spectra, shocks."""

from typing import Any

import numpy as np
import xarray as xr

from jbw.report import style
from jbw.report.messages import loads as messages
from jbw.report.result import arrays
from jbw.report.style import Panels, draw_model, finish, log_y, panels, shade, title
from jbw.report.text import axis_label, plain
from jbw.results.attributes import StoredVariable

BAND = "99 % band"


def load_figure(name: str, dataset: xr.Dataset) -> Panels:
    """Draw a prediction of `Study.response_curve`, `notch`, `random`, `shock` or `resonance`."""
    draw = next(
        (draw for variable, draw in FIGURES.items() if variable in dataset.data_vars), _levels
    )
    axes = draw(dataset)
    title(axes.flat[0], plain(name))
    return axes


def _label(values: xr.DataArray) -> str:
    facts = StoredVariable.of(values)
    return axis_label(facts.long_name or str(values.name), facts.units)


def _curve(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 1, height=3.2)
    ax, (freq, up, down) = axes[0, 0], arrays(dataset, "freq", "upward", "downward")
    draw_model(ax, freq, up, "upward sweep, median", holds=BAND)
    if not np.allclose(up, down, rtol=1e-3, equal_nan=True):
        shade(ax, freq, down[0], down[2], style.SKY, messages.DOWNWARD)
        ax.plot(freq, down[1], color=style.BLUE, lw=1.0, ls="--", label="downward sweep, median")
    log_y(ax)
    return finish(axes, None, axis_label("frequency", "Hz"), _label(dataset["upward"]))


def _notch(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 1, height=3.2)
    ax, (freq, allowed, notched) = axes[0, 0], arrays(dataset, "freq", "allowed", "notched")
    draw_model(ax, freq, allowed, "allowed, median", holds=BAND)
    ax.plot(freq, notched[1], color=style.BLUE, label="notched level")
    log_y(ax)
    unit = StoredVariable.of(dataset["allowed"]).units
    return finish(axes, None, axis_label("frequency", "Hz"), axis_label("level", unit))


def _random(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 1, 1, height=3.2)
    ax = axes[0, 0]
    draw_model(ax, *arrays(dataset, "freq", "psd"), label="median", holds=BAND)
    ax.set_xscale("log")
    log_y(ax)
    return finish(axes, None, axis_label("frequency", "Hz"), _label(dataset["psd"]))


def _shock(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 2 if "srs" in dataset else 1, 1, height=3.2)
    draw_model(axes[0, 0], *arrays(dataset, "time", "response"), label="median", holds=BAND)
    axes[0, 0].set_ylabel(_label(dataset["response"]))
    axes[0, 0].set_xlabel(axis_label("time", "s"))
    if "srs" in dataset:
        draw_model(axes[1, 0], *arrays(dataset, "freq", "srs"), label="median", holds=BAND)
        axes[1, 0].set_xscale("log")
        log_y(axes[1, 0])
        axes[1, 0].set_xlabel(axis_label(messages.OF_SPECTRUM, "Hz"))
        axes[1, 0].set_ylabel(_label(dataset["srs"]))
    return finish(axes, None)


def _levels(dataset: xr.Dataset) -> Panels:
    axes = panels(None, 2, 1, height=4.2, sharex=True)
    level: Any = dataset["level"]
    for ax, name in zip(axes[:, 0], ("frequency", "peak"), strict=True):
        low, middle, high = dataset[name].values
        spread = [middle - low, high - middle]
        ax.errorbar(level.values, middle, spread, color=style.MODEL, marker="o", ms=3, capsize=3)
        ax.set_ylabel(_label(dataset[name]))
    return finish(axes, None, axis_label("level", StoredVariable.of(level).units))


FIGURES = {"upward": _curve, "allowed": _notch, "psd": _random, "response": _shock}
