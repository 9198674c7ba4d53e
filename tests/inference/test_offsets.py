"""Offsets of runs integrated out, against quadrature, scipy's normal density and least squares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from jbw.inference.groups.offsets import (
    Estimate,
    estimate,
    known_estimate,
    log_determinant,
    shrunk,
    solve,
)
from jbw.inference.groups.scatter import draw_offsets, log_density_of_offsets, scatter_grid

RNG = np.random.default_rng(3)


def brute_force(r, within, count, directions, scatter):
    """log of the integral over one offset and the noise, on a grid."""
    b = np.linspace(-8, 8, 1601)[:, None]
    log_sigma = np.linspace(-2, 1, 601)[None, :]
    left = r[None] - b * directions[0][None]
    q = count * np.sum(left**2, axis=1)[:, None] + within
    n = count * len(r)
    log_p = -n * log_sigma - q / (2 * np.exp(2 * log_sigma)) - b**2 / (2 * scatter**2)
    return logsumexp(log_p) - np.log(scatter)


def test_offset_and_noise_are_integrated_out():
    num, count, scatter = 200, 4, 1.5
    direction = np.sin(np.linspace(0, 7, num))[None]
    noise = 0.3 * RNG.normal(size=num)
    within = 0.09 * num * (count - 1) * 4

    def ours(offset):
        r = offset * direction[0] + noise
        found = estimate(
            jnp.sum(r**2)[None], jnp.asarray(direction @ r)[None], jnp.asarray([within]),
            jnp.asarray([float(count)]), jnp.asarray([float(num * count)]),
            jnp.asarray(direction)[None],
        )  # fmt: skip
        density = log_density_of_offsets(found, ((0,),), np.array([[scatter]]))
        return float(found.log_density[0] + density), r

    pairs = [ours(0.2), ours(2.5)]
    exact = [brute_force(r, within, count, direction, scatter) for _, r in pairs]
    # The noise in the offset's precision is taken at its estimate, known to 1 / sqrt(2 n) = 2.5 %;
    # its effect on the density of an offset of 2.5 is of second order.
    assert pairs[1][0] - pairs[0][0] == pytest.approx(exact[1] - exact[0], abs=0.02)


def test_without_offsets_only_the_noise_is_integrated_out():
    r = RNG.normal(size=(2, 50))
    found = estimate(
        jnp.sum(r**2, axis=1), jnp.zeros((2, 0)), jnp.asarray([3.0, 4.0]), jnp.asarray([2.0, 3.0]),
        jnp.asarray([100.0, 150.0]), jnp.zeros((2, 0, 50)),
    )  # fmt: skip
    squares = np.array([2.0, 3.0]) * np.sum(r**2, axis=1) + [3.0, 4.0]
    np.testing.assert_allclose(found.log_density, [-50, -75] * np.log(squares), rtol=1e-13)
    assert log_density_of_offsets(found, ((0, 1),), np.zeros((1, 0))) == 0.0


def test_density_of_offsets_is_that_of_a_normal_distribution():
    runs, own = (0, 1, 0, 2), 2
    roots = RNG.normal(size=(4, own, own)) + 2 * np.eye(own)
    precision = roots @ np.swapaxes(roots, 1, 2)
    offset = RNG.normal(size=(4, own))
    scatters = scatter_grid((0.1, 0.2), (1.0, 3.0))
    found = Estimate(jnp.zeros(4), jnp.asarray(offset), jnp.asarray(precision))

    def exact(scatter):
        covariance = np.zeros((4, own, 4, own))
        for g in range(4):
            covariance[g, :, g, :] += np.linalg.inv(precision[g])
            for h in range(4):
                if runs[g] == runs[h]:
                    covariance[g, :, h, :] += np.diag(scatter**2)
        return multivariate_normal(np.zeros(8), covariance.reshape(8, 8)).logpdf(offset.ravel())

    constant = 0.5 * np.sum(np.linalg.slogdet(precision)[1]) - 4 * np.log(2 * np.pi)
    reference = logsumexp([exact(s) for s in scatters]) - np.log(len(scatters)) - constant
    ours = float(log_density_of_offsets(found, (runs,), scatters))
    assert ours == pytest.approx(reference, rel=1e-10)


def test_a_scatter_whose_median_is_stated_is_log_normal():
    """Of the dense integral over offsets that are normal and a scatter that is log-normal."""
    sure, seen = 4.0, np.array([[0.9], [-0.4], [1.7]])  # precision and offsets of three runs
    found = Estimate(
        jnp.zeros(3), jnp.asarray(seen), jnp.asarray(np.full((3, 1, 1), sure)),
    )  # fmt: skip
    nodes = scatter_grid((1e-3,), (1e3,), medians=(0.8,))
    ours = log_density_of_offsets(found, ((0, 1, 2),), jnp.asarray(nodes))
    log_s = np.linspace(-8.0, 8.0, 20001) * np.log(2.0) + np.log(0.8)
    std = np.sqrt(np.exp(2 * log_s) + 1 / sure)
    each = norm.logpdf(seen, 0.0, std).sum(axis=0) + norm.logpdf(log_s, np.log(0.8), np.log(2.0))
    exact = logsumexp(each) + np.log(log_s[1] - log_s[0])
    # Up to the constant of the observations' own density.
    constant = 3 * norm.logpdf(0.0, 0.0, 1 / np.sqrt(sure))
    # Seventeen nodes of one weight leave a few thousandths.
    np.testing.assert_allclose(float(ours), exact - constant, atol=0.01)
    assert np.median(nodes) == pytest.approx(0.8)


@pytest.mark.parametrize("own", [1, 2, 3, 4])
def test_offsets_of_any_number_are_integrated_out_of_the_likelihood(own):
    """Against the dense normal density of all values of three groups, two of them of one run."""
    rng, runs, num = np.random.default_rng(own), (0, 1, 0), 12
    directions = rng.normal(size=(3, own, num))
    residual, scatter = rng.normal(size=(3, num)), np.geomspace(0.3, 2.0, own)
    found = known_estimate(jnp.asarray(residual), jnp.asarray(directions))
    ours = float(jnp.sum(found.log_density) + log_density_of_offsets(found, (runs,), scatter[None]))
    covariance = np.eye(3 * num)
    for run in set(runs):
        moved = np.concatenate([d.T * (run == r) for d, r in zip(directions, runs, strict=True)])
        covariance += moved @ np.diag(scatter**2) @ moved.T
    exact = multivariate_normal(np.zeros(3 * num), covariance).logpdf(residual.ravel())
    # A constant of the values' number apart; twelve digits less a condition of some hundred.
    assert ours == pytest.approx(exact + 1.5 * num * np.log(2 * np.pi), rel=1e-10)


@pytest.fixture
def nested():
    """Five groups of four runs in two assemblies, and their covariance under given scatters."""
    levels, own = ((0, 1, 0, 2, 3), (0, 0, 1, 1)), 2
    roots = RNG.normal(size=(5, own, own)) + 2 * np.eye(own)
    precision = roots @ np.swapaxes(roots, 1, 2)
    found = Estimate(jnp.zeros(5), jnp.asarray(RNG.normal(size=(5, own))), jnp.asarray(precision))

    def covariance(scatter):
        """Of the offsets of the runs, by the definition."""
        whole = np.zeros((4, own, 4, own))
        for r in range(4):
            for q in range(4):
                if r == q:
                    whole[r, :, q, :] += np.diag(scatter[:2] ** 2)
                if levels[1][r] == levels[1][q]:
                    whole[r, :, q, :] += np.diag(scatter[2:] ** 2)
        return whole.reshape(8, 8)

    member = np.kron(np.eye(4)[list(levels[0])], np.eye(own))
    noise = np.zeros((10, 10))
    for g in range(5):
        noise[2 * g : 2 * g + 2, 2 * g : 2 * g + 2] = np.linalg.inv(precision[g])
    return found, levels, covariance, member, noise


def test_runs_of_assemblies_are_a_nested_normal_distribution(nested):
    found, levels, covariance, member, noise = nested
    scatters = scatter_grid((0.1, 0.2), (1.0, 3.0), assemblies=True)[::997]
    offset = np.asarray(found.offset).ravel()
    exact = [
        multivariate_normal(np.zeros(10), member @ covariance(s) @ member.T + noise).logpdf(offset)
        for s in scatters
    ]
    constant = 0.5 * np.sum(np.linalg.slogdet(found.precision)[1]) - 5 * np.log(2 * np.pi)
    reference = logsumexp(exact) - np.log(len(scatters)) - constant
    ours = float(log_density_of_offsets(found, levels, scatters))
    assert ours == pytest.approx(reference, rel=1e-10)


@pytest.mark.slow
def test_drawn_offsets_have_the_conditional_mean_and_covariance(nested):
    found, levels, covariance, member, noise = nested
    scatter = np.array([0.4, 0.7, 0.9, 0.3])
    prior = covariance(scatter)
    total = member @ prior @ member.T + noise
    gain = prior @ member.T @ np.linalg.inv(total)
    mean = gain @ np.asarray(found.offset).ravel()
    conditional = prior - gain @ member @ prior
    keys = jax.random.split(jax.random.key(0), 20000)
    nodes = jnp.asarray(scatter)[None]
    drawn = jax.vmap(lambda key: draw_offsets(key, found, levels, nodes).offset)(keys)
    drawn = np.asarray(drawn).reshape(20000, 8)
    # 20,000 draws: means to 0.7 % of a standard deviation, covariances to 1 %; five times that.
    sd = np.sqrt(np.diag(conditional))
    np.testing.assert_allclose(drawn.mean(axis=0) / sd, mean / sd, atol=0.036)
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(sd, sd), conditional / np.outer(sd, sd), atol=0.05
    )


@pytest.mark.slow
def test_drawn_scatters_follow_their_density(nested):
    found, levels, *_ = nested
    nodes = jnp.asarray(scatter_grid((0.1, 0.2), (1.0, 3.0), assemblies=True)[[0, 5000, 14000]])
    alone = [float(log_density_of_offsets(found, levels, nodes[i : i + 1])) for i in range(3)]
    expected = np.exp(alone - logsumexp(alone))
    keys = jax.random.split(jax.random.key(1), 20000)
    drawn = jax.vmap(lambda key: draw_offsets(key, found, levels, nodes).scatter)(keys)
    share = [np.mean(np.all(np.asarray(drawn) == np.asarray(one), axis=1)) for one in nodes]
    # Four standard deviations of a share from 20,000 draws.
    np.testing.assert_allclose(share, expected, atol=4 * 0.5 / np.sqrt(20000))


def test_a_group_that_knows_nothing_of_an_offset_adds_nothing():
    one = Estimate(jnp.zeros(1), jnp.asarray([[0.3, 0.0]]), jnp.asarray([[[4.0, 0.0], [0.0, 0.0]]]))
    blank = Estimate(*(jnp.concatenate([x, jnp.zeros_like(x)]) for x in one))
    scatters = scatter_grid((0.1, 0.1), (1.0, 1.0))
    alone = float(log_density_of_offsets(one, ((0,),), scatters))
    both = float(log_density_of_offsets(blank, ((0, 1),), scatters))
    assert both == pytest.approx(alone, rel=1e-12)


def test_known_noise_gives_the_least_squares_offset():
    directions = RNG.normal(size=(1, 2, 30))
    r = RNG.normal(size=(1, 30))
    found = known_estimate(jnp.asarray(r), jnp.asarray(directions))
    best, squares, *_ = np.linalg.lstsq(directions[0].T, r[0])
    np.testing.assert_allclose(found.offset[0], best, rtol=1e-10)
    assert float(found.log_density[0]) == pytest.approx(-0.5 * float(squares[0]), rel=1e-10)


def test_shrunk_residuals_are_the_minimum_over_the_offsets():
    residuals = [RNG.normal(size=(2, 40)), RNG.normal(size=(1, 15))]
    directions = [RNG.normal(size=(2, 2, 40)), RNG.normal(size=(1, 2, 15))]
    runs, scatter = (0, 1, 0), np.array([0.5, 2.0])
    left, cost = shrunk(
        [jnp.asarray(r) for r in residuals], [jnp.asarray(d) for d in directions], runs,
        jnp.asarray(scatter),
    )  # fmt: skip
    rows, target = [], []
    flat = [(r, d) for rs, ds in zip(residuals, directions, strict=True)
            for r, d in zip(rs, ds, strict=True)]  # fmt: skip
    for (r, d), run in zip(flat, runs, strict=True):
        block = np.zeros((len(r), 4))
        block[:, 2 * run : 2 * run + 2] = d.T
        rows.append(block)
        target.append(r)
    rows.append(np.diag(1 / np.tile(scatter, 2)))
    target.append(np.zeros(4))
    best = np.linalg.lstsq(np.concatenate(rows), np.concatenate(target))[0]
    minimum = np.sum((np.concatenate(rows) @ best - np.concatenate(target)) ** 2)
    ours = sum(float(jnp.sum(x**2)) for x in left) + float(jnp.sum(cost**2))
    assert ours == pytest.approx(minimum, rel=1e-10)
    np.testing.assert_allclose(np.asarray(cost).ravel() * np.tile(scatter, 2), best, rtol=1e-8)


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_any_number_of_offsets_is_solved_for(size):
    root = RNG.normal(size=(4, size, size))
    matrix, vector = root @ np.swapaxes(root, 1, 2), RNG.normal(size=(4, size))
    # Condition numbers up to 1e6 leave ten digits.
    np.testing.assert_allclose(
        solve(jnp.asarray(matrix), jnp.asarray(vector)),
        np.linalg.solve(matrix, vector[..., None])[..., 0],
        rtol=1e-8,
    )
    np.testing.assert_allclose(
        log_determinant(jnp.asarray(matrix)), np.linalg.slogdet(matrix)[1], rtol=1e-9
    )


def test_three_offsets_known_to_nobody_are_zero():
    matrix = jnp.stack([jnp.zeros((3, 3)), jnp.diag(jnp.array([2.0, 3.0, 5.0])), jnp.ones((3, 3))])
    solved = solve(matrix, jnp.ones((3, 3)))
    np.testing.assert_allclose(solved, [[0, 0, 0], [1 / 2, 1 / 3, 1 / 5], [0, 0, 0]], rtol=1e-15)
