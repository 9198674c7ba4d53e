"""Plants of 1 rad/s whose law matters at an amplitude of one, with their true values."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial as P

from .simulator import Array, Plant, force_along, free_decay, substeps_of

Rng = np.random.Generator
MOST_STIFFNESS = 0.3  # largest stiffness of a joint, relative to omega_n^2
NUM_SLIDERS = 240
STEADY_RANGE, STEADY_POINTS = 100.0, 40  # range and number of amplitudes of steady loops
PER_PERIOD = 64.0  # samples per period of the free decay from which the truth is computed


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniformly distributed."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def masing(density: Callable[[Array], Array], top: float, lump: float = 0.0) -> Plant:
    """Return parallel sliders with a density of slip displacements, of total stiffness one.

    Args:
        density: Stiffness per slip displacement.
        top: Largest slip displacement.
        lump: Share of the stiffness that slips there and not before.
    """
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, NUM_SLIDERS)]) * top
    slip = (edges[1:] + edges[:-1]) / 2
    springs = density(slip) * np.diff(edges)
    springs = np.append(springs / springs.sum() * (1 - lump), lump)
    return Plant(springs=tuple(springs), forces=tuple(springs * np.append(slip, top)))


def _linear(rng: Rng) -> Plant:
    return Plant()


def _bouc_wen(rng: Rng) -> Plant:
    reach, share = log_uniform(rng, 0.05, 1.0), rng.uniform(0.3, 0.7)
    return Plant(alpha=1.0, delta=reach * share, gamma=reach * (1 - share))


def _bouc_wen_nu(rng: Rng) -> Plant:
    return replace(_bouc_wen(rng), nu=rng.uniform(0.4, 2.0))


def _iwan4(rng: Rng) -> Plant:
    chi, top = rng.uniform(-0.8, 0.0), 1 / rng.uniform(0.1, 1.5)
    beta = log_uniform(rng, 0.05, 5.0)
    return masing(lambda slip: slip**chi, top, beta / (1 + beta))


def _masing_power(rng: Rng) -> Plant:
    chi = rng.uniform(-0.7, 0.3)
    return masing(lambda slip: slip**chi, 1 / rng.uniform(0.02, 0.2))


def _masing_exponential(rng: Rng) -> Plant:
    b = log_uniform(rng, 0.1, 2.0)
    return masing(lambda slip: np.exp(-b * slip), 6 / b)


def _jenkins(rng: Rng) -> Plant:
    springs = rng.dirichlet(np.ones(int(rng.integers(1, 4))))
    slips = rng.uniform(0.1, 0.9, springs.size)
    return Plant(springs=tuple(springs), forces=tuple(springs * slips))


def _iwan5(rng: Rng) -> Plant:
    return replace(_iwan4(rng), kinetic=rng.uniform(0.5, 0.95))


def _gap_series(rng: Rng) -> Plant:
    share = rng.uniform(0.3, 0.7)
    reach = log_uniform(rng, 0.1, 1.0)
    return Plant(
        gap=rng.uniform(0.05, 0.6), gap_alpha=1.0, gap_delta=reach * share,
        gap_gamma=reach * (1 - share),
    )  # fmt: skip


def _valanis(rng: Rng) -> Plant:
    return Plant(
        valanis_0=1.0, valanis_t=rng.uniform(0.0, 0.5), valanis_lambda=log_uniform(rng, 0.1, 1.0),
        valanis_kappa=rng.uniform(0.0, 0.8),
    )  # fmt: skip


def _dahl(rng: Rng) -> Plant:
    return Plant(alpha=1.0, gamma=log_uniform(rng, 0.1, 2.0))


def _stop(rng: Rng) -> Plant:
    return Plant(stop=rng.choice([-1.0, 1.0]), stop_at=rng.uniform(0.2, 0.8))


def _either(name: str) -> Callable[[Rng], Plant]:
    return lambda rng: Plant(**{name: rng.choice([-1.0, 1.0])})


LAWS: dict[str, Callable[[Rng], Plant]] = {
    "linear": _linear,
    "bouc_wen": _bouc_wen,
    "bouc_wen_nu": _bouc_wen_nu,
    "iwan4": _iwan4,
    "masing_power": _masing_power,
    "masing_exponential": _masing_exponential,
    "jenkins": _jenkins,
    "iwan5": _iwan5,
    "gap_series": _gap_series,
    "valanis": _valanis,
    "dahl": _dahl,
    "cubic": _either("cubic"),
    "quintic": _either("quintic"),
    "quadratic": _either("quadratic"),
    "stop": _stop,
    "quadratic_damping": lambda rng: Plant(quadratic_damping=1.0),
    "cubic_damping": lambda rng: Plant(cubic_damping=1.0),
}
# laws of most records; other laws are drawn occasionally
COMMON = ("linear", "bouc_wen", "iwan4", "cubic", "quadratic_damping", "masing_power")
OF_FORCE = (
    "alpha", "gap_alpha", "quadratic", "square", "cubic", "quintic", "stop", "quadratic_damping",
    "cubic_damping", "valanis_0", "valanis_t",
)  # fmt: skip


def times(plant: Plant, factor: float) -> Plant:
    """Return the plant with the force of its joint multiplied by a factor."""
    scaled = {name: factor * getattr(plant, name) for name in OF_FORCE}
    for name in ("delta", "gamma"):
        scaled[name] = getattr(plant, name) * factor ** (1 - plant.nu)
    for name in ("springs", "forces"):
        scaled[name] = tuple(factor * np.array(getattr(plant, name)))
    return replace(plant, **scaled)


def stuck(plant: Plant) -> float:
    """Return the stiffness of the fully stuck joint, without that of an element behind a gap."""
    return plant.alpha + plant.valanis_0 + plant.sigma_0 + sum(plant.springs)


def kappa(plant: Plant, amplitude: float, per_period: int = 2048) -> complex:
    """Return the equivalent stiffness at 1 rad/s, without viscous damping.

    With y = Y cos(t) and F = Re sum F_n exp(j n t) of the third period, kappa = F_1 / Y; viscous
    damping of the mode is left out.
    """
    bare, periods = replace(plant, zeta=0.0), 3
    t = np.arange(2 * periods * per_period + 1) * np.pi / per_period
    # The motion grows within the loop, so that the joint remembers nothing larger.
    envelope = np.minimum(1, t / np.pi)
    y, v = amplitude * envelope * np.cos(t), np.gradient(amplitude * envelope * np.cos(t), t)
    force = force_along(bare, y, v, per_period / (2 * np.pi), 1)[-per_period - 1 : -1]
    turn = np.exp(-1j * np.arange(per_period) * 2 * np.pi / per_period)
    return complex(2 * np.mean(force * turn) / amplitude)


def effect(plant: Plant) -> float:
    """Return the larger change at an amplitude of 1: of frequency (relative) or damping."""
    change = kappa(plant, 1.0) - plant.omega_n**2
    return max(abs(change.real), abs(change.imag)) / 2


def draw_plant(rng: Rng, law: str, zeta: float, *, strong: bool) -> Plant:
    """Draw a plant whose law changes frequency or damping by a share of the damping ratio.

    Args:
        rng: Source of random numbers.
        law: One of `LAWS`.
        zeta: Viscous damping ratio.
        strong: Whether the change is 0.2 to 5 times the damping, or 1 to 10 % of it.
    """
    plant = replace(LAWS[law](rng), zeta=zeta)
    if law == "linear":
        return plant
    # The hysteretic part may not exceed the largest stiffness of a joint.
    small = times(plant, 1e-3)
    per_unit = effect(small) / 1e-3
    size = 10 ** (rng.uniform(-0.7, 0.7) if strong else rng.uniform(-2.0, -1.0))
    most = MOST_STIFFNESS / max(stuck(plant) + plant.gap_alpha, abs(plant.stop), 1e-9)
    wanted = min(size * zeta, 0.1) / max(per_unit, 1e-9)  # changes the frequency by a tenth at most
    return times(plant, min(wanted, most))


class Truth(NamedTuple):
    """Frequency and damping ratio of a plant against displacement amplitude."""

    amplitude: Array  # amplitudes of displacement, ascending
    omega: Array  # damped frequency, in units of omega_n
    sigma: Array  # decay rate

    def at(self, response: Array, order: int) -> tuple[Array, Array]:
        """Return natural frequency, sqrt(omega^2 + sigma^2), and damping ratio at amplitudes.

        Args:
            response: Amplitude of displacement (order 0), velocity (1) or acceleration (2), in
                units of the plant.
            order: Order of the response.
        """
        response = np.asarray(response, float)
        motion = response
        for _ in range(4):
            omega, sigma = self._at(motion)
            motion = response / np.hypot(omega, sigma) ** order
        natural = np.hypot(*self._at(motion))
        return natural, self._at(motion)[1] / natural

    def _at(self, motion: Array) -> tuple[Array, Array]:
        return (
            np.interp(motion, self.amplitude, self.omega),
            np.interp(motion, self.amplitude, self.sigma),
        )


def extrema(y: Array, v: Array, a: Array, step: float) -> tuple[Array, Array]:
    """Return times and values of a motion's extrema, from quintics through y, v, a of samples."""
    (at,) = np.nonzero(np.sign(v[:-1]) * np.sign(v[1:]) < 0)
    y0, v0, a0 = y[at], step * v[at], step**2 * a[at]
    y1, v1, a1 = y[at + 1], step * v[at + 1], step**2 * a[at + 1]
    rest, slope, bend = y1 - y0 - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
    powers = np.array([
        y0, v0, a0 / 2, 10 * rest - 4 * slope + bend / 2, -15 * rest + 7 * slope - bend,
        6 * rest - 3 * slope + bend / 2,
    ])  # fmt: skip
    first, second = P.polyder(powers, axis=0), P.polyder(powers, 2, axis=0)
    s = v0 / (v0 - v1)
    for _ in range(5):
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = s - _values(first, s) / _values(second, s)
        s = np.where(np.isfinite(newton), np.clip(newton, 0.0, 1.0), s)
    return (at + s) * step, _values(powers, s)


