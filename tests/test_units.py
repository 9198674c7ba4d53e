"""Units: factors by definition (BIPM, NIST SP 811), spellings, refusals."""

import subprocess
import sys

import numpy as np
import pytest

from jbw.errors import ConfigError
from jbw.units import FACTORS, decibels, measured, plain, quantity_of, si_unit, to_si


@pytest.mark.parametrize(
    ("value", "unit", "quantity", "expected"),
    [
        (250.0, "mV", "voltage", 0.25),
        (2.0, "kN", "force", 2000.0),
        (1.0, "lbf", "force", 4.4482216152605),  # NIST SP 811, table B.8
        (1.0, "kip", "force", 4448.2216152605),
        (3.0, "um", "displacement", 3e-6),
        (1.0, "in", "displacement", 0.0254),
        (1.0, "in/s", "velocity", 0.0254),
        (1.0, "in/s^2", "acceleration", 0.0254),
        (4.0, "um/s^2", "acceleration", 4e-6),
        (1.0, "kgf", "force", 9.80665),
        (5.0, "mm/s", "velocity", 0.005),
        (2.0, "g", "acceleration", 19.6133),
        (1.0, "mm/s^2", "acceleration", 1e-3),
        (180.0, "deg", "angle", np.pi),
        (2 * np.pi, "rad/s", "frequency", 1.0),
        (2.0, "N/kg", "force per mass", 2.0),
        (1.0, "mil", "displacement", 2.54e-5),
        (1.0, "ft/s^2", "acceleration", 0.3048),
        (3.0, "daN", "force", 30.0),
        (60.0, "RPM", "frequency", 1.0),
        (1.0, "lbf ft", "torque", 1.3558179483314004),  # NIST SP 811, table B.8
        (180.0, "deg/s", "angular velocity", np.pi),
    ],
)
def test_factor(value, unit, quantity, expected):
    np.testing.assert_allclose(to_si(value, unit, quantity), expected, rtol=1e-15)


@pytest.mark.parametrize("written", ["µm/s²", "μm/s^2", "um/s2", "um / s**2"])
def test_spellings_of_one_unit(written):
    assert to_si(1.0, written, "acceleration") == 1e-6


@pytest.mark.parametrize(
    ("written", "quantity", "meant"),
    [("mm\\s", "velocity", "mm/s"), ("vV", "voltage", "V"), ("m/z", "velocity", "m/s")],
)
def test_unknown_unit_names_the_nearest(written, quantity, meant):
    with pytest.raises(ConfigError) as caught:
        to_si(1.0, written, quantity)
    assert f"`{written}`" in caught.value.what
    assert f"Did you mean `{meant}`?" in caught.value.remedy


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("G", "g"), ("g's", "g"), ("m/sec^2", "m/s^2"), ("m/s/s", "m/s^2"), ("m s^-2", "m/s^2"),
        ("m·s⁻²", "m/s^2"), ("ms-2", "m/s^2"), ("Newtons", "N"), ("lbs", "lbf"), ("ips", "in/s"),
        ("kips", "kip"), ("inch", "in"), ("Volt", "V"), ("HZ", "Hz"), ("sec", "s"),
        ("degrees", "deg"), ("Nm", "N m"), ("N·m", "N m"), ("N-m", "N m"), ("ft-lb", "lbf ft"),
        ("[kN]", "kN"), ("rpm", "RPM"), ("in/sec^2", "in/s^2"), ("mm/sec", "mm/s"),
    ],
)  # fmt: skip
def test_words_of_recorders_have_one_spelling(written, meant):
    assert plain(written) == meant


@pytest.mark.parametrize(
    ("unit", "factor", "powers"),
    [
        ("1/kg", 1.0, (0, -1, 0, 0, 0, 0)),
        ("g/N", 9.80665, (0, -1, 0, 0, 0, 0)),
        ("(m/s^2)/N", 1.0, (0, -1, 0, 0, 0, 0)),
        ("in/s/lbf", 0.0254 / 4.4482216152605, (0, -1, 1, 0, 0, 0)),
        ("m/(N s)", 1.0, (0, -1, 1, 0, 0, 0)),
        ("m/Ns", 1.0, (0, -1, 1, 0, 0, 0)),
        ("mm/N", 1e-3, (0, -1, 2, 0, 0, 0)),
    ],
)
def test_accelerance_mobility_and_receptance(unit, factor, powers):
    found = measured(unit)
    assert found is not None
    np.testing.assert_allclose(found[0], factor, rtol=1e-14)
    assert found[1] == powers


@pytest.mark.parametrize(
    "text", ["", "m//s", "((((((m))))))", "m^99", "(m", "x" * 1000, "m/", "°/"]
)
def test_what_is_no_compound_is_none(text):
    assert measured(text) is None


def test_decibels_state_their_reference():
    assert decibels("dB re 1e-6 m/s^2") == (1e-6, "m/s^2")
    assert decibels("dB (ref 1 m/s^2/N)") == (1.0, "m/s^2/N")
    assert decibels("dB") is None
    with pytest.raises(ConfigError, match="0 dB stands for"):
        quantity_of("dB", ("acceleration",))


def test_unit_of_another_quantity_is_refused():
    with pytest.raises(ConfigError, match=r"`V` measures a voltage, but a velocity is needed"):
        to_si(1.0, "V", "velocity")


def test_quantity_among_those_that_a_place_admits():
    assert quantity_of("N/kg", ("voltage", "force per mass")) == "force per mass"


def test_first_unit_is_si():
    assert all(FACTORS[quantity][si_unit(quantity)] == 1.0 for quantity in FACTORS)


def test_units_need_no_jax():
    code = "import sys, jbw.units; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
