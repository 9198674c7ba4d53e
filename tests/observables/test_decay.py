"""Free decays: the filter, the model's decay, and where records enter it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from decays import (
    BAND,
    FS,
    OMEGA_N,
    SETTLE,
    STATES,
    TRUTH,
    ZETA,
    decay_test,
    free_velocity,
)
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.stats import chi2, kstest

from jbw.errors import DataError
from jbw.measurement.demodulation import band_filter, demodulate
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import Dataset, halved, log_likelihood
from jbw.observables.decay import Decays, begun, decay_of, matched, matches_at
from jbw.observables.decay_envelopes import along, match
from jbw.observables.noise import draw_noise, fractions_counted, silenced

THETA = {name: jnp.asarray(value) for name, value in TRUTH.items()}


def test_envelope_is_that_of_a_decaying_cosine():
    t = np.arange(4096) / FS
    omega, rate = 2 * np.pi * 20.4, 0.3
    x = 1.7 * np.exp(-rate * t) * np.cos(omega * t + 0.6)
    chosen = band_filter(BAND, FS)
    time, envelope = demodulate(x, chosen)
    # A pole s passes a filter with the gain of its z-transform at s: for this slow decay next to 1.
    n = np.arange(-chosen.half, chosen.half + 1) / FS
    gain = np.sum(chosen.taps * np.exp((rate - 1j * (omega - 2 * np.pi * chosen.centre_hz)) * n))
    expected = 1.7 * gain * np.exp((-rate + 1j * omega) * time + 0.6j)
    expected *= np.exp(-2j * np.pi * chosen.centre_hz * time)
    # The other half of the cosine is 80 dB down, and further out at least a factor of ten more.
    assert np.max(np.abs(envelope - expected)) < 2e-5


def test_noise_leaves_independent_values_of_its_own_density():
    chosen = band_filter(BAND, FS)
    x = np.random.default_rng(3).standard_normal(400_000)
    values = demodulate(x, chosen)[1][:: chosen.step]
    # White noise of unit variance has 2 sum h^2 in each part of its envelope.
    assert np.var(values.real) == pytest.approx(2 * np.sum(chosen.taps**2), rel=0.03)
    lag_one = np.vdot(values[:-1], values[1:]) / np.vdot(values, values)
    assert abs(lag_one) < 0.1  # of 9000 values: 0.01 by chance, the rest by the filter's edges


def test_second_mode_is_gone():
    chosen = band_filter(BAND, FS)
    t = np.arange(4096) / FS
    assert np.max(np.abs(demodulate(np.cos(2 * np.pi * 47.0 * t), chosen)[1])) < 1e-4


def test_along_follows_between_steps_and_beyond_the_ends():
    steps = np.arange(60.0)
    log = -0.02 * steps + 1e-4 * steps**2 + 0.03j * steps
    place = np.array([1.25, 10.5, 33.1])
    value, slope = along(jnp.asarray(log), jnp.asarray(place))
    np.testing.assert_allclose(value, -0.02 * place + 1e-4 * place**2 + 0.03j * place, atol=1e-12)
    np.testing.assert_allclose(slope, -0.02 + 2e-4 * place + 0.03j, atol=1e-12)
    outside = along(jnp.asarray(log), jnp.asarray([-5.0]))[0][0]
    np.testing.assert_allclose(outside, log[0] - 5 * (-0.02 + 0.03j), atol=1e-12)  # the tangent


def test_a_decay_whose_frequency_changes_is_followed_from_its_first_step():
    """Within the remainder of the polynomial of six points, at the first step as in the middle.

    A cubic spring adds the phase c (1 - exp(-2 s k)) after k steps, of which six derivatives give
    c (2 s)^6 |P| / 720, with P = t (t - 1) ... (t - 5) at most 17 in the first interval.
    """
    c, s = 2.1, 0.12
    steps, place = np.arange(60), np.linspace(0.0, 58.0, 401)

    def course(k):
        return -s * k + 1j * c * (1 - np.exp(-2 * s * k))

    log, slope = along(course(steps), place)
    remainder = c * (2 * s) ** 6 * 17 / 720
    np.testing.assert_allclose(log, course(place), rtol=0, atol=remainder)
    exact = -s + 2j * c * s * np.exp(-2 * s * place)
    np.testing.assert_allclose(slope, exact, rtol=0, atol=10 * remainder)


@pytest.mark.parametrize("laws", [("bouc_wen",), ("masing_power",), ()])
def test_decays_at_many_points_are_those_of_each_point(laws):
    """By the batch solver and NumPy, as by one traced program for each point."""
    theta = TRUTH | {"power_loss": 90.0, "power_exponent": 0.4}
    data = Decays.of(decay_test(), laws=laws)
    many = {name: value * np.array([1.0, 1.001, 0.998]) for name, value in theta.items()}
    found = matches_at(many, data)
    for i in range(3):
        point = {name: jnp.asarray(values[i]) for name, values in many.items()}
        expected = data.matches(point)
        for ours, theirs in zip(found.entry, expected.entry, strict=True):
            np.testing.assert_allclose(ours[i], theirs, rtol=1e-8, atol=1e-9)
        scale = np.abs(data.mean).max()
        np.testing.assert_allclose(found.residual[i] / scale, expected.residual / scale, atol=1e-9)
        np.testing.assert_allclose(found.precision[i], expected.precision, rtol=1e-7, atol=1e-12)


def test_a_decay_that_diverges_spoils_no_other_point():
    data = Decays.of(decay_test())
    many = {name: np.full(2, float(value)) for name, value in TRUTH.items()}
    many["zeta"] = np.array([ZETA, np.nan])
    found = matches_at(many, data)
    assert np.all(np.isfinite(found.misfit[0]))
    assert np.all(np.isnan(found.misfit[1]))


def cut(test, record, share):
    """A test of which one record ends early."""
    records = list(test.records)
    velocity = records[record].channels["velocity"]
    ended = {"velocity": velocity[: round(share * len(velocity))]}
    records[record] = replace(records[record], channels=ended)
    return replace(test, records=tuple(records))


def test_each_record_has_its_own_length():
    """A record that ends early is matched as if it were alone, and the others as before."""
    whole, ended = Decays.of(decay_test()), Decays.of(cut(decay_test(), 1, 0.6))
    assert ended.lengths[0] == whole.lengths[0] > 1.5 * ended.lengths[1]
    before, found = matched(THETA, whole), matched(THETA, ended)
    others = np.delete(np.arange(len(whole.lengths)), 1)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(before), strict=True):
        np.testing.assert_allclose(a[others], b[others], rtol=1e-7, atol=1e-9)
    values = np.asarray(ended.mean[1])[: ended.lengths[1]]
    alone = match(np.asarray(decay_of(THETA, ended)), values, ended.step_s)
    assert found.misfit[1] == pytest.approx(alone.misfit, rel=1e-7)
    np.testing.assert_allclose(found.precision[1], alone.precision, rtol=1e-7, atol=1e-12)
    assert not np.any(found.residual[1, ended.lengths[1] :])
    # The likelihood, traced, sees the same, and its noise has fewer degrees of freedom.
    np.testing.assert_allclose(ended.matches(THETA).misfit, found.misfit, rtol=1e-7)
    noise = ended.with_fitted_noise(THETA, {}).groups.noise_std[1]
    degrees = 2 * ended.lengths[1] - 3
    assert noise == pytest.approx(np.sqrt(alone.misfit / degrees), rel=1e-7)


def test_match_finds_where_a_record_enters():
    step_s, steps = 0.05, np.arange(400.0)
    log = -3e-3 * steps - 0.5 * np.log1p(0.01 * steps) + 0.02j * np.sqrt(1 + steps)
    place, phase, shift = 41.3, 2.1, 0.05
    inside = place + np.arange(120.0)
    own = -3e-3 * inside - 0.5 * np.log1p(0.01 * inside) + 0.02j * np.sqrt(1 + inside)
    record = np.exp(own + 1j * (phase + shift * step_s * np.arange(120.0)))
    entry = match(jnp.asarray(log), jnp.asarray(record), step_s).entry
    np.testing.assert_allclose(entry.place, place, atol=1e-4)
    np.testing.assert_allclose(np.exp(1j * (entry.phase - phase)), 1.0, atol=1e-6)
    np.testing.assert_allclose(entry.shift, shift, atol=1e-6)


def test_zeros_at_the_end_of_a_record_do_not_hide_where_it_enters():
    log = (-0.2 + 0.3j) * np.arange(400.0)
    place = 12.4
    record = np.exp((-0.2 + 0.3j) * (place + np.arange(120.0)))
    record[25:] = 0.0  # as few bits record the end of a long decay
    found = match(jnp.asarray(log), jnp.asarray(record), 0.05)
    # They hide the share e^-10 of the energy: in places e^-10 / 0.2 = 2.3e-4.
    np.testing.assert_allclose(found.entry.place, place, atol=3e-4)


@pytest.mark.parametrize("seed", range(5))
def test_noise_after_the_motion_does_not_hide_where_a_record_enters(seed):
    """SciPy finds the same least sum of squares. Most of the record is noise.

    The first estimate once took all values by their size, and ended far from the optimum.
    """
    rng, steps = np.random.default_rng(seed), np.arange(115.0)
    decay = (-0.2 + 0.3j) * np.arange(140.0)
    noise = rng.standard_normal((2, 115)) / 6
    envelope = 1.5 * np.exp((-0.2 + 0.3j) * steps + 0.4j) + noise[0] + 1j * noise[1]

    def misses(x):
        model = np.exp(x[0] + 1j * x[1] + (-0.2 + 1j * (0.3 + x[2])) * steps)
        return np.concatenate([(envelope - model).real, (envelope - model).imag])

    least = 2 * least_squares(misses, [np.log(1.5), 0.4, 0.0], xtol=1e-12).cost
    # What three Gauss-Newton steps leave is less than a tenth of the noise of one value, 2 / 6^2.
    found = match(jnp.asarray(decay), jnp.asarray(envelope), 1.0)
    assert float(found.misfit) < least + 0.1 * 2 / 36


@pytest.mark.slow
def test_one_decay_holds_every_record_whatever_its_initial_state():
    data = Decays.of(decay_test(noise=0.0, second=0.0), substeps=2)
    found = data.matches(THETA)
    size = np.linalg.norm(np.asarray(data.mean), axis=1)
    # Initial states at every phase and with an unstrained joint, integrated by another solver.
    # Entering one decay by place and rotation is exact but for the joint's memory of its start.
    assert np.max(np.sqrt(found.misfit) / size) < 1e-3
    assert np.max(np.abs(found.entry.shift)) / OMEGA_N < 1e-6
    decay = decay_of(THETA, data)
    amplitude = np.exp(np.asarray(along(decay, found.entry.place)[0].real))
    np.testing.assert_allclose(amplitude, np.abs(np.asarray(data.mean[:, 0])), rtol=1e-3)


@pytest.mark.parametrize("band", [(10.0, 40.0), (14.0, 26.0), (8.0, 22.0)])
def test_the_simulated_decay_begins_above_the_record_wherever_its_mode_lies_in_the_band(band):
    """An acceleration over the square of the band's centre is another displacement."""
    omega, drag, t = 2 * np.pi * 20.0, 5.0, np.arange(1536) / FS
    found = solve_ivp(
        lambda _, x: (x[1], -6e-3 * omega * x[1] - drag * x[1] * abs(x[1]) - omega**2 * x[0]),
        (0, t[-1]), (0.0, 0.3), "DOP853", t, rtol=1e-10, atol=1e-13,
    )  # fmt: skip
    y, v = found.y
    a = -6e-3 * omega * v - drag * v * np.abs(v) - omega**2 * y
    record = Record(FS, {"acceleration": a}, {"acceleration": "m/s^2"})
    data = Decays.of(Test("decay", (record,), band_hz=band), laws=("quadratic_damping",))
    match = matched({"omega_n": omega, "zeta": 3e-3, "quadratic_damping": drag}, data)
    assert float(match.entry.place[0]) > 0.0  # before its beginning nothing was simulated
    size = np.linalg.norm(np.asarray(data.mean))
    # Cubics between the steps leave 2e-5 to 5e-5; a decay that begins too low left 6e-3.
    assert float(np.sqrt(match.misfit[0])) / size < 2e-4


