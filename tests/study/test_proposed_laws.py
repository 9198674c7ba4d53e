"""Which law a campaign that states none goes on with, by decays that scipy simulates."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from pasted import pasted
from scipy.integrate import solve_ivp

import jbw
from jbw.campaign.load import load_campaign
from jbw.campaign.schema import parse
from jbw.errors import ModelError
from jbw.identification.assemble import measured_in
from jbw.report.messages import laws as messages
from jbw.results.attributes import DecayConstants
from jbw.study.identify import identify
from jbw.study.look import look_quietly
from jbw.study.prepared import (
    beside_smallest,
    candidates,
    chosen,
    full_slip_beside,
    measured_curve,
)
from jbw.verification.predictive_basis import Basis

OMEGA, ZETA, FS = 2 * np.pi * 20.0, 0.004, 512.0
# Drag [1/m] and damping ratio of sweeps whose largest motion has three times the damping.
DRAG, HEAVY = 300.0, 0.04
FORCES = {
    "cubic": (lambda y, v: 4e8 * y**3, 4e8),
    "quadratic_damping": (lambda y, v: 60.0 * v * abs(v), 60.0),
}
CAMPAIGN = """[campaign]
name = "taps"
[[test]]
kind = "decay"
files = "tap_*.csv"
channels = { time = "t", velocity = "v" }
units = { time = "s", velocity = "m/s" }
band = [14.0, 26.0]
"""


def taps(folder, law, text=CAMPAIGN):
    """Three decays of a mode with a force of the law, with white noise, and their campaign."""
    t = np.arange(0, 6, 1 / FS)
    force = FORCES[law][0]

    def rate(_, state):
        y, v = state
        return v, -(OMEGA**2) * y - 2 * ZETA * OMEGA * v - force(y, v)

    for i, start in enumerate((1e-3, 1.4e-3, 2e-3)):
        v = solve_ivp(rate, (0, 6), [start, 0.0], t_eval=t, rtol=1e-9, atol=1e-12).y[1]
        v += 1e-4 * np.random.default_rng(i).standard_normal(len(t))
        rows = np.stack([t, v], 1)
        np.savetxt(folder / f"tap_{i}.csv", rows, delimiter=",", header="t,v", comments="")
    (folder / "campaign.toml").write_text(text)
    return load_campaign(folder / "campaign.toml")


def test_a_law_or_a_prior_of_the_file_is_never_replaced():
    assert not parse(CAMPAIGN).states_laws
    assert parse(CAMPAIGN + '[joint]\nlaws = ["bouc_wen"]\n').states_laws
    assert parse(CAMPAIGN + "[identify]\nprior = { alpha = [1.0, 1e4] }\n").states_laws


def test_laws_are_proposed_from_simple_to_rich_and_the_others_of_their_kind_last():
    assert candidates(("iwan4", "masing_power")) == (("masing_power", "bouc_wen", "iwan4"), ())
    assert candidates(("cubic",)) == (("cubic", "bouc_wen"), ("quintic",))
    proposals, others = candidates(())
    assert proposals == ("bouc_wen",)
    assert {"cubic", "quadratic_damping", "iwan4"} < set(others)


@pytest.mark.parametrize(
    ("law", "excluded", "rivals"),
    [
        ("bouc_wen", (), ("iwan4",)),
        ("masing_power", ("bouc_wen",), ("iwan4",)),
        ("masing_power", ("iwan4",), ()),
        ("iwan4", (), ()),
        ("cubic", (), ()),
        ("jenkins_3", (), ()),
    ],
)
def test_a_slipping_joint_may_slip_fully_unless_the_records_exclude_it(law, excluded, rivals):
    assert full_slip_beside(law, excluded) == rivals


def test_a_law_that_may_be_another_has_no_band_beyond_the_fitted_motion():
    alone = Basis(xr.Dataset(), {}, {}, 2.0, (), 1, xr.Dataset(), DecayConstants(), ("bouc_wen",))
    beside = replace(alone, rivals=("iwan4",))
    assert beside.why_withheld((0.1, 2.0)) == ""  # to the largest fitted displacement
    assert "do not exclude iwan4" in beside.why_withheld((0.1, 2.2))
    assert alone.why_withheld((2.2,)) == ""


@pytest.mark.slow
def test_the_law_that_fits_frequency_and_damping_best_is_fitted_first(tmp_path):
    """Its start is that fit, and laws that cannot fit better are not fitted at all."""
    campaign, said = taps(tmp_path, "cubic"), []
    seen, looked = measured_in(campaign, lambda _: None), look_quietly(campaign)
    curve = measured_curve(looked, seen.chosen)
    laws = ("quintic", "bouc_wen", "cubic"), ("quadratic_damping",)
    measured, _, sentence = chosen(seen, laws, curve, 0, said.append)
    assert measured.laws == ("cubic",)
    assert said == [messages.BY_READINGS, messages.trying("cubic"), sentence]
    assert "only noise remains; frequency and damping exclude " in sentence


@pytest.mark.slow
@pytest.mark.parametrize("law", sorted(FORCES))
def test_the_law_of_the_readings_is_taken_where_none_is_stated(tmp_path, law):
    said = []
    study = identify(taps(tmp_path, law), quick=True, report=said.append)
    assert study.tree.attrs["laws"] == f'["{law}"]'
    sentence = next(line for line in said if " is chosen: " in line)
    assert pasted(sentence).laws == (law,)
    assert sentence in json.dumps(study.record, ensure_ascii=False).replace('\\"', '"')
    draws = study.tree["posterior"][law]
    # Five standard deviations, which chance exceeds once in 2e6.
    assert abs(draws.mean() - FORCES[law][1]) < 5 * draws.std()


@pytest.mark.slow
@pytest.mark.parametrize("law", sorted(FORCES))
def test_laws_are_fitted_until_one_leaves_noise_alone(tmp_path, law):
    seen = measured_in(taps(tmp_path, law), lambda _: None)
    measured, theta, sentence = chosen(
        seen, [("quintic", law, "bouc_wen")], None, 0, lambda _: None
    )
    assert measured.laws == (law,)
    assert law in theta
    assert "errors of other laws: quintic " in sentence
    assert "bouc_wen" not in sentence
    assert pasted(sentence).laws == (law,)


@pytest.mark.slow
def test_where_no_law_leaves_noise_alone_the_smallest_error_decides(tmp_path):
    seen = measured_in(taps(tmp_path, "cubic"), lambda _: None)
    measured, _, sentence = chosen(
        seen, [("quadratic_damping", "quintic")], None, 0, lambda _: None
    )
    assert measured.laws == ("quintic",)
    assert "the residual of every tried law exceeds noise" in sentence


def test_a_law_that_cannot_be_solved_is_passed_over(tmp_path, monkeypatch):
    seen = measured_in(taps(tmp_path, "cubic"), lambda _: None)

    def refuse(*given, **options):
        raise ModelError("No start has a finite residual.", remedy="Try another law.")

    monkeypatch.setattr("jbw.study.prepared.first_fit", refuse)
    found = chosen(seen, [("bouc_wen", "cubic")], None, 0, lambda _: None)
    assert found == (seen, {}, "")


def test_a_group_of_noise_does_not_outweigh_the_others():
    """Of two groups, one is noise of 15 % for each law: the other decides."""
    scores = beside_smallest({
        "right": {"quiet": 0.008, "noisy": 0.150},
        "wrong": {"quiet": 0.056, "noisy": 0.150},
    })  # fmt: skip
    assert scores["right"] == 1.0
    assert scores["wrong"] == pytest.approx(np.sqrt((7.0**2 + 1) / 2))


def driven(level):
    """A sweep over a heavily damped mode with drag, with white noise, by SciPy."""
    t = np.arange(0, 12, 1 / 256)
    u = level * np.cos(2 * np.pi * (14 * t + 12 / 24 * t**2))

    def rate(at, state):
        y, v = state
        force = np.interp(at, t, u) - DRAG * v * abs(v)
        return v, force - OMEGA**2 * y - 2 * HEAVY * OMEGA * v

    found = solve_ivp(rate, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-7, atol=1e-9)
    v = found.y[1]
    v = v + 0.004 * np.std(v) / level * np.random.default_rng(3).standard_normal(len(t))
    record = jbw.Record(256.0, {"force": u, "velocity": v}, {"force": "N", "velocity": "m/s"})
    return jbw.Test("sweep", (record,), f"sweep {level:g}")


@pytest.mark.slow
def test_a_law_whose_first_fit_ends_at_a_default_bound_gets_a_wider_one():
    """Sweeps at three levels, of drag that adds more damping than the default bound allows."""
    campaign = jbw.Campaign("drag", None, tuple(map(driven, (30.0, 10.0, 1.0))), gain=1.0)
    seen = measured_in(campaign, lambda _: None)
    measured, theta, _ = chosen(seen, [("quadratic_damping",)], None, 0, lambda _: None)
    assert measured.laws == ("quadratic_damping",)
    # Thirteen samples a period: lines between them lack 2 % of the drive at the resonance.
    assert theta["quadratic_damping"] == pytest.approx(DRAG, rel=0.03)
