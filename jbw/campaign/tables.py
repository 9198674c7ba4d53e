"""The tables of a campaign file that describe measurements; each table is checked alone."""

from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple, Self

from pydantic import StrictBool, model_validator

from jbw.campaign import values
from jbw.campaign.document import FileTable, key
from jbw.measurement.kinds import KINDS
from jbw.measurement.kinds import Kind as Traits
from jbw.measurement.records import BASE, BY_UNIT, INPUTS, RESPONSES, SOURCES, Test, drive_of, si_of
from jbw.quantities import FED

# largest relative error of a clock [ppm]; a larger error would mean another sampling rate
MOST_PPM = 1e4
NAN = float("nan")  # default of a number that is not stated
Gain = float | Mapping[str, float] | None  # one value for all tests, or one value for each drive
WEIGHTLESS = {*FED, BASE}  # sources whose gain does not follow from a modal mass


class Instruments(NamedTuple):
    """Relative standard deviations of clock and calibration, as far as they are stated."""

    fs_std: float = 0.0
    # standard deviation of each channel's calibration, by role
    gain_std: Mapping[str, float] = MappingProxyType({})

    @property
    def is_stated(self) -> bool:
        """Whether any of the errors is stated."""
        return self.fs_std > 0 or bool(self.gain_std)


NOT_STATED = Instruments()


class Head(FileTable):
    """The [campaign] table of a campaign file."""

    name: values.Text = key("campaign", "a short name", "beam")
    gain: values.Positive | None = key(None, "force per modal mass for one volt [N/kg/V]", 15.0)
    modal_mass: values.Positive | None = key(
        None,
        "modal mass [kg], needed if the force is measured; state gain too if the source of other "
        "tests is a voltage or the base",
        1.93,
    )
    fs_std: values.Spread | None = key(
        None,
        "relative standard deviation of the recorder's clock, which no record shows; intervals "
        "include this error",
        5e-5,
    )
    gain_std: values.Spreads = key(
        dict,
        "role = relative standard deviation of that channel's calibration; intervals include this "
        "error",
        {"velocity": 0.01, "force": 0.005},
    )

    @property
    def instruments(self) -> "Instruments":
        """The stated errors of clock and calibration."""
        # The base's channel is stored as a force per mass, as `input`.
        by_role = {"input" if role == BASE else role: x for role, x in self.gain_std.items()}
        return Instruments(self.fs_std or 0.0, by_role)


class Assembly(FileTable):
    """The [assembly] table: torque and other facts for comparisons between assemblies."""

    name: values.Text = key("", "name of the specimen or assembly", "beam 3")
    torque: values.Positive | None = key(None, "tightening torque [N m]", 8.0)
    sequence: values.Index | None = key(
        None, "number of this tightening, counted over the life of the assembly", 2
    )
    temperature: values.Number | None = key(None, "temperature during the measurement [degC]", 21.5)


