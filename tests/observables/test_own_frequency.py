"""The error of a free decay with the record's own frequency."""

import numpy as np
import pytest

from jbw.verification.decays import at_own_frequency


def test_an_offset_of_frequency_is_taken_out_and_nothing_else():
    time = np.linspace(0.0, 8.0, 4001)
    law = np.exp(-0.7 * time) * np.exp(0.3j * time**2 / (1 + time))
    offset, rate = 0.13, 0.02
    measured = law * np.exp((1j * offset - rate) * time)
    draws = np.array([law * (1 + x) for x in (-1e-3, 0.0, 1e-3)])
    turned = at_own_frequency(measured, draws, time)
    # What is left is the rate alone, in phase with the motion.
    np.testing.assert_allclose(np.angle(measured * np.conj(turned)), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(turned), np.abs(law), rtol=1e-12)
    as_it_stands = np.linalg.norm(measured - law) / np.linalg.norm(measured)
    with_own = np.linalg.norm(measured - turned) / np.linalg.norm(measured)
    assert as_it_stands > 5 * with_own


def test_a_decay_without_an_offset_stays_as_it_is():
    time = np.linspace(0.0, 8.0, 401)
    law = np.exp((-0.7 + 2j) * time)
    noise = np.random.default_rng(0).standard_normal((2, 401)) * 1e-3
    turned = at_own_frequency(law + noise[0] + 1j * noise[1], law[None], time)
    # Noise of 1e-3 of the amplitude moves a frequency by 1e-3 / sqrt(100) over a second.
    assert np.angle(turned * np.conj(law))[-1] == pytest.approx(0.0, abs=5e-3)
