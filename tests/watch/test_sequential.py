"""The posterior with one record more, against that of all records, anew and in closed form."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray as xr
from decays import BAND, FS, SETTLE
from scipy.stats import multivariate_t

import jbw
from jbw import rig
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.checks import joint_step
from jbw.identification.joint import JointProblem
from jbw.inference.lanes import at_points
from jbw.measurement.envelopes import filter_of
from jbw.measurement.records import Record, Test
from jbw.observables import dataset
from jbw.observables.dataset import Dataset
from jbw.observables.decay import Decays, counting
from jbw.report.messages.watch import particles
from jbw.rig.generator import Sweep
from jbw.study.store import save_result
from jbw.study.study import Study
from jbw.watch.sequential import updated

# A linear decay has no cubic spring; so few draws stand for posteriors that are nearly normal.
TRUTH = {"omega_n": 2 * np.pi * 20.3, "zeta": 2e-3, "cubic": 0.0}
ABOUT = {"omega_n": 0.05, "zeta": 5e-5, "cubic": 3e5}  # half widths of the box
BOX = {n: (TRUTH[n] - 20 * w, TRUTH[n] + 20 * w) for n, w in ABOUT.items()}
NUM, NOISE = 2000, 3e-3


def hit(seed, size, phase, seconds=4.0):
    t = np.arange(round(seconds * FS)) / FS
    omega, zeta = TRUTH["omega_n"], TRUTH["zeta"]
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(t))
    v = size * np.exp(-zeta * omega * t) * np.cos(omega * t + phase) + noise
    return Record(FS, {"velocity": v}, {"velocity": "m/s"}, f"hit {seed}")


HITS = tuple(hit(i, 0.3 + 0.05 * i, 1.7 * i) for i in range(1, 6))


def of(*hits):
    return Test("decay", hits, "impacts", band_hz=BAND, settle=SETTLE)


def terms_of(x, hits, worth):
    """Terms of the likelihood at points, a value of an envelope counted for `worth` of one."""
    part = Decays.of(of(*hits), laws=("cubic",), substeps=1)
    data = Dataset.of([counting(part, worth)], {"gain": 1.0})
    return at_points(dataset.log_likelihood, dict(zip(TRUTH, x.T, strict=True)), data)


def posterior(rng, hits, worth=1.0):
    """Draws under uniform priors, their terms and the log evidence, by points about themselves."""
    middle, width = (np.array(list(parameters.values())) for parameters in (TRUTH, ABOUT))
    mean, cov = np.zeros(3), np.eye(3)
    for size in (NUM // 2, NUM // 2, NUM // 2, 2 * NUM):
        near = multivariate_t(mean, cov, df=4)  # the scatter of frequencies has far tails
        u = near.rvs(size, random_state=rng)
        terms = terms_of(x := middle + width * u, hits, worth)
        log_w = terms.sum(axis=1) - near.logpdf(u)
        w = np.exp(log_w - log_w.max())
        mean, cov = w @ u / w.sum(), np.cov(u.T, aweights=w)
    assert w.sum() ** 2 / np.sum(w**2) > 0.3 * len(w)  # as good as a thousand draws
    rows = rng.choice(len(x), NUM, p=w / w.sum())
    return x[rows], terms[rows], np.log(w.mean()) + log_w.max()


def study_of(hits, worth=1.0, seed=0):
    """A run of some hits, as its folder would give it, and its log evidence."""
    settings = {"model_error": "none", "substeps": 1, "fit_repeats": len(hits)}
    x, terms, evidence = posterior(np.random.default_rng(seed), hits, worth)
    draws = {
        name: (
            ("chain", "draw"),
            x[None, :, i],
            dict(zip(("lower", "upper"), BOX[name], strict=True)),
        )
        for i, name in enumerate(TRUTH)
    }
    tree = xr.DataTree.from_dict({
        "/": xr.Dataset(attrs={"decay": json.dumps({"worth": worth, "substeps": 1.0})}),
        "/posterior": xr.Dataset(draws),
        "/sample_stats": xr.Dataset({"lp": (("chain", "draw"), terms.sum(axis=1)[None] - 7.0)}),
    })  # fmt: skip
    campaign = jbw.Campaign("hits", None, (of(*hits),), settings=settings, laws=("cubic",))
    return Study(tree, {}, campaign), evidence


@pytest.fixture(scope="module")
def run():
    return study_of(HITS[:-1])


@pytest.mark.slow
def test_one_record_more_leaves_the_posterior_of_all(run):
    study, first = run
    sentences = []
    after_record = updated(study, HITS[-1:], num_particles=NUM, report=sentences.append)
    all_, _, evidence = posterior(np.random.default_rng(1), HITS)
    sequential = after_record["sequential"].to_dataset()
    # Two sets of a few hundred independent draws each: means to 0.06 sd, sds to 5 %; four of these.
    for i, name in enumerate(TRUTH):
        x = after_record["posterior"][name].values.ravel()
        assert abs(x.mean() - all_[:, i].mean()) < 4 * 0.06 * all_[:, i].std()
        assert x.std() == pytest.approx(all_[:, i].std(), rel=4 * 0.05)
    # Either evidence is that of some thousand points.
    assert sequential["log_evidence"].item() == pytest.approx(evidence - first, abs=0.2)
    assert sequential["record"].item() == "hit 5"
    moved = bool(np.isfinite(sequential["accepted"].item()))
    assert sentences == [particles("hit 5", sequential["kish"].item(), moved=moved)]


def exact_sd(hits, worth):
    r"""Sd of zeta by hits of one linear oscillator: a line through every $\ln|X|$, weighed.

    $$1/s^2 = \frac{w\,\omega^2}{\sigma^2} \sum_{r,k} |X_{rk}|^2 (t_k - \bar t_r)^2$$

    with w the worth of a value and $\sigma^2 = 2 \sigma_v^2 \sum h^2$ the noise of an envelope's
    real part behind the filter h.
    """
    chosen, omega = filter_of(of(*hits)), TRUTH["omega_n"]
    taps = np.abs(chosen.taps) / np.abs(chosen.taps.sum())
    variance, total = 2 * NOISE**2 * np.sum(taps**2), 0.0
    lengths = Decays.of(of(*hits), laws=("cubic",), substeps=1).lengths
    for record, steps in zip(hits, lengths, strict=True):
        t = SETTLE + len(taps) / (2 * FS) + chosen.step_s * np.arange(steps)
        size = np.max(np.abs(record.channels["velocity"][:30]))  # 0.3 of it and more, over a period
        square = (size * np.exp(-TRUTH["zeta"] * omega * t)) ** 2
        total += np.sum(square * (t - np.average(t, weights=square)) ** 2)
    return np.sqrt(variance / (worth * omega**2 * total))


@pytest.mark.slow
def test_records_count_as_many_values_as_those_of_the_run():
    """The linear Gaussian limit: every record adds its weights, times what a value is worth.

    The new record is shorter than those of the run.
    """
    worth = 0.3
    study, _ = study_of(HITS[:-1], worth, seed=2)
    before = study.posterior["posterior"]["zeta"].values.ravel()
    last = hit(5, 0.55, 8.5, seconds=3.2)
    after_record = updated(study, [last], num_particles=NUM, report=lambda sentence: None)
    after = after_record["posterior"]["zeta"].values.ravel()
    # Sds of some 500 independent draws are known to 3 %, noise by some 400 values to 4 %, sizes of
    # records by their first crest to 1 %: four of their root of squares.
    for x, hits in ((before, HITS[:-1]), (after, (*HITS[:-1], last))):
        assert x.std() == pytest.approx(exact_sd(hits, worth), rel=4 * 0.05)
    assert abs(after.mean() - TRUTH["zeta"]) < 4 * exact_sd((*HITS[:-1], last), worth)


@pytest.mark.release  # two posteriors drawn whole; their pieces are tested above
def test_a_run_that_was_written_and_loaded_takes_one_record_more(tmp_path):
    """Hits of the rig: a run of three, closed and loaded, and the posterior of all four anew."""
    burst = Sweep(18.6, 18.6, 0.2, burst=1.5, fade=0.1, duration=4.0, settle=1.75)
    plan = rig.Plan("decay", "decay", burst, 4, (14.0, 23.0))
    preset = replace(rig.MIXED, name="hits", source="input", gain=15.0, plans=(plan,),
                     input_range=1.0, fit=())  # fmt: skip
    every = rig.measure(preset, seed=1, noise_ratio=0.02, fs=128.0)
    # Both by so many solver steps as suffice: a run says how many it took.
    draws = {"fit_repeats": 3, "num_samples": 500, "num_chains": 2, "substeps": 2}
    hits = every.tests[0].records
    three = replace(every.tests[0], records=hits[:3])
    first = replace(every, tests=(three,), settings=draws)
    (tmp_path / "run").mkdir()
    path = rig.write(first, tmp_path / "three")
    # these decays alone would choose another law
    path.write_text(f'{path.read_text()}\n[joint]\nlaws = ["bouc_wen"]\n')
    study = jbw.identify(jbw.load_campaign(path))
    save_result(tmp_path / "run", study.tree, study.record)
    loaded = jbw.load_study(tmp_path / "run", jbw.load_campaign(tmp_path / "three/campaign.toml"))
    assert loaded.identification is None
    after_record = updated(loaded, hits[3:], report=lambda sentence: None)["posterior"]

    settings = Identify(**{**draws, "fit_repeats": 4})
    problem = JointProblem(assemble(measured(every.tests, settings, laws=every.laws)), settings)
    all_ = joint_step(jax.random.key(0), problem)[0].posterior
    # 1,000 draws, of which a third count and move, beside as many anew: means to 0.06 sd and sds
    # to 5 %; four of these. The fourth hit moves gamma by an sd.
    for name in ("omega_n", "zeta", "alpha_delta", "alpha_gamma"):
        x, y = after_record[name].values, all_["posterior"][name].values
        assert abs(x.mean() - y.mean()) < 4 * 0.06 * y.std(), name
        assert x.std() == pytest.approx(y.std(), rel=4 * 0.05), name


@pytest.mark.slow
def test_a_record_of_another_kind_is_refused(run):
    other = replace(hit(3, 0.4, 0.0), fs=500.0)
    with pytest.raises(jbw.DataError, match="lacks the channel or the sampling rate"):
        updated(run[0], [other], report=lambda sentence: None)


@pytest.mark.slow
def test_a_run_whose_likelihood_cannot_be_had_again_is_refused(run):
    study, _ = run
    other = study.tree.copy(deep=True)
    other["sample_stats"]["lp"] *= 0.5
    with pytest.raises(jbw.DataError, match=r"cannot be reproduced: .* differ by .* nats"):
        updated(replace(study, tree=other), HITS[-1:])


def test_what_cannot_be_meant_is_refused():
    study = Study(xr.DataTree(), {}, None)
    with pytest.raises(jbw.ConfigError, match="one new record and the run"):
        updated(study, HITS)
