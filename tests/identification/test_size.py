"""The size of a fit, and the line that makes it smaller."""

from dataclasses import replace

import numpy as np
import pytest
from pasted import pasted

from jbw.identification import size
from jbw.identification.size import announced
from jbw.measurement.records import Record, Test
from jbw.measurement.resampled import at_rate
from jbw.observables.dataset import Dataset
from jbw.observables.records import Records
from jbw.report.messages import stages

HZ = 19.0  # a spectral line of records of whole seconds


def sweep(fs, seconds):
    t = np.arange(round(fs * seconds)) / fs
    u = np.sin(2 * np.pi * HZ * t)
    record = Record(fs, {"input": u, "velocity": 1e-2 * u}, {"input": "N/kg", "velocity": "m/s"})
    return Test("sweep", (record,), "long", 1.0)


def reported(test):
    heard = []
    data = Dataset.of(Records.reduce([test]))
    announced(heard.append, stages.least_squares, data)
    return heard


def test_a_short_fit_states_its_time_steps_alone():
    (sentence,) = reported(sweep(1024.0, 4.0))
    # 4,096 samples, and two steps between two samples
    assert (
        sentence
        == "Least squares: all parameters from 1 data group, 8,192 time steps per simulation"
    )


@pytest.fixture
def slow(monkeypatch):
    """A fit with a hundred times as many evaluations, so that short records suffice here."""
    monkeypatch.setattr(size, "EVALUATIONS", 500_000)


@pytest.mark.usefixtures("slow")
def test_a_long_fit_proposes_a_rate_that_shortens_it():
    test = sweep(20_480.0, 2.0)
    _, sentence = reported(test)
    # 81,920 steps of 13.3 ns, 500,000 times: 545 s
    assert "about 9.1 minutes" in sentence
    (stated,) = pasted(sentence).tests
    rate = stated.resample
    assert rate == np.ceil(40 * HZ)
    (record,) = test.records
    channels = {name: at_rate(x, record.fs, rate)[0] for name, x in record.channels.items()}
    (sentence,) = reported(replace(test, records=(Record(rate, channels, record.units),)))
    assert "3,040 time steps" in sentence


@pytest.mark.usefixtures("slow")
def test_a_long_fit_at_a_low_rate_proposes_a_part_of_the_record():
    _, sentence = reported(sweep(1024.0, 32.0))
    assert "resample" not in sentence
    assert "with the key `span`" in sentence
