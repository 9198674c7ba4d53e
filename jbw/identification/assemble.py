"""The assembly of a campaign's tests into the dataset of the joint posterior."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jbw.campaign.joints import SeveralJoints
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify, Structured, laws_of, never_steady
from jbw.campaign.tables import Gain, force_per_unit, gain_of
from jbw.errors import ConfigError, DataError
from jbw.identification import selection
from jbw.identification.assembled import assembled_modes, known_gain, with_steps
from jbw.identification.attachments import foretold, require_one_unit
from jbw.identification.linear_step import LinearStep, TriedStep, linear_step
from jbw.identification.selection import DecaySplit, Sweeps
from jbw.identification.stated_modes import modes_of, require_driven, with_own_constants
from jbw.identification.uncertain_shapes import require_inferred, with_shape_priors
from jbw.inference.space.stated import StatedDensities
from jbw.measurement.records import Test, drive_of, run_of
from jbw.observables.dataset import Dataset
from jbw.observables.drives import attached, informed_by, named, parts_of
from jbw.observables.line_fit import LineReading
from jbw.observables.modes import Modes, ModesAtJoint
from jbw.observables.observable import Observable
from jbw.observables.register import OBSERVABLES, taking
from jbw.quantities import DEFAULT_LAWS, FED
from jbw.report.messages import stages as messages

logger = logging.getLogger("jbw")
Report = Callable[[str], None]


@dataclass(frozen=True)
class Measured:
    """The fitted and held-out tests of a campaign, with the line fit of its noise test (Step 2)."""

    tests: tuple[Test, ...]
    chosen: tuple[Test, ...]  # tests that are fitted according to `fit` and `hold_out`
    settings: Identify
    laws: tuple[str, ...]
    gain: Gain  # gains stated in the campaign [N/kg per unit of the input]
    linear: LinearStep | None  # line fit of a noise test (Step 2); None without such a test
    sweeps: Sweeps | None  # sweeps; None if there are none
    decays: DecaySplit | None  # free decays; None if none can be fitted
    modes: Modes | None = None  # modes of the structure that move the joint; None for a single mode
    joints: SeveralJoints | None = None  # several joints of the structure; None for one joint
    # laws that the tests do not exclude, and that may slip fully beyond the measured amplitudes
    rivals: tuple[str, ...] = ()

    @property
    def probing(self) -> tuple[Test, ...]:
        """The single-tone tests that measure the third-order kernel, for its fit (Step 3)."""
        linear = self.linear
        if linear is None:
            return ()
        same_drive = [test for test in self.tests if drive_of(test) == drive_of(linear.test)]
        return selection.probing_tests(same_drive, linear.natural_hz)

    @property
    def swept(self) -> list[Test]:
        """The sweeps to fit; held-out repeats are removed."""
        sweeps = () if self.sweeps is None else self.sweeps.fitted
        return [test for test in sweeps if test.name in _names(self.chosen)]


def measured(
    tests: Sequence[Test],
    settings: Identify,
    *,
    laws: tuple[str, ...] | None = None,
    structure: Structured | None = None,
    gain: Gain = None,
    joints: SeveralJoints | None = None,
    line_fit: TriedStep | None = None,
    report: Report = logger.info,
) -> Measured:
    """Divide a campaign's tests into fitted and held-out ones; fit the lines of a noise test.

    Args:
        tests: Tests of the campaign.
        settings: The campaign's [identify] settings.
        laws: Names of the joint's laws; None for the default laws.
        structure: Modes of the structure, where the joint couples several.
        gain: Gain that the campaign states [N/kg per unit of the input], by drive where there are
            several.
        joints: Joints of a structure with several joints.
        line_fit: Step 2, where it was tried before.
        report: Function that is called with one sentence at every stage.

    Raises:
        ConfigError: If `hold_out` names no test, settings do not fit the tests, or tests of one
            drive have sources in different units.
    """
    laws = laws_of(DEFAULT_LAWS, settings.prior) if laws is None else laws
    if joints is None:
        modes = modes_of(structure, tests, settings)
    else:
        laws, modes = joints.laws, assembled_modes(joints, tests, settings)
        require_inferred(modes, laws, settings.prior)
        settings = with_shape_priors(modes, laws, settings)
        gain = known_gain(modes, tests)
    tests = with_own_constants(modes, tests)
    chosen = selection.fitted(tests, settings)
    require_one_unit(chosen)
    noise, linear = selection.linear_test(tests), None
    # With several modes, tests are fitted over time and not by a line fit.
    if noise is not None and modes is None:
        report(messages.line_fit(noise.name))
        if line_fit is not None and line_fit.step.test.name == noise.name:
            linear = line_fit.taken_up()
        else:
            linear = linear_step(noise, gain_of(gain, drive_of(noise)), settings.modes)
    sweeps = selection.sweep_tests(tests, settings, every=modes is not None)
    decays = selection.decay_tests(tests, settings, chosen)
    facts = (settings, laws, gain, linear, sweeps, decays, modes)
    return Measured(tuple(tests), tuple(chosen), *facts, joints=joints)


def measured_in(
    campaign: Campaign,
    report: Report,
    tests: Sequence[Test] | None = None,
    line_fit: TriedStep | None = None,
) -> Measured:
    """Divide a campaign's tests into fitted and held-out ones; add the line fit of Step 2."""
    return measured(
        campaign.tests if tests is None else tests, campaign.settings, laws=campaign.laws,
        structure=campaign.structure, gain=force_per_unit(campaign), joints=campaign.joints,
        line_fit=line_fit, report=report,
    )  # fmt: skip


