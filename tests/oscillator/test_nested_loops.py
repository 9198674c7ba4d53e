"""Loops within loops of a structure of several modes: every reversal is remembered, or it is said.

The reference is Masing's rule along the motion, in plain Python with a list that has no end.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiers import represented_by

import jbw
from jbw.oscillator import deepening
from jbw.oscillator.laws.iwan import Iwan4
from jbw.oscillator.modes.structure import Structure

FS = 16384.0
LAW = Iwan4(4e3, 2e3, -0.4, 1.5)


def virgin(x):
    """Segalman's four-parameter force of the first loading, below macroslip."""
    sign, x = np.sign(x), abs(x)
    return sign * (4e3 * x - 2e3 * (x / 1e-3) ** 0.6 * x)


def masing(x):
    """Force along a motion from rest, and how many reversals are open at most."""
    turns, forces, deepest = [], [], 0  # open branches: where they begin, and the force there
    for i, at in enumerate(x):
        if i > 1:
            was = x[i - 1]
            if (at - was) * (was - x[i - 2]) < 0:
                turns.append((was, forces[-1]))
            # A branch ends where the one before its own began, or at the mirror of the first.
            while turns:
                end = turns[-2][0] if len(turns) > 1 else -turns[0][0]
                if (at - end) * np.sign(end - turns[-1][0]) <= 0:
                    break
                turns = turns[:-2] if len(turns) > 1 else []
        deepest = max(deepest, len(turns))
        if not turns:
            forces.append(virgin(at))
        else:
            begin, force = turns[-1]
            forces.append(force + 2 * virgin((at - begin) / 2))
    return np.array(forces), deepest


def structure(law=LAW):
    omega = 2 * np.pi * jnp.array([24.0, 131.0, 397.0])
    zeta, h = jnp.array([4e-3, 3e-3, 2e-3]), jnp.array([1.0, -0.8, 0.7])
    return Structure(omega, zeta, h, h, jnp.array([1.0, 0.9, -0.8]), h, (law,))


def shaken(fs=FS):
    """Three tones near the modes, which fade and come back: loops that close after many others."""
    t = np.arange(int(fs)) / fs
    tones = sum(
        a * np.sin(2 * np.pi * f * t) for a, f in ((0.15, 23.0), (2.5, 130.0), (12.0, 391.0))
    )
    return jnp.asarray(tones * np.abs(np.cos(2 * np.pi * 1.5 * t)) ** 1.5)


@pytest.mark.parametrize("places", represented_by(10, 24))
def test_every_reversal_of_several_modes_is_remembered(places, monkeypatch):
    """From the usual room on, and from less: it is solved again with twice as much."""
    monkeypatch.setattr(deepening, "OF_SEVERAL_MODES", places)
    found = jbw.simulate(structure(), shaken(), FS, substeps=4)
    assert float(found.guesses) == 0.0
    force, deepest = masing(np.asarray(found.x))
    assert deepest > 10  # more than are remembered of one mode
    # Turning points are taken at samples, 40 a period of the highest mode: 2.4e-4. With room for
    # ten reversals 7.4e-4 would be missed.
    assert np.max(np.abs(np.asarray(found.z) - force)) < 4e-4 * np.max(np.abs(force))


def test_a_memory_that_is_too_short_is_counted_under_jit(monkeypatch):
    monkeypatch.setattr(deepening, "OF_SEVERAL_MODES", 10)
    found = jax.jit(lambda u: jbw.simulate(structure(), u, FS, substeps=4))(shaken())
    assert float(found.guesses) > 0.0
