r"""Random vibration of a lightly damped joint, by averaging of its energy.

Under a force of one-sided density G, per unit mass squared, the energy E has the probability
density

$$p(E) \propto T(E)\,\exp\!\left(-\int_0^E \frac{4 B T}{G J}\,de\right), \qquad
  B T = c J + \pi D Y^2$$

with period T, action J, and the losses of the viscous damper and of the loop over one cycle. G is
taken at the frequency 1/T of each energy level. Without a loop the result is exact: p(y) ~ exp(-4 c
V(y)/G).

For one of several modes, period and loss are those of its backbone, and G is multiplied by
$\beta^2/\mu$, where the other modes move along with it: their share in the power of the force is
$\beta - 1$, and that in the kinetic energy is $\mu - 1$.

Reference: J. B. Roberts and P. D. Spanos, Random Vibration and Statistical Linearization (1990).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import legendre
from numpy.typing import NDArray

from jbw.errors import ModelError
from jbw.forced.equivalent import EquivalentMotion, Values, wide
from jbw.oscillator.oscillator import Oscillator

# numbers of amplitudes in the result, and in the search for the largest amplitude
NODES, COARSE = 48, 24
# Exponent of the probability density at the largest amplitude, with its sign reversed.
FARTHEST = 30.0
# smallest spectral density, relative to that at the mode, because zero would cause a division by
# zero
LEAST = 1e-3
# half width of the frequency range around the mode, in half-power half widths, and largest ratio of
# densities in this range
WIDTHS, UNEVEN = 4.0, 4.0
HEAVY = 0.05  # damping ratio above which the energy changes too fast to be averaged
Density = Callable[[Values], Values]
ROUNDS = 4  # number of iterations for the frequency of a mode's backbone
PHASES = 24  # number of nodes per quarter of a cycle


class Cycles(NamedTuple):
    """Free vibration without losses at each amplitude, of shape (draw, amplitude).

    Attributes:
        energy: E per unit mass [m^2/s^2].
        action: J per unit mass [m^2/s].
        period: T [s].
        mean_squares: Mean squares of displacement, velocity and acceleration over the cycle, of
            shape (3, draw, amplitude).
        driven: Factor on the density of the force because other modes move along [-].
        seen: Measured displacement over that of the mode [-].
    """

    energy: Values
    action: Values
    period: Values
    mean_squares: Values
    driven: Values
    seen: Values


@dataclass(frozen=True, eq=False)
class RandomResponse:
    """Stationary random motion, described by amplitude levels, of shape (draw, level).

    Attributes:
        y: Amplitudes [m].
        weight: Probability of each level; the sum over a draw is 1.
        cycles: Free cycle at each level.
        loss: Losses divided by the action at each level, c + pi D Y^2 / J [1/s].
        force_density: Density of the force per unit mass, at frequencies (draw, any) in Hz.
    """

    y: Values
    weight: Values
    cycles: Cycles
    loss: Values
    force_density: Density

    def rms(self, order: int = 0) -> Values:
        """Return the mode's rms displacement (0), velocity (1) or acceleration (2) for each draw.

        The unit is that of the quantity. Far below the resonance the spectrum is taken as flat.
        """
        return np.sqrt(np.sum(self.weight * self.cycles.mean_squares[order], -1))

    @property
    def frequency_hz(self) -> Values:
        """The equivalent frequency, the mean rate of upward zero crossings [Hz]."""
        return np.sum(self.weight / self.cycles.period, -1)

    @property
    def damping(self) -> Values:
        """The equivalent damping ratio: that of a viscous damper with equal mean loss [-]."""
        power = np.sum(self.weight * self.loss * self.cycles.mean_squares[1], -1)
        return power / self.rms(1) ** 2 / (4.0 * np.pi * self.frequency_hz)

    def spectrum(self, freq_hz: Values, order: int = 0) -> Values:
        """Return the one-sided spectral density of the relative motion, of shape (draw, frequency).

        The spectra of linear oscillators with each level's frequency and damping, scaled to the
        mean square of the level, are summed with the levels' probabilities.

        Args:
            freq_hz: Frequencies [Hz].
            order: 0 for displacement, 1 for velocity, 2 for acceleration.
        """
        _, square = self.transfer(freq_hz)
        return self._x(freq_hz) ** (2 * order) * self.force_density(freq_hz[None]) * square

    def base_spectrum(
        self, freq_hz: Values, participation: float = 1.0, shape: float = 1.0
    ) -> Values:
        """Return the one-sided density of a point's absolute acceleration under base motion.

        The force per unit mass is -p a_b: the density of a_b is that of the force divided by p^2.
        """
        mean, square = self.transfer(freq_hz)
        gain = participation * shape * self._x(freq_hz) ** 2
        density = self.force_density(freq_hz[None]) / participation**2
        return density * (1.0 + 2.0 * np.real(gain * mean) + gain**2 * square)

    def transfer(self, freq_hz: Values) -> tuple[NDArray[np.complex128], Values]:
        """Return mean and mean square of the measured displacement per force, (draw, freq)."""
        share, receptance = self._linear(freq_hz)
        seen = self.cycles.seen[..., None]
        mean = np.sum(share * seen * receptance, 1)
        return mean, np.sum(share * np.abs(seen * receptance) ** 2, 1)

    def _x(self, freq_hz: Values) -> Values:
        return 2.0 * np.pi * freq_hz

    def _linear(self, freq_hz: Values) -> tuple[Values, NDArray[np.complex128]]:
        """Return each level's weight and linear receptance, of shape (draw, level, freq)."""
        omega, x = 2.0 * np.pi / self.cycles.period[..., None], self._x(freq_hz)
        loss, level = self.loss[..., None], self.force_density(1.0 / self.cycles.period)
        # Under a force of flat density G the mean square is G / (4 loss omega^2).
        mean_square = self.weight * self.cycles.mean_squares[0] / np.where(level > 0, level, np.inf)
        share = 4.0 * loss * omega**2 * mean_square[..., None]
        return share, 1.0 / (omega**2 - x**2 + 1j * loss * x)

    def exceeded(self) -> Values:
        """Return the number of peaks per second above each amplitude, of shape (draw, level) [1/s].

        Divided by the rate of all peaks, it is the exceedance distribution of the peaks.
        """
        (_, weights, integral, _), rate = rule(self.y.shape[1]), self.weight / self.cycles.period
        return np.sum(rate, -1, keepdims=True) - (rate / weights) @ integral.T

    def largest(self, duration: float) -> Values:
        """Return, for each draw, the median of the largest displacement [m] in a duration [s].

        Peaks of either sign above it are assumed independent, exp(-2 rate duration) = 1/2. For a
        narrow band this assumption overestimates the peaks.
        """
        target = np.log(np.log(2.0) / (2.0 * duration))
        rates = np.log(np.maximum(self.exceeded(), 1e-300))
        return np.array([
            np.interp(-target, -rate, y) for rate, y in zip(rates, self.y, strict=True)
        ])  # fmt: skip


