"""The one dialect of units, as a grammar; and as pint reads it, where pint is installed."""

import re

FACTOR = r"(rad|deg|kg|Hz|[AJNVgms])(\^\d+)?"
PRODUCT = rf"{FACTOR}( {FACTOR})*"
GRAMMAR = re.compile(rf"1|(1|{PRODUCT})?(/({FACTOR}|\(({PRODUCT}|{FACTOR}/{FACTOR})\)))*")


def readable(unit):
    """Whether a unit is in the dialect, by the grammar of its definition and by pint's."""
    try:
        from pint import UnitRegistry
    except ImportError:
        return bool(GRAMMAR.fullmatch(unit))
    UnitRegistry().parse_units(unit)
    return bool(GRAMMAR.fullmatch(unit))
