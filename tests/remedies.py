"""Every remedy in the code that is a line of a campaign file, with the test that pastes it.

Lines are found in the source as `Put under [table]: ...` within backquotes, as other backquoted
`key = value`, and as calls of `put`. `test_remedies.py` fails for a line that is in no row of
`PASTED`, and for a row without its line or its test.
"""

import ast
import re
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "jbw"
LINE = re.compile(r"`([\w.]+) = [^`]*`")
COMMAND = re.compile(r"\bjbw ([a-z]+)((?: --?[a-z-]+| [A-Z]+(?:\.toml)?| \{\})*)")
CALLS = {"put": 1, "put_bounds": None}  # position of the argument that is the key
TEXTS = (ast.Constant, ast.JoinedStr)  # nodes that may be a string
# These sentences quote a test, a run or a call, and propose no line to paste.
QUOTES = {
    ("campaign/check.py", "band"),
    ("campaign/files.py", "files"),
    ("report/messages/reading.py", "units"),  # of times: the unit is a guess to be replaced
    ("report/messages/reading.py", "resample"),  # RATE is replaced: campaign/test_memory.py
    ("oscillator/checks.py", "fs"),
    ("oscillator/checks.py", "substeps"),
    ("oscillator/modes/structure.py", "fs"),
    ("oscillator/modes/structure.py", "substeps"),
}

