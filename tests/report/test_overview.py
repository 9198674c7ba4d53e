"""The channels of a record as they are drawn before any model."""

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure

from jbw.cli.check import check
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record
from jbw.report.looking import channel_overview, power_spectrum, spectrogram, time_history

FS, TONE, PEAK = 512.0, 24.0, 0.3
UNITS = {"input": "V", "velocity": "m/s"}


@pytest.fixture(scope="module")
def record():
    time = np.arange(int(8 * FS)) / FS
    velocity = PEAK * np.sin(2 * np.pi * TONE * time)
    chirp = np.cos(2 * np.pi * (8.0 + 2.0 * time) * time)
    return Record(FS, {"input": chirp, "velocity": velocity}, UNITS, "tone.h5")


def test_every_panel_has_its_unit(record):
    axes = channel_overview(record)
    assert axes.shape == (2, 3)
    labels = [text for ax in axes.flat for text in (ax.get_xlabel(), ax.get_ylabel())]
    assert all("[" in label for label in labels)
    assert axes[1, 0].get_ylabel() == "velocity [m/s]"
    assert axes[0, 1].get_ylabel() == "density [V²/Hz]"
    assert axes[0, 0].get_title(loc="left") == "tone.h5: 4096 samples at 512 Hz"


def test_the_history_spans_the_samples(record):
    ax = time_history(record, "velocity")
    (band,) = ax.collections
    x, y = band.get_paths()[0].vertices.T
    # Extremes of ten samples at 21 a period pass the peak by less than half a sample.
    assert np.ptp(y) == pytest.approx(2 * PEAK, rel=0.05)
    assert (x.min(), x.max()) == pytest.approx((0.0, 8.0), abs=0.05)


def test_the_spectrum_holds_the_power_of_a_tone(record):
    (line,) = power_spectrum(record, "velocity").lines
    freq, density = line.get_data()
    assert freq[np.argmax(density)] == TONE
    # A sine has half its squared amplitude as power.
    assert np.sum(density) * (freq[1] - freq[0]) == pytest.approx(PEAK**2 / 2, rel=1e-6)


def test_the_spectrogram_finds_the_tone_at_all_times(record):
    ax = spectrogram(record, "velocity")
    (image,) = ax.collections
    level = image.get_array().reshape(image.get_coordinates().shape[0] - 1, -1)
    rows = image.get_coordinates()[:, 0, 1]
    centre = 0.5 * (rows[:-1] + rows[1:])
    # Half of the lines' distance, and the logarithmic axis has no row at 0 Hz.
    assert np.abs(centre[np.argmax(level, axis=0)] - TONE).max() <= centre[1] - centre[0]


def test_given_axes_are_used(record):
    ax = Figure().subplots()
    assert spectrogram(record, "input", ax) is ax
    assert time_history(record, "input", ax) is ax
    assert power_spectrum(record, "input", ax) is ax
    grid = Figure().subplots(2, 3)
    assert list(channel_overview(record, grid).flat) == list(grid.flat)


def test_gaps_and_constants_are_drawn():
    gap = np.sin(np.arange(300.0))
    gap[100:120] = np.nan
    broken = Record(100.0, {"velocity": gap, "input": np.zeros(300)}, UNITS, "$gap$")
    channel_overview(broken)[0, 0].figure.draw_without_rendering()


def test_a_response_curve_is_drawn_over_its_frequency():
    freq = np.linspace(10.0, 12.0, 21)
    channels = {"frequency": freq, "force": np.ones(21), "phase": -freq}
    units = {"frequency": "Hz", "force": "N", "phase": "rad"}
    axes = channel_overview(Record(np.nan, channels, units, "curve"))
    assert axes.shape == (2, 1)
    np.testing.assert_array_equal(axes[0, 0].lines[0].get_xdata(), freq)
    assert axes[1, 0].get_ylabel() == "phase [rad]"


CAMPAIGN = """
[campaign]
name = "tones"
[[test]]
kind = "noise"
name = "a/b $x$"
files = "noise_*.h5"
level = 1.0
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }
[[test]]
kind = "noise"
name = "absent"
files = "absent_*.h5"
level = 2.0
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }
"""


def test_check_draws_what_can_be_read(tmp_path):
    rng = np.random.default_rng(0)
    samples = {role: rng.normal(size=4000) for role in UNITS}
    write_hdf5(tmp_path / "noise_1.h5", Record(FS, samples, UNITS))
    campaign = tmp_path / "campaign.toml"
    campaign.write_text(CAMPAIGN)
    folder = tmp_path / "pictures"
    done = CliRunner().invoke(check, [str(campaign), "--figures", str(folder)])
    assert "1 figure in" in done.output
    assert [path.name for path in folder.iterdir()] == ["01_a_b_x_.png"]