@pytest.mark.parametrize("zeta", [0.004, 0.04])
def test_the_simulated_decay_begins_no_higher_than_the_record(zeta):
    """Twice as high, a softening spring that carries the record may have no way back."""
    omega, t = 2 * np.pi * 20.0, np.arange(2048) / FS
    y = 1e-3 * np.exp(-zeta * omega * t) * np.cos(omega * t)
    record = Record(FS, {"displacement": y}, {"displacement": "m"})
    data = Decays.of(Test("decay", (record,), "tap", band_hz=BAND), laws=())
    # The headroom of 2 %, and 1 % for the rate that the first values of the envelope have.
    assert 1e-3 < float(data.y_start) < 1.03e-3


def test_the_largest_displacement_is_that_of_the_record_and_not_of_the_simulated_decay():
    omega, rate, t = 2 * np.pi * 20.0, 0.5, np.arange(4096) / FS
    v = 0.3 * np.exp(-rate * t) * np.cos(omega * t)
    record = Record(FS, {"velocity": v}, {"velocity": "m/s"})
    data = Decays.of(Test("decay", (record,), "tap", band_hz=BAND, settle=SETTLE), laws=())
    lead = band_filter(BAND, FS).half / FS
    most, least = (0.3 / omega * np.exp(-rate * at) for at in (SETTLE, SETTLE + 2 * lead))
    # The filter's own ripple is a thousandth at most.
    assert 0.999 * least < data.shown(omega).y_peak < 1.001 * most


