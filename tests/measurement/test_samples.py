"""Values that are held for several samples, and drop-outs."""

import numpy as np
import pytest

from jbw.measurement.faults.channels import drop_outs, held_for, inspect
from jbw.measurement.records import Record

FS, SIZE = 2048.0, 8192


def ringing(rng, noise=1e-3):
    t = np.arange(SIZE) / FS
    clean = np.exp(-2 * t) * np.cos(2 * np.pi * 80 * t)
    return clean + noise * rng.standard_normal(SIZE)


@pytest.mark.parametrize("each", [2, 3, 7])
@pytest.mark.parametrize("first", [0, 1])
def test_a_held_value_is_told_with_the_rate_it_was_recorded_at(each, first):
    x = np.repeat(ringing(np.random.default_rng(each)), each)[first:]
    assert held_for(x) == (each, (each - first) % each)
    (fault,) = inspect(Record(FS, {"velocity": x}, {"velocity": "m/s"}))
    assert f"repeated for {each} samples" in fault.what
    assert f"{FS / each:.6g} Hz" in fault.what


def test_a_converter_of_few_bits_holds_nothing():
    """Its equal neighbours stand where the signal is slow, and not at multiples of samples."""
    x = np.round(ringing(np.random.default_rng(0)) * 60)
    assert np.mean(np.diff(x) == 0) > 0.4
    assert held_for(x)[0] == 1


@pytest.mark.parametrize("seed", range(5))
def test_drop_outs_are_found_where_they_are(seed):
    rng = np.random.default_rng(seed)
    x = ringing(rng)
    places = np.sort(rng.choice(np.arange(100, 4000, 50), 20, replace=False))
    loud = [at for at in places if abs(x[at]) > 0.05]
    for at in places:
        x[at : at + 3] *= 0.05
    found = drop_outs(x)
    # A sample near a crossing of zero drops by less than noise: no other is missed or invented.
    assert set(found) <= {*places.tolist(), *(places + 1).tolist(), *(places + 2).tolist()}
    assert len(set(loud) - set(found)) <= 1
    faults = inspect(Record(FS, {"velocity": x}, {"velocity": "m/s"}))
    assert [fault.what for fault in faults if "nearly zero" in fault.what]


@pytest.mark.parametrize("seed", range(5))
def test_impacts_and_a_second_blow_are_no_drop_outs(seed):
    rng = np.random.default_rng(seed)
    x = ringing(rng)
    x[rng.integers(0, SIZE, 20)] += 0.5 * rng.choice([-1, 1], 20)
    x[5000:] += ringing(rng)[: SIZE - 5000]
    assert drop_outs(x) == []
    assert drop_outs(ringing(rng)) == []
    assert drop_outs(rng.standard_normal(SIZE)) == []


@pytest.mark.parametrize("seed", range(5))
def test_single_steps_of_a_converter_at_rest_are_no_drop_outs(seed):
    """Noise of 0.28 steps: most samples are rounded to zero, so that their robust scale is zero."""
    k = np.arange(60_000)
    first = np.exp(-14.5 * k / len(k)) * np.cos(2 * np.pi * k / 36)
    second = 0.5 * np.exp(-10 * k / len(k)) * np.cos(2 * np.pi * k * 2.35 / 36)
    noise = 0.28 * np.random.default_rng(seed).standard_normal(len(k))
    assert drop_outs(np.round(400 * (first + second) + noise)) == []


def test_held_values_are_accounted_for_by_the_delay_that_is_proposed():
    x, each = ringing(np.random.default_rng(0)), 3
    channels = {"force": x, "velocity": np.repeat(x[::each], each)[:SIZE]}
    record = Record(FS, channels, {"force": "N", "velocity": "m/s"})
    (fault,) = inspect(record)
    assert f"`delay = {1 / FS:.4g}`" in fault.remedy  # the mean of 0, 1 and 2 samples
    assert inspect(record, delay_s=1 / FS) == ()
    assert inspect(record, delay_s=-4 / FS) != ()
