r"""Spectral densities of random vibration tests: breakpoints, slopes and units.

A slope of s dB/oct is a density that grows as $f^{\,s / (10 \log_{10} 2)}$.
"""

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jbw.errors import ConfigError, DataError
from jbw.forced.equivalent import Values
from jbw.units import measured, plain

OCTAVE = 10.0 * np.log10(2.0)
EXAMPLE = "frequency [Hz], density [g^2/Hz]"


@dataclass(frozen=True, eq=False)
class RandomProfile:
    """A one-sided spectral density by its breakpoints, linear on log-log axes.

    Attributes:
        freq_hz: Breakpoints in rising order [Hz].
        density: Density at each breakpoint, in `unit`.
        unit: Unit of the density, such as `g^2/Hz`.

    Examples:
        A flat density of 0.04 g^2/Hz over 100 Hz has the rms sqrt(0.04 * 100):

        >>> import jbw
        >>> import numpy as np
        >>> flat = jbw.RandomProfile(np.array([20.0, 120.0]), np.array([0.04, 0.04]), "g^2/Hz")
        >>> print(f"{flat.rms:.2f} g")
        2.00 g
    """

    freq_hz: Values
    density: Values
    unit: str

    @property
    def rms(self) -> float:
        """The overall rms of the profile, in the square root of the density's unit times Hz."""
        log_f, log_g = np.log(self.freq_hz), np.log(self.density)
        power = np.diff(log_g) / np.diff(log_f) + 1.0
        rise = power * np.diff(log_f)
        # The integral of f^(power - 1) between two breakpoints becomes a logarithm at power 0.
        part = np.where(
            np.abs(rise) < 1e-8, 1.0 + 0.5 * rise, np.expm1(rise) / np.where(rise, rise, 1.0)
        )
        areas = self.density[:-1] * self.freq_hz[:-1] * np.diff(log_f) * part
        return float(np.sqrt(np.sum(areas)))

    def at(self, freq_hz: Values) -> Values:
        """Return the density at given frequencies; zero outside the profile."""
        with np.errstate(divide="ignore", invalid="ignore"):
            log_f = np.log(freq_hz)
        inside = (freq_hz >= self.freq_hz[0]) & (freq_hz <= self.freq_hz[-1])
        return np.where(
            inside, np.exp(np.interp(log_f, np.log(self.freq_hz), np.log(self.density))), 0.0
        )

    def in_unit(self, source: str) -> "RandomProfile":
        """Return the profile converted to a source in another unit, such as `m/s^2` or `N`.

        Raises:
            ConfigError: The unit belongs to another quantity.
        """
        have, want = measured(plain(self.unit)), measured(f"({source})^2/Hz")
        if have is None or want is None or have[1] != want[1]:
            raise ConfigError(
                f"The profile must be in ({source})^2/Hz, but is in {self.unit}.",
                why=f"The load is in {source}.",
                remedy="State the unit in the header of the file, or the kind of load: `--base` "
                "for an acceleration of the base.",
            )
        return RandomProfile(self.freq_hz, self.density * have[0] / want[0], f"({source})^2/Hz")


