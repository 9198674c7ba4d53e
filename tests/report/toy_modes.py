"""A toy group of modes for the figures: two modes in a band, and poles for rising orders."""

import numpy as np
import xarray as xr


def modes():
    """Return two modes, each with a column of stable poles, and one pole of noise per order."""
    freq, omega = np.linspace(17.0, 21.0, 200), 2 * np.pi * np.array([18.8, 20.0])
    squared = (2 * np.pi * freq) ** 2
    model = sum(15 / (w**2 - squared + 0.008j * w * np.sqrt(squared)) for w in omega)
    orders = np.arange(8, 33)
    noise = 2 * np.pi * (17.2 + 3.6 * (orders * 0.618 % 1))
    poles = np.column_stack([*np.broadcast_arrays(*omega, noise)])
    receptance = {"units": "m/V"}
    return xr.Dataset(
        {
            "omega": ("mode", omega, {"units": "rad/s"}),
            "zeta": ("mode", [0.004, 0.004], {"units": "1"}),
            "h_magnitude": ("freq", 1.02 * np.abs(model), receptance),
            "fit_magnitude": ("freq", np.abs(model), receptance),
            "pole_order": ("pole", np.repeat(orders, 3), {"units": "1"}),
            "pole_omega": ("pole", poles.ravel(), {"units": "rad/s"}),
            "pole_is_stable": ("pole", np.tile([True, True, False], len(orders))),
        },
        {"freq": ("freq", freq, {"units": "Hz"})},
    )
