"""Campaign files of the how-to pages, beside records that they describe: `jbw check` is content.

The records are of linear oscillators by SciPy, and of sliders by a clipped spring: what is looked
at is that files, channels, units and keys are meant as the pages write them.
"""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import lsim

from jbw.cli import run

PAGES = Path(__file__).parents[1] / "docs" / "howto"
ZETA = 0.005


def noise(size, seed=0):
    return np.random.default_rng(seed).standard_normal(size)


def velocity(u, fs, hz=18.8):
    """Velocity [m/s] of a linear oscillator under a force per unit mass [N/kg]."""
    w = 2 * np.pi * hz
    return lsim(([1.0, 0.0], [1.0, 2 * ZETA * w, w**2]), u, np.arange(len(u)) / fs)[1]


def driven(repeat=0, fs=1024.0, level=0.2):
    """A sweep from rest in volts, and the laser in mm/s."""
    t = np.arange(int(16 * fs)) / fs
    u = level * np.sin(2 * np.pi * (10 + t / 2) * t) * (t < 15) * (t > 0.5)
    v = 1e3 * velocity(15 * u, fs)
    return {"shaker": u, "laser": v + 0.5 * noise(len(v), repeat)}


def hdf5(*names):
    for number, name in enumerate(names):
        for i in range(3):
            with h5py.File(f"{name}_{i}.h5", "w") as file:
                for channel, values in driven(3 * number + i).items():
                    file[channel] = values


def decays():
    t = np.arange(2 * 5120) / 5120.0
    w = 2 * np.pi * 122.0
    for i in range(9):
        v = 50 * np.exp(-ZETA * w * t) * np.cos(w * t + i) + 0.05 * noise(len(t), i)
        savemat(f"impact_{i}.mat", {"laser": v})


def stepped():
    fs, tones = 1024.0, (17.5, 18.0, 18.25, 18.5, 18.75, 19.0, 19.5)
    t = np.arange(int(32 * fs)) / fs
    u = np.concatenate([0.02 * np.sin(2 * np.pi * tone * t) for tone in tones])
    for i in range(2):
        v = 1e3 * velocity(15 * u, fs) + 0.01 * noise(len(u), i)
        savemat(f"stepped_{i}.mat", {"shaker": u, "laser": v})


def curves():
    f = np.linspace(17.0, 20.5, 60)
    w, w_n = 2 * np.pi * f, 2 * np.pi * 18.8
    h = -(w**2) / (w_n**2 - w**2 + 2j * ZETA * w_n * w) / 1.93  # acceleration per newton
    curve = np.zeros(1, [(name, object) for name in ("f", "F", "a", "ph")])
    curve[0] = (f, 5 / np.abs(h), np.full(f.size, 5.0), np.degrees(np.angle(h)))
    savemat("curves.mat", {"C": curve})


def loops():
    """A slider beside a spring through growing cycles, in inches and kips."""
    t = np.arange(40 * 128) / 128.0
    found = {}
    for name, amplitude in (("05in", 0.5), ("10in", 1.0)):
        x = amplitude * np.sin(2 * np.pi * 0.25 * t)
        slid = [0.0]
        for dx in np.diff(x):
            slid.append(float(np.clip(slid[-1] + dx, -0.1, 0.1)))
        found |= {f"x_{name}": x, f"f_{name}": 20 * np.array(slid) + 2 * x + 1e-3 * noise(len(x))}
    np.savez("loops.npz", **found)


def structure():
    for name, hz in (("low", 18.8), ("high", 57.2)):
        t = np.arange(8 * 512) / 512.0
        u = np.sin(2 * np.pi * (0.8 * hz + 0.025 * hz * t) * t) * np.sin(np.pi * t / 8) ** 2
        for i in range(2):
            with h5py.File(f"{name}_{i}.h5", "w") as file:
                file["cell"] = u
                v = 1e3 * velocity(u, 512.0, hz)
                file["laser"] = v + 0.01 * np.std(v) * noise(len(v), i)


def points():
    fs, hz = 512.0, (18.8, 57.2)
    t = np.arange(32 * 512) / fs
    u = np.sin(2 * np.pi * (10 + 0.9 * t) * t) * np.sin(np.pi * t / 32) ** 2
    each = np.array([np.gradient(velocity(u, fs, one), 1 / fs) for one in hz])
    for i in range(2):
        with h5py.File(f"wide_{i}.h5", "w") as file:
            file["cell"] = u
            for name, seen in (("acc1", (1, 1)), ("acc2", (0.4, -0.8)), ("acc3", (1.3, -0.2))):
                a = np.array(seen) @ each
                file[name] = a + 0.01 * np.std(a) * noise(len(a), i)


def impacts():
    t = np.arange(2 * 5120) / 5120.0
    rings = [np.exp(-ZETA * w * t) * np.cos(w * t) for w in (2 * np.pi * 122.2, 2 * np.pi * 243.0)]
    savemat("impacts.mat", {"v": rings[0] + 0.3 * rings[1] + 1e-4 * noise(len(t))})


RECORDS = {
    "commands": (lambda: hdf5("sweep_0p20V"),),
    "decays": (decays,),
    "stepped": (stepped, curves),
    "sweeps": (lambda: hdf5("sweep_weak", "sweep_strong"),),
    "loops": (loops,),
    "days": (lambda: hdf5("monday", "tuesday", "wednesday"),),
    "laws": (lambda: hdf5("sweep"),),
    "structures": (structure, points, impacts),
}
CASES = [(page, i) for page, made in RECORDS.items() for i in range(len(made))]


@pytest.mark.parametrize(("page", "number"), CASES)
@pytest.mark.filterwarnings("default")  # what a check doubts is printed, and not failed for
def test_a_campaign_of_a_page_checks(page, number, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    found = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert len(found) == len(RECORDS[page])
    RECORDS[page][number]()
    Path("campaign.toml").write_text(found[number], encoding="utf-8")
    code = run(["check", "campaign.toml"])
    told = capsys.readouterr()
    assert code == 0, told.out + told.err
