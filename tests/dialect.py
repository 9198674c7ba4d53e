"""The notation of units in jbw as a grammar, and as pint reads it, where pint is installed."""

import re
from functools import cache

FACTOR = r"(rad|deg|kg|Hz|[AJNVgms])(\^\d+)?"
PRODUCT = rf"{FACTOR}( {FACTOR})*"
GRAMMAR = re.compile(rf"1|(1|{PRODUCT})?(/({FACTOR}|\(({PRODUCT}|{FACTOR}/{FACTOR})\)))*")


@cache
def readable(unit):
    """Return whether a unit fits the grammar of jbw's notation, and pint's."""
    try:
        from pint import UnitRegistry
    except ImportError:
        return bool(GRAMMAR.fullmatch(unit))
    UnitRegistry().parse_units(unit)
    return bool(GRAMMAR.fullmatch(unit))


def unreadable_units(tree):
    """Return the missing or invalid units of a result's numbers, by path.

    Whole numbers are counts without unit. A noise whose groups differ has a unit for each group.
    """
    wrong = {}
    for node in tree.subtree:
        for name, values in node.dataset.variables.items():
            own = values.attrs.get("group_units", values.attrs.get("units"))
            own = [own] if own is None or isinstance(own, str) else list(own)
            if values.dtype.kind in "fc" and not all(unit and readable(unit) for unit in own):
                wrong[f"{node.path}/{name}"] = own
    return wrong
