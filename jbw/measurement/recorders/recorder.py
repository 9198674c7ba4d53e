"""The interface of a recorder, and what recorders extract from file trees and from lines of text.

Facts are texts, numbers, titles and sampling frequencies.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jbw.measurement.files.tree import Contents, Leaf, Opaque, load
from jbw.units import FACTORS, is_unit, plain, titled

MOST_VALUES = 4096  # largest size of an array from which a single number is read


@dataclass(frozen=True)
class Recorder:
    """A recorder: the layout of files as one program writes them.

    A tree of MATLAB, HDF5, UFF, TDMS, WAV or NumPy is recognised by `of`, if one of `readers` made
    it, and annotated by `read`. A text is recognised from its first lines by `of_text`, and parsed
    by `read_text`. The docstring of the recorder's module says how files are recognised, on what
    evidence, and what has not been tested.
    """

    name: str
    of: Callable[[Contents], bool] | None = None
    read: Callable[[Contents], Contents] | None = None
    of_text: Callable[[Sequence[str]], bool] | None = None
    read_text: Callable[[Sequence[str], Path], Contents] | None = None
    is_general: bool = False  # whether this recorder accepts files that no other recognises
    # beginnings of `Contents.reader`, such as MATLAB, of files to recognise; empty for all files
    readers: tuple[str, ...] = ()

    def recognises(self, contents: Contents) -> bool:
        """Return whether a tree has this recorder's layout; if `of` is None, `readers` decide."""
        is_read = not self.readers or contents.reader.startswith(self.readers)
        return self.read is not None and is_read and (self.of is None or self.of(contents))


def top(contents: Contents) -> dict[str, Any]:
    """Return the top-level nodes of a file's tree by name."""
    root = contents.root
    return {str(name): node for name, node in root.items()} if isinstance(root, Mapping) else {}


def node_at(node: Any, *names: str) -> Any:
    """Return the item at a path of names within structs, or None."""
    for name in names:
        if not isinstance(node, Mapping) or name not in node:
            return None
        node = node[name]
    return node


def text_at(node: Any, *names: str) -> str:
    """Return the text at a path of names within structs; an empty text if there is none."""
    child = node_at(node, *names)
    return child.text.strip() if isinstance(child, Opaque) else ""


def number_at(node: Any, *names: str) -> float:
    """Return the number at a path of names within structs, also if stored as text; NaN if none."""
    child = node_at(node, *names)
    if isinstance(child, Leaf) and 0 < math.prod(child.shape) <= MOST_VALUES:
        values = np.ravel(load(child))
        return float(values[0]) if not np.iscomplexobj(values) else math.nan
    return number_in(child.text) if isinstance(child, Opaque) else math.nan


def number_in(text: Any) -> float:
    """Return the number at the start of a text such as `51200,0 Hz`; NaN if there is none."""
    match = re.match(r"\s*([-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?)", str(text)[:80])
    try:
        return float(match[1].replace(",", ".")) if match else math.nan
    except ValueError:
        return math.nan


def rate_of(increment: float) -> float | None:
    """Return the sampling frequency [Hz] for a sampling interval [s]; None if not positive."""
    return 1 / increment if math.isfinite(increment) and increment > 0 else None


def positive(value: float) -> float | None:
    """Return a number if it is positive and finite; otherwise None."""
    return value if math.isfinite(value) and value > 0 else None


def stated(text: str, pattern: str) -> str:
    """Return the text after a key in a line such as `Sample rate: 1000 Hz` or `Key;value`."""
    match = re.match(rf"[\"#%;\s]*(?:{pattern})[\"\s]*(?:[:=;,\t]|\s{{2,}})[\"\s]*(.*)", text,
                     re.IGNORECASE)  # fmt: skip
    return match[1].strip(' "\t;,') if match else ""


