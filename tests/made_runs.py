"""Artificial runs: posteriors as a run stores them, and records integrated without jbw."""

import json
from typing import Any

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from scipy.stats import norm

from jbw.measurement.records import Record, Test
from jbw.verification.predictive_basis import seen_of

FS, SIZE = 256.0, 768
OMEGA_N, ZETA, GAIN = 118.0, 0.01, 15.0
JOINT = {"omega_n": OMEGA_N, "zeta": ZETA, "alpha": 3000.0, "delta": 400.0, "gamma": 150.0}
SILENT = {**JOINT, "alpha": 1e-6, "delta": 1.0, "gamma": 1.0}
UNITS = {"input": "V", "velocity": "m/s"}
Z = norm.ppf(0.995)


def burst(level):
    """Return a sweep through the resonance that begins and ends at rest, as a function of time."""
    span = SIZE / FS

    def u(t):
        phase = 2 * np.pi * (14.0 * t + 4.0 / span * t**2)
        return level * np.sin(np.pi * np.clip(t / (0.8 * span), 0, 1)) ** 2 * np.sin(phase)

    return u


def integrated(u, joint, t):
    """Return displacement and velocity by DOP853 on Eqs. (1) and (2), with nu = 1."""
    nu = 1.0
    omega_n, zeta, alpha, delta, gamma = joint.values()

    def rate(time, state):
        y, v, z = state
        dz = alpha * v - gamma * abs(v) * abs(z) ** (nu - 1) * z - delta * v * abs(z) ** nu
        return v, GAIN * u(time) - 2 * zeta * omega_n * v - (omega_n**2 - alpha) * y - z, dz

    found = solve_ivp(rate, (0, t[-1]), (0, 0, 0), "DOP853", t, rtol=1e-9, atol=1e-12)
    return found.y[0], found.y[1]


def a_test(level, joint=SILENT, noise=0.0, repeats=1, kind="sweep", name="sweep", unit="V"):
    rng = np.random.default_rng(5)
    t = np.arange(SIZE) / FS
    source = burst(level)(t)
    if joint is SILENT:
        system = ([GAIN, 0.0], [1.0, 2 * ZETA * OMEGA_N, OMEGA_N**2])
        fine = np.arange(32 * SIZE) / (32 * FS)
        velocity = lsim(system, burst(level)(fine), fine)[1][::32]
    else:
        velocity = integrated(burst(level), joint, t)[1]
    role = "force" if unit == "N" else "input"
    records = tuple(
        Record(
            FS,
            {role: source, "velocity": velocity + noise * rng.standard_normal(SIZE)},
            {role: unit, "velocity": "m/s"},
        )
        for _ in range(repeats)
    )
    return Test(kind, records, name, level=level)


def a_tree(draws, *, y_peak=1.0, noise=None, seen=(), substeps=8, held=None):
    variables: dict[str, Any] = {
        name: (("chain", "draw"), np.atleast_2d(values)) for name, values in draws.items()
    }
    if noise is not None:
        shape = next(iter(variables.values()))[1].shape
        stacked = np.broadcast_to(list(noise.values()), (*shape, len(noise)))
        variables["noise_std"] = (("chain", "draw", "level"), stacked)
    posterior = xr.Dataset(variables, {"level": list(noise)} if noise else {})
    tree = xr.DataTree.from_dict({"/": xr.Dataset(), "/posterior": posterior})
    tests = json.dumps({test.name: seen_of(test)._asdict() for test in seen})
    tree.attrs.update(y_peak=y_peak, tests=tests, substeps=substeps, held=json.dumps(held or {}))
    return tree


def same(joint, count=4, **more):
    return {name: np.full(count, value) for name, value in {**joint, "gain": GAIN, **more}.items()}


def spread(relative=0.01, count=400):
    """Return draws of a linear oscillator with uncertain gain only, from a Gaussian's quantiles."""
    unit = norm.ppf((np.arange(count) + 0.5) / count)
    return {**same(SILENT, count), "gain": GAIN * (1 + relative * unit / unit.std())}
