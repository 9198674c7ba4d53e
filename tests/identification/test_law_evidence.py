"""Laws side by side: scores of runs left out against quadrature, and a truth that is found."""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from scipy.optimize import least_squares
from scipy.special import logsumexp
from scipy.stats import norm
from tiers import represented_by

from jbw.campaign.load import Campaign
from jbw.campaign.settings import Identify
from jbw.errors import ConfigError
from jbw.identification import evidence, law_scores
from jbw.identification.assemble import assemble, measured
from jbw.identification.evidence import offset_changes, without_offsets
from jbw.identification.floors import own_lines, scatter_of_means
from jbw.identification.held_out import HeldOut
from jbw.identification.law_scores import log_evidence_wide, twice_as_wide
from jbw.identification.prepare import Fitted
from jbw.inference.posterior.verdict import GOOD_KHAT
from jbw.inference.space.box import bounds_by_name, box, from_unit
from jbw.inference.space.stated import StatedDensities
from jbw.law_comparison import compare
from jbw.law_comparison.answers import (
    _behind_by_runs,
    _of_offsets,
    _of_unseen,
    compared_rows,
    differences,
    stacking,
    statements,
)
from jbw.law_comparison.compare import compare_laws, errors_apart, unseen
from jbw.measurement.channels import rms
from jbw.measurement.records import Record, Test
from jbw.observables import dataset, noise
from jbw.observables.dataset import log_likelihood
from jbw.report.messages import laws as texts
from jbw.results.laws import StoredLaw, StoredLaws, StoredSharedRuns

OMEGA_N, ZETA, CUBIC, LEVELS = 500.0, 0.003, -2e10, (5.0, 20.0, 40.0, 60.0, 80.0, 100.0)


def curve(level, cubic=CUBIC, noise=0.02, points=30, seed=0):
    """Force [N per kg] that holds an acceleration, kappa = 3/4 k_3 Y^2 by the textbook."""
    rng = np.random.default_rng([seed, int(level)])
    freq = np.linspace(78.0, 81.0, points)
    omega = 2 * np.pi * freq
    y = level / omega**2
    force = y * (OMEGA_N**2 - omega**2 + 2j * ZETA * OMEGA_N * omega + 0.75 * cubic * y**2)
    records = []
    for _ in range(3):
        seen = force + noise * (rng.normal(size=points) + 1j * rng.normal(size=points))
        channels = {
            "frequency": freq,
            "force": np.abs(seen),
            "acceleration": np.full(points, level),
            "phase": np.pi - np.angle(seen),
        }
        units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
        records.append(Record(float("nan"), channels, units))
    return Test("frf", tuple(records), f"held at {level:g}", float(level))


@pytest.fixture(scope="module")
def linear():
    """A linear structure under the linear law: two parameters, which a grid integrates."""
    tests = [curve(level, cubic=0.0) for level in LEVELS[:4]]
    seen = measured(tests, Identify(), laws=(), gain=1.0)
    (one,), _ = evidence.candidates(jax.random.key(0), seen, [()], lambda said: None)
    return one


@pytest.mark.parametrize("way", ["draws", "points"])
def test_scores_of_left_out_runs_are_those_of_a_grid(linear, way, monkeypatch):
    if way == "points":  # as where the draws say too little
        monkeypatch.setattr(law_scores, "_by_draws", lambda *of: None)
    else:  # a run that moves the posterior far has none
        own, counted = law_scores._by_draws, []
        monkeypatch.setattr(
            law_scores, "_by_draws", lambda *of: counted.append(own(*of)) or counted[-1]
        )
    drawn = evidence.posterior(jax.random.key(2), linear)
    found = law_scores.left_out(jax.random.key(1), linear, *drawn)
    prior, data, best = linear.fitted.box, linear.fitted.data, linear.fitted.fit
    assert list(found.elpd) == [f"held at {level:g}" for level in LEVELS[:4]]
    std = np.sqrt(np.diag(best.covariance)) / np.asarray(prior.upper - prior.lower)
    sides = [one + 12 * s * np.linspace(-1, 1, 161) for one, s in zip(best.x, std, strict=True)]
    grid = jnp.asarray(np.stack(np.meshgrid(*sides), -1).reshape(-1, 2))
    terms = np.asarray(
        jax.lax.map(lambda x: log_likelihood(from_unit(x, prior), data), grid, batch_size=512)
    )
    for i, run in enumerate(found.elpd):
        rest = terms.sum(axis=1) - terms[:, i]
        exact = logsumexp(terms.sum(axis=1)) - logsumexp(rest)
        # Points worth 200 draws at least: an error of 0.07.
        np.testing.assert_allclose(found.elpd[run], exact, atol=0.25)
        assert 0.0 < found.error[run] < 0.2  # noise of 0.02 N, at the lowest level a tenth
    assert found.khat < 0.7
    assert way == "points" or any(one is not None for one in counted)


