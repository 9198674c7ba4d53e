"""A loop as an infilled wall gives it, pinched and degrading, of the rig; identified from it alone.

What thirty loops of other noise gave, in cycles of four amplitudes: docs/howto/loops.md.
"""

import numpy as np
import pytest
from known_laws import law_of

import jbw
from jbw.campaign.load import Campaign
from jbw.measurement.records import Record, Test
from jbw.oscillator.oscillator import Oscillator
from jbw.rig.prescribed_motion import Growth, pulled

pytestmark = [pytest.mark.release, pytest.mark.filterwarnings("ignore")]

OMEGA_N, NOISE, FS = 90.0, 5e-3, 80.0  # rad/s, of the largest force, samples a cycle
TRUTH = {
    "bwbn_stiffness": 7000.0, "bwbn_yield": 4e-3, "bwbn_n": 1.2, "bwbn_beta": 0.7,
    "bwbn_zeta_s": 0.85, "bwbn_p": 0.3, "bwbn_q": 0.15, "bwbn_psi": 0.25,
    "bwbn_delta_psi": 0.01, "bwbn_lambda": 0.4, "bwbn_delta_nu": 0.02, "bwbn_delta_eta": 0.03,
}  # fmt: skip


def test_a_wall_s_loop_is_identified_with_its_wear():
    joint = Oscillator(OMEGA_N, 0.0, (law_of("bwbn", TRUTH),))
    y, force = pulled(joint, Growth(1.0, 0.02, duration=10.0), FS)
    largest = np.abs(force).max()
    force = force + NOISE * largest * np.random.default_rng(3).standard_normal(len(force))
    units = {"displacement": "m", "restoring_force": "N"}
    record = Record(FS, {"displacement": y, "restoring_force": force}, units, name="wall")
    test = Test("loop", (record,), "wall", level=0.02)
    campaign = Campaign("wall", None, (test,), modal_mass=1.0, laws=("bwbn",))
    study = jbw.identify(campaign, seed=1, report=lambda _: None)
    posterior = study.tree["posterior"].to_dataset()
    for name, value in {**TRUTH, "omega_n": OMEGA_N}.items():
        z = (posterior[name].mean() - value) / posterior[name].std()
        assert abs(z) < 4, f"{name}: {float(z):.1f}"
    assert study.record["verdict"]["status"] == "ok"
    # What is left is the noise, of which the rms of the force is half of the largest or less.
    error = study.tree["verification/loop/wall"].attrs["nrmse"]
    assert error == pytest.approx(NOISE * largest / np.sqrt(np.mean(force**2)), rel=0.1)