def _values(powers: Array, s: Array) -> Array:
    return P.polyval(s, powers, tensor=False)


@lru_cache(maxsize=64)
def truth_of(plant: Plant, top: float) -> Truth:
    """Determine frequency and damping from a free decay that begins above `top`, cycle by cycle."""
    if plant == Plant(omega_n=plant.omega_n, zeta=plant.zeta):
        w = plant.omega_n
        one = np.ones(1)
        return Truth(one * top, one * w * np.sqrt(1 - plant.zeta**2), one * w * plant.zeta)
    plant = replace(plant, gain_2=0.0, drift=0.0)
    length = min(6.0 / max(plant.zeta, 2e-4), 6000.0)
    count = int(length * PER_PERIOD / (2 * np.pi)) + int(8 * PER_PERIOD)
    motion = free_decay(plant, count, PER_PERIOD, (1.3 * top, 0.0), pulled=True)[:3]
    peaks, y = (values[2:-2] for values in extrema(*motion, 2 * np.pi / PER_PERIOD))
    # Amplitudes are from peak to peak, because sliders leave an offset; rates are over whole
    # periods, because half periods differ.
    size = np.abs(np.diff(y)) / 2
    middle = (peaks[1:] + peaks[:-1]) / 2
    keep = size > 1e-9 * top
    size, middle = size[keep], middle[keep]
    period = middle[2:] - middle[:-2]
    amplitude = np.sqrt(size[:-2] * size[2:])
    order = np.argsort(amplitude)
    omega, sigma = 2 * np.pi / period, np.log(size[:-2] / size[2:]) / period
    return Truth(amplitude[order], omega[order], sigma[order])


