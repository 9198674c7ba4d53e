"""What a laboratory suffers from: noise, distortion, delay, and joints that differ by day."""

from dataclasses import dataclass

import equinox as eqx
import numpy as np

from jbw.errors import ConfigError
from jbw.oscillator.parameters import BoucWen

_DAYS = 0xDA75
"""Stream of the joint's day-to-day variation; tests use the checksum of their names."""


@dataclass(frozen=True)
class Conditions:
    """What the records suffer from.

    Attributes:
        seed: Seed of everything random.
        fs: Sampling frequency [Hz].
        noise_std: Laser noise over 0 .. fs/2 [m/s].
        noise_ratio: Laser noise as a fraction of the rms velocity of each record [-]; it takes
            the place of `noise_std` when given.
        input_noise_std: Noise of the source's channel [V or N].
        force_noise_std: Noise of restoring forces [N].
        bits: Bits of the converters, sign included.
        distortion_db: Third harmonic of the source against its fundamental [dB]; None for a pure
            source.
        delay: Lag of the velocity channel [s].
        omega_n_cv: Coefficient of variation of omega_n from day to day [-].
        zeta_cv: Coefficient of variation of zeta from day to day [-].
    """

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
        """Third harmonic of the source relative to its fundamental [-]."""
        return 0.0 if self.distortion_db is None else 10.0 ** (self.distortion_db / 20.0)

    @property
    def varies(self) -> bool:
        """Whether the joint differs from day to day."""
        return self.omega_n_cv > 0.0 or self.zeta_cv > 0.0


def stream(conditions: Conditions, *key: int) -> np.random.Generator:
    """Random numbers of their own for each key."""
    return np.random.default_rng(np.random.SeedSequence(conditions.seed, spawn_key=key))


def joint_of_days(joint: BoucWen, count: int, conditions: Conditions) -> list[BoucWen]:
    """The joint as assembled on each day: omega_n and zeta log-normal, their means the truth."""
    return [_assembled(joint, stream(conditions, _DAYS, day), conditions) for day in range(count)]


def _assembled(joint: BoucWen, rng: np.random.Generator, conditions: Conditions) -> BoucWen:
    e = rng.standard_normal(2)
    return eqx.tree_at(
        lambda leaves: (leaves.omega_n, leaves.zeta),
        joint,
        (
            float(joint.omega_n) * _scatter(conditions.omega_n_cv, e[0]),
            float(joint.zeta) * _scatter(conditions.zeta_cv, e[1]),
        ),
    )


def _scatter(cv: float, e: float) -> float:
    """Log-normal factor of mean 1 and coefficient of variation `cv`."""
    variance = np.log1p(cv**2)
    return float(np.exp(np.sqrt(variance) * e - variance / 2.0))


def check(conditions: Conditions) -> None:
    """Refuses numbers out of range, each by the name of its argument.

    Raises:
        ConfigError: For the first number out of range.
    """
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
