"""Figures of measured records with predicted bands over time: sweeps, decays, multisines."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from jbw.report import style
from jbw.report.chosen import Part, selected
from jbw.report.messages import figures as labels
from jbw.report.result import arrays, fitted_text, frequency, level_text, quantiles, tests, unit_of
from jbw.report.style import INK, MODEL, Panels, band_label, finish, panels, shade, title
from jbw.report.text import axis_label, percent, plain
from jbw.results.attributes import PredictedTest

# number of intervals of a whole record whose extremes are drawn; it equals the figure's number of
# points in width
COLUMNS = 1000
FEWER = 300  # number of intervals of a whole record if three panels share the width
# largest number of drawn records; held-out records are drawn first, then fitted ones
MOST_DECAYS = 6
PERIODS, WIDE_PERIODS = 6, 8
SPECTRA = (
    ("measured", INK, "measured"),
    ("linear_error", style.SKY, labels.LINEAR_RESIDUAL),
    ("error", MODEL, "residual of the model"),
)
Samples = Float[np.ndarray, " time"]


def extremes(
    time: Samples, lower: Samples, upper: Samples, count: int | None = COLUMNS
) -> tuple[Float[np.ndarray, " bin"], Float[np.ndarray, " bin"], Float[np.ndarray, " bin"]]:
    """Return the extremes of a band in `count` intervals of time, to draw a long record.

    They are the minima of `lower` and the maxima of `upper`; with None nothing is thinned.
    """
    if count is None:
        return time, lower, upper
    size = max(1, -(-time.size // count))
    starts = np.arange(0, time.size, size)
    least, most = np.minimum.reduceat(lower, starts), np.maximum.reduceat(upper, starts)
    return time[np.minimum(starts + size // 2, time.size - 1)], least, most


def bands_of(test: xr.Dataset) -> Iterator[tuple[str, str, str]]:
    """Yield variable, colour and label of each of a test's bands, widest band first."""
    looks = (
        ("predictive_band", style.PREDICTIVE, band_label(test.attrs, noise=True)),
        ("measured_band", style.REPEATS, labels.REPEATS_BAND),
        ("model_band", MODEL, band_label(test.attrs)),
    )
    several = test.sizes.get("repeat", 2) > 1  # A single repeat has no band.
    return (look for look in looks if look[0] in test and (several or look[0] != "measured_band"))


def draw_record(
    ax: Axes,
    part: xr.Dataset,
    *,
    less: Samples | float = 0.0,
    count: int | None = None,
    measured: str = "_measured",
) -> None:
    """Draw a record and its bands after subtraction of a curve; on request draw only extremes.

    `less` is the subtracted curve; a record is thinned to extremes of `count` stretches.
    """
    (time,) = arrays(part, "time")
    for name, colour, label in bands_of(part):
        low, _, high = quantiles(part, name) - less
        shade(ax, *extremes(time, low, high, count), colour, label, alpha=0.5)
    if "measured" in part:
        values = arrays(part, "measured")[0] - less
        if count is None:
            ax.plot(time, values, color=INK, lw=0.8, label=measured)
        else:
            shade(ax, *extremes(time, values, values, count), INK, measured, alpha=0.6)
    ax.margins(x=0)
    if count is None:
        ax.locator_params(axis="x", nbins=4)


def draw_outline(ax: Axes, time: Samples, low: Samples, high: Samples, label: str) -> None:
    """Draw the lower and upper edges of a band."""
    ax.plot(time, low, color=MODEL, lw=0.9)
    ax.plot(time, high, color=MODEL, lw=0.9, label=label)


def response_label(test: xr.Dataset, name: str = "measured") -> str:
    """Return the axis label of a record's response."""
    return axis_label(plain(PredictedTest.of(test).response), unit_of(test[name]))


def short(name: str, most: int = 16) -> str:
    """Return a name shortened to fit a panel's title."""
    return name if len(name) <= most else name[: most - 1] + "…"


def length_of(part: Samples, periods: int) -> int:
    """Return the number of samples in some periods of a motion, estimated from zero crossings."""
    crossings = max(1, np.count_nonzero(np.diff(np.signbit(part))))
    return int(2 * periods * part.size / crossings)


def around(measured: Samples, half: int) -> slice:
    """Return a slice that extends `half` samples to either side of the largest response."""
    peak = int(np.nanargmax(np.abs(measured)))
    return slice(max(0, peak - half), min(measured.size, peak + half))


