"""Measurement records: the channels that a data-acquisition system saves, in SI units."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError, naming
from jbw.measurement.channels import Reals
from jbw.measurement.kinds import Kind, kind_named
from jbw.quantities import Motion
from jbw.units import FACTORS, decibels, factor_of, measured, plain, quantity_of, si_unit

RESPONSES: tuple[Motion, ...] = get_args(Motion)
INPUTS = ("input", "force")
BASE = "base"  # role of the acceleration of a moving base; also the name of this drive
SOURCES = (*INPUTS, BASE)  # roles of excitation channels in files
BY_UNIT = {"V": "voltage", "A": "current", "N": "force", "N/kg": "force", "N m": "force"}
# Quantities that a channel of each role may measure. A source is a voltage, a current, or a force
# per modal mass.
QUANTITIES: dict[str, tuple[str, ...]] = {
    "input": ("voltage", "force per mass", "current"),
    "force": ("force", "torque"),
    "displacement": ("displacement", "rotation"),
    "velocity": ("velocity", "angular velocity"),
    "acceleration": ("acceleration", "angular acceleration"),
    "restoring_force": ("force", "torque"),
    # acceleration of the clamp on a moving table; it is stored as a force per mass
    BASE: ("acceleration",),
    # acceleration of the point at which the shaker pushes; it determines the shaker's attachment
    "drive_point": ("acceleration",),
    "frequency": ("frequency",),  # axis of a measured FRF, which has no sampling frequency
    "phase": ("angle",),  # phase of the response relative to the force, in a measured FRF
    # name of a column that determines the sampling frequency, and is not kept as a channel
    "time": ("time",),
}
ROLES = tuple(QUANTITIES)
NUMBERED = re.compile(r" \(\d+\)")  # suffix that distinguishes tests of the same name
COUNTED = "none: samples of a loop without times are counted"
# Largest relative difference of two clocks: quartz is accurate to 1e-5 or better, a
# microcontroller's timer to 1e-4.
CLOCKS = 1e-4
# examples of sensitivities of usual sensors: accelerometers, vibrometers, displacement sensors,
# load cells
SENSITIVITIES = {
    "acceleration": "100 mV/g", "drive_point": "100 mV/g", BASE: "100 mV/g",
    "velocity": "200 mV/(mm/s)", "displacement": "1 V/mm",
    "force": "10 mV/N", "restoring_force": "10 mV/N",
}  # fmt: skip
LOAD_CELLS = ("exact", "offset", "drift")
OF = " / "  # separates an assembly's name from the name of its run


@dataclass(frozen=True)
class Record:
    """Channels that were sampled together once: one repeat of a test.

    Attributes:
        fs: Sampling frequency [Hz].
        channels: Role to samples in SI units; every channel has the same length. Roles:
            `input` (source voltage [V] or current [A], or force per unit mass [N/kg]), `force`
            [N], `displacement` [m], `velocity` [m/s], `acceleration` [m/s^2], `restoring_force`
            [N], `drive_point` [m/s^2] (acceleration where the shaker pushes); in a measured
            response curve, whose `fs` is NaN, also `frequency` [Hz] and `phase` [rad].
        units: SI unit of the samples of each role.
        name: Name in messages: the file, plus the row if a file contains several records.
        provenance: Path, sha256, reader, and the changes made on reading.
        drive: Stated drive of the test, which decides between `input` and `force`.

    Examples:
        Every channel has its role and its SI unit:

        >>> import jbw
        >>> import numpy as np
        >>> t = np.arange(1024) / 512.0
        >>> channels = {"force": np.sin(118.0 * t), "velocity": 0.1 * np.sin(118.0 * t)}
        >>> record = jbw.Record(512.0, channels, {"force": "N", "velocity": "m/s"}, name="tone")
        >>> print(record.name, record.num_samples, sorted(record.channels))
        tone 1024 ['force', 'velocity']
    """

    fs: float
    channels: Mapping[str, Reals]
    units: Mapping[str, str]
    name: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    drive: str = ""

    @property
    def num_samples(self) -> int:
        """The number of samples in each channel."""
        return len(next(iter(self.channels.values())))

    @property
    def valid(self) -> NDArray[np.bool_]:
        """A mask of the samples at which every channel is finite, shape (time,)."""
        return np.logical_and.reduce([np.isfinite(x) for x in self.channels.values()])

    @property
    def response(self) -> Motion:
        """The role of the response channel: displacement, velocity or acceleration."""
        return next(role for role in RESPONSES if role in self.channels)

    @property
    def source(self) -> str:
        """The role of the excitation: the input if there is one, unless the drive is a force."""
        if self.drive == "force" and "force" in self.channels:
            return "force"
        return next(role for role in INPUTS if role in self.channels)


@dataclass(frozen=True)
class Test:
    """A test: repeats of the same excitation, with its settings from the campaign file.

    Attributes:
        kind: Name of the test's kind, one of `jbw.measurement.kinds.KINDS`.
        records: The repeats, in the order of their files.
        name: A short name, unique in the campaign.
        level: Nominal level, in the unit of the controlled quantity: usually the input channel, or
            the response of a response-controlled curve.
        tones_hz: Frequencies present simultaneously (tones) or in sequence (stepped) [Hz].
        band_hz: Lowest and highest frequency to use [Hz], if given.
        dwell: Duration of each step of a stepped test [s].
        settle: Time at the start that is not compared: until tones and steps are steady, or until
            a joint has forgotten earlier motion [s].
        delay: Lag of the response channel behind the input channel [s].
        assembly: Name of the assembly of the joint; empty if there was only one.
        run: Name of the day or run; empty if there was only one.
        periods: Whole periods of the excitation in each record; 1 if not stated.
        residuals: Terms of modes outside the band: auto, none, upper, both or own.
        drive: What drives the structure, one of `DRIVES`; empty if it follows from the source.
        load_cell: Behaviour of the zero of a loop's load cell, one of `LOAD_CELLS`.
        point: Point of the response on a structure with several points; empty for the first.
        locked_phase: Phase of the displacement relative to the force, held by a controller [deg].
        amplitude_std: Relative standard deviation of the amplitudes of a controlled test.

    Examples:
        Two impacts are the repeats of one test, whose first 0.1 s are not compared:

        >>> import jbw
        >>> import numpy as np
        >>> t = np.arange(2048) / 512.0
        >>> decays = [{"velocity": v * np.exp(-t) * np.cos(118.0 * t)} for v in (0.1, 0.2)]
        >>> impacts = tuple(jbw.Record(512.0, decay, {"velocity": "m/s"}) for decay in decays)
        >>> test = jbw.Test("decay", impacts, name="hammer", settle=0.1)
        >>> print(test.name, len(test.records))
        hammer 2
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
    residuals: Literal["auto", "none", "upper", "both", "own"] = "auto"
    drive: str = ""
    point: str = ""
    load_cell: str = "exact"
    locked_phase: float = -90.0
    amplitude_std: float = 0.0

    def __post_init__(self) -> None:
        if any(record.drive != self.drive for record in self.records):
            with_drive = tuple(replace(record, drive=self.drive) for record in self.records)
            object.__setattr__(self, "records", with_drive)

    @property
    def traits(self) -> Kind:
        """The properties of the test's kind."""
        return kind_named(self.kind)

    @property
    def is_single_tone(self) -> bool:
        """Whether a single steady tone is played; single tones of one level form a curve."""
        return self.traits.is_steady and not self.traits.is_stepped and len(self.tones_hz) == 1

    @property
    def is_cyclic(self) -> bool:
        """Whether the records contain several whole periods of their excitation."""
        return self.traits.is_periodic and self.periods > 1


