"""The five sentences and the ten lines that a run begins with, each with its counter-case."""

import io

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jbw.cli import run
from jbw.cli.identify import short_lines
from jbw.cli.printing import show
from jbw.measurement.records import Record, Test
from jbw.report.messages import opening as messages
from jbw.report.messages.discrepancy import not_scored
from jbw.report.opening import (
    _following,
    _unit_of_motion,
    joint_sentences,
    known_parameters,
    lead,
    opening,
    split_sentence,
)
from jbw.results.run import RunSummary, StoredJoints
from jbw.study import resumable
from jbw.study.summary import _turning

QUANTILE = [0.005, 0.5, 0.995]


def facts(mean, cv, kl=2.0, unit="1"):
    half = 2.576 * cv * abs(mean)
    ends = {"q005": mean - half, "q995": mean + half}
    return {"mean": mean, "cv": cv, "kl": kl, "unit": unit, "sd": cv * abs(mean), **ends}


def summary_of(parameters=None, findings=(), predictions=None, **more):
    """A run's summary of what the sentences are made of."""
    rows = parameters or {"omega_n": facts(118.0, 1e-3, unit="rad/s"), "zeta": facts(0.01, 0.02)}
    status = "ok" if all(row["status"] == "ok" for row in findings) else "failed"
    answers = {"sampling": {"status": "ok", "question": "Did it?"}}
    record = {
        "campaign": "toy",
        "main": "joint",
        "steps": {"joint": {"parameters": rows}, "linear": {"parameters": {}}},
        "verdict": {"status": status, "answers": answers, "findings": list(findings)},
        "predictions": predictions or {},
        "wall_time_s": 60.0,
    }
    return RunSummary.read(record | more)


def finding(code, status="failed", reason="It is so.", action="Do it."):
    return {"code": code, "status": status, "reason": reason, "action": action}


def tree_of(rise=-0.02, laws='["bouc_wen"]', damping=0.5):
    """A result whose frequency rises from 20 Hz by a part of it at 4 mm, within +-0.01 Hz."""
    y = np.linspace(0.0, 5e-3, 51)[1:]
    frequencies = 20.0 * (1 + rise * y / 4e-3) + 0.01 * np.array([-1.0, 0.0, 1.0])[:, None]
    ratios = 0.01 * (1 + damping * y / 4e-3) * np.array([0.99, 1.0, 1.01])[:, None]
    dims = ("quantile", "amplitude")
    group = xr.Dataset(
        {"frequency": (dims, frequencies), "damping": (dims, ratios)},
        {"amplitude": y, "quantile": QUANTILE},
        {"y_fitted": 4e-3},
    )
    root = xr.Dataset(attrs={"laws": laws})
    return xr.DataTree.from_dict({"/": root, "/verification/backbone": group})


def test_what_the_joint_does_is_told_at_a_tenth_of_the_motion_and_at_its_end():
    """20 Hz less 2 % at 4 mm is 19.6 Hz, at 0.4 mm 19.96; 1 % times 1.5 and 1.05 of damping."""
    sentence = opening(summary_of(), tree_of())[0]
    lowers = messages.change("natural frequency", "19.96", "19.6 Hz [19.59, 19.61]", lowers=True)
    raises = messages.change("damping ratio", "1.05", "1.5 % [1.485, 1.515]", lowers=False)
    assert sentence == messages.effect(0.4, 4.0, "mm", f"{lowers} and {raises}")


def test_a_joint_that_hardens_and_damps_less_is_told_so():
    sentence = opening(summary_of(), tree_of(0.02, damping=-0.5))[0]
    raised = messages.change("natural frequency", "20.04", "20.4 Hz", lowers=False)
    assert raised in sentence
    assert messages.change("damping ratio", "0.95", "0.5 %", lowers=True) in sentence


def test_a_change_within_its_band_is_no_change():
    sentence = opening(summary_of(), tree_of(-0.0001))[0]
    interval = "19.998 Hz [19.988, 20.008]"
    assert messages.no_change("natural frequency", interval) in sentence


def with_readings(damping, sd, y=(1e-3, 4e-3)):
    """The result above, with measured damping ratios at two amplitudes."""
    tree = tree_of().to_dict()
    rows = {"y": y, "damping": damping, "damping_sd": (sd, sd)}
    tree["/look/tap"] = xr.Dataset({name: ("reading", list(x)) for name, x in rows.items()})
    return xr.DataTree.from_dict(tree)


