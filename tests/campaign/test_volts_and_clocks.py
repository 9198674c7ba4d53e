"""Sensors in volts, clocks of several files, and what a draft asks of unclear columns."""

import tomllib

import numpy as np
import pytest
from pasted import lines_of

from jbw.campaign.check import check_campaign
from jbw.campaign.draft import start_campaign
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import parse
from jbw.errors import ConfigError, JbwError
from jbw.measurement.records import sensitivity_of

G = 9.80665
FS = 512.0
T = np.arange(4096) / FS
DECAY = np.exp(-0.6 * T) * np.cos(2 * np.pi * 20.0 * T)  # 20 Hz, 0.477 %
TEST = """[campaign]
name = "volts"
[[test]]
kind = "decay"
files = "{files}"
channels = {{ time = "time", acceleration = "acc" }}
band = [15.0, 25.0]
{lines}
"""


def table(folder, columns, header, name="tap_1.csv"):
    np.savetxt(folder / name, np.stack(columns, 1), delimiter=",", header=header, comments="",
               fmt="%.9g")  # fmt: skip


def loaded(folder, lines, files="tap_1.csv"):
    path = folder / "campaign.toml"
    path.write_text(TEST.format(files=files, lines=lines))
    return load_campaign(path).tests[0]


@pytest.mark.parametrize(
    ("role", "written", "volts", "unit"),
    [
        ("acceleration", "100 mV/g", 0.1, "g"),
        ("velocity", "40 mV/(mm/s)", 0.04, "mm/s"),
        ("velocity", "2 V/(m/s)", 2.0, "m/s"),
        ("force", "-11.2 mV/N", -0.0112, "N"),
        ("displacement", "0.2 V/mm", 0.2, "mm"),
        ("acceleration", "10.2 mV/(m/s^2)", 0.0102, "m/s^2"),
    ],
)
def test_a_sensitivity_is_volts_per_unit(role, written, volts, unit):
    assert sensitivity_of(role, written) == (pytest.approx(volts, rel=1e-12), unit)


@pytest.mark.parametrize("written", ["100", "100 mV", "mV/g", "100 mV/N", "0 mV/g", "1 A/g"])
def test_what_is_no_sensitivity_is_refused(written):
    with pytest.raises(ConfigError, match="volts per unit"):
        sensitivity_of("acceleration", written)


@pytest.mark.parametrize(("unit", "factor"), [("V", 1.0), ("mV", 1e3), ("", 1.0)])
def test_volts_become_accelerations_by_the_sensitivity(tmp_path, unit, factor):
    table(tmp_path, (T, 0.05 * factor * DECAY), f"time [s],acc{unit and f' [{unit}]'}")
    test = loaded(tmp_path, 'sensitivity = { acceleration = "100 mV/g" }')
    np.testing.assert_allclose(test.records[0].channels["acceleration"], 0.5 * G * DECAY, atol=1e-7)
    assert test.records[0].provenance["sensitivity of acceleration"] == "100 mV/g"


IN_G = 'units = { acceleration = "g" }'


@pytest.mark.parametrize("lines", ["", IN_G, IN_G + "\nscale = { acceleration = 10.0 }"])
def test_the_line_about_volts_cures(tmp_path, lines):
    table(tmp_path, (T, 0.05 * DECAY), "time [s],acc [V]")
    with pytest.raises(JbwError) as caught:
        loaded(tmp_path, lines)
    ((_, line),) = lines_of(caught.value.remedy)
    record = loaded(tmp_path, f"{lines}\n{line}").records[0]
    # The example is 100 mV/g; a factor of 10 beside the unit g is that of one volt.
    np.testing.assert_allclose(record.channels["acceleration"], 0.5 * G * DECAY, atol=1e-7)


def test_a_sensitivity_of_a_channel_in_its_own_unit_is_refused(tmp_path):
    table(tmp_path, (T, DECAY), "time [s],acc [m/s^2]")
    with pytest.raises(ConfigError, match="for a channel in volts"):
        loaded(tmp_path, 'sensitivity = { acceleration = "100 mV/g" }')
    with pytest.raises(ConfigError, match="names role `velocity`"):
        loaded(tmp_path, 'sensitivity = { velocity = "1 V/(m/s)" }')


def test_a_draft_offers_the_sensitivity_of_a_channel_in_volts(tmp_path):
    table(tmp_path, (T, 0.05 * DECAY), "time [s],acc [V]")
    draft = start_campaign(tmp_path)
    offered = next(x for x in draft.text.splitlines() if x.startswith("# sensitivity"))
    assert "CHECK" in offered
    (test,) = parse(draft.text.replace(offered, offered.removeprefix("# "))).tests
    assert test.sensitivity == {"acceleration": "100 mV/g"}
    assert test.band[0] < 20.0 < test.band[1]


def test_files_of_clocks_that_differ_by_1e_5_are_one_test(tmp_path):
    rates = (1024.0, 1024.0107, 1023.9931)
    for i, fs in enumerate(rates):
        t = np.arange(8192) / fs
        table(tmp_path, (t, np.exp(-0.6 * t) * np.cos(2 * np.pi * 20 * t)), "time [s],acc [m/s^2]",
              f"tap_{i + 1}.csv")  # fmt: skip
    test = loaded(tmp_path, "", "tap_*.csv")
    # Nine digits of times up to 8 s.
    np.testing.assert_allclose([record.fs for record in test.records], rates, rtol=2e-9)
    assert check_campaign(tmp_path / "campaign.toml").exit_code == 0


