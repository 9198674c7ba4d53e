"""Which test is verified how: every test with a measured excitation, fitted or held out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray as xr

from jbw.curve_verification import Curve, curve_verification
from jbw.identification.gathering import fitted
from jbw.identification.procedure import Identification, Report
from jbw.identification.selection import Sweeps, loop_tests
from jbw.identification.starts import largest_displacement
from jbw.measurement.periods import periods
from jbw.measurement.records import Test
from jbw.observables import response, steady
from jbw.observables.evidence import Evidence
from jbw.observables.response import Records
from jbw.prediction import Draws, scattered, thin
from jbw.reference import Oscillator, references
from jbw.steady_verification import forced_loop_verification, multisine_verification
from jbw.study.basis import seen_of
from jbw.study.known_noise import noise_of, or_of_repeats
from jbw.validation import loop_validation
from jbw.verification import frf_verification, sweep_verification

NUM_DRAWS = 100  # carried through the model: outer quantiles of 99 % bands need about as many
NUM_NOISE_DRAWS = 20  # of them through the long noise records
BAND = (0.75, 1.25)  # of the natural frequency: where FRFs are shown
DEFAULT = ("linear",)  # oscillators without hysteresis to compare with
SCATTER_KEY = 200  # of the seed
Groups = dict[str, xr.Dataset]


@dataclass(frozen=True)
class Carried:
    """What is carried through the model.

    Attributes:
        draws: Draws of the main posterior, with the scatter of the runs where they have offsets.
        few: Some of them, for long records.
        references: The best oscillators without hysteresis of the same tests, by name.
        fitted: Names of the tests that the posterior was made from.
        natural_hz: Natural frequency [Hz].
    """

    draws: Draws
    few: Draws
    references: dict[str, Oscillator]
    fitted: frozenset[str]
    natural_hz: float


def place(group: str, name: str) -> str:
    """Path of a test in the tree."""
    return f"/{group}/{safe(name)}"


def safe(name: str) -> str:
    """A test's name as one level of the tree: a slash would open another."""
    return name.replace("/", "\N{DIVISION SLASH}")


def forced_groups(
    tests: tuple[Test, ...],
    settings: Mapping[str, Any],
    found: Identification,
    data: Evidence,
    seed: int,
    report: Report,
) -> Groups:
    """Verification and validation on every test but free decays.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table.
        found: What the procedure found.
        data: What the joint posterior was made from.
        seed: Seed of the runs' scatter.
        report: Called with one sentence at every stage.
    """
    report("Verification and validation: every test against the model, and without hysteresis")
    chosen = frozenset(test.name for test in fitted(tests, settings))
    carried = _carried(found, data, chosen, seed, settings.get("compare_with", DEFAULT))
    substeps = _substeps(data)
    groups = _frfs(tests, found, carried, substeps) | _sweeps(tests, found, carried, substeps)
    groups |= _curves(tests, found, carried) | _loops(tests, carried)
    groups |= _multisines(tests, carried, substeps) | _validations(tests, found, carried)
    used = {safe(name) for name in carried.fitted}
    for path, dataset in groups.items():
        if path.startswith("/verification"):
            dataset.attrs.setdefault("fitted", int(path.rsplit("/", 1)[-1] in used))
            dataset.attrs["offsets"] = int(data.scatter.size > 0)
    return groups


def _carried(
    found: Identification,
    data: Evidence,
    chosen: frozenset[str],
    seed: int,
    kinds: Sequence[str],
) -> Carried:
    posterior = found.main.posterior["posterior"].to_dataset()
    key = jax.random.fold_in(jax.random.key(seed), SCATTER_KEY)
    draws, few = (
        scattered(key, thin(posterior, n, found.main.held), data.scatter)
        for n in (NUM_DRAWS, NUM_NOISE_DRAWS)
    )
    mean = {name: float(np.mean(values)) for name, values in draws.items()}
    natural_hz = mean["omega_n"] / (2 * np.pi)
    if found.linear is not None:
        natural_hz = found.linear.natural_hz
    if found.sweeps is not None:  # of which some levels are not fitted
        sweeps = {test.name for test in (*found.sweeps.fitted, *found.sweeps.held_out)}
        chosen -= sweeps - {test.name for test in found.sweeps.fitted}
    others = references(data, mean, largest_displacement(data, mean["omega_n"]), kinds)
    return Carried(draws, few, others, chosen, natural_hz)


def _validations(tests: Sequence[Test], found: Identification, carried: Carried) -> Groups:
    """Hysteresis loops of tones near the resonance."""
    if found.linear is None:
        return {}
    chosen = loop_tests(tests, found.linear.natural_hz)
    return {place("validation/loops", t.name): loop_validation(t, carried.draws) for t in chosen}


