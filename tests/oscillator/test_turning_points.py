"""How often a periodic motion turns, against signs of its slope on a fine grid."""

import jax.numpy as jnp
import numpy as np
import pytest

from jbw.oscillator.steady.waveform import num_turns

MOTIONS = ([1], [-1], [1j], [-1j], [-1, 0, 0], [1, 0.05, 0], [-1, 0, 0.2], [0.3 + 0.4j, 0.3, 0])


@pytest.mark.parametrize("motion", MOTIONS, ids=str)
def test_turns_of_motions_in_phase_and_out_of_it_are_counted(motion):
    """A motion in phase, of either sign, has its crest on an angle of the grid, and turns twice."""
    q, n = np.array(motion, complex), 2 * np.arange(len(motion)) + 1
    theta = 2 * np.pi * (np.arange(20000) + 0.3) / 20000
    rising = np.real(np.exp(1j * np.outer(theta, n)) @ (1j * n * q)) > 0
    expected = int(np.sum(rising != np.roll(rising, 1)))
    assert int(num_turns(jnp.asarray(q))) == expected
