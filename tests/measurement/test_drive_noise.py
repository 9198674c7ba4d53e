"""The noise of a measured drive at a resonance: against the filter's own gain."""

import re

import numpy as np
import pytest
from scipy import signal

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.measurement.faults.noise import noisy_drive, passed_on
from jbw.measurement.faults.unlike_gains import unlike_gains
from jbw.measurement.records import Record

FS, N, F_N, ZETA = 256.0, 4096, 18.8, 0.005
OMEGA = 2 * np.pi * F_N
SYSTEM = signal.cont2discrete(([1.0, 0.0], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), 1 / FS, "foh")


def repeats(std_u, std_y, felt=0.0, seed=0):
    """A sweep through a resonance twice; what is `felt` moves the structure and is measured."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) / FS
    sweep = signal.chirp(t, 12.0, 14.0, 26.0) * np.clip(14.0 - t, 0.0, 0.3) / 0.3
    u, y = [], []
    for _ in range(2):
        force = sweep + felt * rng.standard_normal(N)
        u.append(force + std_u * rng.standard_normal(N))
        moved = signal.lfilter(SYSTEM[0].ravel(), SYSTEM[1], force)
        y.append(moved + std_y * rng.standard_normal(N))
    return np.stack(u), np.stack(y)


@pytest.mark.parametrize(("std_u", "std_y"), [(0.01, 1e-3), (0.01, 1e-2), (1e-3, 1e-3)])
def test_the_ratio_is_that_of_the_filter(std_u, std_y):
    h = signal.freqz(SYSTEM[0].ravel(), SYSTEM[1], 2 * np.pi * F_N / FS)[1]
    exact = np.abs(h[0]) ** 2 * (std_u / std_y) ** 2
    # The lines of the resonance lie above half of its power: their mean is two thirds of it or so.
    assert 0.5 * exact < passed_on(*repeats(std_u, std_y)) < 1.1 * exact


def test_what_the_structure_felt_is_no_noise_of_the_drive():
    assert passed_on(*repeats(0.01, 1e-4)) > 10.0
    assert passed_on(*repeats(0.0, 1e-4, felt=0.01)) == 0.0


def test_random_drives_say_nothing_alike_or_not():
    u = np.random.default_rng(0).standard_normal((2, 8 * N))
    y = signal.lfilter(SYSTEM[0].ravel(), SYSTEM[1], u)
    assert passed_on(u, y) == 0.0
    assert passed_on(u[[0, 0]], y[[0, 0]]) == 0.0


def test_the_doubt_names_the_channel_and_what_to_do():
    u, y = repeats(0.01, 1e-4)
    records = [
        Record(FS, {"force": u[i], "velocity": y[i]}, {"force": "N", "velocity": "m/s"})
        for i in range(2)
    ]
    (found,) = noisy_drive(*records)
    assert found.severity == "warning"
    assert found.channel == "force"
    assert "noise of `force`" in found.what
    assert not list(noisy_drive(*[Record(FS, {"velocity": row}, {}) for row in y]))
    u, y = repeats(1e-5, 1e-3)
    quiet = [Record(FS, {"force": u[i], "velocity": y[i]}, {}) for i in range(2)]
    assert not list(noisy_drive(*quiet))


def test_a_check_says_what_loading_says(tmp_path):
    u, y = repeats(0.01, 1e-4)
    for i in range(2):
        np.savez(tmp_path / f"sweep_{i}.npz", f=u[i], v=y[i])
    path = tmp_path / "campaign.toml"
    path.write_text(f"""[campaign]
name = "sweeps"
[[test]]
kind = "sweep"
files = "sweep_*.npz"
fs = {FS}
channels = {{ force = "f", velocity = "v" }}
units = {{ force = "N", velocity = "m/s" }}
""")
    said = [fault.what for row in check_campaign(path).rows for fault in row.findings]
    (noise,) = [what for what in said if "noise of `force`" in what]
    with pytest.warns(UserWarning, match=re.escape(noise)):
        load_campaign(path)


@pytest.mark.parametrize(
    ("gains", "named"),
    [
        ((1.0, 1.0, 1.4), ""),
        ((1.0, 9.8, 1.0), "b"),  # g in place of m/s^2
        ((1.0, 0.102, 1.0), "b"),
        ((1.0, -1.0, 1.0), "b"),
        ((-2.0, -2.0, np.nan), "ab"),
    ],
)
def test_a_repeat_of_another_sign_or_unit_is_named(gains, named):
    faults = unlike_gains(list(zip("abc", gains, strict=True)), "velocity", "force")
    assert "".join(name for name, _ in faults) == named
