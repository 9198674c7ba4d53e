r"""Laws of one of several joints, with parameters that carry the joint's name.

`bouc_wen@bolt_1` has the parameters `alpha@bolt_1`, `delta@bolt_1` and `gamma@bolt_1`, in the
joint's units: alpha is in N/m if the joint's motion is in metres. Joints that share one law are
named together, `bouc_wen@bolt_1=bolt_2`; its parameters carry the first joint's name.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from typing import Any, ClassVar, Self

from jbw.oscillator.law import Bounds, Coordinates, Law, Monomial, Scales, Threshold
from jbw.quantities import Quantity, law_name, name_at, split


@cache
def law_at(kind: type[Law], joints: tuple[str, ...]) -> type[Law]:
    """Return the law class for joints that share it; the first joint names the parameters."""
    joint = joints[0]

    def named(quantity: Quantity) -> Quantity:
        return quantity._replace(
            name=name_at(quantity.name, joint), symbol=f"{quantity.symbol} {joint}",
            unit=_unit(quantity), meaning=f"{quantity.meaning}, {joint}",
        )  # fmt: skip

    def monomial(product: Monomial) -> Monomial:
        powers = {name_at(name, joint): power for name, power in product.powers.items()}
        return Monomial(named(product.quantity), powers)

    def plain(theta: Mapping[str, Any]) -> dict[str, Any]:
        return {name: theta[name_at(name, joint)] for name in kind.names()}

    class AtJoints(kind):
        """A law of one of several joints, with parameters that carry the joint's name."""

        name = law_name(kind.name, joints)
        table = tuple(named(quantity) for quantity in kind.table)
        products = tuple(monomial(product) for product in kind.products)
        coordinates: ClassVar[Mapping[str, Coordinates]] = {}

        @classmethod
        def build(cls, theta: Mapping[str, Any]) -> Self:
            """Return the law from parameters that carry the joint's name."""
            return _of_kind(cls, kind.build(plain(theta)))

        @classmethod
        def unnamed(cls, theta: Mapping[str, Any]) -> Law:
            """Return the law without the joint's name, so that joints use the same program."""
            return kind.build(plain(theta))

        def parameters(self) -> dict[str, Any]:
            """Return the law's parameter values, keyed by the names that they have at the joint."""
            plain_values = _of_kind(kind, self).parameters()
            return {name_at(name, joint): value for name, value in plain_values.items()}

        @classmethod
        def prior(cls, scales: Scales) -> Bounds:
            """Return prior bounds from the scales of the joint: its stiffness and its motion."""
            return {name_at(name, joint): pair for name, pair in kind.prior(scales).items()}

        @classmethod
        def caution(cls, bounds: Bounds, y_peak: float) -> str | None:
            """Return a warning if the law may diverge within the joint's prior bounds, or None."""
            return kind.caution(plain(bounds), y_peak)

        def powers_of_length(self) -> dict[str, Any]:
            """Return the exponents of length to add to the units of a joint's parameters."""
            plain_powers = _of_kind(kind, self).powers_of_length()
            return {name_at(name, joint): value for name, value in plain_powers.items()}

        def thresholds(self) -> tuple[Threshold, ...]:
            """Return no thresholds: records of responses do not show the motion of one joint."""
            return ()

    AtJoints.__name__ = AtJoints.__qualname__ = kind.__name__
    return AtJoints


def _of_kind[Kind: Law](kind: type[Kind], law: Law) -> Kind:
    """Convert a law to another class with the same fields; the values of the fields stay."""
    same = object.__new__(kind)
    for field in fields(law):
        object.__setattr__(same, field.name, getattr(law, field.name))
    return same


def _unit(quantity: Quantity) -> str:
    """Return the unit of a quantity for forces in N instead of N/kg: `1/s^2` becomes `N/m`."""
    return _PER_MASS.get(quantity.unit, quantity.unit)


_PER_MASS = {
    "1/s^2": "N/m",
    "1/(m s^2)": "N/m^2",
    "1/(m^2 s^2)": "N/m^3",
    "1/(m^4 s^2)": "N/m^5",
    "N/kg": "N",
    "1/s": "N s/m",
}


def resolved(name: str, law_named: Callable[[str], type[Law]]) -> type[Law]:
    """Return the law class of a name that contains joints, such as `bouc_wen@bolt_1`."""
    plain, joints = split(name)
    return law_at(law_named(plain), joints)
