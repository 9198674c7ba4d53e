"""Laws in other programs' conventions."""

import json
from pathlib import Path

import pytest

from jbw.oscillator.laws import Cubic
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.bouc_wen_nu import BoucWenNu
from jbw.oscillator.laws.iwan import Iwan4
from jbw.oscillator.laws.valanis import Valanis

GOLDEN = json.loads((Path(__file__).parents[1] / "golden_laws.json").read_text())


def test_bouc_wen_is_known_elsewhere_and_a_spring_is_not():
    found = BoucWenLaw(500.0, 340.0, 33.0).convert(118.0, 0.005, 2.0)
    benchmark = found["hysteretic benchmark"]
    assert benchmark.values["alpha"] == pytest.approx(2.0 * 500.0)
    assert benchmark.units["alpha"] == "N/m"
    assert not benchmark.materials
    (own,) = [one.materials for one in found.values() if one.materials]
    assert [material.kind for material in own] == ["BoucWen"]
    assert Cubic(1e6).convert(118.0, 0.005, 2.0) == {}


@pytest.mark.parametrize("name", ["iwan4_a", "iwan4_b"])
def test_the_bouc_wen_law_of_the_same_weak_motion_is_golden(name):
    """Closed forms to round-off of the gamma function."""
    row = GOLDEN[name]
    law = Iwan4.of_segalman(*(row[key] for key in ("KT", "FS", "chi", "beta")))
    known = row["bouc_wen_equivalent"]
    found = BoucWenNu.of_masing(known["alpha"], law.iwan_loss, 1.0 + law.iwan_chi)
    scale = 1e-3 ** known["nu"]  # jbw states the loss of slope at 1 mm
    assert float(found.nu) == pytest.approx(known["nu"], rel=1e-12)
    assert float(found.nu_softening) == pytest.approx(known["delta_scaled"] * scale, rel=1e-12)
    assert float(found.nu_opening) == pytest.approx(known["gamma_scaled"] * scale, rel=1e-12)


def test_dahls_law_is_the_limit_of_lugres_and_a_bouc_wen_law():
    row = GOLDEN["lugre"]
    dahl = Valanis.dahl(row["sigma0"], row["F_c"]).bouc_wen_limit()
    known = row["bouc_wen_limit"]
    for name, value in dahl.parameters().items():
        assert value == pytest.approx(known[name], rel=1e-12)
