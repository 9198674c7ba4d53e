"""Comparison of every test of a campaign with the model, and the findings from it.

A narrow posterior of a wrong law passes every check of its chains. It fails if a simpler oscillator
predicts better, or if held-out tests lie outside its bands.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import norm

from jbw.errors import Attempts
from jbw.identification.accuracy import CLOSE, another_law
from jbw.identification.assemble import Measured
from jbw.identification.procedure import Posteriors
from jbw.identification.selection import DecaySplit
from jbw.inference.posterior.finding import Finding, amended, checked
from jbw.inference.posterior.remedies import put
from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.dataset import Dataset
from jbw.observables.decay import Decays
from jbw.quantities import MODES, derivative_order
from jbw.report.messages import discrepancy as withholding
from jbw.report.messages import verification as messages
from jbw.results.attributes import DrawnPosterior, PredictedTest
from jbw.verification.backbone import amplitude_verification
from jbw.verification.decays import first_mode_alone, modes_of_draws, verify_decays
from jbw.verification.forced import verify_forced
from jbw.verification.grade import LEAST_COVERAGE, LEAST_VALUES
from jbw.verification.places import place
from jbw.verification.predicted import ALIKE, Source, without_band
from jbw.verification.predictive_basis import NUM_DRAWS, Basis, Draws
from jbw.verification.reference_oscillators import Reference, of_run, references

# If the law's error is this many times that of a simpler oscillator, the oscillator is the better
# model.
BETTER = 1.1
# If both oscillators have equal errors, noise may be the whole error. The band then contains the
# noise twice, so that the limit of the check is the root of 2.
NOISE_BESIDE = 2**0.5
REACH = float(norm.ppf(QUANTILES[-1]))  # half width of a 99 % band, in standard deviations
Groups = dict[str, xr.Dataset]


def verify(
    measured: Measured, posteriors: Posteriors, basis: Basis, seed: int, attempts: Attempts
) -> Groups:
    """Compare every test with the model and the reference models; return the results by path.

    A comparison that cannot be made is omitted, with a message in `attempts`.
    """

    def simpler(draws: Draws, data: Dataset, *names: str) -> dict[str, Reference]:
        mean = {name: float(np.mean(draws[name])) for name in names or draws}
        # Without a joint the model is a linear oscillator.
        kinds = [kind for kind in measured.settings.compare_with if data.laws or kind != "linear"]
        return references(data, mean, kinds) if kinds else {}

    attempts.report(messages.EVERY_TEST)
    draws, data = basis.draws(NUM_DRAWS, seed=seed), posteriors.joint.fitted.data
    source = Source(basis, draws, seed=seed)
    others = attempts.make(messages.WITHOUT_HYSTERESIS, partial(simpler, draws, data), {})
    groups = verify_forced(source, others, measured, attempts)
    if measured.decays is not None and (reduced := posteriors.free.data) is not None:
        attempts.report(messages.FREE_DECAYS)
        groups |= _verify_free(measured.decays, reduced, basis, simpler, seed, attempts)
    return groups


def _verify_free(
    decays: DecaySplit,
    reduced: Decays,
    basis: Basis,
    simpler: Callable[..., dict[str, Reference]],
    seed: int,
    attempts: Attempts,
) -> Groups:
    """Compare free decays with the model, both record by record and against amplitude."""
    groups: Groups = {}
    together, num_fitted = decays.together, len(decays.fitted.records)
    draws = basis.draws_for(together, NUM_DRAWS)

    def compared() -> list[xr.Dataset]:
        others = simpler(draws, *_freely(draws, reduced))
        free = Source(basis, draws, of_run(others, None), seed=seed)
        return verify_decays(free, together, num_fitted)

    def against_amplitude() -> xr.Dataset:
        first_mode = first_mode_alone(together, modes_of_draws(draws))
        return amplitude_verification(first_mode, num_fitted, draws, basis.laws)

    unit = float(np.mean(draws["omega_n"])) ** derivative_order(together.records[0].response)
    comparisons = attempts.make(messages.DECAYS_COMPARED, compared, ())
    for name, comparison in zip(decays.names, comparisons, strict=False):
        marked, begins = comparison.assign_attrs(discrepancy=0), comparison.attrs["level"] / unit
        if not PredictedTest.of(marked).fitted:
            marked = marked.assign_attrs(discrepancy=int(basis.misses))
            if basis.y_peak > 0:
                marked = marked.assign_attrs(extrapolation=begins / basis.y_peak)
            why = basis.why_withheld((begins,))
            marked = without_band(marked, why) if why else marked
        groups[place("verification/decay", name)] = marked
    curves = attempts.make(messages.DECAY_CURVES, against_amplitude, None)
    return groups if curves is None else {**groups, "/verification/amplitude": curves}


def _freely(draws: Draws, decays: Decays) -> tuple[Any, ...]:
    """Return free decays as a dataset, and the names of all modes' parameters in free motion."""
    held = {ratio.name: 1.0 for _, _, ratio, *_ in MODES if ratio.name in draws}
    names = [quantity.name for mode in MODES for quantity in mode[:2] if quantity.name in draws]
    return Dataset.of([decays], held), "omega_n", "zeta", *names


