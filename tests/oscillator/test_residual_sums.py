"""Sums of the time loop, against NumPy's sums over the response that the loop does not write."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known_laws import THETA, law_of
from tiers import represented_by

import jbw
from jbw.oscillator.hold import held
from jbw.oscillator.oscillator import Oscillator
from jbw.oscillator.residual_sums import Compared, residual_sums

FS = 1024.0
SIZE = 256
TIME = np.arange(SIZE) / FS
INPUT = 8.0 * np.sin(2 * np.pi * 17 * TIME) * np.sin(2 * np.pi * 3 * TIME)
RNG = np.random.default_rng(0)
MEASURED = np.outer([4e-4, 4e-2, 4.0], np.sin(110.0 * TIME))  # of about the response's size
DIRECTIONS, PARTS = RNG.normal(size=(2, SIZE)), np.array([1e-3, -2e-3])
ROWS = RNG.normal(size=(3, SIZE))
LINEAR = Oscillator(118.0, 0.01, ())
BOUC_WEN = Oscillator(118.0, 0.01, (law_of("bouc_wen"),))


def compared(order=1, first=0, rows=ROWS):
    kept = slice(first, None)
    arrays = MEASURED[order, kept], DIRECTIONS[:, kept], PARTS, rows[:, kept]
    return Compared(*map(jnp.asarray, arrays), order=order, first=first)


@eqx.filter_jit
def summed(joint, source, gain, substeps, rows):
    return residual_sums(joint, source.times(gain), FS, substeps, rows)


def sums_of(joint, gain=1.0, *, substeps=2, hold="band_limited", **options):
    joint, gain = jax.tree.map(lambda x: jnp.asarray(x, float), (joint, gain))
    return summed(joint, held(INPUT, hold, periodic=False), gain, substeps, compared(**options))


def expected(joint, gain=1.0, *, substeps=2, hold="band_limited", order=1, first=0):
    motion = jbw.simulate(joint, gain * INPUT, FS, substeps=substeps, hold=hold)
    response = np.asarray(getattr(motion, "yva"[order]))
    residual = (MEASURED[order] - response - PARTS @ DIRECTIONS)[first:]
    return residual @ residual, ROWS[:, first:] @ residual, np.max(np.abs(response[first:]))


def agree(sums, numbers):
    # Sums of 256 products whose order differs: rounding.
    np.testing.assert_allclose(sums.square, numbers[0], rtol=1e-12)
    scale = np.sqrt(numbers[0] * np.sum(ROWS**2, axis=1))
    np.testing.assert_allclose(sums.along / scale, numbers[1] / scale, atol=1e-13)
    np.testing.assert_allclose(sums.peak, numbers[2], rtol=1e-12)


@pytest.mark.parametrize(
    "names", [list(THETA)[start : start + 5] for start in range(0, len(THETA), 5)], ids="-".join
)
def test_sums_of_every_law(names):
    """Laws side by side in a joint: the memory of each counts, and few programs are compiled."""
    joint = Oscillator(118.0, 0.01, tuple(map(law_of, names)))
    agree(sums_of(joint), expected(joint))


@pytest.mark.parametrize(("order", "first"), [(0, 0), (1, 100), (2, 0), (2, 100)])
def test_sums_of_every_response_from_any_sample(order, first):
    agree(sums_of(BOUC_WEN, order=order, first=first), expected(BOUC_WEN, order=order, first=first))


@pytest.mark.parametrize(
    ("hold", "substeps"), represented_by(("band_limited", 3), ("zero", 2), ("first", 1))
)
def test_sums_under_every_hold(hold, substeps):
    options = {"hold": hold, "substeps": substeps}
    agree(sums_of(BOUC_WEN, **options), expected(BOUC_WEN, **options))


@pytest.mark.parametrize("gain", [0.0, -2.5])
def test_gains_of_zero_and_below(gain):
    agree(sums_of(BOUC_WEN, gain), expected(BOUC_WEN, gain))


def test_no_rows_are_no_products():
    assert sums_of(BOUC_WEN, rows=ROWS[:0]).along.shape == (0,)


def test_derivatives_are_those_of_differences():
    """In forward and reverse mode, by the gain and by the joint."""

    def square(x):
        joint = Oscillator(118.0 * x[0], 0.01, (law_of("bouc_wen"),))
        return sums_of(joint, x[1], substeps=4).square

    at, size = jnp.ones(2), 1e-5
    forward, reverse = jax.jit(jax.jacfwd(square))(at), jax.jit(jax.grad(square))(at)
    value = jax.jit(square)
    steps = size * np.eye(2)
    difference = [(value(at + step) - value(at - step)) / (2 * size) for step in steps]
    np.testing.assert_allclose(forward, reverse, rtol=1e-11)
    # Kinks between the samples leave the step's own error of its gradient, 1e-4 at four substeps.
    np.testing.assert_allclose(forward, difference, rtol=1e-4)


def test_a_lane_that_diverges_is_alone():
    """Delta below -gamma feeds energy: that lane is NaN or infinite, and its neighbours are not."""
    delta = jnp.asarray([300.0, -5e6, 350.0])

    def square(delta):
        law = jbw.BoucWen(118.0, 0.01, 500.0, delta, 30.0).laws[0]
        return sums_of(Oscillator(118.0, 0.01, (law,))).square

    lanes, alone = jax.jit(jax.vmap(square))(delta), [square(x) for x in delta]
    assert not np.isfinite(lanes[1])
    # Lanes are compiled to other orders of sums and products: rounding.
    np.testing.assert_allclose(lanes[::2], alone[::2], rtol=1e-12)


def test_a_linear_record_is_that_of_scipy():
    """The state-space integration of SciPy under a first-order hold."""
    from scipy.signal import lsim

    system = ([[0.0, 1.0], [-(118.0**2), -2.36]], [[0.0], [1.0]], [[0.0, 1.0]], [[0.0]])
    _, velocity, _ = lsim(system, INPUT, TIME, interp=True)
    residual = MEASURED[1] - velocity - PARTS @ DIRECTIONS
    # Of SciPy's matrix exponential over 256 samples.
    np.testing.assert_allclose(
        sums_of(LINEAR, hold="first").square, residual @ residual, rtol=1e-11
    )
