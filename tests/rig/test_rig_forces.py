"""The rig's own forces: every law of the register moves the specimen as the exact step does.

Neither knows of the other, so that each is the other's reference: the rig integrates rates and
hundreds of sliders by Runge-Kutta, the solver moves laws exactly between samples.
"""

import numpy as np
import pytest

import jbw
from jbw.errors import ModelError
from jbw.oscillator.law import Law
from jbw.oscillator.laws import LAWS, law_named
from jbw.oscillator.oscillator import Oscillator
from jbw.rig import measure
from jbw.rig.forces import FORCES
from jbw.rig.integrator import GRID, respond

FS = 1024.0
FINER = 8  # times the rig's sampling, so that straight lines between samples follow the force
SAMPLES = 384
THETA = {
    "bouc_wen": {"alpha": 497.4, "delta": 340.21, "gamma": 32.84},
    "bouc_wen_nu": {"nu_stiffness": 497.4, "nu_softening": 0.3, "nu_opening": 0.1, "nu": 0.7},
    "cubic": {"cubic": 2e7},
    "cubic_damping": {"cubic_damping": 4.0},
    "iwan4": {"iwan_stiffness": 1500.0, "iwan_loss": 217.0, "iwan_chi": -0.3, "iwan_beta": 0.5},
    "jenkins": {"stiffness_1": 600.0, "slip_1": 2e-3},
    "masing_exponential": {"exponential_alpha": 497.4, "exponential_b": 373.05},
    "masing_power": {"power_loss": 120.0, "power_exponent": 0.7},
    "quadratic": {"quadratic": 8e4},
    "quadratic_damping": {"quadratic_damping": 2.0},
    "quintic": {"quintic": 5e11},
    "stop": {"stop_stiffness": 400.0, "stop_gap": 1.5e-3},
}


def force(t):
    return 9.0 * np.sin(2 * np.pi * 18.0 * t) * np.sin(2 * np.pi * 1.5 * t)


def joint(name):
    return Oscillator(118.0, 0.004, (law_named(name).of(THETA[name]),))


def motion(one):
    y, v, _ = respond(one, lambda i, j: force(np.arange(i, j) / (FS * GRID)), SAMPLES, FS)
    return y, v


@pytest.mark.parametrize("name", THETA)
def test_the_rig_moves_as_the_exact_step_does(name):
    y, v = motion(joint(name))
    assert np.abs(y).max() > 2e-3  # beyond every slip and stop
    t = np.arange(SAMPLES * FINER) / (FS * FINER)
    found = jbw.simulate(joint(name), force(t), FS * FINER)
    linear = motion(Oscillator(118.0, 0.004, ()))[1]
    rms, matters = np.sqrt(np.mean(v**2)), np.sqrt(np.mean((v - linear) ** 2))
    assert matters > 0.01 * rms
    # Found: 2e-5, of straight lines in the input; 6e-5 of the power's sliders.
    wrong = np.sqrt(np.mean((np.asarray(found.v)[::FINER] - v) ** 2))
    assert wrong < 2e-4 * rms


def test_the_rig_knows_every_law():
    assert {*LAWS} == {*THETA}
    for law in LAWS.values():
        assert law.name.rstrip("_0123456789") in FORCES


def test_a_law_without_a_force_is_refused():
    class Unknown(Law):
        name = "unknown"

    with pytest.raises(ModelError, match="law `unknown` of the joint is none of the rig's"):
        respond(Oscillator(118.0, 0.004, (Unknown(),)), lambda i, j: np.ones(j - i), 8, FS)


def test_elements_side_by_side_are_measured():
    both = (law_named("iwan4").of(THETA["iwan4"]), law_named("cubic").of(THETA["cubic"]))
    campaign = measure(
        joint=Oscillator(118.0, 0.004, both), tests="sweep_0p05V", repeats=1, noise_std=1e-5
    )
    assert campaign.laws == ("iwan4", "cubic")
    assert campaign.truth["joint"]["iwan_chi"] == -0.3
