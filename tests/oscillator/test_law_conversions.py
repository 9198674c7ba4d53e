"""Laws in other programs' conventions."""

import pytest

from jbw.oscillator.laws import Cubic
from jbw.oscillator.laws.bouc_wen import BoucWenLaw


def test_bouc_wen_is_known_elsewhere_and_a_spring_is_not():
    found = BoucWenLaw(500.0, 340.0, 33.0).convert(118.0, 0.005, 2.0)
    benchmark = found["hysteretic benchmark"]
    assert benchmark.values["alpha"] == pytest.approx(2.0 * 500.0)
    assert benchmark.units["alpha"] == "N/m"
    assert not benchmark.materials
    (own,) = [one.materials for one in found.values() if one.materials]
    assert [material.kind for material in own] == ["BoucWen"]
    assert Cubic(1e6).convert(118.0, 0.005, 2.0) == {}
