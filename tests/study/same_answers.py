"""Answers of jbw to a campaign and to its image in other units, compared number by number.

Every number of a `--json` output has its unit in `UNITS` by the name of its field, or in the `unit`
of its row, or from the parameter that it is named after. A field without unit is an error: whoever
adds a field states its unit here, and thus how it changes with the units of length, time and mass.
"""

import re

from scaled_campaigns import UNIT_OF_PARAMETER

PURE, ONE, OF_ROW = "1", object(), "its row's"
# Units of numbers by the name of their field, or of the table that contains them. A pair contains
# the unit and the reference for differences: another field of the same row, since for example the
# scatter of equal readings is a difference of nearly equal numbers, or `ONE`.
UNITS = {
    # look
    **dict.fromkeys(("y", "y_min", "y_max"), "m"),
    "frequency_hz": "Hz", "frequency_sd": ("Hz", "frequency_hz"),
    "damping_sd": (PURE, "damping"), "stiffness": "N/m", "tone_hz": "Hz",
    **dict.fromkeys(("damping", "records", "left", "residual", "third"), PURE),
    **dict.fromkeys(("noise", "coherence"), PURE),
    # cycles of a loop
    "amplitude": "m", "work": "N m", **dict.fromkeys(("retained", "repeated"), PURE),
    # check
    "fs": "Hz", "repeats": PURE, "fitted": PURE, "fitted_repeats": PURE,
    # A parameter's row states its unit; the sd is the reference for the other numbers.
    **dict.fromkeys(("mean", "map", "q005", "q500", "q995", "value", "truth"), (OF_ROW, "sd")),
    "sd": OF_ROW, "z": (PURE, ONE),
    **dict.fromkeys(("cv", "relative", "ess_bulk", "ess_tail", "r_hat"), PURE),
    # Nats, standard deviations, and shares of a box: small values count as zero.
    **dict.fromkeys(("kl", "contraction", "shift", "ratio", "correlation"), (PURE, ONE)),
    **dict.fromkeys(("loadings", "information", "costs", "reached", "chi_square"), (PURE, ONE)),
    # predictions
    **dict.fromkeys(("coverage", "num_values", "nrmse", "half_width", "nrmse_linear"), PURE),
    **dict.fromkeys(("nrmse_cubic", "nrmse_own_frequency", "extrapolation", "num_draws"), PURE),
    "y_peak": "m", "y_peak_fitted": "m",
    # The verdict's numbers are ratios or counts.
    "number": (PURE, ONE),
    "seed": PURE,
    "quick": PURE,  # of a first answer: relative errors by test
    # a comparison of laws
    "spring": "1/(m s^2)", "damper": "1/m",
    **dict.fromkeys(("softening", "softening_exponent", "damping_exponent", "masing"), PURE),
    **dict.fromkeys(("elastic", "opening", "num_readings", "num_parameters", "lines"), PURE),
    **dict.fromkeys(("error", "error_left_out", "error_highest", "floor", "line"), PURE),
    **dict.fromkeys(("error_held_out", "error_beyond", "error_across"), PURE),
    **dict.fromkeys(("khat", "khat_evidence", "elpd_doubt", "weight"), (PURE, ONE)),
    **dict.fromkeys(("elpd_difference", "elpd_difference_se"), (PURE, ONE)),
    **dict.fromkeys(("log_evidence_difference", "log_evidence_error"), (PURE, ONE)),
    # the law without a form
    **dict.fromkeys(("against_masing", "scatter"), (PURE, ONE)), "inflation": PURE,
    # an export
    "mass": "kg", "dashpot": "N s/m",
}  # fmt: skip
ROUNDING = 1e-12
COLUMNS = {
    "_n_m": "N/m", "_ns_m": "N s/m", "_hz": "Hz", "damping_ratio": PURE, "force_n": "N", "_m": "m",
}  # fmt: skip
TABLES = ("backbone", "loop", "skeleton")  # of an export, whose columns end in their unit
# Numbers that are not compared, with the reason.
NOT_COMPARED = {
    "wall_time_s": "how long this machine took",
    **dict.fromkeys(("versions", "sources"), "of packages, not of the data"),
    "command": "what was typed",
    **dict.fromkeys(("inputs", "sha256", "campaign_sha256"), "hashes of files, which are others"),
    "campaign_file": "where it stands",
    **dict.fromkeys(
        ("elpd", "log_likelihood", "log_evidence", "log_evidence_wide"),
        "densities of the data, in their units; the differences over laws are compared",
    ),
}
# Of draws by tempering, which rounding makes others: a part of their Monte Carlo error.
DRAWN = {"free_law": 0.1}
DRAWN_TEXT = re.compile(r"Without assuming a law|Masing's rule")
BEYOND = "times the largest measured amplitude"  # where a few draws make the ends of a band
PREFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}
# A number, and its unit, perhaps after another number with that unit: "0.05 to 3.5 mm".
NUMBER = r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+|×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?!\.?\w)"
UNIT = (
    r"(?<![\w/])(?P<prefix>[nuµkM]|m(?!/)(?=[mHsN]))?"
    r"(?P<unit>m/s\^2|m/s²|m/s|m|Hz|rad/s|s|N/m|N|1/s\^2|1/s|1/\(m s\^2\)|1/m|1/kg|kg)"
    r"(?![\w/^²])"
)
TOKEN = re.compile(rf"{UNIT}|(?P<number>{NUMBER})")
BETWEEN = re.compile(r"[\s,\[\]]*(?:to|and|at)?[\s,\[\]]*")
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