def test_scores_of_fits_alone_are_those_of_a_posterior_to_a_few_nats(linear):
    drawn = evidence.posterior(jax.random.key(2), linear)
    weighed = law_scores.left_out(jax.random.key(1), linear, *drawn)
    fits = law_scores.left_out_of_fits(linear)
    assert fits.error == weighed.error
    assert fits.khat is None
    for run, score in weighed.elpd.items():
        # Two parameters, known from the other runs: each moves a score by half a nat or so.
        assert abs(fits.elpd[run] - score) < 2.0


@pytest.mark.parametrize("way", ["draws", "points"])
def test_the_score_of_a_run_is_that_of_a_conjugate_normal(way, monkeypatch):
    """Of two values N(theta, 1) under theta ~ N(0, 1) the second is N(first / 2, 3/2) given it."""
    first, second = 0.4, 1.1
    times = np.array([1e6, 1.0])  # the second value is silenced, the first one kept
    monkeypatch.setattr(law_scores, "_told_by_terms", lambda *_: times)
    mean, variance = ((first + second) / 3, 1 / 3) if way == "draws" else (first / 2, 1 / 2)
    theta = norm.rvs(mean, np.sqrt(variance), size=(1, 20000), random_state=0)
    terms = np.stack([norm.logpdf(second, theta), norm.logpdf(first, theta)], axis=-1)
    if way == "draws":
        tree = xr.DataTree.from_dict({
            "/posterior": xr.Dataset({"theta": (("chain", "draw"), theta)}),
            "/log_likelihood": xr.Dataset({"terms": (("chain", "draw", "term"), terms)}),
        })  # fmt: skip
        score, _ = law_scores._by_draws(tree, ["theta"], None, None)
    else:
        weights = np.full(theta.size, 1 / theta.size)
        points = SimpleNamespace(terms=terms[0] / times, weights=weights, khat=0.1)
        monkeypatch.setattr(law_scores, "weighed_in", lambda *_: points)
        one = SimpleNamespace(fitted=SimpleNamespace(box=None, data=None))
        piece = HeldOut((), None, None)
        score, _ = law_scores._by_points(jax.random.key(0), one, piece, None)
    # Weights of 20,000 draws: 0.01 nats.
    assert score == pytest.approx(norm.logpdf(second, first / 2, np.sqrt(1.5)), abs=0.03)


def test_rough_scores_may_be_off_by_what_fits_say_otherwise_in_either_direction(monkeypatch):
    rough = {"a": (1.0, 0.9), "b": (-2.0, 0.8), "c": (50.0, 0.1)}
    one = SimpleNamespace(
        fitted=SimpleNamespace(box=SimpleNamespace(names=()), data=None, fit=None)
    )
    table = {run: HeldOut((run,), run, None) for run in rough}
    monkeypatch.setattr(law_scores, "each_run", lambda _: table)
    monkeypatch.setattr(law_scores, "_by_draws", lambda *of: rough[of[-1]])
    monkeypatch.setattr(law_scores, "_score_of_fit", lambda *_: 0.0)
    monkeypatch.setattr(law_scores, "_error_of", lambda *_: 0.1)
    found = law_scores.left_out(jax.random.key(0), one, None, None)
    assert (found.khat, found.doubt) == (0.9, 3.0)  # the third one's weights are good


