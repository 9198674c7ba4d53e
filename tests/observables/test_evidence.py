"""Several kinds of tests in one likelihood, and the offsets of their runs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from known_laws import compiled

from jbw.campaign.settings import Identify
from jbw.errors import ConfigError, DataError
from jbw.identification.assemble import assemble, measured
from jbw.identification.checks import joint_step
from jbw.identification.joint import JointProblem
from jbw.identification.leaving_out import (
    consistency_finding,
    fits_without_each_run,
    leave_one_out,
)
from jbw.identification.prepare import reweight, with_weights
from jbw.identification.run_effects import (
    runs_dataset,
    runs_sentence,
    runs_summary,
    shifts_of,
    wanted,
    with_offsets,
)
from jbw.inference.fit.costly_fit import costly_fit
from jbw.inference.space.box import box
from jbw.measurement.records import Record, Test
from jbw.observables.dataset import (
    Dataset,
    best_offsets,
    estimates,
    log_likelihood,
    residual_by_label,
    stacked,
)
from jbw.observables.drives import told_by
from jbw.observables.noise import effective_fractions, fractions_counted, with_fitted_noise
from jbw.oscillator.laws.hysteresis import hysteresis_map, steady_loop
from jbw.oscillator.oscillator import BoucWen

TRUTH = {"omega_n": 500.0, "zeta": 0.003, "alpha": 4e4, "delta": 900.0, "gamma": 500.0}
GAIN = 0.5
NOISE = 2e-3


def fractions_of(best, data):
    return effective_fractions(best.residual, best.jacobian, best.covariance, data)


def joint(**changes):
    return BoucWen(**{**TRUTH, **changes})


@compiled
def first_harmonics(one, sizes):
    """First harmonics of a joint's hysteretic force at amplitudes."""
    return jax.vmap(lambda size: steady_loop(one, size).z_1)(sizes)


@compiled
def hysteretic(one, steps):
    """Hysteretic force from rest behind each step of a displacement."""

    def onward(z, dy):
        z = hysteresis_map(one, z, dy)
        return z, z

    return jax.lax.scan(onward, jnp.zeros(()), steps)[1]


def curve(level, seed=0, repeats=4, noise=NOISE, omega_n=500.0, zeta=0.003, name=None):
    """Force that holds the acceleration at a level, from the closed form of the loop."""
    rng, one = np.random.default_rng([seed, int(level)]), joint(omega_n=omega_n, zeta=zeta)
    freq = np.linspace(77.5, 81.0, 36)
    omega = 2 * np.pi * freq
    y = level / omega**2
    z_1 = np.asarray(first_harmonics(one, y))
    stiffness = one.k - omega**2 + 2j * one.zeta * one.omega_n * omega
    force = (stiffness * y + z_1) / GAIN
    records = []
    for _ in range(repeats):
        seen = force + noise * (rng.normal(size=36) + 1j * rng.normal(size=36))
        # The measured phase is the response's against the force.
        channels = {
            "frequency": freq,
            "force": np.abs(seen),
            "acceleration": np.abs(-(omega**2) * y * np.exp(-1j * np.angle(seen))),
            "phase": np.pi - np.angle(seen),
        }
        units = {"frequency": "Hz", "force": "N", "acceleration": "m/s^2", "phase": "rad"}
        records.append(Record(float("nan"), channels, units))
    return Test("frf", tuple(records), name or f"held at {level:g}", float(level))


def loop(seed=0):
    """Force along a growing displacement, by the exact map."""
    t = np.arange(400) / 100.0
    y = 1e-3 * np.sin(2 * np.pi * t) * (0.3 + 0.2 * t)
    one = joint()
    force = hysteretic(one, np.diff(y, prepend=0.0))
    rng = np.random.default_rng(seed)
    clean = (one.k * y + np.asarray(force)) / GAIN
    records = tuple(
        Record(100.0, {"displacement": y, "restoring_force": clean + 0.3 * rng.normal(size=400)},
               {"displacement": "m", "restoring_force": "N"})
        for _ in range(3)
    )  # fmt: skip
    return Test("loop", records, "loop", 1e-3)


