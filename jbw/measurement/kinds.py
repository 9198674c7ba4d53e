"""A table of every kind of test and of its properties.

Code asks a test for a property of its kind, `test.traits.is_steady`, and never for its name. A new
kind needs one `register` here and one observable.
"""

from typing import NamedTuple

from jbw.errors import ConfigError, did_you_mean


class Kind(NamedTuple):
    """A kind of test and its properties."""

    name: str  # name in a campaign file
    meaning: str  # what is done to the structure
    # All frequencies are excited at once for a long time; averaged spectra show the linear joint.
    is_broadband: bool = False
    is_transient: bool = False  # driven from rest, and simulated from there
    is_steady: bool = False  # tones whose steady harmonics are read, simultaneous or in sequence
    is_stepped: bool = False  # the tones come in sequence, each for a dwell time
    is_periodic: bool = False  # the excitation repeats, so that whole periods may be cut
    is_free: bool = False  # nothing drives the structure during the record
    is_prescribed: bool = False  # the displacement is prescribed: nothing moves freely
    is_curve: bool = False  # one line per frequency, not samples in time; lines may be masked
    # A controller holds each point of a steady motion, in any order; predicted is the force that
    # this takes and, if the controller `is_locked` to a phase, the frequency as well.
    is_controlled: bool = False
    is_locked: bool = False
    channels: tuple[str, ...] = ()  # roles that a test must have, if no property above implies them

    @property
    def is_driven(self) -> bool:
        """Whether a source drives the structure during the record."""
        if self.channels:
            return "input" in self.channels or "force" in self.channels
        return not (self.is_free or self.is_prescribed)

    @property
    def is_cycle_by_cycle(self) -> bool:
        """Whether tests of the kind are predicted from steady or slowly changing cycles."""
        return self.is_steady or self.is_curve or self.is_free or self.is_periodic

    @property
    def is_plain(self) -> bool:
        """Whether the kind has no property, so that only its observable defines its treatment."""
        return True not in self


KINDS: dict[str, Kind] = {}


def register(kind: Kind) -> None:
    """Register a kind of test for campaigns; replace any kind of equal name."""
    KINDS[kind.name] = kind


def kind_named(name: str) -> Kind:
    """Return the kind of test with the given name; raise a ConfigError if there is none."""
    if name not in KINDS:
        remedy = did_you_mean(name, KINDS) + f"Known: {', '.join(KINDS)}."
        raise ConfigError(f"There is no kind of test `{name}`.", remedy=remedy)
    return KINDS[name]


register(Kind("noise", "random noise, for long", is_broadband=True))
register(Kind("multisine", "lines of one period, over and over", is_broadband=True,
              is_periodic=True))  # fmt: skip
register(Kind("tones", "steady tones, all at once", is_steady=True))
register(Kind("stepped", "steady tones in turn", is_steady=True, is_stepped=True))
register(Kind("sweep", "a sweep from rest", is_transient=True))
register(Kind("decay", "a free decay", is_free=True))
register(Kind("frf", "a measured response curve", is_curve=True))
register(Kind("backbone", "points at a phase that is held", is_curve=True, is_controlled=True,
              is_locked=True))  # fmt: skip
register(Kind("curve", "points of a response that is held, through folds", is_curve=True,
              is_controlled=True))  # fmt: skip
register(Kind("loop", "force along a prescribed displacement", is_prescribed=True))
