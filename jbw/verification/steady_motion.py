"""Steady motion in time beside the model's: forced loops and periods of a multisine."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from jbw.measurement.periods import periods
from jbw.measurement.records import Test
from jbw.observables.loops import Loops
from jbw.observables.observable import prediction
from jbw.observables.records import Records
from jbw.observables.samples import in_band, noise_share
from jbw.quantities import UNIT_OF, derivative_order
from jbw.verification.bands import QUANTILES, band, errors, gaussian_band
from jbw.verification.draws import carry, count_of, with_references
from jbw.verification.noise import noise_of, of_repeats
from jbw.verification.predicted import Predicted, Source

MOST_POINTS = 2048  # of a loop, kept for drawing


def predict_loop(source: Source, test: Test) -> Predicted:
    r"""Restoring force along a prescribed displacement beside that of the model.

    The energy lost is the work of the force over the record after `settle`,

    $$W = \int F\,\mathrm{d}y$$

    Args:
        source: What is carried; its references are springs.
        test: Test of kind loop.

    Returns:
        Forces over (point) and (quantile, point), work over (quantile); attributes as of
        `jbw.verification.bands.errors`.
    """
    data = Loops.of([test], laws=source.basis.laws)
    model, others = _carried(source, data)
    noise = noise_of(source.basis, test, of_repeats(data.repeats))
    dataset = compare_loop(test, data, model, source.std(noise, len(test.records)), others)
    peak = float(jnp.max(jnp.abs(data.displacement)))
    return Predicted(dataset, np.full(count_of(source.draws), peak), noise)


def _carried(source: Source, data: Loops | Records) -> tuple[Any, dict[str, Any]]:
    """What every draw predicts of the data, and what the other oscillators do."""
    return with_references(
        lambda some, laws: carry(prediction, some, replace(data, laws=laws)),
        source.draws, data.laws, source.references,
    )  # fmt: skip


def compare_loop(
    test: Test,
    data: Loops,
    every: Float[np.ndarray, "draw 1 time"],
    noise_std: float | None,
    others: Mapping[str, Float[np.ndarray, "1 time"]],
) -> xr.Dataset:
    """A forced loop beside predictions of it, as of `predict_loop`.

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
    others = {name: one[0, counted] for name, one in others.items()}
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


def predict_periods(source: Source, test: Test) -> Predicted:
    """Steady response over one period of a multisine beside that of the model.

    Args:
        source: What is carried.
        test: Multisine of at least two periods, or whose records are single periods.

    Returns:
        Response over (time) and (quantile, time); amplitude spectra over (freq) of the measured
        response, the model's median, the error it leaves, and the other oscillators' errors;
        attributes as of `jbw.verification.bands.errors`.
    """
    cut = periods(test) or test
    data = Records.of([cut], laws=source.basis.laws, substeps=source.basis.substeps, periodic=True)
    model, others = _carried(source, data)
    noise = noise_of(source.basis, test, of_repeats(data.repeats))
    dataset = compare_period(cut, data, model, source.std(noise, len(cut.records)), others)
    # One period of a steady motion is integrated line by line.
    omega = 2 * np.pi * np.fft.rfftfreq(model.shape[-1], 1 / data.fs)
    lines = np.fft.rfft(model[:, 0])[:, 1:] / (1j * omega[1:]) ** derivative_order(data.response)
    y = np.fft.irfft(np.pad(lines, ((0, 0), (1, 0))), model.shape[-1])
    return Predicted(dataset, np.abs(y).max(axis=-1), noise)


def compare_period(
    test: Test,
    data: Records,
    every: Float[np.ndarray, "draw 1 time"],
    noise_std: float | None,
    others: Mapping[str, Float[np.ndarray, "1 time"]],
) -> xr.Dataset:
    """A period of a multisine beside predictions of it, as of `predict_periods`.

    Args:
        test: Multisine whose records are single periods; its band is that of the spectra.
        data: The same reduced.
        every: Response by every draw.
        noise_std: Noise of the mean, where it is known.
        others: Responses of other oscillators, by name.
    """
    measured, model = np.asarray(data.mean[0]), in_band(every[:, 0], data.lines)
    others = {n: in_band(one[0], data.lines) for n, one in others.items()}
    if noise_std is not None:
        noise_std *= noise_share(data.lines, len(measured))
    record = test.records[0]
    unit = {"units": UNIT_OF[data.response], "long_name": data.response}
    freq = np.fft.rfftfreq(len(measured), 1 / data.fs)
    low, high = test.band_hz or (freq[1], freq[-1])
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
