"""Remedies that a check prints, pasted into the campaign that provoked them: they cure."""

import re

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from jbw.campaign.check import check_campaign
from jbw.campaign.load import load_campaign
from jbw.errors import ConfigError
from jbw.measurement.long_records import long_records

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
            if f"[{table}]\n" not in text:
                text += f"[{table}]\n"
            assert text.count(f"[{table}]\n") == 1
            key = line.partition(" = ")[0]  # stated otherwise before, it stands no more
            text = re.sub(rf"^{re.escape(key)} = .*\n", "", text, flags=re.MULTILINE)
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


@pytest.mark.parametrize("fs", [4096.0, 4.096e6])
def test_a_pasted_span_of_a_long_record_cures(tmp_path, fs):
    t = np.arange(100_000) / 4096.0  # in a time that runs with fs
    envelope = np.where((t > 6.0) & (t < 12.0), np.sin(np.pi * t / 6.0) ** 2, 0.0)
    wave, velocity = (envelope * f(2 * np.pi * 20.0 * t) for f in (np.sin, np.cos))
    noise = 1e-4 * np.random.default_rng(0).normal(size=(2, len(t)))
    np.savez(tmp_path / "long.npz", force=wave + noise[0], v=velocity + noise[1])
    path = tmp_path / "campaign.toml"
    path.write_text(f"""[campaign]
gain = 1.0
[[test]]
kind = "sweep"
files = "long.npz"
fs = {fs}
channels = {{ force = "force", velocity = "v" }}
units = {{ force = "N", velocity = "m/s" }}
""")
    (proposal,) = proposals(path)
    pasted(path, [proposal])
    assert proposals(path) == []
    (record,) = load_campaign(path).tests[0].records
    assert np.any(record.channels["force"] != 0.0)
    assert record.num_samples < 0.3 * len(t)


def proposals(path):
    (test,) = load_campaign(path).tests
    return list(long_records(test.name, test.traits, test.records[0]))


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


def stopped(u, x):
    x[-1500:] = x[-1501]
    return u, x, ""


def lost_block(u, x):
    at = len(u) // 2
    return u[:-4], np.delete(x, slice(at, at + 4)), ""


def lagging(u, x):
    return u[:-8], np.concatenate([np.zeros(8), x])[: len(u) - 8], ""


def offset(u, x):
    return u, x + 6 * np.abs(x).max(), ""


def of_a_name(u, x):
    return u, x, "level = 1000.0"


@pytest.mark.parametrize(
    ("edit", "key"),
    [
        (stopped, "span"),
        (lost_block, "span"),
        (lagging, "delay"),
        (offset, "remove_mean"),
        (of_a_name, "level"),
    ],
)
def test_a_pasted_remedy_of_a_driven_record_cures(tmp_path, edit, key):
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = np.load(tmp_path / "sweep.npz")
    u, x, more = edit(stored["u"], np.array(stored["x"]))
    np.savez(tmp_path / "sweep.npz", u=u, x=x)
    path.write_text(path.read_text() + more + "\n")
    (fault,) = faults(path)
    ((_, line),) = PUT.findall(fault.remedy)
    assert line.startswith(key)
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_a_pasted_start_of_channels_cures(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = np.load(tmp_path / "sweep.npz")
    start = np.datetime64("2026-03-01T10:00:00.000000")
    late = start + np.timedelta64(round(1e6 * 4 / 512), "us")
    with nptdms.TdmsWriter(tmp_path / "sweep.tdms") as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("Log", name, samples, properties={
                    "wf_increment": 1 / 512, "wf_start_time": begin, "wf_start_offset": 0.0,
                    "unit_string": unit,
                })
                for name, samples, begin, unit in (
                    ("u", stored["u"][:-4], start, "N"), ("x", stored["x"][4:], late, "m"),
                )
            ]
        )  # fmt: skip
    text = path.read_text().replace("sweep.npz", "sweep.tdms").replace("fs = 512.0\n", "")
    path.write_text(text.replace('"u"', '"Log.u"').replace('"x"', '"Log.x"'))
    (fault,) = faults(path)
    assert "started" in fault.what
    pasted(path, [fault.remedy])
    assert faults(path) == []


