"""Answers of jbw to a campaign and to its image, compared number by number, each in its unit.

Every number of a `--json` output has its unit in `UNITS` by the name of its field, or in its row's
`unit`, or as the parameter that it is named after. A field that has none is an error: whoever adds
a field states its unit here, and with that how it changes with the units of length, time and mass.
"""

import re

PURE = "1"
# Of numbers by the name of their field. A pair holds the unit and the field of the same row by
# which rounding is measured: a scatter of equal readings is a difference of nearly equal numbers.
UNITS = {
    # look
    "y": "m", "y_max": "m", "frequency_hz": "Hz", "frequency_sd": ("Hz", "frequency_hz"),
    "damping": PURE, "damping_sd": (PURE, "damping"), "stiffness": "N/m", "records": PURE,
    "left": PURE, "third": PURE, "noise": PURE, "coherence": PURE,
    # check
    "fs": "Hz", "repeats": PURE,
}  # fmt: skip
# Numbers that are not compared, and why.
NOT_COMPARED = {
    "wall_time_s": "how long this machine took",
    "versions": "of packages, not of the data",
    "command": "what was typed",
    "inputs": "hashes of files, whose samples are others",
}
PREFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}
# A number, and the unit behind it, perhaps behind another number of the same: "0.05 to 3.5 mm".
NUMBER = r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+|×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?!\.?\w)"
UNIT = r"([nuµkM]|m(?!/)(?=[mHsN]))?(m/s\^2|m/s²|m/s|m|Hz|s|N/m|N|1/s|1/m|kg)(?![\w/^²])"
TOKEN = re.compile(rf"({NUMBER})|(?<![\w/]){UNIT}")
BETWEEN = re.compile(r"[\s,\[\]]*(?:to|and|at)?[\s,\[\]]*")
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


def differences(found, expected, scale, tolerance, path=(), row=None):
    """Sentences on what differs between an answer to an image and that to the campaign."""
    place = "/".join(map(str, path))
    if path and path[-1] in NOT_COMPARED:
        return []
    if isinstance(expected, dict):
        if list(found) != list(expected):
            return [f"{place}: has {list(found)}, not {list(expected)}"]
        return [
            said
            for key, value in expected.items()
            for said in differences(found[key], value, scale, tolerance, (*path, key), expected)
        ]
    if isinstance(expected, list | tuple):
        if len(found) != len(expected):
            return [f"{place}: {len(found)} values, not {len(expected)}"]
        pairs = enumerate(zip(found, expected, strict=True))
        return [
            said
            for i, (one, other) in pairs
            for said in differences(one, other, scale, tolerance, (*path, i), row)
        ]
    if isinstance(expected, bool | type(None)) or isinstance(found, bool | type(None)):
        return [] if found is expected else [f"{place}: {found}, not {expected}"]
    if isinstance(expected, str):
        return [f"{place}: {said}" for said in text_differences(found, expected, scale)]
    return _number(found, expected, scale, tolerance, path, row or {})


def _number(found, expected, scale, tolerance, path, row):
    place, unit = "/".join(map(str, path)), unit_of(path, row)
    if unit is None:
        return [f"{place}: state its unit in tests/study/same_answers.py"]
    unit, beside = unit if isinstance(unit, tuple) else (unit, None)
    factor = scale.of(unit)
    reference = expected if beside is None else row[beside]
    off, allowed = abs(found - factor * expected), tolerance * abs(factor * reference)
    # A number that is zero but for rounding is so in every image.
    return [] if off <= allowed else [f"{place}: {found!r}, not {factor * expected!r} ({unit})"]


def unit_of(path, row):
    """The unit of a number: that of its field, of its row, or of the parameter of its name."""
    names = [name for name in path if isinstance(name, str)]
    field = names[-1]
    if field == "level":
        return "m" if row.get("kind") in ("frf", "loop", "curve") else row.get("level_unit") or "N"
    return UNITS.get(field)


def text_differences(found, expected, scale):
    """How a text differs but for its numbers, each of which may be in any unit of the text."""
    said, now = _parted(found)
    wanted, before = _parted(expected)
    if said != wanted:
        return [f"{found!r}, not {expected!r}"]
    factors = {1.0} | {scale.of(unit.replace("²", "^2")) for unit in wanted[1]}
    for (one, digit), (other, last) in zip(now, before, strict=True):
        # Both are rounded to their last digit.
        if not any(
            abs(one - factor * other) <= 0.51 * (digit + abs(factor) * last) for factor in factors
        ):
            return [f"{one:g}, not {other:g} in {found!r}, not {expected!r}"]
    return []


def _parted(text):
    """What is said without numbers and prefixes, and the units; numbers with their last digit."""
    words, units, numbers, waiting, end = [], [], [], [], 0
    for token in TOKEN.finditer(text):
        between = text[end : token.start()]
        words.append(between)
        if not BETWEEN.fullmatch(between):
            waiting = []
        if token[1]:
            numbers.append(_value(token[1]))
            waiting.append(len(numbers) - 1)
            words.append("#")
        else:
            factor = PREFIX[token[2] or ""]
            for i in waiting:
                numbers[i] = tuple(factor * x for x in numbers[i])
            waiting = []
            units.append(token[3])
            words.append(token[3])
        end = token.end()
    return ("".join([*words, text[end:]]), units), numbers


def _value(text):
    """A printed number, and what one in its last digit is worth."""
    mantissa, _, exponent = text.translate(RAISED).replace("×10", "e").partition("e")
    size = 10.0 ** int(exponent or 0)
    decimals = len(mantissa.partition(".")[2])
    return float(mantissa) * size, 10.0**-decimals * size
