"""What a law's misfit makes repeated data count for, against least squares that are simulated.

Seeds were fixed before the first run.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from scipy.signal import lfilter

from jbw.observables.dataset import Dataset
from jbw.observables.groups import repeated, weights
from jbw.observables.misfit import group_residuals, independent_fractions, shared_misfit
from jbw.observables.noise import with_discrepancy, with_effective_values, with_fitted_noise
from jbw.observables.observable import Observable

SEEDS = (0, 1, 2)
SIZE = 600
COVARIANCE = np.eye(1)  # of one parameter: its scale does not matter


class Lines(Observable):
    """Groups that are a parameter times a shape of their own."""

    shape: Float[Array, "group value"]

    def predict(self, theta):
        return theta["p"] * self.shape


def lines(shapes, data):
    """The observable of data (group, repeat, value)."""
    mean = data.mean(axis=1)
    groups, _, size = data.shape
    own = repeated(
        list(data),
        np.full(groups, size),
        [f"group {i}" for i in range(groups)],
        [f"run {i}" for i in range(groups)],
    )
    return Lines(laws=(), mean=jnp.asarray(mean), shape=jnp.asarray(shapes), groups=own)


def weighed(part, p):
    """The groups with the weights that a fit of p leaves, as the joint finds them."""
    rows = np.asarray(part.misfit({"p": p}))
    left = dict(zip(part.groups.labels, rows, strict=True))
    columns = [dict(zip(part.groups.labels, -np.asarray(part.shape), strict=True))]
    expected = with_discrepancy(left, Dataset.of([part]))
    (table,) = (each.groups for each in expected.parts)
    fractions = independent_fractions(table, left, columns, COVARIANCE)
    noisy = with_fitted_noise({"p": p}, left, expected)
    return with_effective_values(fractions, noisy).parts[0], left, fractions


def curvature(part, p):
    """Of each group's term of the log likelihood, its noise integrated out."""

    def terms(value):
        return part.estimate({"p": value}, 0).log_density

    return -np.asarray(jax.jacfwd(jax.jacfwd(terms))(jnp.asarray(p)))


def simulated(rng, shape, *, count, noise, misfit, coloured=0.0):
    """Repeats about the shape, with a misfit that all of them share."""
    own = lfilter([np.sqrt(1 - coloured**2)], [1.0, -coloured], rng.normal(size=SIZE + 500))[500:]
    return (shape + misfit * own + noise * rng.normal(size=(count, SIZE)))[None]


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("seed", SEEDS)
def test_white_noise_counts_in_full(seed, count):
    rng = np.random.default_rng(seed)
    shapes = rng.normal(size=(3, SIZE))
    data = np.concatenate(
        [
            simulated(rng, shape, count=count, noise=0.1 * (i + 1), misfit=0.0)
            for i, shape in enumerate(shapes)
        ]
    )
    part, _, fractions = weighed(lines(shapes, data), 1.0)
    assert fractions == {}
    np.testing.assert_array_equal(part.groups.num_values, np.full(3, SIZE * count))
    np.testing.assert_array_equal(part.groups.discrepancy, np.zeros(3))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_misfit_that_all_repeats_share_tells_as_much_as_one_of_them(seed):
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=SIZE)
    found = {}
    for count in (4, 16, 64):
        data = simulated(rng, shape, count=count, noise=0.1, misfit=0.3)
        part, left, _ = weighed(lines(shape[None], data), 1.0)
        noise, misfit, is_misfit = group_residuals(part.groups, left)[0]
        assert is_misfit
        # 600 values know a mean square to sqrt(2 / 600).
        assert misfit == pytest.approx(0.09, rel=4 * np.sqrt(2 / SIZE))
        assert noise == pytest.approx(0.01, rel=4 * np.sqrt(2 / (SIZE * (count - 1))))
        # The closed form: w K |J|^2 / (K tau^2 + sigma^2), with the tau and sigma that are found.
        total = count * misfit + noise
        white = count * np.sum(shape**2) / total
        share = curvature(part, 1.0)[0] / white
        # White: what is not one is the colour that a finite residual has by chance. The slope of
        # Q at p = 1, which is not the least squares' own optimum, adds 2 / n.
        assert 0.7 < share < 1.02
        found[count] = curvature(part, 1.0)[0] * 0.09 / np.sum(shape**2)
    for information in found.values():
        # That of one repeat without noise, for any number of them.
        assert 0.6 < information < 1.3


