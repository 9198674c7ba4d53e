"""A campaign with sweeps by a force and on a moving base: both gains, and both predictions."""

import re
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import jbw
from jbw.errors import ConfigError

FS, SECONDS, G, MASS = 512.0, 8.0, 9.80665, 0.8
TRUTH = {"omega_n": 2 * np.pi * 20.0, "zeta": 0.006, "gain": 1 / MASS, "gain_base": 1.4}
JOINT = {"alpha": 0.12 * TRUTH["omega_n"] ** 2, "delta": 310.0, "gamma": 310.0}

PUT = re.compile(r"Put under \[([\w.\[\]]+?)\]: `([^`]+)`")


@cache
def swept(level, gain):
    """The source, and the acceleration that it causes relative to the base, by scipy."""
    t = np.arange(0.0, SECONDS, 1 / FS)
    phase = 2 * np.pi * (12.0 * t + 8.0 * t**2 / SECONDS)  # 12 to 28 Hz
    window = np.clip(t / 0.3, 0, 1) * np.clip((SECONDS - t) / 0.3, 0, 1)
    u = level * window * np.sin(phase)
    omega, zeta = TRUTH["omega_n"], TRUTH["zeta"]
    alpha, delta, gamma = JOINT.values()
    source = CubicSpline(t, u)

    def free(y, v, z):
        return -2 * zeta * omega * v - (omega**2 - alpha) * y - alpha * z

    def rate(t, state):
        y, v, z = state
        slip = v - delta * abs(v) * z - gamma * v * abs(z)
        return [v, free(y, v, z) + gain * source(t), slip]

    solved = solve_ivp(
        rate, (0.0, t[-1]), np.zeros(3), t_eval=t, rtol=1e-9, atol=1e-13, max_step=0.5 / FS
    )
    return u, free(*solved.y) + gain * u


def written(folder, head, levels=(0.5, 1.5)):
    """Write a campaign with sweeps at each level by a force and on a base; return its path."""
    rng = np.random.default_rng(5)
    text = f'[campaign]\nname = "both"\n{head}\n'
    for i, level in enumerate(levels):
        force, seen = swept(level, TRUTH["gain"])
        base, relative = swept(level, -TRUTH["gain_base"])
        for name, source, motion in (("force", force, seen), ("base", base, relative + base)):
            noisy = motion + 2e-3 * np.std(motion) * rng.standard_normal(motion.size)
            np.savez(folder / f"{name}_{i}.npz", source=source, tip=noisy)
            unit = {"force": "N", "base": "m/s^2"}[name]
            text += (
                f'[[test]]\nkind = "sweep"\nname = "{name} {i}"\nfiles = "{name}_{i}.npz"\n'
                f'fs = {FS}\nchannels = {{ {name} = "source", acceleration = "tip" }}\n'
                f'units = {{ {name} = "{unit}", acceleration = "m/s^2" }}\n'
            )
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


@pytest.mark.slow
def test_one_joint_is_found_from_both_drives_and_predicts_both(tmp_path):
    head = f'modal_mass = {MASS}\n[joint]\nlaws = ["bouc_wen"]'
    study = jbw.identify(jbw.load_campaign(written(tmp_path, head)), quick=True)
    draws = study.tree["posterior"]
    assert "gain" not in draws  # The mass determines it.
    assert draws["gain_base"].attrs["units"] == "1"
    for name, truth in (TRUTH | JOINT).items():
        if name in draws:
            values = draws[name].values
            # Noise of 0.2 % in 4 sweeps; five standard deviations of each parameter.
            assert abs(values.mean() - truth) < max(5 * values.std(), 2e-3 * truth), name
    for name in ("force 1", "base 1"):
        assert study.predict(name, num_draws=20).attrs["nrmse"] < 5e-3
    oscillator = jbw.BoucWen(omega_n=TRUTH["omega_n"], zeta=TRUTH["zeta"], **JOINT)
    motion = jbw.forced.equivalent_motion(oscillator)
    for drive, gain in (("force", TRUTH["gain"]), ("base", TRUTH["gain_base"])):
        found = study.resonance([1.0], drive=drive, draws=20)
        expected = jbw.forced.resonance(motion, np.array([[gain]])).peak
        assert found["frequency"].values[1, 0] == pytest.approx(
            expected.omega[0, 0] / 2 / np.pi, rel=1e-3
        )
        assert found["displacement"].values[1, 0] == pytest.approx(expected.y[0, 0], rel=1e-2)
    assert study.resonance([1.0], draws=20)["level"].attrs["units"] == "N"


@pytest.mark.parametrize("head", ["", "gain = 1.4"])
def test_both_drives_without_a_mass_are_refused_with_the_line_to_paste(tmp_path, head):
    with pytest.raises(ConfigError, match=r"modal_mass = 1\.0") as refused:
        jbw.load_campaign(written(tmp_path, head, (0.5,)))
    ((table, line),) = PUT.findall(str(refused.value))
    assert table == "campaign"
    assert jbw.load_campaign(written(tmp_path, line, (0.5,))).modal_mass == 1.0
