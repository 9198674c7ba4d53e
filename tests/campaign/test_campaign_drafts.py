"""`jbw init` on folders as laboratories leave them: structs, tables, files without names."""

import subprocess
import sys
import tomllib

import h5py
import numpy as np
import pytest
import scipy.io
from tiers import represented_by

from jbw.campaign.draft import start_campaign, write_campaign
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import read_spec
from jbw.campaign.settings import Identify
from jbw.identification.selection import decay_tests, sweep_tests

FREQ = np.linspace(79.0, 81.0, 41)


def test_struct_array_of_curves_is_a_test_each(tmp_path):
    phase = np.linspace(-0.1, -3.0, 41)
    levels = [
        {"frequency": FREQ, "force": np.full(41, k), "amplitude": k * np.ones(41), "phase": phase}
        for k in (1.0, 2.0, 3.0)
    ]
    scipy.io.savemat(tmp_path / "Curves.mat", {"FR": {"Control": levels}})
    draft = start_campaign(tmp_path)
    tables = tomllib.loads(draft.text)["test"]
    assert [table["kind"] for table in tables] == ["frf"] * 3
    assert tables[2]["channels"]["acceleration"] == "FR.Control[2].amplitude"
    assert "channel `FR.Control[0].amplitude` is a guess: acceleration" in " ".join(draft.assumed)
    assert "CHECK: acceleration is a guess" in draft.text
    with pytest.warns(UserWarning, match="passive"):  # the guess is checked like everything else
        tests = load_campaign(write_campaign(draft, tmp_path)).tests
    np.testing.assert_array_equal(tests[1].records[0].channels["force"], 2.0)


@pytest.mark.parametrize("along_rows", [True, False])
def test_rows_and_columns_of_tables_are_channels(tmp_path, along_rows):
    rng = np.random.default_rng(0)
    # From rest, as a sweep begins.
    table = np.linspace(0.0, 1.0, 4000) * rng.normal(size=(3, 4000))
    table = table if along_rows else table.T
    np.savez(
        tmp_path / "sinesweep_1.npz", Force=rng.normal(size=4000), Acceleration=table, Fs=400.0
    )
    draft = start_campaign(tmp_path)
    (test,) = tomllib.loads(draft.text)["test"]
    expected = "Acceleration[0]" if along_rows else "Acceleration[:, 0]"
    assert test["channels"] == {"force": "Force", "acceleration": expected}
    assert (test["kind"], test["fs"]) == ("sweep", "Fs")
    (loaded,) = load_campaign(write_campaign(draft, tmp_path)).tests
    first = table[0] if along_rows else table[:, 0]
    np.testing.assert_array_equal(loaded.records[0].channels["acceleration"], first)


def test_channels_without_telling_names_leave_a_form_to_fill_in(tmp_path):
    np.savez(tmp_path / "run1.npz", a=np.arange(100.0), b=np.arange(100.0))
    draft = start_campaign(tmp_path)
    assert "test" not in tomllib.loads(draft.text)
    assert '# CHECK: name the channels of "run1.npz" by hand, from "a", "b".' in draft.text
    assert "# [[test]]" in draft.text


def test_a_file_of_inputs_alone_shows_how_to_pair_it(tmp_path):
    for name in ("u", "y"):
        np.savez(tmp_path / f"{name}_1.npz", **{name: np.sin(np.arange(2000) * 0.01)})
    text = start_campaign(tmp_path).text
    assert 'files = { input = "u_1.npz", velocity = "..." }' in text
    (test,) = tomllib.loads(text)["test"]
    assert test["files"] == "y_1.npz"


def test_a_loop_is_told_by_its_channels(tmp_path):
    y = np.sin(np.arange(2000) * 0.01)
    np.savez(tmp_path / "run.npz", displacement=y, friction_force=y**3, fs=1024.0)
    (test,) = tomllib.loads(start_campaign(tmp_path).text)["test"]
    assert test["kind"] == "loop"
    assert test["channels"]["restoring_force"] == "friction_force"


