"""What the commands print beside their tables."""

from collections.abc import Sequence

from jbw.quantities import Quantity
from jbw.report.messages.message import capital

NO_NAME = "It explains parameters, columns and words too, such as: jbw explain ESS"


def parameter_explained(quantity: Quantity, laws: Sequence[str]) -> str:
    """Meaning, symbol, unit and laws of a parameter."""
    unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
    of_laws = f" Parameter of the law {', '.join(laws)}." if laws else ""
    return f"{capital(quantity.meaning)}, {quantity.symbol}{unit}.{of_laws}"


def nothing_called(name: str, nearest: str) -> str:
    """That a name is not explained, with the nearest that is."""
    guess = f" Did you mean '{nearest}'?" if nearest else ""
    return f"Nothing is called '{name}'.{guess} All findings: jbw explain"
