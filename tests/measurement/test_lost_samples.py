"""Numbers that a logger writes for samples that it lost: far from all that was measured."""

import numpy as np
import pytest

from jbw.measurement.faults.channels import inspect
from jbw.measurement.records import Record

FS = 1000.0
T = np.arange(8000) / FS
MOTION = 0.02 * np.sin(2 * np.pi * (15.0 * T + 0.6 * T**2))


def said(x, role="velocity"):
    return [(fault.severity, fault.what) for fault in inspect(Record(FS, {role: x}, {role: ""}))]


def lost(x, value, places):
    x = x.copy()
    x[places] = value
    return x


@pytest.mark.parametrize("code", [-9999.0, -999.0, 99999.0, 9.999])
@pytest.mark.parametrize("places", [slice(5000, 5040), slice(0, 3), [77]])
def test_a_word_for_a_lost_sample_is_named_and_nothing_else_of_it(code, places):
    ((severity, what),) = said(lost(MOTION, code, places))
    assert severity == "error"
    count, first = len(MOTION[places]), (np.arange(8000)[places])[0]
    assert what == (
        f"{count} of 8000 samples are {code:g} in SI units, the first at {first / FS:.4g} s; "
        "all other samples lie between -0.02 and 0.02."
    )


def test_words_of_both_signs_are_named_each():
    both = lost(lost(MOTION, 9999.0, [5, 6]), -9999.0, [700])
    assert [what.split(",")[0] for _, what in said(both)] == [
        "1 of 8000 samples are -9999 in SI units", "2 of 8000 samples are 9999 in SI units",
    ]  # fmt: skip


def test_a_clipped_channel_lost_nothing():
    assert all("clipped" in what for _, what in said(np.clip(MOTION, -0.01, 0.01)))


def test_a_pulse_of_a_source_is_no_lost_sample():
    """A blow of one sample over noise, and a train of such blows between two values."""
    quiet = 1e-4 * np.random.default_rng(0).standard_normal(8000)
    assert said(lost(quiet, 100.0, [40]), "force") == []
    train = np.where(T % 1.0 < 0.5, 1.0, 0.0)
    assert said(train, "force") == []
    edges = lost(lost(train, 0.5, slice(500, None, 1000)), 0.52, slice(0, None, 1000))
    assert said(edges, "force") == []


def test_a_decay_from_its_first_sample_on_is_sound():
    decay = 1e-2 * np.exp(-40.0 * T) * np.cos(2 * np.pi * 100.0 * T)
    noise = 1e-6 * np.random.default_rng(0).standard_normal(8000)
    assert said(decay + noise) == []
