"""Two lapped beams with two bolts, swept through two modes: a short campaign with matrices.

The truth is a structure of the same reduced model under the same input, on a grid of twice as many
steps; noise is white. The error of the reduction itself is tested in tests/assembly.
"""

from dataclasses import replace

import numpy as np
import scipy.io

import jbw
from jbw.campaign.joints import SeveralJoints
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.measurement.records import Record, Test
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.rig.assemblies import lapped_beams

FS, DURATION, TO_HZ, ZETA = 512.0, 1.0, 120.0, 0.004
NOISE = 0.01  # relative to the motion
NAMES = ("bolt 1", "bolt 2")
LABELS = ("bolt_1", "bolt_2")
# alpha [N/m], delta and gamma [1/m]: delta times the bolts' motion reaches 0.3 to 2.
BOLTS = ((6e6, 3e5, 4e4), (9e6, 2e5, 6e4))
# Band [Hz] and forces [N] of the sweeps of each mode.
SWEEPS = {"first": ((25.0, 40.0), (0.3, 1.5)), "second": ((70.0, 105.0), (0.5, 2.5))}
LAWS = tuple(f"bouc_wen@{label}" for label in LABELS)


def truth(bolts=BOLTS):
    """Return the true parameters by the names that a campaign gives them."""
    named = {
        f"{name}@{label}": value
        for label, bolt in zip(LABELS, bolts, strict=True)
        for name, value in zip(("alpha", "delta", "gamma"), bolt, strict=True)
    }
    model = reduced()
    return {
        "omega_n": float(model.omega[0]), "omega_2": float(model.omega[1]), "zeta": ZETA,
        "zeta_2": ZETA, **named,
    }  # fmt: skip


def reduced(bolts=None, factors=1.0):
    """Return modes to 120 Hz, with laws for given bolts; `factors` scale the bolts' motion."""
    rig = lapped_beams()
    laws = [()] * 2 if bolts is None else [BoucWenLaw(*numbers) for numbers in bolts]
    model = rig.with_laws(*laws).reduced(to_hz=TO_HZ, zeta=ZETA)
    H = model.H.copy()
    H[:, : model.num_kept] *= factors
    return replace(model, H=H)


def sweep(band_hz, force):
    """Return a linear sweep with smooth ends; the response decays freely in its last third."""
    t = np.arange(int(DURATION * FS)) / FS
    window = np.clip(t / 0.1, 0, 1) * np.clip((DURATION - t) / 0.3, 0, 1)
    rate = (band_hz[1] - band_hz[0]) / (2 * DURATION)
    phase = 2 * np.pi * (band_hz[0] * t + rate * t**2)
    return force * np.sin(0.5 * np.pi * window) ** 2 * np.sin(phase)


def slipping_motion(model, u):
    """Return the velocity at the tip under a force, by integration in time."""
    motion = jbw.simulate(model.structure(), u, FS, hold="band_limited", substeps=32)
    return np.asarray(motion.v)


def stuck_motion(model, u):
    """Return the periodic velocity at the tip with fully stuck joints, by the modes' response."""
    omega = 2 * np.pi * np.fft.rfftfreq(len(u), 1 / FS)[:, None]
    compliance = 1 / (model.omega**2 - omega**2 + 2j * model.zeta * model.omega * omega)
    response = np.sum(model.b * model.c[0] * compliance, axis=1)
    return np.fft.irfft(1j * omega[:, 0] * response * np.fft.rfft(u), len(u))


def records(
    names=tuple(SWEEPS), *, bolts=BOLTS, factors=1.0, noise_ratio=NOISE, seed=1, weaker=1.0
):
    """Return level, force and velocity at the tip by test name."""
    model, rng = reduced(bolts, factors), np.random.default_rng(seed)
    found = {}
    for name in names:
        band, forces = SWEEPS[name]
        for force in np.array(forces) / weaker:
            u = sweep(band, force)
            v = stuck_motion(model, u) if bolts is None else slipping_motion(model, u)
            noise = noise_ratio * np.std(v) * rng.standard_normal(v.shape)
            found[f"{name} at {force:g} N"] = force, u, v + noise
    return found


def impact_records(forces=(8.0, 20.0, 40.0), *, noise_ratio=0.01, seed=1):
    """Return records of the velocity at the tip after smooth impacts of 14 ms at node 1."""
    structure, rng = reduced(BOLTS).structure(), np.random.default_rng(seed)
    t = np.arange(int(2.5 * FS)) / FS
    pulse = np.where(t < 0.014, np.sin(np.pi * t / 0.014) ** 2, 0.0)
    found = []
    for force in forces:
        v = np.asarray(jbw.simulate(structure, force * pulse, FS, substeps=32).v)
        v = v + noise_ratio * np.std(v) * rng.standard_normal(len(v))
        found.append(Record(FS, {"velocity": v}, {"velocity": "m/s"}))
    return tuple(found)


def impacts(**options):
    """Return the impacts as a test of free decays of the first two modes."""
    return Test("decay", impact_records(**options), "impacts", band_hz=(18.0, 130.0), settle=0.15)


def campaign(names=tuple(SWEEPS), *, laws=LAWS, settings=None, uncertain=False, **options):
    """Return the sweeps as a campaign in memory."""
    tests = []
    for name, (level, u, v) in records(names, **options).items():
        channels, units = {"force": u, "velocity": v}, {"force": "N", "velocity": "m/s"}
        record = Record(FS, channels, units, name)
        tests.append(Test("sweep", (record,), name, level=level, run="one"))
    stated = Identify.of({"offsets": "none", "model_error": "none", **(settings or {})})
    joints = SeveralJoints(reduced(), laws, uncertain)
    return Campaign("bolts", None, tuple(tests), laws=laws, joints=joints, settings=stated)


def written(folder, names=tuple(SWEEPS), *, tie="", **options):
    """Write the sweeps as a campaign file with matrices and records; return its path."""
    rig = lapped_beams()
    dofs = np.array([str(dof) for dof in rig.model.dofs], dtype=object)[:, None]
    nodes = [[float(node), *where] for node, where in rig.model.positions.items()]
    matrices = {"M": rig.model.mass, "K": rig.model.stiffness, "dofs": dofs, "nodes": nodes}
    scipy.io.savemat(folder / "beams.mat", matrices)
    text = f"""[campaign]
name = "bolts"

[structure]
matrices = "beams.mat"
units = "SI"
to_hz = {TO_HZ}
damping = {ZETA}
input = "1:z"
points = {{ tip = "105:z" }}

[identify]
offsets = "none"
model_error = "none"
"""
    for joint in rig.joints:
        weights = ", ".join(f'"{dof}" = {x}' for dof, x in dict(joint.weights).items())
        text += f"""
[[joint]]
name = "{joint.name}"
weights = {{ {weights} }}
stiffness = {joint.stiffness}
"""
    text += tie
    for name, (level, u, v) in records(names, **options).items():
        file = f"{name.replace(' ', '_')}.npz"
        np.savez(folder / file, u=u, v=v)
        text += f"""
[[test]]
name = "{name}"
kind = "sweep"
files = "{file}"
channels = {{ force = "u", velocity = "v" }}
units = {{ force = "N", velocity = "m/s" }}
fs = {FS}
level = {level}
run = "one"
"""
    path = folder / "campaign.toml"
    path.write_text(text)
    return path
