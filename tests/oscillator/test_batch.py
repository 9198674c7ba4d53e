"""Oscillators side by side by one program, against `jbw.simulate` one after the other."""

import gc
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from compiling import Compiled

import jbw
from jbw.inference.groups.offsets import estimate
from jbw.observables.samples import band_limited, models_at, response_to
from jbw.oscillator import batch
from jbw.oscillator.batch import (
    INTERVALS,
    LANES,
    MeasuredResponse,
    compile_ahead,
    march,
    record_of,
    released,
)
from jbw.oscillator.deepening import OF_SEVERAL_MODES, with_depth
from jbw.oscillator.laws import laws_named
from jbw.oscillator.laws.reversals import SIZE
from jbw.oscillator.oscillator import oscillator_of

FS = 1024.0
LETTERS = "yva"
MARCHED = "jit(_marched)"  # the name of the batch solver's program
THETA = {
    "omega_n": 118.0, "zeta": 0.005, "alpha": 500.0, "delta": 340.0, "gamma": 33.0,
    "quadratic_damping": 0.3,
}  # fmt: skip


def joints(count, laws=("bouc_wen",)):
    rng = np.random.default_rng(count)
    theta = {n: x * (1 + 1e-2 * rng.standard_normal(count)) for n, x in THETA.items()}
    return jax.vmap(lambda point: oscillator_of(point, laws))(theta)


def sweep(size):
    t = np.arange(size) / FS
    return band_limited(0.5 * np.sin(2 * np.pi * (10 * t + 5 * t**2)))


def alone(many, i, source, gain, substeps):
    joint = jax.tree.map(lambda leaf: leaf[i], many)
    return jbw.simulate(joint, source.times(gain), FS, substeps=substeps)


@pytest.mark.parametrize(
    ("laws", "order", "size"),
    [
        (("bouc_wen",), 1, 2 * INTERVALS + 7),
        (("bouc_wen", "quadratic_damping"), 2, INTERVALS + 1),
        ((), 0, 300),
    ],
)
def test_lanes_march_as_each_alone(laws, order, size):
    many, source, gains = joints(3, laws), sweep(size), np.array([1.0, 14.0, 15.0])
    found = march(many, gains, record_of(source), FS, 2, order)
    assert found.response.shape == (3, size)
    for i in range(3):
        motion = alone(many, i, source, gains[i], 2)
        expected = np.asarray(getattr(motion, LETTERS[order]))
        # The same steps, in programs that round a product's last digit differently.
        np.testing.assert_allclose(
            found.response[i], expected, rtol=0, atol=1e-11 * np.abs(expected).max()
        )
        np.testing.assert_allclose(found.y_peak[i], np.abs(motion.y).max(), rtol=1e-11)


def test_sums_are_those_of_the_written_residual():
    rng, size, first = np.random.default_rng(0), INTERVALS + 900, 100
    values, rows = rng.standard_normal(size - first), rng.standard_normal((2, size - first))
    known, many, source = rng.standard_normal((5, 2)), joints(5), sweep(size)
    gains = np.linspace(1.0, 15.0, 5)
    record = record_of(source, None, MeasuredResponse(values, rows, first))
    found = march(many, gains, record, FS, 2, 1, known=known)
    residual = values - found.response[:, first:] - known @ rows
    # Sums of 4,896 products, added in another order.
    np.testing.assert_allclose(found.square, np.sum(residual**2, axis=1), rtol=1e-12)
    np.testing.assert_allclose(found.along, residual @ rows.T, rtol=0, atol=1e-10 * size)
    np.testing.assert_array_equal(found.peak, np.abs(found.response[:, first:]).max(axis=1))
    factors = rng.standard_normal((3, size))
    multiplied = record._replace(rows=factors)
    silent = march(many, gains, multiplied, FS, 2, 1, known=known, writes=False)
    assert silent.response is None
    assert found.products is None
    np.testing.assert_allclose(
        silent.products, found.response @ factors.T, rtol=0, atol=1e-12 * size
    )
    np.testing.assert_array_equal(silent.square, found.square)


