"""Verification: what was measured against the 99 % bands of the model, test by test."""

from collections.abc import Mapping

import jax
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jbw.measurement.channels import derivative_order
from jbw.measurement.harmonics import ThirdOrder
from jbw.measurement.records import Record, Test
from jbw.measurement.spectra import frf
from jbw.observables import kernel
from jbw.observables.kernel import KernelData
from jbw.observables.response import advance
from jbw.observables.spectral_lines import in_band, lines_of, noise_share
from jbw.prediction import QUANTILES, Draws, band, beside, error, gaussian_band, predict_record

SETTLING = 8.0  # s of a noise record during which the unknown start of the motion dies out
SPECTRUM = 4.2  # of the tone: the highest frequency of its spectrum shown


def sweep_verification(
    test: Test,
    draws: Draws,
    noise_std: float,
    *,
    references: Mapping[str, Mapping[str, float]] | None = None,
    substeps: int = 2,
) -> xr.Dataset:
    r"""Measured repeats of a sweep against the bands of the model.

    The predictive band is that of a Gaussian with the draws' variance and the noise's together,

    $$m(t) \pm 2.576 \sqrt{\mathrm{var}_\theta[v(t; \theta)] + \sigma^2}$$

    Args:
        test: The repeats to compare with; none of them fitted.
        draws: Parameters of the joint and gain.
        noise_std: Standard deviation of the noise of one repeat, for the predictive band.
        references: Oscillators to compare with, by name.
        substeps: Steps of the solver between samples.

    Returns:
        Variables over (quantile, time); attributes `coverage`, the share of all measured samples
        inside the predictive band, `nrmse`, the error of the median against the mean repeat, and
        `nrmse_linear` and so on, that of the oscillators to compare with.
    """
    record = test.records[0]
    model, others = beside(
        lambda some: predict_record(some, record, substeps=substeps), draws, references or {}
    )
    return compare_records(test, model, noise_std, others)


def compare_records(
    test: Test,
    model: NDArray[np.float64],
    noise_std: float,
    others: Mapping[str, NDArray[np.float64]] | None = None,
) -> xr.Dataset:
    """Repeats of one input beside the model's responses to it, as of `sweep_verification`.

    Where the test has a band, what lies in it of both.

    Args:
        test: The repeats.
        model: Response by every draw, of shape (draw, time).
        noise_std: Standard deviation of the noise of one repeat.
        others: Responses of other oscillators, by name.
    """
    record = test.records[0]
    fs, response = record.fs, record.response
    measured = np.stack([advance(r.channels[response], test.delay, fs) for r in test.records])
    lines = lines_of(test.band_hz or (), measured.shape[1], fs)
    measured, model = in_band(measured, lines), in_band(model, lines)
    others = {name: in_band(one, lines) for name, one in (others or {}).items()}
    predictive = gaussian_band(model, noise_std * noise_share(lines, measured.shape[1]))
    mean = measured.mean(axis=0)
    inside = (measured >= predictive[0]) & (measured <= predictive[-1])
    unit = record.units[response]
    dims = ("quantile", "time")
    return xr.Dataset(
        {
            "measured": ("time", mean, {"units": unit, "long_name": f"mean measured {response}"}),
            "measured_band": (dims, band(measured), {"units": unit}),
            "model_band": (dims, band(model), {"units": unit}),
            "predictive_band": (dims, predictive, {"units": unit}),
        },
        {"time": ("time", np.arange(len(mean)) / fs, {"units": "s"}), "quantile": list(QUANTILES)},
        {
            "level": test.level,
            "level_unit": record.units[record.source],
            "response": response,
            "num_repeats": len(test.records),
            "coverage": float(inside.mean()),
            "num_values": inside.size,
            "nrmse": error(mean, predictive[1]),
            **{f"nrmse_{name}": error(mean, one) for name, one in others.items()},
        },
    )


def frf_verification(
    test: Test, draws: Draws, band_hz: tuple[float, float], *, substeps: int = 2
) -> xr.Dataset:
    """FRF of every repeat, and of every draw under the measured input, by the same estimator.

    Args:
        test: Noise or sweep test.
        draws: Parameters of the joint and gain.
        band_hz: Band to show [Hz].
        substeps: Steps of the solver between samples.

    Returns:
        Magnitudes and phases, measured over (repeat, freq) and of the model over (quantile, freq).
    """
    return compare_frfs(test, predict_record(draws, test.records[0], substeps=substeps), band_hz)


