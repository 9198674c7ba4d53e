"""The campaign file as typed tables; its validation reports all errors at once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from jbw.campaign.assembled import (
    AssembledStructure,
    JointTable,
    joint_errors,
    laws_by_joint,
    laws_of_joint,
)
from jbw.campaign.document import (
    CAMPAIGN,
    FileTable,
    checked,
    document_of,
    key,
    refuse,
    text_of,
    unknown_tables,
)
from jbw.campaign.settings import (
    MOST_MODES,
    Identify,
    JointLaws,
    Structured,
    law_errors,
    laws_of,
    structure_errors,
)
from jbw.campaign.tables import NOT_STATED, Assembly, Head, Instruments, TestSpec, differ
from jbw.campaign.together import among, at_every_point, named, of_others, on_a_base
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import campaign_faults


class CampaignFile(FileTable):
    """The whole campaign file in the form of its JSON Schema, which editors use."""

    model_config = ConfigDict(title="Campaign file of jbw")

    campaign: Head = key(Head, "what was measured")
    assembly: Assembly = key(
        Assembly, "assembly and its torque, which `jbw collect` writes into a fleet"
    )
    joint: JointLaws | list[JointTable] = key(
        JointLaws, "laws of the joint; one [[joint]] table per joint if a structure has several"
    )
    structure: Structured | AssembledStructure | None = key(
        None, "the structure: several modes that share the joint, or a model's matrices with joints"
    )
    test: Annotated[list[TestSpec], Field(min_length=1)] = key(..., "one table per test")
    identify: Identify = key(Identify, "tests to fit and to hold out, and how to sample")


@dataclass(frozen=True)
class CampaignSpec:
    """A validated campaign file, before any measurement file is opened."""

    name: str
    tests: tuple[TestSpec, ...]  # the tests, each with a name
    gain: float | None = None
    modal_mass: float | None = None
    settings: Identify = field(default_factory=Identify)
    laws: tuple[str, ...] = DEFAULT_LAWS
    assembly: Assembly = field(default_factory=Assembly)
    structure: Structured | None = None
    instruments: Instruments = NOT_STATED  # known errors of clock and calibration
    assembled: AssembledStructure | None = None  # set if the structure is given by matrices
    joints: tuple[JointTable, ...] = ()  # [[joint]] tables of the structure, if any
    states_laws: bool = True  # whether laws are stated, by name or by a prior on a parameter


def read_spec(path: Path) -> CampaignSpec:
    """Read and validate a campaign file; raise a ConfigError that lists all of its errors."""
    return parse(text_of(path, *CAMPAIGN), path.name)


def parse(source: str, file: str = "campaign.toml") -> CampaignSpec:
    """Validate the text of a campaign file and report all errors; errors name it `file`."""
    document = document_of(source, file)
    errors = unknown_tables(document, CampaignFile.model_fields)
    head = checked(Head, document.get("campaign", {}), "[campaign]", errors) or Head()
    assembly = checked(Assembly, document.get("assembly", {}), "[assembly]", errors) or Assembly()
    single = document.get("joint")
    joints = _joints(single, errors)
    stated_joint = {} if isinstance(single, list) else single or {}
    joint = checked(JointLaws, stated_joint, "[joint]", errors) or JointLaws()
    structure, assembled = _structures(document.get("structure"), errors)
    tables = document.get("test", [])
    if not isinstance(tables, list) or not tables:
        errors.append(campaign_faults.NO_TESTS)
        tables = []
    checked_tables = [
        checked(TestSpec, table, f"[[test]] {i + 1}", errors) for i, table in enumerate(tables)
    ]
    tests = [test for test in checked_tables if test is not None]
    settings = checked(Identify, document.get("identify", {}), "[identify]", errors) or Identify()
    both = head.gain is not None and head.modal_mass is not None
    if both and not differ({test.driven_by for test in tests}):
        errors.append(campaign_faults.GAIN_OR_MASS)
    if len(tests) == len(tables):
        errors += [*among(tests, settings), *of_others(tests, assembly)]
        several = structure is not None or assembled is not None
        errors += on_a_base(tests, is_weighed=head.modal_mass is not None, several=several)
        errors += structure_errors(structure, tests, () if assembled is None else assembled.points)
        roles = {role for test in tests for role in test.channels}
        errors += [campaign_faults.no_role(role) for role in head.gain_std if role not in roles]
    # A prior on a parameter of any other law is an error, because stated laws are complete.
    stated = "laws" in joint.model_fields_set
    laws = joint.laws if stated else laws_of(joint.laws, settings.prior)
    num_modes = 1 if structure is None else len(structure.modes)
    of_joints = assembled is not None and joints and settings.prior
    errors += law_errors(
        laws_by_joint(joints) if of_joints else laws,
        settings.prior,
        MOST_MODES if of_joints else num_modes,
        [test.kind for test in tests],
    )
    if assembled is not None and not joints:
        errors.append(campaign_faults.NO_JOINTS)
    errors += joint_errors(joints, assembled, num_modes)
    for table in joints:
        errors += [
            line.replace("[joint]", f"[[joint]] `{table.name}`", 1)
            for line in law_errors(laws_of_joint(table, joints), {})
        ]
    refuse(file, errors)
    tests = [*named(tests)]
    held = (f"{t.name} at {p}" for t in tests if t.name in settings.hold_out for p in t.points)
    settings = settings.model_copy(update={"hold_out": (*settings.hold_out, *held)})
    facts = (head.gain, head.modal_mass, settings, laws, assembly, structure, head.instruments)
    several = assembled, tuple(joints)
    states_laws = stated or bool(joints) or bool(settings.prior)
    return CampaignSpec(head.name, tuple(at_every_point(tests)), *facts, *several, states_laws)


def _joints(tables: Any, errors: list[str]) -> list[JointTable]:
    """Return the [[joint]] tables; an empty list if there are none, or only a [joint] table."""
    if not isinstance(tables, list):
        return []
    stated = [
        checked(JointTable, table, f"[[joint]] {i + 1}", errors) for i, table in enumerate(tables)
    ]
    return [table for table in stated if table is not None]


def _structures(
    table: Any, errors: list[str]
) -> tuple[Structured | None, AssembledStructure | None]:
    """Return the [structure] table as stated modes or as matrices; the other of the two is None."""
    if table is None:
        return None, None
    if isinstance(table, Mapping) and "matrices" in table:
        return None, checked(AssembledStructure, table, "[structure]", errors)
    return checked(Structured, table, "[structure]", errors), None
