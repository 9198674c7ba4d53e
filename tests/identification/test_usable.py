"""A test that cannot be used is left out with a sentence; a strict campaign refuses it."""

import warnings
from types import SimpleNamespace

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
    kept, said, _ = usable([long, short], Identify())
    assert kept == (long,)
    (sentence,) = said
    # The filter of a band of 10 Hz is longer than a tenth of a second.
    assert sentence.startswith("Test short is left out: A band of 10 Hz needs a record longer than")
    assert "Widen `band`" in sentence
    assert assemble(measured(kept, Identify(), gain=1.0)).labels


def test_strict_keeps_it_and_the_refusal():
    tests = [decay("long", 8.0), decay("short", 0.1)]
    kept, said, _ = usable(tests, Identify(strict=True))
    assert kept == tuple(tests)
    assert said == ()
    with pytest.raises(DataError, match="needs a record longer than"):
        assemble(measured(kept, Identify(strict=True), gain=1.0))


def test_where_none_is_left_the_refusal_says_why():
    only = [decay("short", 0.1)]
    kept, said, _ = usable(only, Identify())
    assert (kept, said) == (tuple(only), ())
    with pytest.raises(DataError, match="needs a record longer than"):
        assemble(measured(kept, Identify(), gain=1.0))


def test_noise_too_short_for_a_line_fit_is_left_out():
    rng = np.random.default_rng(0)
    u, v = rng.normal(size=(2, 40))
    record = Record(FS, {"input": u, "velocity": v}, {"input": "V", "velocity": "m/s"})
    noise = Test("noise", (record, record), "noise", 1.0, band_hz=(15.0, 25.0))
    long = decay("long", 8.0)
    kept, said, _ = usable([noise, long], Identify())
    assert kept == (long,)
    assert "noise is left out: " in said[0]


def test_step_2_is_run_once_and_warns_where_it_is_taken_up(monkeypatch):
    ran = []

    def step(test, *_):
        ran.append(test.name)
        warnings.warn("Lines are coarse.", stacklevel=2)
        return SimpleNamespace(test=test)

    for module in ("linear_step", "assemble"):
        monkeypatch.setattr(f"jbw.identification.{module}.linear_step", step)
    channels = {"input": np.ones(512), "velocity": np.ones(512)}
    record = Record(FS, channels, {"input": "V", "velocity": "m/s"})
    noise = Test("noise", (record, record), "noise", 1.0, band_hz=(15.0, 25.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept, _, line_fit = usable([noise, decay("long", 8.0)], Identify())
    with pytest.warns(UserWarning, match="Lines are coarse"):
        seen = measured(kept, Identify(), gain=1.0, line_fit=line_fit)
    assert ran == ["noise"]
    assert seen.linear.test is noise


def tones(run, hz=6.0, repeats=1):
    t = np.arange(2048) / FS
    channels = {"input": np.sin(2 * np.pi * hz * t), "velocity": 1e-3 * np.cos(2 * np.pi * hz * t)}
    record = Record(FS, channels, {"input": "V", "velocity": "m/s"})
    return Test("tones", (record,) * repeats, f"tone {run}", 0.5, tones_hz=(hz,), run=run)


def test_tones_of_three_days_that_tell_no_noise_are_named_in_one_warning():
    """A trial gives none, so that tests which `fit` leaves out are not said to be not fitted."""
    tests = [decay("long", 8.0), *(tones(f"day {i}") for i in (1, 2, 3))]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept, *_ = usable(tests, Identify())
        assemble(measured(kept, Identify(fit=["decay"]), gain=1.0))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assemble(measured(kept, Identify(), gain=1.0))
    (told,) = [str(one.message) for one in caught if "Not fitted" in str(one.message)]
    assert all(f"tone day {i} order 1" in told for i in (1, 2, 3))