def exact_sums(residuals_of, rows) -> Any:
    """Squares, products with the rows, and what is left of the squares without these, by mpmath."""
    with mp.workdps(50):
        values, response, known = residuals_of
        rows = [[mp.mpf(x) for x in row] for row in rows]
        parts = [[mp.mpf(part) * x for x in row] for part, row in zip(known, rows, strict=True)]
        pairs = zip(values, response, *parts, strict=True)
        residual = [mp.mpf(d) - mp.mpf(x) - sum(part) for d, x, *part in pairs]
        square, along = mp.fdot(residual, residual), [mp.fdot(row, residual) for row in rows]
        normal = mp.matrix([[mp.fdot(one, other) for other in rows] for one in rows])
        offset = mp.lu_solve(normal, mp.matrix(along))
        return square, along, square - mp.fdot(offset, along)


def test_terms_are_exact_but_for_rounding():
    """Where offsets take away nearly all of the squares, their rounding is what a term has left.

    So terms of the loop's sums and of sums over written rows differ by it, neither being the
    better one: where |r|^2 is 1e4 times what is left, by 1e-12 of the term.
    """
    size, many, source, gains = 3000, joints(2), sweep(3000), np.array([8.0, 15.0])
    time = np.arange(size) / FS
    like = march(many, gains, record_of(source), FS, 2, 1).response[0]
    # Of an offset of frequency, which shifts the motion in time, and of damping.
    rows = np.stack([np.gradient(like, 1 / FS) * time / 118.0, like * time * 118.0])
    noise = np.random.default_rng(1).standard_normal(size)
    values, known = like + 1e-3 * np.abs(like).max() * noise, np.array([[0.3, 1e-4], [2.0, 3e-3]])
    record = record_of(source, None, MeasuredResponse(values, rows))
    found = march(many, gains, record, FS, 2, 1, known=known)
    taken = []  # squares over what is left of them
    for i, response in enumerate(found.response):
        square, along, left = exact_sums((values, response, known[i]), rows)
        written = values - response - known[i] @ rows
        for squares, products in (
            (found.square[i], found.along[i]),
            (written @ written, rows @ written),
        ):
            # One sum after the other of 3,000 terms: as the root of their number, 6e-15.
            assert abs(float(squares / square - 1)) < 3e-14
            scale = np.sqrt(float(square) * np.sum(rows**2, axis=1))
            error = [float(x - exact) for x, exact in zip(products, along, strict=True)]
            np.testing.assert_allclose(error / scale, 0.0, atol=3e-14)
            term = estimate(
                *map(jnp.asarray, ([squares], [products], [0.0], [1.0], [float(size)], [rows]))
            ).log_density[0]
            rounding = 3e-14 * float(square / left) * size / 2
            assert abs(float(term) + size / 2 * float(mp.log(left))) < rounding
        taken.append(float(square / left))
    assert taken[0] > 1e3


def test_laws_that_remember_reversals_march_too():
    laws, factors = ("masing_exponential",), jnp.array([1.0, 1.02])
    own = dict(zip(laws_named(laws)[0].names(), (500.0, 340.0), strict=True))
    theta = {"omega_n": 118.0, "zeta": 0.005, **own}
    many = jax.vmap(
        lambda x: with_depth(oscillator_of({n: x * value for n, value in theta.items()}, laws), 6)
    )(factors)
    source = sweep(700)
    found = march(many, np.array([10.0, 12.0]), record_of(source), FS, 2, 1)
    for i, gain in enumerate((10.0, 12.0)):
        expected = np.asarray(alone(many, i, source, gain, 2).v)
        np.testing.assert_allclose(
            found.response[i], expected, rtol=0, atol=1e-11 * np.abs(expected).max()
        )


def test_one_program_serves_records_of_any_length_rate_and_step():
    many, gains = joints(2), np.ones(2)
    march(many, gains, record_of(sweep(200)), FS, 2, 1)
    with Compiled() as compiled:
        for size, fs, substeps in ((5000, 2048.0, 1), (333, 100.0, 4), (90, 64.0, 3)):
            march(many, gains, record_of(sweep(size)), fs, substeps, 1)
        march(joints(LANES), np.ones(LANES), record_of(sweep(200)), FS, 2, 1)
    assert MARCHED not in compiled


