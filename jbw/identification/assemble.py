"""From the tests of a campaign to the dataset of the joint posterior, by the register of kinds."""

from collections.abc import Sequence

import numpy as np

from jbw.campaign.settings import DEFAULT_LAWS, Identify, laws_of
from jbw.errors import ConfigError, DataError
from jbw.identification.linear_step import LinearStep
from jbw.identification.selection import DecaySplit, Sweeps, loop_tests
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset
from jbw.observables.line_fit import LineReading
from jbw.observables.observable import Observable
from jbw.observables.register import OBSERVABLES
from jbw.observables.runs import run_of


def assemble(
    tests: Sequence[Test],
    settings: Identify,
    *,
    laws: tuple[str, ...] | None = None,
    linear: LinearStep | None = None,
    sweeps: Sweeps | None = None,
    decays: DecaySplit | None = None,
    gain: float | None = None,
) -> Dataset:
    """Everything that a campaign fits, in one dataset.

    Fitted are all tests but those held out: tones near the resonance (they validate), levels and
    repeats of sweeps beside `fit_levels` and `fit_repeats`, tests named by `hold_out`, and kinds
    not among `fit`, where that is given. A multisine of several periods is fitted in time, as
    steady motion; noise enters by its line fit.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table.
        laws: Names of the laws of the joint.
        linear: Step 2, when there was a noise test.
        sweeps: The split of the sweeps.
        decays: The split of the free decays.
        gain: Force per unit mass and unit of the input, when the campaign knows it.

    Returns:
        The dataset, without offsets of the runs.

    Raises:
        DataError: If nothing is left to fit.
        ConfigError: If `hold_out` names no test.
    """
    laws = laws_of(DEFAULT_LAWS, settings.prior) if laws is None else laws
    chosen = fitted(tests, settings)
    names = {test.name for test in chosen}
    parts: list[Observable] = []
    if linear is not None and linear.is_random and linear.test.name in names:
        parts.append(reading_of(linear, gain, laws))
    usable = _reducible(chosen, linear, sweeps, decays)
    for observable in OBSERVABLES:
        own = [test for test in usable if test.kind in observable.kinds]
        if own:
            parts += observable.reduce(own, laws=laws, substeps=settings.substeps)
    if not parts:
        raise DataError(
            "The campaign has no test that the joint can be fitted to.",
            why="Tones near the resonance only validate; noise alone knows nothing of the joint.",
            remedy="Add sweeps, stepped sines, response curves, loops, free decays or tones near "
            "a third of the resonance; or shorten `hold_out`.",
        )
    told = frozenset().union(*(part.informs for part in parts))
    held = {} if gain is None else {"gain": gain}
    if "gain" not in told:  # nothing tells the modal mass: per kilogram
        held = {"gain": gain or 1.0}
    if "zeta" not in told:  # nothing moves freely, and nothing is damped
        held["zeta"] = 0.0
    return Dataset.of(parts, held)


def _reducible(
    chosen: Sequence[Test],
    linear: LinearStep | None,
    sweeps: Sweeps | None,
    decays: DecaySplit | None,
) -> list[Test]:
    """The chosen tests with the repeats to fit alone; without those that validate."""
    names = {test.name for test in chosen}
    validating = set()
    if linear is not None:
        validating = {test.name for test in loop_tests(chosen, linear.natural_hz)}
    split = [test for test in chosen if test.traits.is_transient or test.traits.is_free]
    apart = {test.name for test in split} | validating
    found = [] if sweeps is None else [t for t in sweeps.fitted if t.name in names]
    found += [test for test in chosen if test.name not in apart]
    if decays is not None and any(test.traits.is_free for test in chosen):
        found.append(decays.fitted)
    return found


def fitted(tests: Sequence[Test], settings: Identify) -> list[Test]:
    """Tests that `fit` and `hold_out` leave.

    Raises:
        ConfigError: If `hold_out` names no test.
    """
    names = [test.name for test in tests]
    held_out = settings.hold_out
    unknown = [name for name in held_out if name not in names]
    if unknown:
        raise ConfigError(
            f"Setting `hold_out` must name tests of the campaign, but holds {unknown}.",
            remedy=f"The tests are {', '.join(names)}.",
        )
    kinds = {test.kind for test in tests} if settings.fit is None else settings.fit
    return [test for test in tests if test.kind in kinds and test.name not in held_out]


def reading_of(
    linear: LinearStep, gain: float | None = None, laws: tuple[str, ...] = DEFAULT_LAWS
) -> LineReading:
    """Step 2 as an observable; its gain in the campaign's units where those are known."""
    scale = np.array([1.0, 1.0, gain or 1.0])
    covariance = linear.pooled.covariance * np.outer(scale, scale)
    run = run_of(linear.test)
    return LineReading.of(linear.pooled.mean * scale, covariance, linear.y_rms, run, laws=laws)