def random_response(motion: EquivalentMotion, density: Density, share: Values) -> RandomResponse:
    """Return the stationary motion of a joint under a random force.

    Args:
        motion: The draws of the joint, of which only the first harmonic is used.
        density: One-sided density as a function of frequency in Hz, in the source's unit squared
            per Hz.
        share: Force per unit mass and per unit of the source, of shape (draw, 1).

    Raises:
        ModelError: The profile has no power at the mode, or the damping is above 5 %.
    """
    single = replace(motion, num_harmonics=1)

    def force_density(freq_hz: Values) -> Values:
        return density(freq_hz) * wide(share, freq_hz) ** 2

    def at_levels(freq_hz: Values) -> Values:
        # Where the excitation is weak, the density is limited from below; `_require_broad` checks
        # this.
        return np.maximum(force_density(freq_hz), LEAST * at_rest)

    at_rest = force_density(motion.omega_n / (2.0 * np.pi))
    _require_power(at_rest, motion.omega_n)
    viscous = np.maximum(motion.viscous, 1e-4 * motion.omega_n)
    # rms displacement of the structure with a fully stuck joint
    scale = np.sqrt(at_rest / (4.0 * viscous)) / motion.omega_n
    coarse = scale * np.geomspace(1e-3, 100.0, COARSE)
    cycle, loss = _losses(single, coarse)
    steps = np.diff(cycle.energy, prepend=0.0)
    exponent = np.cumsum(4.0 * loss / cycle.driven / at_levels(1.0 / cycle.period) * steps, -1)
    # NaN means that the joint cannot vibrate freely at an amplitude, which then has no weight.
    beyond = np.argmax(~(exponent < FARTHEST), -1)
    beyond = np.where(exponent[:, -1] < FARTHEST, COARSE - 1, beyond)
    nodes, weights, integral, derivative = rule(NODES)
    y_most = np.take_along_axis(coarse, beyond[:, None], -1)
    y = y_most * nodes
    cycle, loss = _losses(single, y)
    _require_levels(cycle.period)
    energy_by_y = cycle.energy @ derivative.T
    level = cycle.driven * at_levels(1.0 / cycle.period)
    exponent = (4.0 * loss / level * energy_by_y) @ integral.T
    probability = weights * cycle.period * energy_by_y * np.exp(-exponent)
    probability = probability / np.sum(probability, -1, keepdims=True)
    found = RandomResponse(y, probability, cycle, loss, force_density)
    _require_light(found.damping)
    _require_broad(found)
    return found


