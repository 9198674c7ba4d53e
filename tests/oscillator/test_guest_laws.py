"""Laws from outside whose force follows the velocity: closed forms, SciPy, and what is refused."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy_motion import scipy_motion

import jbw
from jbw.errors import ConfigError
from jbw.measurement.records import Record, Test
from jbw.observables.harmonic_groups import curve_group
from jbw.observables.steady import Points
from jbw.oscillator.contract import require_contract
from jbw.oscillator.damper import Damper
from jbw.oscillator.law import Law, Loop
from jbw.oscillator.laws import LAWS, register
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Oscillator
from jbw.quantities import Quantity

OMEGA_N, ZETA, C, OMEGA, AMPLITUDE = 97.0, 0.012, 7.5, 91.0, 3.0


class Oil(Law):
    """The force `oil_c` v of a film, by what every law must define."""

    name: ClassVar[str] = "oil"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("oil_c", "c", "1/s", "drag of the film", 0.0),
    )
    oil_c: float

    @classmethod
    def prior(cls, scales):
        return {"oil_c": (0.0, 0.2 * scales.omega_n)}

    def stiffness(self):
        return 0.0

    def force(self, y, v, memory):
        return self.oil_c * v


class OilDamper(Damper):
    """The same as a function of the velocity alone."""

    name: ClassVar[str] = "oil_damper"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("film_c", "c", "1/s", "drag of the film", 0.0),
    )
    film_c: float

    def __call__(self, v):
        return self.film_c * v


class Sleeve(Law):
    """Friction that is smooth in the velocity, drag and a stiffening spring in one law."""

    name: ClassVar[str] = "sleeve"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("sleeve_f", "f", "N/kg", "friction", 0.0),
        Quantity("sleeve_c", "c", "1/s", "drag", 0.0),
        Quantity("sleeve_k3", "k₃", "1/(m^2 s^2)", "stiffening", 0.0),
    )
    sleeve_f: float
    sleeve_c: float
    sleeve_k3: float

    @classmethod
    def prior(cls, scales):
        size = scales.omega_n**2 * scales.y_peak
        return {
            "sleeve_f": (0.0, 0.02 * size),
            "sleeve_c": (0.0, 0.1 * scales.omega_n),
            "sleeve_k3": (0.0, 0.2 * size / scales.y_peak**3),
        }

    def force(self, y, v, memory):
        return self.sleeve_f * jnp.tanh(v / 0.1) + self.sleeve_c * v + self.sleeve_k3 * y**3


class Wet(Law):
    """A slider with a film: a force of a memory and of the velocity."""

    name: ClassVar[str] = "wet"
    table: ClassVar[tuple[Quantity, ...]] = (
        Quantity("wet_k", "k", "1/s^2", "stiffness before slip", 0.0, is_share=True),
        Quantity("wet_slip", "s", "m", "slip", 0.0),
        Quantity("wet_c", "c", "1/s", "drag", 0.0),
    )
    wet_k: float
    wet_slip: float
    wet_c: float

    @classmethod
    def prior(cls, scales):
        most = 0.2 * scales.omega_n**2
        return {"wet_k": (0.0, most), "wet_slip": (1e-5, 1e-3), "wet_c": (0.0, 20.0)}

    def at_rest(self):
        return 0.0

    def force(self, y, v, memory):
        return self.wet_k * memory + self.wet_c * v

    def rate(self, y, v, memory):
        return jnp.where(jnp.sign(v) * memory >= self.wet_slip, 0.0, v)

    def move(self, y, memory, dy):
        return jnp.clip(memory + dy, -self.wet_slip, self.wet_slip)


FILMS = [Oil(C), OilDamper(C)]
SLEEVE = (0.9, 3.0, 2e7)


def oscillator(law, zeta=ZETA):
    return jax.tree.map(lambda x: jnp.asarray(x, float), Oscillator(OMEGA_N, zeta, (law,)))


def film_response(c, omega=OMEGA):
    return AMPLITUDE / (OMEGA_N**2 - omega**2 + 1j * omega * (2 * ZETA * OMEGA_N + c))


@pytest.fixture
def forgotten():
    """The register as it was, behind a test."""
    before = dict(LAWS)
    yield
    LAWS.clear()
    LAWS.update(before)


@pytest.mark.parametrize("law", FILMS)
def test_a_film_is_linear_damping_in_the_steady_state_with_its_derivative(law):
    joint = oscillator(law)

    def first(joint):
        return jbw.steady_state(joint, OMEGA, AMPLITUDE, 2)[0]

    exact = film_response(C)
    assert abs(complex(first(joint)) / exact - 1) < 1e-12
    slope = jax.tree.leaves(jax.grad(lambda joint: jnp.abs(first(joint)))(joint).laws)[0]
    # d|Y|/dc of the closed form, whose denominator D moves by j omega.
    d = AMPLITUDE / exact
    assert float(slope) == pytest.approx(-abs(exact) * (1j * OMEGA / d).real, rel=1e-10)


@pytest.mark.parametrize("law", FILMS)
def test_a_film_adds_its_damping_to_the_backbone_from_rest_on(law):
    found = jbw.backbone(oscillator(law), np.array([0.0, 1e-3]))
    np.testing.assert_allclose(found.omega, OMEGA_N, rtol=1e-14)
    # The trapezium rule of 128 points, exact for one harmonic but for rounding.
    np.testing.assert_allclose(found.zeta, ZETA + C / (2 * OMEGA_N), rtol=1e-13)


@pytest.mark.parametrize("law", FILMS)
def test_slow_motion_feels_no_film(law):
    y = jnp.linspace(0.0, 1e-3, 20)
    # 1e-12 rad/s of the drag beside OMEGA_N^2.
    np.testing.assert_allclose(oscillator(law).force_along(y), OMEGA_N**2 * y, rtol=1e-13)


@pytest.mark.slow
def test_a_structure_has_a_films_damping_at_every_amplitude():
    one, none = np.ones(1), np.array([0.0, 1e-3])
    structure = Structure(
        np.array([OMEGA_N]), np.array([ZETA]), one, None, one, one[None], (Oil(C),)
    )
    np.testing.assert_allclose(
        jbw.backbone(structure, none).zeta, ZETA + C / (2 * OMEGA_N), rtol=1e-9
    )
    tone = jbw.steady_state(structure, OMEGA, AMPLITUDE, 2)
    assert abs(complex(tone.q[0, 0]) / film_response(C) - 1) < 1e-10


def test_a_mixed_force_has_the_losses_of_quadrature():
    f, c, k_3 = SLEEVE
    y_peak = 2e-3

    def along(theta):
        v = -y_peak * OMEGA * np.sin(theta)
        return f * np.tanh(v / 0.1) + c * v + k_3 * (y_peak * np.cos(theta)) ** 3

    def part(wave):
        return quad(lambda t: along(t) * wave(t), 0, 2 * np.pi, epsabs=1e-14)[0] / np.pi / y_peak

    loop = Sleeve(*SLEEVE).loop(y_peak, OMEGA)
    # Smooth and periodic: the trapezium rule is spectral.
    np.testing.assert_allclose(loop, [part(np.cos), -part(np.sin)], rtol=1e-9)


@pytest.mark.parametrize("law", [Sleeve(*SLEEVE), Wet(900.0, 4e-4, 5.0)], ids=["sleeve", "wet"])
def test_a_mixed_forces_record_is_that_of_scipy(law):
    time = np.arange(128) / 512.0
    u = 6.0 * np.sin(2 * np.pi * 15 * time) * np.sin(2 * np.pi * 2 * time)
    if law.name == "sleeve":
        f, c, k_3 = SLEEVE
        wanted = scipy_motion(
            lambda y, v, m: f * np.tanh(v / 0.1) + c * v + k_3 * y**3,
            OMEGA_N**2, 2 * ZETA * OMEGA_N, u, 512.0,
        )  # fmt: skip
        tolerance = 3e-7  # of order 4: 5e-9 with four steps a sample
    else:
        wanted = scipy_motion(
            lambda y, v, m: 900.0 * m + 5.0 * v, OMEGA_N**2 - 900.0, 2 * ZETA * OMEGA_N, u, 512.0,
            rate=lambda v, m: 0.0 if np.sign(v) * m >= 4e-4 else v,
        )  # fmt: skip
        tolerance = 1e-3  # a law that says its move alone yields between the ends of a step
    found = jbw.simulate(oscillator(law), u, 512.0, substeps=2)
    for exact, x in zip(wanted[:2], (found.y, found.v), strict=True):
        np.testing.assert_allclose(x, exact, atol=tolerance * np.max(np.abs(exact)))


def test_a_mixed_forces_steady_state_is_that_of_scipy():
    f, c, k_3 = SLEEVE

    def field(t, x):
        force = f * np.tanh(x[1] / 0.1) + c * x[1] + k_3 * x[0] ** 3
        a = AMPLITUDE * np.cos(OMEGA * t) - 2 * ZETA * OMEGA_N * x[1] - OMEGA_N**2 * x[0] - force
        return [x[1], a]

    period, count = 2 * np.pi / OMEGA, 60  # of which the transient keeps exp(-60 * 0.3)
    at = (count + np.arange(64) / 64) * period
    run = solve_ivp(field, (0, at[-1]), [0, 0], "DOP853", at, rtol=1e-10, atol=1e-13)
    exact = 2 * np.mean(run.y[0] * np.exp(-1j * OMEGA * at))
    joint = oscillator(Sleeve(*SLEEVE))
    found = complex(jbw.steady_state(joint, OMEGA, AMPLITUDE)[0])
    assert abs(found / exact - 1) < 1e-6
    moved = [complex(jbw.steady_state(joint, OMEGA, a)[0]) for a in (3.0003, 2.9997)]
    slope = jax.grad(lambda a: jnp.abs(jbw.steady_state(joint, OMEGA, a)[0]))(AMPLITUDE)
    assert float(slope) == pytest.approx((abs(moved[0]) - abs(moved[1])) / 6e-4, rel=1e-6)


def test_a_fit_of_a_response_curve_sees_the_film(forgotten):
    register(Oil)
    freq = np.linspace(12.0, 18.0, 11)
    omega = 2 * np.pi * freq
    h = film_response(C, omega) / AMPLITUDE
    channels = {
        "frequency": freq, "force": np.ones(11), "displacement": np.abs(h),
        "phase": np.angle(h),
    }  # fmt: skip
    units = {"frequency": "Hz", "force": "N", "displacement": "m", "phase": "rad"}
    record = Record(float("nan"), channels, units, provenance={"ratio": "m/N"})
    group = curve_group(Test("frf", (record,), "frf", 1.0))
    data = Points.of([group], laws=("oil",))

    def misfit(c):
        theta = {"omega_n": OMEGA_N, "zeta": ZETA, "gain": 1.0, "oil_c": c}
        theta = {name: jnp.asarray(value) for name, value in theta.items()}
        return jnp.sum(jnp.abs(data.predict(theta) - data.mean) ** 2)

    scale = float(np.sum(np.abs(data.mean) ** 2))
    assert float(misfit(C)) < 1e-20 * scale
    assert float(misfit(0.0)) > 0.1 * scale
    assert float(jax.grad(misfit)(1.1 * C)) > 0.0 > float(jax.grad(misfit)(0.9 * C))


def outside(**methods):
    """A film with other methods."""
    return type("Bad", (Oil,), {"__module__": "elsewhere", "name": "bad", **methods})


@pytest.mark.parametrize(
    ("methods", "said"),
    [
        ({"prior": classmethod(lambda cls, scales: {})}, r"`prior` .* no oil_c"),
        ({"force": lambda self, y, v, m: jnp.sqrt(-1.0 - y)}, "`force` must be finite"),
        ({"force": lambda self, y, v, m: self.oil_c * y**2}, "`force` must be odd"),
        ({"force": lambda self, y, v, m: self.oil_c * y}, r"`stiffness` must be the slope"),
        (
            {"loop": lambda self, y, omega=0.0: Loop(0.0 * y, 2.0 * omega * self.oil_c + 0.0 * y)},
            r"`loop` must be the first harmonic .*1585.9j, but the found value is 0\+3171.8j",
        ),
        (
            {"harmonics": lambda self, q, max_turns, omega=0.0: 0.0 * q},
            "`harmonics` must be the harmonics of `force`",
        ),
        ({"loop": lambda self, y: Loop(0.0 * y, 0.0 * y)}, "cannot be tested .*: TypeError"),
        (
            {
                "at_rest": lambda self: 0.0,
                "force": lambda self, y, v, m: m,
                "rate": lambda self, y, v, m: 1e3 * v - self.oil_c * m,
                "stiffness": lambda self: 1e3,
            },
            "`rate` must be proportional to the velocity",
        ),
    ],
    ids=["prior", "finite", "even", "stiffness", "loop", "harmonics", "signature", "relaxes"],
)  # fmt: skip
def test_what_a_law_says_and_its_force_does_not_is_refused_by_name(methods, said, forgotten):
    law = outside(**methods)
    for _ in range(2):  # said again at the next use
        with pytest.raises(ConfigError, match=said):
            register(law)
    assert "bad" not in LAWS
    with pytest.raises(ConfigError, match=r"The law `bad` is refused"):
        jbw.backbone(Oscillator(OMEGA_N, ZETA, (law(C),)), 1e-3)


@pytest.mark.slow
def test_a_step_that_disagrees_with_the_steady_state_is_refused(forgotten):
    doubled = outside(remainder=lambda self, h, y, v, m, at: (2.0 * self.oil_c * v, 0.0 * v))
    with pytest.raises(ConfigError, match="`steady_state` must be the first harmonic"):
        register(doubled)


def test_sound_guests_are_admitted(forgotten):
    require_contract([Sleeve, Wet, OilDamper])
    assert register(Oil) is LAWS["oil"]


def test_a_law_without_a_prior_is_simulated_and_never_identified():
    with pytest.raises(ConfigError, match="must have a `prior`"):
        OilDamper.prior(None)