@pytest.mark.parametrize(
    ("damping", "sd", "said"),
    [
        # The law has 1.125 and 1.5 % there, with 1 % of it to both sides.
        ((0.0112, 0.0152), 1e-4, False),  # it agrees
        ((0.0112, 0.0090), 1e-4, True),
        ((0.0112, 0.0090), 5e-3, False),  # the records do not tell
        ((0.0112, 0.0130), 1e-5, False),  # certain, but 15 % are no other law
    ],
)
def test_a_law_that_contradicts_what_the_records_show_is_not_to_be_used_there(damping, sd, said):
    found = opening(summary_of(), with_readings(damping, sd))[1]
    contradiction = messages.contradicted(4.0, "mm", "1.5 % [1.485, 1.515]", "0.9 ± 0.03 %")
    assert (found == contradiction) == said


def test_what_lies_beyond_the_fitted_motion_contradicts_nothing():
    sentences = opening(summary_of(), with_readings((0.02, 0.02), 1e-4, y=(4.1e-3, 9e-3)))
    assert not any("without a law" in sentence for sentence in sentences)


def test_no_joint_is_said_in_the_words_of_its_finding_and_only_when_it_is_against():
    reason = "No joint is seen: it changes nothing."
    absent = summary_of(findings=[finding("no_joint", reason=reason)])
    assert opening(absent, tree_of())[0] == reason
    present = summary_of(findings=[finding("no_joint", "ok", reason)])
    assert opening(present, tree_of())[0].startswith("From 0.4 to 4 mm")
    assert opening(present, tree_of(laws="[]"))[0] == messages.LINEAR


def test_bounds_of_a_joint_that_is_not_seen_are_no_next_step():
    """They follow from it: data that see no joint leave its parameters to the prior."""
    follows = [finding("at_bound", action="Widen it."), finding("unidentified", action="Narrow.")]
    absent = summary_of(findings=[*follows, finding("no_joint", action="Drive harder.")])
    assert opening(absent, tree_of())[-1] == "To do next: Drive harder."
    assert opening(summary_of(findings=follows), tree_of())[-1] == "To do next: Widen it."
    unsure = finding("r_hat", action="Draw more.")
    mixed = summary_of(findings=[unsure, *follows, finding("no_joint", action="Drive harder.")])
    assert opening(mixed, tree_of())[-1] == "To do next: Draw more."


def test_a_prescribed_motion_tells_stiffness_and_no_frequency():
    """Stiffness goes by the frequency squared: (19.6 / 19.96)^2 = 0.9642."""
    forced = summary_of({"alpha": facts(500.0, 0.02)})
    sentence = opening(forced, tree_of())[0]
    assert "keeps 96.4 %" in sentence
    assert "Hz" not in sentence
    assert lead(forced, ["backbone", "loops"]) == "loops"
    assert lead(summary_of(), ["backbone", "loops"]) == "backbone"
    assert lead(summary_of(), ["backbone", "amplitude"]) == "amplitude"
    assert lead(summary_of(), ["ridge"]) is None


@pytest.mark.parametrize(("gain", "said"), [(1.0, True), (0.5, False), (None, False)])
def test_a_joint_of_unknown_mass_has_its_stiffness_and_the_mass_that_is_taken(gain, said):
    rows = {"omega_n": facts(1000.0, 1e-3, unit="rad/s")}
    given = tree_of()
    given.attrs["held"] = "{}" if gain is None else f'{{"gain": {gain}}}'
    found = opening(summary_of(rows), given)
    # The square of 1000 rad/s and of its ends, 1000 -+ 2.576.
    stated = "joint is 1e+06 [9.949e+05, 1.005e+06] N/m. The tests do not determine the modal "
    assert any(stated in sentence for sentence in found) == said
    assert any("parameters are those of 1 kg." in sentence for sentence in found) == said


def test_rotations_are_written_in_radians_and_said_to_be():
    loops = [{"test": "twist", "y": 4e-3, "stiffness": 1.0, "unit": "rad"}]
    turned = summary_of(look={"tests": [], "loops": loops})
    effect, units, *_ = opening(turned, tree_of())
    assert effect.startswith("From 0.4 to 4 mrad")
    assert units == messages.TORSION
    pulled = summary_of(look={"tests": [], "loops": [{**loops[0], "unit": "m"}]})
    assert opening(pulled, tree_of())[0].startswith("From 0.4 to 4 mm")
    assert messages.TORSION not in opening(pulled, tree_of())


def test_errors_of_fitted_and_held_out_tests_stand_apart():
    tests = {
        "weak": {"fitted": True, "nrmse": 0.012, "nrmse_linear": 0.2},
        "strong": {"fitted": True, "nrmse": 0.034, "nrmse_linear": 0.3},
        "middle": {"fitted": False, "nrmse": 0.021, "coverage": 0.985, "half_width": 0.04},
        "loop": {"fitted": True, "nrmse": None},
    }
    _, fit, held, *_ = opening(summary_of(predictions=tests), tree_of())
    assert fit == messages.fitted_errors(2, messages.relative_error("1.2 to 3.4 %", "20 to 30 %"))
    error = messages.relative_error("2.1 %", "")
    assert held == messages.held_out_errors(1, error, "98.5 %", "4 %")
    del tests["middle"]
    assert opening(summary_of(predictions=tests), tree_of())[2] == messages.NONE_HELD_OUT


