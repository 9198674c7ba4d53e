"""Preparation of a campaign's tests before any fit: check, measure without a model, split."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from jbw.campaign.gains import force_per_unit
from jbw.campaign.load import Campaign
from jbw.identification.assemble import Measured, Report, measured_in
from jbw.identification.proposed_laws import candidates, chosen
from jbw.identification.usable import usable
from jbw.observables.records import compile_beside
from jbw.report.messages import stages
from jbw.study.look import Look, look_quietly


class PreparedTests(NamedTuple):
    """The tests of a campaign before any fit.

    Attributes:
        measured: Fitted and held-out tests, the linear regime (Step 2), and the ingredients of the
            model.
        look: Readings of the records without a model.
        sentences: Sentences on tests that cannot be used, and on the choice of the law.
        start: Parameters of the fit by which the law was chosen.
    """

    measured: Measured
    look: Look
    sentences: tuple[str, ...]
    start: Mapping[str, float] = MappingProxyType({})


def prepare_tests(campaign: Campaign, report: Report, seed: int) -> PreparedTests:
    """Return the usable tests, their measured frequency and damping, and the data for each step.

    This precedes all sampling, so that an error in a record costs no result. If a campaign states
    no law, it gets the first one that leaves only noise, or the one that fits best.
    """
    gain = force_per_unit(campaign)
    several = campaign.joints is not None
    several |= campaign.structure is not None and len(campaign.structure.modes) > 1
    accepted = usable(campaign.tests, campaign.settings, gain, several_modes=several)
    for sentence in accepted.left_out:
        report(sentence)
    if not several:
        compile_beside(accepted.tests, campaign.laws)
    report(stages.READING_RECORDS)
    look = look_quietly(replace(campaign, tests=accepted.tests))
    measured = measured_in(campaign, report, accepted.tests, accepted.line_fit)
    if campaign.states_laws or several:
        return PreparedTests(measured, look, accepted.left_out)
    found = chosen(measured, candidates(look.record.laws), seed, report)
    sentences = *accepted.left_out, found.sentence
    return PreparedTests(found.measured, look, sentences, found.theta)
