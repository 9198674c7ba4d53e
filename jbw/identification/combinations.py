"""Combinations of the joint's parameters that data know better than the parameters themselves."""

from collections.abc import Iterable

from jbw.inference.space.box import Product
from jbw.oscillator.law import Coordinates, Law, Monomial
from jbw.oscillator.laws import laws_named


def combinations(
    names: Iterable[str], laws: tuple[str, ...] = ("bouc_wen",)
) -> tuple[Product, ...]:
    r"""The products that weak motion knows of every law, and its parameters if not sampled.

    Args:
        names: Parameters of the box.
        laws: Names of the laws of the joint.

    Returns:
        Those combinations whose parameters are all in the box.
    """
    present = set(names)
    found = []
    for law in laws_named(laws):
        coordinates = _sampled_in(law, present)
        own = [] if coordinates is None else list(coordinates.forward)
        for monomial in (*own, *law.products):
            product = _product(monomial, coordinates, is_product=monomial in law.products)
            if product.powers.keys() <= present:
                found.append(product)
    return tuple(found)


def _sampled_in(law: type[Law], present: set[str]) -> Coordinates | None:
    """Which other coordinates of a law are in the box, if any."""
    own = (one for one in law.coordinates.values() if set(one.names) & present)
    return next(own, None)


def _product(monomial: Monomial, coordinates: Coordinates | None, *, is_product: bool) -> Product:
    powers = monomial.powers
    if is_product and coordinates is not None:
        powers = coordinates.powers(powers)
    factors = tuple(monomial.powers) if is_product else ()
    words = "*".join(factors) if is_product else monomial.name
    return Product(monomial.name, words, {name: float(p) for name, p in powers.items()}, factors)
