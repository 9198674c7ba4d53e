"""Remedies that a check prints, pasted into the campaign that provoked them: they cure."""

import re

import h5py
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.io import wavfile
from scipy.signal import chirp, fftconvolve

from jbw import memory
from jbw.campaign.check import check_campaign
from jbw.campaign.files import repeats_of
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import parse
from jbw.errors import ConfigError, DataError
from jbw.measurement.demodulation import FEWEST_VALUES
from jbw.measurement.envelopes import envelopes, filter_of
from jbw.measurement.spans import long_records, start_of
from jbw.units import decibels, quantity_of

FS, HZ, RATE = 600.0, 30.0, 1.1
PUT = re.compile(r"Put under \[([\w.\[\]]+?)\]: `([^`]+)`")


def decay(seconds=8.0, phase=0.3):
    t = np.arange(round(seconds * FS)) / FS
    size = np.exp(-RATE * t)
    return size * np.cos(2 * np.pi * HZ * (t - 0.01 * (1 - size) / RATE) + phase)


def with_its_trigger(x, i):
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


def test_decays_are_read_from_their_own_blows_on(tmp_path):
    path = written(tmp_path, with_its_trigger)
    assert faults(path) == []
    said = [line for line in check_campaign(path).seen if "the blow comes" in line]
    assert len(said) == 1
    assert "3 of 3 records" in said[0]
    assert "1 s to 1.2 s after the start" in said[0]
    ((test,),) = [load_campaign(path).tests]
    for i, record in enumerate(test.records):
        # Noise is that of the samples which the blow has moved back.
        blow, lost = round((1.0 + 0.1 * i) * FS), round(FS / HZ)
        whole = np.load(tmp_path / f"decay_{i}.npz")["v"]
        kept = record.channels["velocity"]
        assert len(whole) - len(kept) == pytest.approx(blow + lost, abs=2)
        np.testing.assert_array_equal(kept, whole[-len(kept) :])
        assert start_of(record) == pytest.approx((blow + lost) / FS, abs=2 / FS)