def resonance_slice(measured: Samples) -> slice:
    """Return a slice of about `PERIODS` periods around the largest response."""
    near = measured[around(measured, max(16, measured.size // 40))]
    return around(measured, length_of(near, PERIODS) // 2)


def verification_sweep(tree: xr.DataTree, ax: Any = None, part: Part = "chosen") -> Panels:
    """Does the model follow the sweeps, fitted and held out?

    From the left: the whole record, some periods around the largest response, and the same periods
    minus the model's median, at a scale that shows the bands. The parameter band contains the
    uncertainty of the model. The predictive band also contains the noise, and should contain 99 %
    of the measured points. Each title states whether the test was fitted or held out.

    Panels: one row of three per test (3 axes per test). Of more than three tests the figure shows
    the weakest, the strongest and a held-out one, or with `part` the `rest` or `all` of them.
    """
    bands = ("measured_band", "model_band")
    sweeps = selected(tests(tree, "verification/sweep", "measured", *bands), part)
    axes = panels(ax, len(sweeps), 3, height=0.7 + 1.75 * len(sweeps))
    for (full, zoom, rest), (name, test) in zip(axes, sweeps, strict=True):
        time, measured = arrays(test, "time", "measured")
        several = test.sizes.get("repeat", 2) > 1
        label = labels.REPEATS_MEAN if several else "measured"
        shade(full, *extremes(time, measured, measured), INK, label, alpha=0.75)
        # If the predictive band is withheld, the figure shows the band of the parameters alone.
        stated = "predictive_band" in test
        low, _, high = quantiles(test, "predictive_band" if stated else "model_band")
        reach = max(3, time.size // 96)
        shown = slice(None, None, max(1, reach // 4))
        edges = minimum_filter1d(low, reach)[shown], maximum_filter1d(high, reach)[shown]
        draw_outline(
            full, time[shown], *edges, f"outline of the {band_label(test.attrs, noise=stated)}"
        )
        full.margins(x=0)
        near = test.isel(time=resonance_slice(measured))
        draw_record(zoom, near)
        draw_record(rest, near, less=quantiles(near, "model_band")[1])
        full.set_ylabel(response_label(test))
        words = (short(plain(name)), level_text(test), fitted_text(test))
        title(full, ", ".join(filter(None, words)), size=8)
        title(zoom, "at the resonance", size=8)
        title(rest, "less the model's median", size=8)
    return finish(axes, ax, "time [s]")


def verification_decay(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Does the model follow the free decays, fitted and held out?

    From the left: the whole record in the band of the mode, some late periods, and the record minus
    the model's median. For a held-out record, the model uses only the first part, up to the dashed
    line, and predicts the rest; an error of frequency grows towards the end of the record.

    Panels: one row of three per record (3 axes per record), held-out records first, 6 at most.
    """
    decays = tests(tree, "verification/decay", "measured", "model_band")
    ordered = sorted(decays, key=lambda test: PredictedTest.of(test[1]).is_fitted)[:MOST_DECAYS]
    axes = panels(ax, len(ordered), 3, height=0.7 + 1.5 * len(ordered))
    for (full, zoom, rest), (name, test) in zip(axes, ordered, strict=True):
        look = {"count": FEWER, "measured": "measured, in the band"}
        low, middle, high = quantiles(test, "model_band")
        time, measured = arrays(test, "time", "measured")
        draw_record(full, test[["measured"]], **look)
        edges = extremes(time, low, high, FEWER)
        draw_outline(full, *edges, "outline of the model")
        # Periods at two thirds of the record are shown, where an error of frequency has
        # accumulated.
        late, size = 2 * time.size // 3, max(64, time.size // 20)
        near = measured[late : late + size]
        draw_record(zoom, test.isel(time=slice(late, late + length_of(near, PERIODS))))
        draw_record(rest, test, less=middle, **look)
        # The line marks the end of the part from which a held-out record's initial state was
        # estimated.
        seen = PredictedTest.of(test).seen_s
        for panel in (full, rest) if seen > 0 else ():
            panel.axvline(time[0] + seen, color=style.SOFT, lw=0.8, ls="--")
        full.set_ylabel(response_label(test))
        words = (short(plain(name)), fitted_text(test) or "fitted")
        title(full, ", ".join(words), size=8)
        title(zoom, "some late periods", size=8)
        title(rest, labels.model_residual(percent(test.attrs.get("nrmse"), 2)), size=8)
    return finish(axes, ax, "time [s]")


def verification_multisine(tree: xr.DataTree, ax: Any = None) -> Panels:
    """Is the residual of a multisine as small as its noise?

    Left, the response around its largest amplitude. Right, the amplitudes of the spectral lines of
    one period, and of the residuals of the model and of the best linear oscillator.

    Panels: for each test some periods around the largest response, and the spectra (2 axes per
        test).
    """
    multisines = tests(tree, "verification/multisine", "measured", "model_band", "error_spectrum")
    axes = panels(
        ax, len(multisines), 2, height=0.6 + 2.7 * len(multisines), width_ratios=[1, 1.35]
    )
    for (response, spectra), (name, test) in zip(axes, multisines, strict=True):
        (measured,) = arrays(test, "measured")
        largest = test.isel(time=around(measured, length_of(measured, WIDE_PERIODS) // 2))
        draw_record(response, largest[["measured", "model_band"]], measured="measured")
        response.set(xlabel="time [s]", ylabel=response_label(test))
        title(response, f"{short(plain(name))}, {fitted_text(test)}", size=8)
        # Spectra are drawn as points, since nothing lies between their lines.
        for kind, colour, label in SPECTRA:
            if f"{kind}_spectrum" in test:
                values = np.asarray(test[f"{kind}_spectrum"], float)
                look = {"color": colour, "ms": 2.5, "label": label, "rasterized": True}
                spectra.plot(frequency(test), values, ".", **look)
        spectra.set_yscale("log")
        spectra.margins(x=0)
        spectra.set_xlabel("frequency [Hz]")
        spectra.set_ylabel(axis_label("amplitude", unit_of(test["measured"])))
        errors = f"error {percent(test.attrs.get('nrmse'), 2)}"
        for other in ("linear", "cubic"):
            if f"nrmse_{other}" in test.attrs:
                errors += f", {other} {percent(test.attrs[f'nrmse_{other}'], 2)}"
        title(spectra, errors, size=8)
    return finish(axes, ax)
