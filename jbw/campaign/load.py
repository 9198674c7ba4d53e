"""Loading of a campaign file with its tests and their records."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from math import isnan
from pathlib import Path
from textwrap import shorten

from jbw.campaign.check import beside_stated, findings, gain_read, has_one_mode, unread
from jbw.campaign.files import repeats_of
from jbw.campaign.joints import SeveralJoints, refuse_unknown_shapes, several_joints
from jbw.campaign.schema import CampaignSpec, read_spec
from jbw.campaign.settings import Identify, Structured, laws_of
from jbw.campaign.tables import (
    NOT_STATED,
    Assembly,
    Gain,
    Instruments,
    TestSpec,
    force_per_unit,
    gain_of,
)
from jbw.campaign.together import held_twice, source_of
from jbw.errors import DataError, JbwError
from jbw.measurement.faults.fault import Fault, gathered
from jbw.measurement.faults.unlike_gains import unlike_gains
from jbw.measurement.files.read import report
from jbw.measurement.kinds import kind_named
from jbw.measurement.records import BASE, Record, Test
from jbw.memory import NO_RECORDS, HeldRecords, require_memory
from jbw.quantities import DEFAULT_LAWS

# keys of a [[test]] table that have the same name in `Test`
SAME = (
    "name",
    "level",
    "dwell",
    "settle",
    "delay",
    "assembly",
    "run",
    "periods",
    "residuals",
    "point",
    "load_cell",
    "locked_phase",
)


# largest number of tests, and of characters per test, in a notebook cell
SHOWN, LINE = 10, 100


@dataclass(frozen=True, repr=False)
class Campaign:
    """A campaign: everything that was measured on one joint, in SI units.

    Examples:
        A campaign is built in memory from one impact and a known modal mass:

        >>> import jbw
        >>> import numpy as np
        >>> t = np.arange(2048) / 512.0
        >>> decay = {"velocity": 0.1 * np.exp(-t) * np.cos(118.0 * t)}
        >>> impact = jbw.Record(512.0, decay, {"velocity": "m/s"})
        >>> test = jbw.Test("decay", (impact,), name="hammer")
        >>> campaign = jbw.Campaign("beam", None, (test,), modal_mass=1.9)
        >>> print(campaign.name, campaign.laws, [test.name for test in campaign.tests])
        beam ('bouc_wen',) ['hammer']
    """

    name: str
    folder: Path | None  # folder of the campaign file; None for a campaign in memory
    tests: tuple[Test, ...]  # tests in the order of the file
    gain: float | None = None  # force per modal mass for one volt [N/kg/V], if known
    modal_mass: float | None = None  # modal mass [kg], if known
    # settings of the identification; a mapping of their keys is also accepted
    settings: Identify = field(default_factory=Identify)
    path: Path = Path()  # path of the campaign file
    laws: tuple[str, ...] = DEFAULT_LAWS  # laws that act in parallel across the joint
    # torque and other facts about the assembly, if stated
    assembly: Assembly = field(default_factory=Assembly)
    # [structure] of the campaign file, as an object or as a mapping of its keys; None if only one
    # mode moves the joint
    structure: Structured | None = None
    instruments: Instruments = NOT_STATED  # known errors of clock and calibration
    joints: SeveralJoints | None = None  # joints, if the structure has several; None for one joint
    # whether laws are stated; if not, measured frequency and damping may suggest other laws
    states_laws: bool = True

    def __repr__(self) -> str:
        lines = [f"  {_line(test)}" for test in self.tests[:SHOWN]]
        return "\n".join([self._head(), *lines, *self._more()])

    def _repr_html_(self) -> str:
        items = [shorten(_line(test), LINE) for test in self.tests[:SHOWN]] + self._more()
        rows = "".join(f"<li>{escape(item)}</li>" for item in items)
        return f"<p>{escape(shorten(self._head(), LINE))}</p><ul>{rows}</ul>"

    def _head(self) -> str:
        laws = ", ".join(self.laws) or "no joint"
        return f"Campaign {self.name}: {len(self.tests)} tests, {laws}"

    def _more(self) -> list[str]:
        num_more = len(self.tests) - SHOWN
        return [f"and {num_more} more"] if num_more > 0 else []

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", Identify.of(self.settings))
        object.__setattr__(self, "structure", Structured.of(self.structure))
        object.__setattr__(self, "laws", laws_of(self.laws, self.settings.prior))


def _line(test: Test) -> str:
    """Return a one-line description of a test: name, kind, number of records, level."""
    level = "" if isnan(test.level) else f", level {test.level:g}"
    return f"{test.name}: {test.kind}, {len(test.records)} records{level}"


def load_campaign(path: str | Path, *, allow_outside: bool = False) -> Campaign:
    """Load a campaign file with all of its records, and check both.

    Args:
        path: The TOML file.
        allow_outside: Whether `files` may point outside the campaign file's folder.

    Raises:
        ConfigError: The campaign file violates the schema; all errors are reported at once.
        DataError: A file or channel is missing, damaged, or fails a check.

    Examples:
        Records and campaign file are those of the virtual rig:

        >>> import jbw; jbw.enable_x64()
        >>> path = jbw.rig.write(jbw.rig.measure(tests=["sweep_0p20V"], repeats=2), "beam")
        >>> campaign = jbw.load_campaign(path)
        >>> print(campaign.name, [(test.name, len(test.records)) for test in campaign.tests])
        virtual rig, laboratory [('sweep_0p20V', 2)]
    """
    path = Path(path)
    spec = read_spec(path)
    refuse_unknown_shapes(spec)
    for fault in unread(spec):
        warnings.warn(f"{path.name}, [identify]: {fault.what} {fault.remedy}", stacklevel=2)
    folder, per_unit = path.resolve().parent, force_per_unit(spec)
    joints = several_joints(spec, folder, allow_outside=allow_outside)
    laws = spec.laws if joints is None else joints.laws
    of_one_mode, tests, held = has_one_mode(spec), list[Test](), NO_RECORDS
    for table in spec.tests:
        held = held.begun(_followed(table, spec, joints))
        test = load_test(
            table, folder, per_unit=per_unit, laws=laws, of_one_mode=of_one_mode,
            allow_outside=allow_outside, held=held,
        )  # fmt: skip
        held = _beside(held, *test.records)
        tests.append(test)
    sources = [
        source_of(record, named)
        for named, test in zip(spec.tests, tests, strict=True)
        for record in test.records
    ]
    by_name = {test.name: test for test in spec.tests}
    for name, repeated in held_twice(sources):
        fault = beside_stated(repeated, by_name[name])
        if fault.severity == "error":
            raise DataError(fault.what, why=fault.why, remedy=fault.remedy)
        warnings.warn(f"Test {name}: {fault.what} {fault.remedy}", stacklevel=2)
    facts = (spec.gain, spec.modal_mass, spec.settings, path, laws, spec.assembly)
    structure_facts = (spec.structure, spec.instruments, joints, spec.states_laws)
    return Campaign(spec.name, folder, tuple(tests), *facts, *structure_facts)


def with_laws(campaign: Campaign, laws: Sequence[str] | None) -> Campaign:
    """Return a campaign with the laws chosen in its identification, if it states none itself."""
    if campaign.states_laws or laws is None:
        return campaign
    return replace(campaign, laws=tuple(laws))


def load_with_doubts(
    path: Path, *, allow_outside: bool = False
) -> tuple[Campaign, list[warnings.WarningMessage]]:
    """Load a campaign; return it with the warnings on doubtful records, instead of issuing them."""
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        campaign = load_campaign(path, allow_outside=allow_outside)
    return campaign, doubts


def load_test(
    test: TestSpec,
    folder: Path,
    *,
    per_unit: Gain,
    laws: Sequence[str] = (),
    of_one_mode: bool = True,
    allow_outside: bool = False,
    held: HeldRecords = NO_RECORDS,
) -> Test:
    """Load the records of a test; raise an error or issue warnings if they have faults.

    Args:
        test: Table of the test.
        folder: Folder of the campaign file.
        per_unit: Force per modal mass for one unit of the input, by drive; None if not stated.
        laws: Names of the laws of the joint.
        of_one_mode: Whether the campaign says that records show only one mode.
        allow_outside: Whether `files` may point outside the folder.
        held: Sizes of the records of earlier tests, which also need memory.
    """

    def admit(samples: int, channels: int, name: str) -> None:
        require_memory(held.beside(samples, channels), name)

    loaded: list[Record] = []
    gain = gain_of(per_unit, test.driven_by)
    doubts: list[tuple[str, Fault]] = []
    gains: list[tuple[str, float]] = []
    for item in repeats_of(test, folder, allow_outside=allow_outside, admit=admit):
        if isinstance(item, JbwError):
            raise item
        held = _beside(held, item)
        require_memory(held, item.name)
        faults = findings(item, test, loaded[:1], per_unit=gain, laws=laws, of_one_mode=of_one_mode)
        errors = [fault for fault in faults if fault.severity == "error"]
        report(item, [beside_stated(fault, test) for fault in errors])
        doubts += [(item.name, fault) for fault in faults]
        gains += gain_read(item, test) if of_one_mode else []
        loaded.append(item)
    if gains:
        doubts += unlike_gains(gains, loaded[0].response, loaded[0].source)
    for gathered_fault in gathered(doubts, len(loaded)):
        fault = beside_stated(gathered_fault, test)
        warning = f"Test {test.name}, channel `{fault.channel}`: {fault.what} {fault.remedy}"
        warnings.warn(warning.rstrip(), stacklevel=3)
    facts = {name: getattr(test, name) for name in SAME}
    facts["drive"] = BASE if test.driven_by == BASE else test.drive or ""
    facts["amplitude_std"] = test.amplitude_std or 0.0
    return Test(test.kind, tuple(loaded), tones_hz=test.tones, band_hz=test.band, **facts)


def _followed(test: TestSpec, spec: CampaignSpec, joints: SeveralJoints | None) -> int:
    """Return the number of modes and joints that a fit simulates at every sample of a test."""
    if not kind_named(test.kind).is_transient:
        return 0
    if joints is not None:
        return sum(joints.model.H.shape)
    return 1 + (1 if spec.structure is None else len(spec.structure.modes))


def _beside(held: HeldRecords, *records: Record) -> HeldRecords:
    for record in records:
        held = held.beside(record.num_samples, len(record.channels))
    return held
