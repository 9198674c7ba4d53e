"""A test that cannot be used is left out with a sentence; a strict campaign refuses it."""

import numpy as np
import pytest

from jbw.campaign.settings import Identify
from jbw.errors import DataError
from jbw.identification.assemble import assemble, measured
from jbw.identification.usable import usable
from jbw.measurement.records import Record, Test

FS, HZ = 512.0, 20.0


def decay(name, seconds, zeta=0.005):
    t = np.arange(int(seconds * FS)) / FS
    noise = 1e-5 * np.random.default_rng(len(name)).normal(size=(4, t.size))
    fall = 1e-2 * np.exp(-2 * np.pi * HZ * zeta * t) * np.cos(2 * np.pi * HZ * t)
    records = tuple(Record(FS, {"velocity": fall + one}, {"velocity": "m/s"}) for one in noise)
    return Test("decay", records, name, 1.0, band_hz=(15.0, 25.0))


def test_a_decay_too_short_for_its_band_is_left_out_and_the_other_stays():
    long, short = decay("long", 8.0), decay("short", 0.1)
    kept, said = usable([long, short], Identify())
    assert kept == (long,)
    (sentence,) = said
    # The filter of a band of 10 Hz is longer than a tenth of a second.
    assert sentence.startswith("Test short is left out: A band of 10 Hz takes a record longer than")
    assert "Widen `band`" in sentence
    assert assemble(measured(kept, Identify(), gain=1.0)).labels


def test_strict_keeps_it_and_the_refusal():
    tests = [decay("long", 8.0), decay("short", 0.1)]
    kept, said = usable(tests, Identify(strict=True))
    assert kept == tuple(tests)
    assert said == ()
    with pytest.raises(DataError, match="takes a record longer than"):
        assemble(measured(kept, Identify(strict=True), gain=1.0))


def test_where_none_is_left_the_refusal_says_why():
    only = [decay("short", 0.1)]
    kept, said = usable(only, Identify())
    assert (kept, said) == (tuple(only), ())
    with pytest.raises(DataError, match="takes a record longer than"):
        assemble(measured(kept, Identify(), gain=1.0))


def test_noise_too_short_for_a_line_fit_is_left_out():
    rng = np.random.default_rng(0)
    u, v = rng.normal(size=(2, 40))
    record = Record(FS, {"input": u, "velocity": v}, {"input": "V", "velocity": "m/s"})
    noise = Test("noise", (record, record), "noise", 1.0, band_hz=(15.0, 25.0))
    long = decay("long", 8.0)
    kept, said = usable([noise, long], Identify())
    assert kept == (long,)
    assert "noise is left out: " in said[0]
