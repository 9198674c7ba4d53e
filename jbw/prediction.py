"""Verification: draws of the posterior carried to the records of a test, as 99 % bands."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jbw.measurement.channels import derivative_order
from jbw.measurement.records import Record, Test
from jbw.measurement.spectra import frf
from jbw.observables.response import JOINT, advance, response_to

QUANTILES = (0.005, 0.5, 0.995)
SETTLING = 8.0  # s of a noise record during which the unknown start of the motion dies out
Draws = dict[str, NDArray[np.float64]]


def thin(posterior: xr.Dataset, num_draws: int, held: Mapping[str, float] | None = None) -> Draws:
    """Evenly spaced draws over all chains, with what was held beside them.

    Args:
        posterior: Posterior group with dimensions (chain, draw).
        num_draws: Draws to keep at most.
        held: Parameters that were not updated, the same in every draw.

    Returns:
        Each parameter of the joint, and `gain`, to its draws.
    """
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    keep = np.unique(np.linspace(0, total - 1, min(num_draws, total)).round().astype(int))
    fixed = {name: np.full(len(keep), float(value)) for name, value in (held or {}).items()}
    names = [name for name in (*JOINT, "gain") if name in posterior]
    return {**fixed, **{name: posterior[name].values.ravel()[keep] for name in names}}


@partial(jax.jit, static_argnames=("fs", "response", "substeps"))
def _respond(
    draws: Mapping[str, Array],
    source: Float[Array, " time"],
    fs: float,
    response: str,
    substeps: int,
) -> Float[Array, "draw time"]:
    def one(theta: Mapping[str, Array]) -> Float[Array, " time"]:
        return response_to(theta, source, fs, response=response, substeps=substeps)

    return jax.lax.map(one, dict(draws), batch_size=8)


def predict_record(draws: Draws, record: Record, *, substeps: int = 2) -> NDArray[np.float64]:
    """Response of every draw to the measured input of a record, from rest.

    Args:
        draws: Parameters of the joint and gain, one value a draw.
        record: The record whose input to use.
        substeps: Steps of the solver between samples.

    Returns:
        Responses of shape (draw, time), in the unit of the measured response.
    """
    theta = {name: jnp.asarray(values) for name, values in draws.items()}
    source = jnp.asarray(record.channels[record.source])
    return np.asarray(_respond(theta, source, record.fs, record.response, substeps))


def band(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quantiles 0.5 %, 50 % and 99.5 % along the first axis: a 99 % band about its median."""
    return np.quantile(values, QUANTILES, axis=0)


def sweep_verification(
    test: Test, draws: Draws, noise_std: float, key: Any, *, substeps: int = 2
) -> xr.Dataset:
    """Measured repeats of a sweep against the bands of the model.

    Args:
        test: The repeats to compare with; none of them fitted.
        draws: Parameters of the joint and gain.
        noise_std: Standard deviation of the noise of one repeat, for the predictive band.
        key: Random key of that noise.
        substeps: Steps of the solver between samples.

    Returns:
        Variables over (quantile, time); attributes `coverage`, the share of all measured samples
        inside the predictive band, and `nrmse`, the error of the median against the mean repeat.
    """
    record = test.records[0]
    fs, response = record.fs, record.response
    measured = np.stack([advance(r.channels[response], test.delay, fs) for r in test.records])
    model = predict_record(draws, record, substeps=substeps)
    model_band = band(model)
    # Gaussian noise on top of a band this narrow beside it, or this wide: both exactly sampled.
    noise = noise_std * np.asarray(jax.random.normal(key, (8, *model.shape)))
    predictive = band((model + noise).reshape(-1, model.shape[-1]))
    mean = measured.mean(axis=0)
    inside = (measured >= predictive[0]) & (measured <= predictive[-1])
    unit = record.units[response]
    dims = ("quantile", "time")
    return xr.Dataset(
        {
            "measured": ("time", mean, {"units": unit, "long_name": f"mean measured {response}"}),
            "measured_band": (dims, band(measured), {"units": unit}),
            "model_band": (dims, model_band, {"units": unit}),
            "predictive_band": (dims, predictive, {"units": unit}),
        },
        {"time": ("time", np.arange(len(mean)) / fs, {"units": "s"}), "quantile": list(QUANTILES)},
        {
            "level": test.level,
            "response": response,
            "num_repeats": len(test.records),
            "coverage": float(inside.mean()),
            "nrmse": float(np.linalg.norm(mean - model_band[1]) / np.linalg.norm(mean)),
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
    simulated = predict_record(draws, record, substeps=substeps)
    model = np.stack([estimate(source, one, record, band_hz)[1] for one in simulated])
    reference = np.angle(h.mean(axis=0))
    unit = "m/(N/kg)" if "gain" not in draws else f"m/{record.units[record.source]}"
    magnitude, phase = {"units": unit, "long_name": "receptance"}, {"units": "rad"}
    dims, bands = ("repeat", "freq"), ("quantile", "freq")
    return xr.Dataset(
        {
            "measured_magnitude": (dims, np.abs(h), magnitude),
            "measured_phase": (dims, _phase_near(h, reference), phase),
            "model_magnitude": (bands, band(np.abs(model)), magnitude),
            "model_phase": (bands, band(_phase_near(model, reference)), phase),
        },
        {"freq": ("freq", freq, {"units": "Hz"}), "quantile": list(QUANTILES)},
        {"level": test.level, "level_unit": record.units[record.source], "kind": test.kind},
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
