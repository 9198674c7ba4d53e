"""A regular grid over a posterior, in normalised coordinates, with moments on it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jbw.inference.samplers.chains import in_batches
from jbw.inference.samplers.evidence import (
    FORBIDDEN,
    effective_draws,
    highest_power,
    weighted_moments,
)
from jbw.inference.space.coordinates import Affine, Coordinate, Vector
from jbw.inference.space.problem import LOGIT_PRIOR_PRECISION, Problem, log_volume

REACH = 6.0  # half width of the first grids in standard deviations
NODES = {1: 128, 2: 80, 3: 40, 4: 20}  # number of nodes per coordinate, by number of parameters
# fraction of the nodes that stays effective when the power of the likelihood is raised
SHRINK = 0.4
MOST_ROUNDS = 120
# largest number of rounds at full likelihood; for a thin curved posterior the moments never become
# steady
MOST_WHOLE = 8
STEADY = 0.03  # Moments are final if they change by less than this, in standard deviations.
HALVINGS = 50  # number of bisections of the logarithm of the power, starting from e^-60
DEEP = 21.0  # A grid may end where its log density is this far below the maximum [nats].
WIDEST = 60.0  # largest half width of a grid in standard deviations
WIDER = 1.2

Bounds = Float[Array, "side parameter"]


class Stretch(Coordinate):
    r"""The stretch of each coordinate, $y = \sinh(\kappa x) / \kappa$ with $\kappa$ = 1/2.

    Otherwise the long tails of a poorly determined parameter would take most of the nodes.
    """

    def forward(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return sinh(x / 2) * 2 for each parameter."""
        return 2.0 * jnp.sinh(0.5 * x)

    def inverse(self, y: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return arsinh(y / 2) * 2 for each parameter."""
        return 2.0 * jnp.arcsinh(0.5 * y)

    def log_abs_det_jacobian(self, x: Vector) -> Float[Array, ""]:
        """Return the log determinant: the sum of log cosh(x / 2)."""
        return jnp.sum(jnp.log(jnp.cosh(0.5 * x)))


class Grid(NamedTuple):
    """Equally spaced nodes with log densities [nats]; the first coordinate varies slowest."""

    whitening: Coordinate
    axes: Float[Array, "parameter place"]
    log_p: Float[Array, " node"]

    @property
    def spacing(self) -> Float[Array, " parameter"]:
        """The distance between nodes along each coordinate."""
        return self.axes[:, 1] - self.axes[:, 0]

    @property
    def nodes(self) -> Float[Array, "node parameter"]:
        """The coordinates of all nodes."""
        return tensor(list(self.axes))

    @property
    def weights(self) -> Float[Array, " node"]:
        """The share of the posterior at each node."""
        return jax.nn.softmax(self.log_p)

    @property
    def log_evidence(self) -> Float[Array, ""]:
        """The logarithm of the evidence [nats], by the trapezoidal rule."""
        return jax.nn.logsumexp(self.log_p) + jnp.sum(jnp.log(self.spacing))


def tensor(axes: list[Float[Array, " _place"]]) -> Float[Array, "node parameter"]:
    """Return all combinations of values on several axes; the first axis varies slowest."""
    return jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def grid_within(problem: Problem, whitening: Coordinate, bounds: Bounds, num_places: int) -> Grid:
    """Return a grid of `num_places` nodes along each coordinate."""
    axes = jnp.linspace(bounds[0], bounds[1], num_places, axis=1)
    return Grid(whitening, axes, log_density_at(problem, whitening, tensor(list(axes))))


def log_density_at(
    problem: Problem, whitening: Coordinate, w: Float[Array, "node parameter"]
) -> Float[Array, " node"]:
    """Return the log posterior density [nats] at normalised points; FORBIDDEN if it is zero."""
    placed = eqx.tree_at(lambda posterior: posterior.whitening, problem, whitening)
    values = in_batches(placed.log_density, w)
    return jnp.where(jnp.isfinite(values), values, FORBIDDEN)


def whitened_by(
    mean: Float[Array, " parameter"],
    covariance: Float[Array, "parameter parameter"],
    first: int = 0,
) -> Affine:
    """Return whitened coordinates of which only the first one changes a given parameter."""
    order = np.array([first, *(i for i in range(mean.size) if i != first)])
    root = jnp.linalg.cholesky(covariance[np.ix_(order, order)])
    return Affine(mean, jnp.zeros_like(root).at[order].set(root))


class LogitMoments(NamedTuple):
    """Moments of a posterior in logit coordinates, at a power of the likelihood.

    Further fields are the highest log density of the last grid [nats], the number of grids, the
    number of grids at the power 1, and whether the posterior was possible at a node of every grid.
    """

    mean: Float[Array, " parameter"]
    covariance: Float[Array, "parameter parameter"]
    power: Float[Array, ""]
    highest: Float[Array, ""]
    rounds: Array
    full_power: Array
    settled: Array
    possible: Array


def located(problem: Problem) -> LogitMoments:
    r"""Find a posterior's mean and covariance on shrinking grids, with rising likelihood powers.

    $$p_\beta \propto \pi\, L^\beta, \qquad 0 < \beta_1 < \dots \le 1$$

    Every grid is whitened by the moments of the one before, and its power is so high that four
    tenths of the effective nodes remain: separate modes keep their share until the end. The search
    starts at a fit with the power 1, or without a fit at the whole prior.
    """
    d = len(problem.box.names)
    bounds = jnp.array([[-REACH], [REACH]]) * jnp.ones(d)
    factor = problem.whitening.factor
    spread = factor @ factor.T if problem.located else jnp.eye(d) / LOGIT_PRIOR_PRECISION
    zero, none = jnp.zeros(()), jnp.array(0)
    power = jnp.asarray(float(problem.located))
    state = power, zero, none, none, jnp.array(False), jnp.array(True)
    first = LogitMoments(problem.whitening.centre, spread, *state)

    def unsettled(at: LogitMoments) -> Array:
        over = at.settled | (at.full_power >= MOST_WHOLE) | (at.rounds >= MOST_ROUNDS)
        return at.possible & ~over

    def narrow(at: LogitMoments) -> LogitMoments:
        whitening = whitened_by(at.mean, at.covariance)
        grid = grid_within(problem, whitening, bounds, NODES[d])
        power, log_share = _raised(problem, grid, at.power)
        shift, spread = weighted_moments(jax.nn.softmax(log_share), grid.nodes)
        # The covariance must be at least as wide as the spacing of the grid's nodes requires.
        values, vectors = jnp.linalg.eigh(spread)
        spread = vectors * jnp.maximum(values, (0.3 * grid.spacing[0]) ** 2) @ vectors.T
        factor = whitening.factor
        still = jnp.max(jnp.abs(shift)) < STEADY
        still &= jnp.max(jnp.abs(spread - jnp.eye(d))) < STEADY
        return LogitMoments(
            at.mean + factor @ shift,
            factor @ spread @ factor.T,
            power,
            jnp.max(grid.log_p) - grid.whitening.log_abs_det_jacobian(at.mean),
            at.rounds + 1,
            at.full_power + (power == 1),
            (power == 1) & still,
            jnp.max(grid.log_p) > FORBIDDEN / 2,
        )

    return jax.lax.while_loop(unsettled, narrow, first)


def _raised(
    problem: Problem, grid: Grid, power: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, " node"]]:
    """Return the highest likelihood power that a grid resolves, and its log density per node."""
    placed = eqx.tree_at(lambda posterior: posterior.whitening, problem, grid.whitening)
    prior = jax.vmap(placed.coordinate.log_abs_det_jacobian)(grid.nodes) - log_volume(problem.box)
    likelihood = grid.log_p - prior

    def effective(power: Float[Array, ""]) -> Float[Array, ""]:
        return effective_draws(jax.nn.softmax(prior + power * likelihood))

    least = SHRINK * effective(power)

    # Bisect the logarithm, because the first powers may be very small.
    ends = jnp.log(jnp.maximum(power, jnp.exp(-60.0))), jnp.zeros(())
    raised = jnp.exp(highest_power(lambda log: effective(jnp.exp(log)), least, ends, HALVINGS))
    power = jnp.where(effective(jnp.ones(())) >= least, 1.0, raised)
    return power, prior + power * likelihood


def bounds_of(
    problem: Problem, whitening: Affine, moments: LogitMoments, num_places: int
) -> Bounds:
    """Expand bounds until the posterior at each side is 21 nats below its highest node."""
    d = len(problem.box.names)
    floor = moments.highest + whitening.log_abs_det_jacobian(moments.mean) - DEEP

    def open_sides(bounds: Bounds) -> Array:
        inner = jnp.linspace(bounds[0], bounds[1], num_places, axis=1)
        faces = [
            tensor([bounds[side, i][None] if j == i else inner[j] for j in range(d)])
            for side in range(2)
            for i in range(d)
        ]
        log_p = log_density_at(problem, whitening, jnp.concatenate(faces))
        return jnp.max(log_p.reshape(2, d, -1), axis=-1) > floor

    def any_open(state: tuple[Bounds, Array]) -> Array:
        return jnp.any(state[1])

    def push(state: tuple[Bounds, Array]) -> tuple[Bounds, Array]:
        bounds = jnp.where(state[1], WIDER * state[0], state[0])
        return bounds, open_sides(bounds) & (jnp.abs(bounds) < WIDEST)

    first = jnp.array([[-REACH], [REACH]]) / WIDER * jnp.ones(d)
    return jax.lax.while_loop(any_open, push, (first, jnp.ones((2, d), bool)))[0]