CHECKS = "campaign/test_pasted_remedies.py::"
DECAYS = CHECKS + "test_a_pasted_remedy_of_a_decay_cures"
DRIVEN = CHECKS + "test_a_pasted_remedy_of_a_driven_record_cures"
LOOPS = CHECKS + "test_a_pasted_remedy_of_a_loop_cures"
CURVES = CHECKS + "test_a_pasted_remedy_of_a_curve_cures"
POINTS = "campaign/test_controlled_campaigns.py::test_a_pasted_remedy_of_controlled_points_cures"
VERDICT = "inference/test_verdict.py::"
BOUNDS = VERDICT + "test_a_line_of_bounds_never_cuts_the_box"
LINES = VERDICT + "test_every_remedy_is_a_line_that_a_campaign_file_takes"
AT_ONCE = VERDICT + "test_remedies_of_samplers_that_draw_at_once_are_lines_too"
CAUSES = "identification/test_causes.py::test_the_first_cause_is_what_was_done_to_the_data"
LACKING = CHECKS + "test_what_a_campaign_lacks_is_told_as_a_line"
FILES = "corpus/test_stated_clocks.py::"
LONG = CHECKS + "test_a_pasted_span_of_a_long_record_cures"
OF_A_RUN = "test_remedies.py::test_a_line_of_a_finding_is_taken"
PAGES = "test_remedies.py::test_a_line_of_a_page_is_taken"
JOINTS = "campaign/test_joint_tables.py::"
BOLTS = "identification/test_two_bolts.py::"
PASTED = {
    ("report/messages/campaign_faults.py", "modal_mass"): "study/test_base_and_force.py::"
    "test_both_drives_without_a_mass_are_refused_with_the_line_to_paste",
    ("assembly/reduce.py", "damping"): JOINTS
    + "test_damping_that_nothing_states_is_refused_and_the_remedy_cures",
    ("assembly/reduce.py", "holds_joints"): JOINTS
    + "test_joints_that_k_does_not_hold_are_refused_and_the_remedy_cures",
    ("campaign/joints.py", "holds_joints"): JOINTS
    + "test_joints_of_measured_modes_are_refused_and_the_modes_as_matrices_are_taken",
    ("campaign/tables.py", "relative_to_base"): "measurement/test_base_motion.py::"
    "test_the_remedy_of_a_velocity_on_a_base_is_taken",
    ("report/messages/campaign_faults.py", "delay"): DRIVEN,
    ("report/messages/record_faults.py", "delay"): CHECKS
    + "test_values_that_are_held_are_accounted_for_by_the_delay",
    ("report/messages/remedies.py", "periods"): CHECKS
    + "test_a_multisine_is_cut_to_whole_periods_beside_a_gap",
    ("report/messages/campaign_faults.py", "same_as"): JOINTS
    + "test_label_switching_is_refused_and_the_remedy_cures",
    ("identification/uncertain_shapes.py", "shapes"): "identification/test_uncertain_shapes.py::"
    "test_a_prior_of_a_factor_needs_uncertain_shapes_and_the_remedy_cures",
    ("identification/assembled.py", "compare_with"): BOLTS
    + "test_springs_of_one_joint_are_no_reference_and_the_remedy_is_taken",
    ("identification/assembled.py", "substeps"): BOLTS
    + "test_too_few_steps_for_the_residual_modes_are_refused_and_the_remedy_cures",
    ("identification/tied_joints.py", "laws"): "study/test_laws_at_joints.py::"
    "test_joints_without_a_law_are_refused_and_the_remedy_cures",
    ("campaign/settings.py", "laws"): "oscillator/test_bwbn.py::"
    "test_the_remedy_of_steady_motion_is_taken",
    ("identification/accuracy.py", "laws"): OF_A_RUN,
    ("identification/paper/step4.py", "prior"): VERDICT
    + "test_a_line_of_bounds_never_cuts_the_box",
    ("report/messages/residuals.py", "residuals"): OF_A_RUN,
    ("identification/selection.py", "fit_repeats"): "identification/test_selection.py::"
    "test_the_remedy_of_too_many_repeats_is_taken",
    ("report/messages/causes.py", "residuals"): CAUSES,
    ("report/messages/causes.py", "run"): CAUSES,
    ("inference/posterior/remedies.py", "{}"): BOUNDS,
    ("inference/posterior/verdict.py", "prior"): VERDICT + "test_the_bound_is_named_with_its_side",
    ("report/messages/clock_faults.py", "clock_ppm"): CHECKS + "test_a_pasted_clock_cures",
    ("report/messages/clock_faults.py", "delay"): DRIVEN,
    ("report/messages/controlled_faults.py", "conjugate"): POINTS,
    ("report/messages/controlled_faults.py", "jumps"): POINTS,
    ("report/messages/controlled_faults.py", "locked_phase"): POINTS,
    ("report/messages/controlled_faults.py", "phase_tolerance"): POINTS,
    ("report/messages/controlled_faults.py", "scale"): POINTS,
    ("report/messages/decay_faults.py", "lines_hz"): DECAYS,
    ("report/messages/decay_faults.py", "settle"): DECAYS,
    ("report/messages/decay_faults.py", "window_s"): DECAYS,
    ("report/messages/loop_faults.py", "laws"): LOOPS,
    ("report/messages/loop_faults.py", "delay"): LOOPS,
    ("report/messages/loop_faults.py", "load_cell"): LOOPS,
    ("report/messages/response_faults.py", "band"): CHECKS + "test_a_missing_band_is_pasted",
    ("report/messages/record_faults.py", "kind"): CHECKS
    + "test_a_curve_that_folds_is_told_its_kind",
    ("report/messages/record_faults.py", "gaps"): CHECKS
    + "test_lines_of_a_curve_that_are_lost_are_masked",
    ("report/messages/decay_faults.py", "band"): CHECKS
    + "test_a_band_too_narrow_for_the_record_is_widened",
    ("measurement/files/assemble.py", "scale"): CHECKS
    + "test_the_value_at_full_scale_is_told_as_a_line",
    ("measurement/files/assemble.py", "units"): LACKING,
    ("measurement/files/sampling.py", "channels"): LACKING,
    ("report/messages/reading.py", "channels"): LACKING,
    ("report/messages/reading.py", "fs"): LACKING,
    ("report/messages/reading.py", "span"): CHECKS + "test_a_pasted_part_of_a_huge_channel_is_read",
    ("report/messages/remedies.py", "exclude"): CHECKS
    + "test_every_line_pasted_for_spoilt_samples_cures",
    ("report/messages/remedies.py", "span"): CHECKS
    + "test_every_line_pasted_for_spoilt_samples_cures",
    ("report/messages/stages.py", "resample"): "identification/test_size.py::"
    "test_a_long_fit_proposes_a_rate_that_shortens_it",
    ("measurement/files/sampling.py", "resample"): FILES + "test_a_pasted_rate_cures",
    ("measurement/files/clocks.py", "resample"): CHECKS
    + "test_every_line_pasted_for_broken_times_cures",
    ("report/messages/reading.py", "sensitivity"): "campaign/test_volts_and_clocks.py::"
    "test_the_line_about_volts_cures",
    ("report/messages/laws.py", "laws"): "study/test_proposed_laws.py::"
    "test_the_law_of_the_readings_is_taken_where_none_is_stated",
    ("campaign/trial.py", "exclude"): DECAYS,
    ("report/messages/gain_faults.py", "scale"): CHECKS
    + "test_a_repeat_that_was_turned_over_is_cured_in_a_test_of_its_own",
    ("report/messages/reading.py", "units_are"): FILES + "test_a_pasted_word_on_units_cures",
    ("measurement/resampled.py", "resample"): FILES + "test_a_rate_beyond_what_was_measured",
    ("measurement/faults/responses.py", "conjugate"): CURVES,
    ("report/messages/response_faults.py", "kind"): POINTS,
    ("report/messages/response_faults.py", "level"): DRIVEN,
    ("report/messages/response_faults.py", "remove_mean"): DRIVEN,
    ("report/messages/response_faults.py", "scale"): LOOPS,
    ("report/messages/response_faults.py", "units"): CHECKS
    + "test_a_phase_in_degrees_keeps_the_units_of_other_channels",
    ("report/messages/convergence.py", "budget_s"): AT_ONCE,
    ("report/messages/convergence.py", "coordinates"): PAGES,
    ("report/messages/convergence.py", "num_chains"): AT_ONCE,
    ("report/messages/convergence.py", "num_warmup"): LINES,
    ("report/messages/convergence.py", "sampler"): LINES,
    ("report/messages/convergence.py", "substeps"): LINES,
    ("report/messages/identifiability.py", "laws"): PAGES,
    ("report/messages/model_adequacy.py", "laws"): PAGES,
    ("report/messages/model_adequacy.py", "model_error"): PAGES,
    ("report/messages/model_adequacy.py", "offsets"): PAGES,
    ("report/messages/remedies.py", "num_samples"): OF_A_RUN,
    ("report/messages/remedies.py", "sampler"): AT_ONCE,
    ("report/messages/words.py", "hold_out"): PAGES,
    ("verification/verify.py", "offsets"): OF_A_RUN,
}


