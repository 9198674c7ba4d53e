"""Example values for every entry and every function of the catalogue, and what they are written as.

`python tests/report/messages.py` writes the snapshot anew: read the difference.
"""

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

from examples_of_faults import EXAMPLES as OF_FAULTS
from examples_of_identification import EXAMPLES as OF_IDENTIFICATION

from jbw.quantities import BY_NAME
from jbw.report.messages import (
    brief,
    commands,
    differences,
    discrepancy,
    figures,
    free_law,
    identified,
    joint,
    laws,
    loads,
    look,
    opening,
    planning,
    population,
    rig,
    run,
    stages,
    study,
    tables,
    watch,
)  # fmt: skip
from jbw.report.messages.findings import FINDINGS, remedy_of, sentence_of
from jbw.report.messages.message import FaultText
from jbw.report.messages.posterior import intervals_of_fit

SNAPSHOT = Path(__file__).with_name("messages.txt")

MORE = {"num_samples": 2000, "sampler": "nuts"}
SIZE = {"name": "delta", "size": 212.0, "limit": 400.0}
PEAKS = {"name": "delta", "below": 12.3, "above": 45.6, "weight": 0.3}
BOUND = {"name": "alpha", "side": "upper", "share": 0.137, "edge": 0.01}
OTHER = {"sampler": "nuts"}
DRAG = {
    "growth": 1.3, "least": 9.21, "number": 2, "y": 1.9,
    "frequency": [-2e-4, -1e-4, -9e-5], "damping": [1.35, 1.36, 1.37],
}  # fmt: skip
OTHER_LAW = {"another_law": "Try other laws: jbw laws."}
# Values of the sentence, then of the remedy.
OF_FINDINGS = {
    "not_sampled": ({"intervals": intervals_of_fit(None)}, {}),
    "second_posterior": ({"reason": "The posterior could not be made."}, {}),
    "incomplete_checks": ({"sentences": ["The check of one could not be made."]}, {}),
    "solver_error": ({"shift": 0.23, "limit": 0.1}, {"substeps": 8}),
    "series": ({"error": 0.3, "limit": 0.1},
               {"line": "Put under [identify.prior]: `gamma = [1.0, 3.0]`."}),
    "coloured_residual": (
        {"coloured": 2, "count": 6, "test": "sweep", "error": 0.034, "correlation": 0.8,
         "counted": 0.11}, OTHER_LAW,
    ),
    "repeatability": ({"count": 6, "test": "sweep", "error": 0.08, "scatter": 0.03}, OTHER_LAW),
    "cause": ({"text": "The response lags behind the drive by 0.001 s.", "share": 0.8},
              {"action": "Put under [[test]]: `delay = 0.001`."}),
    "level_trend": (
        {"quantity": "damping ratio", "count": 6, "change": 0.012, "std": 0.002,
         "unit": "% of critical damping", "p": 0.002}, OTHER_LAW,
    ),
    "misfit": ({"error": 0.12, "test": "hit_1", "limit": 0.1}, OTHER_LAW),
    "leave_one_out": ({"test": "sweep", "name": "zeta", "moves": 5.2, "limit": 4.0}, OTHER_LAW),
    "leave_one_out.none": ({}, {}),
    "records_apart": (
        {"count": 3, "name": "zeta", "scatter": 0.021,
         "others": [("alpha_delta", 0.013)], "within": 0.01, "beyond": 0.04}, {},
    ),
    "no_hysteresis": (
        {"y": 1.9, "damping": [1.35, 1.36, 1.37], "frequency": [-2e-4, -1e-4, 9e-5]},
        {"law": "quadratic_damping"},
    ),
    "no_joint": (
        {"y": 1e-3, "frequency": 2e-4, "damping": 0.012, "growth": 1.2, "least": 11.3}, {},
    ),
    "non_finite": ({"count": 3, "name": "alpha"}, {}),
    "frozen_chain": ({"count": 1, "num_chains": 4, "name": "alpha"}, {}),
    "r_hat": ({"name": "delta", "r_hat": 1.0312, "limit": 1.01}, MORE),
    "r_hat.one_chain": ({}, {"num_chains": 4}),
    "ess_bulk": (SIZE, MORE),
    "ess_tail": (SIZE, {"num_samples": None, "sampler": "nuts"}),
    "crossing": (PEAKS, {}),
    "crossing.weighed": ({"name": "delta"}, {}),
    "ess_weights": ({"size": 12.0, "limit": 400.0}, OTHER),
    "khat": ({"khat": 0.91, "limit": 0.7}, OTHER),
    "temperature": ({"beta": 0.5}, OTHER),
    "quadrature": ({"error": 0.1, "limit": 1e-3}, OTHER),
    "divergences": ({"count": 7, "size": 4000}, {"substeps": 16}),
    "failed_solves": ({"share": 0.021, "limit": 0.01}, {"substeps": 16}),
    "tree_depth": ({"share": 0.1, "limit": 0.05}, {"num_warmup": 1000}),
    "e_bfmi": ({"e_bfmi": 0.21, "limit": 0.3}, {}),
    "budget": ({"spent": 900.0}, {"budget": 1800.0}),
    "discrepancy": (
        {"frequency": 6.6e-5, "damping": 9.8e-5, "rest": 0.0049, "run": "sweep 26 mV",
         "run_frequency": -1.46e-4, "run_damping": 1.95e-4},
        OTHER_LAW,
    ),
    "discrepancy.small": ({"error": 3e-4, "limit": 1e-3}, {}),
    "discrepancy.no_repeats": ({}, {}),
    "chi_square": ({"ratio": 9.0, "low": 0.2, "high": 5.0}, {}),
    "no_hysteresis.drag": (DRAG, {"law": "quadratic_damping"}),
    "at_bound": (BOUND, {"line": "Put under [identify.prior]: `alpha = [1.0, 3.0]`."}),
    "at_bound.ends": (BOUND, {"name": "alpha"}),
    "unidentified_joints": ({"joints": ["bolt_1", "bolt_2"]}, {}),
    "unidentified": (
        {"names": ("alpha", "delta"), "ratio": 0.97,
         "text": "only the product alpha*delta is determined"},
        {"name": "alpha", "low": 1.0, "high": 2.0},
    ),
    "modes": ({**PEAKS, "rest": 0.7, "error": 0.012}, {}),
    "calibration_ranks": (
        {"name": "zeta", "p": 0.002, "test": "ECDF", "count": 8, "limit": 0.01}, {}
    ),
    "calibration_coverage": (
        {"name": "zeta", "share": 0.95, "count": 400, "low": 0.91, "high": 0.976}, {}
    ),
    "calibration_failures": (
        {"share": 0.02, "counted": ["8 not finite", "0 not mixed"], "limit": 0.01}, {}
    ),
}  # fmt: skip

