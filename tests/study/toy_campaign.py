"""The smallest campaign that goes through `jbw.identify`: two sweeps and a loop.

The records are integrated by the fourth-order Runge-Kutta method on Eqs. (1) and (2) as printed,
with sixteen steps per sample, and written by h5py; no code of jbw makes them.
"""

import json

import h5py
import numpy as np

import jbw
from jbw.observables.dataset import log_likelihood
from jbw.study.store import claim, save_result

FS, SUBSTEPS = 256.0, 16
GAIN = 15.0
TRUTH = {"omega_n": 118.0, "zeta": 0.01, "alpha": 3000.0, "delta": 400.0, "gamma": 150.0}
CAMPAIGN = """
[campaign]
name = "toy"
gain = 15.0

[[test]]
kind = "sweep"
name = "weak"
files = "weak_*.h5"
level = 0.3
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }
fs = 256.0

[[test]]
kind = "sweep"
name = "strong"
files = "strong_*.h5"
level = 1.0
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }
fs = 256.0

[[test]]
kind = "loop"
name = "pull"
files = "pull_*.h5"
level = 0.004
channels = { displacement = "displacement", restoring_force = "restoring_force" }
units = { displacement = "m", restoring_force = "N" }
fs = 256.0
"""

# Importance sampling compiles least, and one step per sample is accurate enough here.
PLAIN = """
fit_levels = [1.0]
fit_repeats = 2
hold_out = ["weak"]
sampler = "importance"
num_chains = 2
num_samples = 100
substeps = 1
offsets = "none"
model_error = "none"
"""
# Without it, every law that is tried compiles its own programs.
LAW = """
[joint]
laws = ["bouc_wen"]
"""


def integrated(u, size, y=0.0, v=0.0):
    """Return displacement and velocity from an unstrained joint under u(t) [V]."""
    omega_n, zeta, alpha, delta, gamma = TRUTH.values()
    h = 1 / (SUBSTEPS * FS)
    # The force is given at every step and at the middle of every step.
    drive = GAIN * u(np.arange(2 * SUBSTEPS * size + 1) * h / 2)
    stuck = omega_n**2 - alpha

    def rate(f, y, v, z):
        a = f - 2 * zeta * omega_n * v - stuck * y - z
        return v, a, alpha * v - gamma * abs(v) * z - delta * v * abs(z)

    z, kept = alpha * y, []
    for i in range(SUBSTEPS * size):
        if i % SUBSTEPS == 0:
            kept.append((y, v))
        f0, f1, f2 = drive[2 * i : 2 * i + 3].tolist()
        a = rate(f0, y, v, z)
        b = rate(f1, y + h / 2 * a[0], v + h / 2 * a[1], z + h / 2 * a[2])
        c = rate(f1, y + h / 2 * b[0], v + h / 2 * b[1], z + h / 2 * b[2])
        d = rate(f2, y + h * c[0], v + h * c[1], z + h * c[2])
        y += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        z += h / 6 * (a[2] + 2 * b[2] + 2 * c[2] + d[2])
    return np.array(kept).T


def sweep(level, size):
    """Return a voltage that sweeps from 14 to 24 Hz and rests for the last fifth."""
    span = size / FS

    def u(t):
        envelope = np.sin(np.pi * np.clip(t / (0.8 * span), 0, 1)) ** 2
        return level * envelope * np.sin(2 * np.pi * (14 * t + 5 / span * t**2))

    return u


def pulled(size):
    """Return displacement [m] and force [N/kg] of the joint alone in growing cycles of 1 Hz."""
    alpha, delta, gamma = (TRUTH[name] for name in ("alpha", "delta", "gamma"))
    t = np.arange(size) / FS
    y = 4e-3 * t * FS / size * np.sin(2 * np.pi * t)
    z, force = 0.0, [0.0]
    for dy in (np.diff(y) / SUBSTEPS).repeat(SUBSTEPS):
        half = z + dy / 2 * (alpha - gamma * np.sign(dy) * z - delta * abs(z))
        z += dy * (alpha - gamma * np.sign(dy) * half - delta * abs(half))
        force.append(z)
    return y, (TRUTH["omega_n"] ** 2 - alpha) * y + np.array(force)[::SUBSTEPS]


def write_toy(folder, identify):
    """Write the campaign file and its records; return the path."""
    rng = np.random.default_rng(3)

    def write(name, repeats, noise, given, response):
        for i in range(repeats):
            with h5py.File(folder / f"{name}_{i}.h5", "w") as file:
                for role, values in given.items():
                    file[role] = values
                ((role, values),) = response.items()
                file[role] = values + noise * rng.standard_normal(len(values))

    size = 512
    for name, level in (("weak", 0.3), ("strong", 1.0)):
        u = sweep(level, size)
        _, velocity = integrated(u, size)
        write(name, 3, 2e-3, {"input": u(np.arange(size) / FS)}, {"velocity": velocity})
    y, force = pulled(size)
    write("pull", 2, 0.02, {"displacement": y}, {"restoring_force": force / GAIN})
    path = folder / "campaign.toml"
    path.write_text(CAMPAIGN + "\n[identify]\n" + identify, encoding="utf-8")
    return path


def identified(folder):
    """Return the study of the toy campaign."""
    path = write_toy(folder, PLAIN)
    return jbw.identify(jbw.load_campaign(path), seed=1, report=lambda _: None)


def write_run(folder):
    """Write the campaign, its result, and the log likelihood of the data at the truth."""
    study = identified(folder)
    save_result(claim(folder / "run"), study.tree, study.record)
    theta = {name: np.asarray(value) for name, value in TRUTH.items()}
    terms = log_likelihood(theta, study.identification.data)
    text = json.dumps({"log_likelihood": float(terms.sum())})
    (folder / "at_the_truth.json").write_text(text, encoding="utf-8")
