"""The result tree of a run with closed-form toy numbers, as large as a real one."""

import numpy as np
import xarray as xr
from toy_decay import decay_groups
from toy_identifiability import identifiability_group
from toy_joints import assembly, backbones, joints
from toy_modes import modes
from toy_steady import steady_groups

QUANTILE = np.array([0.005, 0.5, 0.995])
SPREAD = np.array([-2.576, 0.0, 2.576])
TRUTH = {"omega_n": 118.1239, "zeta": 0.00444, "alpha": 497.40, "delta": 340.21, "gamma": 32.84}
UNITS = {"omega_n": "rad/s", "zeta": "1", "alpha": "1/s^2", "delta": "1/m", "gamma": "1/m"}
UNITS |= {"gain": "N/kg/V", "noise_std": "m/s"}
BOX = {
    "omega_n": (110.0, 126.0),
    "zeta": (0.00352, 0.00528),
    "alpha": (425.0, 575.0),
    "delta": (275.0, 410.0),
    "gamma": (10.0, 60.0),
    "gain": (10.0, 20.0),
}
LEVELS = (0.05, 0.10, 0.20)
MEASURED_BAND, MODEL_BAND = (0.99, 1.0, 1.01), (0.97, 1.005, 1.04)


def variable(dims, values, units="", long_name="", **attrs):
    return (dims, values, {"units": units, "long_name": long_name, **attrs})


def posterior(rng, sds, chains=4, draws=500, offset=0.0):
    variables = {}
    for name, sd in sds.items():
        shift = offset * rng.standard_normal((chains, 1))
        values = TRUTH.get(name, 15.0) + sd * (rng.standard_normal((chains, draws)) + shift)
        low, high = BOX[name]
        facts = {"lower": low, "upper": high, "truth": TRUTH.get(name, 15.0)}
        values = np.clip(values, low, high)
        variables[name] = variable(("chain", "draw"), values, UNITS[name], name, **facts)
    return xr.Dataset(variables)


def ridge_posterior(rng, chains=4, draws=500, mix=True):
    if mix:
        delta = rng.uniform(300, 400, (chains, draws))
    else:
        walk = np.cumsum(0.15 * rng.standard_normal((chains, draws)), axis=1)
        delta = rng.uniform(300, 395, (chains, 1)) + walk
    product = TRUTH["alpha"] * TRUTH["delta"]
    alpha = product / delta * (1 + 0.005 * rng.standard_normal((chains, draws)))
    zeta = 0.0050 + 0.00012 * rng.standard_normal((chains, draws))
    values = {"zeta": zeta, "alpha": alpha, "delta": delta}
    return xr.Dataset(
        {
            name: variable(
                ("chain", "draw"),
                np.clip(each, *BOX[name]),
                UNITS[name],
                name,
                lower=BOX[name][0],
                upper=BOX[name][1],
                truth=TRUTH[name],
            )
            for name, each in values.items()
        }
    )


def statistics(rng, level, chains=4, draws=500, offset=0.02):
    each = 1 + offset * rng.standard_normal((chains, 1))
    noise = np.cumsum(0.2 * rng.standard_normal((chains, draws)), 1) / np.arange(1, draws + 1)
    conv = level * (each + noise)
    return xr.Dataset({"conv": variable(("chain", "draw"), conv, "s^11/m^4")})


def receptance(freq, omega_n, zeta):
    omega = 2 * np.pi * freq
    return 1 / (omega_n**2 - omega**2 + 2j * zeta * omega_n * omega)


