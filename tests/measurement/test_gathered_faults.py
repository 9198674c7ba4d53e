"""One doubt a test, with the count and the reach of its numbers."""

import warnings

import numpy as np

from jbw.cli import run
from jbw.measurement.faults.fault import doubt, gathered, refusal, told_together
from jbw.measurement.files.hdf5 import write_hdf5
from jbw.measurement.records import Record


def test_eight_records_of_one_doubt_are_one_with_the_reach_of_its_numbers():
    found = [(f"noise_{i}.h5", doubt("input", f"Coherence is 0.{i} at 18.5 Hz.")) for i in range(8)]
    (one,) = gathered(found, 9)
    assert one.what == "8 of 9 records: Coherence is 0.0 to 0.7 at 18.5 Hz."
    assert (one.severity, one.channel) == ("warning", "input")


def test_other_channels_other_words_and_errors_stay_apart():
    found = [
        ("a", doubt("input", "It is 3.")),
        ("b", doubt("velocity", "It is 3.")),
        ("b", doubt("input", "It was 3.")),
        ("a", refusal("input", "Lost 3.")),
        ("b", refusal("input", "Lost 4.")),
    ]
    told = [one.what for one in gathered(found, 2)]
    assert told == ["a: It is 3.", "b: It is 3.", "b: It was 3.", "a: Lost 3.", "b: Lost 4."]


def test_negative_numbers_and_powers_reach_by_their_size():
    found = [("", doubt("", f"By {x} s.")) for x in ("-2e-3", "1e-4", "-3")]
    assert gathered(found, 3)[0].what == "3 of 3 records: By -3 to 1e-4 s."


def test_warnings_of_a_test_are_told_together():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with told_together("noise", 3):
            for x in (0.1, 0.2, 0.3):
                warnings.warn(f"Finer by {x}.", stacklevel=1)
    told = [str(each.message) for each in caught]
    assert told == ["Test noise: 3 of 3 records: Finer by 0.1 to 0.3."]


def test_a_check_says_it_once_a_test(tmp_path, capsys):
    """Eight sweeps that begin in motion: one line, not eight."""
    rng, t = np.random.default_rng(0), np.arange(2000) / 512
    for i in range(8):
        samples = {
            "force": np.sin(2 * np.pi * (5 + 4 * t) * t),
            "velocity": (1 + 0.1 * i) * np.cos(2 * np.pi * 18 * t) + 0.01 * rng.normal(size=2000),
        }
        units = {"force": "N", "velocity": "m/s"}
        write_hdf5(tmp_path / f"sweep_{i}.h5", Record(512.0, samples, units))
    assert run(["init", str(tmp_path)]) == 0
    assert run(["check", str(tmp_path / "campaign.toml")]) == 0
    said = capsys.readouterr().out
    assert said.count("of the usual motion") == 1
    assert "8 of 8 records: The motion at the start of the record is" in said