@pytest.mark.parametrize("coloured", [0.0, 0.9])
def test_the_interval_is_the_scatter_that_least_squares_really_has(coloured):
    rng = np.random.default_rng(0)
    t = np.arange(SIZE)
    # A chirp from rest: over many lines of the spectrum, of which an AR(1) is loud at the lowest.
    shape = np.sin(0.05 * t + 3e-4 * t**2) * np.sin(np.pi * t / SIZE)
    estimates, widths = [], []
    for number in range(200):
        data = simulated(rng, shape, count=8, noise=0.2, misfit=0.3, coloured=coloured)
        p = float(data.mean(axis=(0, 1)) @ shape / (shape @ shape))
        estimates.append(p)
        if number < 60:
            part, *_ = weighed(lines(shape[None], data), p)
            widths.append(1 / np.sqrt(curvature(part, p)[0]))
    # 200 estimates know their scatter to 5 %. A residual knows its spectrum along the shape to
    # 10 % or 20 %, and none is taken for less than white.
    assert np.median(widths) / np.std(estimates) == pytest.approx(1.0, rel=0.3)
    if not coloured:  # in closed form: what the misfit and the mean's noise make of it
        exact = np.sqrt((0.09 + 0.04 / 8) / (shape @ shape))
        assert np.median(widths) == pytest.approx(exact, rel=0.2)


def four(rng, *, missed=None, coloured=0.8):
    """Groups of very different sizes that a law misses by some 3 %, and one by all of it.

    What it misses is slow, as the motion is: a group counts for a small share of its values, yet
    for more than the eight that are the least.
    """
    scales = (1.0, 10.0, 0.1, 3.0)
    turns = np.arange(SIZE)[None] * np.array([[0.02], [0.03], [0.05], [0.04]])
    shapes = np.array(scales)[:, None] * np.sqrt(2) * np.sin(turns)
    data = np.concatenate(
        [
            simulated(
                rng, shape, count=4, noise=0.002 * scale, misfit=0.03 * scale, coloured=coloured
            )
            for scale, shape in zip(scales, shapes, strict=True)
        ]
    )
    if missed is not None:
        own = lfilter([1.0], [1.0, -coloured], rng.normal(size=SIZE + 500))[500:]
        data[missed] += own / own.std() * scales[missed]
    return shapes, data


def of_groups(part, order):
    """Repeats, sizes and residual in another order of the groups."""
    own, place = part.groups, np.array(order)
    moved = replace(
        jax.tree.map(lambda column: column[place], own),
        labels=tuple(own.labels[i] for i in order),
        runs=tuple(own.runs[i] for i in order),
    )
    return moved, np.linalg.norm(np.asarray(part.mean)[place], axis=1)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_order_of_groups_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    shapes, data = four(rng, missed=2)
    part, left, fractions = weighed(lines(shapes, data), 1.0)
    columns = [dict(zip(part.groups.labels, -shapes, strict=True))]
    assert set(fractions) == set(part.groups.labels)
    for order in ((3, 1, 0, 2), (2, 3, 1, 0)):
        own, sizes = of_groups(part, order)
        shared = shared_misfit(own, sizes, left)
        # Sums in another order: rounding.
        np.testing.assert_allclose(
            shared, np.asarray(part.groups.discrepancy)[list(order)], rtol=1e-12
        )
        other = independent_fractions(own, left, columns, COVARIANCE)
        assert other == pytest.approx(fractions, rel=1e-12)


@pytest.mark.parametrize("missed", range(4))
@pytest.mark.parametrize("seed", SEEDS)
def test_a_group_that_a_law_misses_keeps_its_voice(seed, missed):
    shapes, data = four(np.random.default_rng(seed))
    usual, *_ = weighed(lines(shapes, data), 1.0)
    shapes, data = four(np.random.default_rng(seed), missed=missed)
    part, left, _ = weighed(lines(shapes, data), 1.0)
    # Every group's share of the response is the mean of all: a quarter of what is missed wholly,
    # the size of whose response is doubled by it.
    shares = np.asarray(part.groups.discrepancy) * SIZE / np.sum(np.asarray(part.mean) ** 2, 1)
    np.testing.assert_allclose(shares, shares[0], rtol=1e-12)
    misfits = [misfit for _, misfit, _ in group_residuals(part.groups, left)]
    squares = np.mean(np.asarray(part.mean) ** 2, axis=1)
    assert shares[0] == pytest.approx(np.mean(misfits / squares), rel=1e-12)
    raised = np.asarray(part.groups.discrepancy) / np.asarray(usual.groups.discrepancy)
    assert np.all(raised > 30)  # from a thousandth to an eighth
    fractions = np.asarray(part.groups.num_values) / (4 * SIZE)
    assert np.all((fractions > 1.001 * 8 / SIZE) & (fractions < 1))
    # Weights by the size of the response alone, of which the missed one has lost nothing: the
    # noise is a thousandth of the misfit, and the colour is shared.
    weight = np.asarray(weights(part.groups)) ** 2 * squares
    np.testing.assert_allclose(weight / weight.mean(), 1.0, rtol=1e-3)