def linear(rng):
    freq = np.arange(0, 4097) / 8.0 / 8.0
    h = receptance(freq, TRUTH["omega_n"], TRUTH["zeta"])
    noisy = h * (1 + 0.02 * (rng.standard_normal(freq.size) + 1j * rng.standard_normal(freq.size)))
    near = np.abs(freq - 18.8) < 4
    dims = ("freq",)
    variables = {
        "h_magnitude": variable(dims, np.abs(noisy), "m/(N/kg)"),
        "h_phase": variable(dims, np.angle(noisy), "rad"),
        "coherence": variable(dims, 1 - 0.3 * np.exp(-(((freq - 18.8) / 0.05) ** 2)), ""),
        "fit_magnitude": variable(dims, np.where(near, np.abs(h), np.nan), "m/(N/kg)"),
        "fit_phase": variable(dims, np.where(near, np.angle(h), np.nan), "rad"),
        "omega_n": variable(("repeat",), 118.12 + 0.01 * rng.standard_normal(8), "rad/s"),
    }
    attrs = {"pooled_omega_n": 118.12, "cv_omega_n": 1.8e-5, "cv_zeta": 0.004, "cv_gain": 0.002}
    return xr.Dataset(variables, {"freq": freq}, attrs)


def kernel(rng):
    freq = np.array([5.0, 5.5, 6.0, 6.5, 6.75])
    h1, h1_3 = (receptance(n * freq, TRUTH["omega_n"], TRUTH["zeta"]) for n in (1, 3))
    h3 = 7.0e6 * h1**3 * h1_3
    noise = rng.standard_normal((8, 5)) + 1j * rng.standard_normal((8, 5))
    measured = h3 * np.exp(0.12j) * (1 + 0.05 * noise)
    variables = {
        "measured_magnitude": variable(("repeat", "freq_hz"), np.abs(measured), "s^6/m^2"),
        "measured_phase": variable(("repeat", "freq_hz"), np.angle(measured), "rad"),
        "correction": variable(("freq_hz",), np.linspace(0.02, 0.3, 5)),
        "y_peak": variable(("freq_hz",), np.full(5, 8e-4), "m"),
    }
    for name, width in (("paper", 0.012), ("nuts", 0.02)):
        scale = 1 + width * SPREAD[:, None]
        dims = ("quantile", "freq_hz")
        phase = np.angle(h3) + width * SPREAD[:, None]
        variables[f"{name}_magnitude"] = variable(dims, np.abs(h3) * scale, "s^6/m^2")
        variables[f"{name}_phase"] = variable(dims, phase, "rad")
    return xr.Dataset(variables, {"freq_hz": freq, "quantile": QUANTILE})


def spectrum(rng):
    freq = np.arange(2049) / 64.0
    floor = 2e-9 * np.abs(rng.standard_normal(freq.size) + 1j * rng.standard_normal(freq.size))
    lines = 8e-4 * np.exp(-(((freq - 6) * 40) ** 2)) + 6e-6 * np.exp(-(((freq - 18) * 40) ** 2))
    amplitude = variable(("freq",), floor + lines, "m")
    return xr.Dataset({"amplitude": amplitude}, {"freq": freq}, {"tone_hz": 6.0})


def verification_frf(rng, level):
    freq = np.arange(160, 1440) / 64.0 + 2.0
    omega_n, zeta = TRUTH["omega_n"] * (1 - 0.15 * level), 0.0044 + 0.03 * level
    h = receptance(freq, omega_n, zeta)
    noise = rng.standard_normal((12, freq.size)) + 1j * rng.standard_normal((12, freq.size))
    measured = h * (1 + 0.04 * noise)
    band = np.abs(h) * (1 + 0.015 * SPREAD[:, None])
    phase = np.angle(h) + 0.02 * SPREAD[:, None]
    variables = {
        "measured_magnitude": variable(("repeat", "freq"), np.abs(measured), "m/(N/kg)"),
        "measured_phase": variable(("repeat", "freq"), np.angle(measured), "rad"),
        "model_magnitude": variable(("quantile", "freq"), band, "m/(N/kg)"),
        "model_phase": variable(("quantile", "freq"), phase, "rad"),
    }
    attrs = {"level": level, "level_unit": "V", "fitted": int(level != 0.10), "kind": "sweep"}
    return xr.Dataset(variables, {"freq": freq, "quantile": QUANTILE}, attrs)


