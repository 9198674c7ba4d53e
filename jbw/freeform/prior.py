r"""Priors of slider strengths: without an assumed form, without Masing's rule, or of a named shape.

$$\log w_i = m + s (x_i - x_0) + \sigma (K^{1/2} \xi)_i, \qquad x = \log d, \quad
  K = e^{-|x_i - x_j| / 2.3}$$

m ~ N(log 0.003, 3), s ~ N(0, 1.5), log sigma ~ N(log 1.2, 0.5), xi ~ N(0, 1), and the viscous
damping log c ~ N(log 0.002, 2), all in units of omega_n. Under Masing's rule the same strengths
give stiffness and loss. A loose law has separate strengths for the loss,

$$w_i\, e^{0.5 a + 0.4 (K^{1/2} \eta)_i}, \qquad a, \eta \sim N(0, 1)$$
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jbw.freeform.sliders import ABOVE, Reals, SliderGrid

LEVEL, SLOPE, VISCOUS = (np.log(3e-3), 3.0), (0.0, 1.5), (np.log(2e-3), 2.0)
ROUGHNESS = (np.log(1.2), 0.5)
LENGTH = 2.3  # correlation length of the strengths in ln of the half width: one decade
# prior sd of the level and the shape of a loss that is independent of the stiffness
FREE_LEVEL, FREE_SHAPE = 0.5, 0.4
# prior of ln(largest half width of Iwan's sliders): sd; prior of ln(share of the sliders that have
# the largest half width): mean and sd
CUT, SHARE = 1.5, (0.0, 1.5)
# number added to the diagonal of the correlation matrix, which keeps it positive definite
NUGGET = 1e-3
BOUNDS = -40.0, 5.0  # bounds of ln of a strength

Particles = Float[np.ndarray, "particle parameter"]
Strengths = Float[np.ndarray, "particle bin"]


class SliderStrengths(NamedTuple):
    """The sliders' strengths in every bin, for stiffness and for loss, and the viscous damping."""

    of_stiffness: Strengths
    of_loss: Strengths
    viscous: Float[np.ndarray, " particle"]


class StrengthPrior(NamedTuple):
    """A prior of slider strengths.

    Attributes:
        name: Name of the law.
        mean: Mean of every parameter's Gaussian.
        sd: Standard deviation of every parameter's Gaussian.
        strengths: Function from parameters to strengths.
        slopes: Function that returns a quantity's slopes by the parameters, from its slopes by ln
            of the strengths of the stiffness, of the loss, and of the viscous damping; None for few
            parameters.
    """

    name: str
    mean: Reals
    sd: Reals
    strengths: Callable[[Particles], SliderStrengths]
    slopes: Callable[[Particles, SliderStrengths], Particles] | None = None


def linear_prior(grid: SliderGrid, x_middle: float) -> StrengthPrior:
    """Return the prior of a joint that has viscous damping but no sliders."""

    def strengths(theta: Particles) -> SliderStrengths:
        none = np.zeros((len(theta), len(grid.log_d)))
        return SliderStrengths(none, none, np.exp(theta[:, 0]))

    return StrengthPrior("linear", *_moments(VISCOUS), strengths)


def power_prior(grid: SliderGrid, x_middle: float) -> StrengthPrior:
    """Return the prior of slider strengths that follow a power of the half width."""

    def strengths(theta: Particles) -> SliderStrengths:
        w = _exp(theta[:, :1] + theta[:, 1:2] * (grid.log_d - x_middle))
        return SliderStrengths(w, w, np.exp(theta[:, 2]))

    return StrengthPrior("power", *_moments(LEVEL, SLOPE, VISCOUS), strengths)


