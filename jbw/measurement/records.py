"""Measurement records: what a data-acquisition system leaves behind, in SI units."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jbw.measurement.kinds import Kind, kind_named

RESPONSES = ("displacement", "velocity", "acceleration")
INPUTS = ("input", "force")


@dataclass(frozen=True)
class Record:
    """Channels sampled together, once: one repeat of one test.

    Attributes:
        fs: Sampling frequency [Hz].
        channels: Role to samples in SI units; every channel has the same length. Roles:
            `input` (source voltage [V], or per unit mass [N/kg]), `force` [N], `displacement` [m],
            `velocity` [m/s], `acceleration` [m/s^2], `restoring_force` [N]; in a measured response
            curve, whose `fs` is NaN, also `frequency` [Hz] and `phase` [rad].
        units: Role to the SI unit of its samples.
        name: What to call it in messages: the file, and the row where a file holds several.
        provenance: Path, sha256, reader and what was converted or snapped at the door.
    """

    fs: float
    channels: Mapping[str, NDArray[np.float64]]
    units: Mapping[str, str]
    name: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def num_samples(self) -> int:
        """Samples in each channel."""
        return len(next(iter(self.channels.values())))

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Samples at which every channel is finite, of shape (time,): the record's mask."""
        return np.logical_and.reduce([np.isfinite(x) for x in self.channels.values()])

    @property
    def response(self) -> str:
        """The role of the response channel: displacement, velocity or acceleration."""
        return next(role for role in RESPONSES if role in self.channels)

    @property
    def source(self) -> str:
        """The role of the excitation channel: input or force."""
        return next(role for role in INPUTS if role in self.channels)


@dataclass(frozen=True)
class Test:
    """One test: the same excitation repeated, with what the campaign file says of it.

    Attributes:
        kind: Name of its kind, one of `jbw.measurement.kinds.KINDS`.
        records: The repeats, in the order of their files.
        name: A short name, unique in the campaign.
        level: Nominal level, in the unit of what the rig held: the input channel as a rule, the
            response of a response-controlled curve.
        tones_hz: Frequencies present at once (tones), or in turn (stepped) [Hz].
        band_hz: Lowest and highest frequency to use [Hz], when given.
        dwell: Duration of each step of a stepped test [s].
        settle: Time to discard before the steady state of tones and steps [s].
        delay: Lag of the response channel behind the input channel [s].
        assembly: Which assembly of the joint; empty when there was one.
        run: Which day or run; empty when there was one.
        periods: Whole periods of the excitation in each record; 1 when none were said.
    """

    __test__ = False  # not a pytest class

    kind: str
    records: tuple[Record, ...]
    name: str = ""
    level: float = float("nan")
    tones_hz: tuple[float, ...] = ()
    band_hz: tuple[float, float] | None = None
    dwell: float = float("nan")
    settle: float = 0.0
    delay: float = 0.0
    assembly: str = ""
    run: str = ""
    periods: int = 1

    @property
    def traits(self) -> Kind:
        """What a test of its kind is."""
        return kind_named(self.kind)

    @property
    def is_single_tone(self) -> bool:
        """Whether one steady tone is played, whose tests of a level make a curve together."""
        steady = self.traits.is_steady and not self.traits.is_stepped
        return steady and len(self.tones_hz) == 1

    @property
    def is_cyclic(self) -> bool:
        """Whether the records hold several whole periods of their excitation."""
        return self.traits.is_periodic and self.periods > 1
