"""One entry of the catalogue, and the formatting of values in its sentences."""

from collections.abc import Callable, Mapping, Sequence
from inspect import cleandoc
from string import Formatter
from typing import Any, NamedTuple

PREFIXES = ((1.0, "m"), (1e3, "mm"), (1e6, "µm"), (1e9, "nm"))

Template = str | Callable[..., str]
"""A format string for `str.format`, or a function that chooses between several texts."""


class Message(NamedTuple):
    """The entry of the catalogue for one code.

    Attributes:
        code: Code of the finding; a point separates it from the variant to which the sentence
            belongs, as in "r_hat.one_chain".
        sentence: The fact, in one sentence with the values of the finding.
        explanation: What the check is, why it matters and what to do: a page of `jbw explain`.
            Empty for a variant, which the code's page explains.
        remedy: What to do, with its values; a line of the campaign file where there is one.
        passed: The sentence of a finding that is ok, if it differs from `sentence`.
        question: The question of the verdict that a finding from outside of jbw answers:
            "sampling", "law" or "knowledge".
    """

    code: str
    sentence: Template = ""
    explanation: str = ""
    remedy: Template = ""
    passed: Template = ""
    question: str = "sampling"


class FaultText(NamedTuple):
    """The text of a fault of data or a campaign file: what is wrong, why it matters, what to do."""

    what: str
    why: str = ""
    remedy: str = ""


class _Words(Formatter):
    """Python's `str.format` with more formats: `.2g %` for ratios, `list` and `and` for names."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        if format_spec == "list":
            return ", ".join(map(str, value))
        if format_spec == "and":
            return listed(value)
        if format_spec.endswith(" %"):
            return percent(value, format_spec.removesuffix(" %"))
        return super().format_field(value, format_spec)


def written(template: Template, values: Mapping[str, Any]) -> str:
    """Fill the values into a text of the catalogue."""
    if callable(template):
        return template(**values)
    return _Words().vformat(template, (), values)


def page(message: Message) -> str:
    """Return a finding's explanation as Markdown, without the indentation of the source."""
    return cleandoc(message.explanation)


def percent(ratio: float, digits: str = ".2g") -> str:
    """Return a ratio in per cent, without a power of ten if it is large: 0.0734 as "7.3 %"."""
    return f"{number(100 * ratio, digits)} %"


def number(value: float, digits: str = ".3g") -> str:
    """Return a number as people write it, without a power of ten if it is large: 334, not 3e+02."""
    text = f"{value:{digits}}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e6 else text


def length_unit(largest: float) -> tuple[float, str]:
    """Return the unit in which a length [m] exceeds one, and its factor."""
    return next((prefix for prefix in PREFIXES if largest * prefix[0] >= 1.0), PREFIXES[-1])


def length(y: float, digits: int = 3) -> str:
    """Return a length [m] in a unit in which it exceeds one, such as "334 µm"."""
    factor, unit = length_unit(abs(y))
    return f"{factor * y:.{digits}g} {unit}"


def listed(names: Any) -> str:
    """Return names as a list in a sentence: "a", "a and b", "a, b and c"."""
    *first, last = map(str, names)
    return f"{', '.join(first)} and {last}" if first else last


def first_of(texts: Sequence[str], most: int = 4) -> str:
    """Return the first of many texts and the number of the others: "a, b and 3 more"."""
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return f"{', '.join(texts[:most])}{more}"


def capital(text: str) -> str:
    """Return a text with a capital letter at its beginning."""
    return text[:1].upper() + text[1:]