class TestSpec(FileTable):
    """A [[test]] table of a campaign file."""

    __test__: ClassVar[bool] = False  # not a pytest class

    kind: values.Kind = key(..., f"one of {', '.join(KINDS)}")
    files: values.Files = key(
        ...,
        (
            "file or pattern, or a list of them; or a table role = file, if each role has its "
            "own file"
        ),
    )
    channels: values.Channels = key(
        ...,
        "role = channel's name or path in the file: [3] counts from zero, (4) and {4} from one as "
        "in MATLAB, [:] takes all, and 'a - b' is a difference",
    )
    units: values.Units = key(dict, "role = unit")
    scale: values.Factors = key(dict, "role = calibration factor, applied before the unit")
    sensitivity: values.Sensitivities = key(
        dict,
        "role = sensitivity of the sensor in volts per unit, for a channel that the file states in "
        "volts; state it instead of a unit",
        {"acceleration": "100 mV/g"},
    )
    name: values.Text = key("", "a short name, unique")
    level: values.NonNegative = key(
        NAN, "nominal level, in the unit of the quantity that was held constant", 0.20
    )
    amplitudes: Literal["peak", "rms"] = key(
        "peak", "meaning of the amplitudes of kind frf, backbone or curve", "peak"
    )
    periods: values.Count = key(1, "whole periods of the excitation in a record", 4)
    fs: values.Sampling | None = key(
        None, "sampling frequency [Hz], or the path of a scalar in the file"
    )
    resample: values.Positive | None = key(
        None,
        "sampling frequency [Hz] to which channels of several rates, or of an uneven clock, "
        "are resampled by band-limited interpolation; the provenance states its error",
        100.0,
    )
    units_are: Literal["file", "mine"] = key(
        "file",
        "mine: the units of this table override different units in the file",
        "mine",
    )
    band: values.Span | None = key(None, "lowest and highest frequency to use [Hz]", [5.0, 40.0])
    residuals: Literal["auto", "none", "upper", "both", "own"] = key(
        "auto",
        "constant terms for modes outside the band; upper: for modes above the band, shared by all "
        "tests; both: for modes above and below the band, shared by all tests; own: as both, but "
        "for this test alone; auto: added if the fit shows modes outside the band",
        "upper",
    )
    drive: Literal["voltage", "current", "force", "base", "none"] | None = key(
        None,
        "source of the test. For a free decay: the drive of the shaker that stays attached; with "
        "voltage or current, the shaker moves with the structure. The default is none for a decay; "
        "for other tests it follows from the role or the unit of the input",
        "voltage",
    )
    relative_to_base: StrictBool = key(
        False, "the response was measured relative to the base that moves", True
    )
    tones: values.Numbers = key((), "frequencies present at once, or in turn if stepped [Hz]")
    dwell: values.Positive = key(NAN, "duration of each step of a stepped test [s]")
    settle: values.NonNegative = key(0.0, "time at the start that is not compared [s]")
    delay: values.Number = key(0.0, "lag of the response channel behind the input [s]", 0.0)
    clock_ppm: values.Number = key(
        0.0,
        "error of the response's clock against that of the drive [ppm], positive if the "
        "response's clock runs fast; the response is resampled to the clock of the drive",
        80.0,
    )
    assembly: values.Text = key("", "name of the assembly of the joint", "first")
    run: values.Text = key("", "name of the day or run", "monday")
    repeats: Literal["files", "rows"] = key(
        "files", "files: each file is a repeat; rows: each row is a repeat"
    )
    exclude: values.Excluded = key(
        (), "repeats to drop: numbers counted from zero, or file names", [2, "bad_*.h5"]
    )
    remove_mean: StrictBool = key(
        False, "remove the mean of input and response, to remove offsets", True
    )
    window_s: values.Positive | None = key(
        None,
        "time constant [s] of the exponential window that the analyser applied to a decay; "
        "this window is removed, with time counted from the record's first sample",
        2.0,
    )
    lines_hz: values.Frequencies = key(
        (),
        "frequencies [Hz] of steady lines in a decay, such as hum or a machine nearby, which "
        "are fitted to the last half of the decay and removed",
        [50.0],
    )
    conjugate: StrictBool = key(
        False,
        "conjugate the phase of kind frf, backbone or curve, for a file that uses exp(-j omega t)",
        True,
    )
    locked_phase: values.Lag = key(
        -90.0,
        "phase of the displacement relative to the force at which a controller held the "
        "points of kind backbone [deg]; if the file contains a measured phase, that is used",
        -60.0,
    )
    phase_tolerance: values.Positive = key(
        5.0,
        "deviation of a measured phase from locked_phase above which a point is reported [deg]",
        8.0,
    )
    amplitude_std: values.Spread | None = key(
        None,
        "relative standard deviation of the amplitudes of kind backbone or curve, propagated "
        "to frequency, phase and force",
        0.002,
    )
    jumps: Literal["doubt", "keep"] = key(
        "doubt",
        (
            "whether neighbouring points of kind backbone or curve are reported if their "
            "amplitude jumps"
        ),
        "keep",
    )
    load_cell: Literal["exact", "offset", "drift"] = key(
        "exact",
        "zero error of the load cell in tests of kind loop, fitted together with the joint: an "
        "offset, or an offset and a drift proportional to time",
        "drift",
    )
    gaps: Literal["refuse", "mask"] = key(
        "refuse",
        "treatment of samples that are NaN; refuse: the record is rejected; mask: points with NaN "
        "are omitted, in tests of kind frf, backbone or curve only",
        "refuse",
    )
    span: values.Span | None = key(None, "first and last second to read", [0.0, 8.0])
    point: values.Text = key(
        "", "point of [structure] where the response is measured; by default the first", "wing"
    )
    points: values.Named = key(
        dict,
        "additional channels of the response, in the unit of the response; each key is the point "
        "of [structure] where the channel is measured",
        {"wing": "wing.acceleration"},
    )

    @property
    def traits(self) -> Traits:
        """The properties of the test's kind."""
        return KINDS[self.kind]

    @property
    def is_timed(self) -> bool:
        """Whether the samples need times; force loops do not, because laws ignore the rate."""
        return not self.traits.is_prescribed

    @property
    def driven_by(self) -> str:
        """The drive that the campaign file states, in the words of `drive_of`."""
        if self.drive or self.traits.is_prescribed:
            return self.drive or ""
        if self.traits.is_free:
            return "none"
        if BASE in self.channels:
            return BASE
        if "input" in self.channels:
            return BY_UNIT.get(si_of("input", self.units.get("input", "V"))[1], "voltage")
        return "force"

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        if errors := [*_needs(self), *_contradictions(self)]:
            raise ValueError("\n".join(errors))
        return self


