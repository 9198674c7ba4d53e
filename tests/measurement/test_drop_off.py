"""A drive that drops off at a resonance, by its size alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from jbw.measurement.hypotheses.drop_off import drop_off

SIZE = 2000


def drive(least, noise, seed=3):
    """A drive of size one that falls to `least` in the middle, with noise of each sample."""
    rng, place = np.random.default_rng(seed), np.linspace(-1, 1, SIZE)
    fallen = 1 - (1 - least) * np.exp(-((place / 0.15) ** 2))
    return SimpleNamespace(u=fallen + noise * rng.standard_normal(SIZE))


def test_a_drive_that_drops_off_into_its_noise_is_told_with_both_sizes():
    least, noise = drop_off(drive(0.2, 0.03))
    # Averages over 2 % of the values lie 3 % above the least one; the noise is 0.03 / 0.2.
    assert least == pytest.approx(0.2, rel=0.15)
    assert noise == pytest.approx(0.15, rel=0.2)


@pytest.mark.parametrize(
    ("least", "noise"),
    [
        (0.8, 0.03),  # hardly falls
        (0.2, 0.002),  # falls, and is measured well
        (0.2, 0.5),  # of a random size throughout: no sweep
    ],
)
def test_other_drives_do_not_drop_off(least, noise):
    assert drop_off(drive(least, noise)) is None