def iwan_prior(grid: SliderGrid, x_middle: float) -> StrengthPrior:
    """Return the prior of slider strengths under a power law, with extra sliders at its limit."""
    x_largest = float(grid.log_d[-1] + grid.width / 2 - np.log(ABOVE))

    def strengths(theta: Particles) -> SliderStrengths:
        w = _exp(theta[:, :1] + theta[:, 1:2] * (grid.log_d - x_middle))
        from_cut = theta[:, 3:4] - grid.log_d
        below = w * np.clip(from_cut / grid.width + 0.5, 0.0, 1.0)
        at_cut = np.exp(-np.abs(from_cut) / (0.5 * grid.width))
        at_cut /= np.maximum(at_cut.sum(axis=1, keepdims=True), 1e-300)
        force = below @ np.exp(grid.log_d) / np.exp(theta[:, 3])
        w = below + np.exp(theta[:, 4:5]) * force[:, None] * at_cut
        return SliderStrengths(w, w, np.exp(theta[:, 2]))

    moments = _moments(LEVEL, SLOPE, VISCOUS, (x_largest, CUT), SHARE)
    return StrengthPrior("iwan4", *moments, strengths)


def masing_prior(grid: SliderGrid, x_middle: float) -> StrengthPrior:
    """Return the prior of slider strengths of arbitrary form, under Masing's rule."""
    num, from_middle, root = len(grid.log_d), grid.log_d - x_middle, _root(grid)

    def strengths(theta: Particles) -> SliderStrengths:
        rough = np.exp(theta[:, 2:3]) * (theta[:, 4:] @ root.T)
        w = _exp(theta[:, :1] + theta[:, 1:2] * from_middle + rough)
        return SliderStrengths(w, w, np.exp(theta[:, 3]))

    mean, sd = _moments(LEVEL, SLOPE, ROUGHNESS, VISCOUS)
    return StrengthPrior(
        "free", np.append(mean, np.zeros(num)), np.append(sd, np.ones(num)), strengths,
        lambda theta, by: _bound_slopes(theta, by, from_middle, root),
    )  # fmt: skip


def loose_prior(grid: SliderGrid, x_middle: float) -> StrengthPrior:
    """Return the prior of slider strengths of arbitrary form, without Masing's rule."""
    num, from_middle, root = len(grid.log_d), grid.log_d - x_middle, _root(grid)
    bound = masing_prior(grid, x_middle)

    def strengths(theta: Particles) -> SliderStrengths:
        own = bound.strengths(theta[:, : 4 + num])
        free = FREE_LEVEL * theta[:, 4 + num : 5 + num] + FREE_SHAPE * theta[:, 5 + num :] @ root.T
        return own._replace(of_loss=own.of_loss * np.exp(np.clip(free, -5.0, 5.0)))

    def slopes(theta: Particles, by: SliderStrengths) -> Particles:
        shared = _bound_slopes(theta[:, : 4 + num], by, from_middle, root)
        own = FREE_LEVEL * by.of_loss.sum(axis=1), FREE_SHAPE * by.of_loss @ root
        return np.column_stack([shared, *own])

    more = num + 1
    return StrengthPrior(
        "loose", np.append(bound.mean, np.zeros(more)), np.append(bound.sd, np.ones(more)),
        strengths, slopes,
    )  # fmt: skip


PRIORS = {
    "linear": linear_prior,
    "power": power_prior,
    "iwan4": iwan_prior,
    "free": masing_prior,
    "loose": loose_prior,
}


def _bound_slopes(
    theta: Particles, by: SliderStrengths, from_middle: Reals, root: Float[np.ndarray, "bin bin"]
) -> Particles:
    """Convert derivatives with respect to log strengths to those of the prior's parameters."""
    by_log = by.of_stiffness + by.of_loss
    sigma, by_xi = np.exp(theta[:, 2:3]), by_log @ root
    by_sigma = sigma[:, 0] * np.sum(by_xi * theta[:, 4:], axis=1)
    first = by_log.sum(axis=1), by_log @ from_middle, by_sigma, by.viscous
    return np.column_stack([*first, sigma * by_xi])


def _exp(log_strength: Strengths) -> Strengths:
    return np.exp(np.clip(log_strength, *BOUNDS))


def _root(grid: SliderGrid) -> Float[np.ndarray, "bin bin"]:
    correlation = np.exp(-np.abs(grid.log_d[:, None] - grid.log_d) / LENGTH)
    return np.linalg.cholesky((1 - NUGGET) * correlation + NUGGET * np.eye(len(grid.log_d)))


def _moments(*parameters: tuple[float, float]) -> tuple[Reals, Reals]:
    mean, sd = np.array(parameters).T
    return mean, sd