def test_draws_about_a_fit_have_its_covariance(linear):
    fit, tree = linear.fitted.fit, evidence.about_fit(jax.random.key(0), linear)
    posterior = tree["posterior"].to_dataset()
    drawn = np.stack([posterior[name].values.ravel() for name in linear.fitted.box.names])
    std = np.sqrt(np.diag(fit.covariance))
    # 200 draws: a mean to 0.07 of a deviation, a deviation to 5 %; four times that.
    z = (drawn - np.array(list(fit.theta.values()))[:, None]) / std[:, None]
    np.testing.assert_allclose(z.mean(axis=1), 0.0, atol=0.28)
    np.testing.assert_allclose(z.std(axis=1), 1.0, atol=0.2)
    assert all(np.all(np.isfinite(posterior[name].values)) for name in posterior)
    assert any(name.startswith("noise_std") for name in posterior)


def test_the_likelihood_at_a_fit_bounds_the_evidence(linear):
    draws, _ = evidence.posterior(jax.random.key(2), linear)
    assert draws.attrs["log_evidence"] < evidence.likelihood_at(
        linear.fitted.fit, linear.fitted.data
    )


def test_a_run_that_is_silenced_counts_for_nothing(linear):
    data = linear.fitted.data
    theta = {name: jnp.asarray(value) for name, value in linear.fitted.fit.theta.items()}
    silent = noise.silenced(["held at 20"], data)
    moved = {**theta, "omega_n": theta["omega_n"] * 1.001}
    before, after = (np.asarray(log_likelihood(t, silent) - log_likelihood(t, data))
                     for t in (theta, moved))  # fmt: skip
    index = data.labels.index("held at 20")
    change = np.asarray(log_likelihood(moved, silent) - log_likelihood(theta, silent))
    assert abs(change[index]) < 1e-6
    np.testing.assert_allclose(np.delete(before, index), np.delete(after, index), atol=1e-9)


def test_terms_of_a_silenced_run_tell_what_it_says(linear):
    """As the difference of two evaluations has it: by the terms of either."""
    data, run = linear.fitted.data, "held at 20"
    rest = noise.silenced([run], data)
    times = law_scores._told_by_terms(data, rest)
    theta = {name: jnp.asarray(1.001 * value) for name, value in linear.fitted.fit.theta.items()}
    whole, silent = (np.asarray(log_likelihood(theta, one)) for one in (data, rest))
    exact = whole.sum() - silent.sum()
    np.testing.assert_allclose(whole @ (1 - 1 / times), exact, rtol=1e-10)
    np.testing.assert_allclose(silent @ (times - 1), exact, rtol=1e-10)
    tied = replace(data, scatters=jnp.ones((1, 2)), scatter=jnp.ones(2))
    assert law_scores._told_by_terms(tied, rest) is None


def test_floors_are_the_scatter_of_the_mean_and_a_line_of_each_runs_own():
    tests = [curve(level) for level in (40.0, 80.0)]
    data = assemble(measured(tests, Identify(), laws=("cubic",), gain=1.0))
    lines = own_lines(data, {"omega_n": OMEGA_N, "zeta": ZETA})
    scatter = []
    for test in tests:
        omega, forces = 2 * np.pi * test.records[0].channels["frequency"], []
        for one in test.records:
            forces.append(one.channels["force"] * np.exp(1j * (np.pi - one.channels["phase"])))
        mean, y = np.mean(forces, axis=0), test.level / omega**2
        size = np.linalg.norm(mean)
        scatter.append(np.sqrt(np.sum(np.abs(forces - mean) ** 2) / 2) / 3**0.5 / size)

        def left(x, omega=omega, y=y, mean=mean):
            own = x[0] * OMEGA_N
            miss = mean - y * (own**2 - omega**2 + 2j * x[1] * ZETA * own * omega)
            return np.concatenate([miss.real, miss.imag])

        best = least_squares(left, [1.0, 1.0], xtol=1e-12)
        # Fits stop where the cost changes by less than 1e-6 of itself.
        np.testing.assert_allclose(lines[test.name], np.sqrt(2 * best.cost) / size, rtol=1e-5)
    np.testing.assert_allclose(scatter_of_means(data), rms(scatter), rtol=1e-9)


