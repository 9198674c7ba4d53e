"""Figures of frequency responses and response curves: linear regime and growth with level.

They include the third harmonic of a probing tone, and the kernel H3, measured and predicted.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from jbw.errors import DataError
from jbw.report import style
from jbw.report.chosen import Part, selected
from jbw.report.messages import figures as labels
from jbw.report.records import bands_of, short
from jbw.report.result import (
    arrays,
    branch,
    fitted_text,
    frequency,
    level_text,
    near_branch,
    quantiles,
    tests,
    unit_of,
    unwrapped_band,
    verified,
    wrap_band,
    wrap_degrees,
)
from jbw.report.style import (
    BLUE,
    INK,
    LEVELS,
    MODEL,
    SOFT,
    VERMILION,
    Panels,
    finish,
    log_y,
    panels,
    stacks,
    title,
)
from jbw.report.text import axis_label, number, plain
from jbw.results.attributes import PredictedTest, StoredVariable

# largest number of measured points on a curve, so that the model behind them stays visible
MOST_MARKS = 60
CURVE_LABELS = ("phase [°]", "off the median [%]")
Curve = Float[np.ndarray, " freq"]
Family = list[tuple[str, xr.Dataset]]
TURN = 2 * np.pi
SAMPLERS = {"paper": ("walk as published", VERMILION), "nuts": ("NUTS", BLUE)}


def resonance_window(freq: Curve, magnitude: Curve, depth: float = 0.08) -> tuple[float, float]:
    """Return the frequencies [Hz] around a peak with magnitudes above `depth` times the peak."""
    peak = int(np.nanargmax(magnitude))
    above = magnitude > depth * magnitude[peak]
    first = peak - int(np.argmin(above[peak::-1])) if not above[: peak + 1].all() else 0
    last = peak + int(np.argmin(above[peak:])) if not above[peak:].all() else freq.size - 1
    return float(freq[first]), float(freq[last])


def linear_frf(tree: xr.DataTree, ax: Any = None) -> Panels:
    """How does the structure respond with the joint fully stuck?

    Frequency response at the lowest level with the fit of spectral lines (Step 2), and the
    coherence. The fit should run through the points on both sides of the peak. A coherence below
    one at the peak shows leakage, or hysteresis at this level.

    Panels, in reading order: magnitude, phase, coherence, each in full and enlarged (6 axes).
    """
    needed = ("h_magnitude", "h_phase", "coherence", "fit_magnitude", "fit_phase")
    line = branch(tree, "steps/linear", *needed)
    freq, magnitude, (dim,) = frequency(line), *arrays(line, "h_magnitude"), line["coherence"].dims
    peak = freq[int(np.nanargmax(magnitude))]
    wide = (max(freq[0], peak / 6.0), min(freq[-1], 3.0 * peak))
    near = resonance_window(freq, magnitude, depth=0.25)
    axes = panels(ax, 3, 2, height=5.4, sharex="col", sharey="row", height_ratios=[2, 1.3, 1])
    for column, (low, high), marks, label in (
        (axes[:, 0], wide, {"lw": 0.7}, labels.REPEATS_POOLED),
        (axes[:, 1], near, {"marker": ".", "ms": 2.5, "lw": 0}, None),
    ):
        shown = (freq >= low) & (freq <= high)
        h, phase, coherence, h_fit, phase_fit = arrays(line.isel({dim: shown}), *needed)
        measured = {"color": INK, **marks}
        # Measured points lie on the fit; the fit is therefore drawn wider and behind them.
        fit = {"color": MODEL, "lw": 3.0, "alpha": 0.6, "zorder": 1.5}
        column[0].plot(freq[shown], h, label=label, **measured)
        column[0].plot(freq[shown], h_fit, label="line fit", **fit)
        column[1].plot(freq[shown], wrap_degrees(phase), **measured)
        column[1].plot(freq[shown], wrap_degrees(phase_fit), **fit)
        column[2].plot(freq[shown], coherence, **measured)
        column[2].set_xlim(low, high)
    axes[0, 0].set_yscale("log")
    axes[1, 0].set_yticks([-180, -90, 0])
    axes[2, 0].set_ylim(0.0, 1.05)
    title(axes[0, 0], "around the mode")
    title(axes[0, 1], "at the resonance")
    receptance = axis_label("receptance", unit_of(line["h_magnitude"]))
    return finish(axes, ax, "frequency [Hz]", (receptance, "phase [°]", "coherence [-]"))


def softening(tree: xr.DataTree, ax: Axes | None = None) -> Axes:
    """Does the resonance move with the level?

    Measured frequency responses: the mean of all tests of a kind and level, and the range of their
    repeats. The mark shows the largest spectral line. If the joint slips, the peak moves to lower
    frequencies and becomes flatter as the level rises.
    """
    frf_tests = tests(tree, "verification/frf", "measured_magnitude")
    families: dict[str, list[xr.Dataset]] = {}
    for _, test in frf_tests:
        families.setdefault(_level_and_kind(test), []).append(test)
    axes = panels(ax, 1, 1, height=3.3)
    only: Axes = axes[0, 0]
    curves = [_family_of(family) for family in families.values()]
    lows, highs = zip(*(resonance_window(freq, mean) for freq, (_, mean, _) in curves), strict=True)
    low, high = min(lows), max(highs)
    for (label, family), (freq, band), colour in zip(
        families.items(), curves, level_colours(len(families)), strict=True
    ):
        shown = (freq >= low) & (freq <= high)
        freq, (least, mean, most) = freq[shown], (curve[shown] for curve in band)
        peak = int(np.nanargmax(mean))
        number_of = f"{len(family)} tests, " if len(family) > 1 else ""
        label = f"{label}, {number_of}peak at {number(freq[peak], digits=4)} Hz"
        style.shade(only, freq, least, most, colour, "_range", alpha=0.25)
        only.plot(freq, mean, color=colour, lw=1.1, label=label)
        only.plot(freq[peak], mean[peak], "v", color=colour, ms=5)
    log_y(only)
    only.set_xlim(low, high)
    unit = unit_of(frf_tests[0][1]["measured_magnitude"])
    return finish(axes, ax, "frequency [Hz]", axis_label("receptance", unit))[0, 0]


def _level_and_kind(test: xr.Dataset) -> str:
    return f"{level_text(test)} {plain(test.attrs.get('kind', ''))}"


def _family_of(family: list[xr.Dataset]) -> tuple[Curve, Float[np.ndarray, "3 freq"]]:
    """Return the least, mean and largest frequency response of tests with one kind and level.

    They are stated at the frequencies of the first test [Hz].
    """
    freq = frequency(family[0])
    every = np.concatenate(
        [
            [np.interp(freq, frequency(test), magnitude, np.nan, np.nan) for magnitude in repeats]
            for test in family
            for repeats in arrays(test.transpose("repeat", ...), "measured_magnitude")
        ]
    )
    # At frequencies that another test lacks, only the first test is used.
    return freq, np.stack([np.nanmin(every, 0), np.nanmean(every, 0), np.nanmax(every, 0)])


def verification_frf(tree: xr.DataTree, ax: Any = None, part: Part = "chosen") -> Panels:
    """Does the model follow the frequency response at every level?

    Measured FRFs and the 99 % parameter band of the model. Each draw is simulated under the
    measured input, and its FRF is estimated in the same way. The lowest row shows how far the
    magnitude lies from the model's median. Each title states whether the test was fitted or held
    out.

    Panels: magnitude, phase and that distance for each test (3 axes per test, row by row). Of more
    than three tests the figure shows the weakest, the strongest and a held-out one, or with `part`
    the `rest` or `all` of them.
    """
    needed = ("measured_magnitude", "measured_phase", "model_magnitude", "model_phase")
    frf_tests = selected(tests(tree, "verification/frf", *needed), part)
    axes, stack = stacks(ax, len(frf_tests), 3, height=5.0, height_ratios=[2, 1, 1.2])
    for column, (_, test) in zip(stack, frf_tests, strict=True):
        _frf_column(column, test)
    unit = unit_of(frf_tests[0][1]["measured_magnitude"])
    labels = (axis_label("receptance", unit), "phase [°]", "off the median [%]")
    return finish(axes, ax, "frequency [Hz]", labels)


def _frf_column(column: Panels, test: xr.Dataset) -> None:
    """Draw one test around its resonance: magnitude, phase, and deviation from the median."""
    freq = frequency(test)
    mean_magnitude = np.asarray(test["measured_magnitude"].mean("repeat"), float)
    low, high = resonance_window(freq, mean_magnitude, depth=0.05)
    shown = (freq >= low) & (freq <= high)
    dim = next(name for name in test["model_magnitude"].dims if name != "quantile")
    freq, test = freq[shown], test.isel({dim: shown})
    names = ("measured_magnitude", "measured_phase")
    magnitude, phase = arrays(test.transpose("repeat", ...), *names)
    band = quantiles(test, "model_magnitude")
    turned = wrap_band(quantiles(test, "model_phase"))
    for panel, repeats, model in (
        (column[0], magnitude, band),
        (column[1], near_branch(phase, turned[1]), turned),
        (column[2], 100 * (magnitude / band[1] - 1), 100 * (band / band[1] - 1)),
    ):
        if len(repeats) > 1:
            reach = (repeats.min(axis=0), repeats.max(axis=0))
            style.shade(panel, freq, *reach, style.REPEATS, "range of all repeats", alpha=0.5)
        label = "measured" if len(repeats) == 1 else labels.REPEATS_MEAN
        panel.plot(freq, repeats.mean(axis=0), color=INK, lw=0.8, label=label)
        style.draw_model(panel, freq, model, ls="--", holds=style.band_label(test.attrs))
        panel.margins(x=0)
    log_y(column[0])
    column[1].set(ylim=(-230, 50), yticks=[-180, -90, 0])
    title(column[0], ", ".join(filter(None, (_level_and_kind(test), fitted_text(test)))))


def verification_curves(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model follow the response curves from level to level?

    Measured harmonics: filled circles for fitted tests and open triangles for held-out tests. The
    model has 99 % bands and its median as a line, which is dashed for held-out tests. If runs
    differ, the bands of held-out tests contain the variation between runs, as the legend states.
    Below, the distance of the measured curve from the median, relative to the peak of the curve.

    Panels: one column per measured quantity and harmonic (3 axes per column, row by row).
    """
    curve_tests = tests(tree, "verification/curve", "measured_magnitude", "model_magnitude")
    columns = curve_columns(curve_tests)
    axes, stack = stacks(ax, len(columns), 3, height=5.4, height_ratios=[2, 1.3, 1])
    palette = level_palette(curve_tests)
    for column, (suffix, family) in zip(stack, columns, strict=True):
        draw_curves(column, suffix, family, palette)
    return finish(axes, ax, "frequency [Hz]", ("", *CURVE_LABELS))


