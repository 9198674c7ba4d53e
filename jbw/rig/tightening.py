r"""A joint tightened again and again: its parameters by the torque, and their scatter.

A torque T gives a preload N, through a wrench that is off and a contact that beds in,

$$\ln N = \ln(T / T_0) + b\,\ln n + w\,\epsilon$$

n being the number of the tightening. The torque is set and the preload scatters about it (Berkson's
error): a regression on T keeps its slope, and w is part of the scatter. The contact is stiffer by
$N^p$ and slips at a force of $\mu N$. A joint through which all of the load passes is given its
force: what it adds to the motion falls, and its slip comes at larger displacements. One beside
which the rest carries is given its displacement,

$$\text{series:}\quad k \sim N^{-p},\; y_s \sim N; \qquad
  \text{parallel:}\quad k \sim N^p,\; y_s \sim N^{1-p}$$

for the stiffness k that slip loses, and the displacement y_s at which it slips. Every parameter of
every law is a power of these two by its unit: $1/s^2$ is a stiffness, m a displacement. In both
limits ratios of like unit, as gamma/delta of Bouc-Wen's law, do not follow the torque.
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

FLEET = 0xF1EE7  # stream of what scatters between assemblies


@dataclass(frozen=True)
class Tightening:
    """How a joint follows the torque, and what scatters from one tightening to the next.

    Attributes:
        reference: Torque at which the joint is the one that was given [N m].
        load_path: `series` or `parallel`, as above.
        contact: p, the contact stiffness' power of the preload, 1/2 to 1.
        omega_n: Power of the preload that the natural frequency follows.
        zeta: The same of the damping ratio.
        scatter: Standard deviations of logarithms between assemblies, of `omega_n`, `zeta` and of
            the law's `stiffness` and slip `displacement`.
        wrench: w, standard deviation of ln preload at a torque.
        bedding: b, power of the number of the tightening.
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
    """Return the structure with its joint tightened to a torque.

    Args:
        joint: The structure at the reference torque, when nothing scatters.
        torque: What the wrench says [N m].
        how: How the joint follows it.
        sequence: Number of the tightening.
        chance: Standard normal numbers of this tightening: of omega_n, zeta, stiffness,
            displacement and preload; the mean of all tightenings when None.

    Raises:
        ConfigError: A number out of its range.
        ModelError: A law with a parameter that is no power of a stiffness and a displacement.
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
    """Measure one campaign per tightening: all torques of one assembly, then the next.

    Each states its [assembly] table and holds its own joint in `truth`; tightenings are counted
    over all campaigns of an assembly. Priors are left to the records' own scales.

    Torques that rise with the number of the tightening hide bedding-in in the trend. So each
    assembly takes them in an order by chance, and the one after it in the reverse of that.

    Args:
        preset: What is measured of each; its day-to-day scatter are the runs of one tightening.
        torques: What the wrench says [N m].
        assemblies: How often the structure is taken apart and put together again at each torque.
        joint: The structure at the reference torque, when nothing scatters.
        how: How the joint follows the torque.
        order: `shuffled`, or `given`: every assembly in the order of `torques`.
        seed: Seed of everything random.
        conditions: Further arguments of `jbw.rig.measure`.

    Raises:
        ConfigError: A number out of its range.
        ModelError: As `tightened`, and as `jbw.rig.measure`.
    """
    if assemblies < 1 or not len(torques):
        raise ConfigError("A fleet needs one torque and one assembly at least.")
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
    """Draw the order of torques at random; reverse it for every second assembly."""
    permutation = _chance(seed, assembly // 2).permutation(num).tolist()
    return permutation[::-1] if assembly % 2 else permutation


def _stated(campaign: RigCampaign, assembly: str, torque: float, sequence: int) -> RigCampaign:
    """Return a campaign with its [assembly] table and without the paper's prior boxes."""
    table = Assembly(name=assembly, torque=torque, sequence=sequence)
    settings = campaign.settings.model_copy(update={"prior": {}})
    name = f"{campaign.name}, {assembly} at {torque:g} N m"
    return replace(campaign, name=name, assembly=table, settings=settings)


def _power(name: str, unit: str) -> Float[np.ndarray, " 2"]:
    """Return the powers of stiffness and of displacement in a parameter of this unit."""
    exponents = powers_of(unit)
    seconds = exponents.pop("s", 0)
    metres = exponents.pop("m", 0)
    if seconds > 0 or seconds % 2 or exponents:
        raise ModelError(
            f"Parameter {name} must be a power of a stiffness per mass and of a displacement, but "
            f"its unit is {unit}.",
            remedy="Let laws without viscous parts follow the torque.",
        )
    return np.array([-seconds / 2, metres])


def _check(how: Tightening, torque: float, sequence: int) -> None:
    """Raise an error, with the argument's name, for numbers out of range."""
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
                f'Argument `scatter` must name {", ".join(SCATTERING)}, but holds "{name}".'
            )
    for name, value in (*how.scatter.items(), ("wrench", how.wrench)):
        if not 0.0 <= value < np.inf:
            raise ConfigError(f"Argument `{name}` must be finite and not negative, but is {value}.")
