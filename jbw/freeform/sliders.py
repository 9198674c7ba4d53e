r"""Parallel elasto-plastic sliders without an assumed law: first harmonic, and sliders behind gaps.

A slider of strength w has the play p of half width d, $p' = \mathrm{clip}(p, y - d, y + d)$, and

$$f = \omega_n^2 y - \sum_i w_i p_i$$

With x = d / Y <= 1 and t = arccos(1 - 2 x), one slider has the stiffness $\kappa$ and the loss l,

$$\kappa = \frac{t - \sin t \cos t}{\pi}, \qquad l = \frac{4}{\pi} x (1 - x)$$

so that frequency and damping are linear in the strengths:

$$\omega^2(Y) = \omega_n^2 - \sum_i w_i (1 - \kappa_i), \qquad
  2 \zeta \omega^2 = c\,\omega + \sum_i w_i l_i$$

A slider behind a gap g has the play p of half width g + d, and the force of the dead zone of both,

$$f(y) = \mathrm{dz}(y - p, g), \qquad \mathrm{dz}(e, g) = \mathrm{sign}(e)\,\max(|e| - g, 0)$$

so that the force of a joint in a measured loop is linear in the strengths w >= 0 of all pairs (g,
d), in an elastic spring and in a constant force:

$$F(y) = k y + F_0 + \sum_{g, d} w_{gd}\, f_{gd}(y)$$

Reference:
    Iwan (1966), J. Appl. Mech. 33, 893; Visintin (1994), Differential Models of Hysteresis; Lawson
    and Hanson (1974), Solving Least Squares Problems.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.optimize import nnls

from jbw.errors import DataError
from jbw.measurement.curves import ForcedLoop
from jbw.measurement.readings.loop import slider_columns

Reals = Float[np.ndarray, " _"]
Matrix = Float[np.ndarray, "amplitude bin"]

# number of bins per decade, because with only 6 a Masing law can seem to break Masing's rule
PER_DECADE = 16
FINE = 8  # number of equal sliders into which a bin is divided, so that curves are smooth
# Ends of the grid, relative to the smallest and the largest amplitude. Sliders below a quarter of
# the smallest amplitude slip at every measured amplitude. Without them, bands at a third of that
# amplitude contained only 75 % of true values.
BELOW, ABOVE = 1 / 20, 6.0
# numbers of half widths and of gaps of sliders behind gaps; the gap of zero is not counted
YIELDS, GAPS = 16, 12
SMALLEST = 1e-3  # smallest half width of a slider, relative to the largest motion
LARGEST = 1.0  # largest half width and gap of a slider, relative to the largest motion
SMALLEST_GAP = 1e-2  # smallest gap, relative to the largest motion
# largest number of samples of all loops together, enough because loops are smooth
MOST_SAMPLES = 2000
FEWEST = 8  # smallest number of samples of a loop


def stiffness_share(amplitude: ArrayLike, half_width: ArrayLike) -> np.ndarray:
    r"""Return the first-harmonic stiffness $\kappa$ of a slider of unit strength."""
    x = np.clip(np.asarray(half_width) / np.asarray(amplitude), 0.0, 1.0)
    turn = np.arccos(1 - 2 * x)
    return (turn - np.sin(turn) * np.cos(turn)) / np.pi


def loss_share(amplitude: ArrayLike, half_width: ArrayLike) -> np.ndarray:
    r"""Return the energy loss per cycle of a slider of unit strength, divided by $\pi Y^2$."""
    x = np.clip(np.asarray(half_width) / np.asarray(amplitude), 0.0, 1.0)
    return 4 / np.pi * x * (1 - x)


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


def grid_for(smallest: float, largest: float) -> SliderGrid:
    """Return a slider grid from 1/20 of the smallest to six times the largest amplitude [m]."""
    low, high = np.log(BELOW * smallest), np.log(ABOVE * largest)
    count = max(4, int(np.ceil((high - low) / np.log(10) * PER_DECADE)))
    edges = np.linspace(low, high, count + 1)
    return SliderGrid((edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0]))


@dataclass(frozen=True)
class GapSliders:
    """Sliders behind gaps, in parallel with an elastic spring.

    Attributes:
        half_widths: Half width of every slider [m].
        gaps: Gap in front of every slider [m].
        strengths: Strength of every slider [N/m], none negative.
        stiffness: Stiffness of the parallel elastic spring [N/m].
        offset: Mean of the loops' constant forces [N].
        error: Root mean square of the residual over that of the force, for all loops.
    """

    half_widths: Reals
    gaps: Reals
    strengths: Reals
    stiffness: float
    offset: float
    error: float

    def force(self, y: ArrayLike) -> Reals:
        """Return the force [N] along a motion [m] from rest in the middle of the gaps."""
        motion = np.asarray(y, float)
        used = self.strengths > 0
        columns = slider_columns(motion, self.half_widths[used], self.gaps[used])
        return self.offset + self.stiffness * motion + columns @ self.strengths[used]

    def errors(self, loop: ForcedLoop) -> tuple[float, float]:
        """Return a loop's relative rms force error, without and with a fitted constant force.

        The offset is a constant force of the loop, as from the zero error of an amplifier.
        """
        force = np.asarray(loop.force, float)
        residual = self.force(loop.displacement) - force
        size = max(float(np.sqrt(np.mean(force**2))), 1e-300)
        return float(np.sqrt(np.mean(residual**2)) / size), float(np.std(residual) / size)

    @property
    def mean_gap(self) -> float:
        """The mean gap [m], weighted by the sliders' largest forces."""
        weights = self.strengths * self.half_widths
        return float(weights @ self.gaps / weights.sum()) if weights.sum() > 0 else 0.0