def verification_sweep(rng, level, size=16384):
    time = np.arange(size) / 1024.0
    swept = np.where(time < 8, 2.5 * time**2, 160 + 18.8 * (time - 8))
    envelope = 1 / (1 + ((time - 4.0) / 0.25) ** 2) + 0.3 * np.exp(-0.5 * (time - 4)) * (time > 4)
    clean = 8 * level * envelope * np.cos(2 * np.pi * swept)
    noise = 0.01 * level * rng.standard_normal(size)
    width = np.abs(clean)[None] * 0.02 * SPREAD[:, None]
    spread = 0.03 * level * SPREAD[:, None]
    dims = ("quantile", "time")
    variables = {
        "measured": variable(("time",), clean + noise, "m/s", "mean measured velocity"),
        "measured_band": variable(dims, clean + spread, "m/s"),
        "model_band": variable(dims, clean + width, "m/s"),
        "predictive_band": variable(dims, clean + width + spread, "m/s"),
    }
    attrs = {"level": level, "level_unit": "V", "fitted": int(level != 0.10)}
    attrs |= {"coverage": 0.9893, "nrmse": 0.0312, "response": "velocity"}
    return xr.Dataset(variables, {"time": time, "quantile": QUANTILE}, attrs)


def validation_loop(rng, level):
    phase = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    peak = 0.02 * level
    y, lag = peak * np.cos(phase), 0.12 * peak * np.sin(phase)
    force = 13_456 * y + 400 * (y - 30 * np.abs(y) * y) - 500 * lag
    noise = 0.0002 * np.max(np.abs(force)) * rng.standard_normal(256)
    width = 0.0003 * np.max(np.abs(force)) * SPREAD[:, None] * (0.2 + np.abs(np.sin(phase)))
    dims = ("quantile", "phase")
    area = np.pi * 0.12 * peak * 500 * peak
    variables = {
        "measured_y": variable(("phase",), y, "m"),
        "measured_force": variable(("phase",), force + noise, "N/kg"),
        "measured_force_viscous": variable(("phase",), force + noise - 124 * lag, "N/kg"),
        "model_y": variable(dims, y + 0.002 * peak * SPREAD[:, None] * np.cos(phase), "m"),
        "model_force": variable(dims, force + width, "N/kg"),
    }
    variables["measured_force_band"] = variable(dims, force + 0.3 * width, "N/kg")
    attrs = {"level": level, "level_unit": "V", "tone_hz": 18.0}
    for ending, scale in (("", 1.0), ("_viscous", 1.8)):
        measured, model = (scale * area * np.array(band) for band in (MEASURED_BAND, MODEL_BAND))
        variables[f"measured_area{ending}"] = variable(("quantile",), measured, "J/kg")
        variables[f"model_area{ending}"] = variable(("quantile",), model, "J/kg")
    return xr.Dataset(variables, {"phase": phase, "quantile": QUANTILE}, attrs)


def backbone():
    """Return a joint that softens and dissipates in proportion to the amplitude, and its loops."""
    amplitude = np.linspace(0.0, 8e-3, 41)[1:]
    part = amplitude / 6.4e-3
    dims = ("quantile", "amplitude")
    frequency = 18.8 - 0.2 * part + 0.001 * part * SPREAD[:, None]
    damping = 0.0044 + 0.002 * part + 2e-5 * part * SPREAD[:, None]
    angle = np.linspace(0, 2 * np.pi, 128, endpoint=False)
    y = np.array([1.6e-3, 3.2e-3, 6.4e-3])[:, None] * np.cos(angle)
    z = 300 * y - 60 * y.max(axis=1, keepdims=True) * np.sin(angle)
    variables = {
        "frequency": variable(dims, frequency, "Hz"),
        "damping": variable(dims, damping, "1"),
        "loop_y": variable(("loop", "phase"), y, "m"),
        "loop_z": variable(("quantile", "loop", "phase"), z * (1 + 0.01 * SPREAD[:, None, None])),
        "loop_slip": variable(("quantile", "loop", "phase"), np.stack(3 * [z - 497.4 * y]), "N/kg"),
        "stuck": variable(("quantile",), 497.4 + SPREAD, "1/s^2"),
    }
    return xr.Dataset(
        variables, {"amplitude": amplitude, "quantile": QUANTILE}, {"y_fitted": 6.4e-3}
    )


