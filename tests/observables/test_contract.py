"""What every kind of test must hold to, whoever wrote it; and a kind that the tests bring."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from decays import BAND, SETTLE, decay_test
from guests import RingDown

from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.identification.checks import joint_step
from jbw.identification.joint import JointProblem
from jbw.identification.prepare import prepare
from jbw.measurement.kinds import KINDS, Kind
from jbw.measurement.kinds import register as register_kind
from jbw.measurement.records import Record, Test
from jbw.observables.controlled import ControlledPoints
from jbw.observables.dataset import (
    Dataset,
    by_label,
    log_likelihood,
    residual,
    residual_by_label,
    stacked,
)
from jbw.observables.decay import Decays, decay_of
from jbw.observables.line_fit import LineReading
from jbw.observables.loops import Loops
from jbw.observables.noise import num_known, silenced
from jbw.observables.observable import Observable
from jbw.observables.records import Records
from jbw.observables.register import OBSERVABLES, register, taking
from jbw.observables.steady import Points

TRUTH = {
    "omega_n": 127.5, "zeta": 2e-3, "alpha": 2400.0, "delta": 90.0, "gamma": 35.0, "gain": 0.5,
}  # fmt: skip
FS = 256.0
RNG = np.random.default_rng(0)


def theta(**changes):
    return {name: jnp.asarray(value) for name, value in {**TRUTH, **changes}.items()}


def record(fs=FS, **channels):
    units = {
        "input": "V", "velocity": "m/s", "displacement": "m", "restoring_force": "N",
        "frequency": "Hz", "force": "N", "phase": "rad",
    }  # fmt: skip
    return Record(fs, channels, {name: units[name] for name in channels})


def noisy(values, noise=1e-3):
    return values + noise * np.abs(values).max() * RNG.normal(size=values.shape)


def sweep(num, name="sweep"):
    t = np.arange(256) / FS
    u = np.sin(2 * np.pi * (18 * t + 2 * t**2)) * np.sin(np.pi * t / t[-1]) ** 2
    seen = [record(input=u, velocity=noisy(0.02 * u)) for _ in range(num)]
    return Test("sweep", tuple(seen), name, 1.0)


def tone(num, hz=6.0):
    t = np.arange(512) / FS
    u, y = np.cos(2 * np.pi * hz * t), 4e-5 * np.cos(2 * np.pi * hz * t)
    seen = [record(input=u, displacement=noisy(y, 1e-2)) for _ in range(num)]
    return Test("tones", tuple(seen), f"tone {hz:g}", 1.0, tones_hz=(hz,))


def loop(num, name="loop"):
    y = 1e-3 * np.sin(2 * np.pi * np.arange(200) / 100) * np.linspace(0.3, 1.0, 200)
    seen = [record(displacement=y, restoring_force=noisy(3e4 * y)) for _ in range(num)]
    return Test("loop", tuple(seen), name, 1e-3, settle=0.1)


def free(num, name="impacts"):
    return replace(decay_test(), records=decay_test().records[:num], name=name)


def ring_down(num, name="ring", noise=2e-4):
    y = np.linspace(2e-4, 4e-3, 12)
    shape = RingDown.reduce([Test("ring_down", (record(displacement=y, frequency=y),), name)])[0]
    clean = np.asarray(predicted(shape)[0])
    seen = [record(displacement=y, frequency=noisy(clean, noise / clean.max())) for _ in range(num)]
    return Test("ring_down", tuple(seen), name)


def locked(num, name="backbone"):
    y, lag = np.linspace(2e-4, 4e-3, 12), np.full(12, -np.pi / 2)
    channels = {"displacement": y, "phase": lag}
    frequency = 20.0 - 100.0 * y  # predicted anew where a truth is asked for
    seen = [
        record(np.nan, **channels, frequency=noisy(frequency), force=noisy(100.0 * y))
        for _ in range(num)
    ]
    return Test("backbone", tuple(seen), name)


MAKERS = {
    Records: sweep, Points: tone, Loops: loop, Decays: free, RingDown: ring_down,
    ControlledPoints: locked,
}  # fmt: skip


def made(kind, num):
    """Tests of a kind with so many repeats; of tones two, for one value tells no noise."""
    return [tone(num, 5.0), tone(num)] if kind is Points else [MAKERS[kind](num)]


def read():
    mean = np.array([TRUTH[name] for name in ("omega_n", "zeta", "gain")])
    return LineReading.of(mean, np.diag((1e-3 * mean) ** 2), 2e-5, "noise")


@eqx.filter_jit
def predicted(data):
    """What the truth predicts, by one program: eager JAX compiles every loop at every call."""
    return decay_of(theta(), data) if isinstance(data, Decays) else data.predict(theta())


@eqx.filter_jit
def compared(theta, data):
    """Residual by labels, its rows, and the likelihood: one program for data of a kind.

    The residual as pairs, for a program sorts what it returns by keys.
    """
    pairs = tuple(residual(theta, data).items())
    return pairs, stacked(theta, data), log_likelihood(theta, data)


@cache
def noise_free(kind) -> Observable:
    """Data of a kind of test that the truth predicts exactly."""
    if kind is LineReading:
        data = read()
        return replace(data, mean=predicted(data))
    data = kind.reduce(made(kind, 2))[0]
    if kind is Decays:
        curve = predicted(data)
        steps = data.mean.shape[1]
        enters = 2 + 3 * np.arange(2)
        rows = [np.exp(np.asarray(curve)[i : i + steps] + 0.3j) for i in enters]
        return replace(data, mean=jnp.asarray(np.stack(rows)))
    kept = data.groups.counted if kind is Loops else 1.0
    return replace(data, mean=kept * predicted(data))


# Decays of several modes have tests of their own: they need the modes that a structure states.
KINDS_OF_DATA = (*taking(several=False), LineReading, RingDown)
every_kind = pytest.mark.parametrize("kind", KINDS_OF_DATA, ids=lambda kind: kind.__name__)


def test_the_methods_of_a_kind_are_few_and_documented():
    methods = {
        name
        for name, value in vars(Observable).items()
        if not name.startswith("__") and (callable(value) or isinstance(value, classmethod))
    }
    page = (Path(__file__).parents[2] / "docs/architecture.md").read_text(encoding="utf-8")
    assert len(methods) == 12
    assert {name for name in methods if f"`{name}`" not in page} == set()


@every_kind
def test_nothing_is_left_of_what_the_truth_predicts(kind):
    data = noise_free(kind)
    alone = Dataset.of([data])
    rows, wrong = (
        dict(compared(point, alone)[0]) for point in (theta(), theta(omega_n=128.0, alpha=3000.0))
    )
    assert tuple(rows) == data.groups.labels
    assert all(row.shape == (data.groups.width,) for row in rows.values())
    off = np.linalg.norm(np.concatenate([np.asarray(row) for row in wrong.values()]))
    # Of a wrong joint's residual: rounding, and for a decay its cubics between steps.
    for row in rows.values():
        assert np.linalg.norm(np.asarray(row)) < 1e-4 * off


@every_kind
def test_the_residual_is_keyed_by_the_labels_and_comes_back_from_its_rows(kind):
    data = Dataset.of([noise_free(kind)])
    pairs, values, _ = compared(theta(alpha=3000.0), data)
    rows = dict(pairs)
    assert set(rows) == set(data.layout) == set(data.labels)
    again = by_label(np.asarray(values), data)
    for label, row in rows.items():
        np.testing.assert_array_equal(again[label], np.asarray(row))
    assert len(data.runs) == len(data.labels)
    left = residual_by_label(np.concatenate(list(again.values())), data)
    assert set(left) <= set(data.labels)


@pytest.mark.parametrize(
    "kind",
    # Compiling the slope takes ten seconds where time is stepped or a cycle is balanced.
    [
        pytest.param(kind, marks=[pytest.mark.slow] if kind in (Decays, Points, Records) else [])
        for kind in KINDS_OF_DATA
    ],
    ids=lambda kind: kind.__name__,
)
def test_the_likelihood_has_the_slope_that_differences_give(kind):
    data = Dataset.of([noise_free(kind)])
    alpha = 2410.0 if kind is Decays else 2600.0

    def total(omega_n):
        return jnp.sum(stacked(theta(omega_n=omega_n, alpha=alpha), data) ** 2)

    slope = float(jax.jit(jax.grad(total))(jnp.asarray(127.52)))
    step = 1e-4
    pair = [
        float(np.sum(np.square(compared(theta(omega_n=omega_n, alpha=alpha), data)[1])))
        for omega_n in (127.52 + step, 127.52 - step)
    ]
    # Central differences of step h are wrong by a third derivative times h^2. A decay's shift is
    # where Gauss and Newton end, whose slope leaves out what is left times its curvature: of first
    # order in the error of alpha, 0.13 % where that is 10 (0.26 % at 20, 1.3 % at 100, 4 % at 200).
    rel = 2e-3 if kind is Decays else 1e-4
    assert slope == pytest.approx((pair[0] - pair[1]) / (2 * step), rel=rel)
    assert np.all(np.isfinite(compared(theta(alpha=2600.0), data)[2]))


@pytest.mark.parametrize("kind", list(MAKERS), ids=lambda kind: kind.__name__)
def test_one_repeat_and_many_reduce_to_the_same_groups(kind):
    one, many = (kind.reduce(made(kind, num))[0] for num in (1, 3))
    if one.own_shifts:  # records that are no repeats of one another: a group each
        assert len(many.groups.labels) == 3 * len(one.groups.labels)
        return
    assert one.groups.labels == many.groups.labels
    assert one.groups.width == many.groups.width
    assert not num_known(Dataset.of([one]))
    assert set(num_known(Dataset.of([many]))) == set(many.groups.labels)


@every_kind
def test_an_excluded_run_says_nothing(kind):
    data = Dataset.of([noise_free(kind)])
    if data.parts[0].own_shifts:
        return
    out = silenced(data.labels, data)
    wrong = theta(omega_n=128.0)
    of_rest, of_all = (np.sum(np.square(compared(wrong, part)[1])) for part in (out, data))
    assert of_rest < 1e-6 * of_all


@pytest.fixture
def known_kind():
    """The kind of the tests registered, and forgotten again."""
    register_kind(Kind("ring_down", "frequencies of a ring-down"))
    register(RingDown)
    yield
    OBSERVABLES.remove(RingDown)
    del KINDS["ring_down"]


@pytest.mark.release  # test_guests.py has a campaign of it
def test_a_kind_of_ones_own_is_identified_without_a_change_to_jbw(known_kind):
    tests = [ring_down(4, "first"), ring_down(4, "second")]
    data = assemble(measured(tests, Identify(), gain=1.0))
    assert [type(part) for part in data.parts] == [RingDown]
    settings = Identify(
        num_chains=2, num_warmup=100, num_samples=200, substeps=2,
        prior={"alpha": (500.0, 6000.0), "delta": (20.0, 400.0), "gamma": (34.9, 35.1)},
    )  # fmt: skip
    step, _ = joint_step(jax.random.key(0), JointProblem(data, settings))
    draws = step.posterior["posterior"].to_dataset()
    product = (draws["alpha"] * draws["delta"]).values
    truth = TRUTH["alpha"] * TRUTH["delta"]
    assert abs(product.mean() - truth) < 4 * product.std()
    assert product.std() < 0.1 * truth
    assert draws["noise_std_ring_down"].dims == ("chain", "draw", "ring_down")


@pytest.mark.parametrize(
    ("laws", "names"),
    [
        ((), ("omega_n",)),
        (("cubic",), ("omega_n", "cubic")),
        (("jenkins_2",), ("omega_n", "jenkins_2")),
    ],
    ids=["linear", "cubic", "sliders"],
)
def test_a_campaign_of_other_laws_is_prepared(known_kind, laws, names):
    data = assemble(measured([ring_down(4, "first")], Identify(), laws=laws, gain=1.0))
    ready = prepare(jax.random.split(jax.random.key(0)), data, Identify())
    assert data.laws == laws
    found = ready.box.names
    assert found[0] == "omega_n"
    assert all(any(name in one for one in found) or name in laws for name in names)
    assert np.all(np.isfinite(list(ready.fit.theta.values())))


def test_decays_of_this_file_are_those_of_the_band():
    data = Decays.of(free(2))
    assert BAND[0] < data.centre_hz < BAND[1]
    assert SETTLE > 0
