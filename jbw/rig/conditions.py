"""The disturbances of a laboratory: noise, distortion, delay, converters, daily joint changes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError
from jbw.rig.integrator import Specimen

# random stream of the joint's day-to-day variation; the streams of tests are checksums of the
# tests' names
DAYS = 0xDA75


@dataclass(frozen=True)
class Conditions:
    """The disturbances of the records, which are arguments of `jbw.rig.measure`."""

    seed: int
    fs: float
    noise_std: float
    noise_ratio: float | None
    input_noise_std: float
    force_noise_std: float
    bits: int
    distortion_db: float | None
    delay: float
    omega_n_cv: float
    zeta_cv: float

    @property
    def distortion(self) -> float:
        """The third harmonic of the source relative to its fundamental [-]."""
        return 0.0 if self.distortion_db is None else 10.0 ** (self.distortion_db / 20.0)

    @property
    def varies(self) -> bool:
        """Whether the joint differs from day to day."""
        return self.omega_n_cv > 0.0 or self.zeta_cv > 0.0


def stream(conditions: Conditions, *key: int) -> np.random.Generator:
    """Return a separate random number generator for each key."""
    return np.random.default_rng(np.random.SeedSequence(conditions.seed, spawn_key=key))


def specimen_of_days(specimen: Specimen, count: int, conditions: Conditions) -> list[Specimen]:
    """Draw each day's specimen: omega_n and zeta are log-normal with the true values as means."""
    days = []
    for day in range(count):
        e = stream(conditions, DAYS, day).standard_normal(2)
        omega_n = specimen.omega_n * _scatter(conditions.omega_n_cv, e[0])
        zeta = specimen.zeta * _scatter(conditions.zeta_cv, e[1])
        days.append(specimen._replace(omega_n=omega_n, zeta=zeta))
    return days


def _scatter(cv: float, e: float) -> float:
    """Return a log-normal factor with mean 1 and coefficient of variation `cv`, from a normal e."""
    variance = np.log1p(cv**2)
    return float(np.exp(np.sqrt(variance) * e - variance / 2.0))


def check(conditions: Conditions) -> None:
    """Raise a ConfigError that names the argument if a number is out of range."""
    if not 2 <= conditions.bits <= 24:
        raise ConfigError(f"Argument `bits` must be 2 to 24, but is {conditions.bits}.")
    if not conditions.fs > 0.0:
        raise ConfigError(f"Argument `fs` must be positive, but is {conditions.fs}.")
    names = (
        "seed", "noise_std", "noise_ratio", "input_noise_std", "force_noise_std", "delay",
        "omega_n_cv", "zeta_cv",
    )  # fmt: skip
    for name in names:
        value = getattr(conditions, name)
        if value is not None and not 0.0 <= value < np.inf:
            raise ConfigError(f"Argument `{name}` must be finite and not negative, but is {value}.")


def digitise(
    analog: NDArray[np.float64],
    *,
    noise_std: float,
    full_scale: float,
    bits: int,
    rng: np.random.Generator,
    channel: str = "channel",
) -> NDArray[np.float64]:
    """Add noise, then round to q round((x_n + sigma e_n) / q) with steps q = 2^(1 - b) x_full."""
    # If `full_scale` is a power of two, values of up to 24 bits are exact in float32.
    noisy = analog + noise_std * rng.standard_normal(analog.size)
    step = full_scale * 2.0 ** (1 - bits)
    digital = np.rint(noisy / step) * step
    peak = np.abs(digital).max()
    if peak > full_scale - step:
        raise ConfigError(
            f"Channel {channel} must stay within +-{full_scale:g}, but reaches {peak:.4g}.",
            why="A converter clips outside its range, and a clipped record is useless.",
            remedy="Lower the level or the gain, or use a preset of the rig with a larger range.",
        )
    return digital
