"""Samples that a recorder filled in: equal ones amid motion, found whatever the scale."""

import numpy as np
import pytest

from jbw.measurement.faults.channels import inspect
from jbw.measurement.records import Record

FS = 1000.0


def ring(seconds=6.0, noise=1e-3, bits=None):
    t = np.arange(round(seconds * FS)) / FS
    x = np.exp(-0.5 * t) * np.cos(2 * np.pi * 21.0 * t + 0.4)
    x = x + noise * np.random.default_rng(0).standard_normal(len(x))
    return x if bits is None else np.round(x * 2 ** (bits - 1)) / 2 ** (bits - 1)


def found(x, role="velocity"):
    faults = inspect(Record(FS, {role: 1e-2 * x}, {role: "m/s"}))
    return [fault.what for fault in faults if "response is constant" in fault.what]


@pytest.mark.parametrize("bits", [None, 24, 16, 12])
def test_zeros_amid_motion_are_named(bits):
    x = ring(bits=bits)
    x[2000:2460] = 0.0
    said = "The response is constant at 2-2.46 s, with motion before and after: 1 gap."
    assert found(x) == [said]


def test_three_blocks_are_listed():
    x = ring()
    for start in (500, 1500, 2500):
        x[start : start + 8] = 0.0
    (what,) = found(x)
    assert "at 0.5-0.508 s, 1.5-1.508 s, 2.5-2.508 s, with motion before and after: 3 gaps" in what


def test_a_held_value_is_named():
    x = ring()
    x[1000:1100] = x[999]
    assert len(found(x)) == 1


def test_zeros_to_the_end_are_doubted_and_a_span_leaves_them_out():
    x = ring()
    x[3005:] = 0.0
    (fault,) = inspect(Record(FS, {"velocity": x}, {"velocity": "m/s"}))
    assert fault.severity == "warning"
    assert fault.what == "The response is constant from 3.005 s to the end of the record."
    assert fault.remedy == "Put under [[test]]: `span = [0.0, 3.005]`."
    assert found(x[:3000]) == []


@pytest.mark.parametrize("bits", [None, 24, 16, 12, 10, 9])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_a_decay_of_few_bits_is_not_doubted(bits, noise):
    assert found(ring(20.0, noise, bits)) == []


@pytest.mark.parametrize("bits", [16, 12, 10])
def test_quiet_before_a_blow_is_not_doubted(bits):
    quiet = np.round(1e-3 * np.random.default_rng(1).standard_normal(1000) * 2 ** (bits - 1))
    x = np.concatenate([quiet / 2 ** (bits - 1), ring(bits=bits)])
    assert found(x) == []


def test_rest_before_a_drive_is_not_doubted():
    assert found(np.concatenate([np.zeros(500), ring()])) == []


def test_a_source_may_pause():
    x = ring()
    x[2000:2460] = 0.0
    assert found(x, "force") == []
