"""The tests of a campaign before anything is fitted: usable, looked at, split."""

from dataclasses import replace
from typing import NamedTuple

from jbw.campaign.gains import force_per_unit
from jbw.campaign.load import Campaign
from jbw.identification.assemble import Measured, Report, measured_in
from jbw.identification.proposed_laws import proposed
from jbw.identification.usable import usable
from jbw.observables.records import compile_beside
from jbw.report.messages import stages
from jbw.study.free_group import fitted_tables
from jbw.study.look import Look, look_quietly


class PreparedTests(NamedTuple):
    """The tests of a campaign, before anything is fitted.

    Attributes:
        measured: Tests that are fitted and held out, Step 2, and what the model is made of.
        look: What the records say without a model.
        sentences: On every test that cannot be used, and on laws that readings proposed.
    """

    measured: Measured
    look: Look
    sentences: tuple[str, ...]


def prepare_tests(campaign: Campaign, report: Report, seed: int) -> PreparedTests:
    """Return the tests that can be used, a look at them without a model, and what each step takes.

    All of this comes before anything is sampled: what is wrong with a record then costs no result.
    A campaign that states no law gets the best of those that its readings propose.
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
    read = look.record["laws"]
    if campaign.states_laws or several or not read:
        return PreparedTests(measured, look, accepted.left_out)
    measured, sentence = proposed(measured, fitted_tables(look, measured), read, seed, report)
    return PreparedTests(measured, look, (*accepted.left_out, sentence))
