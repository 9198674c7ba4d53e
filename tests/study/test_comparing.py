"""Samplers compared on a posterior at hand, and by the command on a campaign."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.axes import Axes

from jbw import rig
from jbw.campaign.settings import Identify
from jbw.cli import run
from jbw.cli.printing import show
from jbw.cli.studies import comparison_lines
from jbw.errors import ConfigError
from jbw.identification.assemble import measured
from jbw.identification.procedure import Posterior, posterior_of
from jbw.inference.fit.fitting import fit
from jbw.inference.space.box import box
from jbw.lab.samplers import compare, suited
from jbw.report.studies import comparison, effective_rates, means

MEAN, SD = np.array([0.3, -0.2]), np.array([0.05, 0.1])
PRIOR = box({"p": (-1.0, 1.0), "q": (-1.0, 1.0)})


def residual(theta, data):
    return (jnp.stack([theta["p"], theta["q"]]) - data) / SD


def log_likelihood(theta, data):
    return -0.5 * residual(theta, data) ** 2


def halved(theta, data):
    return 0.5 * log_likelihood(theta, data)


def toy(density):
    best = fit(residual, PRIOR, jnp.asarray(MEAN), starts=2, key=jax.random.key(0))
    return Posterior("joint", density, PRIOR, jnp.asarray(MEAN), best, stepped=False)


@pytest.fixture(scope="module", name="found")
def _found():
    return compare(toy(log_likelihood), samplers=("quadrature", "importance", "tempered_smc"))


@pytest.mark.slow
def test_all_agree_with_the_normal_in_closed_form(found):
    record = found.record
    assert record["reference"] == "quadrature"
    for i, name in enumerate(("p", "q")):
        truth = record["samplers"]["quadrature"]["parameters"][name]
        # The box is 14 and 8 standard deviations away: a share of 1e-15 of the mass.
        assert truth["mean"] == pytest.approx(MEAN[i], abs=1e-7)
        assert truth["sd"] == pytest.approx(SD[i], rel=1e-6)
    evidence = np.log(2 * np.pi * np.prod(SD) / 4)
    for name, one in record["samplers"].items():
        assert one["log_evidence"] == pytest.approx(
            evidence, abs=4 * one["log_evidence_error"] + 1e-8
        )
        assert one["verdict"] == "ok"
        if name != "quadrature":
            assert one["furthest"] < 4
            assert abs(one["z_log_evidence"]) < 4
            assert one["ess_per_s_warm"] > 0
    json.dumps(record, allow_nan=False)


@pytest.mark.slow
def test_a_factor_of_two_dropped_from_the_log_likelihood_is_seen(found):
    wrong = compare(toy(halved), samplers=("importance",), twice=False).record
    truth = found.record["samplers"]["quadrature"]["parameters"]
    row = wrong["samplers"]["importance"]["parameters"]["p"]
    assert abs(row["sd"] - truth["p"]["sd"]) > 4 * row["mcse_sd"]


@pytest.mark.slow
def test_the_figure_has_a_line_a_parameter_and_the_rates(found, capsys):
    axes = comparison(found.result)
    assert axes.shape == (3, 1)
    assert comparison(found.result, ax=axes).shape == (3, 1)
    assert isinstance(means(found.result, "p"), Axes)
    assert isinstance(effective_rates(found.result), Axes)
    show(*comparison_lines(found.result.replaced(campaign="toy")))
    said = capsys.readouterr().out
    assert "tempered_smc" in said
    assert "those of sampler quadrature" in said


def test_every_posterior_is_drawn_from_by_what_suits_it():
    assert suited(toy(log_likelihood))[0] == "quadrature"
    assert "nested" in suited(toy(log_likelihood))


def test_a_step_of_another_name_is_refused():
    with pytest.raises(ConfigError, match="one of joint, third_order, opening"):
        posterior_of("fourth", measured((), Identify()))


@pytest.mark.slow
def test_the_command_compares_a_campaign(tmp_path, capsys):
    names = ("noise_0p005V", "tone_5p00Hz", "tone_5p50Hz", "tone_6p00Hz", "sweep_0p05V")
    rig.write(rig.measure(tests=names, repeats=2, noise_std=1e-3), tmp_path / "campaign")
    path, out = tmp_path / "campaign" / "campaign.toml", tmp_path / "out"
    command = ["compare", str(path), "--step", "opening", "--samplers", "quadrature,tempered_smc"]
    assert run([*command, "--once", "--out", str(out), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record == json.loads((out / "compare.json").read_text())
    assert (out / "compare.png").stat().st_size > 1000
    assert record["samplers"]["tempered_smc"]["furthest"] < 4
    assert abs(record["samplers"]["tempered_smc"]["z_log_evidence"]) < 4
    assert run([*command, "--samplers", "gibbs", "--out", str(tmp_path / "other")]) == 2
