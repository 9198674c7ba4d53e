"""The rig's own forces: every law of the register moves the specimen as the exact step does.

Neither knows of the other, so that each is the other's reference: the rig integrates rates and
hundreds of sliders by Runge-Kutta, the solver moves laws exactly between samples.
"""

import numpy as np
import pytest
from known_laws import THETA, law_of

import jbw
from jbw.errors import ModelError
from jbw.oscillator.law import Law
from jbw.oscillator.laws import LAWS
from jbw.oscillator.oscillator import Oscillator
from jbw.rig import measure
from jbw.rig.forces import BoucWenForce, SliderForces, StopForce
from jbw.rig.integrator import GRID, respond
from jbw.rig.law_forces import FORCES, kind_of

FS = 1024.0
FINER = 8  # times the rig's sampling, so that straight lines between samples follow the force
SAMPLES = 384
NAMES = [name for name in THETA if name in LAWS]


def force(t):
    return 9.0 * np.sin(2 * np.pi * 18.0 * t) * np.sin(2 * np.pi * 1.5 * t)


def joint(name):
    return Oscillator(118.0, 0.004, (law_of(name),))


def motion(one):
    y, v, _ = respond(one, lambda i, j: force(np.arange(i, j) / (FS * GRID)), SAMPLES, FS)
    return y, v


@pytest.mark.parametrize("name", NAMES)
def test_the_rig_moves_as_the_exact_step_does(name):
    y, v = motion(joint(name))
    assert np.abs(y).max() > 2e-3  # beyond every slip and stop
    t = np.arange(SAMPLES * FINER) / (FS * FINER)
    exact = jbw.simulate(joint(name), force(t), FS * FINER)
    linear = motion(Oscillator(118.0, 0.004, ()))[1]
    rms, matters = np.sqrt(np.mean(v**2)), np.sqrt(np.mean((v - linear) ** 2))
    assert matters > 0.01 * rms
    # Found: 2e-5, of straight lines in the input; 6e-5 of the power's sliders.
    wrong = np.sqrt(np.mean((np.asarray(exact.v)[::FINER] - v) ** 2))
    assert wrong < 2e-4 * rms


@pytest.mark.parametrize(
    ("name", "most"), [("iwan4", 2e-6), ("masing_exponential", 1e-5), ("masing_power", 2e-5)]
)
def test_its_sliders_have_the_virgin_curve_of_the_density(name, most):
    """To a part of the whole stiffness that curves of 0.1 % about a resonance of 1 % do not see."""
    law, x = law_of(name), np.geomspace(3e-6, 4e-3, 400)
    force = sum(
        np.minimum(x[:, None], element.slips) @ element.springs
        if isinstance(element, SliderForces)
        else element.stiffness * x
        for element in FORCES[kind_of(law)](**law.parameters())
    )
    exact = law.stiffness() * x - law.lag(x)[0]
    assert np.max(np.abs(force - exact) / x) < most * 118.0**2


def test_the_rig_knows_every_law():
    assert {*LAWS} == {*NAMES}
    for law in LAWS.values():
        assert kind_of(law) in FORCES


def test_a_law_without_a_force_is_refused():
    class Unknown(Law):
        name = "unknown"

    with pytest.raises(ModelError, match="rig does not have the law `unknown`"):
        respond(Oscillator(118.0, 0.004, (Unknown(),)), lambda i, j: np.ones(j - i), 8, FS)


def test_elements_side_by_side_are_measured():
    both = (law_of("iwan4"), law_of("cubic"))
    campaign = measure(
        joint=Oscillator(118.0, 0.004, both), tests="sweep_0p05V", repeats=1, noise_std=1e-5
    )
    assert campaign.laws == ("iwan4", "cubic")
    assert campaign.truth["joint"]["iwan_chi"] == -0.3


def test_a_saturated_force_grows_no_more_and_a_stop_acts_on_both_sides():
    """Eq. (2) at nu = 1 ends at alpha / (gamma + delta); unloading from there it is stiffer."""
    force = BoucWenForce(alpha=400.0, delta=300.0, gamma=100.0)
    assert force.rate(2.0, 1.0) == 0.0
    assert force.rate(-2.0, 1.0) == -2.0 * (400.0 - 300.0 + 100.0)
    stop = StopForce(k=5.0, gap=0.1)
    pushed = [float(stop.exerted(y, 0.0, ())) for y in (-0.3, -0.05, 0.05, 0.3)]
    assert pushed == pytest.approx([-1.0, 0.0, 0.0, 1.0], abs=1e-12)
