"""`jbw.identify`: the identification of a campaign, which returns its posterior and verdict."""

import logging
from collections.abc import Mapping
from functools import partial
from time import perf_counter

import jax

from jbw.campaign.load import Campaign
from jbw.identification.assemble import Report
from jbw.identification.checks import check_joint
from jbw.identification.free_decays import free_decays
from jbw.identification.joint import draw_joint, fit_problem, joint_problem
from jbw.identification.paper_route import paper_route
from jbw.identification.procedure import Posteriors, identified
from jbw.inference.generator import parts_of
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.inference.space.box import require_float64
from jbw.study.comparisons import compare
from jbw.study.finishing import about_instruments, finished_study, for_use
from jbw.study.order import Order
from jbw.study.prepared import prepare_tests
from jbw.study.quick import first_answer, report_fit
from jbw.study.study import Study
from jbw.verification.grade import judged
from jbw.verification.verify import predicted_tests, prediction_findings

logger = logging.getLogger("jbw")
# numbers that derive random keys: for Steps 3 and 4, and for the stages of the joint posterior
NUM_KEYS, NUM_PARTS = 16, 5


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
    """Identify the joint from a campaign: fit, posterior, verification and validation.

    Before the posterior is drawn, `report` receives the answer of the fit alone: parameters with 99
    % intervals, frequency and damping at small and large motion. With `quick` the identification
    ends there, after seconds.

    With `final = true` under [identify] it runs twice: with held-out tests, which show how well the
    law predicts, and with all tests fitted, for use.

    Args:
        campaign: A campaign from `jbw.load_campaign` or the virtual rig.
        seed: Seed of all random numbers; when None that of the campaign, or 0.
        truth: True parameters of a virtual joint, stored with the results and never used.
        report: A function that is called with one sentence at every stage.
        keep: The store of each posterior's chains that survives the end of the process.
        command: The typed command, for the summary; that of this process when None.
        quick: Whether to end with the fit, with intervals and bands from its covariance; the
            verdict is then "not assessed", and no test is predicted.

    Raises:
        ConfigError: The session is in float32, or settings do not fit the tests.
        DataError: The tests do not allow the procedure.

    Reference:
        Fig. 2, the procedure.

    Examples:
        Two sweeps determine the 118.12 rad/s of the virtual rig. Without `quick` the posterior is
        drawn as well, which takes minutes:

        >>> import jbw; jbw.enable_x64()
        >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
        >>> study = jbw.identify(campaign, quick=True)
        >>> print(f"{study.table()['mean']['omega_n']:.2f} rad/s,", study.verdict.status)
        118.12 rad/s, not assessed
    """
    require_float64()
    if campaign.settings.final and not quick:
        again = partial(identify, seed=seed, truth=truth, report=report, command=command)
        return for_use(lambda part, kept: again(part, keep=kept), campaign, keep, report)
    seed = campaign.settings.seed if seed is None else seed
    order = Order(campaign, seed, truth, command, perf_counter())
    # Select usable tests, fitted and held out, and fit the FRF (Step 2).
    prepared = prepare_tests(campaign, report, seed)
    order = order.under(prepared.measured.laws)
    if quick:
        return first_answer(order, prepared, report)
    measured = prepared.measured
    keys = iter(parts_of(jax.random.key(seed), NUM_KEYS))
    # Sample Steps 3 and 4, each with the earlier results fixed, as in Teloli et al.
    paper = paper_route(measured, keys, report, keep)
    problem = joint_problem(measured, paper.means, seed=seed, report=report, start=prepared.start)
    key = parts_of(next(keys), NUM_PARTS)
    # The fit determines starting points, noise, run effects, coordinates and solver steps.
    fit = fit_problem(key[:2], problem)
    report_fit(measured, fit, seed, report)
    # The posterior of all parameters together is sampled, by Eq. (37).
    posterior = draw_joint(key[2:4], problem, fit, keep=keep)
    # The chains, the fit and the posterior are checked.
    checks = check_joint(key[4], posterior)
    free = free_decays(measured, posterior, checks, seed=seed, report=report, keep=keep)
    posteriors = Posteriors(posterior, checks, free, paper)
    # Every test is compared with its prediction.
    comparisons = compare(order, prepared, posteriors, report)
    findings = *checks.findings, *free.findings, *prediction_findings(comparisons.tree)
    tests, limit = predicted_tests(comparisons.tree), campaign.settings.predictive
    verdict = judged(findings, checks.amendments, tests, posterior.fitted.data.laws, limit)
    sentences = (
        *prepared.sentences, *paper.statements, *checks.statements, *comparisons.statements,
        about_instruments(order, prepared),
    )  # fmt: skip
    statements = [sentence for sentence in sentences if sentence]
    identification = identified(measured, posteriors, verdict, statements)
    return finished_study(order, prepared, identification, comparisons)
