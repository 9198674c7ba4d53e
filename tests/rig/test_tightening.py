"""Joints that follow a torque: powers by hand, scatter, and the campaigns of a fleet."""

import numpy as np
import pytest
from scipy.stats import linregress

from jbw import rig
from jbw.campaign.load import load_campaign
from jbw.errors import ConfigError, ModelError
from jbw.oscillator.laws import law_named
from jbw.oscillator.oscillator import Oscillator
from jbw.rig.tightening import SCATTERING, Tightening, measure_fleet, tightened
from jbw.units import powers_of

QUIET = {"scatter": dict.fromkeys(SCATTERING, 0.0)}
SWEEP = "sweep_0p10V"


@pytest.mark.parametrize(
    ("unit", "powers"),
    [("1", {}), ("1/s^2", {"s": -2}), ("1/(m^2 s^2)", {"m": -2, "s": -2}), ("m", {"m": 1}),
     ("N/kg", {"N": 1, "kg": -1}), ("m/s^2", {"m": 1, "s": -2})],
)  # fmt: skip
def test_a_units_powers(unit, powers):
    assert powers_of(unit) == powers


@pytest.mark.parametrize(
    ("path", "p", "stiffness", "displacement"),
    # The contact is stiffer by N^p and slips at mu N. In series what it adds is 1/k, and its slip
    # a force over the load's stiffness; in parallel it is k itself, and its slip the force over it.
    [("series", 0.5, -0.5, 1.0), ("series", 0.8, -0.8, 1.0), ("parallel", 0.5, 0.5, 0.5)],
)
def test_parameters_are_powers_of_the_torque_by_their_units(path, p, stiffness, displacement):
    how = Tightening(load_path=path, contact=p, **QUIET)
    twice = 2.0 * how.reference
    at_torque = tightened(rig.TRUTH, twice, how)
    assert at_torque.omega_n == pytest.approx(rig.TRUTH.omega_n * 2**how.omega_n, rel=1e-12)
    assert at_torque.zeta == pytest.approx(rig.TRUTH.zeta * 2**how.zeta, rel=1e-12)
    stiff, slip = 2.0**stiffness, 2.0**displacement
    (law,) = at_torque.laws
    assert law.alpha == pytest.approx(rig.TRUTH.alpha * stiff, rel=1e-12)
    assert law.delta == pytest.approx(rig.TRUTH.delta / slip, rel=1e-12)
    assert law.gamma / law.delta == pytest.approx(rig.TRUTH.gamma / rig.TRUTH.delta, rel=1e-12)
    sliders = tightened(rig.SLIDERS, twice, how).laws[0]
    before = rig.SLIDERS.laws[0].parameters()
    for name, value in sliders.parameters().items():
        scale = stiff if name.startswith("stiffness") else 1.0 if "ratio" in name else slip
        assert value == pytest.approx(before[name] * scale, rel=1e-12)
    # A cubic spring k_3 is k / y_s^2; at a given motion a slip force has the two's product.
    spring = law_named("cubic").build({"cubic": 3e7})
    cubic = tightened(Oscillator(118.0, 0.004, (spring,)), twice, how).laws[0]
    assert cubic.parameters()["cubic"] == pytest.approx(3e7 * stiff / slip**2, rel=1e-12)


def test_bedding_counts_as_torque_and_a_wrench_scatters_the_preload():
    how = Tightening(bedding=0.1, **QUIET)
    fourth, more = tightened(rig.TRUTH, 8.0, how, sequence=4), tightened(rig.TRUTH, 8 * 4**0.1, how)
    assert fourth.laws[0].alpha == pytest.approx(more.laws[0].alpha, rel=1e-12)
    how = Tightening(wrench=0.1, **QUIET)
    off = tightened(rig.TRUTH, 8.0, how, chance=np.array([0, 0, 0, 0, 1.0]))
    assert off.laws[0].delta == pytest.approx(rig.TRUTH.delta * np.exp(-0.1), rel=1e-12)
    away = tightened(rig.TRUTH, 8.0, chance=np.array([1.0, 0, 0, -1.0, 0]))
    assert away.omega_n == pytest.approx(rig.TRUTH.omega_n * np.exp(2e-3), rel=1e-12)
    assert away.laws[0].delta == pytest.approx(rig.TRUTH.delta * np.exp(0.05), rel=1e-12)


