"""The shaker of a test: what `jbw check` says of it, made and measured."""

import json
from dataclasses import replace

import measured_data
import numpy as np
import pytest
from click.testing import CliRunner

from jbw.campaign.schema import parse
from jbw.cli.check import check
from jbw.errors import ConfigError, DataError
from jbw.identification.shaker import read_shaker, shaker_sentence
from jbw.measurement.records import Record, Test
from jbw.measurement.shaker import fit_attachment
from jbw.oscillator.attachment import Attachment, attached

FS, NUM = 256.0, 256 * 32
OMEGA, ZETA, SHAPE = np.array([118.0, 160.0]), np.array([0.01, 0.012]), np.array([0.9, 0.6])
GAIN, MASS, DAMPING, STIFFNESS = 40.0, 0.08, 1.5, 900.0
DATA = measured_data.DATA / "f16_gvt_sinesweep"


def channels(seed=1):
    """Voltage, force, drive point and a response elsewhere, of four periods of noise."""
    rng, jw = np.random.default_rng(seed), 2j * np.pi * np.fft.rfftfreq(NUM, 1 / FS)
    v = np.fft.rfft(rng.standard_normal(NUM))
    receptance = sum(
        p**2 / (w**2 + jw**2 + 2 * z * w * jw) for w, z, p in zip(OMEGA, ZETA, SHAPE, strict=True)
    )
    force = GAIN * v / (1 + (STIFFNESS + jw * DAMPING + jw**2 * MASS) * receptance)
    moved = jw**2 * receptance * force
    made = {"input": v, "force": force, "drive_point": moved, "v": 0.7 * moved / (jw + 1e-9)}
    return {role: np.tile(np.fft.irfft(x, NUM), 4) for role, x in made.items()}


def made_test(**changed):
    record = Record(fs=FS, channels=channels() | changed, units={})
    return Test("multisine", (record,), name="noise", band_hz=(15.0, 28.0), periods=4)


def test_the_modes_with_their_shaker_are_predicted():
    found = read_shaker(made_test(), modes=2)
    # Whole periods hold no error but round-off; poles with the attachment have golden numbers.
    added = Attachment(MASS, DAMPING, STIFFNESS)
    np.testing.assert_allclose(
        [found.omega, found.zeta], attached(OMEGA, ZETA, SHAPE, added), rtol=1e-6
    )
    np.testing.assert_allclose(found.modes.residues[:, 0], SHAPE**2, rtol=1e-6)
    said = shaker_sentence("noise", found)
    assert "40 N/V" in said
    assert f"18.78 Hz (1.00 %) to {found.omega[0] / (2 * np.pi):.4g} Hz" in said


def test_noise_that_begins_and_ends_in_motion_is_faded():
    """A part of the periods that is no whole number of them."""
    cut = {role: x[1000 : 1000 + 23_000] for role, x in channels().items()}
    found = read_shaker(replace(made_test(**cut), kind="noise", periods=1), modes=2).shaker
    read = [found.gain, found.mass, found.damping, found.stiffness]
    # Hann's window over 2,600 lines: the shaker changes by a thousandth from line to line.
    np.testing.assert_allclose(read, [GAIN, MASS, DAMPING, STIFFNESS], rtol=5e-3)


def test_what_cannot_be_read_is_named():
    with pytest.raises(DataError, match="moves against the force"):
        read_shaker(made_test(force=-channels()["force"]))
    test = made_test()
    one = channels()
    spectra = np.fft.rfft(one["drive_point"])
    jw = 2j * np.pi * np.fft.rfftfreq(4 * NUM, 1 / FS)
    alone = spectra * (OMEGA[0] ** 2 + jw**2 + 2 * ZETA[0] * OMEGA[0] * jw) / (jw + 1e-9) ** 2
    force = np.fft.irfft(alone / SHAPE[0] ** 2, 4 * NUM)
    # The voltage of a stiffness alone: that of one mode.
    voltage = force + STIFFNESS * np.fft.irfft(spectra / (jw + 1e-9) ** 2, 4 * NUM)
    with pytest.raises(DataError, match="must contain a second mode"):
        fit_attachment(voltage, force, one["drive_point"], FS, (15.0, 28.0))
    with pytest.raises(DataError, match="must have a `band`"):
        read_shaker(Test("multisine", test.records, name="noise", periods=4))


