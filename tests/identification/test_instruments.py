"""Clock and calibration in a posterior: by closed forms, and against records in other units."""

import numpy as np
import pytest
import xarray as xr

import jbw
from jbw.campaign.load import Campaign
from jbw.campaign.schema import parse
from jbw.campaign.settings import Identify
from jbw.campaign.tables import Instruments
from jbw.errors import ConfigError
from jbw.identification.assemble import measured_in
from jbw.identification.instruments import (
    Factors,
    Sensors,
    by_stated_gain,
    factors_of,
    instruments_sentence,
    powers,
    sensors_of,
    with_factors,
    with_instruments,
)
from jbw.identification.procedure import posterior_of
from jbw.measurement.records import Record, Test
from jbw.oscillator.laws import laws_named
from jbw.oscillator.laws.iwan import Iwan4
from jbw.oscillator.oscillator import oscillator_of

SHAPE = (4, 20_000)
OMEGA_N, ZETA = 118.0, 0.004
ALONE = Sensors("acceleration", "", is_prescribed=False)
DRIVEN = Sensors("velocity", "force", is_prescribed=False)


def posterior(**parameters):
    """Draws of parameters, mean and relative standard deviation, with their units."""
    rng = np.random.default_rng(1)
    return xr.Dataset(
        {
            name: (
                ("chain", "draw"),
                mean * (1 + part * rng.standard_normal(SHAPE)),
                {"units": unit},
            )
            for name, (mean, part, unit) in parameters.items()
        }
    )


def spread(values):
    return float(values.std() / abs(values.mean()))


def test_the_clock_adds_to_omega_n_squared_in_quadrature():
    before = posterior(omega_n=(OMEGA_N, 1e-4, "rad/s"), zeta=(ZETA, 1e-3, "1"))
    after = with_instruments(before, Instruments(5e-4), ALONE, seed=0)
    # 2 sqrt(1e-4^2 + 5e-4^2); a standard deviation of 80,000 draws to a quarter of a per cent.
    assert spread(after["omega_n"] ** 2) == pytest.approx(2 * np.hypot(1e-4, 5e-4), rel=0.01)
    assert after["zeta"].equals(before["zeta"])


@pytest.mark.parametrize(
    ("sensors", "by_clock", "by_response", "by_source"),
    [
        # y = a t^2: 1/m goes with the clock twice, and the gain of no time but with 1/s_F.
        (Sensors("acceleration", "force", is_prescribed=False), (-2, 0), (-1, 1), (0, -1)),
        (Sensors("velocity", "force", is_prescribed=False), (-1, -1), (-1, 1), (0, -1)),
        (Sensors("displacement", "input", is_prescribed=False), (0, -2), (-1, 1), (0, -1)),
        # Without a clock: lengths by y, and with them forces over the mass by F.
        (Sensors("displacement", "restoring_force", is_prescribed=True), (0, 0), (-1, 0), (0, 0)),
    ],
)
def test_softening_and_gain_go_with_the_sensors(sensors, by_clock, by_response, by_source):
    stated = [
        (Instruments(1e-3), by_clock),
        (Instruments(0.0, {sensors.response: 1e-3}), by_response),
        (Instruments(0.0, {sensors.source: 1e-3}), by_source),
    ]
    before = posterior(delta=(300.0, 0.0, "1/m"), gain=(0.5, 0.0, "1/kg"))
    for instruments, expected in stated:
        after = with_instruments(before, instruments, sensors, seed=0)
        found = [spread(after[name]) for name in ("delta", "gain")]
        assert found == pytest.approx(1e-3 * np.abs(expected), rel=0.01, abs=1e-12)


