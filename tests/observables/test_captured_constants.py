"""No compiled program holds data, or numbers as long as a record, as constants of its own.

A constant is kept with every program that has it, and compiled anew for every record: programs of
long records took gigabytes. Everything that is as long as the data is an argument, or made within.
"""

import re
from math import prod

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jbw
from jbw import rig
from jbw.campaign.settings import Identify
from jbw.identification.assemble import assemble, measured
from jbw.observables.dataset import log_likelihood, stacked
from jbw.observables.residual_terms import added_response
from jbw.observables.samples import band_limited, response_to
from jbw.oscillator.hold import HOLDS, held, periodic_derivatives

pytestmark = pytest.mark.filterwarnings("ignore")  # of short records, on which nothing is judged
MOST = 4096  # bytes of one constant: tables of quadrature rules are of some hundreds
BITS = {"i1": 8, "i8": 8, "ui8": 8}  # a truth takes a byte
CONSTANT = re.compile(
    r"constant dense<\s*[\"\[][^>]*(?:>[^:]*)?: tensor<([\dx]*x)(complex<)?(u?[a-z]+\d+)"
)
JOINT = {"omega_n": 118.0, "zeta": 5e-3, "alpha": 497.4, "delta": 340.0, "gamma": 33.0, "gain": 0.5}
LONG = 3001


def constants(text):
    """Bytes of every dense constant in the text of a lowered program."""
    for shape, is_complex, kind in CONSTANT.findall(text):
        bits = BITS.get(kind, int(re.search(r"\d+", kind)[0])) * (2 if is_complex else 1)
        yield prod(map(int, shape.strip("x").split("x"))) * bits // 8


def assert_holds_none(function, *arguments):
    text = eqx.filter_jit(function).lower(*arguments).as_text()
    assert max(constants(text), default=0) <= MOST


def theta():
    return {name: jnp.asarray(value) for name, value in JOINT.items()}


def test_a_constant_is_found_where_one_is():
    row = np.arange(float(LONG))

    def captures(x):
        return x * row + jnp.asarray(row > 2.0)

    text = jax.jit(captures).lower(jnp.zeros(LONG)).as_text()
    assert sorted(constants(text)) == [LONG, 8 * LONG]
    with pytest.raises(AssertionError):
        assert_holds_none(captures, jnp.zeros(LONG))


@pytest.fixture(scope="module")
def mixed():
    """The rig's campaign of noise, tones, stepped sines, sweeps, decays and a loop."""
    campaign = rig.measure("mixed", seed=0, repeats=1, noise_ratio=0.02, force_noise_std=0.2)
    data = assemble(measured(campaign.tests, Identify(**{**campaign.settings, "substeps": 2})))
    return campaign, data


def test_the_likelihood_of_every_kind_of_test(mixed):
    _, data = mixed
    kinds = {type(part).__name__ for part in data.parts}
    assert kinds >= {"Records", "Points", "Decays", "Loops"}
    assert_holds_none(log_likelihood, theta(), data)


def test_the_derivatives_of_every_kind_of_test(mixed):
    _, data = mixed
    assert_holds_none(jax.jacfwd(stacked), theta(), data)


def test_the_prediction_of_a_record(mixed):
    campaign, _ = mixed
    test = next(test for test in campaign.tests if test.kind == "sweep")
    record = test.records[0]
    source = band_limited(record.channels[record.source])

    def predicted(draws, source):
        facts = dict(laws=("bouc_wen",), substeps=2)
        return response_to(draws, source, record.fs, residuals="auto", **facts)

    assert_holds_none(predicted, theta(), source)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("hold", HOLDS)
def test_an_input_that_is_traced_is_held(hold, periodic):
    assert_holds_none(lambda u: held(u, hold, periodic=periodic).polynomials, jnp.zeros(LONG - 1))


def test_motion_under_a_traced_input():
    joint = jbw.BoucWen(118.0, 5e-3, 497.4, 340.0, 33.0)
    run = lambda joint, u, fs: jbw.simulate(joint, u, fs)  # noqa: E731
    assert_holds_none(run, joint, jnp.zeros(LONG), jnp.asarray(512.0))
    tone = jbw.excitation.tone(1.0, 100.0)
    under_tone = lambda fs: jbw.simulate(joint, tone, fs, num_samples=LONG)  # noqa: E731
    assert_holds_none(under_tone, jnp.asarray(512.0))


def test_terms_beside_the_joint_and_noise_of_a_band():
    terms = {"residual_upper": jnp.asarray(1e-6), "residual_lower": jnp.asarray(1e-3)}

    def added(terms, force):
        return added_response(terms, force, 512.0, response="velocity", periodic=False)

    assert_holds_none(added, terms, jnp.zeros(LONG))
    assert_holds_none(
        lambda key: jbw.excitation.band_noise(key, 1.0, (5.0, 60.0), 512.0, 2 * LONG),
        jax.random.key(0),
    )


@pytest.mark.parametrize("num", [6, 7, 512, 513])
def test_what_is_made_in_a_program_is_what_numpy_makes(num):
    """The same record held by NumPy, as data are, and by JAX, as a traced input is."""
    u = np.random.default_rng(num).standard_normal(num)
    for periodic in (False, True):
        by_numpy = held(u, "band_limited", periodic=periodic).polynomials
        by_jax = held(jnp.asarray(u), "band_limited", periodic=periodic).polynomials
        # Of Fourier transforms of rounding 1e-16, derived twice: pi^2 a sample.
        scale = np.max(np.abs(by_numpy))
        np.testing.assert_allclose(by_jax, by_numpy, rtol=0.0, atol=1e-12 * scale)


@pytest.mark.parametrize("k", range(1, 9))
def test_derivatives_of_every_line_of_a_period_are_those_of_the_sine(k):
    """cos(2 pi k n / 16 + 1) by hand; at the Nyquist frequency its samples show no slope."""
    theta = 2 * np.pi * k / 16
    n = np.arange(16)
    u, shown = np.cos(theta * n + 1), -theta * np.sin(theta * n + 1) * (k < 8)
    for values in (u, jnp.asarray(u)):
        slope, curvature = periodic_derivatives(values)
        np.testing.assert_allclose(slope, shown, atol=1e-13)
        np.testing.assert_allclose(curvature, -(theta**2) * u, atol=1e-13)