def test_an_offset_of_the_voltage_changes_nothing():
    found = read_shaker(made_test(), modes=2)
    offset = read_shaker(made_test(input=5.0 + channels()["input"]), modes=2)
    np.testing.assert_allclose(offset.omega, found.omega, rtol=1e-9)  # round-off
    assert offset.shaker.band_hz == found.shaker.band_hz
    with pytest.raises(DataError, match="`voltage` is constant"):
        read_shaker(made_test(input=np.full(4 * NUM, 5.0)))


def test_a_sweep_counts_from_settle_on():
    """A record of one period, and the same with half a minute of something else before it."""
    one = {role: x[:NUM] for role, x in channels().items()}
    before = channels(seed=2)["input"][: 30 * int(FS)]
    late = {role: np.concatenate([before, x]) for role, x in one.items()}
    alone = replace(made_test(**one), kind="sweep", periods=1)
    test = replace(made_test(**late), kind="sweep", periods=1, settle=30.0)
    assert read_shaker(test).shaker.gain == read_shaker(alone).shaker.gain
    with pytest.raises(DataError, match="`settle` must leave a part"):
        read_shaker(replace(test, settle=1e4))


def test_check_says_it(tmp_path):
    np.savez(tmp_path / "a.npz", **channels())
    (tmp_path / "campaign.toml").write_text(TEXT)
    ran = CliRunner().invoke(check, [str(tmp_path / "campaign.toml"), "--json"])
    (said,) = json.loads(ran.stdout)["shakers"]
    assert "the shaker gives 40 N/V and is attached by 0.08 kg, 1.5 N s/m and 900 N/m" in said


TEXT = """[[test]]
kind = "multisine"
name = "noise"
files = "a.npz"
fs = 256.0
periods = 4
band = [15.0, 23.0]
channels = { input = "input", force = "force", drive_point = "drive_point", velocity = "v" }
units = { input = "V", force = "N", drive_point = "m/s^2", velocity = "m/s" }
"""


def test_a_drive_point_without_a_force_is_refused():
    with pytest.raises(ConfigError, match=r"add `force`, which the identification of the shaker"):
        parse(TEXT.replace('force = "force", ', "").replace('force = "N", ', ""))


def test_a_wings_shaker_at_the_lowest_level():
    path = DATA / "F16Data_SineSw_Level1.npz"
    if not path.is_file():
        pytest.skip(f"{path.name} is not in {DATA}; set JBW_DATA to the folder of the data")
    with np.load(path) as held:
        named = {"input": "Voltage", "force": "Force"}
        found = {role: np.asarray(held[name], float).ravel() for role, name in named.items()}
        found["drive_point"], found["acceleration"] = np.asarray(held["Acceleration"], float)[:2]
    record, band = Record(fs=400.0, channels=found, units={}), (6.0, 8.0)
    read = read_shaker(Test("sweep", (record,), name="level 1", band_hz=band))
    # Of one joint fitted to four levels, by force and by voltage: what it has before it slips. A
    # line of one level has the joint's damping of that level in it, six times as much.
    by_force, by_voltage = (7.359 * 2 * np.pi, 0.00083), (7.394 * 2 * np.pi, 0.00140)
    added = Attachment(read.shaker.mass, read.shaker.damping, read.shaker.stiffness)
    shape = np.sqrt(read.modes.residues[:1, 0])
    (omega,), (zeta,) = attached(*(np.array([one]) for one in by_force), shape, added)
    assert omega == pytest.approx(by_voltage[0], rel=2e-3)
    assert zeta == pytest.approx(by_voltage[1], rel=0.15)
    # 3 to 11 Hz hold the wing's neighbours, whose motion the shaker's electrical side follows.
    assert read.shaker.leftover < 0.06