@pytest.mark.parametrize(("lag", "kind"), [(0.3, "loop"), (np.pi / 2, "sweep")])
def test_a_force_that_follows_the_displacement_is_that_of_a_loop(tmp_path, lag, kind):
    phase = np.arange(2000) * 0.01
    np.savez(tmp_path / "run.npz", displacement=np.sin(phase), force=np.sin(phase + lag), fs=64.0)
    text = start_campaign(tmp_path).text
    (test,) = tomllib.loads(text)["test"]
    assert test["kind"] == kind
    assert ("restoring_force" in test["channels"]) == (kind == "loop")
    assert "# CHECK: a guess" in text


MEASURED = """
import re, sys, time
from pathlib import Path
from jbw.campaign.draft import start_campaign

few, many = (Path(folder) for folder in sys.argv[1:])
start_campaign(few)  # imports what drafting needs
seconds = []
for folder in (few, many):
    begin = time.process_time()
    text = start_campaign(folder).text
    seconds.append(time.process_time() - begin)
status = Path("/proc/self/status")
peak = re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1] if status.exists() else 0
print(text.count("[[test]]\\nkind"), peak, seconds[1] / seconds[0])
"""


@pytest.mark.slow
@pytest.mark.parametrize("counts", represented_by((60, 240), ((250, 1000),)))
def test_a_thousand_files_are_drafted_in_half_a_gigabyte_and_in_proportion(tmp_path, counts):
    t = np.arange(1024) / 1024.0
    decay = np.exp(-3 * t) * np.cos(2 * np.pi * 60.0 * t)
    lines = "\n".join(f"{a:.6g},{b:.6g}" for a, b in zip(t, decay, strict=True))
    few, many = counts
    for count in counts:
        folder = tmp_path / f"{count}"
        folder.mkdir()
        for i in range(count):
            text = f"time [s],acc [m/s^2]\n{lines}\n"
            (folder / f"tap_{i // 2}x_{i % 2}.csv").write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, str(tmp_path / f"{few}"), str(tmp_path / f"{many}")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    tests, kilobytes, ratio = done.stdout.split()
    assert int(tests) == many // 2
    assert int(kilobytes) < 500_000
    assert float(ratio) < 8.0  # four times as many files: 4 where each is read once, 16 by pairs


def test_a_draft_explains_indices_and_marks_kinds_as_guesses(tmp_path):
    np.savez(tmp_path / "run.npz", velocity=np.sin(np.arange(2000) * 0.01), fs=1024.0)
    text = start_campaign(tmp_path).text
    assert "counted from zero" in text
    assert "As in MATLAB" in text
    assert 'kind = "decay"  # CHECK: a guess' in text


def test_a_hammer_s_band_lies_where_the_curves_beside_it_do(tmp_path):
    """The suspension moves further than the mode, but no curve was measured there."""
    t = np.arange(20_000) / 1000.0
    suspension = 5e-2 * np.exp(-0.2 * t) * np.cos(2 * np.pi * 1.4 * t)
    mode = 1e-4 * np.exp(-1.5 * t) * np.cos(2 * np.pi * 80.0 * t)
    acceleration = np.gradient(np.gradient(suspension + mode, t), t)
    np.savez(tmp_path / "hammer_1.npz", acceleration=acceleration, fs=1000.0)
    alone = start_campaign(tmp_path).text
    assert "band = [0.7, 2.1]" in alone
    f = np.linspace(70.0, 90.0, 41)
    h = 1 / ((2 * np.pi * 80.0) ** 2 - (2 * np.pi * f) ** 2 + 2j * 0.003 * (2 * np.pi * f) ** 2)
    np.savez(tmp_path / "curve.npz", frequency=f, force=np.ones_like(f), displacement=np.abs(h),
             phase=np.angle(h))  # fmt: skip
    assert "band = [40.0, 120.0]" in start_campaign(tmp_path).text


