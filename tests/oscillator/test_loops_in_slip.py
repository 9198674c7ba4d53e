"""Loops, harmonics and backbones from a millionth of the slip displacement to a hundred times it.

Every law of the register whose loop has a scale: y = Y cos(theta), the force on the way back from
Y by the law's own equations, its integrals by mpmath with 30 digits. The loops of the free exponent
are in `test_gross_slip.py` and those of Iwan's law with two frictions in `test_iwan5.py`.
"""

import functools
import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from known_laws import compiled, law_of

import jbw
from jbw.oscillator.laws.bouc_wen_nu import BoucWenNu

pytestmark = pytest.mark.filterwarnings("ignore:The steady loop is saturated")
OMEGA_N, ZETA = 118.0, 0.005
MULTIPLES = (1e-6, 1e-3, 0.1, 0.6, 1.0, 3.0, 7.0, 10.0, 30.0, 100.0)
LAYERS = ("1e-3", "0.01", "0.05", "0.2", "0.5")  # of a stretch beside a kink: finer pieces there


def approach(c, x):
    """(1 - exp(-c x)) / c."""
    return x if c == 0 else -mp.expm1(-c * x) / c


def way(c, w):
    """The inverse of `approach`."""
    return w if c == 0 else -mp.log1p(-c * w) / c


def falling_bouc_wen(alpha, delta, gamma, peak):
    """Force on the way back from the tip, and where it vanishes: both ends meet in the tip."""
    a, b = delta - gamma, delta + gamma
    low, high = -peak, peak
    for _ in range(450):
        middle = (low + high) / 2
        rises = approach(b, peak + middle) < approach(a, peak - middle)
        low, high = (middle, high) if rises else (low, middle)
    zero = low

    def force(y):
        back = approach(a, y - zero) if y > zero else -approach(b, zero - y)
        return alpha * back

    return force, [zero]


def falling_gap(alpha, delta, gamma, gap, peak):
    """Bouc-Wen's force of Y - b, then nothing over 2 b, then the rest of its way."""
    if peak <= gap:
        return (lambda y: mp.mpf(0)), []
    force, (zero,) = falling_bouc_wen(alpha, delta, gamma, peak - gap)

    def behind(y):
        if y - gap > zero:
            return force(y - gap)
        return force(y + gap) if y + gap < zero else mp.mpf(0)

    return behind, [zero + gap, zero - gap]


def falling_masing(virgin, peak, *slips):
    """Masing's rule, F_b(Y) - 2 F_b((Y - y)/2); slips are the kinks of F_b."""
    tip = virgin(peak)
    return (lambda y: tip - 2 * virgin((peak - y) / 2)), [peak - 2 * slip for slip in slips]


def falling(name, theta, peak):
    """Force of a law on the way back from its tip [N/kg], and its kinks between -Y and Y [m]."""
    values = [mp.mpf(value) for value in theta.values()]
    mm = mp.mpf("1e-3")
    if name == "bouc_wen":
        return falling_bouc_wen(*values, peak)
    if name == "gap_series":
        return falling_gap(*values, peak)
    if name == "masing_exponential":
        alpha, b = values
        return falling_masing(lambda x: alpha * approach(b, x), peak)
    if name == "masing_power":
        loss, q = values
        return falling_masing(lambda x: -loss * mm * (x / mm) ** (1 + q), peak)
    if name == "iwan4":
        stiffness, loss, chi, beta = values
        most = mm * (stiffness / ((1 + beta) * (2 + chi)) / loss) ** (1 / (1 + chi))

        def virgin(x):
            x = min(x, most)
            return stiffness * x - loss * mm * (x / mm) ** (2 + chi)

        return falling_masing(virgin, peak, most)
    if name.startswith("jenkins"):
        alphas, slips = values[::2], [values[1]]
        for ratio in values[3::2]:
            slips.append(slips[-1] * ratio)
        pairs = list(zip(alphas, slips, strict=True))
        return falling_masing(lambda x: sum(k * min(x, phi) for k, phi in pairs), peak, *slips)
    if name == "stop":
        k, gap = values
        return (lambda y: mp.sign(y) * k * max(abs(y) - gap, 0)), [gap, -gap]
    power = {"quadratic": 2, "cubic": 3, "quintic": 5}[name]
    return (lambda y: mp.sign(y) * values[0] * abs(y) ** power), [0]


