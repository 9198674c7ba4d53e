"""Records one by one, against SciPy's normal density and what the model is known to predict."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from decays import decay_test
from scipy.integrate import simpson
from scipy.stats import norm

from jbw.inference.groups.scatter import scatter_grid
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, log_likelihood, with_directions
from jbw.observables.decay import Decays
from jbw.observables.line_fit import LineReading
from jbw.observables.loops import Loops
from jbw.observables.noise import with_effective_values
from jbw.observables.pointwise import records_of
from jbw.observables.records import Records
from jbw.observables.samples import band_limited, response_to
from jbw.observables.steady import Points

FS, NOISE = 256.0, 1e-3
TRUTH = {
    "omega_n": 118.0, "zeta": 0.01, "alpha": 500.0, "delta": 300.0, "gamma": 30.0, "gain": 15.0,
}  # fmt: skip
T = np.arange(512) / FS
U = 0.1 * np.sin(2 * np.pi * 18 * T) * np.sin(np.pi * T / 2) ** 2
UNITS = {"input": "V", "velocity": "m/s", "displacement": "m", "restoring_force": "N"}


def draws(**changes):
    """Two draws: the truth, and one beside it."""
    beside = {**TRUTH, "omega_n": 118.02, "gain": 15.01, **changes}
    return {name: np.array([value, beside[name]]) for name, value in TRUTH.items()}


def a_test(kind, channels, count, seed=1, name="test", noise=NOISE, **how):
    rng = np.random.default_rng(seed)
    *given, response = channels
    records = tuple(
        Record(
            FS,
            {
                **{role: channels[role] for role in given},
                response: channels[response] + noise * rng.normal(size=len(T)),
            },
            {role: UNITS[role] for role in channels},
        )
        for _ in range(count)
    )
    return Test(kind, records, name, 0.1, **how)


def swept(count, seed=1, name="test", **changes):
    theta = {key: jnp.asarray(value) for key, value in {**TRUTH, **changes}.items()}
    clean = np.asarray(response_to(theta, band_limited(U), FS))
    return a_test("sweep", {"input": U, "velocity": clean}, count, seed, name)


def found(data, theta, noise):
    """What is asked of the records of a dataset."""
    return records_of(jax.random.key(0), theta, noise, data)


def test_every_record_has_its_own_density_given_the_noise():
    test = swept(3)
    data, theta = Dataset.of(Records.reduce([test])), draws()
    noise = np.array([NOISE, 1.3 * NOISE])
    (part,) = found(data, theta, {"test": noise}).parts
    assert part.name == ["test, 1", "test, 2", "test, 3"]
    assert part.repeat == [1, 2, 3]
    for d in range(2):
        point = {name: jnp.asarray(values[d]) for name, values in theta.items()}
        model = np.asarray(response_to(point, band_limited(U), FS, substeps=data.parts[0].substeps))
        for j, record in enumerate(test.records):
            exact = norm.logpdf(record.channels["velocity"], model, noise[d]).sum()
            # Of 512 squares over sigma squared: rounding.
            assert part.log_likelihood[d, j] == pytest.approx(exact, rel=1e-10)


def test_all_periods_of_a_record_of_a_multisine_count():
    clean = np.sin(2 * np.pi * 18 * T[:128])  # a period of 9 cycles, the first of them transient
    channels = {"input": np.tile(clean, 4), "velocity": 0.02 * np.tile(clean, 4)}
    test = a_test("multisine", channels, 3, periods=4, settle=0.5)
    data, theta = Dataset.of(Records.reduce([test])), draws()
    (part,) = found(data, theta, {"test": np.full(2, NOISE)}).parts
    assert part.repeat == [1, 2, 3]
    for d in range(2):
        point = {name: jnp.asarray(values[d]) for name, values in theta.items()}
        model = np.tile(np.asarray(data.parts[0].predict(point))[0], 3)
        for j, record in enumerate(test.records):
            exact = norm.logpdf(record.channels["velocity"][128:], model, NOISE).sum()
            assert part.log_likelihood[d, j] == pytest.approx(exact, rel=1e-10)  # rounding


def tone(count):
    hz = 6.0
    u, y = np.cos(2 * np.pi * hz * T), 4e-4 * np.cos(2 * np.pi * hz * T)
    channels = {"input": u, "displacement": y}
    made = [
        a_test("tones", channels, count, seed, name, 1e-5, tones_hz=(hz,))
        for seed, name in ((1, "a"), (2, "b"))
    ]
    return Points, made


def loop(count):
    y = 1e-3 * np.sin(2 * np.pi * T)
    channels = {"displacement": y, "restoring_force": TRUTH["omega_n"] ** 2 * y / 15.0}
    return Loops, [a_test("loop", channels, count, noise=1e-2, settle=0.1)]


@pytest.mark.parametrize("made", [tone, loop, lambda n: (Records, [swept(n)])])
@pytest.mark.slow
def test_the_noise_integrated_out_leaves_the_likelihood_that_is_sampled(made):
    (part, tests), fraction = made(3), 0.25
    data = Dataset.of(part.reduce(tests))
    labels = data.labels
    fractions = dict.fromkeys(labels, fraction)
    data = with_effective_values(fractions, data)
    theta = draws()
    noise = {label: np.full(2, 1.0) for label in labels}
    parts = found(data, theta, noise).parts
    groups = [label for one in parts for label in one.group]
    assert sorted(set(groups)) == sorted(labels)
    assert all(groups.count(label) == 3 for label in labels)
    # At sigma = 1 a group says -f Q / 2 and its constant: its Q, and the integral by quadrature.
    rows = np.concatenate([one.log_likelihood for one in parts], axis=1)
    for label in labels:
        own = rows[:, [g == label for g in groups]].sum(axis=1)
        i = labels.index(label)
        counts = next(p.groups for p in data.parts if label in p.groups.labels)
        g = next(p.groups.labels.index(label) for p in data.parts if label in p.groups.labels)
        n = float(counts.num_values[g])
        squares = -2 * own - n * np.log(2 * np.pi)  # f Q
        shift = squares[0] / n

        about, wide = np.log(shift) / 2, 0.2 + 30 / np.sqrt(n)
        x = np.linspace(about - wide, about + wide, 20001)[:, None]
        # Constants keep the exponents small; both draws have the same.
        density = -n * (x - about) - squares / (2 * np.exp(2 * x)) + n / 2
        area = simpson(np.exp(density), x=x[:, 0], axis=0)
        points = [{name: jnp.asarray(v[d]) for name, v in theta.items()} for d in range(2)]
        terms = [float(log_likelihood(point, data)[i]) for point in points]
        # Both are differences of numbers of some thousand: rounding.
        assert np.log(area[1] / area[0]) == pytest.approx(terms[1] - terms[0], abs=1e-5)


def test_sizes_are_predicted_as_the_noise_makes_them():
    test = swept(4)
    data = Dataset.of(Records.reduce([test]))
    loud = 0.05  # beside a response of 0.02 rms
    theta = {name: np.full(4000, value) for name, value in TRUTH.items()}
    (part,) = found(data, theta, {"test": np.full(4000, loud)}).parts
    rows = np.stack([record.channels["velocity"] for record in test.records])
    size = np.sqrt(np.sum(rows.mean(axis=0) ** 2))
    exact = np.sqrt(np.sum(rows**2, axis=1)) / size
    np.testing.assert_allclose(part.observed, exact, rtol=1e-12)
    point = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    model = np.asarray(response_to(point, band_limited(U), FS, substeps=data.parts[0].substeps))
    rng = np.random.default_rng(0)
    made = model + loud * rng.normal(size=(4000, len(T)))
    expected = np.sqrt(np.sum(made**2, axis=1)) / size
    for j in range(4):
        own = part.predicted[:, j]
        error = expected.std() * np.sqrt(2 / 4000)
        assert own.mean() == pytest.approx(expected.mean(), abs=4 * error)
        assert own.std() == pytest.approx(expected.std(), rel=4 / np.sqrt(4000))
    assert abs(np.corrcoef(part.predicted[:, :2].T)[0, 1]) < 4 / np.sqrt(4000)


def test_runs_are_predicted_at_their_own_offsets():
    off = 0.4
    tests = [swept(2, 1, "low", omega_n=118.0 - off), swept(2, 2, "high", omega_n=118.0 + off)]
    data = Dataset.of(Records.reduce(tests))
    least, most = (0.01, 1e-5), (1.0, 1e-3)
    placed = with_directions(TRUTH, data, {"low": np.array([-off, 0]), "high": np.array([off, 0])})
    own = replace(
        placed, scatters=jnp.asarray(scatter_grid(least, most)), scatter=jnp.asarray(most)
    )
    theta = draws(omega_n=118.0, gain=15.0)
    noise = {name: np.full(2, NOISE) for name in ("low", "high")}
    every = found(own, theta, noise)
    apart = found(data, theta, noise)
    for name, rest in (("low", -off), ("high", off)):
        there = found(data, {**theta, "omega_n": theta["omega_n"] + rest}, noise)
        pick = [g == name for g in every.parts[0].group]
        drawn, fixed, wrong = (x.parts[0].log_likelihood[:, pick] for x in (every, there, apart))
        # A draw of two offsets strays by chi-square of two degrees of freedom, over two records.
        assert np.all(np.abs(drawn - fixed) < 8)
        assert np.all(fixed - wrong > 100)
    assert every.offsets.shape == (2, 2)
    assert apart.offsets is None


def test_a_line_fit_is_known_beforehand_and_a_decay_is_one_record():
    mean = np.array([TRUTH[name] for name in ("omega_n", "zeta", "gain")])
    line = LineReading.of(mean, np.diag((1e-2 * mean) ** 2), 1e-12, "noise")
    test = swept(2)
    both = found(Dataset.of([line, *Records.reduce([test])]), draws(), {"test": np.full(2, 1.0)})
    density = both.known["line fit of noise"]
    left = (mean - [118.02, 0.01, 15.01]) / (1e-2 * mean)
    # At no amplitude the joint sticks: what was read is the parameters.
    assert density[1] - density[0] == pytest.approx(-0.5 * np.sum(left**2), rel=1e-6)
    impacts = decay_test()
    data = Dataset.of(Decays.reduce([impacts]))
    noise = {label: np.full(2, 1e-4) for label in data.labels}
    (part,) = found(data, draws(), noise).parts
    assert part.name == list(data.labels)
    assert part.observed == pytest.approx(np.ones(len(data.labels)))
    assert np.all(np.isfinite(part.log_likelihood))
    assert np.all(np.isfinite(part.predicted))