def _needs(test: TestSpec) -> Iterator[str]:
    """Yield an error for each key or channel that the test's kind needs but its table lacks."""
    roles, traits = set(test.channels), test.traits
    per_role = ("units", "scale", "sensitivity")
    for table, names in ((table, getattr(test, table)) for table in per_role):
        for role in names:
            if role not in roles:
                yield f"{table}: names role `{role}`, which `channels` does not name."
    if roles.isdisjoint(RESPONSES):
        yield f"channels: needs a response, one of {', '.join(sorted(RESPONSES))}."
    ratios = [role for role, unit in test.units.items() if si_of(role, unit)[2]]
    if ratios and (not traits.is_curve or traits.is_controlled):
        unit = test.units[ratios[0]]
        linear = [k for k in KINDS.values() if k.is_curve and not k.is_controlled]
        named = ", ".join(f"`{kind.name}`" for kind in linear)
        yield f"units: `{unit}` of `{ratios[0]}` is for kind {named} only."
    # A backbone needs no source, because its frequency already determines the stiffness.
    needs_source = traits.is_driven and not traits.is_locked
    if needs_source and roles.isdisjoint(SOURCES) and not ratios:
        yield f"channels: kind `{test.kind}` needs `input`, `force` or `base`."
    yield from _of_base(test, roles)
    if test.drive in FED and traits.is_driven and "input" not in roles:
        yield f"drive: `{test.drive}` needs the channel `input`, which is fed to the shaker."
    if test.drive == "none" and traits.is_driven:
        yield f"drive: `none` is for free decays, but kind `{test.kind}` is driven."
    if lacking := [f"`{role}`" for role in traits.channels if role not in roles]:
        yield f"channels: kind `{test.kind}` needs {' and '.join(lacking)}."
    if "drive_point" in roles and not set(INPUTS) <= roles:
        lacking = " and ".join(f"`{role}`" for role in INPUTS if role not in roles)
        yield (
            f"channels: add {lacking}, which the identification of the shaker at `drive_point` "
            "needs."
        )
    forced = "displacement" in roles and roles & {"restoring_force", "force"}
    if traits.is_prescribed and not forced:
        yield f"channels: kind `{test.kind}` needs `displacement` and `restoring_force`."
    if traits.is_curve and "frequency" not in roles:
        phase_needed = "" if traits.is_controlled else ", and `phase` if amplitudes are real"
        needed = f"`frequency`{phase_needed}"
        yield f"channels: kind `{test.kind}` needs {needed}."
    if traits.is_steady and not test.tones:
        yield f"tones: missing; kind `{test.kind}` needs the frequencies [Hz]."
    if traits.is_stepped and not test.dwell > 0:
        yield "dwell: missing; kind `stepped` needs the duration of each step [s]."
    if test.settle >= test.dwell:  # An unstated `dwell` is NaN, so that this comparison is False.
        yield f"settle: must be shorter than dwell ({test.dwell:g} s), but is {test.settle:g}."


