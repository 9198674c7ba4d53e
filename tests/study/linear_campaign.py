"""A structure without a joint: sweeps at three levels and free decays of a linear oscillator."""

import h5py
import numpy as np
import toy_campaign as toy
from scipy.signal import lsim

TEST = """
[[test]]
kind = "{kind}"
name = "{name}"
files = "{name}_*.h5"
{more}channels = {{ {channels} }}
units = {{ {units} }}
fs = 256.0
"""
SWEPT = 'input = "input", velocity = "velocity"', 'input = "V", velocity = "m/s"'
FREE = 'velocity = "velocity"', 'velocity = "m/s"'


def write_linear(folder, identify="", size=1024):
    """Write the campaign file with records: 1 % of noise, three repeats of a sweep, four decays."""
    rng = np.random.default_rng(8)
    t = np.arange(size) / toy.FS
    omega, zeta = toy.TRUTH["omega_n"], toy.TRUTH["zeta"]
    text = '[campaign]\nname = "linear"\ngain = 15.0\n'
    for name, level in (("weak", 0.1), ("middle", 0.3), ("strong", 1.0)):
        fine = np.arange(16 * size) / (16 * toy.FS)
        u = toy.sweep(level, size)
        system = [toy.GAIN, 0.0], [1.0, 2 * zeta * omega, omega**2]
        velocity = lsim(system, u(fine), fine)[1][::16]
        for i in range(3):
            with h5py.File(folder / f"{name}_{i}.h5", "w") as file:
                file["input"] = u(t)
                noise = 0.01 * np.std(velocity) * rng.standard_normal(size)
                file["velocity"] = velocity + noise
        channels, units = SWEPT
        text += TEST.format(
            kind="sweep", name=name, more=f"level = {level}\n", channels=channels, units=units
        )
    damped = omega * np.sqrt(1 - zeta**2)
    for i in range(4):
        velocity = 0.1 * (1 + 0.2 * i) * np.exp(-zeta * omega * t) * np.sin(damped * t)
        with h5py.File(folder / f"ring_{i}.h5", "w") as file:
            file["velocity"] = velocity + 5e-4 * rng.standard_normal(size)
    channels, units = FREE
    text += TEST.format(
        kind="decay", name="ring", more="band = [12.0, 26.0]\n", channels=channels, units=units
    )
    path = folder / "campaign.toml"
    path.write_text(text + "\n[identify]\n" + identify, encoding="utf-8")
    return path
