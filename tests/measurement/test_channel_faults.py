"""Faults of channels: each is found, named and given a remedy."""

import h5py
import numpy as np
import pytest
from tone_file import DRIVE, FS, LASER, ROLES, UNITS, UNITS_V, N, T, refused

from jbw.errors import ConfigError
from jbw.measurement import kinds
from jbw.measurement.files.read import read
from jbw.measurement.kinds import kind_named
from jbw.measurement.records import Test


@pytest.mark.fault(1)
@pytest.mark.parametrize("share", [1, 30, N])
def test_nan_is_counted_and_placed(tmp_path, share):
    laser = LASER.copy()
    laser[7 : 7 + share] = np.nan
    np.savez(tmp_path / "a.npz", laser=laser)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "`velocity`" in error.what
    assert f"{min(share, N - 7)} of {N}" in error.what
    assert "first at 7" in error.what
    assert "exclude" in error.remedy


@pytest.mark.fault(2)
@pytest.mark.parametrize("laser", [np.zeros(N), np.full(N, 0.3), 0.3 + (np.arange(N) % 2) * 1e-7])
def test_dead_channel(tmp_path, laser):
    np.savez(tmp_path / "a.npz", laser=laser)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "`velocity`: The channel is constant" in error.what
    assert "exclude" in error.remedy


@pytest.mark.fault(3)
def test_missing_sampling_frequency(tmp_path):
    np.savez(tmp_path / "a.npz", laser=LASER)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V)
    assert "sampling frequency is missing" in error.what
    assert "fs = HZ" in error.remedy


@pytest.mark.fault(5)
@pytest.mark.parametrize(
    ("where", "what"), [("attribute", "`shaker` is 2048"), ("argument", "the argument is 2048")]
)
def test_sampling_frequencies_that_disagree(h5, where, what):
    if where == "attribute":
        with h5py.File(h5, "a") as file:
            file["shaker"].attrs["fs"] = 2048.0
    error = refused(h5, ROLES, fs=None if where == "attribute" else 2048.0)
    assert what in error.what
    assert "is 1024 Hz" in error.what
    assert "resample" in error.remedy


@pytest.mark.fault(6)
def test_rounded_interval_is_snapped_and_said(h5):
    with h5py.File(h5, "a") as file:
        for name in ("shaker", "laser"):
            del file[name].attrs["fs"]
            file[name].attrs["dt"] = 0.000976562  # six digits, as UFF keeps them
    (record,) = read(h5, ROLES)
    assert abs((N - 1) / record.fs - (N - 1) / 1024.0) < 1e-9  # drift [s]
    assert "snapped from 1024.0005" in record.provenance["fs"]


@pytest.mark.fault(7, 8)
@pytest.mark.parametrize(
    ("spoil", "what", "remedy"),
    [
        (lambda t: t[[*range(100), 101, 100, *range(102, N)]], "sample 101", "span"),
        (lambda t: np.insert(t, 100, t[100])[:N], "sample 101", "span"),
        (lambda t: np.delete(np.append(t, N / FS), 100), "1 gap(s): 0.0966797-0.0986328", "span"),
        (lambda t: t + 0.02 / FS * np.sin(np.arange(N) * 7.0), "0.0131 off", "`resample = 1024`"),
        (lambda t: np.where(np.arange(N) == 5, np.nan, t), "sample 5", ""),
    ],
)
def test_bad_time_column(tmp_path, spoil, what, remedy):
    np.savez(tmp_path / "a.npz", t=spoil(T.copy()), laser=LASER)
    error = refused(tmp_path / "a.npz", {"time": "t", "velocity": "laser"}, UNITS_V)
    assert "`t`" in error.what
    assert what in error.what
    assert remedy in error.remedy


@pytest.mark.parametrize(("fs", "form"), [(1024.0, "%.6f"), (1000.0, "%.3f"), (51200.0, "%.8f")])
def test_printed_time_column_gives_the_round_rate(tmp_path, fs, form):
    path = tmp_path / "a.csv"
    lines = (f"{form % (n / fs)},{v:.6f}" for n, v in enumerate(LASER))
    path.write_text("time,laser\n" + "\n".join(lines))
    (record,) = read(path, {"time": "time", "velocity": "laser"}, UNITS_V)
    assert record.fs == fs


