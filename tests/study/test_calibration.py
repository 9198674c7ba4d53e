"""Steps 2, 3, 4 and the joint posterior, calibrated; and likelihoods with a slip, which are not.

Seeds were fixed before the first run; statistical tests hold at p = 1e-4 on all of them.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from guests import Bilinear
from scipy.stats import binom
from tiers import represented_by

from jbw.cli import run as command
from jbw.errors import ConfigError, ModelError
from jbw.identification.paper import kernel, simulated_kernel
from jbw.identification.paper.kernel import KernelData
from jbw.identification.paper.step4 import log_likelihood as opening_likelihood
from jbw.inference.calibration.record import Calibration
from jbw.inference.calibration.replications import calibrate
from jbw.lab import designs, models
from jbw.lab.calibration import _numbers_of, sbc, suited
from jbw.oscillator.oscillator import BoucWen
from jbw.oscillator.response import simulate
from jbw.rig import SLIDERS

SEEDS = (0, 1, 2)
LEAST = 1e-4


def least_p(found):
    return min(*found.p_ecdf.values(), *found.p_chi_square.values())


def prepared(step, sampler=None):
    return step, suited(step, sampler or step.sampler)


def replicated(prepared_step, seed, count, model=None):
    step, (own, sampler, options) = prepared_step
    batch = min(step.batch, count)
    key, model = jax.random.key(seed), model or own
    return calibrate(key, model, sampler, options, num_replications=count, batch=batch)


@pytest.fixture(scope="module", name="third_order")
def _third_order():
    return prepared(models.third_order(designs.probing(), known_noise=True))


@pytest.fixture(scope="module", name="unknown_noise")
def _unknown_noise():
    return prepared(models.third_order(designs.probing()))


@pytest.fixture(scope="module", name="opening")
def _opening():
    return prepared(models.opening(designs.opening()))


@pytest.fixture(scope="module", name="joint")
def _joint():
    return prepared(models.joint(designs.joint()))


def test_the_simulated_motion_is_that_of_the_solver():
    """Two integrators that share nothing; the noise of the mean, 0.7 mm/s, is 200 times more."""
    design = designs.joint()
    theta = {name: float(value) for name, value in designs.truth().items()}
    force = theta["gain"] * design.data.source[-1]
    joint = BoucWen(*(theta[name] for name in ("omega_n", "zeta", "alpha", "delta", "gamma")))
    solved = simulate(joint, force, designs.FS, hold="band_limited", substeps=8)
    own = models.motion({n: jnp.asarray(v) for n, v in theta.items()}, force, designs.FS)
    np.testing.assert_allclose(own[:, 1], solved.v, atol=4e-6)
    np.testing.assert_allclose(own[:, 0], solved.y, atol=4e-8)


def test_the_simulated_motion_asks_the_rig_for_the_law():
    """Sliders have kinks, which both integrators meet between their steps."""
    design = designs.joint()
    force = designs.GAIN * design.data.source[-1]
    theta = {n: jnp.asarray(float(value)) for n, value in SLIDERS.parameters().items()}
    solved = simulate(SLIDERS, force, designs.FS, hold="band_limited", substeps=8)
    own = models.motion(theta, force, designs.FS, [law.name for law in SLIDERS.laws])
    np.testing.assert_allclose(own[:, 1], solved.v, atol=1e-4 * np.max(np.abs(solved.v)))
    theta |= {"bilinear_k": jnp.asarray(600.0), "bilinear_yield": jnp.asarray(2e-3)}
    with pytest.raises(ModelError, match="rig does not have the law `bilinear`"):
        models.motion(theta, force, designs.FS, [Bilinear])  # pyright: ignore[reportArgumentType]


def test_the_simulated_kernel_is_reduced_as_a_campaign_is():
    design = designs.probing(200)
    theta = {"zeta": jnp.asarray(0.0044), "alpha": jnp.asarray(497.0), "delta": jnp.asarray(340.0)}
    found = simulated_kernel.measured_kernel(
        jax.random.key(0), theta, design.data, 200, known_noise=True
    )
    spread = simulated_kernel.measured_kernel(jax.random.key(0), theta, design.data, 200).noise_std
    factor = np.asarray(spread / design.data.noise_std)
    assert np.all(np.abs(np.log(factor)) < np.log(simulated_kernel.UNKNOWN) + 0.2)
    assert np.ptp(np.log(factor)) > 0.2
    # The scatter of 400 components has a relative error of 1 / sqrt(2 * 398) = 0.035.
    scatter = np.sqrt(found.within / (2 * 199))
    np.testing.assert_allclose(scatter, design.data.noise_std, rtol=0.15)
    away = np.abs(found.mean - simulated_kernel.kernel_values(theta, design.data))
    assert np.all(away < 5 * np.asarray(design.data.noise_std) * np.sqrt(2 / 200))


@pytest.mark.slow
def test_the_command_calibrates_step_4_and_stores_what_it_found(tmp_path, capsys):
    folder = tmp_path / "sbc"
    options = ["--step", "opening", "--replications", "200", "--out", str(folder), "--json"]
    assert command(["sbc", *options]) == 0
    out = capsys.readouterr()
    record = json.loads(out.out)
    assert record == json.loads((folder / "sbc.json").read_text())
    assert "200 of 200 replications" in out.err
    assert record["verdict"]["status"] == "ok"
    assert record["failed"] == 0
    assert set(record["quantities"]) == {"gamma", "log_likelihood"}
    assert all(row["p_ecdf"] > LEAST for row in record["quantities"].values())
    ranks = xr.open_datatree(folder / "ranks.nc", engine="h5netcdf")["ranks"]
    assert ranks["rank_gamma"].shape == (200,)
    assert ranks["rank_gamma"].attrs["quantity_units"] == "1/m"
    assert (folder / "sbc.png").stat().st_size > 10_000


def test_failed_replications_are_counted_and_once_whatever_they_failed_by():
    rng = np.random.default_rng(0)
    reasons = {"stuck": np.arange(40) < 3, "lost": np.arange(40) % 20 == 1}
    verdict = SimpleNamespace(status="failed", findings=())
    same = {"theta": 0.5}
    found = _numbers_of(Calibration(
        ("theta",), rng.integers(0, 100, (40, 1)), 99, np.ones((40, 1), bool), reasons, same, same,
        {"theta": (1.0, 0.9, 1.0)}, verdict,
    ))  # fmt: skip
    assert found["failures"] == {"stuck": 3, "lost": 2}
    assert (found["failed"], found["replications"]) == (4, 40)  # one failed by both


def test_a_step_that_is_not_calibrated_is_exit_code_4(tmp_path, capsys):
    """Chains of 85 + 765 published steps never cross the ridge of Step 3."""
    options = ["--sampler", "random_walk_paper", "--replications", "20", "--noise", "known"]
    assert command(["sbc", *options, "--out", str(tmp_path / "sbc")]) == 4
    told = capsys.readouterr().out
    assert "Verdict: failed" in told
    assert "jbw explain calibration_failures" in told


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"step": "fourth"}, "`step` must be one of linear, third_order, opening, joint"),
        ({"sampler": "gibbs"}, "`sampler` must be one of nuts"),
        ({"noise": "none"}, "`noise` must be one of unknown, known"),
        ({"step": "opening", "sampler": "importance"}, "has no fit"),
        ({"step": "linear", "sampler": "nuts"}, "come from a Gaussian approximation"),
        ({"num_replications": 0}, "`num_replications` must be at least 1"),
    ],
)
def test_what_cannot_be_meant_is_refused(options, says):
    with pytest.raises(ConfigError, match=says):
        sbc(**options)


# A quarter of the campaigns of one seed in every run of the slow tier, all before a release.
OF_CAMPAIGNS = represented_by((0, 250), *((seed, 1000) for seed in SEEDS))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "count"), OF_CAMPAIGNS)
def test_step_2_is_calibrated(seed, count):
    found = models.calibrate_linear(jax.random.key(seed), *designs.lines(), num_replications=count)
    assert least_p(found) > LEAST
    assert not found.failed.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("of_seeds", "low", "high"),
    [
        # 99 % of 1000: four standard errors of 0.31 %. 99 % of 3000: a standard error of 0.18 %.
        # Where the noise is learnt, as of a campaign, one seed is in the tier before, below.
        pytest.param(SEEDS[:1], 0.9774, 1.0, id="one seed", marks=pytest.mark.release),
        pytest.param(SEEDS, 0.98, 0.997, id="all seeds", marks=pytest.mark.release),
    ],
)
def test_step_3_is_calibrated_where_the_noise_is_known(third_order, of_seeds, low, high):
    inside = []
    for seed in of_seeds:
        found = replicated(third_order, seed, 1000)
        assert least_p(found) > LEAST
        assert found.failed.mean() < 0.01
        inside.append(found.inside)
    share = dict(zip(found.names, np.mean(np.concatenate(inside), axis=0), strict=True))
    for name in ("h3_5Hz", "h3_5.5Hz", "h3_6Hz", "h3_6.5Hz", "h3_6.75Hz"):
        assert low < share[name] < high


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "count"), OF_CAMPAIGNS)
def test_step_3_is_calibrated_where_the_noise_is_learnt_from_the_repeats(
    unknown_noise, seed, count
):
    found = replicated(unknown_noise, seed, count)
    assert least_p(found) > LEAST
    assert found.failed.mean() < 0.01


@pytest.mark.release  # a slip fails below
def test_eight_repeats_are_too_few_to_take_their_scatter_for_the_noise(unknown_noise):
    """What the likelihood as printed does to a campaign: 96 % of the truths within 99 %."""
    step, _ = unknown_noise
    printed = step.model._replace(log_likelihood=kernel.known_noise_log_likelihood)
    found = replicated(unknown_noise, 0, 1000, printed)
    assert least_p(found) < LEAST
    assert found.verdict.status == "failed"


@pytest.mark.slow
@pytest.mark.parametrize("seed", represented_by(*SEEDS))
def test_step_4_is_calibrated(opening, seed):
    found = replicated(opening, seed, 1000)
    assert least_p(found) > LEAST
    assert not found.failed.any()
    assert binom(1000, 0.99).cdf(found.inside[:, 0].sum()) > LEAST


@pytest.mark.release
def test_the_joint_posterior_is_calibrated(joint):
    inside = []
    for seed in SEEDS:
        found = replicated(joint, seed, 36)
        assert least_p(found) > LEAST
        assert found.failed.mean() < 0.05
        inside.append(found.inside)
    share = dict(zip(found.names, np.mean(np.concatenate(inside), axis=0), strict=True))
    # 99 % of 108: a standard error of 1 %.
    assert share["response"] >= 0.955


def doubled(theta, data: KernelData):
    """The variance twice: a factor of two dropped from the exponent."""
    return kernel.known_noise_log_likelihood(
        theta, replace(data, noise_std=data.noise_std * np.sqrt(2))
    )


def unconjugated(theta, data: KernelData):
    return kernel.known_noise_log_likelihood(theta, replace(data, mean=jnp.conj(data.mean)))


def squared(theta, data: KernelData):
    """Sigma squared for sigma, in units of 1e-9 in which sigma is 0.25."""
    return kernel.known_noise_log_likelihood(
        theta, replace(data, noise_std=data.noise_std**2 / 1e-9)
    )


@pytest.mark.release  # a slip of step 4 fails, below
@pytest.mark.parametrize("slip", represented_by(doubled, unconjugated, squared))
def test_a_slip_in_the_likelihood_of_step_3_fails(third_order, slip):
    step, _ = third_order
    found = replicated(prepared(step), 0, 500, step.model._replace(log_likelihood=slip))
    assert least_p(found) < 1e-6
    assert found.verdict.status == "failed"


def halved(theta, curve):
    """The exponent n in place of n / 2, which makes the posterior too narrow by root two."""
    return opening_likelihood(theta, replace(curve, num_values=2 * curve.num_values))


def scatterless(theta, curve):
    """The scatter of the repeats left out of the sum of squares."""
    return opening_likelihood(theta, replace(curve, within=jnp.zeros_like(curve.within)))


@pytest.mark.slow
@pytest.mark.parametrize("slip", represented_by(halved, scatterless))
def test_a_slip_in_the_likelihood_of_step_4_fails(opening, slip):
    step, _ = opening
    found = replicated(opening, 0, 500, step.model._replace(log_likelihood=slip))
    assert least_p(found) < 1e-6
    assert found.verdict.status == "failed"
