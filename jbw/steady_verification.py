"""Verification in time on steady motion: forced loops and periods of a multisine."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from jbw.measurement.records import Test
from jbw.observables import loops, response
from jbw.observables.spectral_lines import in_band, noise_share
from jbw.prediction import (
    QUANTILES,
    UNITS,
    Draws,
    band,
    beside,
    carry,
    errors,
    gaussian_band,
    noise_of_mean,
)

MOST_POINTS = 2048  # of a loop, kept for drawing


def forced_loop_verification(
    test: Test, draws: Draws, references: Mapping[str, Mapping[str, float]] | None = None
) -> xr.Dataset:
    r"""Restoring force along a prescribed displacement beside that of the model.

    The energy lost is the work of the force over the record after `settle`,

    $$W = \int F\,\mathrm{d}y$$

    Args:
        test: Test of kind loop.
        draws: Parameters of the joint and gain.
        references: Springs to compare with, by name.

    Returns:
        Forces over (point) and (quantile, point), work over (quantile); attributes as of
        `jbw.prediction.errors`.
    """
    data = loops.reduce([test])
    every, others = beside(lambda some: carry(loops.predict, some, data), draws, references or {})
    return compare_loop(test, data, every, noise_of_mean(data.repeats), others)


def compare_loop(
    test: Test,
    data: loops.Loops,
    every: Float[np.ndarray, "draw 1 time"],
    noise_std: float | None,
    others: Mapping[str, Float[np.ndarray, "1 time"]] | None = None,
) -> xr.Dataset:
    """A forced loop beside predictions of it, as of `forced_loop_verification`.

    Args:
        test: Test of kind loop.
        data: The same reduced.
        every: Force by every draw [N].
        noise_std: Noise of the mean, where it is known [N].
        others: Forces of springs, by name.
    """
    counted = np.asarray(data.counted[0]) > 0
    y, measured = (np.asarray(x[0])[counted] for x in (data.displacement, data.mean))
    model = every[:, 0, counted]
    others = {name: one[0, counted] for name, one in (others or {}).items()}
    shown = slice(None, None, -(-len(y) // MOST_POINTS))
    newton, joule, metre = {"units": "N"}, {"units": "J"}, {"units": "m"}
    variables = {
        "displacement": ("point", y[shown], metre),
        "measured_force": ("point", measured[shown], newton),
        "model_force": (("quantile", "point"), band(model)[:, shown], newton),
        "measured_work": ((), trapezoid(measured, y), joule),
        "model_work": ("quantile", band(trapezoid(model, y, axis=-1)), joule),
    }
    if noise_std is not None:
        predictive = gaussian_band(model, noise_std)[:, shown]
        variables["predictive_force"] = (("quantile", "point"), predictive, newton)
    variables |= {f"{n}_force": ("point", one[shown], newton) for n, one in others.items()}
    return xr.Dataset(
        variables,
        {"quantile": list(QUANTILES)},
        {
            "level": test.level,
            "level_unit": "m",
            "kind": test.kind,
            **errors(measured, model, others, noise_std),
        },
    )


def multisine_verification(
    test: Test,
    draws: Draws,
    references: Mapping[str, Mapping[str, float]] | None = None,
    *,
    band_hz: tuple[float, float] | None = None,
    substeps: int = 2,
) -> xr.Dataset:
    """Steady response over one period of a multisine beside that of the model.

    Args:
        test: Multisine whose records are single periods.
        draws: Parameters of the joint and gain.
        references: Oscillators to compare with, by name.
        band_hz: Band of the spectra [Hz]; all of them when None.
        substeps: Steps of the solver between samples.

    Returns:
        Response over (time) and (quantile, time); amplitude spectra over (freq) of the measured
        response, the model's median, the error it leaves, and the other oscillators' errors;
        attributes as of `jbw.prediction.errors`.
    """
    data = response.reduce([test], substeps=substeps, periodic=True)
    every, others = beside(
        lambda some: carry(response.predict, some, data), draws, references or {}
    )
    return compare_period(test, data, every, noise_of_mean(data.repeats), others, band_hz=band_hz)


def compare_period(
    test: Test,
    data: response.Records,
    every: Float[np.ndarray, "draw 1 time"],
    noise_std: float | None,
    others: Mapping[str, Float[np.ndarray, "1 time"]] | None = None,
    *,
    band_hz: tuple[float, float] | None = None,
) -> xr.Dataset:
    """A period of a multisine beside predictions of it, as of `multisine_verification`.

    Args:
        test: Multisine whose records are single periods.
        data: The same reduced.
        every: Response by every draw.
        noise_std: Noise of the mean, where it is known.
        others: Responses of other oscillators, by name.
        band_hz: Band of the spectra [Hz]; all of them when None.
    """
    measured, model = np.asarray(data.mean[0]), in_band(every[:, 0], data.lines)
    others = {n: in_band(one[0], data.lines) for n, one in (others or {}).items()}
    if noise_std is not None:
        noise_std *= noise_share(data.lines, len(measured))
    record = test.records[0]
    unit = {"units": UNITS[data.response], "long_name": data.response}
    freq = np.fft.rfftfreq(len(measured), 1 / data.fs)
    low, high = band_hz or (freq[1], freq[-1])
    keep = (freq >= low) & (freq <= high)
    median = np.median(model, axis=0)
    spectra = {"measured": measured, "model": median, "error": measured - median}
    spectra |= {f"{name}_error": measured - one for name, one in others.items()}
    variables: dict[str, Any] = {
        "measured": ("time", measured, unit),
        "model_band": (("quantile", "time"), band(model), unit),
    }
    if noise_std is not None:
        predictive = gaussian_band(model, noise_std)
        variables["predictive_band"] = (("quantile", "time"), predictive, unit)
    variables |= {
        f"{name}_spectrum": ("freq", _amplitudes(x)[keep], unit) for name, x in spectra.items()
    }
    return xr.Dataset(
        variables,
        {
            "time": ("time", np.arange(len(measured)) / data.fs, {"units": "s"}),
            "freq": ("freq", freq[keep], {"units": "Hz"}),
            "quantile": list(QUANTILES),
        },
        {
            "level": test.level,
            "level_unit": record.units[record.source],
            "kind": test.kind,
            "response": data.response,
            **errors(measured, model, others, noise_std),
        },
    )


def _amplitudes(x: Float[np.ndarray, " time"]) -> NDArray[np.float64]:
    """Peak amplitudes of the lines of one period."""
    return 2 * np.abs(np.fft.rfft(x)) / len(x)