def test_levels_of_a_drive_are_tests_of_their_own(tmp_path):
    """Numbered 1 to 6, with the levels 1, 1, 2, 2, 8, 8 N: three levels of two repeats."""
    t = np.arange(4096) / 512.0
    u = np.sin(2 * np.pi * (15 + 1.5 * t) * t) * np.sin(np.pi * t / t[-1])
    ratio = np.fft.rfftfreq(2 * len(t), 1 / 512.0) / 25.0
    h = -(ratio**2) / (1 - ratio**2 + 0.02j * ratio)
    response = np.fft.irfft(h * np.fft.rfft(u, 2 * len(t)))[: len(t)]
    noise = np.random.default_rng(0)
    for i, level in enumerate((2, 1, 8, 1, 2, 8)):
        force = level * u + 1e-4 * noise.standard_normal(len(t))
        measured = level * response + 0.01 * noise.standard_normal(len(t))
        channels = {"force": force, "acceleration": measured}
        np.savez(tmp_path / f"sweep_{i + 1}.npz", fs=512.0, **channels)
    draft = start_campaign(tmp_path)
    tests = tomllib.loads(draft.text)["test"]
    assert [test["level"] for test in tests] == [1.0, 2.0, 8.0]
    assert tests[0]["files"] == ["sweep_2.npz", "sweep_4.npz"]
    loaded = load_campaign(write_campaign(draft, tmp_path)).tests
    split = sweep_tests(loaded, Identify())
    assert [test.level for test in split.fitted] == [1.0, 8.0]


@pytest.mark.parametrize(
    ("names", "assemblies"),
    [
        (("tap_05Nm_1", "tap_20Nm_1"), ["05Nm", "20Nm"]),
        (("tap 5 N m 1", "tap 7.5 N m 1"), ["5 N m", "7.5 N m"]),
        (("3Nm-a", "12Nm-a"), ["12Nm", "3Nm"]),
        (("tap_20names_a", "tap_30name_b"), [None, None]),
        (("tap_05Nm_a", "tap_05Nm_b"), [None, None]),  # one torque is none to tell apart
    ],
)
def test_torques_in_names_are_assemblies(tmp_path, names, assemblies):
    t = np.arange(4096) / 512.0
    for name in names:
        x = np.exp(-t) * np.cos(2 * np.pi * 30 * t)
        np.savez(tmp_path / f"{name}.npz", acceleration=x, fs=512.0)
    draft = start_campaign(tmp_path)
    tests = tomllib.loads(draft.text)["test"]
    assert [test.get("assembly") for test in tests] == assemblies
    assert any("several torques" in line for line in draft.assumed) == (None not in assemblies)


@pytest.mark.parametrize(
    ("name", "torque"),
    [("tap_05Nm", 5.0), ("tap 7,5 N m", 7.5), ("50kgcm", 4.903325), ("10 ft-lbf", 13.558179)],
)
def test_the_one_torque_in_all_names_is_that_of_the_assembly(tmp_path, name, torque):
    x = np.exp(-np.arange(4096) / 512.0) * np.cos(np.pi * 60 * np.arange(4096) / 512.0)
    for repeat in (1, 2):
        np.savez(tmp_path / f"{name}_{repeat}.npz", acceleration=x, fs=512.0)
    path = write_campaign(start_campaign(tmp_path), tmp_path)
    assert read_spec(path).assembly.torque == pytest.approx(torque, rel=1e-5)  # six digits


def test_decays_of_one_mode_are_drafted_in_one_band(tmp_path):
    """Torques shift the mode by some percent; an identification asks for one band of all."""
    t = np.arange(4096) / 512.0
    for name, hz in (("tap_05Nm", 30.0), ("tap_10Nm", 31.0), ("tap_20Nm", 32.0)):
        x = np.exp(-t) * np.cos(2 * np.pi * hz * t)
        np.savez(tmp_path / f"{name}_1.npz", acceleration=x, fs=512.0)
    draft = start_campaign(tmp_path)
    bands = [test["band"] for test in tomllib.loads(draft.text)["test"]]
    assert bands == [[16.0, 45.0]] * 3  # from half of the highest to one and a half of the lowest
    tests = load_campaign(write_campaign(draft, tmp_path)).tests
    assert decay_tests(tests, Identify()) is not None


@pytest.mark.parametrize("name", ["fs", "Fs", "_fs_hz", "sample_rate", "SamplingRate"])
def test_the_rate_is_found_under_its_usual_names(tmp_path, name):
    velocity = np.sin(np.arange(2000) * 0.01)
    np.savez(tmp_path / "run.npz", velocity=velocity, **{name: 1024.0})
    found = f'fs = "{name}"' in start_campaign(tmp_path).text
    assert found == (name != "SamplingRate")  # of one word with others it is not known


