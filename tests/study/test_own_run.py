"""Days on which a structure has another frequency: what was fitted is compared by its own day."""

import numpy as np
import pytest

import jbw
from jbw import Campaign, Record, Test
from jbw.campaign.settings import Identify

HZ, ZETA, GAIN, NOISE = 18.8, 0.01, 15.0, 0.004
# Of each day, relative; friday is held out. Offsets enter to first order: of a resonance as wide as
# two per cent these leave a thousandth.
DAYS = {"monday": -5e-4, "tuesday": 0.0, "wednesday": 4e-4, "thursday": -2e-4, "friday": 9e-4}
FREQ = np.linspace(17.5, 20.0, 61)


def curve(day, shift):
    """A measured curve of the linear oscillator in closed form, with noise."""
    rng = np.random.default_rng(list(DAYS).index(day))
    omega, omega_n = 2 * np.pi * FREQ, 2 * np.pi * HZ * (1 + shift)
    y = GAIN / (omega_n**2 - omega**2 + 2j * ZETA * omega_n * omega)
    noise = rng.standard_normal((2, len(FREQ))) * NOISE * np.sqrt(np.mean(np.abs(y) ** 2) / 2)
    y = y + noise[0] + 1j * noise[1]
    channels = {
        "frequency": FREQ, "force": np.ones(len(FREQ)), "displacement": np.abs(y),
        "phase": np.angle(y),
    }  # fmt: skip
    units = {"frequency": "Hz", "force": "N", "displacement": "m", "phase": "rad"}
    return Test("frf", (Record(np.nan, channels, units),), name=day, level=1.0)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    settings = Identify(hold_out=("friday",), offsets="runs", seed=3)
    tests = tuple(curve(day, shift) for day, shift in DAYS.items())
    folder = tmp_path_factory.mktemp("days")
    return jbw.identify(Campaign("days", folder, tests, settings=settings, laws=()))


def test_a_fitted_day_is_predicted_at_its_own_frequency(study):
    for day in ("monday", "tuesday", "wednesday", "thursday"):
        attrs = study.tree[f"verification/curve/{day}"].attrs
        # Noise alone; a thousandth off in frequency would leave ten times as much.
        assert attrs["nrmse"] == pytest.approx(NOISE, rel=0.25)
        assert "nrmse_linear" not in attrs  # the model is that oscillator
        assert attrs["coverage"] > 0.95


def test_a_further_day_is_predicted_by_their_scatter(study):
    attrs = study.tree["verification/curve/friday"].attrs
    assert attrs["nrmse"] > 5 * NOISE
    assert attrs["coverage"] > 0.95
    found = study.predict("friday")
    assert found.attrs["nrmse"] > 5 * NOISE
    assert study.predict("monday").attrs["nrmse"] == pytest.approx(NOISE, rel=0.25)
