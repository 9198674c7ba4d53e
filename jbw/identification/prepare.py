"""From the tests of a campaign to what is sampled: one way for all that fit or draw the joint.

Step 2, the splits of what is fitted and held out, the dataset, the box, the fit and its weights:
identify, compare, identifiability and calibration all come this way.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble
from jbw.identification.coordinates import box_of
from jbw.identification.linear_step import LinearStep, linear_step
from jbw.identification.reweighting import reweight
from jbw.identification.selection import (
    DecaySplit,
    Sweeps,
    decay_tests,
    linear_test,
    sweep_tests,
)
from jbw.identification.starts import first_values, fit_from, from_amplitude_curve
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset, by_label

logger = logging.getLogger("jbw")
Report = Callable[[str], None]


@dataclass(frozen=True)
class Measured:
    """A campaign's tests, split before anything is fitted.

    Attributes:
        tests: All of them.
        settings: The campaign's [identify] table.
        laws: Names of the laws of the joint; None for those of a campaign that names none.
        gain: Gain that the campaign states [N/kg per unit of the input].
        linear: Step 2, when there was a noise test.
        sweeps: The split of the sweeps, when there were any.
        decays: The split of the free decays, when there were any.
    """

    tests: tuple[Test, ...]
    settings: Identify
    laws: tuple[str, ...] | None
    gain: float | None
    linear: LinearStep | None
    sweeps: Sweeps | None
    decays: DecaySplit | None

    def dataset(self, tests: Sequence[Test] | None = None) -> Dataset:
        """What the joint posterior is made from.

        Args:
            tests: Those of the tests that may be fitted; all of them when None.
        """
        settings = self.settings
        if tests is None:
            tests = self.tests
        else:  # what is held out of all tests is not missing among some of them
            named = {test.name for test in tests}
            held_out = tuple(name for name in settings.hold_out if name in named)
            settings = settings.model_copy(update={"hold_out": held_out})
        return assemble(
            tests,
            settings,
            laws=self.laws,
            linear=self.linear,
            sweeps=self.sweeps,
            decays=self.decays,
            gain=self.gain,
        )


def measured(
    tests: Sequence[Test],
    settings: Identify,
    *,
    laws: tuple[str, ...] | None = None,
    gain: float | None = None,
    report: Report = logger.info,
) -> Measured:
    """Step 2, where there is a noise test, and what is fitted and held out.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table.
        laws: Names of the laws of the joint.
        gain: Gain that the campaign states [N/kg per unit of the input].
        report: Called with one sentence at every stage.
    """
    noise, linear = linear_test(tests), None
    if noise is not None:
        report(f"Step 2: line fit of {noise.name}")
        linear = linear_step(noise, gain)
    sweeps, decays = sweep_tests(tests, settings), decay_tests(tests, settings)
    return Measured(tuple(tests), settings, laws, gain, linear, sweeps, decays)


@dataclass(frozen=True)
class Prepared:
    """A fit of the joint, ready to be drawn from.

    Attributes:
        data: The dataset with the noise, effective values and run effects that were found.
        box: The prior, in the coordinates to sample in.
        fit: Least squares in the box.
        words: What the fit showed, a sentence each.
        chi_square: Of the first fit over the groups whose noise repeats tell, and its degrees of
            freedom; None without such groups.
    """

    data: Dataset
    box: Box
    fit: Fit
    words: tuple[str, ...]
    chi_square: tuple[float, int] | None


def prepare(
    keys: Sequence[Key[Array, ""]] | Key[Array, " two"],
    data: Dataset,
    settings: Identify,
    known: Mapping[str, float] | None = None,
) -> Prepared:
    """First values, the box, the fit from them, and what the fit settles.

    Args:
        keys: Random keys of the starts and of the steps of the solver.
        data: What was measured.
        settings: The campaign's [identify] table.
        known: Values that earlier steps know.
    """
    values = {**first_values(data), **(known or {})}
    prior = box_of(settings, data, values)
    values = {**from_amplitude_curve(keys[0], data, prior, values), **values}
    first = fit_from(keys[0], data, prior, values)
    chi_square = explained(first, data)
    prior, best, data, words = reweight(keys[1], data, prior, first, settings)
    best = replace(best, waterfall=first.waterfall)  # the later fits have one start
    return Prepared(data, prior, best, tuple(words), chi_square)


def explained(first: Fit, data: Dataset) -> tuple[float, int] | None:
    """Chi-square of a fit over the groups whose noise is known from repeats, and its degrees."""
    sizes = {label: size for part in data.parts for label, size in part.noise_known().items()}
    if not sizes:
        return None
    rows = by_label(first.residual, data)
    total = sum(float(np.sum(rows[label] ** 2)) for label in sizes)
    return total, max(int(sum(sizes.values())) - len(first.x), 1)