RATE = re.compile(
    r"^[\"#%;\s]*(?:default\s+)?(fs|f_s|(?:sampling|sample|scan|acquisition)[\s_]*"
    r"(?:frequency|freq\.?|rate)|samplerate|abtastrate|abtastfrequenz|messrate)"
    r"\s*(?:\[([^\]]*)\]|\(([^)]*)\))?[\"\s]*[:=;,\t ][\"\s]*"
    r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)\s*[,;]?\s*([A-Za-zµ/]*)",
    re.IGNORECASE,
)
INTERVAL = re.compile(
    r"^[\"#%;\s]*(dt|d(?:elta)[\s_]*[tx]|(?:sampling|sample|x|time|horizontal)[\s_]*"
    r"(?:interval|increment|period|resolution)|x[\s_]*increment|abtastintervall|increment)"
    r"\s*(?:\[([^\]]*)\]|\(([^)]*)\))?[\"\s]*[:=;,\t ][\"\s]*"
    r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)\s*([A-Za-zµ]*)",
    re.IGNORECASE,
)
# a rate within a sentence, which must state its unit: `sampled at 2 kHz`, `1000 Hz sampling rate`
SPOKEN = re.compile(
    r"(?:(?<!re)(?<!down)sampl|abtast|acquisition\s+rate|scan\s+rate|\bfs\b)[^\d\n]{0,40}?(\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
    r"\s*([kM]?(?:Hz|S/s|Sa/s))\b"
    r"|(\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)\s*([kM]?(?:Hz|S/s|Sa/s))\s+(?:sampl|abtast)",
    re.IGNORECASE,
)
TIMES = r"^t$|\btime|\bdatetime\b|\bzeit(?:stempel)?\b|\btemps\b|^date$"
HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ksa/s": 1e3,
         "ms/s": 1e6, "msa/s": 1e6, "": 1.0}  # fmt: skip
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "sec": 1.0, "": 1.0}


class Axis(NamedTuple):
    """The first axis of a table, as described by lines above the table."""

    name: str  # time or frequency
    unit: str
    fs: float | None  # sampling frequency [Hz] if the axis is a time axis


def axis_in(lines: Sequence[str]) -> Axis | None:
    """Return the axis described by keys such as `Delta` and `AxisUnit`; None without such keys."""
    unit, step = (
        next(filter(None, (stated(line, pattern) for line in lines)), "")
        for pattern in (r"(?:x[\s_]*)?axis[\s_]*unit|x[\s_]*units?", "delta")
    )
    unit, step = plain(unit), number_in(step)
    if unit in FACTORS["frequency"]:
        return Axis("frequency", unit, None)
    seconds = FACTORS["time"].get(unit)
    return None if seconds is None else Axis("time", unit, rate_of(step * seconds))


def rate_in(lines: Sequence[str], *, with_sentences: bool = False) -> float | None:
    """Return the sampling frequency [Hz] that lines above a table state; None if they state none.

    With `with_sentences`, sentences in comments are searched as well.
    """
    for pattern, units, to_fs in (
        (RATE, HERTZ, lambda x: x),
        (INTERVAL, SECONDS, lambda x: 1 / x),
    ):
        for line in lines:
            match = pattern.match(line[:200])
            if not match:
                continue
            _, bracketed, in_parentheses, text, behind = match.groups()
            unit = (bracketed or in_parentheses or behind or "").strip().lower()
            value = float(text.replace(",", "."))
            if unit in units and value > 0:
                return float(to_fs(value * units[unit]))
    for line in lines if with_sentences else ():
        if match := SPOKEN.search(line[:200]):
            value, unit = filter(None, match.groups())
            return positive(float(value.replace(",", ".")) * HERTZ[unit.lower()])
    return None


def named(leaf: Leaf, title: str, unit: str = "") -> Leaf:
    """Return an array with a title; a unit that is not given is taken from the title's end."""
    name, behind = titled(title)
    unit = unit or behind
    return replace(leaf, label=name, unit=plain(unit) if is_unit(unit) else unit)


def titled_leaf(leaf: Leaf, title: str) -> Leaf:
    """Return an array whose title is restored from a name with underscores."""
    return replace(leaf, label=title.replace("_", " ").strip())


def is_time(title: str) -> bool:
    """Return whether a title names a column of times."""
    return re.search(TIMES, title.replace("_", " ").strip().lower()) is not None