def _losses(motion: EquivalentMotion, y: Values) -> tuple[Cycles, Values]:
    """Return free vibration at each amplitude, and its energy loss per cycle over action [1/s]."""
    if motion.is_by_backbone:
        return _losses_of_mode(motion, y)
    cycle = cycles(motion, y)
    _, loss = motion.values(y, 2.0 * np.pi / cycle.period)
    return cycle, motion.viscous + np.pi * loss * y**2 / cycle.action


def _losses_of_mode(motion: EquivalentMotion, y: Values) -> tuple[Cycles, Values]:
    r"""Return free vibration along a mode's backbone, computed with one harmonic, and its losses.

    $$J = \pi\mu\omega Y^2, \qquad dE = \frac{\omega}{2\pi} dJ, \qquad
      \frac{B T}{J} = \frac{\beta}{\mu}\left(c + \frac{D}{\omega}\right)$$
    """
    omega = np.broadcast_to(motion.omega_n, y.shape)
    with np.errstate(invalid="ignore"):
        for _ in range(ROUNDS):
            stiffness, loss = motion.values(y, omega)
            omega = np.sqrt(stiffness)
    power, mass = motion.moved_along(y, omega)
    action = np.pi * mass * omega * y**2
    rises = np.diff(action, prepend=0.0)
    means = 0.5 * (omega + np.concatenate([omega[:, :1], omega[:, :-1]], -1))
    energy = np.cumsum(means * rises, -1) / (2.0 * np.pi)
    squares = 0.5 * y**2 * omega ** (2 * np.arange(3)[:, None, None])
    cycle = Cycles(energy, action, 2.0 * np.pi / omega, squares, power**2 / mass,
                   np.real(motion.seen(y, omega)))  # fmt: skip
    return cycle, power / mass * (motion.viscous + loss / omega)


def _require_power(density: Values, omega_n: Values) -> None:
    if not np.all(density > 0.0):
        raise ModelError(
            "The profile must have power at the natural frequency, but has none at "
            f"{float(np.median(omega_n)) / (2.0 * np.pi):.4g} Hz.",
            why="Only the motion of the mode is predicted.",
            remedy="Widen the profile, or predict a joint whose mode the profile drives.",
        )