def test_a_program_compiled_ahead_is_the_one_that_marches():
    laws = ("bouc_wen", "quintic")
    joint = oscillator_of({**THETA, "quintic": 1e9}, laws)
    many = jax.tree.map(lambda x: np.full(2, x), joint)
    compile_ahead(many, 0)
    with Compiled() as compiled:
        march(many, np.ones(2), record_of(sweep(100)), FS, 2, 0)
    assert MARCHED not in compiled


@pytest.mark.parametrize("laws", [("bouc_wen",), ("masing_power",), ("quadratic_damping",)])
def test_a_joint_that_is_released_moves_freely_from_the_tip_of_its_loop(laws):
    """From Y without velocity, with the memory of the steady loop; over a piece's end."""
    masing = {"power_loss": 90.0, "power_exponent": 0.4}
    rng = np.random.default_rng(5)
    theta = {n: x * (1 + 1e-2 * rng.standard_normal(3)) for n, x in (THETA | masing).items()}
    many, size, y_peak = jax.vmap(lambda p: oscillator_of(p, laws))(theta), INTERVALS + 30, 2e-3
    found = march(many, np.ones(3), released(y_peak, size), FS, 2, 1)
    for i in range(3):
        joint = jax.tree.map(lambda leaf, i=i: leaf[i], many)
        start = (y_peak, 0.0, joint.at_tip(jnp.asarray(y_peak)))
        motion = jbw.simulate(joint, np.zeros(size), FS, hold="zero", initial=start, substeps=2)
        # The same steps, in programs that round a product's last digit differently.
        np.testing.assert_allclose(found.response[i], motion.v, rtol=0, atol=1e-11)


def test_a_lane_that_cannot_be_solved_spoils_no_other():
    source, gains = sweep(400), np.ones(4)
    sound = march(joints(4), gains, record_of(source), FS, 2, 1)
    gains[2] = np.nan
    found = march(joints(4), gains, record_of(source), FS, 2, 1)
    assert np.isnan(found.response[2]).any()
    assert np.isnan(found.square[2])
    kept = [0, 1, 3]
    np.testing.assert_array_equal(found.response[kept], sound.response[kept])


def test_what_was_made_of_a_record_goes_with_it():
    record_of(sweep(100))  # of arrays that are gone
    source = sweep(100)
    before = len(batch._CACHE._made)
    assert record_of(source).pieces[0].samples is record_of(source).pieces[0].samples
    assert len(batch._CACHE._made) == before + 1
    del source
    gc.collect()
    assert len(batch._CACHE._made) <= before


@pytest.mark.slow
def test_a_structure_remembers_as_many_reversals_as_alone():
    """Noise over two modes that move one joint of Iwan-4, whose load reverses hundreds of times."""
    rng, size = np.random.default_rng(3), 3000
    line = np.fft.rfftfreq(size, 1 / FS)
    phases = np.exp(2j * np.pi * rng.random(len(line)))
    u = np.fft.irfft(((line > 8) & (line < 70)) * phases, size)
    source, laws = band_limited(6.0 * u / u.std()), ("iwan4",)
    theta = {
        "omega_n": 118.0, "zeta": 0.003, "gain": 15.0, "iwan_stiffness": 600.0, "iwan_loss": 300.0,
        "iwan_chi": -0.3, "iwan_beta": 0.5, "omega_2": 300.0, "zeta_2": 0.004,
        "gain_ratio_2": -0.9, "shape_2": 1.4, "sign_2": -1.0, "coupling_2": 1.7,
    }  # fmt: skip
    models: Any = models_at({name: np.full(2, x) for name, x in theta.items()}, laws, depth=SIZE)
    assert {law.depth for of_joint in models.laws for law in of_joint} == {OF_SEVERAL_MODES}
    models = replace(models, c=models.c[:, [0, 0]])
    found = march(models, np.full(2, theta["gain"]), record_of(source), FS, 2, 1).response
    point = {name: jnp.asarray(x) for name, x in theta.items()}
    alone = response_to(point, source, FS, response="velocity", laws=laws, depth=SIZE)
    # Both take the same steps; rounding is amplified by the resonance.
    np.testing.assert_allclose(found[0], alone, rtol=0, atol=1e-12 * np.abs(alone).max())