def test_differences_and_stacking_are_closed_forms():
    rng = np.random.default_rng(0)
    base = rng.normal(size=8)
    scores = {"a": base, "b": base - 1.0 + 0.5 * np.arange(8) / 7, "c": base - 30.0}
    apart = differences(scores, "a")
    own = scores["b"] - base
    np.testing.assert_allclose(apart["b"], (own.sum(), np.sqrt(8) * own.std(ddof=1)))
    assert apart["a"] == (0.0, 0.0)
    weights = stacking(scores)
    # `a` predicts every run better than the others: all weight.
    np.testing.assert_allclose([weights[name] for name in "abc"], [1.0, 0.0, 0.0], atol=1e-3)
    # Each best on half of the runs by the same amount: half of the weight.
    halves = np.where(np.arange(8) % 2, 5.0, 0.0)
    weights = stacking({"odd": base + halves, "even": base + 5.0 - halves})
    np.testing.assert_allclose(weights["odd"], 0.5, atol=1e-3)
    # Hundreds of nats a run are no matter; nor is a law that is far behind on one run only.
    far = {"odd": 800.0 + base + halves, "even": 800.0 + base + 5.0 - halves, "off": base - 2000.0}
    weights = stacking(far)
    np.testing.assert_allclose([weights[name] for name in far], [0.5, 0.5, 0.0], atol=1e-3)


def row(evidence_of, error=0.1, count=1, hopeless=False, **more):
    wide = None if evidence_of is None else evidence_of - count * np.log(2.0)
    facts = {"error": error, "hopeless": hopeless, "log_likelihood": 20.0 - error * 1e3,
            "log_evidence": evidence_of, "log_evidence_wide": wide, "khat": 0.1,
            "elpd_doubt": 0.0, "khat_evidence": 0.1, "at_bound": [], "reached": [],
            "laws": []}  # fmt: skip
    return StoredLaw.read(facts | more)


def said_of(rows, runs, **more):
    """The sentences on a comparison of these laws."""
    return statements(StoredLaws(laws=rows, runs=list(runs), **more))


def test_few_runs_are_no_comparison_of_predictions():
    rows = {"a": row(0.0), "b": row(-3.0), "c": row(-20.0)}
    rows = compared_rows(rows, {name: np.zeros(3) for name in rows})
    assert [one.answer for one in rows.values()] == ["best", "not told apart", "worse"]
    assert rows["a"].weight is None
    said = said_of(rows, "xyz", floor=0.09, line=0.035, lines={"x": 0.03, "y": 0.04})
    assert said[:5] == [
        texts.best_by_evidence("a", 3, 5),
        texts.equivalent(["b"]),
        texts.worse(["c"]),
        texts.against_repeats("a", 0.1, 0.09, near=True),
        texts.linear_by_session(0.035, 0.03, 0.04),
    ]


def test_other_kinds_are_predicted_by_the_law_whose_worst_kind_is_least():
    rows = {
        "a": row(0.0, error_across={"sweeps": 0.02, "loops": 0.3}),
        "b": row(-3.0, error_across={"sweeps": 0.03, "loops": 0.1}),
    }
    rows = compared_rows(rows, {name: np.zeros(3) for name in rows})
    said = said_of(rows, "xyz")
    assert texts.predicted_by(texts.ACROSS, ["b"], 0.1, "a", 0.3) in said
    assert texts.best_across("a", "sweeps", 0.02) in said
    assert texts.best_across("b", "loops", 0.1) in said


