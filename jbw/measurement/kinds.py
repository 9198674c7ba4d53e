"""The kinds of test and their properties.

Code asks a test for a property of its kind, `test.traits.is_steady`, and never for its name. A new
kind needs one `register` here and one observable.
"""

from typing import NamedTuple

from jbw.errors import ConfigError, did_you_mean


class Kind(NamedTuple):
    """A kind of test and its properties."""

    name: str  # name in a campaign file
    meaning: str  # how the structure is excited
    # whether all frequencies are excited at once for a long time; averaged spectra then show the
    # linear behaviour
    is_broadband: bool = False
    # whether the structure is driven from rest, so that the whole record can be simulated
    is_transient: bool = False
    # whether the test measures steady harmonics of tones, applied together or one after another
    is_steady: bool = False
    is_stepped: bool = False  # whether the tones follow each other, each for a dwell time
    # whether the excitation repeats, so that whole periods can be cut out
    is_periodic: bool = False
    is_free: bool = False  # whether nothing drives the structure during the record
    # whether the displacement is prescribed, so that nothing moves freely
    is_prescribed: bool = False
    # whether the record has one line per frequency instead of samples in time; lines may be masked
    is_curve: bool = False
    # Whether a controller holds each point of a steady motion, in any order. The model predicts the
    # force that this takes. If the controller `is_locked` to a phase, the model also predicts the
    # frequency.
    is_controlled: bool = False
    is_locked: bool = False
    # roles that a test must have, if no property above determines them
    channels: tuple[str, ...] = ()

    @property
    def is_driven(self) -> bool:
        """Whether a source drives the structure during the record."""
        if self.channels:
            return "input" in self.channels or "force" in self.channels
        return not (self.is_free or self.is_prescribed)

    @property
    def is_cycle_by_cycle(self) -> bool:
        """Whether tests of this kind are predicted from steady or slowly changing cycles."""
        return self.is_steady or self.is_curve or self.is_free or self.is_periodic

    @property
    def is_plain(self) -> bool:
        """Whether the kind has no trait; its tests are then treated as their observable defines."""
        return True not in self


KINDS: dict[str, Kind] = {}


def register(kind: Kind) -> None:
    """Register a kind of test for use in campaigns; replace a kind of the same name."""
    KINDS[kind.name] = kind


def kind_named(name: str) -> Kind:
    """Return the kind of test with the given name; raise a ConfigError if there is none."""
    if name not in KINDS:
        remedy = did_you_mean(name, KINDS) + f"Known: {', '.join(KINDS)}."
        raise ConfigError(f"There is no kind of test `{name}`.", remedy=remedy)
    return KINDS[name]


register(Kind("noise", "random noise, for long", is_broadband=True))
register(Kind("multisine", "lines of one period, repeated", is_broadband=True,
              is_periodic=True))  # fmt: skip
register(Kind("tones", "steady tones, all at once", is_steady=True))
register(Kind("stepped", "steady tones in turn", is_steady=True, is_stepped=True))
register(Kind("sweep", "a sweep from rest", is_transient=True))
register(Kind("decay", "a free decay", is_free=True))
register(Kind("frf", "a measured response curve", is_curve=True))
register(Kind("backbone", "points at a controlled phase", is_curve=True, is_controlled=True,
              is_locked=True))  # fmt: skip
register(Kind("curve", "points at controlled responses, also beyond folds", is_curve=True,
              is_controlled=True))  # fmt: skip
register(Kind("loop", "force along a prescribed displacement", is_prescribed=True))
