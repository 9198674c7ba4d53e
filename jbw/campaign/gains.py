"""The force per modal mass that one unit of each source causes, if a campaign states it."""

from collections.abc import Collection, Mapping
from typing import Any

from jbw.measurement.records import BASE, Test, drive_of
from jbw.quantities import FED

Gain = float | Mapping[str, float] | None  # one value for all tests, or one value for each drive
WEIGHTLESS = {*FED, BASE}  # sources whose gain does not follow from a modal mass


def force_per_unit(campaign: Any) -> Gain:  # a campaign as checked, or with its records
    """Return the force per modal mass for one unit of input [1/kg or N/kg/V]; None if unknown.

    If a measured force drives some tests and a shaker's voltage, a current or a moving base others,
    the gains are given by drive. A mass does not determine the gain of a voltage or current, nor
    that of a moving base, which is the participation of the mode.
    """
    gain, mass = campaign.gain, campaign.modal_mass
    by_mass = None if mass is None else 1 / mass
    tests = campaign.tests
    drives = {drive_of(t) if isinstance(t, Test) else t.driven_by for t in tests}
    if differ(drives):
        every = {"force": by_mass, **dict.fromkeys(WEIGHTLESS, gain)}
        return {drive: value for drive, value in every.items() if value is not None}
    if by_mass is None or WEIGHTLESS.isdisjoint(drives):
        return gain if by_mass is None else by_mass
    return {"force": by_mass}


def gain_of(gain: Gain, drive: str) -> float | None:
    """Return the gain of a drive from the result of `force_per_unit`."""
    return gain.get(drive) if isinstance(gain, Mapping) else gain


def differ(drives: Collection[str]) -> bool:
    """Return whether force drives some tests, and a source without a modal mass others."""
    return "force" in drives and not WEIGHTLESS.isdisjoint(drives)
