"""The command `jbw predict` under other loads: bands, CSV files, figures, refusals."""

import json
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import xarray as xr

from jbw import parts
from jbw.cli import run
from jbw.report.load_section import load_rows

OMEGA_N, ZETA, GAIN = 118.0, 0.01, 15.0
LINEAR = {"omega_n": OMEGA_N, "zeta": ZETA, "alpha": 1e-6, "delta": 1.0, "gamma": 1.0}


@pytest.fixture
def folder(tmp_path):
    """The folder of a run on a linear oscillator, of which the velocity was measured."""
    path = tmp_path / "run"
    path.mkdir()
    draws: dict[str, Any] = {
        name: (("chain", "draw"), np.full((2, 4), value))
        for name, value in {**LINEAR, "gain": GAIN}.items()
    }
    tree = xr.DataTree.from_dict({"/": xr.Dataset(), "/posterior": xr.Dataset(draws)})
    seen = {"fitted": {"kind": "sweep", "source": "V", "response": "velocity"}}
    tree.attrs.update(y_peak=1.0, tests=json.dumps(seen), held="{}")
    tree.to_netcdf(path / "posterior.nc", engine="h5netcdf")
    (path / "summary.json").write_text("{}")
    return path


def rows_of(capsys):
    return {
        (row["load"], row["quantity"], row["level"]): row
        for row in json.loads(capsys.readouterr().out)["loads"]
    }