def compare_frfs(
    test: Test, model: NDArray[np.float64], band_hz: tuple[float, float]
) -> xr.Dataset:
    """FRFs of the repeats and of the model's responses to the first one's input.

    Args:
        test: Noise or sweep test.
        model: Response by every draw, of shape (draw, time).
        band_hz: Band to show [Hz].
    """
    estimate = _noise_frf if test.kind in ("noise", "multisine") else _sweep_frf
    record = test.records[0]
    source = record.channels[record.source]
    measured = [
        estimate(
            r.channels[r.source], advance(r.channels[r.response], test.delay, r.fs), r, band_hz
        )
        for r in test.records
    ]
    freq = measured[0][0]
    h = np.stack([one for _, one in measured])
    simulated = np.stack([estimate(source, one, record, band_hz)[1] for one in model])
    reference = np.angle(h.mean(axis=0))
    unit = record.units[record.source]
    magnitude = {"units": f"m/({unit})" if "/" in unit else f"m/{unit}", "long_name": "receptance"}
    phase = {"units": "rad"}
    dims, bands = ("repeat", "freq"), ("quantile", "freq")
    return xr.Dataset(
        {
            "measured_magnitude": (dims, np.abs(h), magnitude),
            "measured_phase": (dims, _phase_near(h, reference), phase),
            "model_magnitude": (bands, band(np.abs(simulated)), magnitude),
            "model_phase": (bands, band(_phase_near(simulated, reference)), phase),
        },
        {"freq": ("freq", freq, {"units": "Hz"}), "quantile": list(QUANTILES)},
        {"level": test.level, "level_unit": unit, "kind": test.kind},
    )


def _phase_near(h: NDArray[np.complex128], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phase on the branch next to a reference, so that bands do not straddle +-pi."""
    return reference + np.angle(h * np.exp(-1j * reference))


def _noise_frf(
    u: NDArray[np.float64], y: NDArray[np.float64], record: Record, band_hz: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    skip = round(SETTLING * record.fs)
    estimate = frf(u[skip:], y[skip:], record.fs, response=record.response, band=band_hz)
    return estimate.freq, estimate.h


def _sweep_frf(
    u: NDArray[np.float64], y: NDArray[np.float64], record: Record, band_hz: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    r"""Ratio of the spectra of a whole sweep, $H = Y(\omega) / U(\omega)$."""
    freq = np.fft.rfftfreq(len(u), 1 / record.fs)
    keep = (freq >= band_hz[0]) & (freq <= band_hz[1])
    ratio = np.fft.rfft(y)[keep] / np.fft.rfft(u)[keep]
    return freq[keep], ratio / (2j * np.pi * freq[keep]) ** derivative_order(record.response)


def kernel_verification(
    kernels: tuple[ThirdOrder, ...],
    data: KernelData,
    posteriors: Mapping[str, xr.Dataset],
) -> xr.Dataset:
    """Measured third-order kernel of every repeat against the bands of Step 3.

    Args:
        kernels: The measured kernel of each probing test.
        data: Their sufficient statistics, with those below the noise left out.
        posteriors: Prefix of the variables to the draws of zeta, alpha and delta.

    Returns:
        Magnitudes and phases, measured over (repeat, freq) and of the model over (quantile, freq).
    """
    omega = np.asarray(data.omega)
    shown = [k for k in kernels if np.any(np.isclose(k.omega, omega))]
    repeats = min(len(k.h3) for k in shown)
    h = np.stack([k.h3[:repeats] for k in shown], axis=-1)
    reference = np.angle(h.mean(axis=0))
    unit = {"units": "m^-2 s^6", "long_name": "third-order kernel"}
    variables = {
        "measured_magnitude": (("repeat", "freq"), np.abs(h), unit),
        "measured_phase": (("repeat", "freq"), _phase_near(h, reference), {"units": "rad"}),
        "correction": ("freq", [k.source_ratio for k in shown], {"units": "1"}),
        "y_peak": ("freq", np.asarray(data.y_peak), {"units": "m"}),
    }
    for prefix, posterior in posteriors.items():
        theta = {name: posterior[name].values.ravel() for name in ("zeta", "alpha", "delta")}
        model = np.asarray(jax.vmap(lambda t: kernel.predict(t, data))(theta))
        dims = ("quantile", "freq")
        variables[f"{prefix}_magnitude"] = (dims, band(np.abs(model)), unit)
        variables[f"{prefix}_phase"] = (dims, band(_phase_near(model, reference)), {"units": "rad"})
    coords = {
        "freq_hz": ("freq", omega / (2 * np.pi), {"units": "Hz"}),
        "quantile": list(QUANTILES),
    }
    return xr.Dataset(variables, coords)


def tone_spectrum(test: Test) -> xr.Dataset:
    """Amplitude spectrum of the displacement of one probing record.

    Args:
        test: A test with one tone.

    Returns:
        Peak amplitude over frequency, through a Hann window.
    """
    record = test.records[0]
    x = record.channels[record.response][round(test.settle * record.fs) :]
    window = np.hanning(len(x))
    freq = np.fft.rfftfreq(len(x), 1 / record.fs)
    keep = (freq > 0.3 * test.tones_hz[0]) & (freq < SPECTRUM * test.tones_hz[0])
    amplitude = np.abs(np.fft.rfft(x * window))[keep] * 2 / window.sum()
    amplitude /= (2 * np.pi * freq[keep]) ** derivative_order(record.response)
    return xr.Dataset(
        {"amplitude": ("freq", amplitude, {"units": "m", "long_name": "displacement"})},
        {"freq": ("freq", freq[keep], {"units": "Hz"})},
        {"tone_hz": test.tones_hz[0], "test": test.name},
    )
