"""The verdict is never ok by accident: every pathology has its finding."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from pasted import lines_of, pasted
from scipy.signal import lfilter
from scipy.stats import truncnorm

from jbw.identification import accuracy
from jbw.identification.accuracy import OF_MISFIT, within_misfit, within_unseen
from jbw.inference.posterior.finding import (
    ASKED_BY,
    Amendment,
    answers,
    checked,
    usable_within,
)
from jbw.inference.posterior.remedies import more_draws, put_bounds, wider
from jbw.inference.posterior.verdict import Finding, judge, leaning, verdict
from jbw.inference.space.box import box
from jbw.report.messages.findings import explanations

BOX = box({"alpha": (1.0, 2.0), "delta": (1.0, 2.0)})


@pytest.mark.parametrize(("change", "status"), [(0.05, "ok"), (0.2, "failed"), (None, None)])
def test_a_solver_may_move_a_mean_by_a_tenth_of_its_deviation(monkeypatch, change, status):
    """A change of the log likelihood of this standard deviation moves no mean by more of them."""
    found = None if change is None else change * np.array([-1.0, 1.0])
    monkeypatch.setattr(accuracy, "solver_change", lambda *_: found)
    posterior = xr.Dataset({"alpha": (("chain", "draw"), np.ones((1, 40)))})
    finding = accuracy.solver_finding(posterior, SimpleNamespace(parts=()))
    assert (None if finding is None else finding.status) == status


def healthy(num_chains=4, num_draws=1000, seed=0):
    rng = np.random.default_rng(seed)
    shape = (num_chains, num_draws)
    draws = {name: rng.normal(1.5, 0.05, size=shape) for name in BOX.names}
    stats = {
        "diverging": np.zeros(shape, bool),
        "failed": np.zeros(shape, bool),
        "reached_max_tree_depth": np.zeros(shape, bool),
        "energy": rng.normal(size=shape),
    }
    return draws, stats


def judged(draws, stats, facts=None, **options):
    dims = ("chain", "draw")
    groups = {"posterior": draws, "sample_stats": stats}
    tree = xr.DataTree.from_dict(
        {
            group: xr.Dataset({name: (dims, values) for name, values in variables.items()})
            for group, variables in groups.items()
        }
    )
    tree.attrs.update(facts or {})
    return verdict(tree, BOX, **options)


def status_of(result, code):
    return next(finding.status for finding in result.findings if finding.code == code)


def test_a_healthy_posterior_is_ok():
    result = judged(*healthy(), chi_square=(95.0, 100))
    assert result.status == "ok", result
    assert not any(finding.action for finding in result.findings)


def _frozen(draws, stats):
    draws["alpha"][2] = 1.4


def _nan(draws, stats):
    draws["delta"][0, 7] = np.nan


def _apart(draws, stats):
    draws["alpha"][0] += 0.2


def _two_modes(draws, stats):
    draws["alpha"][:2] = 1.2 + 0.1 * (draws["alpha"][:2] - 1.5)
    draws["alpha"][2:] = 1.8 + 0.1 * (draws["alpha"][2:] - 1.5)


def _sticky(draws, stats):
    draws["delta"][:] = np.repeat(draws["delta"][:, ::20], 20, axis=1)


def _piled(draws, stats):
    draws["alpha"][:] = 2 - 0.05 * np.random.default_rng(0).exponential(size=(4, 1000))


def _ridge(draws, stats):
    rng = np.random.default_rng(0)
    along = rng.uniform(-0.33, 0.33, size=(4, 1000))
    draws["alpha"][:] = 1.4 * np.exp(along)
    draws["delta"][:] = 1.4 * np.exp(-along + 0.01 * rng.normal(size=along.shape))


def _diverging(draws, stats):
    stats["diverging"][1, 10] = True


def _failing(draws, stats):
    stats["failed"][:, ::50] = True


def _shallow(draws, stats):
    stats["reached_max_tree_depth"][:, ::10] = True


def _heavy(draws, stats):
    stats["energy"][:] = np.cumsum(stats["energy"], axis=1)


PATHOLOGIES = {
    "frozen_chain": _frozen,
    "non_finite": _nan,
    "r_hat": _apart,
    "ess_bulk": _sticky,
    "at_bound": _piled,
    "unidentified": _ridge,
    "divergences": _diverging,
    "failed_solves": _failing,
    "tree_depth": _shallow,
    "e_bfmi": _heavy,
}


@pytest.mark.fault(26, 28, 34, 36, 38)
@pytest.mark.parametrize("code", PATHOLOGIES)
def test_every_pathology_fails_with_what_to_do(code):
    draws, stats = healthy()
    PATHOLOGIES[code](draws, stats)
    result = judged(draws, stats)
    assert result.status == "failed"
    finding = next(f for f in result.findings if f.code == code)
    assert finding.status == "failed"
    assert finding.action
    assert finding.reason.endswith(".")
    assert not isinstance(finding.values, str)


# What no key of a campaign mends, and bounds that only the person can know.
NO_LINE = ("non_finite", "chi_square", "modes", "unidentified")


@pytest.mark.parametrize("code", [code for code in PATHOLOGIES if code not in NO_LINE])
def test_every_remedy_is_a_line_that_a_campaign_file_takes(code):
    draws, stats = healthy()
    PATHOLOGIES[code](draws, stats)
    for finding in judged(draws, stats).findings:
        if finding.status != "ok" and finding.code not in NO_LINE:
            assert lines_of(finding.action), finding
            pasted(finding.action)


AT_ONCE = {
    "khat": 0.9, "ess_weights": 12.0, "inverse_temperature": 0.5, "quadrature_error": 0.1,
    "budget_spent_s": 900.0, "sampler": "nuts",
}  # fmt: skip


def test_remedies_of_samplers_that_draw_at_once_are_lines_too():
    draws, stats = healthy()
    _sticky(draws, stats)
    found = {one.code: one for one in judged(draws, stats, AT_ONCE).findings}
    for code in ("khat", "ess_weights", "temperature", "quadrature"):
        assert pasted(found[code].action).settings.sampler in ("nuts", "tempered_smc")
    # Two hundred of 400: at least twice the time that was spent.
    assert pasted(found["budget"].action).settings.budget_s >= 1800
    draws, stats = healthy(num_chains=1, num_draws=4000)
    alone = {one.code: one for one in judged(draws, stats).findings}
    assert pasted(alone["r_hat"].action).settings.num_chains == 4


@pytest.mark.parametrize(
    ("least", "count"),
    [(200.0, 2000), (130.0, 3100), (3.0, None)],
)
def test_so_many_draws_as_are_missing_are_asked_for(least, count):
    """400 over the least times 1000, to two digits upwards; beyond 20 times, another sampler."""
    assert more_draws(1000, least, 400.0) == {"num_samples": count, "sampler": "nuts"}
    assert more_draws(1000, 0.0, 400.0, "nuts") == {"num_samples": None, "sampler": "tempered_smc"}


@pytest.mark.parametrize(
    ("bounds", "sides", "wide"),
    [
        ((1.0, 2.0), ["upper"], (1.0, 3.0)),
        ((1.0, 2.0), ["lower"], (0.1, 2.0)),  # what is positive stays so
        ((-1.0, 2.0), ["lower", "upper"], (-4.0, 5.0)),
        ((0.0, 2.0), ["upper"], (0.0, 4.0)),
    ],
)
def test_a_bound_is_moved_by_the_width_of_the_box(bounds, sides, wide):
    assert wider(bounds, sides) == pytest.approx(wide)


@pytest.mark.parametrize("bounds", [(117.9123, 118.0877), (2.1e-7, 3e3), (-1e-9, 1e-9)])
def test_a_line_of_bounds_never_cuts_the_box(bounds):
    low, high = pasted(put_bounds("cubic" if bounds[0] < 0 else "omega_n", bounds)).settings.prior[
        "cubic" if bounds[0] < 0 else "omega_n"
    ]
    assert low <= bounds[0]
    assert high >= bounds[1]
    assert high - low <= 1.02 * (bounds[1] - bounds[0])


def test_what_the_stiffness_ends_is_not_widened():
    draws, stats = healthy()
    _piled(draws, stats)
    found = judged(draws, stats, ending=("alpha",)).findings
    (finding,) = (one for one in found if one.code == "at_bound")
    assert finding.status == "usable"  # a lower limit is an answer
    assert lines_of(finding.action) == []


@pytest.mark.fault(29)
def test_chains_in_two_modes_fail():
    draws, stats = healthy()
    _two_modes(draws, stats)
    assert status_of(judged(draws, stats), "r_hat") == "failed"


@pytest.mark.fault(26)
def test_the_bound_is_named_with_its_side():
    draws, stats = healthy()
    _piled(draws, stats)
    finding = next(f for f in judged(draws, stats).findings if f.code == "at_bound")
    assert (finding.values["name"], finding.values["side"]) == ("alpha", "upper")
    # The box, 1 to 2, twice as wide upwards: the rule of `widened`.
    assert pasted(finding.action).settings.prior == {"alpha": (1.0, 3.0)}


@pytest.mark.fault(26)
@pytest.mark.parametrize(
    ("place", "status"), [(0.0, "failed"), (0.25, "failed"), (2.0, "ok"), (8.0, "ok")]
)
def test_a_posterior_leans_on_its_bound_by_its_own_width_not_the_boxs(place, status):
    draws, stats = healthy()
    # A normal of a thousandth of the box, cut off so many deviations below its mean.
    uniform = np.random.default_rng(1).uniform(size=(4, 1000))
    draws["delta"] = truncnorm.ppf(uniform, -place, np.inf, loc=1.0 + 1e-3 * place, scale=1e-3)
    finding = next(f for f in judged(draws, stats).findings if f.code == "at_bound")
    assert finding.status == status, finding.reason


@pytest.mark.fault(28)
def test_the_ridge_is_named():
    draws, stats = healthy()
    _ridge(draws, stats)
    finding = next(f for f in judged(draws, stats).findings if f.code == "unidentified")
    assert "alpha*delta" in finding.values["text"]
    # The posterior's own interval as a prior would count the data twice: no line to paste, and
    # the bounds that are named are those of the box.
    assert lines_of(finding.action) == []
    assert (finding.remedy["low"], finding.remedy["high"]) == (1.0, 2.0)


@pytest.mark.fault(37)
def test_one_chain_is_not_assessed():
    draws, stats = healthy(num_chains=1, num_draws=4000)
    result = judged(draws, stats)
    assert result.status == "not assessed"
    assert status_of(result, "r_hat") == "not assessed"


@pytest.mark.fault(31)
@pytest.mark.parametrize("ratio", [0.01, 9.0, float("nan")])
def test_a_chi_square_out_of_range_fails(ratio):
    result = judged(*healthy(), chi_square=(100 * ratio, 100))
    assert status_of(result, "chi_square") == "failed"


def test_nothing_looked_at_is_not_ok():
    assert judge([]).status == "not assessed"
    fine = Finding("a", "ok", "Fine.", 0.0)
    assert judge([fine, Finding("b", "failed", "Bad.", 1.0, "Act.")]).status == "failed"


def test_the_verdict_answers_three_questions():
    fine = [Finding(code, "ok", f"{code}.", 0.0) for code in ("r_hat", "ess_bulk", "unidentified")]
    law = [
        Finding("held_out_coverage", "ok", "Inside.", 1.0),
        Finding("coloured_residual", "failed", "Coloured.", 0.9, "Doubt the law."),
    ]
    told = dict(answers([*fine, *law]))
    assert {name: answer.status for name, answer in told.items()} == {
        "sampling": "ok", "law": "failed", "knowledge": "ok",
    }  # fmt: skip
    assert told["law"].because == "Coloured."
    assert told["sampling"].because == "ess_bulk."
    assert list(dict(answers(fine))) == ["sampling", "knowledge"]


def test_what_an_amendment_adds_to_several_findings_is_said_once_in_an_answer():
    codes = ("coloured_residual", "chi_square")
    law = [Finding(code, "failed", f"{code}.", 1.0) for code in codes]
    usable = usable_within(codes, "Usable within 2 %.")
    farther = Amendment(codes, "usable", "usable", "Held-out tests: 1 %.")
    judged = judge(law, [usable, farther])
    ((_, answer),) = answers(judged.findings)
    additions = "Usable within 2 %. Held-out tests: 1 %."
    assert answer.because == f"coloured_residual. chi_square. {additions}"
    assert [finding.reason for finding in judged.findings] == [
        f"coloured_residual. {additions}",
        f"chi_square. {additions}",
    ]


def test_a_finding_that_fails_after_all_does_not_say_within_what_it_was_usable():
    usable = usable_within(("misfit",), "Usable within 2 %.")
    missed = Amendment(("misfit",), "usable", "failed", "Held-out tests: 9 %.", "Fit them too.")
    (finding,) = judge([Finding("misfit", "failed", "Misfit.", 1.0)], [usable, missed]).findings
    assert (finding.status, finding.reason) == ("failed", "Misfit. Held-out tests: 9 %.")
    assert finding.action == "Fit them too."


def test_every_finding_of_the_law_and_of_knowledge_has_a_page():
    assert set(ASKED_BY) <= set(explanations())


def looked_at(**statuses):
    return judge(Finding(code, status, f"Seen {code}.", 1.0) for code, status in statuses.items())


def test_the_worst_of_the_findings_is_the_verdict():
    assert looked_at(r_hat="ok", coloured_residual="usable").status == "usable"
    assert looked_at(r_hat="not assessed", coloured_residual="usable").status == "not assessed"
    assert looked_at(r_hat="failed", coloured_residual="usable").status == "failed"
    assert judge([]).status == "not assessed"


@pytest.mark.parametrize(("error", "status"), [(0.049, "usable"), (0.051, "failed")])
def test_misfit_is_usable_up_to_a_twentieth_of_every_test(error, status):
    found = looked_at(r_hat="ok", coloured_residual="failed", repeatability="ok")
    judged = judge(found.findings, [within_misfit({"weak": 0.01, "strong": error})])
    assert judged.status == status
    with_this_error = "With this error the law may be used"
    assert (with_this_error in judged.findings[1].reason) == (status == "usable")


def test_no_other_failure_becomes_usable():
    found = looked_at(coloured_residual="failed", simpler_model="failed", r_hat="failed")
    judged = judge(found.findings, [within_misfit({"sweep": 0.01})])
    assert judged.status == "failed"
    assert [one.status for one in judged.findings] == ["usable", "failed", "failed"]
    assert judge(found.findings, [within_misfit({"sweep": np.nan})]) == found
    judged = judge(found.findings, [usable_within(("r_hat",), "Yet.")])
    assert judged.findings[2].reason == "Seen r_hat. Yet."


@pytest.mark.parametrize(
    ("fitted", "unseen", "status"),
    [
        ([0.018, 0.018], [0.24, 0.02], "failed"),  # rms 0.17: a clock that is off in one run
        ([0.018, 0.018], [0.026, 0.02], "usable"),  # rms 0.0232, 1.29 times as much
        ([0.03, 0.04], [], "usable"),
    ],
)
def test_a_statement_of_use_quotes_what_no_fit_saw(fitted, unseen, status):
    found = judge([checked("coloured_residual", False, "Coloured.", 0.4, "Another law.")])
    unseen_errors = within_unseen(OF_MISFIT, fitted, unseen, "tests that were not fitted")
    judged = judge(found.findings, [within_misfit({"sweep": 0.018}), unseen_errors])
    assert judged.status == status
    (finding,) = judged.findings
    if unseen:
        assert "tests that were not fitted: " in finding.reason
        assert ": 17 %, compared with" in finding.reason or status == "usable"
    if status == "failed":
        assert "Another law." in finding.action
    untouched = judge([checked("r_hat", True, "Mixed.", 1.0, "")])
    amendment = within_unseen(OF_MISFIT, fitted, unseen, "tests")
    assert judge(untouched.findings, [amendment]) == untouched


def test_a_pile_at_a_negative_lower_bound_is_found():
    """A joint that stiffens: delta ends at -2/Y, which is a bound and no end of the quantity."""
    rng = np.random.default_rng(5)
    draws = {"delta": -500.0 + rng.exponential(30.0, (4, 1000))}
    around = {"delta": rng.normal(0.0, 50.0, (4, 1000))}
    bounds = box({"delta": (-500.0, 5000.0)})
    ((name, side, share),) = leaning(draws, bounds)
    assert (name, side) == ("delta", "lower")
    # Within 1 % of the 99 % span, 30 ln(200): 1 - exp(-0.053) of an exponential law.
    assert share == pytest.approx(1 - np.exp(-0.01 * np.log(0.995 / 0.005)), abs=0.015)
    assert list(leaning(around, bounds)) == []
    ended = {"gamma": rng.exponential(30.0, (4, 1000))}
    assert list(leaning(ended, box({"gamma": (0.0, 5000.0)}))) == []


def test_one_chain_of_bad_energy_among_good_ones_is_found():
    """E-BFMI of white noise is 2; of a random walk of 1000 steps it is next to 0."""
    draws, stats = healthy()
    assert status_of(judged(draws, stats), "e_bfmi") == "ok"
    stats["energy"][2] = np.cumsum(stats["energy"][2])
    found = {one.code: one for one in judged(draws, stats).findings}["e_bfmi"]
    assert found.status == "failed"
    energy = stats["energy"][2]
    assert found.number == pytest.approx(np.mean(np.diff(energy) ** 2) / np.var(energy), rel=0.01)


def correlated(coefficient, rng, shape):
    """Unit normal numbers along the last axis, each the last one times a coefficient and noise."""
    noise = rng.standard_normal(shape)
    return lfilter([np.sqrt(1 - coefficient**2)], [1, -coefficient], noise)


@pytest.mark.parametrize(("shift", "status"), [(0.0, "ok"), (0.3, "failed")])
def test_chains_a_little_apart_fail(shift, status):
    """Means by +-0.3 of their deviation: R-hat of Gelman and Rubin is about 1.06."""
    draws, stats = healthy()
    draws["alpha"] += shift * 0.05 * np.array([1, -1, 1, -1])[:, None]
    between, within = np.var(draws["alpha"].mean(axis=1), ddof=1), draws["alpha"].var(axis=1).mean()
    by_hand = np.sqrt(1 + between / within)
    assert 1.03 < by_hand < 1.09 or by_hand < 1.005
    found = {finding.code: finding for finding in judged(draws, stats).findings}["r_hat"]
    assert found.status == status
    assert found.number == pytest.approx(by_hand, abs=0.02)  # of ranks, and of halves of chains


@pytest.mark.parametrize(("coefficient", "status"), [(0.5, "ok"), (0.9, "failed")])
def test_draws_worth_some_hundreds_fail(coefficient, status):
    """4000 draws of correlation c are worth 4000 (1 - c) / (1 + c): 1333 and 211."""
    draws, stats = healthy()
    draws["alpha"] = 1.5 + 0.05 * correlated(coefficient, np.random.default_rng(1), (4, 1000))
    found = {finding.code: finding for finding in judged(draws, stats).findings}["ess_bulk"]
    assert found.status == status
    worth = 4000 * (1 - coefficient) / (1 + coefficient)
    assert found.number == pytest.approx(worth, rel=0.35)  # of halves of 26 correlation times


@pytest.mark.parametrize(("coefficient", "status"), [(0.7, "ok"), (0.9, "failed")])
def test_energies_that_creep_fail(coefficient, status):
    """E-BFMI of energies of correlation c is 2 (1 - c): 0.6 and 0.2."""
    draws, stats = healthy()
    stats["energy"] = correlated(coefficient, np.random.default_rng(1), (4, 1000))
    found = {finding.code: finding for finding in judged(draws, stats).findings}["e_bfmi"]
    assert found.status == status
    assert found.number == pytest.approx(2 * (1 - coefficient), rel=0.25)


@pytest.mark.parametrize(("khat", "status"), [(0.65, "ok"), (0.75, "failed"), (2.0, "failed")])
def test_weights_of_a_heavy_tail_fail(khat, status):
    """0.7 is where Vehtari et al. (2024) say that weighted means no longer settle."""
    assert status_of(judged(*healthy(), {"khat": khat}), "khat") == status


@pytest.mark.parametrize(("ratio", "status"), [(0.15, "failed"), (4.5, "ok"), (5.5, "failed")])
def test_a_fit_of_five_times_the_noise_fails(ratio, status):
    assert status_of(judged(*healthy(), chi_square=(100.0 * ratio, 100)), "chi_square") == status
