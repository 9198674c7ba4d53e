"""Reduction and likelihood of records under a measured input."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pasted import pasted
from scipy.stats import norm
from tiers import represented_by

from jbw.errors import DataError
from jbw.identification.accuracy import repeatability_finding
from jbw.identification.joint import draw_noise_std
from jbw.measurement.delays import advance, on_time
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, log_likelihood, stacked
from jbw.observables.noise import repeatability
from jbw.observables.records import Records
from jbw.observables.remembered import remembering
from jbw.observables.samples import band_limited, response_to

FS = 256.0
TRUTH = {
    "omega_n": 118.0,
    "zeta": 0.01,
    "alpha": 500.0,
    "delta": 300.0,
    "gamma": 30.0,
    "gain": 15.0,
}


def theta(**changes):
    return {name: jnp.asarray(value) for name, value in {**TRUTH, **changes}.items()}


@pytest.fixture(scope="module")
def tests():
    rng = np.random.default_rng(1)
    t = np.arange(512) / FS
    u = 0.1 * np.sin(2 * np.pi * 18 * t) * np.sin(np.pi * t / 2) ** 2
    clean = np.asarray(response_to(theta(), band_limited(u), FS))
    records = tuple(
        Record(FS, {"input": u, "velocity": clean + 1e-3 * rng.normal(size=512)},
               {"input": "V", "velocity": "m/s"})
        for _ in range(5)
    )  # fmt: skip
    return (Test("sweep", records, "sweep", 0.1),)


def test_squares_are_those_of_every_repeat(tests):
    data = Records.of(tests)
    model = np.asarray(data.predict(theta(gamma=40.0)))[0]
    direct = sum(np.sum((r.channels["velocity"] - model) ** 2) for r in tests[0].records)
    # Sums of 2560 squares in another order: rounding only.
    np.testing.assert_allclose(data.squares(theta(gamma=40.0))[0], direct, rtol=1e-12)


@pytest.mark.fault(30, 32)
def test_marginal_likelihood_integrates_the_noise_out(tests):
    data = Records.of(tests)

    def integrated(one):
        q, n = float(data.squares(one)[0]), 5 * 512
        sigma = np.sqrt(q / n) * np.exp(np.linspace(-0.3, 0.3, 4001))
        log_p = -n * np.log(sigma) - q / (2 * sigma**2)
        return log_p.max() + np.log(np.trapezoid(np.exp(log_p - log_p.max()), np.log(sigma)))

    pair = [theta(), theta(delta=320.0)]
    exact = integrated(pair[1]) - integrated(pair[0])
    found = [float(log_likelihood(one, Dataset.of([data]))[0]) for one in pair]
    # Quadrature over ln sigma on a grid of 1.5e-4: good to 1e-7 of the log likelihood's change.
    np.testing.assert_allclose(found[1] - found[0], exact, rtol=1e-6, atol=1e-6)


def test_noise_of_the_repeats(tests):
    data = Records.of(tests)
    # 2048 degrees of freedom: the estimate has a standard error of 1.6 %.
    assert float(data.groups.noise_std[0]) == pytest.approx(1e-3, rel=0.07)


@pytest.mark.fault(31)
def test_what_a_fit_leaves_stands_beside_the_scatter_of_its_repeats(tests):
    data = Dataset.of([Records.of(tests)])
    velocity = np.stack([record.channels["velocity"] for record in tests[0].records])
    mean = velocity.mean(axis=0)
    scatter = np.sqrt(np.var(velocity, axis=0, ddof=1).sum()) / np.linalg.norm(mean)
    assert repeatability(data) == pytest.approx({"sweep": scatter}, rel=1e-12)
    fine = repeatability_finding({"sweep": 0.5 * scatter}, data)
    assert fine is not None
    assert (fine.status, fine.number) == ("ok", pytest.approx(0.5))
    poor = repeatability_finding({"sweep": 3 * scatter}, data)
    assert poor is not None
    assert poor.status == "failed"
    sizes = 300 * scatter, 100 * scatter
    said = "{:.2g} %, the standard deviation between its repeats {:.2g} %".format(*sizes)
    assert f"The residual of sweep is {said}" in poor.reason
    assert pasted(poor.action).laws == ("bouc_wen", "cubic")
    once = Records.of([replace(tests[0], records=tests[0].records[:1])])
    assert repeatability_finding({"sweep": 1.0}, Dataset.of([once])) is None


def test_draws_of_the_noise_come_from_the_stored_likelihood(tests):
    data = Dataset.of([Records.of(tests)])
    terms = np.asarray(log_likelihood(theta(), data))
    stored = np.broadcast_to(terms, (4, 100, 1))
    _, draws, attrs = draw_noise_std(jax.random.key(0), {}, stored, data)["noise_std"]
    assert attrs["units"] == "m/s"
    draws = draws[..., 0]
    squares = float(data.parts[0].squares(theta())[0])
    # sigma^2 = Q / chi^2_n with n = 2560: mean sqrt(Q / n) to 1e-3, sd 1 / sqrt(2 n) of it, which
    # 400 draws know to 3.5 %.
    assert draws.shape == (4, 100)
    assert draws.mean() == pytest.approx(np.sqrt(squares / 2560), rel=0.004)
    assert draws.std() / draws.mean() == pytest.approx(1 / np.sqrt(2 * 2560), rel=4 * 0.035)


def test_residuals_at_the_truth_are_standard_normal(tests):
    r = np.asarray(stacked(theta(), Dataset.of([Records.of(tests)])))
    assert abs(r.std() - 1) < 4 / np.sqrt(2 * len(r))
    assert abs(np.mean(np.abs(r) < norm.ppf(0.995)) - 0.99) < 4 * np.sqrt(0.99 * 0.01 / len(r))


def test_a_delay_is_undone():
    t = np.arange(1024) / FS
    pulse = np.exp(-0.5 * ((t - 2.0) / 0.05) ** 2)
    late = np.exp(-0.5 * ((t - 2.0 - 0.0037) / 0.05) ** 2)
    # A Gaussian of 50 ms is band-limited far below 128 Hz: exact to rounding.
    np.testing.assert_allclose(advance(late, 0.0037, FS), pulse, atol=1e-12)


@pytest.mark.parametrize("band", represented_by((14.0, 24.0), None))
def test_what_moved_before_the_record_is_not_compared(tests, band):
    """A record cut out of a motion: reference is the motion followed from its true start."""
    (whole,) = tests
    begins, after = 200, 280  # samples: 1.1 s are 8 times 1 / (zeta omega_n), at zeta = 0.06
    damped = theta(zeta=0.06)
    u = jnp.asarray(whole.records[0].channels["input"])
    v = np.asarray(response_to(damped, band_limited(u), FS))[begins:]
    cut = Record(FS, {"input": np.asarray(u)[begins:], "velocity": v}, whole.records[0].units)
    test = Test("sweep", (cut,), "cut", 0.1, band_hz=band)
    naive = Records.of([test])
    data = Records.of([replace(test, settle=after / FS)])
    assert data.mean.shape == (1, len(v) - after)
    missed, left = (
        float(jnp.linalg.norm(one.misfit(damped)) / np.linalg.norm(v)) for one in (naive, data)
    )
    # exp(-8) of the motion is left, of a burst that has died by then to a third of its largest.
    assert missed > 0.1
    assert left < 1e-4
    np.testing.assert_allclose(data.squares(damped), jnp.sum(data.misfit(damped) ** 2), rtol=1e-9)


def test_unlike_records_are_refused(tests):
    (test,) = tests
    other = Record(512.0, test.records[0].channels, test.records[0].units)
    with pytest.raises(DataError, match="sampling frequency"):
        Records.of([test, Test("sweep", (other, other), "fast", 0.2)])


SLIDING = {name: jnp.asarray(value) for name, value in {
    "omega_n": 118.0, "zeta": 0.01, "gain": 15.0, "power_loss": 3000.0, "power_exponent": 0.3,
}.items()}  # fmt: skip


def dying():
    """In noise that dies loops lie in loops, till a push."""
    t = np.arange(4096) / FS
    noise = np.random.default_rng(2).normal(size=t.size)
    u = np.exp(-t / 6) * np.sin(2 * np.pi * 2 * t) + 0.3 * noise
    u[-64:] = 6.0
    return u


def under(u):
    record = Record(FS, {"input": u, "velocity": 0.0 * u}, {"input": "V", "velocity": "m/s"})
    return Test("sweep", (record, record), name="sweep", level=0.1)


@pytest.mark.slow
def test_records_remember_as_deep_as_their_motion_asks():
    (data,) = Records.reduce([under(dying())], laws=("masing_power",), substeps=1)
    deep = remembering(SLIDING, data)
    assert deep.depth > data.depth
    assert deep.statements(SLIDING) == []


def test_loops_deeper_than_a_law_remembers_are_told():
    # Motion that grows closes every loop.
    t = np.arange(512) / FS
    for u, told in ((np.exp(2 * t) * np.sin(2 * np.pi * 5 * t), 0), (dying(), 1)):
        (data,) = Records.reduce([under(u)], laws=("masing_power",), substeps=1)
        said = data.statements(SLIDING)
        assert len(said) == told
    assert said[0].startswith("sweep: the motion has more nested loops than the law can")
    (data,) = Records.reduce([under(dying())])
    assert data.statements(theta()) == []
    assert remembering(theta(), data) is data


def test_a_motion_that_hides_the_data_by_rounding_is_no_prediction(monkeypatch):
    """A constant of 1e20 m has no line in a band, and a residual of zero: it is none."""
    t = np.arange(512) / 256.0
    source = np.sin(2 * np.pi * 20 * t)
    record = Record(256.0, {"input": source, "displacement": 1e-3 * source},
                    {"input": "V", "displacement": "m"})  # fmt: skip
    data = Records.of([Test("sweep", (record,), name="one", band_hz=(10.0, 30.0))])
    for size, bounded in ((1e-2, True), (1e20, False)):
        far = np.full((1, 512), size)
        monkeypatch.setattr(Records, "predict", lambda self, theta, far=far: far)
        assert np.all(np.isfinite(data.misfit({}))) == bounded


def apart(lag, size=512):
    """A sweep whose channels were started `lag` samples apart, its voltage and its velocity."""
    t = np.arange(size) / FS
    u, y = np.sin(2 * np.pi * 3 * t**2), np.sin(2 * np.pi * 3 * t**2 - 0.4) * (1 + t)
    channels = {"input": u[: size - lag], "velocity": y[lag:]}
    if lag < 0:
        channels = {"input": u[-lag:], "velocity": y[: size + lag]}
    record = Record(FS, channels, {"input": "V", "velocity": "m/s"})
    return Test("sweep", (record,), "sweep", delay=-lag / FS, settle=0.01), u, y


@pytest.mark.parametrize("lag", [64, -64])
def test_a_response_started_later_or_earlier_is_compared_with_its_own_drive(lag):
    """Whole samples apart, so that what both saw is known to the last digit."""
    test, u, y = apart(lag)
    timely = on_time(test)
    (record,) = timely.records
    assert timely.delay == 0.0
    first, begun = round(timely.settle * FS), max(-lag, 0)  # the latter in the motion's time
    assert first == max(lag, round(0.01 * FS))
    seen = slice(begun + first, len(u) - abs(lag))
    np.testing.assert_array_equal(record.channels["input"][first:], u[seen])
    np.testing.assert_allclose(record.channels["velocity"][first:], y[seen], atol=1e-12)


def test_a_delay_longer_than_the_record_is_refused_by_name():
    test, *_ = apart(64)
    with pytest.raises(DataError, match="`delay` must be shorter than record"):
        on_time(replace(test, delay=3.0))


def test_periods_are_turned_for_their_ends_meet():
    t = np.arange(256) / 256
    channels = {"input": np.cos(2 * np.pi * t), "velocity": np.cos(2 * np.pi * (t - 0.1))}
    record = Record(256.0, channels, {"input": "V", "velocity": "m/s"})
    test = Test("multisine", (record,), delay=0.1, periods=2, tones_hz=(1.0,))
    (timely,) = on_time(test).records
    np.testing.assert_allclose(timely.channels["velocity"], np.cos(2 * np.pi * t), atol=1e-12)