@pytest.mark.parametrize(
    ("edit", "key"),
    [
        (driven, "settle"),
        (hit_twice, "span"),
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


def test_a_stated_beginning_before_the_blow_is_refused_and_its_remedy_cures(tmp_path):
    path = written(tmp_path, with_its_trigger, band="band = [20.0, 45.0]\nsettle = 0.2")
    (fault,) = faults(path)
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_a_missing_band_is_pasted(tmp_path):
    path = written(tmp_path, lambda x, i: x, band="")
    (fault,) = faults(path)
    pasted(path, [fault.remedy])
    assert faults(path) == []


def not_finite(v):
    v[2400] = np.nan
    return v


def of_a_word(v):
    v[[700, 701, 702]] = -9999.0
    return v


def standing(v):
    v[1500:1800] = v[1499]
    return v


def clipped(v):
    return np.clip(v, -0.6 * np.abs(v).max(), 0.6 * np.abs(v).max())


def dead(v):
    return np.zeros(len(v))


LINE = re.compile(r"`((?:span|exclude|resample) = [^`]+)`")


def with_line(text, line):
    """A campaign's text with a line in its one test, in the place of what it says of the key."""
    key = line.partition(" = ")[0]
    kept = re.sub(rf"^{key} = .*\n", "", text, flags=re.MULTILINE)
    return kept.replace("[[test]]\n", f"[[test]]\n{line}\n")


@pytest.mark.parametrize("spoilt", [(1,), (0, 2), (0, 1, 2)], ids=["one", "two", "all"])
@pytest.mark.parametrize(
    ("edit", "keys"),
    [
        (not_finite, ["span", "exclude"]),
        (of_a_word, ["span", "exclude"]),
        (standing, ["span", "exclude"]),
        (clipped, ["span", "exclude"]),
        (dead, ["exclude"]),
    ],
)
def test_every_line_pasted_for_spoilt_samples_cures(tmp_path, edit, keys, spoilt):
    """Each line by itself; where all records are spoilt, none is told to leave out all of them."""
    path = written(tmp_path, lambda x, i: x)
    for i in spoilt:
        v = np.array(np.load(tmp_path / f"decay_{i}.npz")["v"])
        np.savez(tmp_path / f"decay_{i}.npz", v=edit(v))
    text = path.read_text()
    remedies = {fault.remedy for fault in faults(path) if fault.severity == "error"}
    lines = [line for remedy in remedies for line in LINE.findall(remedy)]
    if len(spoilt) == 3:
        keys = [key for key in keys if key != "exclude"]
    assert [line.partition(" = ")[0] for line in lines] == keys
    for line in lines:
        path.write_text(with_line(text, line))
        assert faults(path) == []


def test_a_span_counts_from_the_file_and_not_from_a_span_that_is_read(tmp_path):
    path = written(tmp_path, lambda x, i: x)
    v = np.array(np.load(tmp_path / "decay_1.npz")["v"])
    v[3000:3006] = np.nan  # at 5 s
    np.savez(tmp_path / "decay_1.npz", v=v)
    path.write_text(with_line(path.read_text(), "span = [1.0, 7.0]"))
    (fault,) = faults(path)
    (span, _) = LINE.findall(fault.remedy)
    assert span == "span = [1.0, 5.0]"
    path.write_text(with_line(path.read_text(), span))
    assert faults(path) == []


def test_faults_at_other_places_keep_what_their_spans_share(tmp_path):
    path = written(tmp_path, lambda x, i: x)
    for i, at in ((0, 4200), (1, 3600)):
        v = np.array(np.load(tmp_path / f"decay_{i}.npz")["v"])
        v[at] = np.nan
        np.savez(tmp_path / f"decay_{i}.npz", v=v)
    (fault,) = faults(path)
    lines = LINE.findall(fault.remedy)
    assert lines == ["span = [0.0, 6.0]", 'exclude = ["decay_0.npz", "decay_1.npz"]']
    for line in lines:
        path.write_text(with_line(path.read_text(), line))
        assert faults(path) == []


def hit_late(x, i):
    if i == 1:
        x[2700:] += 0.5 * x[:-2700]
    return x


def test_what_comes_before_a_second_blow_may_be_kept(tmp_path):
    path = written(tmp_path, hit_late)
    text = path.read_text()
    (fault,) = faults(path)
    span, exclude = LINE.findall(fault.remedy)
    assert exclude == 'exclude = ["decay_1.npz"]'
    assert float(span.split()[-1].rstrip("]")) == pytest.approx(4.5, abs=0.1)
    path.write_text(with_line(text, span))
    assert faults(path) == []


def test_a_file_of_any_name_is_excluded_by_it(tmp_path):
    path = written(tmp_path, lambda x, i: x)
    (tmp_path / "decay_1.npz").rename(tmp_path / 'decay_[1] "late".npz')
    np.savez(tmp_path / 'decay_[1] "late".npz', v=np.zeros(4800))
    (fault,) = [fault for fault in faults(path) if fault.severity == "error"]
    (line,) = LINE.findall(fault.remedy)
    path.write_text(with_line(path.read_text(), line))
    assert faults(path) == []


TIMED = """[campaign]
modal_mass = 1.0
[[test]]
kind = "decay"
files = "decay.npz"
channels = { time = "t", velocity = "v" }
units = { time = "s", velocity = "m/s" }
band = [20.0, 45.0]
"""


def with_a_gap_of_time(t):
    return t + 0.005 * (t > 6.0)


def with_two_gaps_of_time(t):
    return t + 0.005 * (t > 2.0) + 0.005 * (t > 7.0)


def swapped_once(t):
    t[100], t[101] = t[101], t[100]
    return t


def begun_again(t):
    return np.where(t > 6.0, t - 6.0, t)


@pytest.mark.parametrize(
    ("edit", "keys", "seconds"),
    [
        # Of 5 + 1.7 ms: half of 150 Hz, of which nine tenths are good, lie above 30 Hz.
        (with_a_gap_of_time, ["span", "resample"], (0.0, 6.0)),
        # Its longest part lies between 2 s and 7 s.
        (with_two_gaps_of_time, ["span", "resample"], (2.005, 7.005)),
        (swapped_once, ["span"], (0.17, 8.0)),
        (begun_again, ["span"], (0.0, 6.0)),
    ],
)
def test_every_line_pasted_for_broken_times_cures(tmp_path, edit, keys, seconds):
    x = decay()
    t = edit(np.arange(len(x)) / FS)
    v = 1e-2 * x + 1e-5 * np.random.default_rng(0).standard_normal(len(x))
    np.savez(tmp_path / "decay.npz", t=t, v=v)
    path = tmp_path / "campaign.toml"
    path.write_text(TIMED)
    (fault,) = faults(path)
    lines = LINE.findall(fault.remedy)
    assert [line.partition(" = ")[0] for line in lines] == keys
    for line in reversed(lines):
        path.write_text(with_line(TIMED, line))
        assert not [fault for fault in faults(path) if fault.severity == "error"]
    # A record begins with the first sample of its span and goes on in even steps.
    (record,) = load_campaign(path).tests[0].records
    assert record.fs == pytest.approx(FS, rel=1e-9)
    first = int(np.searchsorted(t, seconds[0] - 0.5 / FS)) if seconds[0] else 0
    np.testing.assert_array_equal(record.channels["velocity"], v[first:][: record.num_samples])
    assert record.num_samples == pytest.approx((seconds[1] - seconds[0]) * FS, abs=3)


def test_a_span_between_pauses_is_resampled_by_itself(tmp_path):
    """A tone of 90 Hz, which pauses of 0.1 s swallow, met where there is none."""
    t = np.arange(3000) / 400.0
    t = t + np.cumsum(0.02 / 400.0 * np.random.default_rng(0).standard_normal(3000))
    t = t + 0.1 * np.searchsorted([2.0, 2.5, 3.0, 3.5, 7.2], t)
    v = np.cos(2 * np.pi * 90.0 * t)
    np.savez(tmp_path / "decay.npz", t=t, v=v)
    path = tmp_path / "campaign.toml"
    path.write_text(TIMED + "resample = 400.0\n")
    (fault,) = faults(path)
    assert "differs from the omitted samples by" in fault.what
    (line,) = LINE.findall(fault.remedy)
    (test,) = parse(with_line(path.read_text(), line)).tests
    (record,) = repeats_of(test, tmp_path)
    first = float(line.split("[")[1].split(",")[0])
    time = t[0] + first + np.arange(record.num_samples) / 400.0
    inner = slice(40, -40)
    # The kernel leaves 3e-5 of a tone well within the band.
    expected = np.cos(2 * np.pi * 90.0 * time)
    np.testing.assert_allclose(record.channels["velocity"][inner], expected[inner], atol=1e-3)


# Words in capitals stand for what a file does not say: here for what was measured.
STANDING_FOR = {"HZ": str(FS), "UNIT": '"m/s"', "VALUE": "0.2"}


def filled(line):
    for word, value in STANDING_FOR.items():
        line = re.sub(rf"\b{word}\b", value, line)
    return line


@pytest.mark.parametrize(
    ("dropped", "keys"),
    [
        ('time = "t", ', ["channels", "fs"]),
        (', velocity = "m/s"', ["units"]),
    ],
)
def test_what_a_campaign_lacks_is_told_as_a_line(tmp_path, dropped, keys):
    x = decay()
    t = np.arange(len(x)) / FS
    np.savez(tmp_path / "decay.npz", t=t, v=1e-2 * x)
    path = tmp_path / "campaign.toml"
    text = TIMED.replace(dropped, "").replace('time = "s", velocity', "velocity")
    path.write_text(text)
    (fault,) = faults(path)
    lines = re.findall(r"`(\w+ = [^`]+)`", fault.remedy)
    assert [line.partition(" = ")[0] for line in lines] == keys
    for line in lines:
        path.write_text(with_line(text, filled(line)))
        assert faults(path) == []
        (record,) = load_campaign(path).tests[0].records
        np.testing.assert_array_equal(record.channels["velocity"], 1e-2 * x)
        assert record.fs == FS


def test_a_rate_that_times_belie_gives_way_to_them(tmp_path):
    x = decay()
    np.savez(tmp_path / "decay.npz", t=np.arange(len(x)) / FS, v=1e-2 * x)
    path = tmp_path / "campaign.toml"
    text = TIMED.replace('time = "t", ', "").replace('time = "s", ', "")
    path.write_text(text + "fs = 590.0\n")
    (fault,) = faults(path)
    assert fault.remedy.endswith("and take `fs` out.")
    (line,) = re.findall(r"`(\w+ = [^`]+)`", fault.remedy)
    path.write_text(with_line(text, line))
    assert faults(path) == []
    assert load_campaign(path).tests[0].records[0].fs == FS


def test_the_value_at_full_scale_is_told_as_a_line(tmp_path):
    x = decay()
    counts = np.round(32767 * x / np.abs(x).max()).astype(np.int16)
    wavfile.write(tmp_path / "decay.wav", round(FS), counts)
    path = tmp_path / "campaign.toml"
    text = TIMED.replace("npz", "wav").replace('time = "t", ', "").replace('time = "s", ', "")
    text = text.replace('"v"', '"channel"')
    path.write_text(text)
    (fault,) = faults(path)
    (line,) = re.findall(r"`(\w+ = [^`]+)`", fault.remedy)
    path.write_text(with_line(text, filled(line)))
    assert faults(path) == []
    (record,) = load_campaign(path).tests[0].records
    np.testing.assert_allclose(record.channels["velocity"], 0.2 * counts / 32768.0, rtol=1e-12)


@pytest.mark.parametrize("rate", ["", "fs = 600.0\n"])
def test_a_pasted_part_of_a_huge_channel_is_read(tmp_path, monkeypatch, rate):
    """Of 4,800 samples at 600 Hz where 1,200 are read at once."""
    x = decay()
    with h5py.File(tmp_path / "decay.h5", "w") as file:
        dataset = file.create_dataset("v", data=1e-2 * x)
        dataset.attrs.update({"fs": FS} if rate == "" else {})
    monkeypatch.setattr(memory, "MAX_BYTES", 8 * 1200)
    path = tmp_path / "campaign.toml"
    text = TIMED.replace("npz", "h5").replace('time = "t", ', "").replace('time = "s", ', "") + rate
    path.write_text(text)
    (fault,) = faults(path)
    assert "A channel of shape (4800,) takes" in fault.what
    if rate:  # the file knows no rate, by which samples would be seconds
        assert (
            fault.remedy == "Read at most 1200 samples of the channel at once, by the key `span`."
        )
        return
    (line,) = LINE.findall(fault.remedy)
    assert line == "span = [0.0, 2]"
    path.write_text(with_line(text, line))
    assert faults(path) == []
    (record,) = load_campaign(path).tests[0].records
    np.testing.assert_array_equal(record.channels["velocity"], 1e-2 * x[:1200])


def test_decibels_without_a_reference_are_told_with_one():
    with pytest.raises(ConfigError) as refused:
        quantity_of("dB", ("acceleration",))
    (unit,) = re.findall(r'0 dB: "([^"]+)"', refused.value.remedy)
    assert decibels(unit) == (1.0, "m/s^2")


def test_a_decay_without_a_band_is_told_one_when_it_is_fitted(tmp_path):
    path = written(tmp_path, lambda x, i: x, band="")
    (test,) = load_campaign(path).tests
    with pytest.raises(DataError) as refused:
        filter_of(test)
    pasted(path, [refused.value.remedy])
    (test,) = load_campaign(path).tests
    assert filter_of(test).centre_hz == pytest.approx(HZ, rel=0.2)


def test_a_band_too_narrow_for_the_record_is_widened(tmp_path):
    path = written(tmp_path, lambda x, i: x[:1500], band="band = [29.0, 31.0]")
    (fault,) = faults(path)
    assert "values in `band` = [29, 31] Hz" in fault.what
    pasted(path, [fault.remedy])
    assert faults(path) == []
    (test,) = load_campaign(path).tests
    least = FEWEST_VALUES * filter_of(test).step
    assert all(len(envelope) >= least for envelope in envelopes(test))


def test_of_four_periods_nothing_is_read(tmp_path):
    path = written(tmp_path, lambda x, i: x[: round(4 * FS / HZ)], band="band = [25.0, 35.0]")
    (fault,) = faults(path)
    assert "4 periods" in fault.why
    assert fault.remedy == "Measure longer, or shorten `settle`."


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
    fault, unexplained = sorted(faults(path), key=lambda fault: "explained neither" in fault.what)
    assert "outside 9.6 to 14 Hz" in fault.what or "outside 25 to 37 Hz" in fault.what
    assert "`band` may contain several modes" in unexplained.remedy
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


def test_a_pasted_sign_of_all_repeats_cures(tmp_path):
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = dict(np.load(tmp_path / "sweep.npz"))
    np.savez(tmp_path / "sweep.npz", u=stored["u"], x=-stored["x"])
    (fault,) = faults(path)
    assert "the gain is negative" in fault.what
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_the_acceleration_of_a_base_is_named_and_its_remedy_cures(tmp_path):
    """Absolute acceleration of 30 Hz and 1 % on a base whose acceleration is called force."""
    fs, seconds = 1000.0, 20.0
    t = np.arange(round(seconds * fs)) / fs
    base = chirp(t, 24.0, seconds, 36.0)
    s = 2 * np.pi * 30.0 * (-0.01 + 1j)
    ringing = np.imag(np.exp(s * t)) / s.imag / fs  # of y'' + 2 zeta w y' + w^2 y = -base
    relative = -fftconvolve(base, ringing)[: len(t)]
    relative = np.gradient(np.gradient(relative, 1 / fs), 1 / fs)
    noise = 1e-3 * np.std(relative) * np.random.default_rng(5).standard_normal(len(t))
    path = tmp_path / "campaign.toml"
    path.write_text(
        '[[test]]\nname = "swept"\nkind = "sweep"\nband = [25, 35]\n'
        f'files = "sweep.npz"\nfs = {fs}\n'
        'channels = { force = "u", acceleration = "x" }\n'
        'units = { force = "N", acceleration = "m/s^2" }\n'
    )
    np.savez(tmp_path / "sweep.npz", u=base, x=relative + base + noise)
    (fault,) = faults(path)
    assert "as a structure on a moving base does" in fault.what
    np.savez(tmp_path / "sweep.npz", u=base, x=relative + noise)  # as the remedy asks
    line = re.findall("with `(scale = .*)`", fault.remedy)[0]
    path.write_text(f"{path.read_text()}{line}\n")
    assert faults(path) == []


@pytest.mark.parametrize(("factor", "written"), [(-1.0, "-1.0"), (9.80665, "9.8")])
def test_a_repeat_that_was_turned_over_is_cured_in_a_test_of_its_own(tmp_path, factor, written):
    """Three sweeps of a linear mode, of one the response is turned over, or in another unit."""
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = dict(np.load(tmp_path / "sweep.npz"))
    for i in range(3):
        x = stored["x"] * (factor if i == 1 else 1.0)
        x += 1e-4 * np.std(x) * np.random.default_rng(i).standard_normal(len(x))
        np.savez(tmp_path / f"sweep_{i + 1}.npz", u=stored["u"], x=x)
    text = path.read_text().replace('"sweep.npz"', '"sweep_*.npz"')
    path.write_text(text)
    (fault,) = faults(path)
    ((_, line),) = PUT.findall(fault.remedy)
    assert line.startswith(f"scale = {{ force = {written}")
    others = text.replace('"sweep_*.npz"', '["sweep_1.npz", "sweep_3.npz"]')
    turned = text.replace('"sweep_*.npz"', '"sweep_2.npz"').partition("[[test]]")[2]
    path.write_text(f'{others}name = "others"\n[[test]]{turned}name = "turned"\n{line}\n')
    assert faults(path) == []


@pytest.mark.parametrize("which", [1, 2, 3])
@pytest.mark.parametrize(("factor", "written"), [(1 / 9.80665, "0.101972"), (0.0254, "0.0254")])
def test_a_test_in_another_unit_is_cured_by_the_unit(tmp_path, factor, written, which):
    """Three sweeps of a linear mode, the acceleration of one written in another unit."""
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = dict(np.load(tmp_path / "sweep.npz"))
    for i in (1, 2, 3):
        x = stored["x"] * (factor if i == which else 1.0)
        x += 1e-3 * np.std(x) * np.random.default_rng(i).standard_normal(len(x))
        np.savez(tmp_path / f"sweep_{i}.npz", u=stored["u"], x=x)
    head, _, table = path.read_text().partition("[[test]]")
    tables = {
        i: f'[[test]]{table.replace("sweep.npz", f"sweep_{i}.npz")}name = "at {i}"\n'
        for i in (1, 2, 3)
    }
    path.write_text(head + "".join(tables.values()))
    (fault,) = faults(path)
    assert f"in at {which} is" in fault.what
    ((_, line),) = PUT.findall(fault.remedy)
    assert line == f"scale = {{ force = {written} }}"
    tables[which] += f"{line}\n"
    path.write_text(head + "".join(tables.values()))
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


def late(y):
    return np.interp(LOOP_TIME - 0.41, LOOP_TIME, slipping(y))


def hardening(y):
    return slipping(y) + 1e6 * y**3 / 3e-3**2


@pytest.mark.parametrize(
    ("made", "key", "said"),
    [
        (turned, "scale", "falls where the displacement rises"),
        # exp(-8 s * 8 / 400 s): from the second cycle to the ninth, of ten.
        (degrading, "span", "from cycle 2 to cycle 9 the force falls by 13 %"),
        # 2 mm, on a grid of gaps 0.06 mm apart, and what slips behind the contact.
        (with_a_gap, "laws", "moves freely over 1.92 mm, at an amplitude of 6 mm"),
        # Twenty samples and a half.
        (late, "delay", "The force lags the displacement by"),
        (
            drifting,
            "load_cell",
            "begins 12.4 % of its half range away from zero and moves by 16.5 %",
        ),
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


def test_a_load_cell_of_a_third_of_the_rate_is_accounted_for_by_its_lag(tmp_path):
    path = written_loop(tmp_path, slipping(STROKE))
    stored = np.load(tmp_path / "loop.npz")
    held = np.repeat(stored["f"][::3], 3)[: len(STROKE)]
    np.savez(tmp_path / "loop.npz", y=stored["y"], f=held)
    (fault,) = faults(path)
    assert "is repeated for 3 samples" in fault.what
    pasted(path, [fault.remedy.replace(", or put under", ". Put under")])
    assert faults(path) == []


@pytest.mark.parametrize("made", [slipping, hardening])
def test_a_loop_of_one_law_is_not_doubted(tmp_path, made):
    assert faults(written_loop(tmp_path, made(STROKE))) == []


def test_lines_of_a_curve_that_are_lost_are_masked(tmp_path):
    """A linear receptance in closed form, of which two lines are no numbers."""
    hz = np.linspace(17.0, 20.0, 61)
    omega, natural = 2 * np.pi * hz, 2 * np.pi * 18.5
    h = 1 / (natural**2 - omega**2 + 0.02j * natural * omega)
    h[[20, 40]] = np.nan
    np.savez(tmp_path / "frf.npz", f=hz, h=h)
    path = tmp_path / "campaign.toml"
    path.write_text(RATIO)
    (fault,) = faults(path)[:1]
    pasted(path, [fault.remedy])
    assert all("are not finite; gaps" in doubt.what for doubt in faults(path))


def test_a_curve_that_folds_is_told_its_kind(tmp_path):
    r"""A softening mode under one force, in closed form, measured along its fold.

    $$(\omega_0^2 (1 - c a) - \omega^2)^2 + (2 \zeta \omega_0^2)^2 = (F / a)^2$$
    """
    natural, zeta, softening, force = 2 * np.pi * 20.0, 0.005, 50.0, 0.5
    peak = force / (2 * zeta * natural**2)
    a = peak * np.sin(np.linspace(0.05, 0.5 * np.pi, 60))
    away = np.sqrt(np.maximum((force / a) ** 2 - (2 * zeta * natural**2) ** 2, 0.0))
    stiffness = natural**2 * (1 - softening * a)
    squares = np.concatenate([stiffness - away, (stiffness + away)[-2::-1]])
    y = np.concatenate([a, a[-2::-1]])
    stiffness = np.concatenate([stiffness, stiffness[-2::-1]])
    phase = -np.arctan2(2 * zeta * natural**2, stiffness - squares)
    hz = np.sqrt(squares) / (2 * np.pi)
    assert np.count_nonzero(np.diff(np.sign(np.diff(hz)))) == 2  # it folds
    np.savez(tmp_path / "frf.npz", f=hz, force=np.full(len(hz), force), y=y, phase=phase)
    path = tmp_path / "campaign.toml"
    path.write_text(AMPLITUDES.replace("[[test]]", "modal_mass = 1.0\n[[test]]"))
    (fault,) = faults(path)
    assert 'kind = "curve"' in fault.remedy
    pasted(path, [fault.remedy])
    assert faults(path) == []
    (test,) = load_campaign(path).tests
    np.testing.assert_allclose(test.records[0].channels["frequency"], hz)  # in its order
    # A jumble of lines is no curve.
    mixed = np.random.default_rng(0).permutation(len(hz))
    np.savez(tmp_path / "frf.npz", f=hz[mixed], force=np.full(len(hz), force), y=y, phase=phase)
    path.write_text(path.read_text().replace('kind = "curve"', 'kind = "frf"'))
    assert any("Sort the lines" in fault.remedy for fault in faults(path))


AMPLITUDES = """[campaign]
name = "curve"
[[test]]
kind = "frf"
files = "frf.npz"
channels = { frequency = "f", force = "force", displacement = "y", phase = "phase" }
units = { frequency = "Hz", force = "N", displacement = "m", phase = "rad" }
"""
RATIO = """[campaign]
name = "curve"
[[test]]
kind = "frf"
files = "frf.npz"
channels = { frequency = "f", displacement = "h" }
units = { frequency = "Hz", displacement = "m/N" }
"""


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
    path.write_text(AMPLITUDES)
    (fault,) = faults(path)
    found = [line.split(" = ")[0] for _, line in PUT.findall(fault.remedy)]
    assert sorted(found) == keys
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_a_sign_that_is_turned_keeps_the_calibration_of_every_channel(tmp_path):
    """A load cell of 1 kN a volt and a stroke in centimetres, stated as factors."""
    path = written_loop(tmp_path, turned(STROKE))
    stored = dict(np.load(tmp_path / "loop.npz"))
    np.savez(tmp_path / "loop.npz", y=stored["y"] / 0.01, f=stored["f"] / 1e3)
    path.write_text(path.read_text() + "scale = { displacement = 0.01, restoring_force = 1e3 }\n")
    (fault,) = faults(path)
    pasted(path, [fault.remedy])
    assert faults(path) == []
    (record,) = load_campaign(path).tests[0].records
    sizes = [np.abs(record.channels[role]).max() for role in ("displacement", "restoring_force")]
    expected = [np.abs(STROKE).max(), np.abs(stored["f"]).max()]
    np.testing.assert_allclose(sizes, expected, rtol=1e-12)


def test_a_phase_in_degrees_keeps_the_units_of_other_channels(tmp_path):
    hz = np.linspace(17.0, 20.0, 61)
    omega, natural = 2 * np.pi * hz, 2 * np.pi * 18.5
    h = 1 / (natural**2 - omega**2 + 0.02j * natural * omega)
    phase = np.degrees(np.angle(h))
    np.savez(tmp_path / "frf.npz", f=hz, force=np.ones(61), y=np.abs(h) * 1e3, phase=phase)
    path = tmp_path / "campaign.toml"
    path.write_text(AMPLITUDES.replace('displacement = "m"', 'displacement = "mm"'))
    (fault,) = faults(path)
    (line,) = re.findall(r"units = \{[^}]*\}", fault.remedy)
    path.write_text(with_line(path.read_text(), line))
    assert faults(path) == []
    assert load_campaign(path).tests[0].records[0].units["displacement"] == "m"


@pytest.mark.parametrize("at", [0.2, 0.45, 0.8])
def test_a_multisine_is_cut_to_whole_periods_beside_a_gap(tmp_path, at):
    """Ten periods of a linear mode under a multisine, with zeros for a while."""
    rng, size, periods = np.random.default_rng(3), 512, 10
    force = np.fft.irfft(np.exp(2j * np.pi * rng.random(size // 2 + 1)), size)
    hz = np.fft.rfftfreq(size, 1 / 512.0)
    x = np.fft.irfft(np.fft.rfft(force) / (40.0**2 - hz**2 + 1.6j * hz), size)
    x = np.tile(x, periods) + 1e-4 * np.std(x) * rng.standard_normal(size * periods)
    x[round(at * len(x)) :][:30] = 0.0
    np.savez(tmp_path / "steady.npz", u=np.tile(force, periods), x=x)
    path = tmp_path / "campaign.toml"
    path.write_text(
        f'[[test]]\nkind = "multisine"\nfiles = "steady.npz"\nfs = 512.0\nperiods = {periods}\n'
        'channels = { force = "u", acceleration = "x" }\n'
        'units = { force = "N", acceleration = "m/s^2" }\n'
    )
    (gap,) = [fault for fault in faults(path) if "constant" in fault.what]
    for line in re.findall(r"`(span = .*?)` and `(periods = \d+)`", gap.remedy)[0]:
        path.write_text(with_line(path.read_text(), line))
    assert [fault for fault in faults(path) if fault.severity == "error"] == []


@pytest.mark.parametrize("each", [2, 3])
def test_values_that_are_held_are_accounted_for_by_the_delay(tmp_path, each):
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = np.load(tmp_path / "sweep.npz")
    held = np.repeat(stored["x"][::each], each)[: len(stored["x"])]
    np.savez(tmp_path / "sweep.npz", u=stored["u"], x=held)
    (fault,) = [fault for fault in faults(path) if "is repeated" in fault.what]
    line = re.findall(r"`(delay = .*?)`", fault.remedy)[0]
    path.write_text(with_line(path.read_text(), line))
    assert faults(path) == []


@pytest.mark.parametrize("at", [0.08, 0.5])
def test_of_a_broken_decay_the_part_that_tells_most_is_kept(tmp_path, at):
    """Frequency and rate are known to 1 / (duration, root of energy), so the head is not enough."""
    from_sample, to_sample = round(8 * at * FS), round(8 * at * FS) + 20

    def broken(x, i):
        x[from_sample:to_sample] = np.nan
        return x

    path = written(tmp_path, broken)
    (fault,) = faults(path)
    first, last = map(float, re.findall(r"span = \[(.*?), (.*?)\]", fault.remedy)[0])
    kept = (to_sample / FS, 8.0) if at < 0.1 else (0.0, from_sample / FS)
    assert (first, last) == pytest.approx(kept, abs=1 / FS)
    pasted(path, [fault.remedy])
    assert faults(path) == []


def test_a_part_too_short_to_be_read_is_not_proposed(tmp_path):
    """Four periods between gaps: every part of the decay is shorter than its filter."""

    def broken(x, i):
        x[80::80] = np.nan
        return x

    path = written(tmp_path, broken, band="band = [27.0, 33.0]")
    (fault,) = faults(path)
    assert "span" not in fault.remedy


def test_drop_outs_are_told_alone(tmp_path):
    """Zeros of a laser look like gaps, lines and further modes, all without a cure of their own."""
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = dict(np.load(tmp_path / "sweep.npz"))
    rng = np.random.default_rng(4)
    for start in rng.integers(2000, len(stored["x"]) - 100, 30):
        stored["x"][start : start + 3] *= 1e-3
    np.savez(tmp_path / "sweep.npz", **stored)
    (fault,) = faults(path)
    assert "drop-outs" in fault.what


def test_a_sweep_that_would_begin_in_motion_is_left_out(tmp_path):
    """Zeros shortly before the resonance: the part behind them holds most of the motion."""
    path = tmp_path / "campaign.toml"
    of_two_modes(path, 0.0)
    stored = dict(np.load(tmp_path / "sweep.npz"))
    top = int(np.argmax(np.abs(stored["x"])))
    stored["x"][top - 60 : top - 30] = 0.0
    np.savez(tmp_path / "sweep.npz", **stored)
    gaps = [fault for fault in faults(path) if "constant" in fault.what]
    assert gaps
    assert not any("span" in fault.remedy for fault in gaps)
