"""Which parameters the data know: before sampling by the fit, afterwards by the draws too."""

import logging
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from jbw.campaign.load import Campaign, force_per_unit
from jbw.campaign.settings import Identify
from jbw.identification.coordinates import combinations
from jbw.identification.prepare import Fitted, fit_joint
from jbw.identification.procedure import Identification
from jbw.inference.fit.identifiability import (
    box_sensitivity,
    contraction,
    listed,
    sensitivity_statements,
)
from jbw.inference.fit.information import information, statements
from jbw.inference.fit.profiles import Profile, profile_statements, profiles
from jbw.inference.space.box import alone, require_float64, value_of
from jbw.observables.dataset import stacked
from jbw.study.identifiability_record import Identifiability, reached

logger = logging.getLogger("jbw")
NARROWED = 0.5  # of the prior's variance

Report = Callable[[str], None]


def identifiability(
    campaign: Campaign,
    *,
    profiles: bool = False,
    seed: int | None = None,
    report: Report = logger.info,
) -> Identifiability:
    """Fit the joint to a campaign and say what the data know of it, without sampling.

    Args:
        campaign: From `jbw.load_campaign` or the virtual rig.
        profiles: Whether to follow the profile of every parameter too.
        seed: Seed of the starts; the campaign's, or 0, when None.
        report: Called with one sentence at every stage.

    Returns:
        The information spectrum, the profiles, and both in words.

    Raises:
        ConfigError: A float32 session, or settings that do not fit the tests.
        DataError: Tests that the joint cannot be fitted to.
    """
    require_float64()
    settings = campaign.settings
    seed = settings.seed if seed is None else seed
    gain = force_per_unit(campaign)
    fitted = fit_joint(
        campaign.tests, settings, laws=campaign.laws, gain=gain, seed=seed, report=report
    )
    return look(fitted, with_profiles=profiles, report=report)


def look(fitted: Fitted, *, with_profiles: bool, report: Report = logger.info) -> Identifiability:
    """What a fit says before sampling.

    Args:
        fitted: The fit.
        with_profiles: Whether to follow the profile of every parameter too.
        report: Called with one sentence for every profile.
    """
    products = combinations(fitted.box.names, fitted.data.laws)
    found = information(fitted.fit, fitted.box, products)
    followed = _profiles(fitted, report) if with_profiles else {}
    said = [
        *fitted.statements,
        *statements(found, products),
        *profile_statements(followed),
        _waterfall_words(fitted.fit.waterfall),
    ]
    return Identifiability(fitted, products, found, followed, statements=tuple(said))


def _profiles(fitted: Fitted, report: Report) -> dict[str, Profile]:
    return profiles(stacked, fitted.box, fitted.data, fitted.fit, report=report)


def look_again(
    found: Identification, settings: Identify, report: Report = logger.info
) -> Identifiability | None:
    """What the fit said and what the draws say, of the main posterior of an identification.

    Args:
        found: What the procedure found.
        settings: The campaign's [identify] table; with `profiles`, those are followed too.
        report: Called with one sentence for every profile.

    Returns:
        The answer; None without a joint posterior.
    """
    fitted = found.fitted
    if fitted is None:
        return None
    before = look(fitted, with_profiles=settings.profiles, report=report)
    box, products = fitted.box, before.products
    group = found.main.posterior["posterior"].to_dataset()
    draws = {name: group[name].values for name in box.names}
    looked_at = (*map(alone, box.names), *products)
    narrowed = contraction(draws, box, looked_at)
    values = {each.name: value_of(each, draws) for each in looked_at}
    sensitivity = box_sensitivity(values, box)
    texts = {each.name: each.text for each in looked_at}
    said = [
        *before.statements,
        *_contraction_words(narrowed, texts),
        *sensitivity_statements(sensitivity, texts),
    ]
    return Identifiability(
        fitted, products, before.information, before.profiles, narrowed, sensitivity, tuple(said)
    )


def _waterfall_words(costs: NDArray[np.float64]) -> str:
    if len(costs) == 1:
        return "The fit had one start, which explained the data."
    near = reached(costs)
    if near == 1:
        return (
            f"Of {len(costs)} starts of the fit, one alone reached the lowest cost: a lower one "
            "may have been missed."
        )
    return f"{near} of {len(costs)} starts of the fit ended within 1 % of the lowest cost."


def _contraction_words(narrowed: Mapping[str, float], texts: Mapping[str, str]) -> list[str]:
    """Which marginals the data hardly narrowed, in words."""
    wide = [
        f"{texts[name]} ({max(value, 0.0):.0%})"
        for name, value in narrowed.items()
        if value < NARROWED
    ]
    if not wide:
        return ["After sampling, every parameter has less than half of its prior variance left."]
    return [
        f"After sampling, the data have taken less than half of the prior variance of "
        f"{listed(wide)}."
    ]