OF_FINDINGS |= {
    "law_grade": (
        {"status": "usable", "count": 3, "error": 0.08, "worst": 0.12, "linear": 0.3,
         "coverage": 0.983, "to": "repeats", "is_withheld": False, "limit": 0.05}, OTHER_LAW,
    ),
    "simpler_model": (
        {"test": "sweep", "fit_status": "fitted", "error": 0.2, "kind": "cubic", "simpler": 0.1,
         "limit": 1.1}, OTHER_LAW,
    ),
    "law_replaced": ({"test": "sweep", "ratio": 1.2, "limit": 1.0}, OTHER_LAW),
    "held_out_coverage": ({"test": "sweep", "share": 0.81, "limit": 0.95},
                          {"line": 'Put under [identify]: `offsets = "runs"`.'}),
}  # fmt: skip
OF_PASSED = {"records_apart": {"count": 3, "names": ["zeta", "alpha_delta"]}}


def of_findings() -> Iterator[str]:
    """Every finding: its sentence, that of a check that passed, its remedy."""
    for entry, message in FINDINGS.items():
        if not message.sentence:
            continue
        values, remedy = OF_FINDINGS[entry]
        yield f"{entry}: {sentence_of(entry, values, passed=False)}"
        if message.passed:
            passed = sentence_of(entry, OF_PASSED.get(entry) or values, passed=True)
            yield f"  passed: {passed}"
        if message.remedy:
            yield f"  remedy: {remedy_of(entry, remedy)}"