LOOP = """[campaign]
name = "loop"
[[test]]
kind = "loop"
files = "loop.npz"
channels = { displacement = "y", restoring_force = "f" }
units = { displacement = "m", restoring_force = "N" }
fs = 50.0
"""
LOOP_TIME = np.arange(4000) / 50.0
STROKE = 3e-3 * np.sin(2 * np.pi * LOOP_TIME / 8.0)  # ten cycles


def slipping(y, stiffness=1e6, slip=1.5e-3):
    """A spring and an elasto-plastic slider, sample by sample."""
    force, held = np.zeros(len(y)), 0.0
    for i in range(1, len(y)):
        held = np.clip(held + y[i] - y[i - 1], -slip, slip)
        force[i] = stiffness * (y[i] + held)
    return force


def written_loop(folder, force):
    noise = 1e-3 * np.abs(force).max() * np.random.default_rng(0).standard_normal(len(force))
    np.savez(folder / "loop.npz", y=STROKE, f=force + noise)
    path = folder / "campaign.toml"
    path.write_text(LOOP)
    return path


def turned(y):
    return -slipping(y)


def degrading(y):
    return slipping(y) * np.exp(-LOOP_TIME / 400.0)


def with_a_gap(y):
    return slipping(np.sign(y) * np.maximum(np.abs(y) - 1e-3, 0.0)) + 1e5 * y


def drifting(y):
    """A load cell that drifts: no cycle differs from the others."""
    return slipping(y) + 600.0 + 10.0 * LOOP_TIME


def hardening(y):
    return slipping(y) + 1e6 * y**3 / 3e-3**2


@pytest.mark.parametrize(
    ("made", "key", "said"),
    [
        (turned, "scale", "gives out"),
        # exp(-8 s * 8 / 400 s): from the second cycle to the ninth, of ten.
        (degrading, "span", "from the second to number 9 the force falls by 13%"),
        # 2 mm, on a grid of gaps 0.06 mm apart, and what slips behind the contact.
        (with_a_gap, "laws", "travels freely over 1.92 of 6 mm"),
        (drifting, "load_cell", "begins 12.4% of its half range away from zero and moves"),
    ],
)
def test_a_pasted_remedy_of_a_loop_cures(tmp_path, made, key, said):
    path = written_loop(tmp_path, made(STROKE))
    (fault,) = faults(path)
    assert said in fault.what
    ((_, line),) = PUT.findall(fault.remedy)
    assert line.startswith(key)
    pasted(path, [fault.remedy])
    assert faults(path) == []


@pytest.mark.parametrize("made", [slipping, hardening])
def test_a_loop_of_one_law_is_not_doubted(tmp_path, made):
    assert faults(written_loop(tmp_path, made(STROKE))) == []


@pytest.mark.parametrize(
    ("sign", "conjugate", "keys"),
    [(-1.0, False, ["scale"]), (1.0, True, ["conjugate"]), (-1.0, True, ["conjugate", "scale"])],
)
def test_a_pasted_remedy_of_a_curve_cures(tmp_path, sign, conjugate, keys):
    """A linear receptance in closed form, of the other sign or counted as exp(-j omega t)."""
    hz = np.linspace(17.0, 20.0, 61)
    omega, natural = 2 * np.pi * hz, 2 * np.pi * 18.5
    h = sign / (natural**2 - omega**2 + 0.02j * natural * omega)
    h = np.conj(h) if conjugate else h
    phase = np.unwrap(np.angle(h))
    np.savez(tmp_path / "frf.npz", f=hz, force=np.ones(61), y=np.abs(h), phase=phase)
    path = tmp_path / "campaign.toml"
    path.write_text("""[campaign]
name = "curve"
[[test]]
kind = "frf"
files = "frf.npz"
channels = { frequency = "f", force = "force", displacement = "y", phase = "phase" }
units = { frequency = "Hz", force = "N", displacement = "m", phase = "rad" }
""")
    (fault,) = faults(path)
    found = [line.split(" = ")[0] for _, line in PUT.findall(fault.remedy)]
    assert sorted(found) == keys
    pasted(path, [fault.remedy])
    assert faults(path) == []
