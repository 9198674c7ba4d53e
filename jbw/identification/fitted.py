"""The joint fit by least squares and nothing drawn: what the data know, before sampling."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import jax
from jaxtyping import Array, Key

from jbw.campaign.settings import Identify
from jbw.identification.coordinates import PAPER
from jbw.identification.prepare import Report, measured, prepare
from jbw.identification.procedure import Identification
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.measurement.records import Test
from jbw.observables.dataset import Dataset

logger = logging.getLogger("jbw")


@dataclass(frozen=True)
class Fitted:
    """A fit of the joint with what it was fitted to.

    Attributes:
        fit: The fit.
        box: Its prior.
        data: The dataset, whose residual is `jbw.observables.dataset.stacked`.
        statements: What the fit showed, in words.
    """

    fit: Fit
    box: Box
    data: Dataset
    statements: tuple[str, ...] = ()


def fit_joint(
    tests: Sequence[Test],
    settings: Identify,
    *,
    laws: tuple[str, ...] | None = None,
    gain: float | None = None,
    seed: int = 0,
    report: Report = logger.info,
) -> Fitted:
    """Fit the joint to a campaign as the joint posterior would, in the paper's parameters.

    Args:
        tests: The campaign's tests.
        settings: Its [identify] table; `coordinates` is not read.
        laws: Names of the laws of the joint.
        gain: Gain that the campaign states [N/kg per unit of the input], not fitted then.
        seed: Seed of the starts.
        report: Called with one sentence at every stage.

    Returns:
        The fit.

    Raises:
        DataError: If there is nothing that the joint can be fitted to.
    """
    data = measured(tests, settings, laws=laws, gain=gain, report=report).dataset()
    report(f"Least squares: all parameters from {len(data.labels)} groups of data")
    return fit_dataset(jax.random.key(seed), data, settings)


def fit_dataset(key: Key[Array, ""], data: Dataset, settings: Identify) -> Fitted:
    """Fit the joint in the paper's parameters, noise and offsets as the fit shows them.

    Args:
        key: Random key of the starts.
        data: What was measured.
        settings: The campaign's [identify] table.
    """
    settings = settings.model_copy(update={"coordinates": PAPER})
    ready = prepare(jax.random.split(key), data, settings)
    return Fitted(ready.fit, ready.box, ready.data, ready.words)


def fitted_of(found: Identification) -> Fitted | None:
    """The fit that the main posterior of a finished identification started from, if any."""
    if found.data is None:
        return None
    return Fitted(found.main.fit, found.main.box, found.data)
