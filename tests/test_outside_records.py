"""Records, faults, campaigns and the judge of `benchmarks/outside`."""

import json
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from outside import judge
from outside.bound import bound
from outside.campaigns import CAMPAIGNS, mishandled_campaign, sound_campaign
from outside.doors import Finding, paste
from outside.faults import FAULTS, mishandled, spoilt
from outside.files import write_campaign
from outside.plants import loop_of
from outside.records import KINDS, Choice, recorded, sound, specimen
from outside.simulator import library

pytestmark = pytest.mark.skipif(library() is None, reason="needs a C compiler")
PLAIN = Choice(law="linear", zeta=(0.01, 0.01), noise=(1e-3, 1e-3), bits=24)


def clean(kind, seed=1, choice=PLAIN):
    rng = default_rng(seed)
    return KINDS[kind](rng, specimen(rng, kind, choice))


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, fault.name) for fault in FAULTS.values() for kind in fault.kinds]
)
def test_every_fault_changes_its_record_and_says_by_how_much(kind, name):
    rng, perfect = default_rng(2), clean(kind)
    made = spoilt(rng, perfect, FAULTS[name])
    assert made.fault == name
    assert made.size
    perfect_x = recorded(default_rng(2), perfect).x
    same = made.x.shape == perfect_x.shape and np.allclose(made.x, perfect_x, equal_nan=True)
    moved = kind == "loop" and not np.allclose(
        made.channels["displacement"], perfect.channels["displacement"], rtol=1e-2
    )
    assert moved or not same
    # A slip of the gauge leaves the force as it is.
    assert len(set(map(len, made.channels.values()))) == 1


def test_a_seed_repeats_a_mishandled_record():
    first, again = (mishandled(default_rng([7, 3]), "sweep", "delay") for _ in range(2))
    np.testing.assert_array_equal(first.x, again.x)
    assert first.size == again.size


def test_a_recorder_adds_the_noise_that_it_states():
    perfect = clean("noise")
    written = recorded(default_rng(4), perfect)
    left = written.x - perfect.x
    size = 1e-3 * np.max(np.abs(perfect.x))
    # Of 30,000 samples the standard deviation is known to 0.4 %.
    assert np.std(left) == pytest.approx(size, rel=0.02)


def test_a_linear_loop_is_a_straight_line_of_the_stated_stiffness():
    perfect = clean("loop")
    slope = perfect.channels["restoring_force"] / perfect.facts["stiffness"]
    np.testing.assert_allclose(slope, perfect.channels["displacement"], rtol=1e-12)
    assert loop_of(perfect.plant, 0.7) == pytest.approx((1.0, 0.0), abs=1e-9)


def test_the_bound_of_a_decay_is_its_closed_form():
    """Check var(omega) = var(sigma) = 16 sigma^3 s^2 / (A^2 fs) of a decay seen to its end.

    With J = A^2 fs / (2 s^2) the information on omega and phase is J / (4 sigma^3), J / (4 sigma^2)
    and J / (2 sigma), by integrals of t^2, t and 1 times exp(-2 sigma t); of small damping, omega
    and phase know nothing of sigma and ln A, whose information is the same.
    """
    rng, choice = (
        default_rng(0),
        Choice(law="linear", zeta=(0.005, 0.005), noise=(1e-3, 1e-3), bits=24),
    )
    one = replace(specimen(rng, "decay", choice), per_period=30.0, response="displacement")
    perfect = clean_decay(one)
    hz_sd, zeta_sd = bound(perfect)
    w = 2 * np.pi * one.hz
    sigma = 0.005 * w
    size = np.max(np.abs(perfect.x))
    sd = np.sqrt(16 * sigma**3 * (1e-3 * size) ** 2 / (size**2 * one.fs))
    # Neglected: damping squared, and what lies beyond eight time constants, exp(-16) of it.
    assert hz_sd == pytest.approx(sd / (2 * np.pi), rel=0.02)
    assert zeta_sd == pytest.approx(sd / w, rel=0.02)


