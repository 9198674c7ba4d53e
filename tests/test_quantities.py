"""Quantities: one dialect of units, old ones still read."""

import subprocess
import sys

import pytest
from dialect import GRAMMAR, readable

from jbw.errors import ConfigError
from jbw.identification.step import attrs
from jbw.oscillator.laws import vocabulary
from jbw.quantities import BY_NAME, derivative_order, gain_unit, in_dialect, per


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rad s-1", "rad/s"),
        ("m s-2", "m/s^2"),
        ("m-1 s-2", "1/(m s^2)"),
        ("m^-2 s^6", "s^6/m^2"),
        ("rad m^-4 s^11", "rad s^11/m^4"),
        ("N kg-1 per unit of input", "N/kg per unit of input"),
        ("m/s^2", "m/s^2"),
        ("m/(N/kg)", "m/(N/kg)"),
        ("1", "1"),
        ("", ""),
    ],
)
def test_old_dialects_are_read(old, new):
    assert in_dialect(old) == new
    assert in_dialect(new) == new


def test_every_quantity_has_a_unit_of_the_dialect_and_a_symbol():
    for name, own in {**attrs(), **{n: each.attrs for n, each in BY_NAME.items()}}.items():
        assert readable(own["units"]), (name, own["units"])
        assert own["symbol"]
        assert own["long_name"]


@pytest.mark.parametrize("wrong", ["rad s-1", "m^-2 s^6", "unit of the group", "m per unit"])
def test_the_grammar_refuses_other_dialects(wrong):
    assert not GRAMMAR.fullmatch(wrong)


def test_units_of_a_gain_and_of_a_receptance():
    # N/kg over V; N/kg over N is one over a mass; N/kg over N/kg a number.
    assert [gain_unit(unit) for unit in ("V", "N", "N/kg")] == ["N/kg/V", "1/kg", "1"]
    assert [per("m", unit) for unit in ("V", "N/kg")] == ["m/V", "m/(N/kg)"]


def test_order_of_the_derivative():
    responses = ("displacement", "velocity", "acceleration")
    assert [derivative_order(response) for response in responses] == [0, 1, 2]
    with pytest.raises(ConfigError, match="jerk"):
        derivative_order("jerk")


def test_the_table_loads_no_jax():
    code = "import sys, jbw.quantities; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_pint_reads_every_unit_of_the_tables():
    pint = pytest.importorskip("pint")
    registry = pint.UnitRegistry()
    units = {each.unit for each in (*BY_NAME.values(), *vocabulary().values())}
    units |= {gain_unit(source) for source in ("V", "N", "N/kg")}
    assert {"rad/s", "1/m", "N/kg/V", "1/s^2"} <= units
    known = {"[length]", "[mass]", "[time]", "[current]"}
    for unit in units:
        # Base dimensions of a vibration alone: no prefix or name that happens to be a unit.
        assert set(registry.parse_units(unit).dimensionality) <= known, unit
    assert registry.parse_units("N/kg") == registry.newton / registry.kilogram
    assert registry.parse_units("1/(m^2 s^2)") == (registry.meter * registry.second) ** -2
