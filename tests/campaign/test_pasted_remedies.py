"""Remedies that a check prints, pasted into the campaign that provoked them: they cure."""

import re

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.errors import ConfigError

FS, HZ, RATE = 600.0, 30.0, 1.1
PUT = re.compile(r"Put under \[([\w.\[\]]+?)\]: `([^`]+)`")


def decay(seconds=8.0, phase=0.3):
    t = np.arange(round(seconds * FS)) / FS
    size = np.exp(-RATE * t)
    return size * np.cos(2 * np.pi * HZ * (t - 0.01 * (1 - size) / RATE) + phase)


def late(x, i):
    return np.concatenate([np.zeros(round((1.0 + 0.1 * i) * FS)), x])


def driven(x, i):
    t = np.arange(-round(2 * FS), 0) / FS
    return np.concatenate([np.cos(2 * np.pi * HZ * t + 0.3 + i), x])


def hit_twice(x, i):
    if i == 1:
        x[700:] += 0.5 * x[:-700]
    return x


def hummed(x, i):
    return x + 0.03 * np.sin(2 * np.pi * 25.0 * np.arange(len(x)) / FS + i)


def windowed(x, i):
    return x  # of the record with its noise


def written(folder, edit, band="band = [20.0, 45.0]"):
    """Three decays under a campaign file."""
    for i in range(3):
        x = edit(decay(phase=0.3 + i), i)
        x = x + 1e-3 * np.random.default_rng(i).standard_normal(len(x))
        x = x * np.exp(-np.arange(len(x)) / FS / 1.5) if edit is windowed else x
        np.savez(folder / f"decay_{i}.npz", v=1e-2 * x)
    path = folder / "campaign.toml"
    path.write_text(f"""[campaign]
name = "decays"
[[test]]
kind = "decay"
files = "decay_*.npz"
channels = {{ velocity = "v" }}
units = {{ velocity = "m/s" }}
fs = {FS}
{band}
""")
    return path


def faults(path):
    return [fault for row in check_campaign(path).rows for fault in row.findings]


def pasted(path, remedies):
    """Put what the remedies say under the tables that they name."""
    text = path.read_text()
    for remedy in remedies:
        for table, line in PUT.findall(remedy):
            assert text.count(f"[{table}]\n") == 1
            text = text.replace(f"[{table}]\n", f"[{table}]\n{line}\n")
    path.write_text(text)


@pytest.mark.parametrize(
    ("edit", "key"),
    [
        (late, "settle"),
        (driven, "settle"),
        (hit_twice, "exclude"),
        (windowed, "window_s"),
        (hummed, "lines_hz"),
    ],
)
def test_a_pasted_remedy_of_a_decay_cures(tmp_path, edit, key):
    path = written(tmp_path, edit)
    (fault,) = faults(path)
    ((_, line),) = PUT.findall(fault.remedy)
    assert line.startswith(key)
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_a_missing_band_is_pasted(tmp_path):
    path = written(tmp_path, lambda x, i: x, band="")
    (fault,) = faults(path)
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_the_window_that_a_campaign_states_is_taken_out(tmp_path):
    path = written(tmp_path, windowed)
    x = np.load(tmp_path / "decay_1.npz")["v"]
    path.write_text(path.read_text() + "window_s = 1.5\nspan = [1.0, 7.0]\n")
    (test,) = load_campaign(path).tests
    t = np.arange(600, 4200) / FS  # from the record's first sample, not from the span's
    expected = x[600:4200] * np.exp(t / 1.5)
    np.testing.assert_allclose(test.records[1].channels["velocity"], expected, rtol=1e-12)
    assert test.records[1].provenance["window of velocity removed"] == "exp(-t / 1.5 s)"


def test_a_window_that_leaves_nothing_is_refused(tmp_path):
    path = written(tmp_path, windowed)
    path.write_text(path.read_text() + "window_s = 0.2\n")  # exp(-40) at the end
    assert all("the window falls to exp(-40)" in fault.what for fault in faults(path))


def test_a_window_is_for_decays_alone(tmp_path):
    path = written(tmp_path, windowed)
    text = (
        path.read_text()
        .replace('"decay"', '"sweep"')
        .replace("channels = {", 'channels = { force = "v",')
    )
    path.write_text(text.replace("units = {", 'units = { force = "N",') + "window_s = 0.2\n")
    with pytest.raises(ConfigError, match="window_s: for kind `decay` only"):
        check_campaign(path)


def of_two_modes(path, second):
    """A sweep from rest over two modes of unit modal mass, in closed form by their spectra."""
    t = np.arange(1 << 14) / 512.0
    u = np.sin(2 * np.pi * (5 + 0.6 * t) * t) * np.sin(np.pi * t / t[-1]) ** 2
    omega = 2 * np.pi * np.fft.rfftfreq(2 * len(t), 1 / 512.0)
    h = sum(
        size / (w**2 - omega**2 + 2j * 0.01 * w * omega)
        for size, w in ((1.0, 2 * np.pi * 12.0), (second, 2 * np.pi * 31.0))
    )
    x = np.fft.irfft(h * np.fft.rfft(u, 2 * len(t)))[: len(t)]
    x = x + 1e-3 * np.std(x) * np.random.default_rng(0).standard_normal(len(x))
    np.savez(path.parent / "sweep.npz", u=u, x=x)
    path.write_text("""[campaign]
name = "sweep"
modal_mass = 1.0
[[test]]
kind = "sweep"
files = "sweep.npz"
channels = { force = "u", displacement = "x" }
units = { force = "N", displacement = "m" }
fs = 512.0
""")


def test_the_band_of_one_mode_is_proposed_for_a_sweep_over_two(tmp_path):
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    assert faults(path) == []
    of_two_modes(path, 2.5)
    (fault,) = faults(path)
    assert "outside 9.6 to 14 Hz" in fault.what or "outside 25 to 37 Hz" in fault.what
    pasted(path, [fault.remedy])
    assert faults(path) == []


@pytest.mark.parametrize("ppm", [150.0, -150.0])
def test_a_pasted_clock_cures(tmp_path, ppm):
    """A linear sweep from rest, its response at n / (1 + ppm) by quintic splines."""
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = dict(np.load(tmp_path / "sweep.npz"))
    t = np.arange(len(stored["u"])) / 512.0
    at = np.clip(t / (1 + 1e-6 * ppm), 0, t[-1])
    np.savez(tmp_path / "sweep.npz", u=stored["u"], x=make_interp_spline(t, stored["x"], 5)(at))
    (fault,) = faults(path)
    assert f"ppm {'fast' if ppm > 0 else 'slow'}" in fault.what
    pasted(path, [fault.remedy])
    assert faults(path) == []