@pytest.fixture(scope="module")
def mixed():
    return assemble(measured([curve(5), curve(20), curve(60), loop()], Identify(), gain=GAIN))


def theta(**changes):
    return {name: jnp.asarray(value) for name, value in {**TRUTH, **changes}.items()}


PRIOR = {
    "omega_n": (490.0, 510.0), "zeta": (0.001, 0.01), "alpha": (1e4, 1e5),
    "delta": (100.0, 3000.0), "gamma": (100.0, 3000.0),
}  # fmt: skip


def test_terms_of_the_parts_add_up(mixed):
    both = np.asarray(log_likelihood(theta(), mixed))
    apart = [
        np.asarray(log_likelihood(theta(), Dataset.of([part], {"gain": GAIN})))
        for part in mixed.parts
    ]
    np.testing.assert_allclose(both, np.concatenate(apart), rtol=1e-14)
    assert len(both) == 4


@pytest.mark.slow
def test_least_squares_and_likelihood_agree_about_the_optimum(mixed):
    """At the optimum of one the other has no slope, and their curvatures agree."""
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, box(PRIOR), mixed, starts=middle)
    left = residual_by_label(best.residual, mixed)
    again = costly_fit(
        stacked, box(PRIOR), with_fitted_noise(best.theta, left, mixed), starts=best.theta
    )
    left = residual_by_label(again.residual, mixed)
    data = with_fitted_noise(again.theta, left, mixed)
    names = list(PRIOR)
    sd = np.sqrt(np.diag(again.covariance))

    def total(u):
        values = {n: again.theta[n] + sd[i] * u[i] for i, n in enumerate(names)}
        return jnp.sum(log_likelihood(values, data))

    program = jax.jit(lambda u: (jax.grad(total)(u), jax.hessian(total)(u)))
    slope, hessian = map(np.asarray, program(jnp.zeros(5)))
    # In posterior sds; what is left is the change of noise between two fits.
    assert np.abs(slope).max() < 0.05
    covariance = np.linalg.inv(-hessian)
    # Gauss-Newton leaves out the second derivatives of the residual.
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 1.0, rtol=0.1)
    truth = np.array([TRUTH[name] for name in names])
    apart = truth - np.array([again.theta[name] for name in names])
    assert apart @ np.linalg.solve(again.covariance, apart) < 25  # chi-square of 5, p = 1e-4


def test_what_a_fit_leaves_is_read_off_its_residual(mixed):
    at_truth = np.asarray(stacked({**theta(), "gain": GAIN}, mixed))
    left = residual_by_label(at_truth, mixed)
    assert set(left) == {"held at 5", "held at 20", "held at 60", "loop"}
    assert left["held at 5"].shape == (36,)
    assert left["loop"].shape == (400,)
    # Means of 4 repeats: complex noise of 2e-3 a component; 72 values know it to 8 %.
    assert np.std(left["held at 20"].view(float)) == pytest.approx(NOISE / 2, rel=0.35)