@pytest.mark.parametrize(("fs", "form"), [(512.0, "%.7g"), (1024.0, "%.7g"), (100.0, "%.6g")])
def test_times_of_so_many_significant_digits_are_even(tmp_path, fs, form):
    """As MATLAB and C write them: 9.876953, then 10.00195."""
    times = [form % (n / fs) for n in range(6000)]
    rows = "\n".join(f"{t},{v:.6f}" for t, v in zip(times, np.resize(LASER, 6000), strict=True))
    (tmp_path / "a.csv").write_text("time,laser\n" + rows)
    (record,) = read(tmp_path / "a.csv", {"time": "time", "velocity": "laser"}, UNITS_V)
    assert record.fs == fs


def test_a_jitter_of_more_than_the_digits_round_is_none_of_theirs(tmp_path):
    rng = np.random.default_rng(0)
    times = [f"{(n + 0.05 * x) / 512.0:.7g}" for n, x in enumerate(rng.standard_normal(6000))]
    rows = "\n".join(f"{t},{v:.6f}" for t, v in zip(times, np.resize(LASER, 6000), strict=True))
    (tmp_path / "a.csv").write_text("time,laser\n" + rows)
    error = refused(tmp_path / "a.csv", {"time": "time", "velocity": "laser"}, UNITS_V)
    assert "must be evenly spaced" in error.what


@pytest.mark.fault(9, 10)
def test_unit_is_required_known_and_not_contradicted(tmp_path, h5):
    np.savez(tmp_path / "a.npz", laser=LASER)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, fs=FS, error=ConfigError)
    assert "unit of role `velocity` is missing" in error.what
    error = refused(h5, ROLES, {"velocity": "m/z"}, error=ConfigError)
    assert "Role `velocity`: Unit `m/z`" in error.what
    assert "`m/s`" in error.remedy
    error = refused(h5, ROLES, {"velocity": "mm/s"})
    assert "`mm/s` in the campaign but `m/s` in the file" in error.what


def test_units_are_converted_and_said(tmp_path):
    np.savez(tmp_path / "a.npz", laser=LASER)
    (record,) = read(tmp_path / "a.npz", {"velocity": "laser"}, {"velocity": "mm/s"}, fs=FS)
    np.testing.assert_array_equal(record.channels["velocity"], LASER * 1e-3)
    assert record.units == {"velocity": "m/s"}
    assert record.provenance["unit of velocity"] == "mm/s, times 0.001"


@pytest.mark.fault(9)
def test_implausible_unit_is_doubted(tmp_path):
    np.savez(tmp_path / "a.npz", laser=LASER * 1e3)  # mm/s, taken for m/s
    with pytest.warns(UserWarning, match="is the file in mm/s"):
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)


@pytest.mark.fault(12)
def test_missing_channel_lists_what_is_there(h5):
    error = refused(h5, {"velocity": "lazer"}, UNITS_V)
    assert "role `velocity`: Channel `lazer` is not in the file" in error.what
    assert "Did you mean `laser`?" in error.remedy
    assert "shaker" in error.remedy


def test_unknown_role(h5):
    error = refused(h5, {"speed": "laser"}, error=ConfigError)
    assert "Role `speed`" in error.what
    assert "velocity" in error.remedy