@functools.cache
def reference(name, pairs, y_peak):
    """Force at the tip, first and third harmonic over Y: F = Re sum F_n exp(j n theta)."""
    with mp.workdps(
        140 if y_peak > 1e-2 else 40
    ):  # where slip is long, a tip is close to its limit
        peak = mp.mpf(y_peak)
        force, kinks = falling(name, dict(pairs), peak)
        unit = abs(force(peak)) or 1  # mpmath's own error is not relative
        ends = sorted({-peak, *(k for k in kinks if abs(k) < peak), peak})
        with mp.workdps(30):
            pieces = {mp.acos(end / peak) for end in ends}
            for low, high in itertools.pairwise(ends):
                for part in map(mp.mpf, LAYERS):
                    for y in (low + part * (high - low), high - part * (high - low)):
                        pieces.add(mp.acos(y / peak))

            @functools.cache  # of the same nodes are all four integrals
            def scaled_force(t):
                return force(peak * mp.cos(t)) / unit

            waves = []
            for n in (1, 3):
                both = [
                    mp.quad(lambda t, w=w, n=n: scaled_force(t) * w(n * t), sorted(pieces))
                    for w in (mp.cos, mp.sin)
                ]
                waves.append(complex(*both).conjugate() * 2 / np.pi / y_peak * float(unit))
        return float(force(peak)), *waves


CASES = {
    "bouc_wen": ({"alpha": 497.4, "delta": 340.21, "gamma": 32.84}, 1 / 373.05),
    "bouc_wen opens": ({"alpha": 497.4, "delta": 32.84, "gamma": 340.21}, 1 / 373.05),
    "bouc_wen hardens": ({"alpha": 497.4, "delta": -150.0, "gamma": 350.0}, 1 / 200.0),
    "gap_series": (
        {"gap_stiffness": 700.0, "gap_softening": 300.0, "gap_opening": 100.0, "gap": 6e-4},
        1 / 400.0,
    ),
    "iwan4": (
        {"iwan_stiffness": 1500.0, "iwan_loss": 217.0, "iwan_chi": -0.3, "iwan_beta": 0.5},
        7.66e-3,
    ),
    "jenkins": ({"stiffness_1": 600.0, "slip_1": 2e-3}, 2e-3),
    "jenkins_3": (
        {"stiffness_1": 300.0, "slip_1": 5e-4, "stiffness_2": 250.0, "slip_ratio_2": 3.0,
         "stiffness_3": 200.0, "slip_ratio_3": 8.0 / 3.0},
        4e-3,
    ),
    "masing_exponential": ({"exponential_alpha": 497.4, "exponential_b": 373.05}, 1 / 373.05),
    "masing_power": ({"power_loss": 120.0, "power_exponent": 0.7}, 1e-3),
    "stop": ({"stop_stiffness": 400.0, "stop_gap": 1.5e-3}, 1.5e-3),
    "quadratic": ({"quadratic": 8e4}, 1e-3),
    "cubic": ({"cubic": 2e7}, 1e-3),
    "quintic": ({"quintic": 5e11}, 1e-4),
}  # fmt: skip


@compiled
def around(law, y_peak, zeta):
    """Force at the tip, loop, first two odd harmonics of the force, and the joint's backbone."""
    q = y_peak * jnp.array([1.0, 0.0, 0.0], complex)
    harmonics = (law.harmonics(q, 2) + law.stiffness() * q)[:2]
    backbone = jbw.backbone(jbw.Oscillator(OMEGA_N, zeta, (law,)), y_peak)
    return law.force(y_peak, 0.0, law.at_tip(y_peak)), law.loop(y_peak), harmonics, backbone


@compiled
def slope_of_damping(law, y_peak):
    """Derivative of the loop's damping by gamma."""
    return jax.grad(lambda gamma: replace(law, gamma=gamma).loop(y_peak).damping)(law.gamma)


FAST = {("bouc_wen", 7.0), ("bouc_wen hardens", 100.0), ("gap_series", 7.0), ("iwan4", 7.0),
        ("jenkins_3", 7.0), ("masing_exponential", 7.0)}  # fmt: skip
# Stick, little slip, the motion that once lost a third of the damping, and slip throughout.
EVERY_TIME = (1e-6, 0.6, 7.0, 100.0)


def every_case():
    for case in CASES:
        for multiple in MULTIPLES:
            slow = pytest.mark.slow if multiple in EVERY_TIME else pytest.mark.release
            yield pytest.param(case, multiple, marks=() if (case, multiple) in FAST else slow)


