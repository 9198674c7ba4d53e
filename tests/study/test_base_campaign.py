"""A campaign on a moving base: identified, and predicted with the participation that it found."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import jbw

pytestmark = pytest.mark.slow

FS, SECONDS, G = 512.0, 12.0, 9.80665
TRUTH = {"omega_n": 2 * np.pi * 20.0, "zeta": 0.006, "gain": 1.4}
JOINT = {"alpha": 0.12 * TRUTH["omega_n"] ** 2, "delta": 310.0, "gamma": 310.0}


def swept(level):
    """The base and a point on it under a sweep, by scipy: accelerations as sensors see them."""
    t = np.arange(0.0, SECONDS, 1 / FS)
    phase = 2 * np.pi * (12.0 * t + 8.0 * t**2 / SECONDS)  # 12 to 28 Hz
    window = np.clip(t / 0.3, 0, 1) * np.clip((SECONDS - t) / 0.3, 0, 1)
    base = level * G * window * np.sin(phase)
    omega, zeta, gain = TRUTH.values()
    alpha, delta, gamma = JOINT.values()
    source = CubicSpline(t, base)

    def rate(t, state):
        y, v, z = state
        free = -2 * zeta * omega * v - (omega**2 - alpha) * y - alpha * z
        return [v, free - gain * source(t), v - delta * abs(v) * z - gamma * v * abs(z)]

    solved = solve_ivp(
        rate, (0.0, t[-1]), np.zeros(3), t_eval=t, rtol=1e-9, atol=1e-13, max_step=0.5 / FS
    )
    y, v, z = solved.y
    relative = -2 * zeta * omega * v - (omega**2 - alpha) * y - alpha * z - gain * base
    return base, relative + base


def test_the_joint_on_a_moving_base_is_found_and_predicted_with_its_participation(tmp_path):
    rng = np.random.default_rng(5)
    for i, level in enumerate((0.05, 0.2)):
        base, seen = swept(level)
        noisy = seen + 2e-3 * np.std(seen) * rng.standard_normal(seen.size)
        np.savez(tmp_path / f"sweep_{i}.npz", base=base / G, tip=noisy / G)
    (tmp_path / "campaign.toml").write_text(
        '[campaign]\nname = "table"\n[joint]\nlaws = ["bouc_wen"]\n'
        + "".join(
            f'[[test]]\nkind = "sweep"\nname = "{name}"\nfiles = "sweep_{i}.npz"\nfs = 512.0\n'
            'channels = { base = "base", acceleration = "tip" }\n'
            'units = { base = "g", acceleration = "g" }\n'
            for i, name in enumerate(("weak", "strong"))
        )
    )
    campaign = jbw.load_campaign(tmp_path / "campaign.toml")
    study = jbw.identify(campaign, quick=True)
    draws = study.tree["posterior"]
    assert draws["gain"].attrs["units"] == "1"
    for name, truth in (TRUTH | JOINT).items():
        values = draws[name].values
        # What the spline between samples adds to the noise is a few of these deviations at most.
        assert np.mean(values) == pytest.approx(truth, rel=2e-3, abs=5 * np.std(values)), name
    found = study.resonance([0.1 * G], drive="base")
    assert found.attrs["participation"] == pytest.approx(TRUTH["gain"], rel=2e-3)
    # At 1e-5 g the joint is a spring: the absolute acceleration of a linear mode at its peak.
    weak = study.resonance([1e-5 * G], drive="base")
    ratio = np.linspace(0.97, 1.03, 20001)
    lag = 2j * TRUTH["zeta"] * ratio
    transmitted = np.abs(1 + TRUTH["gain"] * ratio**2 / (1 - ratio**2 + lag))
    assert weak["peak"].attrs["units"] == "g"
    peak = float(weak["peak"].sel(quantile=0.5).values[0])
    assert peak == pytest.approx(1e-5 * transmitted.max(), rel=5e-3)  # zeta to 0.2 %