def test_a_rough_score_calls_no_law_worse_and_none_the_best():
    rng = np.random.default_rng(0)
    base = rng.normal(size=6)
    scores = {"a": base, "b": base - 50.0, "c": base - 60.0, "d": base + 40.0}
    rows = {name: row(0.0) for name in scores}
    for name in "bd":
        rows[name] = rows[name].replaced(khat=0.9, elpd_doubt=120.0)
    rows = compared_rows(rows, scores)
    answers = {name: one.answer for name, one in rows.items()}
    assert answers == {"a": "best", "b": "not judged", "c": "worse", "d": "not judged"}
    said = said_of(rows, "uvwxyz")
    assert texts.not_judged(["b", "d"], "a", GOOD_KHAT) in said
    # What it may be off by does not reach so far.
    for name in "bd":
        rows[name] = rows[name].replaced(elpd_doubt=30.0)
    rows = compared_rows(rows, scores)
    answers = {name: one.answer for name, one in rows.items()}
    assert answers == {"a": "worse", "b": "worse", "c": "worse", "d": "best"}
    rows = {"a": row(0.0), "b": row(-80.0, khat_evidence=np.inf), "c": row(-80.0)}
    rows = compared_rows(rows, {})
    assert [one.answer for one in rows.values()] == ["best", "not judged", "worse"]


@pytest.mark.parametrize(("doubt", "behind"), [(0.0, True), (5.0, False)])
def test_a_law_is_no_worse_than_one_whose_own_score_may_be_off_by_as_much(doubt, behind):
    """Ten nats behind, with a standard error of one: a rough best score is off by 3 x 5 nats."""
    sure = StoredLaw(elpd_difference=-10.0, elpd_difference_se=1.0, khat=0.1, elpd_doubt=0.0)
    assert _behind_by_runs(sure, StoredLaw(khat=0.9, elpd_doubt=doubt)) == behind


def test_a_hopeless_law_is_worse_whatever_its_score_and_the_words_say_by_what():
    rng = np.random.default_rng(0)
    base = rng.normal(size=6)
    # Far behind on one run alone, which no standard error over runs would call apart.
    scores = {"a": base, "b": base - np.array([0, 0, 0, 0, 0, 9e3])}
    rows = {"a": row(0.0), "b": row(None, error=0.4, hopeless=True, khat=None)}
    rows = compared_rows(rows, scores)
    assert -rows["b"].elpd_difference < 2 * rows["b"].elpd_difference_se
    assert [one.answer for one in rows.values()] == ["best", "worse"]
    np.testing.assert_allclose([one.weight for one in rows.values()], [1.0, 0.0], atol=1e-3)
    said = said_of(rows, "uvwxyz")
    assert texts.by_fit_alone("b", 0.4, "a", 0.1, 300.0) in said
    # Where the law that leaves least could not be weighed, the others are compared all the same.
    alone = {"b": row(None, error=0.4, hopeless=True), "c": row(None, error=0.5, hopeless=True)}
    alone = compared_rows(alone, {"b": base, "c": base + 1.0})
    assert [one.answer for one in alone.values()] == ["best", "worse"]
    # Alone with a rough law it is still not the best one.
    rows["a"] = rows["a"].replaced(khat=0.9)
    rows = compared_rows(rows, scores)
    assert [one.answer for one in rows.values()] == ["best", "worse"]


def test_evidence_that_hangs_on_the_priors_tells_nothing_apart():
    # Seven nats behind with one parameter more, four with both priors twice as wide.
    rows = {"a": row(0.0, count=5), "b": row(-7.0, count=0)}
    rows = compared_rows(rows, {})
    assert rows["b"].answer == "not told apart"


class Normal(NamedTuple):
    """Data of which the likelihood is normal in omega_n and in the cubic stiffness."""

    centre: float
    std: float
    stepped: bool = False
    stated: StatedDensities = StatedDensities()


def normal(theta, data):
    own = (theta["cubic"] - data.centre) / data.std
    return jnp.stack([-0.5 * own**2, -0.5 * (theta["omega_n"] - 1.0) ** 2 / 0.01**2])


