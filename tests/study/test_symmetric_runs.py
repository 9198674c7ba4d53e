"""The same joint at 15 kHz and at 0.2 Hz: identified from end to end, and as at 19 Hz.

One campaign of the rig, decays and sweeps, with time, length and mass scaled: a part of 2 g that
moves by micrometres and is sampled at 1 MHz, and a structure of 19 t that moves by centimetres.
Equal seeds draw equal numbers, so that all of a summary is compared, number by number.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from same_answers import differences
from scaled_campaigns import (
    AT_TRUTH,
    BURST,
    Scale,
    campaign_in,
    measured,
    write_campaign,
)

import jbw.cli.progress
from jbw.campaign.load import load_campaign
from jbw.campaign.settings import Identify
from jbw.cli import run
from jbw.export.one_joint import export
from jbw.law_comparison.compare import compare_laws
from jbw.report.result import read_result
from jbw.rig import measure
from jbw.rig.generator import Sweep
from jbw.rig.presets import MODAL_MASS, Plan, Preset
from jbw.study.identifiability import identifiability
from jbw.verification.predict import predict, row_of
from jbw.verification.predictive_basis import basis_of

FS = 1280.0  # 1 MHz where time runs 781 times faster
SWEEP = Sweep(10.0, 30.0, 4.0, burst=4.0, fade=0.2, duration=5.0)
PLANS = (Plan("sweep", "sweep", SWEEP, 2), Plan("ringing", "decay", BURST, 2, (15.0, 22.0)))
RIG = Preset("short", 1.0 / MODAL_MASS, 32.0, 2.0, PLANS, "force", 50e-6)
SCALES = {
    "19 Hz": Scale(),
    "15 kHz": Scale(time=1.28e-3, length=1e-3, mass=1e-3),
    "0.2 Hz": Scale(time=94.0, length=10.0, mass=1e4),
}
# Of a standard deviation, or of a number that is known as it is: fits that stop within 1e-5 of a
# cost lie within it, and so do the draws about them.
CLOSE = 1e-3
# Two campaigns from end to end each: fits, checks and likelihoods of images are in the other tiers.
MOVED = [pytest.param(name, marks=pytest.mark.release) for name in ("15 kHz", "0.2 Hz")]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Campaign files and runs by name, made when they are asked for."""
    made = {}
    campaign = replace(measure(RIG, seed=0, fs=FS), settings=Identify())
    patch = pytest.MonkeyPatch()
    patch.setattr(jbw.cli.progress, "prepare_process", lambda: None)  # JAX is set up already

    def run_of(name):
        if name not in made:
            folder = tmp_path_factory.mktemp("scaled")
            path = write_campaign(campaign_in(campaign, SCALES[name]), folder)
            assert run(["identify", str(path), "--out", str(folder / "run"), "--seed", "0"]) == 0
            made[name] = path, folder / "run"
        return made[name]

    yield run_of
    patch.undo()


def summary(folder):
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", MOVED)
def test_it_is_identified_from_end_to_end(name, runs):
    record = summary(runs(name)[1])
    assert (runs(name)[1] / "report.html").stat().st_size > 100_000
    assert record["verdict"]["status"] == summary(runs("19 Hz")[1])["verdict"]["status"] == "ok"
    for parameter, truth in SCALES[name].parameters(AT_TRUTH).items():
        row = record["steps"]["joint"]["parameters"][parameter]
        assert row["q005"] < truth < row["q995"]


@pytest.mark.parametrize("name", MOVED)
def test_its_summary_is_that_of_its_twin(name, runs):
    found, expected = summary(runs(name)[1]), summary(runs("19 Hz")[1])
    assert differences(found, expected, SCALES[name], CLOSE) == []


def predicted(path, folder):
    """Rows as `jbw predict --json` writes them, of every test of a campaign."""
    basis = basis_of(read_result(folder)[1])
    tests = load_campaign(path).tests
    return json.loads(json.dumps([row_of(predict(basis, test)) for test in tests]))


def exported(folder, scale):
    """All that an export holds, in plain values."""
    record, tree = read_result(folder)
    found = export(tree, MODAL_MASS * scale.mass, summary=record)
    named = ("about", "parameters", "backbone", "loop", "linear", "skeleton", "mass", "y_max")
    plain = {name: getattr(found, name) for name in (*named, "joint", "products")}
    return json.loads(json.dumps(plain, default=lambda values: np.asarray(values).tolist()))


@pytest.mark.parametrize("name", MOVED)
def test_its_predictions_and_exports_are_those_of_its_twin(name, runs):
    found, expected = predicted(*runs(name)), predicted(*runs("19 Hz"))
    assert differences(found, expected, SCALES[name], CLOSE) == []
    found = exported(runs(name)[1], SCALES[name])
    expected = exported(runs("19 Hz")[1], Scale())
    assert differences(found, expected, SCALES[name], CLOSE) == []


ALL = Scale(time=3e-3, length=7e-3, mass=2e4, sign=-1.0)


def silent(_):
    return None


@pytest.mark.release  # test_symmetry.py has the likelihoods of images, kind by kind
def test_a_fit_is_that_of_the_image():
    """Of a sweep, decays, a curve and a loop, time, length and mass scaled and motion turned."""
    campaign = measured("sweep_weak", "ringing", "held_curve", "pulled")
    image = campaign_in(campaign, ALL)
    found, expected = (identifiability(one, report=silent).summary() for one in (image, campaign))
    assert differences(found, expected, ALL, CLOSE) == []


@pytest.mark.release
def test_a_comparison_of_laws_is_that_of_the_image():
    campaign = measured("sweep_weak", "ringing")
    image = campaign_in(campaign, ALL)
    found, expected = (
        compare_laws(one, ["cubic", "bouc_wen"], seed=0, report=silent).record
        for one in (image, campaign)
    )
    assert differences(found, expected, ALL, CLOSE) == []
