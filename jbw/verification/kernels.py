"""The measured third-order kernel beside that of Step 3, and the spectrum of a probing tone."""

from collections.abc import Mapping

import jax
import numpy as np
import xarray as xr

from jbw.identification.paper import kernel
from jbw.identification.paper.kernel import KernelData
from jbw.measurement.probing import ThirdOrder
from jbw.measurement.records import Test
from jbw.quantities import derivative_order
from jbw.verification.bands import QUANTILES, band, phase_near

SPECTRUM = 4.2  # of the tone: the highest frequency of its spectrum shown


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
    unit = {"units": "s^6/m^2", "long_name": "third-order kernel"}
    variables = {
        "measured_magnitude": (("repeat", "freq"), np.abs(h), unit),
        "measured_phase": (("repeat", "freq"), phase_near(h, reference), {"units": "rad"}),
        "correction": ("freq", [k.source_ratio for k in shown], {"units": "1"}),
        "y_peak": ("freq", np.asarray(data.y_peak), {"units": "m"}),
    }
    for prefix, posterior in posteriors.items():
        theta = {name: posterior[name].values.ravel() for name in ("zeta", "alpha", "delta")}
        model = np.asarray(jax.vmap(lambda t: kernel.predict(t, data))(theta))
        dims = ("quantile", "freq")
        variables[f"{prefix}_magnitude"] = (dims, band(np.abs(model)), unit)
        variables[f"{prefix}_phase"] = (dims, band(phase_near(model, reference)), {"units": "rad"})
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