def test_what_no_test_shows_of_the_law_is_said_at_once():
    nothing = {"levels": "", "kind": ""}
    for unscored in ({"levels": "one run", "kind": "sweeps"}, {"levels": "", "kind": "loops"}):
        said = opening(summary_of(unscored=unscored), tree_of())
        assert not_scored(**unscored) in said
    unknown = "The error of the law in predicting"
    assert not any(line.startswith(unknown) for line in opening(summary_of(), tree_of()))
    assert opening(summary_of(unscored=nothing), tree_of()) == opening(summary_of(), tree_of())


def test_what_is_not_known_is_named_with_the_products_that_are():
    ridge = {
        "omega_n": facts(118.0, 1e-3),
        "alpha": facts(500.0, 0.6, kl=1.0),
        "delta": facts(340.0, 0.7),
        "alpha_delta": facts(1.7e5, 0.02, kl=None, unit="1/(m s^2)"),
    }
    sentence = opening(summary_of(ridge), tree_of())[3]
    parts = ["alpha", "delta"], "60", ["alpha_delta"], "2"
    assert sentence == messages.not_identified(*parts, poorly=True)
    ridge["delta"] = facts(340.0, 0.7, kl=0.1)  # as wide as its prior
    assert opening(summary_of(ridge), tree_of())[3] == messages.not_identified(*parts)
    assert [parameter.split()[0] for parameter in known_parameters(summary_of(ridge))] == [
        "omega_n",
        "alpha_delta",
    ]


def test_where_all_is_known_the_least_known_is_named_and_no_product():
    parameters = {
        "omega_n": facts(118.0, 1e-3, unit="rad/s"),
        "alpha": facts(500.0, 0.04),
        "alpha_delta": facts(1.7e5, 0.02, kl=None),
    }
    all_of_them = messages.all_identified("alpha", "4", roughly=False)
    assert opening(summary_of(parameters), tree_of())[3] == all_of_them
    # 118 +- 2.576 * 0.118: two digits of a width of 0.61.
    assert known_parameters(summary_of(parameters)) == [
        "omega_n 118 [117.7, 118.3] rad/s",
        "alpha 500 [448, 552]",
    ]


def test_a_parameter_that_leans_on_its_bound_is_not_called_known():
    leaning = summary_of(findings=[finding("at_bound", reason="alpha leans.")])
    assert opening(leaning, tree_of())[3] == messages.truncated("alpha leans.")
    fine = summary_of(findings=[finding("at_bound", "ok", "alpha does not lean.")])
    assert opening(fine, tree_of())[3].startswith("All parameters")


def test_what_fails_is_to_be_done_before_what_is_only_limited():
    both = [finding("a", "usable", action="Later."), finding("b", "failed", action="First.")]
    assert opening(summary_of(findings=both), tree_of())[4] == "To do next: First."
    assert opening(summary_of(), tree_of())[4] == messages.NOTHING_TO_DO


def test_a_bare_summary_has_no_sentences():
    assert opening(RunSummary.read({}), xr.DataTree()) == []


@pytest.mark.parametrize("width", [80, 160])
def test_the_terminal_has_at_most_ten_lines_and_its_report(tree, summary, monkeypatch, width):
    """Nine here: the tenth says where the report is, and a wide terminal wraps few of them."""
    screen = Console(file=io.StringIO(), width=width, highlight=False)
    monkeypatch.setattr("jbw.cli.printing.console", lambda: screen)
    lines = list(short_lines(RunSummary.read(summary), tree))
    assert len(lines) <= 9
    show(*lines)
    printed = screen.file.getvalue()
    assert printed.startswith("cantilever: Bouc-Wen oscillator")
    assert "Verdict: not assessed" in printed
    assert "omega_n 118.17" in printed
    # What the paper's own steps say is left for --verbose.
    assert "third_order" not in printed
    assert len(printed.splitlines()) <= 20