def _require_levels(period: Values) -> None:
    if not np.all(np.isfinite(period)):
        raise ModelError(
            "The joint must keep a positive stiffness at every amplitude of the motion, but does "
            f"not in {np.sum(~np.all(np.isfinite(period), -1))} of {len(period)} draws.",
            remedy="Use a lower level, or simulate the motion by `jbw.simulate`.",
        )


def _require_light(damping: Values) -> None:
    if np.median(damping) > HEAVY:
        raise ModelError(
            f"The equivalent damping ratio must be at most {HEAVY:g} for averaging of the energy, "
            f"but is {np.median(damping):.3g}.",
            why="With heavier damping, the energy changes within a cycle.",
            remedy="Simulate the motion by `jbw.simulate` with samples of the force.",
        )


def _require_broad(found: RandomResponse) -> None:
    frequency, likely = 1.0 / found.cycles.period, found.weight > 1e-3
    low, high = (
        extreme(np.where(likely, frequency, edge), -1, keepdims=True)
        for extreme, edge in ((np.min, np.inf), (np.max, -np.inf))
    )
    width = WIDTHS * found.damping[:, None] * found.frequency_hz[:, None]
    near = low - width + (high - low + 2.0 * width) * np.linspace(0.0, 1.0, 33)
    density = found.force_density(near)
    if np.any(np.max(density, -1) > UNEVEN * np.min(density, -1)):
        raise ModelError(
            f"The profile must be broad at the mode, but its density changes by more than a factor "
            f"of {UNEVEN:g} between {np.min(near):.4g} and {np.max(near):.4g} Hz.",
            why="Averaging of the energy assumes a force that is flat across the resonance.",
            remedy="Simulate the motion by `jbw.simulate` with samples of the force.",
        )


@cache
def rule(count: int) -> tuple[Values, Values, Values, Values]:
    """Return the Gauss-Legendre rule on [0, 1]: nodes, weights, integrating and derivative matrix.

    From values at the `count` nodes, the matrices give the integrals from 0 to each node, and the
    derivatives.
    """
    nodes, weights = legendre.leggauss(count)
    to_series = np.linalg.inv(legendre.legvander(nodes, count - 1))
    series = np.eye(count)
    integral = legendre.legval(nodes, legendre.legint(series, lbnd=-1)).T @ to_series
    derivative = legendre.legval(nodes, legendre.legder(series)).T @ to_series
    return 0.5 * (nodes + 1.0), 0.5 * weights, 0.5 * integral, 2.0 * derivative


def cycles(motion: EquivalentMotion, y: Values) -> Cycles:
    """Return energy, action, period and mean squares of motion at amplitudes y (draw, any) [m]."""
    nodes, weights, integral, _ = rule(PHASES)
    angle = 0.5 * np.pi * nodes
    draw = np.repeat(np.arange(y.shape[0]), y.shape[1])
    midline = motion.by_lanes(partial(_midlines, angle=angle), draw, y.ravel())
    midline = midline.reshape(*y.shape, -1)
    sine, cosine = np.sin(angle), np.cos(angle)
    half_pi, length = 0.5 * np.pi, y[..., None]
    work = half_pi * length * ((midline * sine) @ integral.T)
    energy = half_pi * y * ((midline * sine) @ weights)
    with np.errstate(invalid="ignore"):
        v = np.sqrt(2.0 * work)
    action = 4.0 * half_pi * y * ((v * sine) @ weights)
    time = 4.0 * half_pi * length * weights * sine / v
    period = np.sum(time, -1)
    squares = ((length * cosine) ** 2, v**2, midline**2)
    means = np.stack([np.sum(time * square, -1) / period for square in squares])
    one = np.ones_like(y)
    return Cycles(energy, action, period, means, one, one)


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
