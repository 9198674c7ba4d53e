"""The stabilisation diagram: modes in closed form, in noise, and beside another program's."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

from jbw.errors import DataError
from jbw.identification.modal import stabilisation

FREQ = np.arange(5.0, 15.0, 0.02)
OMEGA, ZETA = 2 * np.pi * np.array([7.0, 7.4, 11.0]), np.array([0.004, 0.006, 0.01])
RESIDUES = np.array([[1.0, 2.0, -1.0], [1.0, -1.0, 0.5]])


def outputs(noise=0.0, freq=FREQ, response="displacement"):
    """Receptances of three modes and a constant, with noise of this share of the peak."""
    rng, omega = np.random.default_rng(0), 2 * np.pi * freq
    found = []
    for row in RESIDUES:
        poles = OMEGA**2 - omega[:, None] ** 2 + 2j * ZETA * OMEGA * omega[:, None]
        h = (row / poles).sum(axis=1) + 1e-4
        white = rng.normal(size=len(h)) + 1j * rng.normal(size=len(h))
        h = h + noise * np.abs(h).max() * white
        found.append(SimpleNamespace(freq=freq, omega=omega, h=h, response=response))
    return found


@pytest.mark.parametrize("response", ["displacement", "acceleration"])
def test_modes_without_noise_are_exact(response):
    found = stabilisation(outputs(response=response), 3).modes
    # A fraction of order n in z follows negative frequencies and the constant geometrically.
    np.testing.assert_allclose(found[:, 0], OMEGA, rtol=1e-6)
    np.testing.assert_allclose(found[:, 1], ZETA, rtol=1e-3)


def test_modes_stay_in_noise_and_its_poles_do_not():
    found = stabilisation(outputs(0.01), 3)
    # A line is 1 % of the peak off: a pole's frequency by some 1e-4, its damping by some per cent.
    np.testing.assert_allclose(found.modes[:, 0], OMEGA[:2], rtol=1e-3)
    np.testing.assert_allclose(found.modes[:, 1], ZETA[:2], rtol=0.1)
    near = np.abs(found.omega[:, None] / OMEGA - 1).min(axis=1) < 1e-2
    assert found.is_stable[near].mean() > 3 * found.is_stable[~near].mean()
    assert np.all((found.omega >= 2 * np.pi * 5.0) & (found.omega <= 2 * np.pi * 15.0))


def test_the_orders_are_two_to_eight_times_the_modes():
    found = stabilisation(outputs(0.01), 5)
    assert (found.order.min(), found.order.max()) == (10, 40)
    with pytest.raises(DataError, match="must contain at least 19 lines to look for 4 modes"):
        stabilisation(outputs(freq=FREQ[:18]), 2)


@pytest.mark.filterwarnings("ignore")
def test_another_program_finds_the_same_modes():
    """Against sdypy-EMA's pLSCF, by its closest stable poles; it is no requirement of jbw's."""
    try:
        ema = importlib.import_module("sdypy.EMA")
    except ImportError as absent:
        pytest.skip(f"sdypy-EMA is not installed: {absent}")
    freq = np.arange(0.0, 20.0, 0.02)
    found = outputs(freq=freq[1:])
    frfs = np.array([np.append(0.0, one.h) for one in found])
    # It looks within 2 Hz about a frequency: in units of a hundredth of a second modes are apart.
    band = {"lower": 500, "upper": 1500}
    model = ema.Model(frfs, 100 * freq, pol_order_high=40, frf_form="receptance", **band)
    model.get_poles(show_progress=False)
    model.select_closest_poles(list(100 * OMEGA / (2 * np.pi)), f_window=10)
    ours = stabilisation(outputs(), 3).modes
    # It keeps poles to 0.1 % and 5 %, and its real coefficients fit a constant less well.
    np.testing.assert_allclose(np.sort(model.nat_freq) / 100, ours[:, 0] / (2 * np.pi), rtol=1e-3)
    np.testing.assert_allclose(
        np.asarray(model.nat_xi)[np.argsort(model.nat_freq)], ours[:, 1], rtol=0.05
    )