@pytest.mark.parametrize(("case", "multiple"), list(every_case()))
def test_tip_loop_harmonics_and_backbone_are_those_of_mpmath(case, multiple):
    (theta, scale), name = CASES[case], case.split()[0]
    law, y_peak = law_of(name, theta), multiple * scale
    tip, first, third = reference(name, tuple(theta.items()), y_peak)
    # Rounding; ahead of a hundred slip displacements forces and stiffnesses are differences.
    close = dict(rtol=1e-12, atol=1e-20)
    force, loop, harmonics, found = around(law, y_peak, ZETA)
    np.testing.assert_allclose(force, tip, **close)
    # Behind a gap the stiffness is by 24 points a piece, which meet layers at a hundred of slip.
    by_rule = dict(close, rtol=1e-11) if multiple == 100.0 else close
    np.testing.assert_allclose(loop.stiffness, first.real, **by_rule)
    size = abs(first)
    np.testing.assert_allclose(loop.damping, first.imag, rtol=1e-12, atol=1e-30 * size)
    # Harmonics are by fixed points a piece, and of one size.
    within = 3e-10 * size if multiple == 100.0 else 1e-12 * size
    np.testing.assert_allclose(harmonics / y_peak, [first, third], rtol=0.0, atol=within)
    k = OMEGA_N**2 - float(law.stiffness())
    omega = np.sqrt(k + first.real)
    np.testing.assert_allclose(found.omega, omega, rtol=1e-12)
    zeta = ZETA * OMEGA_N / omega + first.imag / (2 * omega**2)
    np.testing.assert_allclose(found.zeta, zeta, rtol=1e-12)


@pytest.mark.parametrize("multiple", MULTIPLES)
@pytest.mark.parametrize("case", ["bouc_wen", "bouc_wen opens", "bouc_wen hardens"])
def test_the_free_exponent_at_one_is_bouc_wen(case, multiple):
    """Y (delta + gamma) of 7 and 10 once lost a third of the damping and more."""
    theta, scale = CASES[case]
    plain, free = law_of("bouc_wen", theta), BoucWenNu.of_bouc_wen(*theta.values(), 1.0)
    y_peak = multiple * scale
    force, _, harmonics, ours = around(free, y_peak, 0.0)
    tip, _, own, other = around(plain, y_peak, 0.0)
    np.testing.assert_allclose(force, tip, rtol=1e-13)
    within = 1e-7 * theta["alpha"] * y_peak  # of sums over 512 angles, with cusps between them
    np.testing.assert_allclose(harmonics, own, rtol=0.0, atol=within)
    np.testing.assert_allclose(ours.omega, other.omega, rtol=1e-13)
    np.testing.assert_allclose(ours.zeta, other.zeta, rtol=1e-11)


@pytest.mark.parametrize("power", [2, 3])
@pytest.mark.parametrize("amplitude", [1e-9, 1e-3, 0.1])
def test_dampers_raise_the_damping_ratio_by_what_they_lose(power, amplitude):
    """c |v|^p of v = omega Y sin: its work a cycle over 2 pi omega^2 Y^2, by mpmath."""
    name = {2: "quadratic_damping", 3: "cubic_damping"}[power]
    law = law_of(name, {name: 0.3})
    work = 4 * 0.3 * (OMEGA_N * amplitude) ** power * amplitude
    work *= float(mp.quad(lambda t: mp.sin(t) ** (power + 1), [0, mp.pi / 2]))
    *_, found = around(law, amplitude, ZETA)
    np.testing.assert_allclose(found.omega, OMEGA_N, rtol=1e-15)
    added = work / (2 * np.pi * OMEGA_N**2 * amplitude**2)
    np.testing.assert_allclose(found.zeta, ZETA + added, rtol=1e-13)


@pytest.mark.parametrize("case", ["bouc_wen", "bouc_wen hardens"])
def test_a_saturated_loop_has_derivatives(case):
    """Against differences of mpmath's loop at thirty slip displacements, where forms are closed."""
    theta, scale = CASES[case]

    gamma = theta["gamma"]
    h = 1e-4 * gamma
    sides = [
        reference("bouc_wen", tuple((theta | {"gamma": gamma + step}).items()), 30 * scale)[1].imag
        for step in (h, -h)
    ]
    # The difference's own error is of second order in 1e-4.
    slope = float(slope_of_damping(law_of("bouc_wen", theta), 30 * scale))
    assert slope == pytest.approx((sides[0] - sides[1]) / (2 * h), rel=1e-6)
