"""Figures of records without a model: each channel over time and frequency, and all tests."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from scipy.signal import ShortTimeFFT, welch
from scipy.signal.windows import hann

from jbw.errors import DataError
from jbw.measurement.records import Record
from jbw.report import style
from jbw.report.records import Samples, extremes
from jbw.report.result import node
from jbw.report.style import Panels, finish, log_y, panels, shade, title
from jbw.report.text import axis_label, length_unit, plain, unit_text
from jbw.results.attributes import PredictedTest, StoredVariable

MOST_NAMED = 12  # largest number of tests that a legend names
DOTS = {"ls": "", "marker": ".", "ms": 4}
COLUMNS = 400  # number of columns of a spectrogram, and of a channel's drawn extremes
LONGEST, SHORTEST = 1024, 32  # largest and smallest length of a spectrogram's window [samples]
WINDOWS = 24  # number of adjacent windows of a spectrogram in a short record
RANGE = 90.0  # range of a spectrogram below its largest value [dB]
CURVE = "frequency"  # channel of a record that is a measured response curve
COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.INK)


def look_figure(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Do the records alone show that the structure is nonlinear?

    Left, for driven tests: displacement divided by the source, around the resonance. For a linear
    structure the curves of all levels coincide. Right, frequency and damping of every record, from
    the fit of a linear oscillator, against the motion. For a linear structure they do not change
    with the motion. Each colour is a test, or the tests of one kind and level on several days.
    """
    look = node(tree, "look")
    if look is None or not look.children:
        raise DataError("The result has no frequency and damping of single records.")
    tests = [group.to_dataset() for group in look.children.values()]
    is_driven = any("response" in test for test in tests)
    widths = [1.2, 1, 1] if is_driven or ax is not None else [1, 1]
    axes = panels(ax, 1, len(widths), height=3.4, width_ratios=widths)
    motions = [test["y"] for test in tests]
    factor, unit = length_unit(max(float(y.max()) for y in motions))
    names = _families(tests)
    shown = list(dict.fromkeys(names))
    colours = [style.LEVELS[shown.index(name) % len(style.LEVELS)] for name in names]
    if len(widths) > 2:
        _responses(axes[0, 0], tests, colours)
    for only, name, scale, label in (
        (axes[0, -2], "frequency_hz", 1.0, "frequency [Hz]"),
        (axes[0, -1], "damping", 100.0, "damping ratio [%]"),
    ):
        for test, y, family, colour in zip(tests, motions, names, colours, strict=True):
            called = plain(family) if shown.index(family) < MOST_NAMED else "_further"
            only.plot(factor * y, scale * test[name], color=colour, label=called, **DOTS)
        only.set(ylabel=label, xlabel=f"motion [{unit}]")
        only.ticklabel_format(axis="y", useOffset=False)
    return finish(axes, ax)


def _families(tests: list[xr.Dataset]) -> list[str]:
    """Return each test's label: kind and level if several tests share them, otherwise its name."""
    facts = [PredictedTest.of(test) for test in tests]
    kind_and_level = [(test.kind, test.level) for test in facts]
    return [
        f"{kind}, {level:g}" if level is not None and kind_and_level.count((kind, level)) > 1
        else test.test
        for test, (kind, level) in zip(facts, kind_and_level, strict=True)
    ]  # fmt: skip


def _responses(only: Axes, tests: list[xr.Dataset], colours: list[str]) -> None:
    """Plot each driven test's response divided by its source."""
    driven = [pair for pair in zip(tests, colours, strict=True) if "response" in pair[0]]
    for test, colour in driven:
        only.plot(test["freq"], test["response"], color=colour, lw=0.8)
    units = {StoredVariable.of(test["response"]).units for test, _ in driven}
    label = axis_label("displacement over source", units.pop() if len(units) == 1 else "")
    only.set(xlabel="frequency [Hz]", ylabel=label)
    title(only, "" if driven else "no driven test")
    if driven:
        log_y(only)


def channel_overview(record: Record, ax: Any = None) -> Panels:
    """Draw every channel in one row: over time, as power spectral density, and as spectrogram."""
    if CURVE in record.channels:
        return _curve(record, ax)
    names = list(record.channels)
    axes = panels(ax, len(names), 3, height=0.5 + 1.9 * len(names), width_ratios=[1.1, 1, 1.3])
    for row, name, colour in zip(axes, names, COLOURS * len(names), strict=False):
        time_history(record, name, row[0], colour=colour)
        power_spectrum(record, name, row[1], colour=colour)
        spectrogram(record, name, row[2])
    what = f"{record.name}: {record.num_samples} samples at {record.fs:.7g} Hz"
    title(axes[0, 0], plain(what.removeprefix(": ")), size=8)
    return axes


