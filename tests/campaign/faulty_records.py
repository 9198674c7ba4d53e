"""Records with one fault each: a function writes files and returns the keys of their [[test]]."""

from itertools import count

import h5py
import numpy as np
import scipy.io

from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record

FS = 1024.0
N = 2**14
GAIN = 2.0  # N/kg/V, of the oscillator whose response is written
T = np.arange(N) / FS
UNITS = {"input": "V", "velocity": "m/s"}
SIZES = count(1)  # ensures that no two records of the folder have the same samples


def respond(u, f_n=40.0, zeta=0.01, fs=FS, order=1):
    """Return the steady periodic response of one mode, in closed form; order 1 is the velocity.

    Each response is larger than the previous one by a relative 1e-12.
    """
    omega, omega_n = 2 * np.pi * np.fft.rfftfreq(len(u), 1 / fs), 2 * np.pi * f_n
    h = GAIN * (1j * omega) ** order / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)
    return np.fft.irfft(h * np.fft.rfft(u), len(u)) * (1 + 1e-12 * next(SIZES))


def drive(seed=0, n=N):
    return np.random.default_rng(seed).normal(size=n)


def good(seed=0):
    u = drive(seed)
    return {"input": u, "velocity": respond(u)}


def tone(hz=5.03, third=1e-2, noise=0.0, seed=0):
    """Return a tone with a third harmonic, at no spectral line of the record."""
    phase = 2 * np.pi * hz * T
    y = 1e-3 * (np.cos(phase) + third * np.cos(3 * phase + 0.4))
    y += noise * np.random.default_rng(seed).normal(size=N)
    return {"input": 0.1 * np.cos(phase + 0.3), "displacement": y}


def noise(channels, suffix=".npz", fs=FS, units=UNITS, **keys):
    """Return a function that writes a noise test into one file."""

    def write(folder):
        path = folder / f"noise{suffix}"
        if suffix == ".h5":
            write_hdf5(path, Record(fs, channels, units))
        else:
            np.savez(path, **channels)
        stated = {} if suffix == ".h5" or fs is None else {"fs": fs}
        return {
            "kind": "noise", "files": path.name, "channels": {r: r for r in channels},
            "units": {role: units[role] for role in channels if role in units}, **stated, **keys,
        }  # fmt: skip

    return write


def tones(channels, hz=(5.03,), fs=FS, **keys):
    def write(folder):
        units = {"input": "V", "displacement": "m"}
        return noise(channels, fs=fs, units=units, tones=list(hz), **keys)(folder) | {
            "kind": "tones"
        }

    return write


def spoilt(role, change, **keys):
    """Return the writer of the good record with one channel changed."""
    channels = good()
    channels[role] = change(channels[role].copy())
    return noise(channels, **keys)


def with_nan(share):
    def change(x):
        x[7 : 7 + share] = np.nan
        return x

    return change


def timed(change):
    """Return the writer of the good record with a changed time column."""
    return noise({"time": change(T.copy()), **good()}, fs=None, units=UNITS)


def swap(t):
    t[[100, 101]] = t[[101, 100]]
    return t


def repeat(t):
    t[101] = t[100]
    return t


def two_rates(folder):
    keys = noise(good(), ".h5")(folder)
    with h5py.File(folder / keys["files"], "a") as file:
        file["velocity"].attrs["fs"] = 2048.0
    return keys


def rounded_interval(folder):
    keys = noise(good(), ".h5")(folder)
    with h5py.File(folder / keys["files"], "a") as file:
        del file.attrs["fs"]
        for name in ("input", "velocity"):
            del file[name].attrs["fs"]
            file[name].attrs["dt"] = 0.000976562
    return keys


def renamed(folder):
    keys = noise(good())(folder)
    return keys | {"channels": {"input": "input", "velocity": "velocty"}}


def lengths(folder):
    for i, n in enumerate((N, N - 2000, N // 2)):
        u = drive(i, n)
        np.savez(folder / f"noise_{i}.npz", input=u, velocity=respond(u))
    return noise(good())(folder) | {"files": "noise_*.npz"}


def lightly_damped():
    # zeta f_n is 0.04 Hz, less than the 1/16 Hz that the record resolves.
    u = drive()
    return {"input": u, "velocity": respond(u, zeta=0.001)}


def in_g():
    return {"input": drive(), "acceleration": respond(drive(), order=2) / 9.81}


def settling():
    channels = tone()
    channels["displacement"] *= 1 + 0.1 * np.exp(-T / 5)
    return channels


def truncated(suffix):
    def write(folder):
        keys = noise(good(), suffix)(folder)
        path = folder / keys["files"]
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        return keys

    return write


def matlab73(folder):
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        for name, samples in good().items():
            file.create_dataset(name, data=samples[None, :]).attrs["MATLAB_class"] = np.bytes_(
                "double"
            )
    with (folder / "a.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128))
    return noise(good())(folder) | {"files": "a.mat"}


def matlab_table(folder):
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        table = file.create_dataset("velocity", data=np.zeros(3, dtype=np.uint32))
        table.attrs["MATLAB_class"] = np.bytes_("table")
    return noise(good())(folder) | {"files": "a.mat", "channels": {"velocity": "velocity"},
                                    "units": {"velocity": "m/s"}, "kind": "decay"}  # fmt: skip


def decimal_comma(folder):
    lines = (f"{u:.9e};{v:.9e}".replace(".", ",") for u, v in zip(*good().values(), strict=True))
    (folder / "a.csv").write_text("\ufeffinput;velocity\n" + "\n".join(lines), encoding="utf-8")
    return noise(good())(folder) | {"files": "a.csv"}


def one_column(folder):
    (folder / "a.csv").write_text("\n".join(f"{v:.6f}".replace(".", ",") for v in good()["input"]))
    return noise(good())(folder) | {"files": "a.csv"}


def huge(folder):
    with h5py.File(folder / "a.h5", "w") as file:
        for name in UNITS:
            file.create_dataset(name, (2**30,), dtype="f8", chunks=(2**16,))
    return noise(good())(folder) | {"files": "a.h5"}


def pickled(folder):
    (folder / "a.pkl").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    return noise(good())(folder) | {"files": "a.pkl"}


def linked_out(folder):
    keys = noise(good(), ".h5")(folder)
    with h5py.File(folder / "a.h5", "w") as file:
        for name in UNITS:
            file[name] = h5py.ExternalLink(str(folder / keys["files"]), name)
    return keys | {"files": "a.h5"}


def bomb(folder):
    with h5py.File(folder / "a.h5", "w") as file:
        for name in UNITS:
            file.create_dataset(name, (2**31,), dtype="f8", chunks=(2**16,), compression="gzip")
    return noise(good())(folder) | {"files": "a.h5", "fs": FS}


def flipped_exponent(folder):
    channels = good()
    channels["velocity"][40] = 4e284
    scipy.io.savemat(folder / "a.mat", channels)
    return noise(good())(folder) | {"files": "a.mat"}