def belongs_to(label: str, name: str) -> bool:
    """Return whether a label is the name of a run or group, or such a name with an addition.

    `sweep 3` belongs to `sweep`; `sweep (2)` does not, because it is the second test of this name.
    """
    addition = label.removeprefix(name)
    is_longer = addition != label and addition.startswith(" ")
    return label == name or (is_longer and NUMBERED.match(addition) is None)


def share_clock(fs: float, other_fs: float) -> bool:
    """Return whether two rates [Hz] are equal within the accuracy of recorders' clocks.

    Records of one test may differ that much, and each keeps its own rate.
    """
    return fs == other_fs or abs(fs - other_fs) <= CLOCKS * fs


def is_sampled(record: Record) -> bool:
    """Return whether samples have times; response curves and loops without a clock have none."""
    return record.fs == record.fs and record.provenance.get("fs") != COUNTED


def drive_of(test: Test) -> str:
    """Return a test's drive, as stated or implied by its source; empty if motion is prescribed."""
    if test.drive or test.traits.is_prescribed or not test.records:
        return test.drive
    if test.traits.is_free:
        return "none"
    record = test.records[0]
    if not any(role in record.channels for role in INPUTS):
        return ""
    return BY_UNIT.get(record.units.get(record.source, ""), "voltage")


def run_of(test: Test) -> str:
    """Return the name of a test's run: its assembly and day if stated, else the test's name."""
    return OF.join(part for part in (test.assembly, test.run) if part) or test.name


