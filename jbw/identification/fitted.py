"""The joint fit by least squares and nothing drawn: what the data know, before sampling."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
from jaxtyping import Array, Float, Key

from jbw.identification.coordinates import box_of
from jbw.identification.decay_fit import decay_box, fit_decay
from jbw.identification.decay_reading import first_reading
from jbw.identification.gathering import gather
from jbw.identification.linear_step import linear_step
from jbw.identification.procedure import Identification, Report
from jbw.identification.selection import decay_tests, linear_test, sweep_tests
from jbw.identification.settling import settled
from jbw.identification.starts import fit_from, linear_look
from jbw.inference.box import Box
from jbw.inference.fitting import Fit
from jbw.measurement.records import Test
from jbw.observables import decay, decay_likelihood, evidence
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, labels

logger = logging.getLogger("jbw")


@dataclass(frozen=True)
class Fitted:
    """A fit of the joint with what it was fitted to.

    Attributes:
        fit: The fit.
        box: Its prior.
        residual: (theta, data) to residuals in units of their standard deviation.
        data: What `residual` takes.
        worth: Share of the residuals that are independent and not yet weighted as such.
        statements: What the fit showed, in words.
    """

    fit: Fit
    box: Box
    residual: Callable[[Mapping[str, Array], Any], Float[Array, " values"]]
    data: Evidence | Decays
    worth: float
    statements: tuple[str, ...] = ()


def fit_joint(
    tests: Sequence[Test],
    settings: Mapping[str, Any],
    *,
    gain: float | None = None,
    seed: int = 0,
    report: Report = logger.info,
) -> Fitted:
    """Fit the joint to a campaign as the joint posterior would, in the paper's parameters.

    Free decays alone are fitted by softening, opening and share, as they always are.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table; `coordinates` is not read.
        gain: Gain that the campaign states [N/kg per unit of the input], not fitted then.
        seed: Seed of the starts.
        report: Called with one sentence at every stage.

    Returns:
        The fit.

    Raises:
        DataError: If there is nothing that the joint can be fitted to.
    """
    key, decays = jax.random.key(seed), decay_tests(tests, settings)
    if decays is not None and all(test.kind == "decay" for test in tests):
        report(f"Least squares: the joint from {len(decays.fitted.records)} free decays")
        return _fit_decays(key, decays.fitted, settings)
    noise, linear = linear_test(tests), None
    if noise is not None:
        report(f"Step 2: line fit of {noise.name}")
        linear = linear_step(noise, gain)
    sweeps = sweep_tests(tests, settings)
    data = gather(tests, settings, linear=linear, sweeps=sweeps, decays=decays, gain=gain)
    report(f"Least squares: all parameters from {len(labels(data))} groups of data")
    return fit_evidence(key, data, settings)


def fit_evidence(key: Key[Array, ""], data: Evidence, settings: Mapping[str, Any]) -> Fitted:
    """Fit the joint to evidence in the paper's parameters, noise and offsets as the fit shows them.

    Args:
        key: Random key of the starts.
        data: What was measured.
        settings: The campaign's [identify] table.
    """
    keys, known = jax.random.split(key), linear_look(data)
    settings = {**settings, "coordinates": "paper"}
    prior = box_of(settings, data, known)
    first = fit_from(keys[0], data, prior, known)
    prior, best, data, words = settled(keys[1], data, prior, first, settings)
    best = replace(best, waterfall=first.waterfall)
    return Fitted(best, prior, evidence.residual, data, 1.0, tuple(words))


def _fit_decays(key: Key[Array, ""], test: Test, settings: Mapping[str, Any]) -> Fitted:
    reading, data = first_reading(test), decay.reduce(test, substeps=settings.get("substeps", 1))
    prior = decay_box(settings, reading)
    best, data = fit_decay(key, data, prior, reading)
    return Fitted(best, prior, decay_likelihood.residual, data, float(data.worth))


def fitted_of(found: Identification) -> Fitted | None:
    """The fit that the main posterior of a finished identification started from, if any."""
    step = found.main
    if found.data is not None:
        return Fitted(step.fit, step.box, evidence.residual, found.data, 1.0)
    if found.decay_data is None:
        return None
    worth = float(found.decay_data.worth)
    return Fitted(step.fit, step.box, decay_likelihood.residual, found.decay_data, worth)