def assemble(seen: Measured) -> Dataset:
    """Assemble all fitted tests of a campaign in one dataset, in which runs do not have offsets.

    All tests are fitted except held-out ones. Held out are tones near the resonance (they
    validate), levels and repeats of sweeps that are not among `fit_levels` and `fit_repeats`,
    tests named by `hold_out`, and kinds that are not among `fit`, where that is given. A multisine
    of several periods is fitted in time, as steady motion. A noise test enters as
    frequency, damping and gain from its FRF (the line fit of Step 2).

    Raises:
        DataError: If nothing is left to fit.
    """
    linear, gain = seen.linear, seen.gain
    parts: list[Observable] = []
    if linear is not None and linear.test.name in _names(seen.chosen):
        # A noise test contributes its frequency, damping and gain from Step 2.
        if not linear.test.traits.is_periodic:
            linear_gain = gain_of(gain, drive_of(linear.test))
            parts.append(reading_of(linear, linear_gain, seen.laws))
    parts += _reduced(_reducible(seen), seen)
    if not parts:
        raise DataError(
            "The campaign has no test to which the joint can be fitted.",
            why="Tones near the resonance are only for validation; noise alone does not determine "
            "the joint.",
            remedy="Add sweeps, stepped sines, response curves, loops, free decays or tones near "
            "a third of the resonance; or shorten `hold_out`.",
        )
    _require_labels(parts)
    held = _held(parts, gain, seen.chosen)
    if seen.modes is not None:
        require_driven(seen.modes, parts)
        # Free decays do not depend on a gain.
        if all("gain" not in part.informs for part in parts):
            held |= dict.fromkeys(seen.modes.ratios, 1.0)
        held |= seen.modes.held
        if seen.modes.free:
            stated, run = tuple(seen.settings.prior), parts[0].groups.runs[0]
            parts.append(ModesAtJoint.of(seen.modes, stated, run, laws=seen.laws))
    stated = {name: prior for name, prior in seen.settings.prior.items() if name not in held}
    return Dataset.of([*parts, *foretold(seen.tests, parts)], held, StatedDensities.of(stated))


def _held(parts: Sequence[Observable], gain: Gain, tests: Sequence[Test]) -> dict[str, float]:
    """Return fixed parameters: stated gains, and parameters that no test determines."""
    others, first_parts = attached(parts), parts_of("", parts)
    informed = informed_by(first_parts)
    first = next((part.drive for part in first_parts if part.drive), "")
    stated_gain = gain_of(gain, "force" if others and first not in FED else first)
    held = {} if stated_gain is None else {"gain": stated_gain}
    if "gain" not in informed:  # No test determines the modal mass.
        held = {"gain": stated_gain or 1.0}
    if "zeta" not in informed:  # No test determines the damping.
        held["zeta"] = 0.0
    stated = {named("gain", drive): gain_of(gain, drive) for drive in others}
    loops = any(test.traits.is_prescribed for test in tests)
    if loops and stated_gain is None and ((others and "gain" in held) or first in FED):
        raise DataError(
            "Loops together with tests driven by a shaker's voltage or current need the modal "
            "mass, which these tests do not determine.",
            why="A measured force or a free decay determines the modal mass; a voltage or a "
            "current does not.",
            remedy="Also fit a free decay or a sweep with a measured force, or hold the loops out.",
        )
    return held | {name: value for name, value in stated.items() if value is not None}


