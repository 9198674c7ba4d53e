"""Probing tests that cannot tell the joint: refused with the number and what to measure."""

from dataclasses import replace

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.identification.paper.kernel import reduce
from jbw.measurement.probing import ThirdOrder

OMEGA_N = 118.0  # [rad/s]


def kernel(omega, repeats=4, above_noise=True):
    rng = np.random.default_rng(0)
    h3 = 1e-9 * (1 + 0.01 * (rng.normal(size=repeats) + 1j * rng.normal(size=repeats)))
    ones = np.ones(repeats)
    return ThirdOrder(
        omega=omega, h3=h3, amplitude=ones, u_3=0 * ones, y_1=ones, y_3=ones, y_peak=ones,
        source="removed", source_ratio=0.0, std=1e-11, std_expected=1e-11,
        covariance=np.eye(2) * 1e-22, above_noise=above_noise, notes=(),
    )  # fmt: skip


@pytest.mark.fault(22)
def test_buried_harmonics_are_dropped_and_fewer_than_two_refused():
    heard, buried = [kernel(omega) for omega in (31.0, 34.0)], kernel(38.0, above_noise=False)
    assert list(reduce([*heard, buried], OMEGA_N).omega) == [31.0, 34.0]
    with pytest.raises(DataError) as caught:
        reduce([heard[0], buried, replace(buried, omega=40.0)], OMEGA_N)
    assert "at least 2 probing frequencies" in caught.value.what
    assert "found 1 of 3" in caught.value.what
    assert "Raise the level" in caught.value.remedy


@pytest.mark.fault(30, 32)
def test_one_repeat_has_no_scatter_to_tell_its_noise():
    with pytest.raises(DataError) as caught:
        reduce([kernel(31.0), kernel(2 * np.pi * 5.5, repeats=1)], OMEGA_N)
    assert "5.5 Hz needs at least 2 repeats to estimate its noise, but has 1" in caught.value.what
    assert "Measure repeats" in caught.value.remedy
