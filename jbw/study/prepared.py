"""The tests of a campaign before any fit: checked, read without a model, split."""

from dataclasses import replace
from typing import NamedTuple

from jbw.campaign.gains import force_per_unit
from jbw.campaign.load import Campaign
from jbw.identification.assemble import Measured, Report, measured_in
from jbw.identification.proposed_laws import proposed
from jbw.identification.usable import usable
from jbw.observables.records import compile_beside
from jbw.quantities import DEFAULT_LAWS
from jbw.report.messages import stages
from jbw.study.free_group import fitted_tables
from jbw.study.look import Look, look_quietly


class PreparedTests(NamedTuple):
    """The tests of a campaign before any fit.

    Attributes:
        measured: Fitted and held-out tests, the linear regime (Step 2), and the ingredients of the
            model.
        look: Readings of the records without a model.
        sentences: Sentences on tests that cannot be used, and on laws that the readings propose.
    """

    measured: Measured
    look: Look
    sentences: tuple[str, ...]


def prepare_tests(campaign: Campaign, report: Report, seed: int) -> PreparedTests:
    """Return the usable tests, their readings without a model, and the data of each later step.

    This precedes all sampling, so that an error in a record costs no result. If a
    campaign states no law, and its readings propose another law before the default, it gets the
    best one of those that they propose.
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
    read = look.record.laws
    if campaign.states_laws or several or not read or read[0] in DEFAULT_LAWS:
        return PreparedTests(measured, look, accepted.left_out)
    measured, sentence = proposed(measured, fitted_tables(look, measured), read, seed, report)
    return PreparedTests(measured, look, (*accepted.left_out, sentence))