def test_an_assumption_of_several_tests_is_one_line_and_keys_stand_once(tmp_path):
    t = np.arange(512) / 256.0
    for name in ("low_sweep", "high_sweep"):
        for i in (1, 2):
            np.savez(tmp_path / f"{name}_{i}.npz", time=t, input=np.sin(t), velocity=np.cos(t))
    draft = start_campaign(tmp_path)
    assert len(tomllib.loads(draft.text)["test"]) == 2
    about = [line for line in draft.assumed if "unit of velocity" in line]
    assert about == [
        "high_sweep_1.npz, low_sweep_1.npz: the unit of velocity is assumed to be the SI unit, m/s."
    ]
    assert draft.text.count("# level = ") == 1
    assert draft.text.index("# level = ") > draft.text.rindex("[[test]]\n")


DECAY = np.exp(-np.arange(4096) / 512) * np.cos(2 * np.pi * 20 * np.arange(4096) / 512)


@pytest.mark.parametrize("name", ["_fs_hz", "fs", "log_fs_hz", "SampleRate", "sampling_frequency"])
def test_a_scalar_that_is_called_a_rate_is_taken_for_it(tmp_path, name):
    np.savez(tmp_path / "tap_1.npz", acceleration=DECAY, **{name: 512.0})
    draft = start_campaign(tmp_path)
    (test,) = tomllib.loads(draft.text)["test"]
    assert test["fs"] == name
    (loaded,) = load_campaign(write_campaign(draft, tmp_path)).tests
    assert loaded.records[0].fs == 512.0


@pytest.mark.parametrize("place", ["file", "acceleration"])
def test_a_rate_among_the_attributes_of_hdf5_is_read(tmp_path, place):
    with h5py.File(tmp_path / "decay_1.h5", "w") as file:
        file["acceleration"] = DECAY
        (file if place == "file" else file[place]).attrs["_fs_hz"] = 512.0
    draft = start_campaign(tmp_path)
    assert "fs = " not in draft.text
    (loaded,) = load_campaign(write_campaign(draft, tmp_path)).tests
    assert loaded.records[0].fs == 512.0


@pytest.mark.parametrize(
    ("stem", "kind", "roles"),
    [
        ("run1", "...", ["force", "acceleration"]),
        ("impact_1", "decay", ["acceleration"]),
        ("loop_1", "loop", ["displacement", "restoring_force"]),
        ("noise_1", "noise", ["force", "acceleration"]),
    ],
)
def test_a_table_to_fill_in_is_of_the_files_kind_and_states_no_unit(tmp_path, stem, kind, roles):
    np.savez(tmp_path / f"{stem}.npz", a=DECAY, b=DECAY, _fs_hz=512.0)
    np.savez(tmp_path / "tap_1.npz", acceleration=DECAY, _fs_hz=512.0)  # a test beside it
    text = start_campaign(tmp_path).text
    head = text.index(f'# CHECK: name the channels of "{stem}.npz" by hand')
    # The table goes on as long as its lines are comments.
    table = text[head:].partition("\n\n")[0].splitlines()[1:]
    (drafted,) = tomllib.loads("\n".join(line.removeprefix("# ") for line in table))["test"]
    assert drafted["kind"] == kind
    assert list(drafted["channels"]) == roles
    assert set(drafted["units"].values()) == {"..."}
    assert drafted["fs"] == "_fs_hz"


@pytest.mark.parametrize("base", ["Table ctrl (g)", "Control (g)", "base (g)", "shaker_table (g)"])
def test_the_accelerometer_of_a_shaker_table_is_the_base(tmp_path, base):
    t = np.arange(2048) / 512.0
    columns = np.column_stack([t, np.sin(40 * t**2), np.cos(40 * t**2)])
    header = f"Time (s),{base},Tip (g)"
    for level in ("0.02g", "0.06g"):
        path = tmp_path / f"sweep_{level}_run1.csv"
        np.savetxt(path, columns, delimiter=",", header=header, comments="", fmt="%.6f")
    text = start_campaign(tmp_path).text
    name = base.removesuffix(" (g)")
    assert text.count('kind = "sweep"') == 2
    assert f'channels = {{ time = "Time", base = "{name}", acceleration = "Tip" }}' in text