def periods(test: Test) -> Test | None:
    """Return a multisine with its steady periods as repeats; None if its period is unknown.

    The `periods` of the returned test is the number of remaining periods of each record.
    """
    # At the start, `settle` seconds, rounded up to whole periods, are omitted.
    if test.periods < 2:
        return None
    records = [
        _cut(record, start, size)
        for record, size in (_steady(record, test) for record in test.records)
        for start in range(0, record.num_samples, size)
    ]
    left = len(records) // len(test.records)
    return replace(test, records=tuple(records), periods=left, settle=0.0)


def steady(test: Test) -> tuple[Test, int] | None:
    """Return a test without transient periods, and samples per period; None if not periodic."""
    if test.periods < 2:
        return None
    records, sizes = zip(*(_steady(record, test) for record in test.records), strict=True)
    return replace(test, records=records), sizes[-1]


def _steady(record: Record, test: Test) -> tuple[Record, int]:
    """Return a record without its transient periods, and the number of samples per period."""
    size, rest = divmod(record.num_samples, test.periods)
    if rest:
        raise DataError(
            f"Record `{record.name}` must hold {test.periods} whole periods, but its "
            f"{record.num_samples} samples are not a multiple of {test.periods}.",
            remedy="Correct `periods`, or cut the record with `span`.",
        )
    # A `settle` of whole periods may exceed them by round-off.
    skipped = int(np.ceil(test.settle * record.fs / size - 1e-6))
    if skipped >= test.periods:
        raise DataError(
            f"Key `settle` must leave a whole period of record `{record.name}`, but "
            f"{test.settle:g} s reach into the last of its {test.periods} periods of "
            f"{size / record.fs:.4g} s.",
            remedy="Shorten `settle`, or measure more periods.",
        )
    return _cut(record, skipped * size, (test.periods - skipped) * size), size


def _cut(record: Record, start: int, size: int) -> Record:
    channels = {role: x[start : start + size] for role, x in record.channels.items()}
    return replace(record, channels=channels)


def si_of(role: str, unit: str) -> tuple[float, str, str]:
    """Return a unit's factor to SI, its SI unit, and the source in the denominator of a ratio.

    For decibels they are those of the unit of the reference.
    """
    _, unit = decibels(unit) or (1.0, unit)
    above, _, below = (part.strip("()") for part in plain(unit).rpartition("/"))
    if role in RESPONSES and above in FACTORS[role]:
        for source in ("force", "input"):
            for quantity in QUANTITIES[source]:
                if below in FACTORS[quantity]:
                    return FACTORS[role][above] / FACTORS[quantity][below], si_unit(role), source
    if role in RESPONSES and (ratio := _per_source(role, unit)):
        return ratio
    with naming(f"Role `{role}`"):
        quantity = quantity_of(unit, QUANTITIES[role])
    return factor_of(unit, quantity), si_unit(quantity), ""


def sensitivity_of(role: str, written: str) -> tuple[float, str]:
    """Return a sensor's sensitivity in volts per unit of its channel's quantity, and that unit.

    `100 mV/g` is (0.1, `g`), `40 mV/(mm/s)` is (0.04, `mm/s`).

    Raises:
        ConfigError: The text is no number of volts per unit, or the unit is of another quantity.
    """
    number, _, units = written.strip().partition(" ")
    volts, _, below = units.partition("/")
    with suppress(ValueError, KeyError):
        value = float(number) * FACTORS["voltage"][plain(volts)]
        if np.isfinite(value) and value != 0 and below and not si_of(role, below)[2]:
            return value, plain(below)
    raise ConfigError(
        f"the sensitivity of role `{role}` must be volts per unit, but is {written!r}.",
        remedy=f'State the sensitivity as in the sensor\'s certificate: "{SENSITIVITIES[role]}".',
    )


def _per_source(role: str, unit: str) -> tuple[float, str, str] | None:
    """Return factor, unit and source for the unit of a response per force or per voltage.

    Examples are an accelerance in `1/kg` and a mobility in `m/(N s)`.
    """
    of_unit = measured(plain(unit))
    for moved in QUANTITIES[role] if of_unit else ():
        above = measured(si_unit(moved))
        for source in INPUTS:
            for quantity in QUANTITIES[source]:
                below = measured(si_unit(quantity))
                if quantity == "force per mass" or above is None or below is None:
                    continue
                if of_unit and of_unit[1] == tuple(np.subtract(above[1], below[1])):
                    return of_unit[0], si_unit(moved), source
    return None