def _require_labels(parts: Sequence[Observable]) -> None:
    """Raise a DataError if tones of one level have different drives."""
    labels = [label for part in parts for label in part.groups.labels]
    twice = [label for part in parts for label in part.groups.labels if labels.count(label) > 1]
    if twice and attached(parts):
        raise DataError(
            f"Groups of data must have different names, but {len(twice)} groups have the name "
            f"`{twice[0]}`.",
            why="Tones of one level form one group, but the tones of this group have different "
            "drives.",
            remedy=f"Correct `level` of the tones of `{twice[0]}`: state the level of each tone in "
            "the unit of its source.",
        )


def entered(seen: Measured) -> dict[str, bool]:
    """Return, by test name, whether the fit uses one of the test's repeats or its line fit."""
    kinds = {kind for observable in OBSERVABLES for kind in observable.kinds}
    names = _names([test for test in _reducible(seen) if test.kind in kinds])
    names |= _names([test for test in seen.chosen if test.traits.is_free])
    if seen.linear is not None:
        names |= {seen.linear.test.name} & _names(seen.chosen)
    return {test.name: test.name in names for test in seen.tests}


def fitted_repeats(seen: Measured) -> dict[str, list[int]]:
    """Return the fitted repeats of each test, counted from one."""
    sweeps = () if seen.sweeps is None else seen.sweeps.fitted
    chosen = [id(record) for test in sweeps for record in test.records]
    if seen.decays is not None:
        chosen += [id(record) for record in seen.decays.fitted.records]
    return {
        test.name: [
            i + 1
            for i, record in enumerate(test.records)
            if id(record) in chosen or not (test.traits.is_transient or test.traits.is_free)
        ]
        for test in seen.tests
    }


def _reduced(tests: Sequence[Test], seen: Measured) -> list[Observable]:
    """Return tests as the data that the likelihood needs, grouped by kind of test and by drive."""
    parts: list[Observable] = []
    if worn := never_steady(seen.laws, {test.kind for test in tests}):
        raise ConfigError(f"Argument `laws`: {worn}")
    for observable in taking(several=seen.modes is not None):
        of_kind = [test for test in tests if test.kind in observable.kinds]
        stated: dict[str, Any] = {"laws": seen.laws, "substeps": seen.settings.substeps}
        if observable.several:
            stated["modes"] = seen.modes
        for drive in dict.fromkeys(drive_of(test) for test in of_kind):
            same_drive = [test for test in of_kind if drive_of(test) == drive]
            reduced = with_steps(observable.reduce(same_drive, **stated), seen.modes, seen.settings)
            parts += [replace(part, drive=drive, modes=seen.modes) for part in reduced]
    return parts


def _names(tests: Sequence[Test]) -> set[str]:
    return {test.name for test in tests}


def _reducible(seen: Measured) -> list[Test]:
    """Return the tests to fit, without held-out repeats and without validation tests."""
    chosen, linear = seen.chosen, seen.linear
    validating = () if linear is None else selection.loop_tests(chosen, linear.natural_hz)
    split = [test for test in chosen if test.traits.is_transient or test.traits.is_free]
    apart = _names(validating) | _names(split)
    usable = [*seen.swept, *(test for test in chosen if test.name not in apart)]
    if seen.decays is not None and any(test.traits.is_free for test in chosen):
        usable.append(seen.decays.fitted)
    return usable


def reading_of(
    linear: LinearStep, gain: float | None = None, laws: tuple[str, ...] = DEFAULT_LAWS
) -> LineReading:
    """Return the Step 2 fit of a noise test's FRF as a likelihood term; gain in campaign units."""
    scale = np.array([1.0, 1.0, gain or 1.0])
    covariance = linear.pooled.covariance * np.outer(scale, scale)
    run = run_of(linear.test)
    read = LineReading.of(linear.pooled.mean * scale, covariance, linear.y_rms, run, laws=laws)
    return replace(read, drive=drive_of(linear.test))
