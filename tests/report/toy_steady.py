"""Response curves, forced loops and a multisine in closed form, for the report's toy tree."""

import numpy as np
import xarray as xr

SPREAD = np.array([-2.576, 0.0, 2.576])
QUANTILE = np.array([0.005, 0.5, 0.995])


def curve(rng, level, fitted, force):
    """Return a linear mode at 18.8 Hz (1 - 0.1 level), with controlled response or force."""
    freq = np.linspace(17.0, 20.0, 61)
    omega, omega_n = 2 * np.pi * freq, 2 * np.pi * 18.8 * (1 - 0.1 * level)
    receptance = 1 / (omega_n**2 - omega**2 + 2j * 0.01 * omega_n * omega)
    values = 1e-3 * level / receptance if force else level * receptance
    measured = values + 0.003 * np.abs(values).max() * rng.standard_normal(61)
    unit = "N" if force else "m"
    attrs = {"units": unit, "long_name": "force" if force else "displacement"}
    dims = ("quantile", "freq")
    magnitude = np.abs(values) * (1 + 0.02 * SPREAD[:, None])
    phase = np.angle(values) + 0.02 * SPREAD[:, None]
    variables = {
        "measured_magnitude": ("freq", np.abs(measured), attrs),
        "measured_phase": ("freq", np.angle(measured), {"units": "rad"}),
        "model_magnitude": (dims, magnitude, attrs),
        "model_phase": (dims, phase, {"units": "rad"}),
    }
    if not force:
        variables |= {
            f"{name}_3": (d, 0.01 * np.asarray(x), a) for name, (d, x, a) in variables.items()
        }
    held = ("force", "displacement")
    quantity, other = held if force else held[::-1]
    facts = {"level": level, "level_unit": "m" if force else "N", "kind": "frf"}
    facts |= {"quantity": quantity, "held": other, "fitted": int(fitted), "nrmse": 0.003}
    return xr.Dataset(variables, {"freq": freq, "quantile": QUANTILE}, facts)


def loop(rng, level):
    """Return two cycles of an ellipse: a spring of 2 kN/m and a loss of 0.3 of its force."""
    angle = np.linspace(0, 4 * np.pi, 400)
    y = level * np.sin(angle)
    force = 2e3 * (y + 0.3 * level * np.cos(angle))
    band = force + 20.0 * level * SPREAD[:, None]
    lost = 2 * np.pi * 2e3 * 0.3 * level**2
    newton, joule = {"units": "N"}, {"units": "J"}
    variables = {
        "displacement": ("point", y, {"units": "m"}),
        "measured_force": ("point", force + 10 * level * rng.standard_normal(400), newton),
        "model_force": (("quantile", "point"), band, newton),
        "linear_force": ("point", 2e3 * y, newton),
        "measured_work": ((), lost, joule),
        "model_work": ("quantile", lost * (1 + 0.01 * SPREAD), joule),
    }
    attrs = {"level": level, "level_unit": "m", "fitted": int(level < 0.02), "nrmse": 0.01}
    return xr.Dataset(variables, {"quantile": QUANTILE}, attrs)


def multisine(rng):
    """Return one period of 4 s at 256 Hz with random phases, coloured by a mode at 18.8 Hz."""
    freq = np.arange(513) / 4.0
    shape = 1 / np.abs(18.8**2 - freq**2 + 2j * 0.01 * 18.8 * freq)
    lines = np.where((freq > 5) & (freq < 60), shape * np.exp(2j * np.pi * rng.random(513)), 0)
    x = np.fft.irfft(lines, 1024)
    noise = 1e-3 * x.std() * rng.standard_normal((2, 1024))
    unit = {"units": "m/s"}
    keep = (freq > 5) & (freq < 60)

    def lines_of(part):
        return ("freq", 2 * np.abs(np.fft.rfft(part))[keep] / 1024, unit)

    variables = {
        "measured": ("time", x + noise[0], unit),
        "model_band": (("quantile", "time"), x * (1 + 1e-3 * SPREAD[:, None]), unit),
        "measured_spectrum": lines_of(x),
        "error_spectrum": lines_of(noise[0]),
        "linear_error_spectrum": lines_of(30 * noise[1]),
    }
    coords = {"time": np.arange(1024) / 256, "freq": freq[keep], "quantile": QUANTILE}
    attrs = {"level": 2.0, "level_unit": "N", "response": "velocity", "fitted": 1}
    return xr.Dataset(variables, coords, attrs | {"nrmse": 1e-3, "nrmse_linear": 0.03})


def further(rng):
    y, unit = np.linspace(1e-3, 5e-3, 9), {"units": "Hz"}
    model = 18.8 - 100 * y
    found = {
        "measured": ("value", model + 1e-2 * rng.standard_normal(9), unit),
        "model_band": (("quantile", "value"), model * (1 + 1e-4 * SPREAD[:, None]), unit),
        "predictive_band": (("quantile", "value"), model * (1 + 5e-4 * SPREAD[:, None]), unit),
    }
    coords = {
        "displacement": ("value", y, {"units": "m"}),
        "group": ("value", np.repeat(np.array(["first", "second"], object), [5, 4])),
        "quantile": QUANTILE,
    }
    attrs = {"kind": "ring_down", "axis": "displacement", "fitted": 0, "nrmse": 5e-4}
    return xr.Dataset(found, coords, attrs)


def steady_groups(rng):
    groups = {
        f"/verification/curve/held at {level:g}": curve(rng, level, level < 0.3, force=True)
        for level in np.linspace(0.05, 0.4, 8)
    }
    for level in (0.1, 0.2):
        groups[f"/verification/curve/stepped {level:g}"] = curve(rng, level, True, force=False)
    for level in (0.01, 0.015, 0.02, 0.03):
        groups[f"/verification/loop/loop {level:g}"] = loop(rng, level)
    groups["/verification/multisine/periodic"] = multisine(rng)
    return {**groups, "/verification/ring_down/rung": further(rng)}
