"""Bouc-Wen's law with degradation and pinching: its equations by SciPy, its limits, its order."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from known_laws import THETA, compiled, law_of
from pasted import lines_of
from scipy.integrate import solve_ivp

from jbw.campaign.schema import parse
from jbw.campaign.settings import never_steady
from jbw.errors import ConfigError
from jbw.measurement.kinds import KINDS
from jbw.oscillator.laws import law_named
from jbw.oscillator.oscillator import Oscillator

Z_Y = THETA["bwbn"]["bwbn_yield"]
TURNS = Z_Y * np.array([0.0, 1.5, -2.0, 2.5, -3.0, 3.5, 0.5, 3.0, -3.5])


def slopes(y, state, theta, sign):
    """The equations of Foliente (1995), z in metres, energy in joules of a unit stiffness."""
    z, work = state
    z_y, n = theta["bwbn_yield"], theta["bwbn_n"]
    beta, gamma = theta["bwbn_beta"] / z_y**n, (1.0 - theta["bwbn_beta"]) / z_y**n
    energy = work / z_y**2
    nu = 1.0 + theta.get("bwbn_delta_nu", 0.0) * energy
    eta = 1.0 + theta.get("bwbn_delta_eta", 0.0) * energy
    z_u = (1.0 / (nu * (beta + gamma))) ** (1.0 / n)
    zeta_1 = theta["bwbn_zeta_s"] * (1.0 - np.exp(-theta["bwbn_p"] * energy))
    psi = z_y * (theta["bwbn_psi"] + theta["bwbn_delta_psi"] * energy)
    zeta_2 = psi * (theta["bwbn_lambda"] + zeta_1)
    h = 1.0 - zeta_1 * np.exp(-(((z * sign - theta["bwbn_q"] * z_u) / zeta_2) ** 2))
    lost = nu * (beta * sign * abs(z) ** (n - 1.0) * z + gamma * abs(z) ** n)
    return [h / eta * (1.0 - lost), z]


def stretches(theta, turns):
    """Stretch z [m] at every turn, by SciPy's rule of order 8 at 1e-12, which steps up to z = 0."""
    state, found = np.zeros(2), []
    for start, end in pairwise(turns):
        part = solve_ivp(
            slopes, (start, end), state, "DOP853", args=(theta, np.sign(end - start)),
            rtol=1e-12, atol=1e-16,
        )  # fmt: skip
        state = part.y[:, -1]
        found.append(state[0])
    return np.array(found)


@compiled
def moved(law, turns):
    def onward(memory, ends):
        memory = law.move(ends[0], memory, ends[1] - ends[0])
        return memory, memory

    rest = jax.tree.map(jnp.zeros_like, jax.tree.map(jnp.asarray, law.at_rest()))
    return jax.lax.scan(onward, rest, (turns[:-1], turns[1:]))[1]


@compiled
def followed(law, y):
    joint = Oscillator(200.0, 0.0, (law,))
    return (joint.force_along(y) - joint.k * y) / law.stiffness()


def path(steps):
    """Every stroke in as many steps."""
    return np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(TURNS)])


@pytest.mark.parametrize("name", ["bwbn", "bwbn_pinching"])
def test_long_and_short_moves_are_those_of_the_equations(name):
    """References of 1e-12; short moves have 96 parts a stroke of up to six yields."""
    exact = stretches(THETA[name], TURNS)
    np.testing.assert_allclose(moved(law_of(name), TURNS).stretch, exact, atol=1e-10 * Z_Y)
    steps = 24
    short = followed(law_of(name), path(steps))[steps - 1 :: steps]
    np.testing.assert_allclose(short, exact, atol=2e-5 * Z_Y)


def test_the_error_of_short_moves_falls_with_the_fourth_power():
    """Where n is an even number, the slope has no kink at z = 0 in one of its branches, and a weak
    one in the other: of n = 4, of order five."""
    theta = {**THETA["bwbn"], "bwbn_n": 4.0}
    exact, law = stretches(theta, TURNS), law_of("bwbn", theta)
    error = [
        np.max(np.abs(followed(law, path(steps))[steps - 1 :: steps] - exact)) for steps in (24, 48)
    ]
    assert 12.0 < error[0] / error[1] < 22.0


