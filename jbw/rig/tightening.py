r"""A joint tightened repeatedly: its parameters as functions of torque, and their variation.

A torque T causes a preload N, through a wrench with an error and a contact that beds in,

$$\ln N = \ln(T / T_0) + b\,\ln n + w\,\epsilon$$

with n the number of the tightening. The torque is set and the preload varies about it (Berkson's
error): a regression on T keeps its slope, and w is part of the variation. The contact stiffness
grows as $N^p$, and slip starts at a force of $\mu N$. A joint that carries the whole load has its
force prescribed: its contribution to the motion decreases, and it slips at larger displacements. A
joint in parallel to other load paths has its displacement prescribed,

$$\text{series:}\quad k \sim N^{-p},\; y_s \sim N; \qquad
  \text{parallel:}\quad k \sim N^p,\; y_s \sim N^{1-p}$$

for the stiffness k that slip removes, and the displacement y_s at which the joint slips. Every
parameter of every law is a power of these two according to its unit: $1/s^2$ is a stiffness, m a
displacement. In both limits ratios of equal unit, such as gamma/delta of the Bouc-Wen law, do not
depend on the torque.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jbw.campaign.tables import Assembly
from jbw.errors import ConfigError, ModelError
from jbw.oscillator.laws import law_named
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.rig.acquisition import RigCampaign, measure
from jbw.rig.presets import TRUTH, Preset
from jbw.units import powers_of

FLEET = 0xF1EE7  # random stream of the variation between assemblies


@dataclass(frozen=True)
class Tightening:
    """The dependence of a joint on torque, and its variation between tightenings.

    Attributes:
        reference: Torque at which the joint is the given one [N m].
        load_path: `series` or `parallel`, as above.
        contact: p, the exponent of the contact stiffness in the preload, 1/2 to 1.
        omega_n: Exponent of the natural frequency in the preload.
        zeta: Exponent of the damping ratio in the preload.
        scatter: Standard deviations of logarithms between assemblies, for `omega_n`, `zeta` and
            the law's `stiffness` and slip `displacement`.
        wrench: w, the standard deviation of ln preload at a given torque.
        bedding: b, the exponent of the number of the tightening.
    """

    reference: float = 8.0
    load_path: Literal["series", "parallel"] = "series"
    contact: float = 0.5
    omega_n: float = 0.01
    zeta: float = -0.1
    scatter: Mapping[str, float] = field(
        default_factory=lambda: {
            "omega_n": 2e-3, "zeta": 0.05, "stiffness": 0.05, "displacement": 0.05
        }
    )  # fmt: skip
    wrench: float = 0.0
    bedding: float = 0.0


SCATTERING = ("omega_n", "zeta", "stiffness", "displacement")


def tightened(
    joint: Joint,
    torque: float,
    how: Tightening | None = None,
    *,
    sequence: int = 1,
    chance: Float[np.ndarray, " 5"] | None = None,
) -> Oscillator:
    """Return the structure with its joint tightened to a given torque.

    Args:
        joint: Structure at the reference torque, without variation.
        torque: Torque of the wrench [N m].
        how: Dependence of the joint on torque.
        sequence: Number of the tightening.
        chance: Standard normal numbers of this tightening, for omega_n, zeta, stiffness,
            displacement and preload; the mean of all tightenings when None.

    Raises:
        ConfigError: A number is out of its range.
        ModelError: A parameter of a law is no power of a stiffness and a displacement.
    """
    how = Tightening() if how is None else how
    _check(how, torque, sequence)
    e = np.zeros(5) if chance is None else np.asarray(chance, float)
    preload = np.log(torque / how.reference) + how.bedding * np.log(sequence) + how.wrench * e[4]
    p = how.contact
    stiffness, displacement = (-p, 1.0) if how.load_path == "series" else (p, 1.0 - p)
    exponents = how.omega_n, how.zeta, stiffness, displacement
    scatter = np.array([how.scatter.get(name, 0.0) for name in SCATTERING])
    omega_n, zeta, stiffer, farther = np.array(exponents) * preload + scatter * e[:4]
    oscillator = as_oscillator(joint)
    laws = []
    for law in oscillator.laws:
        kind = law_named(law.name)
        units = {quantity.name: quantity.unit for quantity in kind.table}
        changed = {
            name: float(value) * np.exp(_power(name, units[name]) @ (stiffer, farther))
            for name, value in law.parameters().items()
        }
        laws.append(kind.build(changed))
    return Oscillator(
        float(oscillator.omega_n) * np.exp(omega_n),
        float(oscillator.zeta) * np.exp(zeta),
        tuple(laws),
    )


def measure_fleet(
    preset: str | Preset = "everyday",
    *,
    torques: Sequence[float],
    assemblies: int = 2,
    joint: Joint = TRUTH,
    how: Tightening | None = None,
    order: Literal["shuffled", "given"] = "shuffled",
    seed: int = 0,
    **conditions: Any,
) -> list[RigCampaign]:
    """Return one measured campaign per tightening: all torques of an assembly, then the next one.

    Each campaign states its [assembly] table and has its own joint in `truth`; tightenings are
    counted over all campaigns of an assembly. No priors are stated, so that they follow from the
    records' scales.

    Torques that increase with the number of the tightening would hide bedding-in in the trend. Each
    assembly therefore takes them in random order, and every second assembly in the reverse order of
    its predecessor.

    Args:
        preset: Tests of each campaign; day-to-day variation appears as runs of one tightening.
        torques: Torques of the wrench [N m].
        assemblies: Number of times that the structure is taken apart and reassembled at each
            torque.
        joint: Structure at the reference torque, without variation.
        how: Dependence of the joint on torque.
        order: `shuffled`, or `given` for the order of `torques` in every assembly.
        seed: Seed of everything random.
        conditions: Further arguments of `jbw.rig.measure`.

    Raises:
        ConfigError: A number is out of its range.
        ModelError: As for `tightened` and `jbw.rig.measure`.
    """
    if assemblies < 1 or not len(torques):
        raise ConfigError("A fleet needs at least one torque and one assembly.")
    if order not in ("shuffled", "given"):
        raise ConfigError(f'Argument `order` must be "shuffled" or "given", but is "{order}".')
    campaigns = []
    for assembly in range(assemblies):
        order_of_torques = (
            _order(len(torques), assembly, seed) if order == "shuffled" else range(len(torques))
        )
        for number, place in enumerate(order_of_torques, start=1):
            chance, torque = _chance(seed, assembly, place), torques[place]
            tightened_joint = tightened(
                joint, torque, how, sequence=number, chance=chance.standard_normal(5)
            )
            campaign = measure(
                preset, joint=tightened_joint, seed=int(chance.integers(2**31)), **conditions
            )
            campaigns.append(_stated(campaign, f"assembly {assembly + 1}", torque, number))
    return campaigns


def _chance(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FLEET, *key)))


def _order(num: int, assembly: int, seed: int) -> Sequence[int]:
    """Return a random order of torques; every second assembly reverses its predecessor's order."""
    permutation = _chance(seed, assembly // 2).permutation(num).tolist()
    return permutation[::-1] if assembly % 2 else permutation


def _stated(campaign: RigCampaign, assembly: str, torque: float, sequence: int) -> RigCampaign:
    """Return a campaign that states its assembly and torque but no prior bounds."""
    table = Assembly(name=assembly, torque=torque, sequence=sequence)
    settings = campaign.settings.model_copy(update={"prior": {}})
    name = f"{campaign.name}, {assembly} at {torque:g} N m"
    return replace(campaign, name=name, assembly=table, settings=settings)


def _power(name: str, unit: str) -> Float[np.ndarray, " 2"]:
    """Return the powers of stiffness and of displacement in a parameter with the given unit."""
    exponents = powers_of(unit)
    seconds = exponents.pop("s", 0)
    metres = exponents.pop("m", 0)
    if seconds > 0 or seconds % 2 or exponents:
        raise ModelError(
            f"Parameter {name} must be a power of a stiffness per mass and of a displacement, "
            f"but its unit is {unit}.",
            remedy="Use laws without viscous parts if the joint depends on the torque.",
        )
    return np.array([-seconds / 2, metres])


def _check(how: Tightening, torque: float, sequence: int) -> None:
    """Raise a ConfigError that names the argument if a number is out of range."""
    positive = {"torque": torque, "reference": how.reference, "sequence": sequence}
    for name, value in positive.items():
        if not 0.0 < value < np.inf:
            raise ConfigError(f"Argument `{name}` must be positive and finite, but is {value}.")
    if how.load_path not in ("series", "parallel"):
        raise ConfigError(
            f'Argument `load_path` must be "series" or "parallel", but is "{how.load_path}".'
        )
    for name in how.scatter:
        if name not in SCATTERING:
            raise ConfigError(
                f"Argument `scatter` may contain only {', '.join(SCATTERING)}, but contains "
                f'"{name}".'
            )
    for name, value in (*how.scatter.items(), ("wrench", how.wrench)):
        if not 0.0 <= value < np.inf:
            raise ConfigError(f"Argument `{name}` must be finite and not negative, but is {value}.")
