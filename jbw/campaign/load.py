"""From a campaign file to the tests and their records."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jbw.campaign.agree import findings, unread
from jbw.campaign.files import repeats_of
from jbw.campaign.schema import CampaignSpec, TestSpec, read_spec
from jbw.campaign.settings import DEFAULT_LAWS, Identify, laws_of
from jbw.errors import JbwError
from jbw.measurement.files.read import report
from jbw.measurement.records import Record, Test


@dataclass(frozen=True)
class Campaign:
    """Everything that was measured on one joint, in SI.

    Attributes:
        name: What to call it.
        folder: Where the campaign file lies.
        tests: The tests, in the order of the file.
        gain: Force per modal mass for one volt [N/kg/V], when known.
        modal_mass: Modal mass [kg], when known.
        settings: The [identify] table, checked; a mapping of its keys is taken too.
        path: The campaign file.
        laws: Names of the laws that stand beside each other across the joint.
    """

    name: str
    folder: Path
    tests: tuple[Test, ...]
    gain: float | None = None
    modal_mass: float | None = None
    settings: Identify = field(default_factory=Identify)
    path: Path = Path()
    laws: tuple[str, ...] = DEFAULT_LAWS

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", Identify.of(self.settings))
        object.__setattr__(self, "laws", laws_of(self.laws, self.settings.prior))


def load_campaign(path: str | Path, *, allow_outside: bool = False) -> Campaign:
    """Campaign file read and checked, with all of its records.

    Args:
        path: The TOML file.
        allow_outside: Let `files` point out of the campaign file's folder.

    Raises:
        ConfigError: The campaign file is against the schema; all its errors at once.
        DataError: A file or channel is missing, damaged, or fails a check.
    """
    path = Path(path)
    spec = read_spec(path)
    for fault in unread(spec):
        warnings.warn(f"{path.name}, [identify]: {fault.what} {fault.remedy}", stacklevel=2)
    folder = path.resolve().parent
    tests = [
        _test(test, name, _checked(test, name, folder, allow_outside, force_per_unit(spec)))
        for test, name in zip(spec.tests, test_names(spec), strict=True)
    ]
    return Campaign(
        spec.name, folder, tuple(tests), spec.gain, spec.modal_mass, spec.settings, path, spec.laws
    )


def test_names(spec: CampaignSpec) -> list[str]:
    """The tests' names: as given, else kind and level, numbered where that is not unique."""
    taken = {test.name for test in spec.tests}
    names = []
    for test in spec.tests:
        known = "" if np.isnan(test.level) else f" {test.level:g}"
        base = test.name or f"{test.kind}{known}"
        candidates = (base if n == 1 else f"{base} ({n})" for n in range(1, len(spec.tests) + 2))
        name = test.name or next(name for name in candidates if name not in taken)
        taken.add(name)
        names.append(name)
    return names


def force_per_unit(spec: CampaignSpec | Campaign) -> float | None:
    """Force per modal mass for one unit of the input [1/kg, or N/kg/V], when the campaign says."""
    return spec.gain if spec.modal_mass is None else 1 / spec.modal_mass


def _checked(
    test: TestSpec, name: str, folder: Path, allow_outside: bool, per_unit: float | None
) -> tuple[Record, ...]:
    """Repeats of a test; the first error is raised, what is doubtful is warned of."""
    kept: list[Record] = []
    for item in repeats_of(test, name, folder, allow_outside=allow_outside):
        if isinstance(item, JbwError):
            raise item
        report(item, findings(item, test, kept[:1], per_unit=per_unit))
        kept.append(item)
    return tuple(kept)


def _test(spec: TestSpec, name: str, kept: tuple[Record, ...]) -> Test:
    return Test(
        kind=spec.kind,
        records=kept,
        name=name,
        level=spec.level,
        tones_hz=spec.tones,
        band_hz=spec.band,
        dwell=spec.dwell,
        settle=spec.settle,
        delay=spec.delay,
        assembly=spec.assembly,
        run=spec.run,
        periods=spec.periods,
    )
