"""The register of joint laws: one file per law.

A law that is defined elsewhere, in a test or a notebook, is added by `register`. A campaign or a
command can then use its name.

Examples:
    A law is built from the parameters that its name has:

    >>> import jbw
    >>> print([quantity.name for quantity in jbw.laws.quantities_of(["jenkins_1"])])
    ['stiffness_1', 'slip_1']
    >>> print(jbw.laws.law_named("jenkins_1").build({"stiffness_1": 200.0, "slip_1": 1e-3}))
    Jenkins1(alpha=(200.0,), phi=(0.001,))
"""

import re
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from typing import Any

from jbw.errors import ConfigError
from jbw.oscillator.guests import require_contract as _require_contract
from jbw.oscillator.law import Law
from jbw.oscillator.laws.at_joints import resolved as _resolved
from jbw.oscillator.laws.bouc_wen import BoucWenLaw
from jbw.oscillator.laws.bouc_wen_nu import BoucWenNu
from jbw.oscillator.laws.bwbn import BWBN as BWBN
from jbw.oscillator.laws.bwbn import BWBNPinching as BWBNPinching
from jbw.oscillator.laws.dampers import CubicDamping, QuadraticDamping
from jbw.oscillator.laws.gap_series import GapSeries
from jbw.oscillator.laws.given_backbone import given_backbone as given_backbone
from jbw.oscillator.laws.iwan import Iwan4, MasingExponential, MasingPower
from jbw.oscillator.laws.jenkins import Jenkins, jenkins
from jbw.oscillator.laws.kinked_springs import Quadratic, Stop
from jbw.oscillator.laws.masing import Masing as Masing
from jbw.oscillator.laws.springs import Cubic as Cubic
from jbw.oscillator.laws.springs import Polynomial as Polynomial
from jbw.oscillator.laws.springs import Quintic, Square
from jbw.quantities import AT, Quantity
from jbw.report.messages import joint as messages

Kind = type[Law]

# Laws by name. A family of laws, such as `jenkins`, makes the law `jenkins_3` from the number 3.
LAWS: dict[str, Kind] = {
    law.name: law
    for law in (
        BoucWenLaw,
        BoucWenNu,
        BWBN,
        BWBNPinching,
        Cubic,
        CubicDamping,
        GapSeries,
        Iwan4,
        Jenkins,
        MasingExponential,
        MasingPower,
        Quadratic,
        QuadraticDamping,
        Quintic,
        Square,
        Stop,
    )
}
FAMILIES: dict[str, Callable[[int], Kind]] = {"jenkins": jenkins}


def is_law(kind: Any) -> bool:
    """Return True if this object is a law class (a subclass of `Law`)."""
    return isinstance(kind, type) and issubclass(kind, Law)


def register(law: Kind) -> Kind:
    """Add a law to the register by its name; usable as a decorator.

    Args:
        law: The law class.

    Raises:
        ConfigError: Another law has this name, it is not a law, or its methods disagree with its
            force and rate: see `jbw.oscillator.contract`.
    """
    if not is_law(law):
        raise ConfigError(f"A law must be a subclass of `Law`, but this is {law!r}.")
    if LAWS.get(law.name, law) is not law:
        raise ConfigError(
            f"A law `{law.name}` is already registered.",
            remedy="Give the new law another `name`.",
        )
    _require_contract([law])
    LAWS[law.name] = law
    return law


def law_named(name: str | Kind) -> Kind:
    """Return the law class of a name, such as `bouc_wen` or `jenkins_3`; return a class unchanged.

    Raises:
        ConfigError: There is no such law; the message gives the nearest known name.
    """
    if is_law(name):
        return name  # pyright: ignore[reportReturnType]
    if name in LAWS:
        return LAWS[str(name)]
    if AT in str(name):
        return _resolved(str(name), law_named)
    member = re.fullmatch(r"(\w+)_([1-9]\d?)", str(name))
    if member and member[1] in FAMILIES:
        return FAMILIES[member[1]](int(member[2]))
    choices = [*LAWS, *(f"{family}_3" for family in FAMILIES)]
    nearest = get_close_matches(str(name), choices, n=1, cutoff=0.5)
    hint = f"; did you mean `{nearest[0]}`" if nearest else ""
    raise ConfigError(f"Unknown law `{name}`{hint} (known: {', '.join(choices)}).")


def laws_named(names: Iterable[str | Kind]) -> tuple[Kind, ...]:
    """Return the classes of several laws that act in parallel.

    Raises:
        ConfigError: A law is unknown or named twice, or two laws share a parameter's name.
    """
    kinds = tuple(law_named(name) for name in names)
    owner: dict[str, str] = {}
    for kind in kinds:
        if kind.name in [other.name for other in kinds if other is not kind]:
            raise ConfigError(
                f"Two different laws have the name `{kind.name}`.",
                remedy="Give one of the two laws another `name`.",
            )
        if kinds.count(kind) > 1:
            raise ConfigError(f"The law `{kind.name}` is named twice.")
        for name in kind.names():
            if name in owner:
                raise ConfigError(
                    f"The laws `{owner[name]}` and `{kind.name}` share the parameter `{name}` and "
                    "cannot be combined."
                )
            owner[name] = kind.name
    return kinds


def same_by_construction(names: Iterable[str | Kind]) -> str | None:
    """Return a message if no motion can distinguish some of the laws among `names`.

    The sum of two Masing laws, sliders included, is the Masing law of the sum of their virgin
    curves; and Bouc-Wen's law is the law with a free exponent at an exponent of one.
    """
    kinds = laws_named(names)
    for why in (messages.SAME_CURVES, messages.SAME_EXPONENT):
        same_laws = [kind.name for kind in kinds if kind.same_as == why]
        if len(same_laws) > 1:
            return messages.indistinguishable(same_laws, why)
    return None


def quantities_of(laws: Iterable[str | Kind]) -> tuple[Quantity, ...]:
    """Return the tables of the parameters of several laws, one after the other."""
    return tuple(quantity for law in laws_named(laws) for quantity in law.table)


def vocabulary() -> dict[str, Quantity]:
    """Return the quantities of all laws by name: parameters, products and other coordinates."""
    quantities: dict[str, Quantity] = {}
    for law in LAWS.values():
        coordinates = (quantity for other in law.coordinates.values() for quantity in other.table)
        products = (product.quantity for product in law.products)
        quantities |= {
            quantity.name: quantity for quantity in (*law.table, *coordinates, *products)
        }
    return quantities