SLOPE = {"q005": -2.0, "median": -1.5, "q995": -1.0}
PARAMETERS = {"alpha": 1e3, "delta": 100.0, "gamma": -200.0}
NUMBERS = watch.distances(31.2, 17.4, 20, 0.00021)


def in_one_line(text: str | FaultText) -> str:
    """A sentence, or what, why and remedy of a fault after each other."""
    return text if isinstance(text, str) else " ".join(filter(None, text))


def constants(topic: ModuleType) -> list[str]:
    """The texts of a topic that have no values."""
    texts = [text for name, text in vars(topic).items() if name.isupper()]
    return [in_one_line(text) for text in texts if isinstance(text, str | FaultText)]


# Functions of the catalogue and arguments, topic by topic.
OF_TOPICS = {
    "identified": [
        identified.directions(3, 5),
        identified.grade("known", [identified.with_error("alpha*delta", 12.0, 0.24, 0.02)]),
        identified.grade("roughly", ["zeta (12 %)"]),
        identified.grade("hardly", [identified.with_error("gamma", 2.0, 6.0, 3.0)]),
        identified.grade("unknown", ["alpha", "delta"]),
        identified.tie("alpha*delta", 34.2),
        identified.undetermined(["alpha", "delta"]),
        identified.determined(["alpha*delta"], logs=True),
        identified.determined(["a + b", "a - c"], logs=False),
        identified.box_sensitivity([identified.follows_bound("alpha", 0.17, "upper bound of alpha"),
                                    identified.follows_bound("gamma", float("inf"),
                                                             "lower bound of gamma")]),
        identified.box_sensitivity([]),
        identified.profile_interval("gamma", ["1.202", "1.31"]),
        identified.profile_limit("gamma", 1.3, "above"),
        identified.profile_open("gamma", (0.0, 50.0), 0.03, flat=True),
        identified.profile_refused("gamma", 3),
        identified.better_fit(12.3),
        identified.waterfall(1, 1),
        identified.waterfall(8, 1),
        identified.waterfall(8, 5),
        identified.costs(["12.1", "12.1"]),
        identified.costs(["12.1", "none"]),
    ],
    "laws": [
        free_law.FREQUENCY, free_law.DAMPING, free_law.LEAST_DAMPING, free_law.BAND,
        free_law.TABLE,
        free_law.bands(9.3e-4, (122.124, 122.135, 122.146), (1.2e-3, 1.25e-3, 1.29e-3)),
        free_law.bands_beyond(1.25, (121.9, 122.0, 122.1), (1.4e-3, 1.6e-3, 2.1e-3)),
        *(free_law.masing(rule, 12.3, 5.0) for rule in ("broken", "holds", "open")),
        free_law.least_damping(1.25, 1.4e-3), free_law.scattered(1.51),
        free_law.gap_sliders(11, 0.104, 2.6e-3),
        free_law.held_out_loop("1.5 in", 0.151, 0.124),
        laws.BY_READINGS,
        laws.trying("cubic"),
        laws.chosen_by_fits("cubic", {"cubic": 0.0041}, ["iwan4", "bouc_wen"], is_white=True),
        laws.chosen_by_fits(
            "iwan4", {"bouc_wen": 0.0068, "iwan4": 0.0021, "masing_power": 0.0025}, [],
            is_white=False,
        ),
        laws.OF_EACH_MODE, laws.IN_FIRST_MODE,
        *(
            laws.tried_at_joints(["linear", "bouc_wen"], ["bouc_wen@bolt_1"], 4, which, 12)
            for which in (laws.EVERY, laws.NONE, laws.NEITHER)
        ),
        laws.best_by_predictions("bouc_wen", 6),
        laws.best_by_evidence("bouc_wen", 1, 5),
        laws.best_by_evidence("bouc_wen", 3, 5),
        laws.equivalent(["iwan4"]),
        laws.worse(["cubic", "stop"]),
        laws.predicted_by("outward", ["cubic"], 0.04, "iwan4", 0.09),
        laws.predicted_by("across", ["cubic", "stop"], 0.04, "iwan4", None),
        laws.by_fit_alone("stop", 0.4, "bouc_wen", 0.1, 300.0),
        laws.not_judged(["iwan4"], "bouc_wen", 0.7),
        laws.against_repeats("bouc_wen", 0.1, 0.09, near=True),
        laws.linear_by_session(0.035, 0.03, 0.04),
        laws.at_bound("iwan4", ["chi"]),
        laws.of_law("iwan4", "The fit reached default prior bounds."),
        laws.unreliable_scores(["iwan4"], 0.7),
        laws.unreliable_evidence(["iwan4"], 0.7),
        laws.best_within("bouc_wen", 0.023),
        laws.best_beyond("bouc_wen", 0.051),
        laws.best_across("bouc_wen", "sweep", 0.034),
        laws.without_offsets("bouc_wen", 0.08, 0.02,
                             [laws.moved("alpha_delta", (12.0, 0.3), (14.0, 0.5))], "iwan4", 0.07),
        laws.without_offsets("bouc_wen", 0.08, 0.02,
                             [laws.moved("zeta", (0.012, 3e-4), (0.014, 5e-4))], "bouc_wen", 0.08),
        laws.wider_priors({"bouc_wen": -2.1, "cubic": -0.7}),
        laws.no_wider_evidence(["stop"]),
        laws.heading(4),
        laws.not_distinguished(["iwan4"]),
        laws.error_of_fit(0.023),
    ],
    "differences": [
        differences.NONE_DIFFERS, differences.without_backbone("runs/a"), differences.SCATTER,
        differences.with_torque("frequency", "0.14 mm", "0.85 [0.8, 0.9] Hz", "rises", steady=True),
        differences.with_torque("frequency", "0.14 mm", "2 [-28, 31] Hz", "rises", steady=False),
        differences.with_torque("damping ratio", "0.14 mm", "0 [-0.02, 0.03] %", "", steady=False),
        differences.LEAVE_IT_OUT, differences.NO_TORQUES, differences.INDEPENDENT_RUNS,
        differences.SIDE_BY_SIDE.format(3),
        differences.differs("omega_n", "1.00 [0.64, 1.36] rad/s", sure=True),
        differences.differs("zeta", "0.001 [-0.001, 0.003]", sure=False),
        differences.may_be_same(["zeta", "alpha"]),
        differences.factors_apart(["motion_factor_2@bolt_1"]),
        differences.homes_differ("bolt_1", "bolt_1 in mode 1", "bolt_1 in mode 2"),
        differences.of_prior({"gamma": ["A", "B"]}),
        differences.only_one(["alpha", "gamma"]),
        differences.not_usable("B", "failed"),
        differences.inadequate(["A", "B"]),
        differences.records_scatter({"A": {"zeta": 0.02}}),
        differences.sessions_scatter({"A": ("0.5 rad/s", "0.0001")}),
        differences.ONE_ASSEMBLY,
        differences.INDEPENDENT,
        differences.one_joint("gamma/delta", "0.27 [0.2, 0.3]", "0.5 [0.4, 0.6]", sure=True),
        differences.one_joint("gamma/delta", "0.27 [0.2, 0.3]", "0.28 [0.2, 0.3]", sure=False),
    ],
    "look": [
        look.NO_OSCILLATOR,
        look.coherence((0.97, "weak"), (0.99, "strong")),
        look.secant(1e-4, 1e-3, -0.12), look.of_mode(30.5, "Nonlinear: no."),
        look.not_read(["gap", "hole"], "A record has samples missing."),
        look.nonlinear(True, [1e-4, 1e-3], 3, [
            look.change("frequency", -0.013, 2e-4, (0.5, 0.4, 0.6), ""),
            look.no_change("damping ratio", 1e-4, 2e-4, " of critical damping")]),
        look.nonlinear(True, [1e-4, 1e-3], 1, [
            look.change("frequency", -0.013, 2e-4, None, ""),
            look.turning("damping ratio", 4e-4, 0.013, -2e-3)]),
        look.one_amplitude(1e-4, 3), look.likely_laws(["jenkins", "iwan"]),
        look.records_differ([("frequency", 0.002), ("damping", 0.03)], "order"),
        look.records_differ([("frequency", 0.002)], "runs"),
        look.records_differ([("frequency", 0.002)], ""),
        look.another_unit(2, 3, 0.101972, "units of g"),
        look.between_ends([1e-4, 2e-4, 4e-4], -0.013, 1.3, (0.01, 0.012), "softens"),
        look.between_ends([1e-4, 2e-4, 4e-4], 0.0013, 0.13, (0.01, 0.0101), ""),
        look.onset(4e-3, is_linear=True), look.onset(4e-3, is_linear=False),
        look.session_scatter(3, [("frequency", 0.00053, 0.0053), ("damping", 0.02, 0.05)]),
        look.not_assessed("A segment must have at least 8 samples."),
        look.repeats(3, 0.0023, 0.0013, look.AS_NOISE),
        look.repeats(3, 0.0423, 0.0243, look.more_than_noise(0.0023, 1e-9, 0.041)),
        look.harmonics([], 0.111), look.harmonics([look.harmonic("third", 0.012, 18.8)], 0.004),
        look.distortion(0.002, 0.013, 4), look.noise_of_periods(0.002, 8),
        look.idle_lines([("even", 0.001), ("odd", 0.02)], 0.002),
        look.coherence_of_noise(18.81, 0.963),
    ],
    "opening": [
        opening.effect(0.4, 4.0, "mm", opening.change(
            "natural frequency", "19.96", "19.6 Hz [19.59, 19.61]", lowers=True)),
        opening.effect(0.4, 4.0, "mm", opening.no_change("damping ratio", "1 % [0.9, 1.1]")),
        opening.effect(0.4, 4.0, "mm", opening.keeps_stiffness(96.4, 96.0, 97.0)),
        opening.contradicted(4.0, "mm", "1.5 % [1.485, 1.515]", "0.9 ± 0.03 %"),
        opening.of_unknown_mass("1e+06", "[9.949e+05, 1.005e+06]", is_rotation=False),
        opening.split([opening.repeats("tap", [1, 4]), "sweep"], [opening.repeats("tap", [2, 3])],
                      some_repeats=True),
        opening.split([f"sweep {i}" for i in range(9)], [], some_repeats=False),
        opening.LINEAR, opening.NO_BACKBONE, opening.NO_ERRORS, opening.NO_FIT_ERROR,
        opening.NO_GRADES, opening.FITTED_NOW, opening.TORSION, opening.NONE_HELD_OUT,
        opening.fitted_errors(2, opening.relative_error(opening.span("1.2", "3.4"), "20 to 30 %")),
        opening.held_out_errors(1, opening.relative_error("2.1 %", ""), "98.5 %", "4 %"),
        opening.held_out_errors(2, opening.relative_error("2.1 %", "22 %", "1.1 %"), "98.5 %", ""),
        opening.held_out_errors(3, opening.relative_error("2.1 %", ""), "98.5 %", "4 %", 1),
        opening.fit_errors(1, opening.span("1.2", "1.2")),
        opening.not_identified(["alpha", "delta"], "60", ["alpha_delta"], "2"),
        opening.not_identified(["alpha"], "60"),
        opening.not_identified(["alpha"], "60", poorly=True),
        opening.truncated("The upper prior bound truncates alpha."),
        opening.all_identified("zeta", "2.7", roughly=False),
        opening.all_identified("zeta", "12", roughly=True),
        opening.doubtful("decay_1: at 2.21 s the motion jumps."),
        opening.next_step("Draw more samples."), opening.next_step(""),
        opening.by_the_fit(["zeta 0.01 [0.009, 0.011]"]),
        opening.headline(["zeta 0.01 [0.009, 0.011]"], quick=True),
        opening.headline([], quick=False),
        *opening.STATUS.values(),
    ],
    "planning": [
        planning.WRITE_PLAN, planning.NOISE_ALONE, planning.PER_KILOGRAM, planning.FLEET_NOISE,
        planning.drawn_from_ranges(16), planning.drawn_from_run(16), planning.unknown_reach(2e-3),
        planning.cost(12, 16, 45.0), planning.cost(12, 16, 300.0),
        planning.too_far(2e-3, 1e-3), planning.too_strong(5.0, "V"), planning.no_response(2, 16),
        planning.before({"zeta": planning.with_median(0.2, 0.1)}),
        planning.before({"zeta": planning.with_median(0.1, 0.1)}),
        planning.title(0.05, ["alpha", "delta"], 16),
        planning.NO_TEST_NEEDED, planning.most_per_second("sweep", 2.0, "V"),
        planning.NO_TEST_ADMITTED, planning.together("the data do not determine delta"),
        *planning.recommended(["  3 x sweep, 2 V"], {"delta": "0.05"}, "4 min"),
        *planning.not_reached(["  9 x sweep, 2 V"], {"delta": "0.1"}, "4 min", 9),
        planning.fleet_designs((3, 2), 6, 1.7), planning.fleet_title(0.1),
        planning.told_by_run(" zeta"), planning.single_value("gain", (1.0, 2.0)),
        planning.missing("noise", "standard deviation of a sample"),
        planning.beyond_stiffness("alpha", 100.0, 120.0), planning.share_of("alpha"),
    ],
    "brief": [
        *brief.USE.values(), brief.PROVISIONAL, brief.MODES, brief.MEASURED, brief.FOOT,
        brief.heading("2026-01-31", "Bouc-Wen oscillator", "0.1"), brief.levels(several_modes=True),
        brief.more_findings(3), brief.more_lines(7),
    ],
    "commands": [
        *commands.SHORT.values(), commands.MORE, commands.FAULT, commands.NO_NAME,
        commands.MISSING_FACTS, commands.condition_number("12.3"),
        commands.nothing_called("rhat", "r_hat"), commands.one_at_a_time("a.toml", "b.toml"),
        commands.no_command("identfy", "identify"),
        commands.identify_again("run"), commands.saved("a run", "'a run'"),
        commands.draw_posterior("run"), commands.or_export("run"), commands.or_plan("run"),
        commands.finished("run", "run/report.html"), commands.finished("run", ""),
        commands.without_model("beam"), commands.sampler_distances("nuts"),
        commands.two_numbers("'10-25'"),
        commands.parameter_explained(BY_NAME["omega_n"], ()),
    ],
    "joint": [
        *constants(joint),
        joint.stiffer_than_structure("omega_n^2", 1.2e4, 1e4),
        joint.unbounded(joint.unloads_beyond(2.0), PARAMETERS, "Check delta."),
        joint.may_diverge(("alpha > 0", "gamma >= 0"), ("gamma >= 0",), PARAMETERS),
        joint.prior_unbounded(-30.0), joint.prior_beyond_motion("gap", 2e-4, 1e-3, 1e-4),
        joint.prior_beyond_motion("gap", 1e-5, 1e-3, 1e-4),
        joint.modes_explained(3, ((1.2, 1, 0.27), (0.4, 1, 0.53)), True),
        joint.no_known_force("chi", "iwan4", "above -1", -1.5),
        joint.joints_stiffer(1.2),
        joint.step_of_mode(400.0, 1.3, 1024.0, 1),
        joint.put_substeps(4),
        joint.indistinguishable(("iwan4", "jenkins_3"), joint.SAME_CURVES),
    ],
    "loads": [
        loads.sine(0.02, "V"), loads.limit(5.0, "g"), loads.random(1.2, "g"),
        *loads.warnings_of("A sine of 2 V", 4e-3, 1.8, 1.25, discrepancy.ERROR_UNKNOWN),
        loads.internal_resonance("A sine of 2 V", 18.5, 57.3), loads.isolated("A sine of 2 V", 0.5),
        loads.threshold_beyond("A sine of 2 V", "macroslip", 1e-3, "the slip force"),
        loads.LOADS_OR_TESTS, loads.BASE_NEEDS, loads.RESPONSE_NEEDS, loads.no_quantity("two"),
        loads.SINE_NEEDS, loads.no_sine("30"),
        loads.bare_level("V"), loads.DOWNWARD, loads.OF_SPECTRUM,
        loads.in_report("run"), loads.earlier_posterior("run"), loads.unreadable_loads("run"),
        loads.heading("response at 2 V"),
        loads.contains(loads.in_bands(scatters=True, misses=True), 100, "force"),
        loads.contains(loads.in_bands(scatters=False, misses=False), 100, "force"),
        loads.contains(loads.PARAMETERS, 100, "base", participation=1.3, shape=1.0),
    ],
    "run": [
        *constants(run), run.stopping(waits=True), run.stopping(waits=False),
        run.damaged_checkpoint("joint", "beam-run", has_earlier=True),
        run.damaged_checkpoint("joint", "beam-run", has_earlier=False),
        run.another_machine("lab", "16", "desk", "8"), run.going_on(3),
    ],
    "rig": [rig.IDENTIFY, rig.PRIOR, *rig.PURPOSE.values(), *rig.HEAD.splitlines()],
    "figures": [
        *constants(figures),
        figures.model_residual("2.3 %"), figures.taken_by_slip("alpha"),
        figures.full_stick("alpha"),
        figures.modal_amplitude("mm", several_joints=False),
        figures.modal_amplitude("mm", several_joints=True), figures.fold("mode 2", "3 mm"),
        figures.mode_at(2, 90.47), figures.energy_of("bolt_1 8.2 %"),
        figures.secant("1.2e+07", "N/m"),
        figures.loop_areas(4, "3 %"), figures.less_mean("alpha", "nuts"),
    ],
    "stages": [
        *constants(stages), stages.little_address_space(1.5, 3.0), stages.design(3),
        stages.unkept_code("/var/cache/jbw", "Read-only file system"),
        stages.scoring("cubic", 6, by_fit=True),
        stages.scoring("cubic", 6, by_fit=False), stages.scoring("cubic", 1, by_fit=True),
        stages.scoring("cubic", 1, by_fit=False), stages.points(1000, "products"),
        stages.drawing_figures("run/report.html"), stages.drawing_records("figures"),
        stages.later_round("joint posterior", 2), stages.effective(312.0, 400.0),
        stages.evaluated("... Fitting, for 9 s so far", 1536),
        stages.finished_before("usable"), stages.joint_posterior(12, 40960), stages.kernel(8),
        stages.least_squares(12, 0), stages.long_fit(327.0, ["low", "high"], 752.0),
        stages.long_fit(327.0, ["low"], None), stages.line_fit("noise"),
        stages.fitting_as("bouc_wen"),
    ],
    "study": [
        *constants(study),
        study.step_2(1e-5, 1), study.step_2(1e-5, 4),
        study.neighbours([(18.8, 0.005), (20.0, 0.004)], 0.023),
        study.rigid_body("1.5 [1.4, 1.6]", "1/kg"), study.compliance("1.5 [1.4, 1.6]", "m/N"),
        study.no_shaker("sweep", "It has no voltage."), study.identify_anew("runs/a"),
        study.verdict_of("beam", "failed", "the chains disagree."),
        study.exported_draw(12, 400, study.HIGHEST_DENSITY, 2.0), study.one_draw(12, 2.0),
        study.exported_joints(12, 400, study.AS_ASKED, "N-mm-t-s"),
        study.one_of_joints_draws(12, "N-mm-t-s"),
        study.mode_beside_matrices(2, 90.47, 91.2, 0.0021),
        study.motion_beside_matrices("motion of bolt_1 in mode 2", 1.0432),
        study.joint_place("bolt", ("1 (17:x) -1 (112:x)", "mm"), (1.5e4, "N/mm"),
                          is_held=True, has_law=True),
        study.joint_place("bolt", ("1 (17:x) -1 (112:x)", "mm"), (1.5e4, "N/mm"),
                          is_held=False, has_law=True),
        study.joint_place("bolt", ("1 (17:x)", "mm"), (1.5e4, "N/mm"),
                          is_held=True, has_law=False),
        study.joint_place("bolt", ("1 (17:x)", "mm"), (1.5e4, "N/mm"),
                          is_held=False, has_law=False),
        study.joint_in_si("bolt", "m", "N"), study.joint_dashpot("bolt", 90.47, 0.3, "mm"),
        study.within_interval("alpha*delta", 12.0, "1/(m s^2)", 11.0, 13.0, inside=True),
        study.within_bands(inside=False), study.sliders("iwan4", 0.008, 0.001, 0.01, 1.2),
        study.without_form("Nastran"), study.no_logarithm("gamma", ["unit_1"]),
        study.unfinished("runs/a"), study.further_units(8.0, of_units=True),
        study.further_units(None, of_units=False),
        study.rank_below("zeta"), study.truth_inside("zeta"),
    ],
    "tables": [
        *constants(tables), tables.rests_on(["gamma"]), tables.beyond(1.3), tables.laws("beam"),
    ],
    "population": [
        population.mostly_prior(2, 1, trend=False),
        population.mostly_prior(4, 2, trend=True),
        population.wide_intervals(4, 2),
        population.not_converged(1.2, 40),
        population.failed_runs(["unit_1", "unit_4"], 6),
        population.confounded(-0.99),
        population.no_logarithm("gamma", ["unit_2"]),
        population.trend("alpha*delta", SLOPE, rises=False),
        population.ratio_trend("gamma/delta", SLOPE, depends=True),
        population.ratio_trend("gamma/delta", SLOPE, depends=False),
        population.scatter([("zeta", 0.031, 0.2)]),
        population.outliers(["unit_3"]),
        population.weighed(4, 6, 0.31),
        population.approximated(["unit_0", "unit_1"]),
        population.weak(["gamma"], 2.0),
        population.saturates(["omega_n"], SLOPE),
        population.wrench("alpha*delta", 0.1, 0.15, 0.043),
        population.scatter_stage(6),
        population.sampling_stage(6, 4),
        population.without_stage(1, 2),
        population.one_stage(6, 1000),
        population.heading(6),
        population.caption(trend=True),
    ],
    "discrepancy": (
        *constants(discrepancy),
        discrepancy.bands_withheld(["far", "farther"]),
        discrepancy.one_kind("sweeps"),
        *(reason.sentence for reason in discrepancy.UNSCORED.values()),
        discrepancy.not_scored("one run", "sweeps"),
        discrepancy.not_scored("", "loops"),
    ),
    "watch": [
        watch.no_alarm(NUMBERS),
        watch.alarm("drift", "hit 31", "hit 27", "looser",
                    watch.changes((-0.12, -0.2, -0.04), (0.08, 0.05, 0.11), ""), NUMBERS),
        watch.alarm("reading", "hit 31", "hit 31", "looser", watch.changes(
            (-0.12, -0.2, -0.04), (0.08, 0.05, 0.11), watch.torque_change(
                8.0, (6.1, 5.2, 7.3), within_fleet=False, is_explained=False)), NUMBERS),
        watch.attenuated(0.1, 0.043),
        watch.torn_line("w/watch.jsonl", 50, "w/watch.torn"),
        watch.known_already("hit 3", 23),
        watch.particles("hit 5", 0.42, moved=True),
        watch.several_amplitudes(20),
        watch.CAPTION,
        watch.heading(31, 20),
        watch.table_title("0.3 m/s", 1e-3),
    ],
}  # fmt: skip


def catalogue() -> str:
    """All that the catalogue says of the examples."""
    lines = list(of_findings())
    for topic, sentences in OF_TOPICS.items():
        lines += ["", topic, *(f"  {sentence}" for sentence in sentences)]
    for topic, examples in {**OF_IDENTIFICATION, **OF_FAULTS}.items():
        texts = *constants(import_module(f"jbw.report.messages.{topic}")), *examples
        lines += ["", topic, *(f"  {in_one_line(text)}" for text in texts)]
    return "".join(f"{line}\n" for line in lines)


if __name__ == "__main__":
    sys.stdout.write(f"{SNAPSHOT.write_text(catalogue(), encoding='utf-8')} characters\n")