def test_offsets_of_runs_are_seen_and_let_in():
    shifted = [500.0, 500.9, 499.2, 500.4]
    tests = [
        curve(level, omega_n=w, seed=i)
        for i, (level, w) in enumerate(zip((5, 20, 40, 60), shifted, strict=True))
    ]
    prior = box(PRIOR)
    data = assemble(measured(tests, Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts=middle)
    shifts = shifts_of(best, prior.names, data)
    assert shifts is not None
    assert wanted(shifts, Identify())
    assert not wanted(shifts, Identify(offsets="none"))
    with_own = with_offsets(best, shifts, data)
    refit = costly_fit(stacked, prior, with_own, starts=best.theta)
    z = [
        (fit.theta["delta"] - TRUTH["delta"]) / np.sqrt(fit.covariance[3, 3])
        for fit in (best, refit)
    ]
    assert abs(z[0]) > 8  # without offsets: far outside its own interval
    assert abs(z[1]) < 4
    found = estimates({**theta(), "gain": jnp.asarray(GAIN)}, with_own)
    # Offsets at the true common parameters are the shifts put in, to their errors.
    errors = np.sqrt(np.linalg.inv(np.asarray(found.precision))[:, 0, 0])
    assert np.all(np.abs(found.offset[:, 0] - np.array(shifted) + 500.0) < 5 * errors + 0.02)


def test_what_frequencies_hide_of_damping_is_found_and_every_record_counts():
    """In a fit without offsets omega_n's misfit is all that is seen, and takes every weight."""
    days = [(500.0, 3.0e-3), (500.3, 2.8e-3), (499.8, 3.25e-3)]
    tests = [
        replace(curve(level, omega_n=w, zeta=z, seed=i, name=f"{level} of {i}"), run=f"day {i}")
        for i, (w, z) in enumerate(days)
        for level in (5, 20)
    ]
    prior = box(PRIOR)
    data = assemble(measured(tests, Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    first = costly_fit(stacked, prior, data, starts=middle)
    found = reweight(jax.random.key(0), data, prior, first, Identify())
    assert min(fractions_counted(found.data).values()) == 1.0
    # Scatters of 0.05 % and 7.5 % of three days, of which the likely sizes
    # reach to some times that: their root mean square lies above.
    assert 0.5 < float(found.data.scatter[0]) / 0.25 < 6.0
    assert 0.5 < float(found.data.scatter[1]) / 2.3e-4 < 6.0
    own = best_offsets(found.fit.theta, found.data)
    for i, (_, zeta) in enumerate(days):
        # 72 values of 0.2 to 1 % noise: 1e-5 of damping.
        assert abs(found.fit.theta["zeta"] + own[f"day {i}"][1] - zeta) < 5e-5
    z = (found.fit.theta["delta"] - TRUTH["delta"]) / np.sqrt(found.fit.covariance[3, 3])
    assert abs(z) < 4


def test_levels_have_no_damping_of_their_own_to_hide_a_law_that_fails():
    """Zeta that doubles with level is the law's; as days the same records have their own zeta."""
    damped = {5: 3.0e-3, 20: 4.5e-3, 60: 6.0e-3}
    prior = box(PRIOR | {"gamma": (100.0, 500.0)})  # the loop does not open further

    def offsets_of_zeta(**stated):
        tests = [
            replace(
                curve(level, zeta=z, seed=level), **{key: of(level) for key, of in stated.items()}
            )
            for level, z in damped.items()
        ]
        data = assemble(measured(tests, Identify(), gain=GAIN))
        middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()} | {"gamma": 300.0}
        best = costly_fit(stacked, prior, data, starts=middle)
        shifts = shifts_of(best, prior.names, data)
        assert shifts is not None
        data = with_offsets(best, shifts, data)
        best = costly_fit(stacked, prior, data, starts=best.theta)
        zetas = np.array([offset[1] for offset in best_offsets(best.theta, data).values()])
        alone = residual_by_label(best.residual, data)
        return zetas / best.theta["zeta"], max(np.linalg.norm(row) for row in alone.values())

    (of_levels, error), (of_days, error_of_days) = (
        offsets_of_zeta(),
        offsets_of_zeta(run=lambda level: f"day of {level}"),
    )
    assert np.ptp(of_days) > 0.3  # 1.5e-3 of about 4.5e-3 between neighbours: a third
    assert np.max(np.abs(of_levels)) < 1e-6
    assert error > 3 * error_of_days  # what the law misses stays in sight


@pytest.mark.slow
def test_runs_whose_frequency_goes_with_their_level_are_told_as_the_laws_failure():
    # More than the joint softens, which would take a smaller rise for less softening.
    levels = (5, 12, 20, 30, 45, 60)
    tests = [curve(level, omega_n=500.0 + 3.0 * i, seed=i) for i, level in enumerate(levels)]
    prior = box(PRIOR)
    data = assemble(measured(tests, Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    first = costly_fit(stacked, prior, data, starts=middle)
    (found,) = reweight(jax.random.key(0), data, prior, first, Identify()).findings
    assert (found.code, found.status) == ("level_trend", "failed")


@pytest.mark.slow
def test_every_run_has_its_own_frequency_and_assemblies_scatter_more_than_days():
    shifted = {"A": (501.5, 501.7), "B": (499.0, 498.7), "C": (500.2, 500.4)}
    tests = [
        replace(curve(30, omega_n=w, seed=i, name=f"{assembly} {i}"), assembly=assembly, run=day)
        for assembly, pair in shifted.items()
        for i, (day, w) in enumerate(zip(("monday", "friday"), pair, strict=True))
    ]
    prior = box(PRIOR)
    data = assemble(measured([*tests, curve(5, name="alone")], Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts=middle)
    shifts = shifts_of(best, prior.names, data)
    assert shifts is not None
    data = with_offsets(best, shifts, data)
    assert data.levels[1] == (0, 0, 1, 1, 2, 2, 3)
    best = costly_fit(stacked, prior, data, starts=best.theta)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(list(best.theta.values()), best.covariance, (1, 50))
    posterior = xr.Dataset(
        {name: (("chain", "draw"), drawn[..., i]) for i, name in enumerate(prior.names)}
    )
    runs = runs_dataset(jax.random.key(0), posterior, prior.names, data)
    assert runs is not None
    for assembly, pair in shifted.items():
        for day, truth in zip(("monday", "friday"), pair, strict=True):
            own = runs["omega_n"].sel(run=f"{assembly} / {day}")
            assert abs(float(own.mean()) - truth) < 5 * float(own.std()) + 0.02
    told = runs_summary(runs)
    over = [told[f"spread_omega_n{suffix}"][""] for suffix in ("", "_assembly")]
    # Days differ by 0.2 to 0.3 rad/s, assemblies by 1.3; three and four of them know it roughly.
    assert over[0]["q005"] < 0.2 < over[0]["q995"]
    assert over[1]["q005"] < 1.3 < over[1]["q995"]
    assert over[1]["median"] > 2 * over[0]["median"]
    assert "over assemblies" in runs_sentence(runs)


def test_runs_that_agree_get_no_offsets():
    prior = box(PRIOR)
    data = assemble(measured([curve(5), curve(20), curve(60)], Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts=middle)
    shifts = shifts_of(best, prior.names, data)
    assert shifts is not None
    assert not wanted(shifts, Identify())
    assert wanted(shifts, Identify(offsets="runs"))


def test_a_mixed_campaign_of_the_right_law_counts_in_full(mixed):
    prior = box(PRIOR)
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    assert fractions_of(costly_fit(stacked, prior, mixed, starts=middle), mixed) == {}


def test_misfit_shared_by_all_repeats_does_not_count_as_often():
    data = assemble(measured([curve(20, repeats=16)], Identify(), gain=GAIN))
    prior = box({**PRIOR, "zeta": (0.00349, 0.00351)})  # away from the truth
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts={**middle, "zeta": 0.0035})
    weighed = with_weights(best, data, Identify())
    worth = fractions_counted(weighed)["held at 20"]
    # One misfit in all of 16 repeats: 1/16 of them, twice that for what the likelihood adds to
    # their noise, and less for its colour.
    assert worth < 0.2
    counted = weighed.parts[0].groups.num_values
    assert float(counted[0]) == pytest.approx(worth * 72 * 16)
    exact = with_weights(best, data, Identify(model_error="none"))
    assert float(exact.parts[0].groups.num_values[0]) == 72 * 16


def test_leaving_a_run_out_is_a_fit_of_the_others():
    tests = [curve(5), curve(20), curve(60)]
    prior = box(PRIOR)
    data = assemble(measured(tests, Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts=middle)
    found = leave_one_out(best, prior, data, fits_without_each_run(best, prior, data))
    assert found is not None
    assert list(found.run.values) == ["held at 5", "held at 20", "held at 60"]
    apart = costly_fit(
        stacked, prior, assemble(measured(tests[1:], Identify(), gain=GAIN)), starts=middle
    )
    change = (found["estimate"][0] - list(apart.theta.values())) / found["std"][0]
    # Two iterations along the valley of alpha delta, each to its tolerance.
    assert np.abs(change).max() < 0.02
    # The right law predicts a run that it never saw to its noise, of the mean of four repeats.
    force = np.abs(np.mean([r.channels["force"] for r in tests[0].records], axis=0))
    noise = NOISE / np.sqrt(4) * np.sqrt(2 * 36) / np.linalg.norm(force)
    assert float(found["error"][0]) == pytest.approx(noise, rel=0.5)
    np.testing.assert_allclose(found["std"][0], np.sqrt(np.diag(apart.covariance)), rtol=0.02)
    with_it = np.sqrt(np.diag(best.covariance))
    np.testing.assert_allclose(found["wider"], found["std"] / with_it, rtol=1e-12)
    assert consistency_finding(found).status == "ok"  # |z| < 4 over 15 numbers: p = 1e-3


def test_a_level_that_contradicts_the_others_is_found():
    tests = [curve(5), curve(20), curve(60, omega_n=501.0)]
    prior = box(PRIOR)
    data = assemble(measured(tests, Identify(), gain=GAIN))
    middle = {name: sum(pair) / 2 for name, pair in PRIOR.items()}
    best = costly_fit(stacked, prior, data, starts=middle)
    finding = consistency_finding(
        leave_one_out(best, prior, data, fits_without_each_run(best, prior, data))
    )
    assert finding.status == "failed"
    assert finding.number > 4


def test_the_linear_look_reads_a_held_curve():
    data = assemble(measured([curve(5), curve(60)], Identify(), gain=GAIN))
    found = told_by(data.parts)
    # At the lowest level: 10 um on a joint that softens by 4/(3 pi) alpha delta Y, and the noise.
    assert found["omega_n"] == pytest.approx(500.0, rel=1e-3)
    assert found["zeta"] == pytest.approx(0.003, rel=0.4)
    assert found["gain"] == pytest.approx(GAIN, rel=0.1)


def test_hold_out_and_fit_choose_the_tests(mixed):
    tests = [curve(5), curve(20), loop()]
    data = assemble(measured(tests, Identify(hold_out=["held at 5"], fit=["frf"]), gain=GAIN))
    assert [part.groups.labels for part in data.parts] == [("held at 20",)]
    with pytest.raises(ConfigError, match="`hold_out` must name tests"):
        assemble(measured(tests, Identify(hold_out=["other"]), gain=GAIN))
    with pytest.raises(DataError, match="no test to which the joint can be fitted"):
        assemble(measured(tests, Identify(fit=["sweep"]), gain=GAIN))


@pytest.mark.slow
def test_the_joint_posterior_of_curves_and_a_loop_holds_the_truth(mixed):
    settings = Identify(prior=PRIOR, num_chains=4, num_samples=400, num_warmup=200)
    step, _ = joint_step(jax.random.key(0), JointProblem(mixed, settings))
    draws = step.posterior["posterior"].to_dataset()
    for name, value in TRUTH.items():
        z = (float(draws[name].mean()) - value) / float(draws[name].std())
        assert abs(z) < 4, name
    assert step.verdict.status == "ok", [f for f in step.verdict.findings if f.status != "ok"]
    noise = draws["noise_std_harmonics"].mean(("chain", "draw")).values
    np.testing.assert_allclose(noise, NOISE, rtol=0.25)  # 288 values a level: 4 %
    assert float(draws["noise_std_loop"].mean()) == pytest.approx(0.3, rel=0.1)