def procedure():
    """Return verdicts and mixing of the toy's steps."""
    rows = {
        "linear": ("", np.nan, np.nan),
        "third_order_nuts": ("ok", 812.0, 1.004),
        "third_order_paper": ("failed", 4.2, 4.1),
        "third_order_walk": ("not assessed", 433.0, 1.02),
        "opening_nuts": ("ok", 950.0, 1.001),
        "opening_paper": ("failed", 9.0, 1.4),
        "joint": ("ok", 1404.0, 1.003),
    }
    verdict, ess, r_hat = zip(*rows.values(), strict=True)
    variables = {
        "verdict": ("step", np.asarray(verdict, object)),
        "ess": variable(("step",), np.array(ess), "1"),
        "r_hat": variable(("step",), np.array(r_hat), "1"),
    }
    return xr.Dataset(variables, {"step": np.asarray(list(rows), object)}, {"main": "joint"})


def look(level):
    """Return the readings of five repeats of one level, and a receptance."""
    y = 1e-2 * level * np.array([0.98, 0.99, 1.0, 1.01, 1.02])
    freq = np.linspace(17.5, 20.0, 200)
    return xr.Dataset(
        {
            "y": variable("reading", y, "m", "motion"),
            "frequency_hz": variable("reading", 18.8 - 100.0 * y, "Hz", "natural frequency"),
            "damping": variable("reading", 0.0044 + 0.5 * y, "1", "damping ratio"),
            "response": variable("freq", np.abs(receptance(freq, 118.0, 0.005)), "m/N"),
            "freq": variable("freq", freq, "Hz"),
        },
        attrs={"test": f"sweep {level}", "kind": "sweep", "level": level},
    )


def result_tree():
    rng = np.random.default_rng(0)
    main = posterior(
        rng,
        {"omega_n": 0.004, "zeta": 8e-6, "alpha": 2.1, "delta": 2.4, "gamma": 0.3, "gain": 0.01},
    )
    noise = np.array([5e-5, 6e-5]) * (1 + 0.01 * rng.standard_normal((4, 500, 2)))
    main["noise_std"] = variable(("chain", "draw", "level"), noise, "m/s")
    main = main.assign_coords(level=[0.05, 0.20])
    groups = {
        "/posterior": main,
        "/identifiability": identifiability_group(),
        "/steps/linear": linear(rng),
        "/modes": modes(),
        "/steps/third_order_nuts/posterior": ridge_posterior(rng),
        "/steps/third_order_walk/posterior": ridge_posterior(rng),
        "/steps/third_order_paper/posterior": ridge_posterior(rng, draws=765, mix=False),
        "/steps/third_order_nuts/sample_stats": statistics(rng, 3e-14, offset=0.002),
        "/steps/third_order_paper/sample_stats": statistics(rng, 3e-14, draws=765),
        "/steps/opening_nuts/posterior": posterior(rng, {"gamma": 1.4}),
        "/steps/opening_paper/posterior": posterior(rng, {"gamma": 0.6}, draws=765, offset=3),
        "/steps/opening_nuts/sample_stats": statistics(rng, 2.0, offset=0.002),
        "/steps/opening_paper/sample_stats": statistics(rng, 2.0, draws=765),
        "/verification/h3": kernel(rng),
        "/verification/spectrum": spectrum(rng),
        "/verification/backbone": backbone(),
        "/procedure": procedure(),
        "/joints": joints(),
        "/assembly": assembly(),
        "/backbones": backbones(),
    }
    for level in LEVELS:
        name = f"sweep_{level:.2f}".replace(".", "p")
        groups[f"/look/{name}"] = look(level)
        groups[f"/verification/frf/{name}"] = verification_frf(rng, level)
        groups[f"/verification/sweep/{name}"] = verification_sweep(rng, level)
        groups[f"/validation/loops/loop_{name[6:]}"] = validation_loop(rng, level)
    groups |= decay_groups(np.random.default_rng(7))
    groups |= steady_groups(np.random.default_rng(8))
    return xr.DataTree.from_dict(groups)
