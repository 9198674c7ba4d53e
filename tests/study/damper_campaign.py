"""A small campaign of prescribed loops, with forces from the law itself, not from jbw's map."""

import numpy as np

from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record

FS, SECONDS, REPEATS = 64.0, 4.0, 3
TRUTH = {"omega_n": 60.0, "alpha": 2000.0, "delta": 90.0, "gamma": 60.0}
UNITS = {"displacement": "m", "restoring_force": "N"}


def force_along(y):
    """Return the force per unit mass from 64 midpoint steps per sample of straight motion."""
    z, values = 0.0, [0.0]
    for move in np.diff(y):
        dy = move / 64
        for _ in range(64):
            half = z + 0.5 * dy * _slope(z, dy)
            z += dy * _slope(half, dy)
        values.append(z)
    k = TRUTH["omega_n"] ** 2 - TRUTH["alpha"]
    return k * y + np.array(values)


def _slope(z, dy):
    return TRUTH["alpha"] - TRUTH["gamma"] * np.sign(dy) * z - TRUTH["delta"] * abs(z)


def write_campaign(folder, amplitude, noise=2e-4, settings="", seed=5):
    """Write loops up to an amplitude [m], with noise relative to the largest force."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * FS)) / FS
    y = amplitude * np.sin(2 * np.pi * 0.5 * t) * (0.4 + 0.15 * t)
    force = force_along(y)
    for i in range(REPEATS):
        noisy = force + noise * np.abs(force).max() * rng.standard_normal(len(t))
        samples = {"displacement": y, "restoring_force": noisy}
        write_hdf5(folder / f"loop_{i}.h5", Record(FS, samples, UNITS))
    (folder / "campaign.toml").write_text(
        f"""
[campaign]
name = "loops"
modal_mass = 1.0

[[test]]
kind = "loop"
name = "loop"
files = "loop_*.h5"
level = {amplitude}
channels = {{ displacement = "displacement", restoring_force = "restoring_force" }}
units = {{ displacement = "m", restoring_force = "N" }}

[identify]
{settings}
""",
        encoding="utf-8",
    )
    return folder / "campaign.toml"