def test_stiffness_along_a_prescribed_displacement_goes_with_force_over_displacement():
    sensors = Sensors("displacement", "restoring_force", is_prescribed=True)
    stated = Instruments(1e-2, {"displacement": 3e-3, "restoring_force": 4e-3})
    after = with_instruments(posterior(alpha=(1e4, 0.0, "1/s^2")), stated, sensors, seed=0)
    assert spread(after["alpha"]) == pytest.approx(5e-3, rel=0.01)


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("1/(m^2 s^2)", (-2, -2)),
        ("rad/s", (0, -1)),
        ("s/m^2", (-2, 1)),
        ("m", (1, 0)),
        ("1", (0, 0)),
        ("N/kg/V", None),
        ("V", None),
    ],
)
def test_powers_of_a_unit(unit, expected):
    assert powers(unit) == expected


LAWS = {
    ("bouc_wen",): {"alpha": 900.0, "delta": 400.0, "gamma": 200.0},
    ("bouc_wen_nu",): {"nu_stiffness": 900.0, "nu_softening": 0.4, "nu_opening": 0.2, "nu": 1.4},
    ("masing_power", "cubic"): {"power_loss": 300.0, "power_exponent": 0.6, "cubic": 2e7},
    ("iwan4", "quadratic_damping"): {
        "iwan_stiffness": 900.0, "iwan_loss": 300.0, "iwan_chi": -0.3, "iwan_beta": 0.5,
        "quadratic_damping": 4.0,
    },
    ("gap_series", "cubic_damping"): {
        "gap_stiffness": 2e3, "gap_softening": 300.0, "gap_opening": 100.0, "gap": 2e-4,
        "cubic_damping": 30.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("laws", LAWS)
def test_a_joint_in_other_units_gives_the_same_record(laws):
    """y at time lambda t is ell times as large: the motion of the scaled joint, by the solver."""
    length, time, fs = 1.7, 0.6, 600.0
    theta = {"omega_n": OMEGA_N, "zeta": ZETA, **LAWS[laws]}
    units = {q.name: q.unit for law in laws_named(laws) for q in law.table}
    units |= {"omega_n": "rad/s", "zeta": "1"}
    one = xr.Dataset({n: (("chain", "draw"), [[x]], {"units": units[n]}) for n, x in theta.items()})
    factors = Factors(*(np.full((1, 1), x) for x in (time, length, length / time**2)))
    scaled = {n: float(x.item()) for n, x in with_factors(one, factors, laws).items()}
    t = np.arange(400) / fs
    u = 1.2 * np.sin(110.0 * t)
    motion, other = (
        jbw.simulate(oscillator_of(values, laws), force, rate).y
        for values, force, rate in (
            (theta, u, fs),
            (scaled, u * length / time**2, fs / time),
        )
    )
    assert np.max(np.abs(motion)) > 5e-4  # beyond the gap
    # The same steps in other units: to round-off.
    np.testing.assert_allclose(np.asarray(other) / length, motion, rtol=0, atol=1e-11)


def test_iwan_macroslip_is_a_length():
    law = Iwan4(900.0, 300.0, -0.3, 0.5)
    one = xr.Dataset(
        {
            q.name: (("chain", "draw"), [[getattr(law, q.name)]], {"units": q.unit})
            for q in Iwan4.table
        }
    )
    factors = Factors(*(np.full((1, 1), x) for x in (0.6, 1.7, 1.7 / 0.36)))
    scaled = Iwan4(*(x.item() for x in with_factors(one, factors, ("iwan4",)).values()))
    assert float(scaled.phi_max / law.phi_max) == pytest.approx(1.7, rel=1e-12)


def curve(factor=1.0):
    """A linear FRF at a force of 1 N and a mass of 2 kg, 61 lines about 18.8 Hz, with noise."""
    hz = np.linspace(17.5, 20.0, 61)
    omega = 2 * np.pi * hz
    h = 0.5 * 1j * omega / (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega)
    records = []
    for seed in range(4):
        noise = np.random.default_rng(seed).standard_normal((2, len(hz)))
        y = factor * (h + 1e-3 * np.abs(h).max() * (noise[0] + 1j * noise[1]))
        channels = {
            "frequency": hz, "force": np.ones_like(hz),
            "velocity": np.abs(y), "phase": np.angle(y),
        }  # fmt: skip
        units = {"frequency": "Hz", "force": "N", "velocity": "m/s", "phase": "rad"}
        records.append(Record(float("nan"), channels, units, f"curve {seed}"))
    test = Test("frf", tuple(records), "curve")
    return Campaign("curve", None, (test,), modal_mass=2.0, laws=(), settings=Identify(seed=0))


def test_a_stated_gain_moves_the_parameters_as_a_fit_of_wrong_records_does():
    """Records 0.2 % too large are fitted by other parameters: the step is that difference."""
    quiet = {"report": lambda _: None}
    eta = 2e-3
    fits = [
        posterior_of("joint", measured_in(curve(factor), **quiet), **quiet)
        for factor in (1.0, np.exp(eta))
    ]
    step = by_stated_gain(fits[0].fit, fits[0].data)
    moved = {name: (fits[1].fit.theta[name] - x) / eta for name, x in fits[0].fit.theta.items()}
    # A taller peak of a given gain is one of less damping: of one line at the top -zeta.
    assert step["zeta"] == pytest.approx(moved["zeta"], rel=0.02)
    assert -1.2 < step["zeta"] / ZETA < -0.5
    assert step["omega_n"] == pytest.approx(moved["omega_n"], abs=0.02 * ZETA * OMEGA_N)
    # And with it the spread: 1 % of the velocity's calibration.
    before = posterior(omega_n=(OMEGA_N, 0.0, "rad/s"), zeta=(ZETA, 0.0, "1"))
    after = with_instruments(
        before, Instruments(0.0, {"velocity": 0.01}), DRIVEN, seed=0,
        best=fits[0].fit, data=fits[0].data,
    )  # fmt: skip
    assert float(after["zeta"].std()) == pytest.approx(0.01 * abs(step["zeta"]), rel=0.02)


def test_factors_are_one_where_nothing_is_stated():
    found = factors_of(np.random.default_rng(0), (2, 3), Instruments(), DRIVEN)
    assert all(np.all(factor == 1.0) for factor in found)


def test_sensors_are_those_of_the_tests():
    (test,) = curve().tests
    assert sensors_of([test]) == DRIVEN
    other = Record(100.0, {"acceleration": np.ones(9)}, {"acceleration": "m/s^2"})
    decay = Test("decay", (other,), "decay")
    assert sensors_of([decay]) == ALONE
    assert sensors_of([decay, test]) is None


def test_one_sentence_says_what_is_included_and_what_is_not():
    assert "`fs_std` and `gain_std`" in instruments_sentence(Instruments(), DRIVEN)
    said = instruments_sentence(Instruments(5e-5, {"force": 0.01}), DRIVEN)
    assert "the clock (5e-05), force (0.01); not stated: `gain_std` of velocity." in said
    assert "not included" in instruments_sentence(Instruments(5e-5), None)


STATED = """[campaign]
fs_std = 5e-5
gain_std = {{ {role} = {value} }}
[[test]]
kind = "decay"
files = "decay.npz"
channels = {{ velocity = "v" }}
units = {{ velocity = "m/s" }}
"""


def test_the_keys_of_a_campaign():
    found = parse(STATED.format(role="velocity", value=0.01)).instruments
    assert found == Instruments(5e-5, {"velocity": 0.01})


@pytest.mark.parametrize(
    ("role", "value", "said"),
    [
        ("force", 0.01, "names role `force`, but no test has"),
        ("velocity", 1.0, "must lie between 0 and 1, but is 1.0"),
        ("velcity", 0.1, "role `velcity` is unknown"),
    ],
)
def test_wrong_keys_are_refused(role, value, said):
    with pytest.raises(ConfigError, match=said):
        parse(STATED.format(role=role, value=value))