def predicted_tests(tree: xr.DataTree) -> Mapping[str, PredictedTest]:
    """Return the attributes of each test's comparison with its prediction, by name."""
    parents = tree["verification"].children if "verification" in tree.children else {}
    return {
        name: PredictedTest.of_mapping({"group": group, **node.attrs})
        for group, parent in parents.items()
        for name, node in parent.children.items()
        if "nrmse" in node.attrs
    }


def prediction_findings(tree: xr.DataTree) -> list[Finding]:
    """Return findings on the errors of simpler oscillators, and on coverage of held-out tests."""
    tests = predicted_tests(tree)
    laws = DrawnPosterior.of(tree).laws or ()
    return [*_simpler(tests, laws), *_replaced(tests, laws), *_coverage(tests, laws)]


def _simpler(tests: Mapping[str, PredictedTest], laws: Sequence[str]) -> list[Finding]:
    errors = {
        (name, kind): (test.nrmse, other)
        for name, test in tests.items()
        for kind, other in (("linear", test.nrmse_linear), ("cubic", test.nrmse_cubic))
        if np.isfinite(other) and other > 0
    }
    ratios = {key: nrmse / other for key, (nrmse, other) in errors.items()}
    # A model that cannot be solved counts as worse than every other model.
    ratios = {key: ratio if np.isfinite(ratio) else np.inf for key, ratio in ratios.items()}
    if not ratios:
        return []
    name, kind = worst = max(ratios, key=lambda pair: ratios[pair])
    fit_status = "fitted" if tests[name].fitted else "never fitted"
    error, other = errors[worst]
    values = {
        "test": name, "fit_status": fit_status, "error": error, "kind": kind,
        "simpler": other, "limit": BETTER,
    }  # fmt: skip
    remedy = {"another_law": another_law(laws)}
    return [checked("simpler_model", ratios[worst] < BETTER, values, ratios[worst], remedy)]


def _replaced(tests: Mapping[str, PredictedTest], laws: Sequence[str]) -> list[Finding]:
    """Check whether the model discrepancy in a band exceeds even a linear oscillator's error.

    Empty if the bands have no discrepancy, or the joint has little effect: the linear oscillator is
    close, and no worse than the joint.
    """
    limits, ratios = {}, {}
    for name, test in tests.items():
        nrmse, linear, width = test.nrmse, test.nrmse_linear, test.half_width
        if test.discrepancy > 0 and linear > min(BETTER * nrmse, CLOSE) and np.isfinite(width):
            limits[name] = 1.0 if linear > BETTER * nrmse else NOISE_BESIDE
            ratios[name] = width / REACH / linear
    if not ratios:
        return []
    worst = max(ratios, key=lambda name: ratios[name] / limits[name])
    values = {"test": worst, "ratio": ratios[worst], "limit": limits[worst]}
    remedy, ok = {"another_law": another_law(laws)}, ratios[worst] < limits[worst]
    return [checked("law_replaced", ok, values, ratios[worst], remedy)]


def _coverage(tests: Mapping[str, PredictedTest], laws: Sequence[str]) -> list[Finding]:
    # Harmonics and loops at another level may have other noise. Therefore their coverage is not
    # checked if typical noise is assumed.
    shares = {
        name: test.coverage
        for name, test in tests.items()
        if not test.fitted
        and np.isfinite(test.coverage)
        and test.num_values >= LEAST_VALUES
        and (test.group == "sweep" or test.noise != ALIKE)
    }
    withheld = [name for name, test in tests.items() if test.withheld]
    if not shares:
        if not withheld:
            return []
        reason, action = withholding.bands_withheld(withheld), withholding.FIT_THAT_LEVEL
        return [Finding("held_out_coverage", "not assessed", reason, float("nan"), action)]
    worst = min(shares, key=lambda name: shares[name])
    values = {"test": worst, "share": shares[worst], "limit": LEAST_COVERAGE}
    # Every free decay has its own frequency already, so offsets of runs change nothing.
    has_runs = any(test.group != "decay" for test in tests.values())
    remedy = {"line": put("identify", "offsets", "runs") if has_runs else another_law(laws)}
    ok = shares[worst] >= LEAST_COVERAGE
    finding = checked("held_out_coverage", ok, values, shares[worst], remedy)
    if withheld:
        sentence = withholding.bands_withheld(withheld)
        finding = amended(finding, finding.status, sentence, withholding.FIT_THAT_LEVEL)
    return [finding]