def time_history(
    record: Record, channel: str, ax: Axes | None = None, *, colour: str = style.BLUE
) -> Axes:
    """Draw a channel over time, as an envelope of extremes if it is long; gaps stay empty."""
    only: Axes = panels(ax, 1, 1, height=2.4)[0, 0]
    samples = np.asarray(record.channels[channel], float)
    time = np.arange(samples.size) / record.fs
    if samples.size > 2 * COLUMNS:
        # The edge is drawn, because the extremes of a slow motion are so close that the area alone
        # is invisible.
        ends = extremes(time, samples, samples, COLUMNS)
        shade(only, *ends, colour, channel, alpha=0.8, lw=0.6)
    else:
        only.plot(time, samples, color=colour, lw=0.8, label=channel)
    only.set(xlabel="time [s]", ylabel=_label(record, channel))
    only.margins(x=0)
    return only


def power_spectrum(
    record: Record, channel: str, ax: Axes | None = None, *, colour: str = style.BLUE
) -> Axes:
    """Draw a channel's power spectral density, by Welch's estimate with Hann windows."""
    only: Axes = panels(ax, 1, 1, height=2.4)[0, 0]
    samples = _complete(record, channel)
    # Windows of an eighth of the record give narrow lines and some averaging.
    freq, power = welch(samples, record.fs, nperseg=max(8, samples.size // 8))
    only.loglog(freq[1:], np.maximum(power[1:], np.finfo(float).tiny), color=colour, lw=0.8)
    only.set(xlabel="frequency [Hz]", ylabel=f"density [{_density_unit(record, channel)}]")
    only.margins(x=0)
    return only


def spectrogram(record: Record, channel: str, ax: Axes | None = None) -> Axes:
    """Draw a channel's spectrogram, with a range of at most 90 dB below its largest value."""
    only: Axes = panels(ax, 1, 1, height=3.0)[0, 0]
    samples = _complete(record, channel)
    wished = 2 ** int(np.log2(max(samples.size / WINDOWS, 1)))
    size = min(max(wished, SHORTEST), LONGEST, samples.size)
    hop = max(1, size // 4, -(-samples.size // COLUMNS))
    transform = ShortTimeFFT(hann(size, sym=False), hop, record.fs, scale_to="psd")
    time = transform.t(samples.size)
    inside = (time >= 0) & (time <= samples.size / record.fs)
    power = transform.spectrogram(samples)[1:, inside]
    level = 10.0 * np.log10(np.maximum(power, np.finfo(float).tiny))
    top = float(level.max())
    image = only.pcolormesh(
        time[inside], transform.f[1:], level, shading="nearest", cmap="viridis", rasterized=True,
        vmin=max(top - RANGE, float(level.min())), vmax=top,
    )  # fmt: skip
    only.set(yscale="log", xlabel="time [s]", ylabel="frequency [Hz]")
    only.grid(False)
    bar = only.figure.colorbar(image, ax=only, pad=0.02)
    bar.set_label(f"dB re {_density_unit(record, channel)}", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    return only


def _complete(record: Record, channel: str) -> Samples:
    """Return a channel minus its mean, with zero in place of missing samples."""
    samples = np.asarray(record.channels[channel], float)
    is_finite = np.isfinite(samples)
    return np.where(
        is_finite, samples - (samples[is_finite].mean() if is_finite.any() else 0.0), 0.0
    )


def _curve(record: Record, ax: Any) -> Panels:
    names = [name for name in record.channels if name != CURVE]
    axes = panels(ax, len(names), 1, height=0.5 + 1.7 * len(names), sharex=True)
    freq = np.asarray(record.channels[CURVE], float)
    for only, name, colour in zip(axes[:, 0], names, COLOURS * len(names), strict=False):
        only.plot(freq, record.channels[name], ".-", color=colour, lw=0.8, ms=3)
        only.set_ylabel(_label(record, name))
    title(axes[0, 0], plain(record.name), size=8)
    return finish(axes, ax, "frequency [Hz]")


def _label(record: Record, channel: str) -> str:
    return axis_label(plain(channel.replace("_", " ")), record.units.get(channel, ""))


def _density_unit(record: Record, channel: str) -> str:
    unit = unit_text(record.units.get(channel, "")) or "1"
    return f"{unit}²/Hz" if unit.isalnum() else f"({unit})²/Hz"


def save_overviews(records: Iterable[tuple[str, Record]], folder: Path) -> list[Path]:
    """Save one overview per test as PNG, from names of tests with one record each; return paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for place, (name, record) in enumerate(records, start=1):
        path = folder / f"{place:02d}_{re.sub(r'[^\w.-]+', '_', name)}.png"
        try:
            channel_overview(record)[0, 0].figure.savefig(path, dpi=110, facecolor="white")
        except OSError:
            path.unlink(missing_ok=True)  # A full disk left an incomplete file.
            raise
        written.append(path)
    return written
