r"""Energy, action and period of free vibration against amplitude, without losses.

At the amplitude Y the midline of the steady loop is a conservative force m(y), and

$$E = \int_0^Y m\,dy, \qquad J = \oint v\,dy, \qquad T = \oint \frac{dy}{v}, \qquad
  v = \sqrt{2\int_y^Y m\,dy}$$

With y = Y cos(theta) every integrand is smooth, and the Gauss-Legendre rule is accurate to
round-off where the law is smooth.
"""

from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import legendre

from jbw.forced.equivalent import EquivalentMotion, Values
from jbw.oscillator.oscillator import Oscillator

PHASES = 24  # number of nodes per quarter of a cycle


class Cycles(NamedTuple):
    """Free vibration without losses at each amplitude, of shape (draw, amplitude).

    Attributes:
        energy: E per unit mass [m^2/s^2].
        action: J per unit mass [m^2/s].
        period: T [s].
        mean_squares: Mean squares of displacement, velocity and acceleration over the cycle, of
            shape (3, draw, amplitude).
    """

    energy: Values
    action: Values
    period: Values
    mean_squares: Values


class Rule(NamedTuple):
    """The Gauss-Legendre rule on [0, 1], with matrices for cumulative integrals and derivatives.

    Attributes:
        nodes: Nodes x.
        weights: Weights of the integral over [0, 1].
        integral: Matrix from values at the nodes to integrals from 0 to each node.
        derivative: Matrix from values at the nodes to derivatives at the nodes.
    """

    nodes: Values
    weights: Values
    integral: Values
    derivative: Values


@cache
def rule(count: int) -> Rule:
    """Return the Gauss-Legendre rule with `count` nodes on [0, 1]."""
    nodes, weights = legendre.leggauss(count)
    to_series = np.linalg.inv(legendre.legvander(nodes, count - 1))
    series = np.eye(count)
    integral = legendre.legval(nodes, legendre.legint(series, lbnd=-1)).T @ to_series
    derivative = legendre.legval(nodes, legendre.legder(series)).T @ to_series
    return Rule(0.5 * (nodes + 1.0), 0.5 * weights, 0.5 * integral, 2.0 * derivative)


def cycles(motion: EquivalentMotion, y: Values) -> Cycles:
    """Return energy, action, period and mean squares of motion at amplitudes y (draw, any) [m]."""
    phases = rule(PHASES)
    angle = 0.5 * np.pi * phases.nodes
    draw = np.repeat(np.arange(y.shape[0]), y.shape[1])
    midline = motion.by_lanes(partial(_midlines, angle=angle), draw, y.ravel())
    midline = midline.reshape(*y.shape, -1)
    sine, cosine = np.sin(angle), np.cos(angle)
    half_pi, length = 0.5 * np.pi, y[..., None]
    work = half_pi * length * ((midline * sine) @ phases.integral.T)
    energy = half_pi * y * ((midline * sine) @ phases.weights)
    with np.errstate(invalid="ignore"):
        v = np.sqrt(2.0 * work)
    action = 4.0 * half_pi * y * ((v * sine) @ phases.weights)
    time = 4.0 * half_pi * length * phases.weights * sine / v
    period = np.sum(time, -1)
    squares = ((length * cosine) ** 2, v**2, midline**2)
    means = np.stack([np.sum(time * square, -1) / period for square in squares])
    return Cycles(energy, action, period, means)


@jax.jit
def _midlines(
    joint: Oscillator, y: Float[Array, " lane"], angle: Float[Array, " phase"]
) -> Float[Array, "lane phase"]:
    """Return the mean force of loading and unloading at y cos(angle), for each amplitude."""

    def midline(joint: Oscillator, y: Array) -> Array:
        to = y * jnp.cos(angle)
        down, mirrored = jnp.split(joint.force_unloading(y, jnp.concatenate([to, -to])), 2)
        return jnp.asarray(joint.k * to + 0.5 * (down - mirrored))

    return jax.vmap(midline)(joint, y)