def differences(found, expected, scale, tolerance, path=(), row=None):
    """Return sentences on the differences between the answers to an image and to the campaign."""
    place = "/".join(map(str, path))
    tolerance = max(tolerance, DRAWN.get(path[0], 0.0)) if path else tolerance
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
    place, stated = "/".join(map(str, path)), unit_of(path, row)
    if stated is None:
        return [f"{place}: state its unit in tests/study/same_answers.py"]
    unit, beside = stated if isinstance(stated, tuple) else (stated, None)
    factor = scale.of(unit)
    if beside is ONE:
        reference = max(1.0, abs(expected))
    else:
        reference = expected if beside is None else row[beside]
    # The standard deviation of a fixed parameter is zero up to rounding.
    least = ROUNDING * max(abs(row.get(name) or 0.0) for name in ("value", "mean", "map"))
    off = abs(found - factor * expected)
    allowed = abs(factor) * (tolerance * abs(reference) + (least if path[-1] == "sd" else 0.0))
    return [] if off <= allowed else [f"{place}: {found!r}, not {factor * expected!r} ({unit})"]


def unit_of(path, row):
    """Return the unit of a number: by its field or table, or as its row states."""
    names = [name for name in path if isinstance(name, str)]
    if names[-1] == "level":
        return row.get("level_unit") or ("m" if row.get("kind") in ("frf", "loop") else "N")
    stated = next((UNITS[name] for name in reversed(names) if name in UNITS), None)
    if names[0] in ("joint", "products"):  # of an export
        return _of_parameter(names)
    if names[0] in TABLES:
        return next((unit for part, unit in COLUMNS.items() if part in names[-1]), None)
    if names[-1] == "spring" and names[0] == "linear":  # of an export; a law has a spring, too
        return "N/m"
    if "spectrum" in names:  # of logarithms of products
        return PURE, ONE
    if stated == OF_ROW or (isinstance(stated, tuple) and stated[0] == OF_ROW):
        own = row.get("unit") or _of_parameter(names[:-1])
        return None if own is None else (own, *stated[1:]) if isinstance(stated, tuple) else own
    return stated


def _of_parameter(names):
    """Return the unit of the parameter, or product of parameters, that a row is named after."""
    products = {"alpha_delta": "1/(m s^2)", "alpha_gamma": "1/(m s^2)"}
    units = UNIT_OF_PARAMETER | products
    return next((units[name] for name in reversed(names) if name in units), None)


# The density of data has a unit, so that its logarithm differs in other units.
EVIDENCE = re.compile(r"log evidence is \S+")


def text_differences(found, expected, scale):
    """Return how a text differs, except for its numbers, which may be in any unit of the text."""
    found, expected = (EVIDENCE.sub("log evidence", text) for text in (found, expected))
    said, now = _parted(found)
    wanted, before = _parted(expected)
    if said != wanted:
        return [f"{found!r}, not {expected!r}"]
    if BEYOND in expected and BEYOND in found:
        return []
    drawn = DRAWN["free_law"] if DRAWN_TEXT.search(expected) else 0.0
    factors = {1.0} | {scale.of(unit.replace("²", "^2")) for unit in wanted[1]}
    for (one, digit), (other, last) in zip(now, before, strict=True):
        # Both numbers are rounded to their last digit.
        if not any(
            abs(one - factor * other)
            <= 0.51 * (digit + abs(factor) * last) + drawn * abs(factor * other)
            for factor in factors
        ):
            return [f"{one:g}, not {other:g} in {found!r}, not {expected!r}"]
    return []


def _parted(text):
    """Return a text's words without numbers and prefixes, its units, and its numbers."""
    words, units, numbers, waiting, end = [], [], [], [], 0
    for token in TOKEN.finditer(text):
        between = text[end : token.start()]
        words.append(between)
        if not BETWEEN.fullmatch(between):
            waiting = []
        if token["number"]:
            numbers.append(_value(token["number"]))
            waiting.append(len(numbers) - 1)
            words.append("#")
        else:
            factor = PREFIX[token["prefix"] or ""]
            for i in waiting:
                numbers[i] = tuple(factor * x for x in numbers[i])
            waiting = []
            units.append(token["unit"])
            words.append(token["unit"])
        end = token.end()
    return ("".join([*words, text[end:]]), units), numbers


def _value(text):
    """Return a printed number, and the value of one in its last digit."""
    mantissa, _, exponent = text.translate(RAISED).replace("×10", "e").partition("e")
    size = 10.0 ** int(exponent or 0)
    decimals = len(mantissa.partition(".")[2])
    return float(mantissa) * size, 10.0**-decimals * size