def profile_of(rows: Iterable[tuple[str, str]], unit: str) -> RandomProfile:
    """Return the spectral density that rows of text state in the notation of test laboratories.

    Args:
        rows: Frequency and density, both as text. A frequency is one number or a range such as
            `80-350` [Hz]; a density is a number, or over a range a slope such as `+3 dB/oct`.
        unit: Unit of the densities.

    Raises:
        ConfigError: A row cannot be read, or the rows do not determine the densities.

    Examples:
        A slope of +3 dB/oct over two octaves raises the density by a factor of about four:

        >>> import jbw
        >>> rows = [("20-80", "+3 dB/oct"), ("80-350", "0.04"), ("350-2000", "-3 dB/oct")]
        >>> profile = jbw.profile_of(rows, "g^2/Hz")
        >>> print(profile.freq_hz, profile.density.round(4), f"{profile.rms:.2f} g")
        [  20.   80.  350. 2000.] [0.01  0.04  0.04  0.007] 6.06 g
    """
    known: dict[float, float] = {}
    slopes: list[tuple[float, float, float]] = []
    for freq, value in rows:
        ends = [float(end) for end in re.findall(r"\d+\.?\d*(?:[eE][+-]?\d+)?", freq)]
        slope = re.fullmatch(r"\s*([+-]?\d+\.?\d*)\s*dB\s*/\s*oct\w*\s*", value, re.IGNORECASE)
        if slope and len(ends) == 2:
            slopes.append((ends[0], ends[1], float(slope[1])))
        elif not slope and len(ends) in (1, 2) and _is_positive(value) and min(ends) > 0:
            known |= dict.fromkeys(ends, float(value))
        else:
            raise ConfigError(
                f"A row of the profile must be a frequency and a positive density, or a range and "
                f"a slope, but is `{freq}, {value}`.",
                remedy="Write rows such as `20, 0.01`, `20-80, +3 dB/oct` or `80-350, 0.04`.",
            )
    # Known densities are extended along the slopes until all breakpoints are known.
    for _ in slopes:
        for low, high, slope in slopes:
            gain = (high / low) ** (slope / OCTAVE)
            if low in known:
                known.setdefault(high, known[low] * gain)
            elif high in known:
                known[low] = known[high] / gain
    missing = {end for low, high, _ in slopes for end in (low, high)} - known.keys()
    if missing or len(known) < 2:
        raise ConfigError(
            f"The profile must determine at least two densities, but determines {len(known)}.",
            remedy="State the density at one end of each slope, as in `20, 0.01`.",
        )
    freq_hz = np.array(sorted(known))
    return RandomProfile(freq_hz, np.array([known[freq] for freq in freq_hz]), unit)


def _is_positive(value: str) -> bool:
    try:
        return 0.0 < float(value) < np.inf
    except ValueError:
        return False


def read_profile(path: str | Path, unit: str = "") -> RandomProfile:
    """Return the spectral density from a CSV file with two columns, frequency and density.

    Args:
        path: The file. Its header names the units, as in `frequency [Hz], density [g^2/Hz]`.
        unit: Unit of the density if the file has no header.

    Raises:
        ConfigError: A row cannot be read, or no unit is stated.
        DataError: The file cannot be opened.

    Examples:
        A flat density of 0.01 g^2/Hz over 100 Hz has the rms sqrt(0.01 * 100):

        >>> import jbw
        >>> import numpy as np
        >>> title = "frequency [Hz], density [g^2/Hz]"
        >>> rows = np.array([[20.0, 0.01], [120.0, 0.01]])
        >>> np.savetxt("psd.csv", rows, delimiter=",", header=title, comments="")
        >>> print(f"{jbw.read_profile('psd.csv').rms:.1f} g")
        1.0 g
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as cause:
        raise DataError(
            f"The profile {path} cannot be read: {cause}.",
            remedy="Give a CSV file of frequencies and densities.",
        ) from cause
    delimiter = next((mark for mark in ";\t" if mark in text), ",")
    rows = [row for row in csv.reader(text.splitlines(), delimiter=delimiter) if any(row)]
    rows = [row for row in rows if not row[0].lstrip().startswith("#")]
    if rows and not rows[0][0].strip()[:1].isdigit():
        unit = _header_unit(rows.pop(0)) or unit
    if not unit:
        raise ConfigError(
            f"The profile {path} must state the unit of its density, but has none.",
            why="g^2/Hz and (m/s^2)^2/Hz differ by a factor of 96.",
            remedy=f"Begin the file with a header such as `{EXAMPLE}`.",
        )
    if any(len(row) < 2 for row in rows):
        raise ConfigError(
            f"The profile {path} must have two columns, but a row has one.",
            remedy=f"Write frequency and density in each row, under `{EXAMPLE}`.",
        )
    return profile_of([(row[0], row[1]) for row in rows], unit)


def _header_unit(header: list[str]) -> str:
    """Return the density's unit from the title of the second column; empty if it states none."""
    title = header[1] if len(header) > 1 else ""
    brackets = re.search(r"\[(.+)\]", title) or re.search(r"\((.+)\)\s*$", title)
    written = (brackets[1] if brackets else title).strip().replace("²", "^2")
    return written if measured(plain(written)) is not None else ""
