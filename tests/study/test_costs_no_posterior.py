"""What stands beside the main posterior and fails is left out and said: the posterior stays."""

import h5py
import numpy as np
import pytest
from toy_campaign import FS, LAW, PLAIN, integrated, write_toy

import jbw
from jbw.errors import Attempts, DataError
from jbw.identification import checks, free_decays
from jbw.report import figures
from jbw.study import collect, comparisons
from jbw.verification import forced, verify

DECAY = """
[[test]]
kind = "decay"
name = "ring/down"
files = "ring_*.h5"
band = [12.0, 26.0]
channels = {{ velocity = "velocity" }}
units = {{ velocity = "m/s" }}
fs = {fs}
"""
NOISE = 2e-3  # of the decays [m/s]


def failing(*_, **__):
    raise ValueError("array must not contain infs or NaNs")


@pytest.fixture(scope="module")
def ringing(tmp_path_factory):
    """The toy campaign with free decays of 0.2 mm."""
    folder = tmp_path_factory.mktemp("ringing")
    path = write_toy(folder, PLAIN)
    rng = np.random.default_rng(0)
    for i, y in enumerate((2e-4, 1.5e-4)):
        _, v = integrated(np.zeros_like, 512, y=y)
        with h5py.File(folder / f"ring_{i}.h5", "w") as file:
            file["velocity"] = v + NOISE * rng.standard_normal(len(v))
    # Fewer programs are compiled without a loop and without an oscillator to compare with; the
    # sampler `amis` evaluates the likelihood by the program of the fit.
    sweeps, *_ = path.read_text().partition('\n[[test]]\nkind = "loop"')
    settings = PLAIN.replace("importance", "amis") + "compare_with = []\n"
    path.write_text(f"{sweeps}{DECAY.format(fs=FS)}{LAW}\n[identify]\n{settings}")
    return path


@pytest.mark.leaves_out
def test_an_attempt_says_what_failed_and_why():
    said = []
    attempts = Attempts(said.append)
    assert attempts.make("The sum", lambda: 2 + 2, None) == 4
    assert attempts.make("The figure", failing, "nothing") == "nothing"

    def refused():
        raise DataError("The record is short.", remedy="Measure longer.")

    assert attempts.make("The table", refused, None) is None
    assert (
        attempts.said
        == said
        == [
            "The figure could not be made and is left out: "
            "ValueError: array must not contain infs or NaNs.",
            "The table could not be made and is left out: The record is short.",
        ]
    )
    with pytest.raises(KeyboardInterrupt):
        attempts.make("The figure", lambda: (_ for _ in ()).throw(KeyboardInterrupt), None)


@pytest.mark.leaves_out
def test_comparisons_that_fail_leave_the_posterior_and_are_named(toy, tmp_path, monkeypatch):
    whole = jbw.load_study(toy / "run")
    for place, name in (
        (forced, "compare_records"),
        (forced, "compare_frfs"),
        (verify, "references"),
        (collect, "backbone_group"),
        (collect, "arviz_groups"),
        (comparisons, "look_again"),
        (checks, "leave_one_out"),
        (checks, "response_finding"),
        (checks, "within_response"),
    ):
        monkeypatch.setattr(place, name, failing)
    campaign = jbw.load_campaign(write_toy(tmp_path, PLAIN))
    found = jbw.identify(campaign, seed=1, report=lambda _: None)
    for name in ("omega_n", "gamma"):
        draws, same = (each.tree["posterior"][name].values for each in (found, whole))
        np.testing.assert_array_equal(draws, same)
    said = " ".join(found.record["steps"]["joint"]["statements"])
    for what in (
        "test `weak` with the model", "oscillators without hysteresis", "The backbone",
        "likelihood of single records", "study of identifiability",
    ):  # fmt: skip
        assert what in said
    codes = {one.code: one for one in found.verdict.findings}
    assert "incomplete_checks" not in {one.code for one in whole.verdict.findings}
    assert codes["incomplete_checks"].status == "not assessed"
    assert "the fits that each omit one test" in codes["incomplete_checks"].reason
    monkeypatch.setattr(figures.FIGURE_LIST[0].__class__, "draw", property(lambda _: failing))
    found.save(tmp_path / "run")
    assert (tmp_path / "run" / "posterior.nc").is_file()
    assert "This figure could not be drawn" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.slow
def test_decays_that_show_no_joint_are_compared_with_the_joint_posterior(ringing):
    """The joint slips in sweeps to 12 mm, and hardly in decays of 0.2 mm."""
    found = jbw.identify(jbw.load_campaign(ringing), seed=1, report=lambda _: None)
    assert "alpha" not in found.tree["steps/decay/posterior"]
    groups = found.tree["verification"]
    assert "alpha" in found.tree["posterior"]
    assert "model_damping" in groups["amplitude"]
    assert len(groups["decay"].children) == 2
    for decay in groups["decay"].children.values():
        # White noise in a band of 14 of 128 Hz, and as much again for the error of the start.
        noise = NOISE * np.sqrt(14 / 128)
        miss = decay["measured"].values - decay["model_band"].values[1]
        assert np.sqrt(np.mean(miss**2)) < 2 * noise


@pytest.mark.leaves_out
@pytest.mark.slow
def test_a_second_posterior_that_fails_costs_the_first_one_nothing(ringing, tmp_path, monkeypatch):
    drawn = free_decays.joint_step

    def step(*args, name="joint", **options):
        return failing() if name == "decay" else drawn(*args, name=name, **options)

    monkeypatch.setattr(free_decays, "joint_step", step)
    found = jbw.identify(jbw.load_campaign(ringing), seed=1, report=lambda _: None)
    codes = {one.code: one for one in found.verdict.findings}
    assert "infs or NaNs" in codes["second_posterior"].reason
    assert "free decays alone" in codes["second_posterior"].reason
    assert found.record["main"] == "joint"
    assert abs(float(found.tree["posterior"]["omega_n"].mean()) - 118.0) < 0.5
    # Its decays are compared by the joint posterior, which knows the noise of every record.
    assert any(name.startswith("ring") for name in found.record["predictions"])
    found.save(tmp_path / "run")
