"""Conversions of a joint to the parameters of Baber and Noori, OpenSees and the benchmark.

Public as `jbw.conventions`: `to_...` converts our parameters to theirs, `from_...` theirs to ours.
The benchmark is the hysteretic (Bouc-Wen) benchmark of system identification.

Examples:
    The stiffness is m omega_n^2, and the ratio of stiffness after slip 1 - alpha / omega_n^2:

    >>> import jbw; jbw.enable_x64()
    >>> joint = jbw.BoucWen(omega_n=100.0, zeta=0.01, alpha=500.0, delta=340.0, gamma=33.0)
    >>> other = jbw.conventions.to_baber_noori(joint, mass=2.0)
    >>> print(f"{other.stiffness:.0f} N/m, {other.ratio:.2f}")
    20000 N/m, 0.95
"""

from jbw.oscillator.laws.conversions import BaberNoori as BaberNoori
from jbw.oscillator.laws.conversions import Benchmark as Benchmark
from jbw.oscillator.laws.conversions import conversions as conversions
from jbw.oscillator.laws.conversions import require_positive
from jbw.oscillator.laws.conversions import to_baber_noori as to_baber_noori
from jbw.oscillator.laws.conversions import to_benchmark as to_benchmark
from jbw.oscillator.oscillator import BoucWen

__all__ = [
    "BaberNoori",
    "Benchmark",
    "conversions",
    "from_baber_noori",
    "from_benchmark",
    "to_baber_noori",
    "to_benchmark",
]


def from_baber_noori(other: BaberNoori) -> BoucWen:
    """Return the joint of a Bouc-Wen-Baber-Noori oscillator; the inverse of `to_baber_noori`.

    Args:
        other: Parameters of that oscillator, with A = 1 and no degradation.

    Raises:
        ModelError: Mass, stiffness or the hysteretic share is not positive.
    """
    require_positive(other.mass, "mass")
    require_positive(other.stiffness, "stiffness")
    require_positive(1.0 - other.ratio, "1 - ratio")
    omega_n = (other.stiffness / other.mass) ** 0.5
    alpha = (1.0 - other.ratio) * omega_n**2
    scale = alpha ** (1.0 - other.n)
    return BoucWen(
        omega_n,
        other.damping / (2.0 * other.mass * omega_n),
        alpha,
        other.gamma * scale,
        other.beta * scale,
        nu=other.n,
    )


def from_benchmark(other: Benchmark) -> BoucWen:
    """Return the joint of the hysteretic benchmark's parameters; the inverse of `to_benchmark`.

    Args:
        other: The benchmark's parameters.

    Raises:
        ModelError: The mass or the small-amplitude stiffness is not positive.
    """
    require_positive(other.mass, "mass")
    require_positive(other.stiffness + other.alpha, "stiffness + alpha")
    omega_n = ((other.stiffness + other.alpha) / other.mass) ** 0.5
    scale = other.beta * other.mass ** (other.nu - 1.0)
    return BoucWen(
        omega_n,
        other.damping / (2.0 * other.mass * omega_n),
        other.alpha / other.mass,
        other.delta * scale,
        other.gamma * scale,
        nu=other.nu,
    )