@lru_cache(maxsize=64)
def steady_truth(plant: Plant, top: float) -> Truth:
    """Return frequency and damping from steady loops under sines, up to above `top`.

    With kappa of `kappa`: omega^2 = Re kappa and sigma = zeta omega_n + Im kappa / (2 omega). A
    Bouc-Wen element closes its loops only in steady motion: its free decay is another one by up to
    some per cent of the damping, and what is driven is nearer to the loops.
    """
    bare = replace(plant, gain_2=0.0, drift=0.0)
    amplitude = np.geomspace(top / STEADY_RANGE, 1.3 * top, STEADY_POINTS)
    loops = np.array([kappa(bare, size) for size in amplitude])
    squared = np.maximum(loops.real, 0.0)
    sigma = plant.zeta * plant.omega_n + loops.imag / (2 * np.sqrt(squared))
    return Truth(amplitude, np.sqrt(np.maximum(squared - sigma**2, 0.0)), sigma)


def loop_of(plant: Plant, amplitude: float, rate: float = 1e-3) -> tuple[float, float]:
    """Return secant stiffness and energy per cycle of the steady loop under a slow sine."""
    per_period, periods = 4096, 3
    t = np.arange(2 * periods * per_period + 1) * np.pi / per_period
    y, v = amplitude * np.sin(t), amplitude * rate * np.cos(t)
    fs = per_period * rate / (2 * np.pi)
    force = force_along(plant, y, v, fs, 1)[-per_period - 1 :]
    y = y[::2][-per_period - 1 :]
    secant = (force[np.argmax(y)] - force[np.argmin(y)]) / (y.max() - y.min())
    return float(secant), float(np.trapezoid(force, y))


__all__ = [
    "COMMON", "LAWS", "Plant", "Rng", "Truth", "draw_plant", "effect", "kappa", "log_uniform",
    "loop_of", "steady_truth", "substeps_of", "truth_of",
]  # fmt: skip
