"""Free decays and their curves in closed form, for the report's toy tree."""

import numpy as np
import xarray as xr

SPREAD = np.array([-2.576, 0.0, 2.576])
QUANTILE = np.array([0.005, 0.5, 0.995])


def verification_decay(rng, level, fitted):
    time = 0.1 + np.arange(4096) / 1024.0
    clean = level * np.exp(-0.4 * time) * np.cos(2 * np.pi * 18.8 * time)
    model = clean * (1 + 0.004 * SPREAD[:, None])
    unit = {"units": "m/s"}
    return xr.Dataset(
        {
            "measured": ("time", clean + 2e-3 * level * rng.standard_normal(time.size), unit),
            "model_band": (("quantile", "time"), np.sort(model, axis=0), unit),
            "predictive_band": (
                ("quantile", "time"),
                np.sort(model, axis=0) + 2e-3 * level * SPREAD[:, None],
                unit,
            ),
        },
        {"time": time, "quantile": QUANTILE},
        {
            "level": level,
            "response": "velocity",
            "fitted": int(fitted),
            "seen_s": 0.0 if fitted else 0.5,
            "coverage": 0.99,
            "nrmse": 0.004,
        },
    )


def verification_amplitude(rng):
    amplitude, measured = np.linspace(0.01, 0.6, 60), np.linspace(0.1, 0.5, 12)
    records = np.stack([measured, 0.9 * measured])
    noise = rng.standard_normal(records.shape)
    bands = ("quantile", "amplitude")
    return xr.Dataset(
        {
            "measured_amplitude": (("record", "piece"), records, {"units": "m/s"}),
            "measured_frequency": (("record", "piece"), 18.8 - 0.1 * records + 1e-3 * noise),
            "measured_damping": (("record", "piece"), 4e-3 + 2e-3 * records + 2e-5 * noise),
            "model_frequency": (bands, 18.8 - 0.1 * amplitude + 2e-3 * SPREAD[:, None]),
            "model_damping": (bands, 4e-3 + 2e-3 * amplitude + 3e-5 * SPREAD[:, None]),
            "fitted": ("record", [1, 0]),
        },
        {
            "amplitude": ("amplitude", amplitude, {"units": "m/s", "long_name": "velocity"}),
            "quantile": QUANTILE,
        },
    )


def decay_groups(rng):
    return {
        "/verification/decay/impacts 1": verification_decay(rng, 0.6, True),
        "/verification/decay/impacts 2": verification_decay(rng, 0.5, False),
        "/verification/amplitude": verification_amplitude(rng),
    }
