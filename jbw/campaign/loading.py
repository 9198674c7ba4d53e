"""From a campaign file to the tests and their records."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jbw.campaign.finding import found_files
from jbw.campaign.schema import CampaignSpec, TestSpec, read_spec
from jbw.errors import ConfigError, DataError, JbwError
from jbw.measurement.checks import Finding, inspect
from jbw.measurement.files.door import records, report
from jbw.measurement.files.sampling import Wanted
from jbw.measurement.plausibility import doubts
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
        settings: The [identify] table, checked; `prior` maps names to bounds in SI.
        path: The campaign file.
    """

    name: str
    folder: Path
    tests: tuple[Test, ...]
    gain: float | None = None
    modal_mass: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    path: Path = Path()


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
    folder = path.resolve().parent
    tests = [
        _test(test, name, _checked(test, name, folder, allow_outside))
        for test, name in zip(spec.tests, test_names(spec), strict=True)
    ]
    return Campaign(
        spec.name, folder, tuple(tests), spec.gain, spec.modal_mass, spec.settings, path
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


def repeats_of(
    test: TestSpec, name: str, folder: Path, *, allow_outside: bool = False
) -> Iterator[Record | JbwError]:
    """Repeats of a test in SI, without the excluded ones; not yet checked sample by sample.

    What cannot be read comes as the error, in its place, so that the others can still be seen.
    """
    wanted = Wanted(test.channels, test.units, test.fs, test.scale, test.repeats, test.span)
    unused = set(test.exclude)
    number = kept = 0
    try:
        files = found_files(test.files, folder, allow_outside=allow_outside)
    except JbwError as error:
        yield error
        return
    for file in files:
        dropped = {x for x in test.exclude if isinstance(x, str) and fnmatch(file.name, x)}
        unused -= dropped
        if dropped:  # perhaps because it cannot be read
            number += 1
            continue
        try:
            found: tuple[Record | JbwError, ...] = records(file, wanted)
        except JbwError as error:
            found = (error,)
        for item in found:
            if number in unused:
                unused.remove(number)
            else:
                kept += 1
                yield item
            number += 1
    if unused:
        yield _unused(unused, name, number)
    elif not kept:
        yield DataError(f"Test {name!r} has no repeats left.", remedy="Shorten `exclude`.")


def _unused(unused: set[int | str], name: str, number: int) -> ConfigError:
    listed = ", ".join(repr(item) for item in sorted(unused, key=str))
    return ConfigError(
        f"Test {name!r}: `exclude` names {listed}, which is none of its {number} repeats.",
        remedy="Repeats are counted from zero; file names may hold * and ?.",
    )


def _checked(test: TestSpec, name: str, folder: Path, allow_outside: bool) -> tuple[Record, ...]:
    """Repeats of a test; the first error is raised, what is doubtful is warned of."""
    kept: list[Record] = []
    for item in repeats_of(test, name, folder, allow_outside=allow_outside):
        if isinstance(item, JbwError):
            raise item
        report(item, (*inspect(item), *fits_test(item, test), *alike(item, kept[:1])))
        kept.append(item)
    return tuple(kept)


def alike(record: Record, first: Sequence[Record]) -> tuple[Finding, ...]:
    """Whether a repeat has the sampling frequency and units of the test's first one."""
    found = []
    for other in first:
        if record.fs != other.fs and not np.isnan(record.fs):
            found.append(
                Finding(
                    "error",
                    record.response,
                    f"Repeats of a test must have one sampling frequency, but this has "
                    f"{record.fs:g} Hz and {other.name} has {other.fs:g} Hz.",
                    remedy="Make two tests of them.",
                )
            )
    return tuple(found)


def fits_test(record: Record, test: TestSpec) -> tuple[Finding, ...]:
    """What in a record contradicts the campaign file: tones or band beyond what it can show."""
    role = record.response
    found = []
    nyquist = record.fs / 2
    if test.band and test.band[1] > nyquist:
        found.append(
            Finding(
                "error",
                role,
                f"`band` ends at {test.band[1]:g} Hz, above half the sampling frequency "
                f"({nyquist:g} Hz).",
                remedy=f"Lower the band's end to at most {nyquist:g} Hz, or correct fs.",
            )
        )
    high = [tone for tone in test.tones if 3 * tone >= nyquist]
    if high:
        found.append(
            Finding(
                "error",
                role,
                f"Tone {high[0]:g} Hz must lie below a third of half the sampling frequency "
                f"({nyquist / 3:.4g} Hz).",
                "Its third harmonic folds back otherwise.",
                "Drop the tone, or measure with a higher sampling frequency.",
            )
        )
    length = record.num_samples / record.fs
    needed = test.dwell * len(test.tones) if test.kind == "stepped" else test.settle
    if needed > length:
        told = "the steps take" if test.kind == "stepped" else "`settle` alone takes"
        found.append(
            Finding(
                "error",
                role,
                f"The record lasts {length:.4g} s, but {told} {needed:.4g} s.",
                remedy="Correct settle, dwell or tones, or give the whole record.",
            )
        )
    if test.kind in ("noise", "multisine") and not any(map(_is_broken, record.channels.values())):
        found += doubts(record, test.band)
    return tuple(found)


def _is_broken(samples: NDArray[np.float64]) -> bool:
    return not np.isfinite(samples).all() or np.ptp(samples) == 0


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
    )
