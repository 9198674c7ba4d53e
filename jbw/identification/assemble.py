"""From the tests of a campaign to the dataset of the joint posterior, by the register of kinds."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jbw.campaign.settings import Identify, laws_of
from jbw.errors import DataError, JbwError
from jbw.identification import selection
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.selection import DecaySplit, Sweeps
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset
from jbw.observables.line_fit import LineReading
from jbw.observables.observable import Observable, run_of
from jbw.observables.register import OBSERVABLES
from jbw.quantities import DEFAULT_LAWS

logger = logging.getLogger("jbw")
Report = Callable[[str], None]


@dataclass(frozen=True)
class Measured:
    """A campaign's tests, split before anything is fitted."""

    tests: tuple[Test, ...]
    chosen: tuple[Test, ...]  # those that `fit` and `hold_out` leave
    settings: Identify
    laws: tuple[str, ...]
    gain: float | None  # that the campaign states [N/kg per unit of the input]
    linear: LinearStep | None  # Step 2, when there was a noise test
    sweeps: Sweeps | None  # when there were any
    decays: DecaySplit | None  # when any may be fitted

    @property
    def probing(self) -> tuple[Test, ...]:
        """Tests with one tone that probes the third-order kernel, for Step 3."""
        linear = self.linear
        return () if linear is None else selection.probing_tests(self.tests, linear.natural_hz)

    @property
    def swept(self) -> list[Test]:
        """Sweeps to fit, with the repeats to fit."""
        sweeps = () if self.sweeps is None else self.sweeps.fitted
        return [test for test in sweeps if test.name in _names(self.chosen)]


def measured(
    tests: Sequence[Test],
    settings: Identify,
    *,
    laws: tuple[str, ...] | None = None,
    gain: float | None = None,
    report: Report = logger.info,
) -> Measured:
    """Step 2, where there is a noise test, and what is fitted and held out.

    `laws` are those of a campaign that names none when None, `gain` is what the campaign states
    [N/kg per unit of the input], and `report` is called with one sentence at every stage.

    Raises:
        ConfigError: If `hold_out` names no test, or settings do not fit the tests.
    """
    laws = laws_of(DEFAULT_LAWS, settings.prior) if laws is None else laws
    chosen = selection.fitted(tests, settings)
    noise, linear = selection.linear_test(tests), None
    if noise is not None:
        report(f"Step 2: line fit of {noise.name}")
        linear = linear_step(noise, gain, settings.modes)
    sweeps = selection.sweep_tests(tests, settings)
    decays = selection.decay_tests(tests, settings, chosen)
    return Measured(tuple(tests), tuple(chosen), settings, laws, gain, linear, sweeps, decays)


def assemble(seen: Measured) -> Dataset:
    """Everything that a campaign fits, in one dataset, without offsets of the runs.

    Fitted are all tests but those held out: tones near the resonance (they validate), levels and
    repeats of sweeps beside `fit_levels` and `fit_repeats`, tests named by `hold_out`, and kinds
    not among `fit`, where that is given. A multisine of several periods is fitted in time, as
    steady motion; noise enters by its line fit.

    Raises:
        DataError: If nothing is left to fit.
    """
    linear, gain = seen.linear, seen.gain
    parts: list[Observable] = []
    if linear is not None and linear.test.name in _names(seen.chosen):
        if not linear.test.traits.is_periodic:  # random motion enters by its line fit alone
            parts.append(reading_of(linear, gain, seen.laws))
    parts += _reduced(_reducible(seen), seen)
    if not parts:
        raise DataError(
            "The campaign has no test that the joint can be fitted to.",
            why="Tones near the resonance only validate; noise alone knows nothing of the joint.",
            remedy="Add sweeps, stepped sines, response curves, loops, free decays or tones near "
            "a third of the resonance; or shorten `hold_out`.",
        )
    informed = frozenset().union(*(part.informs for part in parts))
    held = {} if gain is None else {"gain": gain}
    if "gain" not in informed:  # nothing tells the modal mass: per kilogram
        held = {"gain": gain or 1.0}
    if "zeta" not in informed:  # nothing moves freely, and nothing is damped
        held["zeta"] = 0.0
    return Dataset.of(parts, held)


def single_records(seen: Measured) -> list[list[Observable]]:
    """What is fitted, reduced from every test's first record alone, its second, and so on.

    Tests without so many are left out, and so is a number of which no test can be reduced.
    """
    usable, found = _reducible(seen), []
    for i in range(max((len(test.records) for test in usable), default=0)):
        kept = [
            replace(test, records=(test.records[i],)) for test in usable if len(test.records) > i
        ]
        try:
            found.append(_reduced(kept, seen))
        except JbwError:  # an average needs more, or a record is too short by itself
            found.append([])
    return found


def _reduced(tests: Sequence[Test], seen: Measured) -> list[Observable]:
    """Tests by the register of kinds."""
    parts: list[Observable] = []
    for observable in OBSERVABLES:
        if own := [test for test in tests if test.kind in observable.kinds]:
            parts += observable.reduce(own, laws=seen.laws, substeps=seen.settings.substeps)
    return parts


def _names(tests: Sequence[Test]) -> set[str]:
    return {test.name for test in tests}


def _reducible(seen: Measured) -> list[Test]:
    """The chosen tests with the repeats to fit alone; without those that validate."""
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
    """Step 2 as an observable; its gain in the campaign's units where those are known."""
    scale = np.array([1.0, 1.0, gain or 1.0])
    covariance = linear.pooled.covariance * np.outer(scale, scale)
    run = run_of(linear.test)
    return LineReading.of(linear.pooled.mean * scale, covariance, linear.y_rms, run, laws=laws)