@pytest.mark.parametrize(
    ("centre", "std"),
    [(0.3, 0.05), (0.0, 1e3), (1.0, 0.1), (1.5, 0.3)],
    ids=["narrow", "open", "at its bound", "beyond it"],
)
def test_evidence_under_wider_priors_is_that_of_the_closed_form(centre, std, monkeypatch):
    monkeypatch.setattr(dataset, "log_likelihood", normal)
    prior = box({"omega_n": (0.9, 1.1), "cubic": (-1.0, 1.0)})
    best = {"omega_n": 1.0, "cubic": min(centre, 1.0)}
    known = SimpleNamespace(theta=best, covariance=np.diag([1e-4, min(std, 0.5) ** 2]), weak=None,
                            at_bound={})  # fmt: skip
    one = evidence.Candidate(("cubic",), Fitted(known, prior, Normal(centre, std)))
    of_omega_n = np.log(np.sqrt(2 * np.pi) * 0.01 / 0.2)  # its ends are ten deviations away

    def exact(width):
        mass = np.diff(norm.cdf((np.array([-width, width]) - centre) / std))[0]
        return of_omega_n + np.log(np.sqrt(2 * np.pi) * std * mass / (2 * width))

    monkeypatch.setattr(evidence, "with_derived", lambda key, tree, data: tree)
    monkeypatch.setattr(evidence, "about_valley", lambda *of: None)
    draws, _ = evidence.posterior(jax.random.key(1), one)
    np.testing.assert_allclose(draws.attrs["log_evidence"], exact(1.0), atol=0.25)
    found = log_evidence_wide(jax.random.key(0), one, draws)
    # Points that are worth 200 draws: an error of 0.07.
    np.testing.assert_allclose(found, exact(2.0), atol=0.25)
    change = {0.3: -np.log(2.0), 0.0: 0.0, 1.0: 0.0}
    assert centre not in change or abs(exact(2.0) - exact(1.0) - change[centre]) < 1e-3


def test_wider_priors_of_a_law_are_twice_as_wide_but_for_its_share_of_the_stiffness():
    bounds = {"omega_n": (90.0, 110.0), "alpha": (10.0, 900.0), "delta": (-2.0, 20.0),
              "gamma": (0.0, 20.0), "cubic": (-3.0, 3.0)}  # fmt: skip
    wide = bounds_by_name(twice_as_wide(box(bounds), ("bouc_wen", "cubic")))
    own = {"delta": (-4.0, 40.0), "gamma": (0.0, 40.0), "cubic": (-6.0, 6.0)}
    assert wide == bounds | own
    above = bounds_by_name(twice_as_wide(box({"gamma": (5.0, 20.0)}), ("bouc_wen",)))
    assert above == {"gamma": (5.0, 35.0)}


def moved_by(level):
    """A level whose natural frequency lies elsewhere: by chance, but much for a law."""
    return curve(level) if level != 40.0 else shifted(curve(level), 1.003)


def shifted(test, factor):
    records = []
    for one in test.records:
        channels = {**one.channels, "frequency": one.channels["frequency"] * factor}
        records.append(replace(one, channels=channels))
    return replace(test, records=tuple(records))


@pytest.mark.slow
def test_a_law_is_shown_with_offsets_of_the_runs_and_without():
    tests = [moved_by(level) for level in LEVELS[1:5]]
    seen = measured(tests, Identify(), laws=("cubic",), gain=1.0)
    found, _ = evidence.candidates(jax.random.key(0), seen, [("cubic",)], lambda said: None)
    (best,) = found
    assert best.fitted.data.has_offsets
    shared = without_offsets(jax.random.key(1), seen, found, best)
    assert not any(one.fitted.data.has_offsets for one in shared)
    row = offset_changes(best, shared[0])
    own = row["parameters"]["cubic"]
    assert abs(own["with"] - CUBIC) < 4 * own["with_sd"]
    # One level of four that is off by 0.3 % costs the fit without offsets more than that with them.
    assert row["error"][1] > 2 * row["error"][0]
    shown = {**row, "errors": {"linear": 1.0, "cubic": shared[0].error}}
    (said,) = _of_offsets("cubic", StoredSharedRuns.read(shown))
    with_, without = row["error"]
    moved = [
        texts.moved(name, (each["without"], each["without_sd"]), (each["with"], each["with_sd"]))
        for name, each in row["parameters"].items()
    ]
    least = shown["errors"]["cubic"]
    assert said == texts.without_offsets("cubic", without, with_, moved, "cubic", least)