def gap_sliders(loops: Sequence[ForcedLoop]) -> GapSliders:
    """Fit sliders behind gaps to force loops, with a separate constant force for each loop.

    Args:
        loops: Displacement and force along the motion, each from rest.

    Raises:
        DataError: There is no loop, or a loop has fewer than eight samples, no motion, or values
            that are not finite.
    """
    for loop in loops:
        _require(loop)
    if not loops:
        raise DataError("Sliders behind gaps need at least one force loop, but there is none.")
    top = max(float(np.max(np.abs(loop.displacement))) for loop in loops)
    widths = np.geomspace(SMALLEST, LARGEST, YIELDS) * top
    gaps = np.concatenate([[0.0], np.geomspace(SMALLEST_GAP, LARGEST, GAPS) * top])
    gap, width = (grid.ravel() for grid in np.meshgrid(gaps, widths, indexing="ij"))
    every = max(1, sum(len(loop.displacement) for loop in loops) // MOST_SAMPLES)
    columns = [
        slider_columns(np.asarray(loop.displacement, float), width, gap)[::every] for loop in loops
    ]
    motions = [np.asarray(loop.displacement, float)[::every] for loop in loops]
    forces = [np.asarray(loop.force, float)[::every] for loop in loops]
    own = np.repeat(np.eye(len(loops)), [len(force) for force in forces], axis=0)
    signed = np.column_stack([np.concatenate(motions), own])
    scale = float(np.sqrt(np.mean(np.concatenate(forces) ** 2)))
    design = np.column_stack([np.vstack(columns), signed, -signed])
    sizes = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    found, left = nnls(design / sizes, np.concatenate(forces), maxiter=50 * design.shape[1])
    values = found / sizes
    free = values[len(gap) : len(gap) + signed.shape[1]] - values[len(gap) + signed.shape[1] :]
    error = float(left / np.sqrt(len(own)) / max(scale, 1e-300))
    offset = float(np.mean(free[1:]))
    return GapSliders(width, gap, values[: len(gap)], float(free[0]), offset, error)


def _require(loop: ForcedLoop) -> None:
    y, force = np.asarray(loop.displacement, float), np.asarray(loop.force, float)
    if len(y) < FEWEST or not np.all(np.isfinite(y)) or not np.all(np.isfinite(force)):
        raise DataError(
            f"A force loop must have {FEWEST} finite samples or more, but a loop has "
            f"{int(np.sum(np.isfinite(y)))}.",
            remedy="Leave out the loop, or remove its samples that are not finite.",
        )
    if not np.ptp(y) > 0:
        raise DataError(
            "A force loop must move, but the displacement of a loop is constant.",
            remedy="Check which channel is the displacement.",
        )