def clean_decay(one):
    """Return a decay of at least eight time constants without a mode elsewhere."""
    for seed in range(100):
        drawn = KINDS["decay"](default_rng(seed), one)
        if drawn.facts["time_constants"] > 8 and "elsewhere" not in drawn.facts:
            return drawn
    raise AssertionError("none of a hundred seeds draws such a decay")


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_is_written_as_jbw_reads_it(name, tmp_path):
    from jbw.campaign.schema import read_spec

    rng = default_rng(11)
    made = sound_campaign(rng, name, PLAIN)
    path = write_campaign(tmp_path / name, made, rng)
    assert len(read_spec(path).tests) == len({one.test for one in made.members})
    truth = json.loads((path.parent / "truth.json").read_text())
    files = {file for test in tomllib.loads(path.read_text())["test"] for file in test["files"]}
    assert files == set(truth["records"])
    for facts in truth["records"].values():
        assert facts["fault"] == ""
        if "by_amplitude" in facts and facts["session"] == "":
            y, hz, zeta = np.transpose(facts["by_amplitude"])
            assert np.all(np.diff(y) > 0)
            # Linear: the damped frequency and the damping ratio at every amplitude.
            np.testing.assert_allclose(hz, facts["hz"], rtol=1e-12)
            np.testing.assert_allclose(zeta, facts["zeta"], rtol=1e-12)


def test_a_mishandled_campaign_states_what_and_where():
    seen = set()
    for seed in range(12):
        made = mishandled_campaign(default_rng(seed), "decays")
        assert made.fault
        assert ": " in made.size
        assert any(one.drawn.fault == made.fault for one in made.members)
        seen.add(made.fault)
    assert len(seen) > 4


def test_a_remedy_is_pasted_under_its_test():
    text = (
        '[campaign]\nname = "a"\n\n[[test]]\nname = "one"\ndelay = 0.1\n\n[[test]]\nname = "two"\n'
    )
    finding = Finding("warning", "one", "It is late.", "Put under [[test]]: `delay = 0.2`, or not.")
    pasted = tomllib.loads(paste(text, finding))
    assert pasted["test"] == [{"name": "one", "delay": 0.2}, {"name": "two"}]
    assert paste(text, finding._replace(remedy="Measure again.")) is None


def test_outcomes_are_judged_and_counted(tmp_path, capsys):
    out = tmp_path / "outcomes.jsonl"
    words = (
        "--sound 1 --mishandled 1 --campaigns 0 --kind decay --law linear --times none --seed 12"
    )
    judge.main([*words.split(), "--fault", "gap of nan", "--out", str(out)])
    sound_row, spoilt_row = map(json.loads, out.read_text().splitlines())
    assert "benchmark" not in sound_row
    assert sound_row["law"] == "linear"
    assert spoilt_row["named"]
    assert "Mishandled and not named: 0 of 1" in capsys.readouterr().out


def test_without_a_seed_every_run_draws_others(capsys):
    for _ in range(2):
        judge.main(["--sound", "0", "--mishandled", "0", "--campaigns", "0"])
    seeds = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Seed")]
    assert len(set(seeds)) == 2


def test_a_failure_of_the_benchmark_is_an_outcome(monkeypatch):
    def fails(*_):
        raise ValueError("no such thing")

    monkeypatch.setattr(judge, "drawn", fails)
    job = judge.Job(0, "sound", "decay", "", None, False)
    row = judge.outcome(job, judge.Options(1, False, False, None))
    assert "no such thing" in row["benchmark"]
    assert "Failures of the benchmark itself: 1" in "\n".join(judge.tables([row]))


def test_sound_records_are_drawn_as_they_were_asked():
    choice = Choice(law="cubic", strong=True, zeta=(0.01, 0.02), noise=(1e-4, 1e-3), bits=12)
    for seed in range(3):
        made = sound(default_rng(seed), "decay", choice)
        assert (made.law, made.strong) == ("cubic", True)
        assert 0.01 <= made.zeta <= 0.02
        assert made.bits >= 12
