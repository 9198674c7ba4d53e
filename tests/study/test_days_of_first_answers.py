"""A first answer knows each day of its campaign, as a drawn posterior does."""

import numpy as np
import pytest
from scipy.signal import lsim

import jbw

pytestmark = pytest.mark.slow
OMEGA, ZETA, FS, NOISE = 2 * np.pi * 18.0, 0.01, 512.0, 0.02
DAYS = {"monday": -2e-3, "tuesday": 3e-3, "friday": -1e-3}  # relative changes of omega_n


def swept(day, seed):
    """A sweep over a linear oscillator whose frequency is that of the day."""
    t = np.arange(0, 16, 1 / FS)
    force = np.sin(2 * np.pi * (15 * t + 6 / 32 * t**2))
    omega_n = OMEGA * (1 + DAYS[day])
    system = ([1.0, 0.0], [1.0, 2 * ZETA * omega_n, omega_n**2])
    _, v, _ = lsim(system, force, t)
    v = v + NOISE * np.std(v) * np.random.default_rng(seed).standard_normal(len(t))
    record = jbw.Record(FS, {"force": force, "velocity": v}, {"force": "N", "velocity": "m/s"})
    return jbw.Test("sweep", (record,), f"sweep of {day}", run=day)


def test_sweeps_are_predicted_with_the_frequency_of_their_day():
    tests = tuple(swept(day, seed) for seed, day in enumerate(DAYS))
    settings = {"offsets": "runs"}
    campaign = jbw.Campaign("days", None, tests, gain=1.0, settings=settings, laws=())
    study = jbw.identify(campaign, quick=True, report=lambda _: None)
    runs = study.tree["runs"]["omega_n"]
    for test in tests:
        # Its own noise; the parameters add a hundredth of that.
        assert study.predict(test).attrs["nrmse"] == pytest.approx(NOISE, rel=0.05)
        omega = runs.sel(run=test.run).values
        assert abs(np.mean(omega) - OMEGA * (1 + DAYS[test.run])) < 4 * np.std(omega)
    assert "vary around it" in " ".join(study.record["steps"]["joint"]["statements"])