def test_a_fleet_states_what_was_done_and_is_read_back(tmp_path):
    torques, options = (4.0, 8.0), {"tests": [SWEEP], "repeats": 2}
    options["order"] = "given"
    fleet = measure_fleet(torques=torques, assemblies=2, seed=3, **options)
    stated = [
        (unit.assembly["name"], unit.assembly.torque, unit.assembly.sequence) for unit in fleet
    ]
    assert stated == [
        ("assembly 1", 4.0, 1), ("assembly 1", 8.0, 2), ("assembly 2", 4.0, 1),
        ("assembly 2", 8.0, 2),
    ]  # fmt: skip
    joints = [unit.truth["joint"] for unit in fleet]
    # Every tightening is another joint, by more than the torque alone says.
    assert len({joint["alpha"] for joint in joints}) == 4
    repeated = measure_fleet(torques=torques, assemblies=2, seed=3, **options)
    assert [unit.truth["joint"] for unit in repeated] == joints
    for unit, same_unit in zip(fleet, repeated, strict=True):
        first, second = (
            measured.tests[0].records[0].channels["velocity"] for measured in (unit, same_unit)
        )
        assert np.array_equal(first, second)
    loaded = load_campaign(rig.write(fleet[1], tmp_path / "second"))
    assert dict(loaded.assembly) == {"name": "assembly 1", "torque": 8.0, "sequence": 2}
    assert not loaded.settings.prior


def test_a_wrench_that_is_off_leaves_the_slope_and_adds_to_the_scatter():
    """A torque that is set: ln alpha = a - p ln T - p w eps. 2,000 draws, SciPy's regression."""
    rng, w = np.random.default_rng(0), 0.3
    how = Tightening(wrench=w, **QUIET)
    torques = np.repeat([2.0, 4.0, 8.0, 12.0], 500)
    drawn = [
        tightened(rig.TRUTH, torque, how, chance=rng.standard_normal(5)).laws[0]
        for torque in torques
    ]
    for values, power in (
        ([law.alpha for law in drawn], -how.contact),
        ([law.alpha * law.delta for law in drawn], -1.0 - how.contact),
    ):
        line = linregress(np.log(torques), np.log(values))
        # Attenuated, as of a torque read with this error, it would be off by 16 %: 16 of these.
        assert abs(line.slope - power) < 3 * line.stderr
        off = np.log(values) - line.intercept - line.slope * np.log(torques)
        assert np.std(off) == pytest.approx(abs(power) * w, rel=0.07)  # four errors of 2,000


def test_torque_and_sequence_do_not_rise_together():
    options = {"tests": [SWEEP], "repeats": 1, "torques": (4.0, 8.0, 12.0)}
    fleet = measure_fleet(assemblies=2, seed=3, **options)
    stated = np.array([[unit.assembly.torque, unit.assembly.sequence] for unit in fleet])
    assert abs(np.corrcoef(np.log(stated).T)[0, 1]) < 0.5
    first, second = stated[:3, 0], stated[3:, 0]
    assert sorted(first) == [4.0, 8.0, 12.0]
    assert np.array_equal(second, first[::-1])
    in_order = measure_fleet(assemblies=2, seed=3, order="given", **options)

    # Which joint one gets at a torque has nothing to do with the order.
    def joints(campaigns):
        return {(o.assembly["name"], o.assembly.torque): o.truth["joint"] for o in campaigns}

    assert joints(fleet) == joints(in_order)


def test_scatter_is_what_was_asked():
    rng = np.random.default_rng(0)
    drawn = [tightened(rig.TRUTH, 8.0, chance=rng.standard_normal(5)) for _ in range(400)]
    spread = np.std([np.log(joint.omega_n) for joint in drawn], ddof=1)
    assert spread == pytest.approx(2e-3, rel=0.15)  # four standard errors of 400
    spread = np.std([np.log(joint.laws[0].alpha) for joint in drawn], ddof=1)
    assert spread == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"torque": 0.0}, "`torque` must be positive and finite, but is 0.0"),
        ({"sequence": 0}, "`sequence` must be positive"),
        ({"how": Tightening(reference=-1.0)}, "`reference` must be positive"),
        ({"how": Tightening(load_path="bent")}, '`load_path` must be "series" or "parallel"'),
        ({"how": Tightening(scatter={"alpha": 0.1})}, 'only omega_n.*but contains "alpha"'),
        ({"how": Tightening(wrench=-0.1)}, "`wrench` must be finite and not negative"),
    ],
)
def test_numbers_out_of_range_are_named(change, said):
    with pytest.raises(ConfigError, match=said):
        tightened(**{"joint": rig.TRUTH, "torque": 8.0} | change)


def test_a_fleet_needs_a_torque_and_laws_without_viscous_parts():
    with pytest.raises(ConfigError, match="one torque and one assembly"):
        measure_fleet(torques=())
    with pytest.raises(ConfigError, match='`order` must be "shuffled" or "given"'):
        measure_fleet(torques=(4.0,), order="random")
    viscous = law_named("cubic_damping")
    damper = viscous.build(dict.fromkeys(viscous.names(), 1.0))
    with pytest.raises(ModelError, match="must be a power of a stiffness"):
        tightened(Oscillator(118.0, 0.004, (damper,)), 8.0)
