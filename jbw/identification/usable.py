"""Exclusion of tests that cannot be used, because they are too short or too noisy."""

import warnings
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager

from jbw.campaign.settings import Identify
from jbw.campaign.tables import Gain, gain_of
from jbw.errors import DataError
from jbw.identification.linear_step import TriedStep, tried_step
from jbw.identification.selection import decay_tests, linear_test
from jbw.measurement.records import Test, drive_of
from jbw.observables.register import taking
from jbw.report.messages import posterior as messages


def usable(
    tests: Sequence[Test], settings: Identify, gain: Gain = None, *, several_modes: bool = False
) -> tuple[tuple[Test, ...], tuple[str, ...], TriedStep | None]:
    """Return the tests that can be fitted, a sentence on each other test, and the trial of Step 2.

    If the settings are `strict`, or no test can be used, all tests are returned, so that the error
    that follows gives the reason. With several modes at the joint there is no Step 2.
    """
    if settings.strict:
        return tuple(tests), (), None
    refused = {test.name: why for test in tests if (why := _refusal(test, settings))}
    line_fit = None
    while (noise := _linear(tests, refused)) is not None and not several_modes:
        try:
            line_fit = tried_step(noise, gain_of(gain, drive_of(noise)), settings.modes)
        except DataError as error:
            refused[noise.name] = str(error)
        else:
            break
    if len(refused) == len(tests):
        return tuple(tests), (), None
    accepted = tuple(test for test in tests if test.name not in refused)
    sentences = (
        messages.test_left_out(name, " ".join(why.split())) for name, why in refused.items()
    )
    return accepted, tuple(sentences), line_fit


def _linear(tests: Sequence[Test], refused: Container[str]) -> Test | None:
    """Return the test for the line fit (Step 2), chosen from the tests that are not rejected."""
    return linear_test([test for test in tests if test.name not in refused])


def _refusal(test: Test, settings: Identify) -> str:
    """Return the reason why a test cannot be fitted; an empty text if it can."""
    try:
        if test.traits.is_free:
            split = decay_tests([test], settings)
            test = test if split is None else split.together
        with _tried():
            # Decays of several modes have additional requirements. They concern [structure], and
            # the check of [structure] reports them as errors.
            for observable in taking(several=False):
                if test.kind in observable.kinds:
                    observable.reduce([test], substeps=settings.substeps)
    except DataError as error:
        return str(error)
    return ""


@contextmanager
def _tried() -> Iterator[None]:
    """Suppress warnings during a trial fit; the final fit issues them once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
