r"""The Bouc-Wen joint in the notation of OpenSees, of Baber and Noori, and of the benchmark.

All describe the same law. They differ in the meaning of z (a force per mass, a force, a
displacement) and in the name, beta, gamma or delta, of the coefficient of the dissipating term:

$$\dot Z = \alpha v - \gamma\,|v|\,|Z|^{\nu-1} Z - \delta\,v\,|Z|^\nu$$

here; in the other notations the dissipating coefficient is called beta and the other one gamma.
"""

from typing import Any, NamedTuple

from jbw.errors import ModelError
from jbw.oscillator.parameters import Conversion, Material, Scalar

OF_BOTH = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}


class BaberNoori(NamedTuple):
    r"""A Bouc-Wen-Baber-Noori oscillator without degradation or pinching; z is a displacement.

    $$m\ddot y + c\dot y + a k_0 y + (1 - a) k_0 z = F, \qquad
      \dot z = v - \beta\,|v|\,|z|^{n-1} z - \gamma\,v\,|z|^n$$

    Attributes:
        mass: m [kg].
        damping: c [N s/m].
        stiffness: k_0, initial stiffness [N/m].
        ratio: a, stiffness after slip divided by the initial stiffness [-].
        beta: Dissipating coefficient [m^-n].
        gamma: Non-dissipating coefficient [m^-n].
        n: Exponent.
    """

    mass: float
    damping: float
    stiffness: float
    ratio: float
    beta: float
    gamma: float
    n: float = 1.0


class Benchmark(NamedTuple):
    r"""The oscillator of the hysteretic (Bouc-Wen) benchmark; z is a force.

    $$m\ddot y + c\dot y + k y + z = F, \qquad
      \dot z = \alpha v - \beta\,(\gamma\,|v|\,|z|^{\nu-1} z + \delta\,v\,|z|^\nu)$$

    Attributes:
        mass: m [kg].
        damping: c [N s/m].
        stiffness: k [N/m].
        alpha: Stiffness of the hysteretic force [N/m].
        beta: Common factor of gamma and delta.
        gamma: Dissipating coefficient; beta gamma in N^(1 - nu)/m.
        delta: Non-dissipating coefficient; beta delta in N^(1 - nu)/m.
        nu: Exponent.

    Reference:
        Noel, Schoukens (2016), Hysteretic benchmark with a dynamic nonlinearity.
    """

    mass: float
    damping: float
    stiffness: float
    alpha: float
    beta: float
    gamma: float
    delta: float
    nu: float = 1.0


def to_baber_noori(joint: Any, mass: float) -> BaberNoori:
    r"""Return the joint in the parameters of a Bouc-Wen-Baber-Noori oscillator.

    $$z = Z / \alpha: \quad k_0 = m\omega_n^2, \quad a = k / \omega_n^2, \quad
      \beta = \gamma\,\alpha^{\nu-1}, \quad \gamma_{BN} = \delta\,\alpha^{\nu-1}$$
    """
    omega_n, zeta, alpha, delta, gamma = _scalars(joint, mass)
    scale = alpha ** (joint.nu - 1.0)
    return BaberNoori(
        mass=mass,
        damping=2.0 * zeta * omega_n * mass,
        stiffness=mass * omega_n**2,
        ratio=1.0 - alpha / omega_n**2,
        beta=gamma * scale,
        gamma=delta * scale,
        n=joint.nu,
    )


def to_benchmark(joint: Any, mass: float, beta: float = 1.0) -> Benchmark:
    r"""Return the joint in the parameters of the hysteretic benchmark.

    $$z = m Z: \quad k = m (\omega_n^2 - \alpha), \quad \alpha_B = m\alpha, \quad
      \beta\gamma_B = \gamma\,m^{1-\nu}, \quad \beta\delta_B = \delta\,m^{1-\nu}$$
    """
    omega_n, zeta, alpha, delta, gamma = _scalars(joint, mass)
    require_positive(beta, "beta")
    scale = mass ** (1.0 - joint.nu) / beta
    return Benchmark(
        mass=mass,
        damping=2.0 * zeta * omega_n * mass,
        stiffness=mass * (omega_n**2 - alpha),
        alpha=mass * alpha,
        beta=beta,
        gamma=gamma * scale,
        delta=delta * scale,
        nu=joint.nu,
    )


def bouc_wen(stiffness: Scalar, n: Scalar, gamma: Scalar, beta: Scalar) -> Material:
    r"""Return the hysteretic force alone in OpenSees [N], without the parallel spring and dashpot.

    $$F = k_0 z, \qquad dz / dy = 1 - |z|^n\,(\gamma + \beta\,\mathrm{sgn}(z\,dy))$$

    Args:
        stiffness: k_0 [N/m].
        n: Exponent.
        gamma: Non-dissipating coefficient [m^-n].
        beta: Dissipating coefficient [m^-n].
    """
    # The first argument is the ratio of a linear spring, here 0; the last are A = 1 and no
    # degradation.
    return Material("BoucWen", (0.0, stiffness, n, gamma, beta, 1.0, 0.0, 0.0, 0.0))


def conversions(joint: Any, mass: float) -> dict[str, Conversion]:
    """Return the joint in every convention of this module, by name."""
    baber, benchmark = to_baber_noori(joint, mass), to_benchmark(joint, mass)
    # Units for z as a displacement and as a force; they depend on the exponent.
    n = baber.n
    length, force = ("1/m", "1/m") if n == 1.0 else (f"1/m^{n:g}", f"N^{1.0 - n:g}/m")
    baber_units = {**OF_BOTH, "ratio": "1", "beta": length, "gamma": length, "n": "1"}
    benchmark_units = {**OF_BOTH, "alpha": "N/m", "beta": "1", "gamma": force, "delta": force}
    materials = (bouc_wen(mass * float(joint.alpha), baber.n, baber.gamma, baber.beta),)
    return {
        "Bouc-Wen-Baber-Noori, OpenSees": Conversion(baber._asdict(), baber_units, materials),
        "hysteretic benchmark": Conversion(benchmark._asdict(), benchmark_units | {"nu": "1"}),
    }


def _scalars(joint: Any, mass: float) -> tuple[float, ...]:
    require_positive(mass, "mass")
    if joint.restoring is not None:
        raise ModelError(
            "Parameter `restoring` must be None for a conversion, but is of kind "
            f"{type(joint.restoring).__name__}.",
            why="The conventions of other programs have only a linear spring and the hysteretic "
            "force.",
            remedy="Convert the oscillator without `restoring`, and add the restoring force as a "
            "separate spring in the other program.",
        )
    leaves = joint.omega_n, joint.zeta, joint.alpha, joint.delta, joint.gamma
    return tuple(float(leaf) for leaf in leaves)


def require_positive(value: float, name: str) -> None:
    """Raise if a number is not positive."""
    if not value > 0.0:
        raise ModelError(f"Argument `{name}` must be positive, but it is {value:g}.")
