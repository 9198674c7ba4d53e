"""`jbw.identify`: a campaign in; a posterior with its verdict, bands and summary out."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import xarray as xr

from jbw.campaign.gains import force_per_unit
from jbw.campaign.load import Campaign
from jbw.errors import Attempts
from jbw.identification.assemble import entered, measured_in
from jbw.identification.instruments import as_recorded, instruments_sentence, sensors_of
from jbw.identification.laplace import fit_alone
from jbw.identification.paper.sequential_vs_joint import compare_routes
from jbw.identification.prepare import Fitted
from jbw.identification.procedure import Identification, Report, run_procedure
from jbw.identification.usable import usable
from jbw.inference.samplers.chunked_run import Keep, no_checkpoint
from jbw.inference.space.box import require_float64
from jbw.measurement.records import INPUTS, Test, drive_of
from jbw.observables.drives import named
from jbw.observables.records import compile_beside
from jbw.quantities import gain_unit
from jbw.report.opening import opening
from jbw.study.collect import collect
from jbw.study.final import for_use
from jbw.study.identifiability import as_group, look_again
from jbw.study.look import look_groups, look_quietly
from jbw.study.quick import first_answer, fit_lines
from jbw.study.study import Study
from jbw.study.summary import (
    fitted_and_held_out,
    record_of,
    steps_group,
    widened_by_instruments,
)
from jbw.study.surroundings import constants_sentence
from jbw.verification.predictive_basis import AS_RECORDED
from jbw.verification.verify import with_predictions

logger = logging.getLogger("jbw")


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

    def once(campaign: Campaign, keep: Keep) -> Study:
        return _identified(
            campaign, seed=seed, truth=truth, report=report, keep=keep, command=command, quick=quick
        )

    if campaign.settings.final and not quick:
        return for_use(once, campaign, keep, report)
    return once(campaign, keep)


def _identified(
    campaign: Campaign,
    *,
    seed: int | None,
    truth: Mapping[str, float] | None,
    report: Report,
    keep: Keep,
    command: str | None,
    quick: bool,
) -> Study:
    """The procedure once, as far as `identify` says."""
    started = perf_counter()
    seed = campaign.settings.seed if seed is None else seed
    gain = force_per_unit(campaign)
    several = campaign.structure is not None and len(campaign.structure.modes) > 1
    tests, left_out = usable(campaign.tests, campaign.settings, gain, several_modes=several)
    for sentence in left_out:
        report(sentence)
    if not several:
        compile_beside(tests, campaign.laws)
    # Before anything is sampled: what is wrong with a record then costs no result.
    report("Reading the records without a model")
    looked = look_quietly(replace(campaign, tests=tests))
    seen = measured_in(campaign, report, tests)
    if quick:
        found = fit_alone(seen, seed=seed, report=report)
        name_gain_unit(tests, found)
        return first_answer(
            campaign, seen, looked, found, left_out=left_out, truth=truth, seed=seed,
            command=command, started=started,
        )  # fmt: skip

    def at_fit(ready: Fitted) -> None:
        lines = Attempts(report).make(
            "The answer of the fit", lambda: fit_lines(seen, ready, seed), []
        )
        for line in lines:
            report(line)
        report("Drawing the posterior")

    found = run_procedure(seen, seed=seed, report=report, keep=keep, at_fit=at_fit)
    source = name_gain_unit(tests, found)
    # From here on the posterior is drawn: what cannot be made of it is left out and said.
    attempts = Attempts(report)
    known = attempts.make(
        "The study of identifiability", lambda: look_again(found, campaign.settings, report), None
    )
    tree = collect(seen, found, seed, truth, report, campaign.settings, attempts)
    main = found.main
    verdict = with_predictions(main.verdict, tree)
    outside = attempts.make(
        "The constant of the modes outside the band",
        lambda: constants_sentence(main.posterior["posterior"].to_dataset(), main.held, source),
        None,
    )
    compared = attempts.make("The comparison of the routes", lambda: compare_routes(found), {})
    said = (*left_out, *main.statements, *([outside] if outside else []), *attempts.said)
    sensors = sensors_of(seen.chosen)
    said = (*said, instruments_sentence(campaign.instruments, sensors))
    main = replace(main, verdict=verdict, statements=said)
    found = replace(found, steps={**found.steps, main.name: main})
    wide = widened_by_instruments(campaign, sensors, found, seed)
    if wide is not None:
        recorded = tree["posterior"].to_dataset()
        attrs = {name: values.attrs for name, values in recorded.data_vars.items()}
        tree[AS_RECORDED] = xr.DataTree(as_recorded(recorded, wide))
        widened = {name: wide[name].assign_attrs(attrs[name]) for name in recorded.data_vars}
        tree["posterior"] = xr.DataTree(recorded.assign(widened))
    record = record_of(
        campaign, found, tree, verdict=verdict, truth=truth, compared=compared, seed=seed,
        command=command, started=started, tests=fitted_and_held_out(seen), wide=wide,
    )  # fmt: skip
    record["look"] = looked.record
    tree = xr.DataTree.from_dict({**tree.to_dict(), **look_groups(looked, entered(seen))})
    record["opening"] = list(opening(record, tree))
    tree["procedure"] = xr.DataTree(steps_group(record))
    if known is not None:
        tree["identifiability"] = xr.DataTree(as_group(known))
        record["identifiability"] = known.summary()
    return Study(tree, record, campaign, found)


def name_gain_unit(tests: Sequence[Test], found: Identification) -> str:
    """Write the unit of the gain, which the returned one of the source decides, into posteriors.

    That of a force where none drives anything: of loops, whose modal mass free decays tell.
    """
    driven = [test for test in tests if not set(INPUTS).isdisjoint(test.records[0].channels)]
    units = {drive_of(t): t.records[0].units[t.records[0].source] for t in reversed(driven)}
    for step in found.steps.values():
        draws = step.posterior["posterior"]
        own = {drive: named("gain", drive) for drive in units if named("gain", drive) in draws}
        rest = [drive for drive in map(drive_of, driven) if drive not in own]
        if "gain" in draws:
            draws["gain"].attrs["units"] = gain_unit(units[rest[0]] if rest else "N")
        for drive, name in own.items():
            draws[name].attrs["units"] = gain_unit(units[drive])
    return next(iter(units.values()), "")