def test_one_clock_printed_from_two_origins_has_one_rate(tmp_path):
    fs = 2441.40625
    for i, begins in enumerate((0.0, 3.3333337)):
        t = np.round(begins + np.arange(8192) / fs, 6)
        x = np.exp(-t) * np.cos(2 * np.pi * 20 * t)
        lines = (f"{a:.6f},{b:.7f}" for a, b in zip(t, x, strict=True))
        (tmp_path / f"tap_{i + 1}.csv").write_text("time [s],acc [g]\n" + "\n".join(lines) + "\n")
    first, second = loaded(tmp_path, "", "tap_*.csv").records
    # Half a digit at either end of 3.4 s.
    assert first.fs == second.fs == pytest.approx(fs, rel=1e-6 / 3.3)


def test_rates_that_no_two_clocks_have_are_two_tests(tmp_path):
    for i, fs in enumerate((1024.0, 1024.5)):
        t = np.arange(8192) / fs
        table(tmp_path, (t, np.cos(40 * t)), "time [s],acc [m/s^2]", f"tap_{i + 1}.csv")
    with pytest.raises(JbwError, match=r"1024\.5 Hz and tap_1\.csv has 1024 Hz"):
        loaded(tmp_path, "", "tap_*.csv")


# --- what a draft asks ---


def drafted(folder):
    draft = start_campaign(folder)
    return draft, tomllib.loads(draft.text).get("test", [])


def test_a_column_that_counts_samples_is_no_clock(tmp_path):
    table(tmp_path, (np.arange(4096), DECAY), "Time,acc [g]")
    draft, (test,) = drafted(tmp_path)
    assert test["channels"] == {"acceleration": "acc"}
    assert "# fs = 1024.0  # CHECK" in draft.text
    assert any("Time counts samples" in line for line in draft.assumed)


def test_times_without_a_unit_are_marked(tmp_path):
    table(tmp_path, (1000 + 2 * np.arange(4096), DECAY), "time,acc [g]")
    draft, (test,) = drafted(tmp_path)
    assert test["units"]["time"] == "ms"
    assert "not in the file, for time" in draft.text
    assert any("unit of the channel of times" in line for line in draft.assumed)


def test_a_stated_rate_tells_the_unit_of_times(tmp_path):
    table(tmp_path, (2 * np.arange(4096), DECAY), "# Sample rate: 500 Hz\ntime,acc [g]")
    draft, (test,) = drafted(tmp_path)
    assert test["units"]["time"] == "ms"
    assert not any("unit of the channel of times" in line for line in draft.assumed)


def test_times_of_too_few_digits_are_drafted_as_their_rate(tmp_path):
    table(tmp_path, (np.round(T, 3), DECAY), "time [s],acc [g]")
    _, (test,) = drafted(tmp_path)
    assert "time" not in test["channels"]
    assert test["fs"] == pytest.approx(FS, rel=1e-3)


def test_an_elapsed_time_is_taken_before_a_date(tmp_path):
    hours = 36000.0 + np.round(T, 1)
    table(tmp_path, (T, hours, DECAY), "Elapsed time [s],Time of day [s],acc [g]")
    assert drafted(tmp_path)[1][0]["channels"]["time"] == "Elapsed time"


def test_three_axes_are_a_question(tmp_path):
    table(tmp_path, (T, 0.1 * DECAY, DECAY, 0.2 * DECAY), "time [s],acc x [g],acc y [g],acc z [g]")
    draft, (test,) = drafted(tmp_path)
    assert test["channels"]["acceleration"] == "acc y"
    assert 'CHECK: acceleration may be any of "acc x", "acc y", "acc z"' in draft.text


def test_a_word_of_time_is_no_displacement(tmp_path):
    table(tmp_path, (T, DECAY, T / 60), "time [s],Voltage [V],Minute [m]")
    assert drafted(tmp_path)[1] == []


def test_names_that_do_not_fit_the_columns_are_said(tmp_path):
    table(tmp_path, (T, DECAY), "time,a_x,a_y,a_z")
    draft, tests = drafted(tmp_path)
    assert tests == []
    assert "# CHECK: the header of the file names 4 columns (time, a_x, a_y, a_z)" in draft.text


@pytest.mark.parametrize("corner", [1.0, 3.0])
def test_a_cyclic_test_without_a_clock_is_a_loop(tmp_path, corner):
    """An elastic and perfectly plastic force, slow: loops fatter than a lag tells."""
    y = np.concatenate([a * np.sin(np.linspace(0, 2 * np.pi, 400)) for a in (1, 2, 4, 8)])
    force, moved = [0.0], np.diff(y)
    for step in moved:
        force.append(float(np.clip(force[-1] + step, -corner, corner)))
    header = "Actuator Force [kN],Actuator Displacement [mm]"
    table(tmp_path, (np.array(force), y), header, "specimen_1.csv")
    draft, (test,) = drafted(tmp_path)
    assert test["kind"] == "loop"
    assert test["units"] == {"restoring_force": "kN", "displacement": "mm"}
    assert "CHECK: a guess" in draft.text


def test_a_motion_of_metres_is_doubted(tmp_path):
    table(tmp_path, (T, 9.0 * DECAY), "time [s],acc [g]")
    loaded(tmp_path, "")
    assert "metres" not in str(check_campaign(tmp_path / "campaign.toml").rows)
    table(tmp_path, (T, 9.0 * DECAY), "time [ms],acc [g]")
    lines = 'units_are = "mine"\nunits = { time = "h", acceleration = "g" }'
    slow = TEST.format(files="tap_1.csv", lines=lines).replace("[15.0, 25.0]", "[0.004, 0.007]")
    (tmp_path / "campaign.toml").write_text(slow)
    faults = [f for row in check_campaign(tmp_path / "campaign.toml").rows for f in row.findings]
    assert any("In the stated units, the motion is" in fault.what for fault in faults)