@pytest.mark.fault(14)
@pytest.mark.parametrize("length", [N - 1, N + 1, N // 2])
def test_unequal_lengths(tmp_path, length):
    np.savez(tmp_path / "a.npz", shaker=DRIVE, laser=np.resize(LASER, length))
    error = refused(tmp_path / "a.npz", ROLES, UNITS, fs=FS)
    assert f"`input` has {N}" in error.what
    assert f"`velocity` has {length}" in error.what


@pytest.mark.fault(16)
def test_clipped_channel(tmp_path):
    np.savez(tmp_path / "a.npz", laser=np.clip(LASER, -1, 0.27))
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert "% of the samples are clipped, at " in error.what
    assert "exclude" in error.remedy
    once = np.concatenate([LASER, 2 * LASER[:3] / LASER[:3] * 0.3, LASER])
    np.savez(tmp_path / "a.npz", laser=once)
    with pytest.warns(UserWarning, match=r"0\.05 % of the samples are clipped, at 2\.930-2\.933 s"):
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)


@pytest.mark.fault(17)
def test_smooth_peak_of_few_bits_is_not_clipped_but_quantised(tmp_path):
    np.savez(tmp_path / "a.npz", laser=np.round(LASER / 0.3 * 100) * 0.003)
    with pytest.warns(UserWarning, match="distinct values, fewer than 256") as caught:
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert len(caught) == 1


def test_pulse_train_source_is_no_fault(tmp_path, recwarn):
    np.savez(tmp_path / "a.npz", shaker=np.sign(DRIVE), laser=LASER)
    read(tmp_path / "a.npz", ROLES, UNITS, fs=FS)
    assert not recwarn.list


def test_missing_file_names_the_nearest(h5):
    error = refused(h5.parent / "swep.h5", ROLES)
    assert "does not exist" in error.what
    assert "Did you mean `sweep.h5`?" in error.remedy


def test_rows_are_repeats(tmp_path):
    rows = np.stack([LASER, 2 * LASER, 3 * LASER])
    np.savez(tmp_path / "a.npz", laser=rows, t=T)
    error = refused(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert f"(3, {N})" in error.what
    assert "`laser[0]`" in error.remedy
    roles = {"time": "t", "velocity": "laser"}
    repeats = read(tmp_path / "a.npz", roles, UNITS_V, repeats="rows", exclude=[1])
    assert [record.name for record in repeats] == ["a.npz[0]", "a.npz[2]"]
    np.testing.assert_array_equal(repeats[1].channels["velocity"], 3 * LASER)


@pytest.mark.fault(56)
def test_paths_with_spaces_and_other_scripts(tmp_path, h5):
    folder = tmp_path / "Prüfstand 振动"
    folder.mkdir()
    moved = h5.rename(folder / "mess ung ü.h5")
    assert read(moved, ROLES)[0].name == "mess ung ü.h5"


@pytest.mark.parametrize("path", ["laser[9999999]", "laser[x]", "laser[0].a", "laser[0][0]", ""])
def test_paths_that_lead_nowhere(h5, path):
    assert "velocity" in refused(h5, {"velocity": path}, UNITS_V).what


def test_a_kind_that_nobody_knows_is_said_with_the_nearest():
    with pytest.raises(ConfigError, match="no kind of test `sweeps`") as caught:
        kind_named("sweeps")
    assert "Did you mean `sweep`?" in caught.value.remedy


def test_a_kind_of_one_s_own_is_one_registration(monkeypatch):
    monkeypatch.setattr(kinds, "KINDS", dict(kinds.KINDS))
    kinds.register(kinds.Kind("hammer", "an impact, its force recorded", is_transient=True))
    test = Test("hammer", ())
    assert test.traits.is_driven
    assert not test.is_single_tone
    assert not test.is_cyclic


def decaying(samples_a_period, bits=None, clip=None, turns=200.0):
    """A decay whose peaks are met by few samples each, of a converter of so many bits."""
    t = np.arange(int(turns * samples_a_period)) / samples_a_period
    x = np.exp(-t / 60) * np.sin(2 * np.pi * t + 0.3)
    x += 1e-4 * np.random.default_rng(5).standard_normal(len(t))
    x = x if clip is None else np.clip(x, -clip, clip)
    return x if bits is None else np.round(x * 2 ** (bits - 1)) / 2 ** (bits - 1)


@pytest.mark.parametrize("bits", [None, 16])
def test_peaks_of_one_or_two_samples_that_end_at_one_value_are_clipped(tmp_path, bits):
    np.savez(tmp_path / "a.npz", laser=decaying(9.3, bits, clip=0.92, turns=2000.0))
    with pytest.warns(UserWarning, match="of the samples are clipped, at "):
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)


@pytest.mark.parametrize("bits", [None, 16, 12])
def test_unclipped_peaks_are_not_called_clipped(tmp_path, recwarn, bits):
    # A decay; a steady sine, whose samples come near its crest; a record that repeats itself.
    steady = 0.4 * np.sin(2 * np.pi * 0.1037 * np.arange(40_000))
    steady = steady if bits is None else np.round(steady * 2 ** (bits - 1)) / 2 ** (bits - 1)
    for x in (decaying(9.3, bits), steady, np.tile(decaying(9.3, bits), 12)):
        np.savez(tmp_path / "a.npz", laser=x)
        read(tmp_path / "a.npz", {"velocity": "laser"}, UNITS_V, fs=FS)
    assert not [one for one in recwarn.list if "clipped" in str(one.message)]
