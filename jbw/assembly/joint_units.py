r"""The units of a joint in a consistent system: its motion x_j, force and law parameters.

The motion $x_j = w_j^Tq$ is a length, or an angle if it is the rotation of one node relative to
another. In units of $\ell$ metres, $e$ joules and $\tau$ seconds, x_j is in units of $X = \ell$ for
a length and $X = 1$ for an angle. The joint's force, which does work on x_j, is in units of $e/X$.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jbw.assembly.dofs import ROTATIONS, TRANSLATIONS, Dof
from jbw.assembly.units import system_named
from jbw.units import measured

Terms = Sequence[tuple[Dof, float]]


class JointUnits(NamedTuple):
    """The units of one joint's motion and force."""

    motion: float  # unit of the motion [m, or rad]
    force: float  # unit of the force [N, or N m]
    time: float  # unit of time [s]
    length: float  # unit of length of the system of units [m]
    names: tuple[str, str, str]  # names of the units of force, motion and time

    def value(self, si: Any, unit: str, power_of_length: Any = 0.0) -> Any:
        """Return the value of a parameter in the units of this joint.

        Args:
            si: Value in SI, where forces are in newtons and motions in metres.
            unit: SI unit of that value, such as `N/m`.
            power_of_length: Power of length of the value, in addition to that of its unit.
        """
        force, motion, time = _powers(unit)
        scale = self.force**force * self.motion ** (motion + power_of_length) * self.time**time
        return si / scale

    def unit(self, unit: str) -> str:
        """Return the name of an SI unit in this joint's units, such as `N m/rad` for `N/m`."""
        powers = zip(self.names, _powers(unit), strict=True)
        factors = [(name, power) for name, power in powers if power]
        above = " ".join(_raised(name, p) for name, p in factors if p > 0) or "1"
        below = " ".join(_raised(name, -p) for name, p in factors if p < 0)
        if not below:
            return above
        several = " " in below
        return f"{above}/({below})" if several else f"{above}/{below}"


def joint_units(system: str, *, rotates: bool) -> JointUnits:
    """Return the units of a joint that moves by a length; with `rotates`, by an angle."""
    units = system_named(system)
    force, length, time = units.names
    if rotates:
        names = (f"{force} {length}", "rad", time)
        return JointUnits(1.0, units.energy, units.time, units.length, names)
    names = (force, length, time)
    return JointUnits(units.length, units.energy / units.length, units.time, units.length, names)


def rotates(terms: Terms) -> bool:
    """Return True if a joint's motion is a relative rotation of nodes, in radians."""
    return all(dof.direction in ROTATIONS and abs(weight) == 1.0 for dof, weight in terms)


def terms_in(units: JointUnits, terms: Terms) -> tuple[tuple[Dof, float], ...]:
    """Return the factors of a joint's degrees of freedom in the system of units of the model."""
    si = {True: units.length, False: 1.0}
    return tuple(
        (dof, weight * si[dof.direction in TRANSLATIONS] / units.motion) for dof, weight in terms
    )


def _powers(unit: str) -> tuple[int, int, int]:
    """Return the powers of force, motion and time in an SI unit."""
    of_unit = measured(unit)
    if of_unit is None:
        raise ValueError(f"`{unit}` is no SI unit")
    metre, kilogram, second = of_unit[1][:3]
    return kilogram, metre - kilogram, second + 2 * kilogram


def _raised(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"