def draw_curves(column: Panels, suffix: str, family: Family, palette: Mapping[str, str]) -> None:
    """Draw one harmonic, given by its suffix, of all levels in the three panels of a column."""
    for _, test in family:
        _curve(column, test, suffix, palette[level_text(test)])
    test = family[0][1]
    values = test[f"measured_magnitude{suffix}"]
    what = plain(StoredVariable.of(values).long_name or "response")
    kind = plain(PredictedTest.of(test).kind)
    title(column[0], f"{what} at {suffix.removeprefix('_')}ω, {kind}".removesuffix(", "))
    log_y(column[0])
    column[0].set_ylabel(axis_label("amplitude", unit_of(values)))


def verification_groups(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model predict the tests of user-defined kinds?

    Means over the repeats of such a test, against its coordinate, with the model's 99 % bands.

    Panels: one per test.
    """
    group_tests = [(name, test) for _, name, test in verified(tree, "axis")]
    if not group_tests:
        raise DataError("The result has no test of a user-defined kind.")
    axes, stack = stacks(ax, len(group_tests), 1, height=2.5)
    for (only,), (name, test) in zip(stack, group_tests, strict=True):
        facts = PredictedTest.of(test)
        axis = facts.axis
        for _, group in test.groupby("group"):
            ordered = group.sortby(axis)
            for variable, colour, label in bands_of(ordered):
                low, _, high = quantiles(ordered, variable)
                style.shade(only, ordered[axis], low, high, colour, label, alpha=0.5)
            if "measured" in ordered:
                look = {"color": INK, "ms": 3, "mfc": "none", "label": "measured"}
                only.plot(ordered[axis], ordered["measured"], "o", **look)
        level = "" if facts.level is None else level_text(test)
        words = (short(plain(name), 32), level, fitted_text(test))
        title(only, ", ".join(filter(None, words)), size=8)
        only.locator_params(axis="x", nbins=5)
        only.set_xlabel(axis_label(plain(axis), unit_of(test[axis])))
        quantity = plain(facts.quantity or (facts.kind or "response").replace("_", " "))
        only.set_ylabel(axis_label(quantity, unit_of(test["model_band"])))
    return finish(axes, ax)


def curve_columns(tests: Family) -> list[tuple[str, Family]]:
    """Group tests by quantity, kind and harmonic, for the columns of a figure."""
    groups: dict[tuple[str, str, str], Family] = {}
    for name, test in tests:
        for suffix in ("", "_3"):
            if f"measured_magnitude{suffix}" in test:
                facts = PredictedTest.of(test)
                key = suffix, str(facts.quantity), facts.kind
                groups.setdefault(key, []).append((name, test))
    return [(key[0], family) for key, family in sorted(groups.items())]


def level_palette(tests: Family) -> dict[str, str]:
    """Return a colour for every level of the tests, by the level's text."""
    levels = {level_text(test): PredictedTest.of(test).level or 0.0 for _, test in tests}
    ordered = sorted(levels, key=lambda text: levels[text])
    return dict(zip(ordered, level_colours(len(ordered)), strict=True))


def level_colours(count: int) -> list[str]:
    """Return distinct colours for few levels, or shades from dark to light for many."""
    if count <= len(LEVELS):
        return list(LEVELS[:count])
    return [to_hex(colormaps["viridis"](x)) for x in np.linspace(0.25, 0.85, count)]


def _curve(column: Panels, test: xr.Dataset, suffix: str, colour: str) -> None:
    freq = frequency(test)
    measured = np.asarray(test[f"measured_magnitude{suffix}"], float)
    phase = np.asarray(test[f"measured_phase{suffix}"], float)
    model = quantiles(test, f"model_magnitude{suffix}")
    turned = unwrapped_band(quantiles(test, f"model_phase{suffix}"))
    off = np.abs(measured * np.exp(1j * phase) - model[1] * np.exp(1j * np.radians(turned[1])))
    fitted = PredictedTest.of(test).is_fitted
    label = ", ".join(filter(None, (level_text(test), fitted_text(test))))
    look = {"color": colour, "lw": 0, "ms": 3.6, "marker": "o" if fitted else "^", "mew": 0.8}
    look |= {"mfc": colour if fitted else "none", "markevery": -(-freq.size // MOST_MARKS)}
    for ax, points, band in (
        (column[0], measured, model),
        (column[1], near_branch(phase, turned[1]), turned),
    ):
        low, _, high = band
        style.shade(ax, freq, low, high, colour, style.band_label(test.attrs), alpha=0.18)
        ax.plot(freq, band[1], color=colour, lw=1.0, ls="-" if fitted else "--")
        ax.plot(freq, points, label=label, **look)
    column[2].plot(freq, 100.0 * off / np.nanmax(measured), color=colour, lw=1.0, label=label)
    for ax in column:
        ax.margins(x=0.02)


def stabilisation_diagram(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Which modes does the band contain?

    Above, poles of rational functions of rising order; a pole is filled if the previous order has
    it too. Below, the measured frequency response with the fit of the modes. A mode is a column of
    filled points that reaches the top. Poles that noise causes move from order to order.

    Panels: the diagram, and the magnitude (2 axes).
    """
    needed = ("omega", "zeta", "pole_omega", "pole_order", "h_magnitude", "fit_magnitude")
    modes = branch(tree, "modes", *needed)
    omega_n, zeta_n, poles, order, h, h_fit = arrays(modes, *needed)
    axes = panels(ax, 2, 1, height=4.6, sharex=True, height_ratios=[1.2, 1])
    upper, lower = axes[:, 0]
    freq = poles / TURN
    stable = np.asarray(modes["pole_is_stable"], bool)
    look = {"lw": 0, "marker": "o", "ms": 3.4, "mew": 0.7}
    upper.plot(freq[~stable], order[~stable], color=SOFT, mfc="none", label="pole", **look)
    upper.plot(freq[stable], order[stable], color=INK, label="pole that stays", **look)
    lower.plot(frequency(modes), h, color=INK, lw=0.9, label="measured")
    fit = {"color": MODEL, "lw": 3.0, "alpha": 0.6, "zorder": 1.5, "label": "fit of the modes"}
    lower.plot(frequency(modes), h_fit, **fit)
    for natural_frequency in omega_n / TURN:
        for panel in (upper, lower):
            panel.axvline(natural_frequency, color=MODEL, lw=0.8, ls=":")
    log_y(lower)
    modes_fitted = (
        f"{number(omega / TURN, digits=4)} Hz ({number(100 * zeta, digits=2)} %)"
        for omega, zeta in zip(omega_n, zeta_n, strict=True)
    )
    title(upper, f"modes fitted: {', '.join(modes_fitted)}")
    receptance = axis_label("receptance", unit_of(modes["h_magnitude"]))
    return finish(axes, ax, "frequency [Hz]", ("order [-]", receptance))


def harmonic_spectrum(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the response to a tone contain a third harmonic?

    Left, the spectrum of the response to one probing tone, with circles at ω and 3ω; the third
    harmonic must exceed the noise. Right, the third-order kernel from every repeat. The likelihood
    of Step 3 takes the scatter of these points as noise.

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
    tone = PredictedTest.of(spectrum).tone_hz or freq[int(np.nanargmax(amplitude[1:])) + 1]
    shown = (freq > 0.2 * tone) & (freq < 6.0 * tone)
    ax.plot(freq[shown], amplitude[shown], color=INK, lw=0.7)
    ax.margins(y=0.12)
    for order, text, colour in ((1, "ω", BLUE), (3, "3ω", VERMILION)):
        at = int(np.argmin(np.abs(freq - order * tone)))
        point = (freq[at], amplitude[at])
        ax.plot(*point, "o", ms=5, mfc="none", color=colour, mew=1.3)
        look: Any = {"xytext": (5, 1), "textcoords": "offset points", "fontsize": 9}
        ax.annotate(text, point, color=colour, **look)
    unit = unit_of(spectrum["amplitude"])
    ax.set(yscale="log", xlabel="frequency [Hz]", ylabel=axis_label("response amplitude", unit))
    title(ax, f"tone of {tone:g} Hz")


def _measured_kernel(pair: Panels, kernel: xr.Dataset, label: str) -> None:
    magnitude, phase = (kernel[n].transpose("repeat", ...)
                        for n in ("measured_magnitude", "measured_phase"))  # fmt: skip
    look = {"color": INK, "marker": "o", "mfc": "none", "mew": 0.6, "ms": 3.2, "lw": 0}
    for panel, values in zip(pair, (magnitude, wrap_degrees(phase)), strict=True):
        panel.plot(frequency(kernel), np.asarray(values).T, **look)[0].set_label(label)
    log_y(pair[0])
    pair[0].set_ylabel(axis_label("|H₃|", unit_of(magnitude)))
    pair[1].set_ylabel("arg H₃ [°]")


def kernel_bands(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model reproduce the measured kernel?

    Above, measured H₃ of every repeat, and the 99 % parameter bands of each sampler. Below, both
    relative to the median of one sampler, which shows small differences. The bands contain only the
    uncertainty of the parameters and no noise. Single repeats may therefore lie outside, but their
    mean should lie inside.

    Panels: magnitude and phase; below, both relative to the median of NUTS (4 axes). The bands are
    drawn side by side at the probing frequencies only, since nothing was measured between them.
    """
    kernel = branch(tree, "verification/h3", "measured_magnitude", "measured_phase")
    present = [name for name in SAMPLERS if f"{name}_magnitude" in kernel]
    if not present:
        raise DataError(
            "The group /verification/h3 of the result must contain a band of the model, but does "
            "not.",
            remedy="Identify the campaign again: jbw identify CAMPAIGN.toml.",
        )
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
    """Return kernel magnitudes divided by a sampler's median, and phases minus that median."""
    middle = kernel.isel(quantile=1, drop=True)
    magnitude, phase = middle[f"{name}_magnitude"], middle[f"{name}_phase"]
    relative = {}
    for key, values in kernel.data_vars.items():
        if str(key).endswith("magnitude"):
            relative[key] = values / magnitude
        elif str(key).endswith("phase"):
            relative[key] = (values - phase + np.pi) % (2.0 * np.pi) - np.pi
    return kernel.assign(relative)
