"""Tables of equivalent stiffness and loss against amplitude, which make searches fast."""

from dataclasses import dataclass, replace

import numpy as np

from jbw.forced.equivalent import EquivalentLoops, EquivalentMotion, Values, wide


@dataclass(frozen=True, eq=False)
class LoopTable:
    """Equivalent stiffness and loss of each draw, at amplitudes with a constant ratio.

    Attributes:
        log_y: Logarithms of the amplitudes, of shape (draw, node).
        parts: K, D and c at these amplitudes, of shape (3, draw, node).
        slopes: Derivatives of `parts` by the logarithm of the amplitude.
    """

    log_y: Values
    parts: Values
    slopes: Values

    @property
    def y(self) -> Values:
        """The amplitudes at the nodes, of shape (draw, node) [m]."""
        return np.exp(self.log_y)

    def loops(self, y: Values) -> EquivalentLoops:
        """Return equivalent stiffness and loss at amplitudes y, by cubic interpolation.

        The shape is (draw, *any). Below the smallest node, where the joint is nearly stuck, values
        are those of this node; they are NaN beyond the largest.
        """
        count = self.log_y.shape[1]
        shape, position = y.shape, np.log(y).reshape(y.shape[0], -1)
        step = self.log_y[:, 1:2] - self.log_y[:, :1]
        u = np.maximum((position - self.log_y[:, :1]) / step, 0.0)
        inside = u < count - 1 + 1e-9
        cell = np.clip(np.nan_to_num(u), 0, count - 2).astype(int)
        u = np.where(inside, u - cell, np.nan)
        values = [np.take_along_axis(self.parts, (cell + i)[None], 2) for i in range(2)]
        slopes = [np.take_along_axis(self.slopes, (cell + i)[None], 2) * step for i in range(2)]
        rise = values[1] - values[0]
        # Hermite's cubic through both values and both slopes.
        third, second = slopes[0] + slopes[1] - 2.0 * rise, 3.0 * rise - 2.0 * slopes[0] - slopes[1]
        parts = values[0] + u * (slopes[0] + u * (second + u * third))
        by_y = (slopes[0] + u * (2.0 * second + 3.0 * u * third)) / (step * np.exp(position))
        by_y = np.where(u > 0.0, by_y, 0.0 * u)
        return EquivalentLoops(*(part.reshape(shape) for part in (*parts, *by_y)))


def tabulated(motion: EquivalentMotion, low: Values, high: Values, num_nodes: int) -> LoopTable:
    """Return a table of a joint's equivalent stiffness and loss between two amplitudes.

    Quantities that also depend on the frequency are evaluated in resonance at each amplitude.

    Args:
        motion: The draws of the joint.
        low: Smallest amplitudes of shape (draw, 1) [m].
        high: Largest amplitudes of shape (draw, 1) [m].
        num_nodes: Number of amplitudes for each draw.
    """
    log_y = np.log(low) + (np.log(high) - np.log(low)) * np.linspace(0.0, 1.0, num_nodes)
    y, omega = np.exp(log_y), wide(motion.omega_n, log_y)
    if motion.feels_frequency:
        stiffness, _ = replace(motion, num_harmonics=1).values(y, omega)
        omega = np.sqrt(np.where(stiffness > 0, stiffness, np.nan))
    if motion.feels_rate:
        parts = np.stack(motion.loops(y, omega)[:3])
    else:
        parts = np.stack([*motion.values(y, omega), np.broadcast_to(motion.viscous, y.shape)])
    slopes = np.gradient(parts, axis=2, edge_order=2) / (log_y[:, 1:2] - log_y[:, :1])
    return LoopTable(log_y, parts, slopes)
