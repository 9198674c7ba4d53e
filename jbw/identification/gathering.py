"""From the tests of a campaign to the evidence of the joint posterior, kind by kind."""

import warnings
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from jbw.errors import ConfigError, DataError
from jbw.identification.linear_step import LinearStep
from jbw.identification.selection import DecaySplit, Sweeps, loop_tests
from jbw.measurement.periods import periods
from jbw.measurement.records import Test
from jbw.observables import decay, harmonics, loops, response, steady
from jbw.observables.evidence import Evidence, Part, evidence
from jbw.observables.linear import LineReading, line_reading
from jbw.observables.runs import run_of

DEFAULT_SUBSTEPS = 2


def gather(
    tests: Sequence[Test],
    settings: Mapping[str, Any],
    *,
    linear: LinearStep | None = None,
    sweeps: Sweeps | None = None,
    decays: DecaySplit | None = None,
    gain: float | None = None,
) -> Evidence:
    """Everything that a campaign fits, in one evidence.

    Fitted are all tests but those held out: tones near the resonance (they validate), levels and
    repeats of sweeps beside `fit_levels` and `fit_repeats`, tests named by `hold_out`, and kinds
    not among `fit`, where that is given. A multisine of several periods is fitted in time, as
    steady motion; noise enters by its line fit.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table.
        linear: Step 2, when there was a noise test.
        sweeps: The split of the sweeps.
        decays: The split of the free decays.
        gain: Force per unit mass and unit of the input, when the campaign knows it.

    Returns:
        The evidence, without offsets of the runs.

    Raises:
        DataError: If nothing is left to fit.
        ConfigError: If `hold_out` names no test.
    """
    chosen = fitted(tests, settings)
    names = {test.name for test in chosen}
    substeps = settings.get("substeps", DEFAULT_SUBSTEPS)
    parts: list[Part] = []
    if linear is not None and linear.test.kind == "noise" and linear.test.name in names:
        parts.append(reading_of(linear, gain))
    if sweeps is not None:
        kept = [test for test in sweeps.fitted if test.name in names]
        parts += [response.reduce(same, substeps=substeps) for same in by_form(kept)]
    steady_tests = [periods(test) for test in chosen if test.kind == "multisine"]
    parts += [
        response.reduce(same, substeps=substeps, periodic=True)
        for same in by_form([test for test in steady_tests if test is not None])
    ]
    groups = _groups(chosen, None if linear is None else linear.natural_hz)
    if groups:
        parts.append(harmonics.gather(groups))
    forced = [test for test in chosen if test.kind == "loop"]
    if forced:
        parts.append(loops.reduce(forced))
    if decays is not None and decays.fitted.kind in {test.kind for test in chosen}:
        parts.append(decay.reduce(decays.fitted, substeps=1))
    if not parts:
        raise DataError(
            "The campaign has no test that the joint can be fitted to.",
            why="Tones near the resonance only validate; noise alone knows nothing of the joint.",
            remedy="Add sweeps, stepped sines, response curves, loops, free decays or tones near "
            "a third of the resonance; or shorten `hold_out`.",
        )
    held = {} if gain is None else {"gain": gain}
    if all(isinstance(part, loops.Loops | decay.Decays) for part in parts):
        held = {"gain": gain or 1.0}  # nothing tells the modal mass: per kilogram
    if all(isinstance(part, loops.Loops) for part in parts):
        # Along a prescribed displacement nothing moves freely: per kilogram, and no damping.
        held = {"gain": gain or 1.0, "zeta": 0.0}
    return evidence(parts, held)


def fitted(tests: Sequence[Test], settings: Mapping[str, Any]) -> list[Test]:
    """Tests that `fit` and `hold_out` leave.

    Raises:
        ConfigError: If `hold_out` names no test.
    """
    names = [test.name for test in tests]
    held_out = settings.get("hold_out", ())
    unknown = [name for name in held_out if name not in names]
    if unknown:
        raise ConfigError(
            f"Setting `hold_out` must name tests of the campaign, but holds {unknown}.",
            remedy=f"The tests are {', '.join(names)}.",
        )
    kinds = settings.get("fit", {test.kind for test in tests})
    return [test for test in tests if test.kind in kinds and test.name not in held_out]


def reading_of(linear: LinearStep, gain: float | None = None) -> LineReading:
    """Step 2 as an observable; its gain in the campaign's units where those are known."""
    scale = np.array([1.0, 1.0, gain or 1.0])
    covariance = linear.pooled.covariance * np.outer(scale, scale)
    run = run_of(linear.test)
    return line_reading(linear.pooled.mean * scale, covariance, linear.y_rms, run)


def by_form(tests: Sequence[Test]) -> list[list[Test]]:
    """Tests in groups of one sampling frequency, response and length."""
    ordered = sorted(tests, key=response.form_of)
    return [list(same) for _, same in groupby(ordered, key=response.form_of)]


def _groups(tests: Sequence[Test], natural_hz: float | None) -> list[harmonics.Group]:
    """Harmonics of tones, stepped sines and response curves."""
    validating = set()
    if natural_hz is not None:
        validating = {test.name for test in loop_tests(tests, natural_hz)}
    tones = [t for t in tests if t.kind == "tones" and t.name not in validating]
    groups = steady.tone_groups([test for test in tones if len(test.tones_hz) == 1])
    for test in tests:
        if test.kind == "stepped":
            groups += steady.stepped_groups(test)
        elif test.kind == "frf":
            groups.append(steady.curve_group(test))
    return _with_noise(groups)


def _with_noise(groups: Sequence[harmonics.Group]) -> list[harmonics.Group]:
    """Groups that tell their own noise: one value alone would be fitted as if it had none."""
    lone = [one.label for one in groups if one.num_repeats * len(one.omega) < 2]
    if lone:
        warnings.warn(
            f"Not fitted, for one frequency and one repeat tell nothing of their noise: "
            f"{', '.join(lone)}. Measure repeats, or more tones at the same level.",
            stacklevel=2,
        )
    return [one for one in groups if one.label not in lone]