def text_of(node: ast.AST) -> str:
    """Return a string in the source, with {} for its placeholders."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(text_of(part) for part in node.values)
    return "{}"


def strings_of(tree: ast.AST) -> list[str]:
    """Return the strings of a module, without docstrings and parts of other strings."""
    found, waiting = [], [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, TEXTS):
            found.append(text_of(node))  # The parts of the string are included.
            continue
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        docstring = (
            first if isinstance(first, ast.Expr) and isinstance(first.value, TEXTS) else None
        )
        waiting += (child for child in ast.iter_child_nodes(node) if child is not docstring)
    return found


def modules():
    """Yield the path within the package and the syntax tree of every file."""
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


@cache  # Every process that collects the tests needs the strings of the whole package.
def strings() -> tuple[tuple[str, list[str]], ...]:
    """Return the path within the package and the strings of every file."""
    return tuple((name, strings_of(tree)) for name, tree in modules())


def called_in(tree: ast.AST) -> set[str]:
    """Return the keys of the lines that the calls of a module propose."""
    found = set()
    for node in ast.walk(tree):
        name = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
        if name in CALLS:
            place = CALLS[name]
            found.add("prior" if place is None else text_of(node.args[place]))
    return found


def lines():
    """Return (file, key) of every remedy that is a line."""
    quoted = {(name, key) for name, texts in strings() for t in texts for key in LINE.findall(t)}
    called = {(name, key) for name, tree in modules() for key in called_in(tree)}
    return (quoted | called) - QUOTES


def commands():
    """Return (file, command, options) of every `jbw ...` that a string of the code names."""
    return {
        (name, command, options.strip())
        for name, texts in strings()
        for text in texts
        for command, options in COMMAND.findall(text)
    }


# Proposals of a sentence without backquotes: a key and a complete value; {} is a channel's role.
TEXT, MAPPING = r"\"[^\"{}]*\"|'[^'{}]*'", r"\{ (?:\w+|\{\}) = (?:\"[^\"{}.]*\"|-?\d[\d.]*) \}"
BARE = re.compile(rf"(?<![\w.])([a-z_]+) = ({TEXT}|true|{MAPPING})")
# Drafts are whole campaign files, which their tests load; oscillators' sentences name arguments.
NO_SENTENCES = (
    "report/messages/draft.py",
    "campaign/document.py",
    "campaign/asked.py",
    "rig/",
    "paper/",
)


def bare_lines():
    """Return (file, key, line) of every whole line that a sentence of the code has unquoted."""
    return {
        (name, key, f"{key} = {value}".replace("{}", "velocity"))
        for name, texts in strings()
        if not name.startswith(NO_SENTENCES)
        for text in texts
        for key, value in BARE.findall(re.sub(r"`[^`]*`", "", text))
    }