def test_without_energy_it_is_bouc_wen_of_the_exponent():
    none = dict.fromkeys(("bwbn_zeta_s", "bwbn_delta_nu", "bwbn_delta_eta"), 0.0)
    law = law_of("bwbn", {**THETA["bwbn"], **none})
    y = path(48)
    same = followed(law.undamaged(), y)
    # Parts of a twenty-eighth of a yield, one of which passes the kink |w|^1.5 at z = 0.
    np.testing.assert_allclose(followed(law, y), same, rtol=0, atol=5e-6 * Z_Y)
    assert float(law.stiffness()) == float(law.undamaged().stiffness())


def test_a_virgin_loading_has_a_closed_form():
    r"""$w = 1 - e^{-y / z_y}$ of n = 1, and $\tanh(y / z_y)$ of n = 2, without damage."""
    none = dict.fromkeys(("bwbn_zeta_s", "bwbn_delta_nu", "bwbn_delta_eta"), 0.0)
    for n, closed in ((1.0, lambda x: -mpmath.expm1(-x)), (2.0, mpmath.tanh)):
        law = law_of("bwbn", {**THETA["bwbn"], **none, "bwbn_n": n})
        z = moved(law, np.array([0.0, 3e-3])).stretch[-1]
        assert float(z) == pytest.approx(Z_Y * float(closed(mpmath.mpf(3e-3) / Z_Y)), rel=1e-11)


def test_memory_counts_the_work_of_the_force():
    """In alpha z_y^2, by the trapezium rule on a fine path."""
    law, y = law_of("bwbn"), path(2000)
    z = np.append(0.0, followed(law, y))
    work = np.trapezoid(z, np.append(0.0, y)) / Z_Y**2
    assert float(moved(law, TURNS).energy[-1]) == pytest.approx(work, rel=1e-5)


def test_strength_and_stiffness_fall_and_loops_are_pinched():
    """In the tenth of equal cycles, against the first."""
    y = 3.0 * Z_Y * np.sin(2 * np.pi * np.arange(2001) / 200)
    z = np.array(followed(law_of("bwbn"), y))
    first, last = z[200:401], z[1800:2001]
    assert np.ptp(last) < 0.9 * np.ptp(first)
    middle = [abs(part[100]) / np.ptp(part) for part in (first, last)]
    assert middle[1] < 0.7 * middle[0]


CAMPAIGN = """
[joint]
laws = ["bwbn"]
[[test]]
kind = "{kind}"
files = "a.npz"
channels = {{ {channels} }}
{more}
"""
CHANNELS = {
    "loop": 'displacement = "y", restoring_force = "f"',
    "frf": 'force = "f", velocity = "v", frequency = "hz"',
    "decay": 'velocity = "v"',
    "backbone": 'force = "f", displacement = "y", frequency = "hz"',
    "curve": 'force = "f", displacement = "y", frequency = "hz"',
}
MORE = {"tones": "tones = [1.0]", "stepped": "tones = [1.0]\ndwell = 1.0"}


@pytest.mark.parametrize("kind", KINDS)
def test_tests_of_steady_motion_are_refused(kind):
    channels = CHANNELS.get(kind, 'force = "f", velocity = "v"')
    text = CAMPAIGN.format(kind=kind, channels=channels, more=MORE.get(kind, ""))
    if kind in ("loop", "sweep", "noise"):
        assert parse(text).laws == ("bwbn",)
        return
    with pytest.raises(ConfigError, match=f"every cycle changes the joint, but .* `{kind}`"):
        parse(text)


def test_the_remedy_of_steady_motion_is_taken():
    ((table, line),) = lines_of(never_steady(("bwbn",), ["decay"]))
    assert table == "joint"
    text = CAMPAIGN.format(kind="decay", channels=CHANNELS["decay"], more="")
    assert parse(text.replace('laws = ["bwbn"]', line)).laws == ("bouc_wen_nu",)
    assert law_named("bouc_wen_nu") is type(law_of("bwbn").undamaged())