@pytest.mark.parametrize("response", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("zeta", [0.004, 1.3])
def test_the_decay_of_a_structure_without_a_joint_is_exact(response, zeta):
    data = Decays.of(decay_test(noise=0.0, second=0.0), laws=())
    data = replace(data, response=response)
    theta = {"omega_n": jnp.asarray(OMEGA_N), "zeta": jnp.asarray(zeta)}
    # Its motion by the exponential of the state matrix, through the filter as it stands.
    system = np.array([[0.0, 1.0], [-(OMEGA_N**2), -2 * zeta * OMEGA_N]])
    count = 40 * data.stride + len(data.taps)
    step, state = expm(system / data.fs), np.array([float(data.y_start), 0.0])
    motion = []
    for _ in range(count):
        motion.append([*state, (system @ state)[1]])
        state = step @ state
    x = np.array(motion)[:, ["displacement", "velocity", "acceleration"].index(response)]
    every = np.convolve(x, np.asarray(data.taps)[::-1], "valid")[:: data.stride]
    found = np.asarray(decay_of(theta, replace(data, num_samples=count)))
    turn = np.exp(1j * np.arange(len(every)) * np.angle(complex(data.rotation)))
    expected = every * turn / every[0] * np.abs(every[0])
    # Round-off of sums over the filter, of a motion that has fallen far where it is overdamped.
    np.testing.assert_allclose(np.exp(found), expected, rtol=1e-8)


def test_steps_of_a_structure_without_a_joint_are_exact_and_not_halved():
    test = decay_test(noise=0.0, second=0.0)
    assert halved(Dataset.of([Decays.of(test, laws=())])) is None
    bare = Decays.of(test)
    (finer,) = halved(Dataset.of([bare])).parts
    assert finer is not None
    assert finer.substeps == 2 * bare.substeps


def test_entry_is_the_initial_state():
    y0, v0 = STATES[1]
    v = free_velocity(y0, v0, 1.0)
    assert len(v) == 512
    amplitude = OMEGA_N * np.hypot(y0, v0 / OMEGA_N)
    chosen = band_filter(BAND, FS)
    _, envelope = demodulate(v, chosen)
    # Half a filter after the impact, less what has decayed: between zeta and thrice zeta.
    lost = np.log(amplitude / np.abs(envelope[0])) / (OMEGA_N * chosen.half / FS)
    assert ZETA < lost < 3 * ZETA


@pytest.mark.parametrize(
    ("band", "samples", "word"),
    [(None, 4608, "band"), (BAND, 300, "longer"), (BAND, 700, "values")],
)
def test_useless_decays_are_refused(band, samples, word):
    record = Record(FS, {"velocity": np.ones(samples)}, {"velocity": "m/s"})
    with pytest.raises(DataError, match=word):
        Decays.of(Test("decay", (record,), "impacts", band_hz=band, settle=SETTLE))


@pytest.mark.release  # test_contract.py has this of every kind
def test_a_silenced_record_counts_as_if_it_were_not_there():
    test = decay_test(shifts=(3e-6, -4e-6, 1e-6, 0.0))
    data = Decays.of(test)
    rest = Decays.of(replace(test, records=test.records[1:]))
    (silent,) = silenced(data.groups.labels[:1], Dataset.of([data])).parts
    # The model's decay begins at the largest amplitude of all records.
    rest = replace(rest, y_start=data.y_start, num_samples=data.num_samples)
    found = [log_likelihood(THETA, Dataset.of([one])) for one in (silent, rest)]
    assert float(found[0][0]) == 0.0
    np.testing.assert_allclose(found[0][1:], found[1], rtol=1e-9)
    rows, _ = silent.weighted(THETA)
    assert not np.any(rows[0])
    assert fractions_counted(Dataset.of([silent]))[data.groups.runs[0]] < 1e-9


def test_noise_is_drawn_from_its_exact_posterior():
    r"""Of n values and 3 that a record's beginning takes, $w Q / \sigma^2$ is $\chi^2_{n-3}$."""
    data = Decays.of(decay_test(second=0.0), laws=())
    theta = {"omega_n": 1.001 * OMEGA_N, "zeta": ZETA}
    drawn = {name: np.full((4, 1000), value) for name, value in theta.items()}
    noise = draw_noise(jax.random.key(0), drawn, {}, data, 1)
    squares = np.asarray(data.matches({n: jnp.asarray(v) for n, v in theta.items()}).misfit)
    num_values = 2 * data.mean.shape[1]
    for label, square in zip(data.groups.labels, squares, strict=True):
        assert noise[label].shape == (4, 1000)
        p = kstest((square / noise[label] ** 2).ravel(), chi2(num_values - 3).cdf).pvalue
        assert p > 1e-3


def test_of_a_shift_at_the_beginning_only_the_records_own_part_goes_on():
    """Own shifts and errors of the law drawn by their priors: what is left of both is as stated."""
    own_std, law_std, step_s, size = 0.02, 0.05, 0.05, 60
    steps = np.arange(400.0)
    log = -3e-3 * steps - 0.5 * np.log1p(0.01 * steps) + 0.02j * np.sqrt(1 + steps)
    inside = 41.3 + np.arange(float(size))
    motion = -3e-3 * inside - 0.5 * np.log1p(0.01 * inside) + 0.02j * np.sqrt(1 + inside)
    data = replace(Decays.of(decay_test()), shift_std=jnp.asarray(own_std), step_s=step_s)
    rng, noise, errors, phases = np.random.default_rng(5), 1e-3, [], []
    for own, of_law in rng.standard_normal((300, 2)) * [own_std, law_std]:
        total = own + of_law
        record = np.exp(motion + 1j * (2.1 + total * step_s * np.arange(size)))
        record = record + noise * (rng.standard_normal(size) + 1j * rng.standard_normal(size))
        found = begun(log, record, noise, data, law_std)
        errors.append((float(found.entry.shift) - own) / float(jnp.sqrt(found.covariance[2, 2])))
        end = step_s * size
        turn = found.entry.phase + found.entry.shift * end - (2.1 + total * end)
        phases.append(float(np.angle(np.exp(1j * turn))))
    # Standard normal, of 300: the standard deviation is within 4 %, one standard deviation.
    assert np.mean(errors) == pytest.approx(0.0, abs=0.25)
    assert np.std(errors) == pytest.approx(1.0, abs=0.17)
    # The phase at the end of the beginning is measured, whatever the shift consists of.
    assert np.std(phases) < 5e-3


def test_without_an_error_of_the_law_the_whole_shift_goes_on():
    log = jnp.asarray((-3e-3 + 0.02j) * np.arange(400.0))
    record = jnp.exp(log[:60] + 0.05j * 0.05 * jnp.arange(60.0))
    data = replace(Decays.of(decay_test()), shift_std=jnp.asarray(10.0), step_s=0.05)
    sharp = begun(log, record, jnp.asarray(1e-6), data)
    assert float(sharp.entry.shift) == pytest.approx(0.05, rel=1e-6)
    precision = match(log, record, 0.05).precision * data.fraction / 1e-12
    expected = np.linalg.inv(np.asarray(precision.at[2, 2].add(1e-2)))
    np.testing.assert_allclose(sharp.covariance, expected, rtol=1e-9)