def test_the_command_prints_ten_lines_and_with_verbose_the_rest(tmp_path, monkeypatch, capsys):
    step = {"statements": ["Drawn at once."], "verdict": {"status": "ok"}}
    summary = summary_of(findings=[finding("coloured_residual", "ok")], steps={"joint": step})
    monkeypatch.setattr(resumable, "identified", lambda *_: (tree_of(), summary))
    monkeypatch.setattr("jbw.report.page.write_page", lambda *of: of[2].write_text("page"))
    monkeypatch.setattr("jbw.report.figures.draw_figures", lambda *_: None)
    out, campaign = tmp_path / "short", tmp_path / "toy.toml"
    campaign.touch()
    assert run(["identify", str(campaign), "--out", str(out)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) <= 10
    assert printed[-1] == f"Report: {out / 'report.html'}"
    assert printed[1] == "Verdict: ok (sampling ok)"
    assert "Drawn at once" not in "".join(printed)
    assert run(["identify", str(campaign), "--out", str(tmp_path / "long"), "--verbose"]) == 0
    assert "joint: Drawn at once." in capsys.readouterr().out


def test_what_is_doubtful_in_the_records_stands_before_what_to_do_next():
    doubted = summary_of(doubts=["decay_1: at 2.21 s the motion jumps."])
    *_, doubt, following = opening(doubted, tree_of())
    assert doubt == messages.doubtful("decay_1: at 2.21 s the motion jumps.")
    assert following == opening(summary_of(), tree_of())[-1]


def shares(*medians):
    return [{"0.005": x - 0.01, "0.5": x, "0.995": x + 0.01} for x in medians]


def test_several_joints_are_told_by_mode_and_an_unidentified_one_damps_nothing():
    joint = {"energy_share": [0.2, 0.1], "softening_share": shares(0.5, 0.5)}
    joints = {
        "modes": [
            {
                "mode": mode,
                "frequency_hz": hz,
                "frequency_change": {"0.005": -0.041, "0.5": -0.04, "0.995": -0.039},
                "damping_added": {"0.005": 0.009, "0.5": 0.01, "0.995": 0.011},
                "shape": shape,
            }
            for mode, hz, shape in ((1, 32.0, "free"), (2, 90.0, "full stick"))
        ],
        "joints": [
            {"joint": "bolt_1", "verdict": "unidentified", "loss_share": shares(0.7, 0.02)} | joint,
            {"joint": "bolt_2", "verdict": "identified", "loss_share": shares(0.3, 0.98)} | joint,
        ],
    }
    effect, damped, unknown = joint_sentences(StoredJoints.read(joints))
    assert "frequency of mode 1 changes by -4 % [-4.1, -3.9]" in effect
    assert "damping ratio by 1 % [0.9, 1.1]" in effect
    assert effect.count("in the mode shape with fully stuck joints") == 1
    assert damped == "Mode 2 is damped mainly by bolt_2 (98 % of the joints' losses)."
    assert unknown.startswith("Not identified separately: bolt_1;")
    assert joint_sentences(None) == []


def test_a_cause_is_told_before_what_follows_from_it():
    """Two modes of the posterior, say, where the response has another clock."""
    rows = [
        {"code": code, "status": "failed", "reason": "Found.", "action": action}
        for code, action in (("modes", "Report each mode."), ("cause", "Correct the clock."))
    ]
    assert _following(RunSummary.read({"verdict": {"findings": rows}})).endswith(
        "Correct the clock."
    )
    assert _following(RunSummary.read({"verdict": {"findings": rows[:1]}})).endswith(
        "Report each mode."
    )


def test_decays_of_torsion_say_the_units_of_their_tables():
    assert (
        _unit_of_motion(
            RunSummary.read({"motion_unit": "rad", "look": {"tests": [{"name": "decay"}]}})
        )
        == "rad"
    )
    assert _unit_of_motion(RunSummary.read({"look": {"tests": [{"name": "decay"}]}})) == "m"


@pytest.mark.parametrize(
    ("units", "said"),
    [(("rad/s", "rad/s"), {"motion_unit": "rad"}), (("rad/s", "m/s"), {}), (("m/s",), {})],
)
def test_a_summary_says_that_its_motion_is_a_rotation(units, said):
    records = [Record(64.0, {"velocity": np.ones(8)}, {"velocity": unit}) for unit in units]
    assert _turning([Test("decay", (record,)) for record in records]) == said


def test_the_split_names_the_fitted_repeats_and_the_others():
    rows = [
        {"test": "tap", "repeats": 4, "fitted_repeats": [1, 4]},
        {"test": "sweep", "repeats": 2, "fitted_repeats": [1, 2]},
        {"test": "tone", "repeats": 1, "fitted_repeats": []},
    ]
    assert split_sentence(RunSummary.read({"tests": rows})).startswith(
        "Fitted: tap (repeats 1 and 4) and sweep. Held out: tap (repeats 2 and 3) and tone. "
    )
    whole = split_sentence(RunSummary.read({"tests": rows[1:2]}))
    assert whole == "Fitted: sweep. Held out: nothing."
    assert (
        split_sentence(RunSummary.read({"tests": [{"kind": "sweep"}]})) is None
    )  # of an earlier version
