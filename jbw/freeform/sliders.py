r"""Parallel elasto-plastic sliders: force, first harmonic, and the grid of their half widths.

A slider of strength w has the play p of half width d, $p' = \mathrm{clip}(p, y - d, y + d)$, and

$$f = \omega_n^2 y - \sum_i w_i p_i$$

With x = d / Y <= 1 and t = arccos(1 - 2 x), one slider has the stiffness $\kappa$ and the loss l,

$$\kappa = \frac{t - \sin t \cos t}{\pi}, \qquad l = \frac{4}{\pi} x (1 - x)$$

so that frequency and damping are linear in the strengths:

$$\omega^2(Y) = \omega_n^2 - \sum_i w_i (1 - \kappa_i), \qquad
  2 \zeta \omega^2 = c\,\omega + \sum_i w_i l_i$$

Reference:
    Iwan (1966), J. Appl. Mech. 33, 893; Visintin (1994), Differential Models of Hysteresis.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import ArrayLike, Float

Reals = Float[np.ndarray, " _"]
Matrix = Float[np.ndarray, "amplitude bin"]

# number of bins per decade: with only 6, a Masing law can seem to break Masing's rule
PER_DECADE = 16
FINE = 8  # number of equal sliders into which a bin is divided, so that curves are smooth
# Ends of the grid, relative to the smallest and the largest amplitude. Sliders below a quarter of
# the smallest amplitude slip at every measured amplitude. Without them, bands at a third of that
# amplitude contained only 75 % of true values.
BELOW, ABOVE = 1 / 20, 6.0


def stiffness_share(amplitude: ArrayLike, half_width: ArrayLike) -> np.ndarray:
    r"""Return the first-harmonic stiffness $\kappa$ of a slider of unit strength."""
    x = np.clip(np.asarray(half_width) / np.asarray(amplitude), 0.0, 1.0)
    turn = np.arccos(1 - 2 * x)
    return (turn - np.sin(turn) * np.cos(turn)) / np.pi


def loss_share(amplitude: ArrayLike, half_width: ArrayLike) -> np.ndarray:
    r"""Return the energy loss per cycle of a slider of unit strength, divided by $\pi Y^2$."""
    x = np.clip(np.asarray(half_width) / np.asarray(amplitude), 0.0, 1.0)
    return 4 / np.pi * x * (1 - x)


def play_force(y: Reals, strengths: Reals, half_widths: Reals, stiffness: float) -> Reals:
    """Return the sliders' force along a motion from rest, exact for piecewise linear motion.

    Args:
        y: Displacement [m].
        strengths: Strength w of every slider [N/kg/m].
        half_widths: Half width d of every slider [m].
        stiffness: Stiffness omega_n^2 of the fully stuck joint [N/kg/m].
    """
    play, force = np.zeros_like(half_widths), np.empty(len(y))
    for k, position in enumerate(y):
        play = np.clip(play, position - half_widths, position + half_widths)
        force[k] = stiffness * position - strengths @ play
    return force


@dataclass(frozen=True)
class SliderGrid:
    """A grid of bins of the sliders' half width, equally wide in its logarithm.

    Attributes:
        log_d: Middle of every bin, as ln of the half width [m].
        width: Width of a bin, in ln of the half width.
    """

    log_d: Reals
    width: float

    @property
    def half_widths(self) -> Float[np.ndarray, "bin slider"]:
        """The half widths [m] of the sliders into which every bin is divided."""
        within = self.width * ((np.arange(FINE) + 0.5) / FINE - 0.5)
        return np.exp(self.log_d[:, None] + within)

    def softening(self, amplitude: ArrayLike) -> Matrix:
        """Return the decrease of omega^2 at each amplitude, for unit strength of each bin."""
        return 1.0 - self._mean(stiffness_share, amplitude)

    def loss(self, amplitude: ArrayLike) -> Matrix:
        """Return the increase of 2 zeta omega^2 at each amplitude, for unit strength of bins."""
        return self._mean(loss_share, amplitude)

    def _mean(self, share: Callable[..., np.ndarray], amplitude: ArrayLike) -> Matrix:
        return share(np.asarray(amplitude)[:, None, None], self.half_widths).mean(axis=-1)


def grid_for(smallest: float, largest: float, per_decade: int = PER_DECADE) -> SliderGrid:
    """Return a slider grid from 1/20 of the smallest to six times the largest amplitude [m]."""
    low, high = np.log(BELOW * smallest), np.log(ABOVE * largest)
    count = max(4, int(np.ceil((high - low) / np.log(10) * per_decade)))
    edges = np.linspace(low, high, count + 1)
    return SliderGrid((edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0]))
