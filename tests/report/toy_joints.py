"""Toy groups of two joints for the figures: three nodes in a row, two modes, one loop per joint."""

import numpy as np
import xarray as xr

PHASE = np.linspace(0, 2 * np.pi, 64, endpoint=False)


def joints():
    """Return the shares of joints, and loops that are ellipses about a slope of 2e6 N/m."""
    peaks = np.array([[2e-6], [5e-6]])
    x = peaks * np.cos(PHASE)
    shares = np.array([[0.2, 0.01], [0.3, 0.04]])
    band = np.stack([0.8 * shares, shares, 1.2 * shares], axis=-1)
    unit = {"units": "1"}
    return xr.Dataset(
        {
            "energy_share": (("joint", "mode"), shares, unit),
            "energy_share_at_motion": (("joint", "mode", "quantile"), band, unit),
            "loss_share": (("joint", "mode", "quantile"), band, unit),
            "softening_share": (("joint", "mode", "quantile"), band, unit),
            "frequency_hz": ("mode", [32.0, 90.0], {"units": "Hz"}),
            "identified": ("joint", [True, False]),
            "motion": (("joint", "phase"), x, {"units": "m"}),
            "loop": (("joint", "phase"), 2e6 * x + 3.0 * np.sin(PHASE), {"units": "N"}),
        },
        {"joint": ["bolt_1", "bolt_2"], "mode": [1, 2]},
    )


def backbones():
    """Return two amplitudes of two modes: the first falls by 1 Hz from 32; its damping doubles."""
    hz, damping = np.array([[32.0, 31.0], [90.0, 89.0]]), np.array([[0.004, 0.008]] * 2)
    band = np.array([0.99, 1.0, 1.01])
    of_levels = ("mode", "level")
    return xr.Dataset(
        {
            "displacement": (of_levels, [[2e-6, 4e-6], [1e-6, 2e-6]]),
            "frequency_hz": ((*of_levels, "quantile"), hz[..., None] * band),
            "damping": ((*of_levels, "quantile"), damping[..., None] * band),
            "frequency_at_medians": (of_levels, hz - [0.0, 0.1]),
            "damping_at_medians": (of_levels, damping),
            "frequency_in_full_stick": (of_levels, hz + np.array([0.0, 0.1])),
            "damping_in_full_stick": (of_levels, 0.9 * damping),
            "shape": (
                (*of_levels, "coordinate"), [[[1, 1e-4], [1, 2e-4]], [[1e-5, 1], [3e-5, 1]]],
            ),
        },
        {"mode": [1, 2], "coordinate": [1, 2]},
    )  # fmt: skip


def assembly():
    """Return three nodes along x that move along z, the first of them fixed."""
    deflection = np.zeros((2, 3, 3))
    deflection[:, 1:, 2] = [[0.4, 1.0], [-1.0, 0.8]]
    return xr.Dataset(
        {
            "weight": (("joint", "dof"), [[0.0025, 0.0], [0.0, 0.0025]]),
            "motion_unit": ("joint", ["m", "m"]),
            "force_unit": ("joint", ["N", "N"]),
            "position": (("node", "axis"), [[0.0, 0, 0], [0.3, 0, 0], [0.5, 0, 0]]),
            "held": ("node", [True, False, False]),
            "link": (("link", "end"), [[1, 2]]),
            "deflection": (("mode", "node", "axis"), deflection),
        },
        {"joint": ["bolt_1", "bolt_2"], "dof": ["1:ry", "2:ry"], "node": ["0", "1", "2"]},
    )