def _contradictions(test: TestSpec) -> Iterator[str]:
    """Yield an error for each stated key that does not apply to the test's kind or channels."""
    curves = ", ".join(f"`{kind.name}`" for kind in KINDS.values() if kind.is_curve)
    is_curve, roles = test.traits.is_curve, set(test.channels)
    if not is_curve and (roles - set(test.traits.channels)) & {"frequency", "phase"}:
        yield f"channels: `frequency` and `phase` belong to kind {curves}."
    if not is_curve and test.amplitudes != "peak":
        yield (
            f"amplitudes: for kind {curves} only; the samples of a record in time are neither peak "
            "nor rms values."
        )
    if is_curve and test.remove_mean:
        yield f"remove_mean: applies only to records in time, not to tests of kind {curves}."
    if test.conjugate and not is_curve:
        yield f"conjugate: for kind {curves} only; the samples of a record in time have no phase."
    yield from _of_controlled_tests(test)
    free = ", ".join(f"`{kind.name}`" for kind in KINDS.values() if kind.is_free)
    if test.window_s and not test.traits.is_free:
        yield (
            f"window_s: for kind {free} only; records of other kinds have no window that begins at "
            "the start of the record."
        )
    timed = test.traits.is_driven and not is_curve
    if test.clock_ppm and not timed:
        yield (
            "clock_ppm: for records in time of a driven test only; records of other tests have no "
            "second clock."
        )
    if abs(test.clock_ppm) > MOST_PPM:
        yield f"clock_ppm: must be at most {MOST_PPM:g} to either side, but is {test.clock_ppm:g}."
    if test.lines_hz and not test.traits.is_free:
        yield (
            f"lines_hz: for kind {free} only; in tests of other kinds the drive itself is a "
            "steady line."
        )
    prescribed = ", ".join(f"`{kind.name}`" for kind in KINDS.values() if kind.is_prescribed)
    if test.load_cell != "exact" and not test.traits.is_prescribed:
        yield (
            f"load_cell: for kind {prescribed} only, where the force is measured; leave "
            "`load_cell` out of this test."
        )
    # A transform spreads one bad sample over all frequencies, and a simulation needs the whole
    # input; only a curve may therefore omit points.
    if not is_curve and test.gaps == "mask":
        yield (
            f"gaps: kind `{test.kind}` needs every sample; samples can be masked only in kind "
            f"{curves}; keep a part without gaps by `span`, or leave the record out by `exclude`."
        )
    if test.resample and is_curve:
        yield f"resample: applies only to records in time, not to tests of kind {curves}."
    if test.resample and test.band and 2 * test.band[1] > test.resample:
        yield (
            f"resample: must be at least twice the end of band, {test.band[1]:g} Hz, but is "
            f"{test.resample:g}; resampling removes all frequencies above half of `resample`."
        )
    if test.point in test.points:
        yield f"points: must differ from `{test.point}`, which is the test's own `point`."
    if isinstance(test.files, Mapping) and set(test.files) != roles:
        yield (
            f"files: as a table it must name a file for each role ({', '.join(sorted(roles))}), "
            f"but names {', '.join(sorted(test.files))}."
        )


def _of_base(test: TestSpec, roles: set[str]) -> Iterator[str]:
    """Yield the errors of a test on a moving base: missing channels and forbidden keys."""
    if BASE not in roles:
        if test.drive == BASE:
            yield "drive: `base` needs the channel `base`, the acceleration of the base."
        if test.relative_to_base:
            yield "relative_to_base: for tests with the channel `base` only."
        return
    traits = test.traits
    if not traits.is_driven or traits.is_curve or traits.is_prescribed:
        kinds = [k.name for k in KINDS.values() if k.is_driven and not k.is_curve]
        yield f"channels: `base` is allowed only in records in time of kind {', '.join(kinds)}."
    if test.drive not in (None, BASE) or not roles.isdisjoint(INPUTS):
        other = next((role for role in INPUTS if role in roles), f"drive = {test.drive!r}")
        yield (
            f"channels: both `base` and `{other}` state the source of the test: leave out one of "
            "the two."
        )
    if not test.relative_to_base and "acceleration" not in roles:
        yield (
            "channels: with `base` the response must be `acceleration`, unless it was measured "
            "relative to the base. Put under [[test]]: `relative_to_base = true`."
        )
    if test.delay:
        yield "delay: not allowed with `base`, because the response must not lag behind the base."


def _of_controlled_tests(test: TestSpec) -> Iterator[str]:
    """Yield an error for each key of controlled tests that another kind of test states."""
    locked = ", ".join(f"`{kind.name}`" for kind in KINDS.values() if kind.is_locked)
    controlled = ", ".join(f"`{kind.name}`" for kind in KINDS.values() if kind.is_controlled)
    is_beside = test.traits.is_locked and test.locked_phase != -90
    if is_beside and not set(INPUTS) & set(test.channels):
        yield (
            f"channels: kind `{test.kind}` at {test.locked_phase:g} degrees needs `force`, "
            "because away from -90 degrees its frequency depends on the damping."
        )
    for name in ("locked_phase", "phase_tolerance"):
        if name in test.model_fields_set and not test.traits.is_locked:
            yield f"{name}: for kind {locked} only; in tests of other kinds no phase is held."
    for name in ("amplitude_std", "jumps"):
        if name in test.model_fields_set and not test.traits.is_controlled:
            yield f"{name}: for kind {controlled} only; other kinds have no controlled points."


def force_per_unit(campaign: Any) -> Gain:  # a checked campaign, with or without records
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
    """Return whether a force drives some tests, and a voltage, current or base drives others."""
    return "force" in drives and not WEIGHTLESS.isdisjoint(drives)
