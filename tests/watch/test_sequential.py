"""The posterior with one record more, against that of all records by importance sampling."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from decays import BAND, FS, SETTLE
from scipy.stats import multivariate_t

import jbw
from jbw.inference.lanes import at_points
from jbw.measurement.records import Record, Test
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.decay import Decays
from jbw.study.study import Study
from jbw.watch.sequential import updated

# A linear decay has no cubic spring; so few draws stand for posteriors that are nearly normal.
TRUTH = {"omega_n": 2 * np.pi * 20.3, "zeta": 2e-3, "cubic": 0.0}
ABOUT = {"omega_n": 0.05, "zeta": 5e-5, "cubic": 3e5}  # half widths of the box
BOX = {n: (TRUTH[n] - 20 * w, TRUTH[n] + 20 * w) for n, w in ABOUT.items()}
NUM = 2000


def hit(seed, size, phase, seconds=4.0):
    t = np.arange(round(seconds * FS)) / FS
    omega, zeta = TRUTH["omega_n"], TRUTH["zeta"]
    noise = 3e-3 * np.random.default_rng(seed).standard_normal(len(t))
    v = size * np.exp(-zeta * omega * t) * np.cos(omega * t + phase) + noise
    return Record(FS, {"velocity": v}, {"velocity": "m/s"}, f"hit {seed}")


HITS = tuple(hit(i, 0.3 + 0.05 * i, 1.7 * i) for i in range(1, 6))


def of(*hits):
    return Test("decay", hits, "impacts", band_hz=BAND, settle=SETTLE)


def terms_of(x, hits):
    """Terms of the likelihood at points, every value of an envelope counted."""
    data = Dataset.of([Decays.of(of(*hits), laws=("cubic",), substeps=1)], {"gain": 1.0})
    return at_points(dataset.log_likelihood, dict(zip(TRUTH, x.T, strict=True)), data)


def posterior(rng, hits):
    """Draws under uniform priors, their terms and the log evidence, by points about themselves."""
    middle, width = (np.array(list(each.values())) for each in (TRUTH, ABOUT))
    mean, cov = np.zeros(3), np.eye(3)
    for _ in range(4):
        near = multivariate_t(mean, cov, df=4)  # the scatter of frequencies has far tails
        u = near.rvs(2 * NUM, random_state=rng)
        terms = terms_of(x := middle + width * u, hits)
        log_w = terms.sum(axis=1) - near.logpdf(u)
        w = np.exp(log_w - log_w.max())
        mean, cov = w @ u / w.sum(), np.cov(u.T, aweights=w)
    assert w.sum() ** 2 / np.sum(w**2) > 0.3 * len(w)  # as good as a thousand draws
    rows = rng.choice(len(x), NUM, p=w / w.sum())
    return x[rows], terms[rows], np.log(w.mean()) + log_w.max()


@pytest.fixture(scope="module")
def run():
    """A run of all hits but the last, as its folder would give it, and its log evidence."""
    settings = {"model_error": "none", "substeps": 1, "fit_repeats": 4}
    x, terms, evidence = posterior(np.random.default_rng(0), HITS[:-1])
    draws = {
        name: (
            ("chain", "draw"),
            x[None, :, i],
            dict(zip(("lower", "upper"), BOX[name], strict=True)),
        )
        for i, name in enumerate(TRUTH)
    }
    likelihood = xr.Dataset({"terms": (("chain", "draw", "term"), terms[None])})
    tree = xr.DataTree.from_dict({"/posterior": xr.Dataset(draws), "/log_likelihood": likelihood})
    campaign = jbw.Campaign("hits", None, (of(*HITS[:-1]),), settings=settings, laws=("cubic",))
    return Study(tree, {}, campaign), evidence


@pytest.mark.slow
def test_one_record_more_leaves_the_posterior_of_all(run):
    study, first = run
    said = []
    found = updated(study, HITS[-1:], num_particles=NUM, report=said.append)
    all_, _, evidence = posterior(np.random.default_rng(1), HITS)
    sequential = found["sequential"].to_dataset()
    # Two sets of a few hundred independent draws each: means to 0.06 sd, sds to 5 %; four of these.
    for i, name in enumerate(TRUTH):
        x = found["posterior"][name].values.ravel()
        assert abs(x.mean() - all_[:, i].mean()) < 4 * 0.06 * all_[:, i].std()
        assert x.std() == pytest.approx(all_[:, i].std(), rel=4 * 0.05)
    # Either evidence is that of some thousand points.
    assert sequential["log_evidence"].item() == pytest.approx(evidence - first, abs=0.2)
    assert sequential["record"].item() == "hit 5"
    assert said == [f"hit 5: {sequential['kish'].item():.0%} of the particles count"] or (
        said[0].endswith("moved since") and np.isfinite(sequential["accepted"].item())
    )


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (hit(3, 0.4, 0.0, seconds=3.2), "`hit 3` is shorter than the records of the run"),
        (replace(hit(3, 0.4, 0.0), fs=500.0), "has not the channel or the rate"),
    ],
)
@pytest.mark.slow
def test_a_record_of_another_kind_is_refused(run, record, message):
    with pytest.raises(jbw.DataError, match=message):
        updated(run[0], [record], report=lambda said: None)


@pytest.mark.slow
def test_a_run_whose_likelihood_cannot_be_had_again_is_refused(run):
    study, _ = run
    other = study.tree.copy(deep=True)
    other["log_likelihood"]["terms"] *= 0.5
    with pytest.raises(jbw.DataError, match=r"cannot be had again: it strays by .* nats"):
        updated(replace(study, tree=other), HITS[-1:])


def test_what_cannot_be_meant_is_refused():
    study = Study(xr.DataTree(), {}, None)
    with pytest.raises(jbw.ConfigError, match="a record to add"):
        updated(study, HITS)