@pytest.fixture(scope="module")
def softening():
    tests = tuple(curve(level) for level in LEVELS)
    return Campaign(
        "softening",
        None,
        tests,
        gain=1.0,
        settings=Identify(hold_out=("held at 100",)),
        laws=("cubic",),
    )


def test_tests_that_nobody_fitted_are_told_apart_by_reach():
    tests = [curve(level) for level in LEVELS[:3]]
    assert [test.name for test in unseen(tests, ("held at 5", "held at 20 again"))] == [
        "held at 40"
    ]
    found = xr.Dataset(
        {
            "error": (("law", "test"), [[0.1, 0.2, 0.6], [0.3, np.nan, 0.4]]),
            "extrapolation": (("law", "test"), [[0.5, 1.0, 1.3], [2.0, 2.0, 2.0]]),
        },
        {"law": ["a", "b"], "test": list("xyz")},
    )
    rows = {name: errors_apart(found, name, "a") for name in "ab"}
    assert rows["a"] == {"error_held_out": pytest.approx(0.025**0.5), "error_beyond": 0.6}
    assert rows["b"] == {"error_held_out": 0.3, "error_beyond": 0.4}
    within, beyond = _of_unseen({name: StoredLaw(**row) for name, row in rows.items()})
    assert within == texts.best_within("a", 0.025**0.5)
    assert beyond == texts.best_beyond("b", 0.4)
    assert list(_of_unseen({"a": StoredLaw(**errors_apart(None, "a", "a"))})) == []


@pytest.mark.slow
@pytest.mark.parametrize("beside", represented_by([], ["bouc_wen"]))
def test_the_law_that_made_the_data_is_best_and_wrong_ones_are_told_apart(softening, beside):
    found = compare_laws(softening, ["linear", "cubic", *beside, ("quadratic",)], seed=3)
    rows = found.record["laws"]
    assert rows["cubic"]["answer"] == "best"
    assert rows["linear"]["answer"] == rows["quadratic"]["answer"] == "worse"
    assert rows["cubic"]["weight"] > 0.5
    assert rows["linear"]["hopeless"]
    assert not rows["cubic"]["hopeless"]
    mean, sd = (rows["cubic"]["parameters"]["cubic"][key] for key in ("mean", "sd"))
    assert abs(mean - CUBIC) < 4 * sd
    assert found.record["highest"] == "held at 80"
    # The highest level is held out: the law that made it predicts it, within the noise.
    others = found.tree["held_out"].to_dataset()
    assert others["test"].values.tolist() == ["held at 100"]
    assert float(others["extrapolation"].sel(law="cubic").item()) > 1.1
    assert rows["cubic"]["error_beyond"] < 0.2 * rows["linear"]["error_beyond"]
    assert rows["cubic"]["error_held_out"] is None
    assert set(found.tree["scores"]["law"].values) == set(rows)
    assert stacking({"cubic": np.zeros(5)}) == {"cubic": 1.0}


@pytest.mark.parametrize(
    ("levels", "highest"),
    [
        ((float("nan"),) * 3, None),  # as of tests that state none
        ((20.0, float("nan"), 5.0), "20"),
        ((20.0, float("nan"), float("nan")), None),
        ((5.0, 20.0, 10.0), "20"),
    ],
)
def test_the_highest_run_is_that_of_the_highest_level_that_is_stated(levels, highest):
    names = [f"{level:g} {i}" for i, level in enumerate(levels)]
    tests = [replace(curve(5.0), name=n, level=x) for n, x in zip(names, levels, strict=True)]
    campaign = Campaign("levels", None, tuple(tests), gain=1.0, settings=Identify(), laws=())
    found = compare._highest(campaign, [test.name for test in tests])
    assert found is None if highest is None else found.startswith(highest)


def test_an_unknown_law_is_named(softening):
    with pytest.raises(ConfigError, match="Unknown law `iwan5`"):
        compare_laws(replace(softening), ["iwan5 + cubic"])
