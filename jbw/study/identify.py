"""`jbw.identify`: a campaign in; a posterior with its verdict, bands and summary out."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import jax
import xarray as xr

from jbw.campaign.gains import force_per_unit
from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.errors import Attempts
from jbw.identification.assemble import measured_in
from jbw.identification.joint_answers import GROUP as JOINTS
from jbw.identification.laplace import fit_alone
from jbw.identification.paper.sequential_vs_joint import compare_routes
from jbw.identification.prepare import Fitted
from jbw.identification.procedure import Identification, Report, run_procedure
from jbw.identification.tied_joints import tied_evidence, tied_laws
from jbw.identification.usable import usable
from jbw.inference.posterior.finding import judge
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.inference.space.box import require_float64
from jbw.observables.records import compile_beside
from jbw.report.messages import stages
from jbw.study.collect import collect
from jbw.study.final import for_use
from jbw.study.finishing import about_instruments, finished_study, name_gain_unit, with_main
from jbw.study.identifiability import look_again
from jbw.study.look import look_quietly
from jbw.study.order import Order, ReadCampaign
from jbw.study.quick import first_answer, fit_lines
from jbw.study.study import Study
from jbw.study.surroundings import constants_sentence
from jbw.verification.verify import prediction_findings, within_predictions

logger = logging.getLogger("jbw")
TIED_KEY = 300  # of the seed: of the evidence of one law for several joints


def identify(
    campaign: Campaign,
    *,
    seed: int | None = None,
    truth: Mapping[str, float] | None = None,
    report: Report = logger.info,
    keep: Keep = no_checkpoint,
    command: str | None = None,
    quick: bool = False,
) -> Study:
    """Identify the joint from a campaign: the procedure, verification and validation.

    While it goes on, `report` is told what the fit says by itself: parameters with 99 % intervals,
    frequency and damping at small and large motion. With `quick` it ends there, in seconds.

    With `final = true` under [identify] it goes through this twice: with tests held out, which tell
    what the law is worth, and with all of them fitted, for use.

    Args:
        campaign: From `jbw.load_campaign` or the virtual rig.
        seed: Seed of everything random; the campaign's, or 0, when None.
        truth: True parameters of a virtual joint, written beside the results; never used.
        report: Called with one sentence at every stage.
        keep: Where the chains of each posterior outlive the process.
        command: What was typed, for the summary; this process's when None.
        quick: Whether to end with the fit, its intervals and bands by its covariance; the verdict
            is then "not assessed", and no test is predicted.

    Raises:
        ConfigError: A float32 session, or settings that do not fit the tests.
        DataError: Tests that do not allow the procedure.

    Reference:
        Fig. 2, the procedure.
    """
    require_float64()
    seed = campaign.settings.seed if seed is None else seed

    def once(campaign: Campaign, keep: Keep) -> Study:
        order = Order(campaign, seed, truth, command, perf_counter())
        read = read_campaign(campaign, report)
        if quick:
            fit = fit_alone(read.measured, seed=seed, report=report)
            name_gain_unit(read.measured.tests, fit)
            return first_answer(order, read, fit)
        return drawn_study(order, read, report, keep)

    if campaign.settings.final and not quick:
        return for_use(once, campaign, keep, report)
    return once(campaign, keep)


def read_campaign(campaign: Campaign, report: Report) -> ReadCampaign:
    """The tests that can be used, a look at them without a model, and what each step takes.

    All of this comes before anything is sampled: what is wrong with a record then costs no result.
    """
    gain = force_per_unit(campaign)
    several = campaign.joints is not None
    several |= campaign.structure is not None and len(campaign.structure.modes) > 1
    tests, left_out = usable(campaign.tests, campaign.settings, gain, several_modes=several)
    for sentence in left_out:
        report(sentence)
    if not several:
        compile_beside(tests, campaign.laws)
    report(stages.READING_RECORDS)
    look = look_quietly(replace(campaign, tests=tests))
    return ReadCampaign(measured_in(campaign, report, tests), look, tuple(left_out))


def drawn_study(order: Order, read: ReadCampaign, report: Report, keep: Keep) -> Study:
    """The posteriors of a campaign, the checks of the main one, and every test predicted."""
    settings, seed, measured = order.campaign.settings, order.seed, read.measured

    def answer_of_fit(ready: Fitted) -> None:
        lines = Attempts(report).make(
            stages.ANSWER_OF_FIT, lambda: fit_lines(measured, ready, seed), []
        )
        for line in (*lines, stages.DRAWING):
            report(line)

    posteriors = run_procedure(measured, seed=seed, report=report, keep=keep, at_fit=answer_of_fit)
    source_unit = name_gain_unit(measured.tests, posteriors)
    # From here on the posterior is drawn: what cannot be made of it is left out and said.
    attempts = Attempts(report)
    identifiability = attempts.make(
        stages.IDENTIFIABILITY, lambda: look_again(posteriors, settings, report), None
    )
    tree = collect(measured, posteriors, seed, order.truth, attempts)
    tree = with_tied(tree, posteriors, settings, seed, attempts)
    main = posteriors.main
    outside = attempts.make(
        stages.OUTSIDE_BAND,
        lambda: constants_sentence(
            main.posterior["posterior"].to_dataset(), main.held, source_unit
        ),
        None,
    )
    compared = attempts.make(stages.ROUTES, lambda: compare_routes(posteriors), {})
    statements = [*read.left_out, *main.statements, outside, *attempts.said]
    statements.append(about_instruments(order, read))
    findings = [*main.verdict.findings, *prediction_findings(tree)]
    verdict = judge(findings, [within_predictions(tree)])
    identification = with_main(posteriors, verdict, list(filter(None, statements)))
    return finished_study(
        order, read, identification, tree, identifiability=identifiability, compared=compared
    )


def with_tied(
    tree: xr.DataTree,
    posteriors: Identification,
    settings: Identify,
    seed: int,
    attempts: Attempts,
) -> xr.DataTree:
    """The tree whose joints' group says whether joints of one kind of law share one."""
    fitted = posteriors.fitted
    if fitted is None or JOINTS not in tree.children:
        return tree
    if tied_laws(fitted.data.laws) == fitted.data.laws:
        return tree
    attempts.report(stages.TIED)
    key = jax.random.fold_in(jax.random.key(seed), TIED_KEY)
    tied = attempts.make(stages.TIED, lambda: tied_evidence(key, fitted, settings), None)
    if tied is None:
        return tree
    group = tree[JOINTS].to_dataset().assign_attrs(tied.attrs)
    return xr.DataTree.from_dict({**tree.to_dict(), f"/{JOINTS}": group})