def _loops(tests: Sequence[Test], carried: Carried) -> Groups:
    """Force loops under prescribed displacement."""
    return {
        place("verification/loop", test.name): forced_loop_verification(
            test, carried.draws, carried.references
        )
        for test in tests
        if test.kind == "loop"
    }


def _multisines(tests: Sequence[Test], carried: Carried, substeps: int) -> Groups:
    """Periodic multisines with steady periods."""
    groups = {}
    for test in tests:
        if test.kind == "multisine" and (cut := periods(test)) is not None:
            groups[place("verification/multisine", test.name)] = multisine_verification(
                cut, carried.few, carried.references, band_hz=test.band_hz, substeps=substeps
            )
    return groups


def _substeps(data: Evidence) -> int:
    """Steps of the solver that the data took."""
    return max((part.substeps for part in data.parts if isinstance(part, Records)), default=2)


def _frfs(tests: Sequence[Test], found: Identification, carried: Carried, substeps: int) -> Groups:
    """FRFs of noise records, and of sweeps with repeats that were not fitted."""
    band_hz = (BAND[0] * carried.natural_hz, BAND[1] * carried.natural_hz)
    groups = {}
    for test in _compared(found.sweeps, carried.fitted):
        dataset = frf_verification(test, carried.draws, band_hz, substeps=substeps)
        groups[place("verification/frf", test.name)] = dataset
    for test in tests:
        if test.kind == "noise" or (test.kind == "multisine" and test.periods < 2):
            dataset = frf_verification(test, carried.few, band_hz, substeps=1)
            groups[place("verification/frf", test.name)] = dataset
    return groups


def _sweeps(
    tests: Sequence[Test], found: Identification, carried: Carried, substeps: int
) -> Groups:
    """Repeats and levels of sweeps that no fit saw, where there are any."""
    posterior = found.main.posterior["posterior"].to_dataset()
    groups = {}
    for test in _compared(found.sweeps, carried.fitted):
        dataset = sweep_verification(
            test,
            carried.draws,
            _noise_of(posterior, tests, test),
            references=carried.references,
            substeps=substeps,
        )
        groups[place("verification/sweep", test.name)] = dataset
    return groups


def _compared(sweeps: Sweeps | None, chosen: frozenset[str]) -> list[Test]:
    """Repeats of sweeps that no fit saw; the fitted ones where a level has no others."""
    if sweeps is None:
        return []
    others = {test.name for test in sweeps.held_out}
    rest = [t for t in sweeps.fitted if t.name not in chosen or t.name not in others]
    return [*sweeps.held_out, *rest]


def _noise_of(posterior: xr.Dataset, tests: Sequence[Test], test: Test) -> float:
    """Noise of one repeat of a sweep, that of its own repeats where no fit knows it."""
    known = noise_of(posterior, {one.name: seen_of(one) for one in tests}, test)
    if known.std is None:
        known = or_of_repeats(known, response.reduce([test]).repeats)
    return known.std or 0.0


def _curves(tests: Sequence[Test], found: Identification, carried: Carried) -> Groups:
    """Response curves, stepped sines and tones; tones near the resonance are validated instead."""
    families = dict(_families(tests, found, carried.fitted))
    curves = list(families.values())
    groups = {}
    datasets = curve_verification(curves, carried.draws, carried.references)
    for name, curve, dataset in zip(families, curves, datasets, strict=True):
        dataset.attrs["fitted"] = int(curve.test.name in carried.fitted)
        groups[place("verification/curve", name)] = dataset
    return groups


def _families(
    tests: Sequence[Test], found: Identification, chosen: frozenset[str]
) -> Iterator[tuple[str, Curve]]:
    """Every curve by name; the fitted tones of one level make one, and those held out another."""
    validating = set()
    if found.linear is not None:
        validating = {test.name for test in loop_tests(tests, found.linear.natural_hz)}
    tones: dict[tuple[float, bool], list[Test]] = {}
    for test in tests:
        if test.kind == "frf":
            yield test.name, Curve([steady.curve_group(test)], test)
        elif test.kind == "stepped":
            yield test.name, Curve(steady.stepped_groups(test), test)
        elif test.kind == "tones" and len(test.tones_hz) == 1 and test.name not in validating:
            tones.setdefault((test.level, test.name in chosen), []).append(test)
    for (level, known), family in tones.items():
        name = f"tones {level:g}{'' if known else ' (held out)'}"
        harmonics = steady.tone_groups(family)
        width = len(steady.ORDERS)
        for i in range(0, len(harmonics), width):
            number = f" {i // width + 1}" if i else ""
            yield name + number, Curve(harmonics[i : i + width], family[0])
