"""What of a campaign becomes evidence: a group that cannot tell its own noise does not."""

import numpy as np
import pytest

from jbw.campaign.settings import Identify
from jbw.errors import DataError
from jbw.identification.assemble import assemble, measured
from jbw.measurement.records import Record, Test

FS, HZ = 512.0, (5.0, 6.0)


def tone(hz, repeats, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(4096) / FS
    records = tuple(
        Record(
            FS,
            {
                "input": np.cos(2 * np.pi * hz * t),
                "displacement": 1e-4 * np.cos(2 * np.pi * hz * t - 0.1)
                + 1e-6 * np.cos(6 * np.pi * hz * t)
                + 1e-9 * rng.normal(size=t.size),
            },
            {"input": "N/kg", "displacement": "m"},
        )
        for _ in range(repeats)
    )
    return Test("tones", records, f"tone_{hz:g}", 1.0, (hz,))


def gathered(*tests):
    return assemble(measured(tests, Identify(), gain=1.0))


def test_one_tone_with_one_repeat_is_left_out_and_said_to_be():
    with (
        pytest.warns(UserWarning, match=r"one frequency and one repeat.*tone_5 order 1"),
        pytest.raises(DataError, match="no test to which the joint can be fitted"),
    ):
        gathered(tone(5.0, 1))


def test_repeats_or_a_second_frequency_tell_the_noise():
    assert any("tone_5" in label for label in gathered(tone(5.0, 2)).labels)
    together = gathered(*(tone(hz, 1) for hz in HZ))
    assert any(label.startswith("tones 1") for label in together.labels)