def test_curves_at_two_levels(folder, capsys):
    arguments = ["--response", "17:20", "--level", "0.1,0.2", "--draws", "4", "--json"]
    assert run(["predict", str(folder), *arguments]) == 0
    rows = rows_of(capsys)
    peak = GAIN * 0.2 / (2 * ZETA * OMEGA_N)
    found = rows["resonance", "peak", 0.2]
    assert found["unit"] == "m/s"
    assert found["median"] == pytest.approx(peak, rel=1e-4)
    assert rows["resonance", "jump_up", 0.2]["median"] is None  # a linear curve has none
    out = folder / "predictions"
    names = {path.name for path in out.iterdir()}
    assert {"loads.nc", "loads.json", "resonance.csv", "response_at_0.2_V.csv"} <= names
    assert len(list((out / "figures").glob("*.png"))) == 3
    header, first, *_ = (out / "response_at_0.2_V.csv").read_text().splitlines()
    assert header.split(",")[:2] == ["freq [Hz]", "upward_low [m/s]"]
    omega = 2 * np.pi * 17.0
    expected = omega * GAIN * 0.2 / abs(OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    assert float(first.split(",")[2]) == pytest.approx(expected, rel=1e-4)


def test_loads_that_were_finished_before_a_full_disk_are_not_predicted_again(
    folder, capsys, monkeypatch
):
    arguments = ["--shock", "1V,11ms", "--draws", "4"]
    with monkeypatch.context() as patch:
        full = Mock(side_effect=OSError(28, "No space left on device"))
        patch.setattr("jbw.study.store.write_tree", full)
        assert run(["predict", str(folder), *arguments]) == 1
    (folder / "report.html").write_text("a page that was written in between")
    pack = Mock(wraps=parts.pack)
    monkeypatch.setattr(parts, "pack", pack)
    assert run(["predict", str(folder), *arguments]) == 0
    assert "Continuing with 1 saved part" in capsys.readouterr().err
    assert pack.call_count == 0
    assert (folder / "predictions" / "shock_time.csv").is_file()
    assert not list((folder / "predictions").glob(".*"))


def test_a_row_has_the_ends_of_its_band_in_their_order():
    values = {"peak": ("quantile", [1.0, 2.0, 4.0], {"units": "m"})}
    (row,) = load_rows("shock", xr.Dataset(values, attrs={"source_unit": "N"}))
    assert (row.low, row.median, row.high, row.level) == (1.0, 2.0, 4.0, None)


def test_a_moving_base_in_g(folder, capsys):
    arguments = ["--response", "17:20", "--level", "0.1g", "--base", "--unit", "g"]
    assert run(["predict", str(folder), *arguments, "--draws", "4", "--json"]) == 0
    rows = rows_of(capsys)
    found = next(row for key, row in rows.items() if key[:2] == ("resonance", "peak"))
    assert found["level"] == pytest.approx(0.980665)
    assert found["level_unit"] == "m/s^2"
    # Transmissibility of a damped oscillator at its displacement's peak, to zeta^2.
    assert found["median"] == pytest.approx(0.1 / (2 * ZETA), rel=1e-3)


def test_a_notch_in_words(folder, capsys):
    arguments = ["--response", "17:20", "--level", "1g", "--base", "--notch", "5g", "--unit", "g"]
    assert run(["predict", str(folder), *arguments, "--draws", "4"]) == 0
    printed = capsys.readouterr().out
    assert "--participation" in printed
    (name,) = (path for path in (folder / "predictions").glob("notch*.csv"))
    lowest = min(float(line.split(",")[2]) for line in name.read_text().splitlines()[1:])
    # The level is allowed to be the limit over the transmissibility, between frequencies.
    assert lowest == pytest.approx(5 * 9.80665 * 2 * ZETA, rel=5e-3)


def test_a_random_profile_and_a_shock(folder, tmp_path, capsys):
    profile = tmp_path / "profile.csv"
    profile.write_text("frequency [Hz], density [g^2/Hz]\n5, 0.001\n80, 0.001\n")
    arguments = ["--psd", str(profile), "--shock", "20g,11ms", "--base", "--draws", "4"]
    assert run(["predict", str(folder), *arguments, "--json"]) == 0
    rows = rows_of(capsys)
    miles = np.sqrt(0.001 * 9.80665**2 / (8 * ZETA * OMEGA_N**3))
    # The band of 5 to 80 Hz: the quasi-static part.
    assert rows["random", "displacement", None]["median"] == pytest.approx(miles, rel=3e-3)
    assert rows["shock", "largest", None]["median"] > 0
    names = {path.name for path in (folder / "predictions").iterdir()}
    assert {"random.csv", "shock.csv", "shock_time.csv"} <= names


def test_a_sine_beside_a_random_profile(folder, tmp_path, capsys):
    profile = tmp_path / "profile.csv"
    profile.write_text("frequency [Hz], density [g^2/Hz]\n5, 0.001\n80, 0.001\n")
    arguments = ["--psd", str(profile), "--sine", "40:0.5g", "--base", "--unit", "g"]
    assert run(["predict", str(folder), *arguments, "--draws", "4", "--json"]) == 0
    omega = 2 * np.pi * 40.0
    receptance = 1 / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    found = rows_of(capsys)["random", "sine", None]
    assert found["median"] == pytest.approx(0.5 * abs(1 + omega**2 * receptance), rel=1e-4)
    assert found["unit"] == "g"


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--response", "17:20"], 2, "needs --level"),
        (["--response", "17:20", "--level", "2g"], 2, "must be in V"),
        (["--sweep", "10:20", "--level", "2g"], 2, "unit of the run's source"),
        (["--response", "17:20", "--level", "x"], 2, "number"),
        (["--shock", "20g,11ms"], 2, "must be in V"),
        (["--response", "20:17", "--level", "1"], 2, "rise"),
        (["--response", "17:20", "--level", "1", "--sweep", "10:20"], 2, "separate commands"),
        (["--sweep", "10:20", "--level", "1", "--base"], 2, "needs a load"),
        (["--notch", "5", "--level", "1"], 2, "needs --response and --level"),
        (["--response", "17:20", "--level", "1", "--sine", "30:1"], 2, "needs --psd"),
        (["--psd", "profile.csv", "--sine", "30"], 2, "one frequency"),
    ],
)
def test_options_that_cannot_be_meant(folder, capsys, arguments, code, text):
    assert run(["predict", str(folder), *arguments, "--draws", "4"]) == code
    assert text in capsys.readouterr().err
