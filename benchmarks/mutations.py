"""Does a test notice each of these small changes of physics, statistics, verdict and results?

    python benchmarks/mutations.py [WORD ...] [--calls 99] [--json FILE]

Every mutation is made alone in a copy of the package, and the tests beside it run against the copy.
Ends with 1 where one survives, where its tests fail without it, or where the code that it changes
is no longer there. Words choose mutations by what they say, `--calls` the first so many of them.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FAILED = "fail"
LIMIT_S = 900  # of a mutation: a test that does not end has noticed nothing


class Mutation(NamedTuple):
    """One change, and what must notice it."""

    path: str  # below jbw
    old: str  # occurs once
    new: str
    tests: str  # files or test ids, below tests


FEW = "watch/test_few_readings.py"
SLIP = "oscillator/test_gross_slip.py"
SCALE = "study/test_time_scale.py"
VERDICT = "inference/test_verdict.py"
PROFILES = "inference/test_profiles.py"
COURSE = "observables/test_course_of_decays.py"
SEAL = "run/test_integrity.py"
NESTED = "oscillator/test_nested_loops.py"
EXCITATION = "oscillator/test_excitation.py"
LOOPS = "oscillator/test_loops_in_slip.py"
IWAN5 = "oscillator/test_iwan5.py"
HOTELLING = "watch/test_hotelling.py"
COMPARISON = "inference/test_comparison.py"
INFORMATION = "inference/test_information.py"
EXPORTED = "study/test_exported_slip.py"
ELSEWHERE = "study/test_exports_elsewhere.py"
SPECTRA = "measurement/test_spectra.py"
READINGS = "observables/test_decay_readings.py observables/test_course_of_decays.py"
DUPLICATES = "campaign/test_duplicates.py"
PATH = "oscillator/laws/stretch_path.py"
RECORDERS = "corpus/test_corpus.py measurement/test_recorded_facts.py"
FINAL = "study/test_final.py"
KINDS = "observables/test_across_kinds.py"
STARTS = "identification/test_first_fit.py"
LOST = "measurement/test_lost_samples.py"
RECORDER = "measurement/recorders"
MUTATIONS = (
    Mutation("watch/statement.py", "(1 / num + 1 / reference.num)", "(1 / num)", FEW),
    Mutation(
        "watch/statement.py",
        "residual_square.min() * (1 + 1 / reference.num)",
        "residual_square.min()",
        FEW,
    ),
    Mutation("watch/statement.py", "** (-(freedom + 1) / 2)", "** (-freedom / 2)", FEW),
    Mutation("watch/statement.py", "slopes, reference.num - 1", "slopes, reference.num", FEW),
    Mutation(
        "watch/change_point.py",
        "both = np.array([np.log(hazard), np.log1p(-hazard)])",
        "both = np.array([np.log(hazard), 0.0])",
        FEW,
    ),
    Mutation(
        "watch/change_point.py",
        "np.concatenate([change, np.log1p(-hazard) + joint], axis=-1)",
        "np.concatenate([change, joint], axis=-1)",
        FEW,
    ),
    Mutation(
        "watch/change_point.py",
        "kappa / (kappa + 1))[..., None, None] * square",
        "(kappa + 1) / kappa)[..., None, None] * square",
        FEW,
    ),
    Mutation("inference/posterior/verdict.py", "if lower != 0.0:", "if lower > 0.0:", VERDICT),
    Mutation(
        "inference/posterior/verdict.py",
        "float(np.min(array_stats.bfmi(",
        "float(np.mean(array_stats.bfmi(",
        VERDICT,
    ),
    Mutation(
        "inference/posterior/verdict.py",
        "draws[name] > upper - edge",
        "draws[name] > upper + edge",
        VERDICT,
    ),
    Mutation(
        "verification/bands.py",
        "/ (2 * np.linalg.norm(measured))",
        "/ np.linalg.norm(measured)",
        "study/test_band_widths.py",
    ),
    Mutation(
        "population/prediction.py",
        "gains[k][s] for k, s in zip(which, place, strict=True)",
        "gains[k][s] for k, s in zip(which, place[::-1], strict=True)",
        "population/test_new_units.py",
    ),
    Mutation("identification/accuracy.py", "MOST_BEYOND = 1.5", "MOST_BEYOND = 15.0", VERDICT),
    Mutation(
        "measurement/channels.py",
        "np.sqrt(np.mean(squares))",
        "np.mean(squares)",
        VERDICT,
    ),
    Mutation("identification/accuracy.py", "CLOSE = 0.05", "CLOSE = 0.5", VERDICT),
    Mutation("inference/fit/costly_fit.py", "and np.all(np.isfinite(part(s, 1)))", "", PROFILES),
    Mutation(
        "inference/fit/costly_fit.py",
        "end.num_refused = len(refused)",
        "end.num_refused = 0",
        PROFILES,
    ),
    Mutation(
        "inference/fit/profiles.py",
        "return float(s[j])\n    share",
        "return float(s[j - 1])\n    share",
        PROFILES,
    ),
    Mutation("inference/thresholds.py", "PROB = 0.99", "PROB = 0.95", PROFILES),
    Mutation("verification/in_time.py", "FORGOTTEN = 7.0", "FORGOTTEN = 3.0", SCALE),
    Mutation(
        "verification/in_time.py", "forgotten = FORGOTTEN / rate", "forgotten = FORGOTTEN", SCALE
    ),
    Mutation(
        "observables/decay.py", "BEGINNING / (rate * data.step_s)", "BEGINNING / data.step_s", SCALE
    ),
    Mutation(
        "verification/places.py",
        'name.replace("/", "\\N{DIVISION SLASH}")',
        "name",
        "study/test_any_name.py",
    ),
    Mutation("observables/decay_envelopes.py", "LEAST_RATE = 0.1", "LEAST_RATE = 1e-9", COURSE),
    Mutation("observables/decay_envelopes.py", "SPARE = 1.3", "SPARE = 0.9", COURSE),
    Mutation("run/integrity.py", "hashes.get(name) != digest", "not hashes.get(name)", SEAL),
    Mutation(PATH, "_POLE = 0.5", "_POLE = 2.0", SLIP),
    Mutation(PATH, "_DEEP = 40.0", "_DEEP = 4.0", SLIP),
    Mutation(PATH, "- 0.5 * m * x**2", "", SLIP),
    Mutation(PATH, "moment(more) - moment(less)", "moment(more) + moment(less)", SLIP),
    Mutation(PATH, "zero - jax.vmap", "zero + jax.vmap", SLIP),
    Mutation(
        "oscillator/deepening.py",
        "if not np.sum(deeper.guesses) < np.sum(response.guesses):",
        "if True:",
        NESTED,
    ),
    Mutation(
        "oscillator/checks.py",
        "if np.any(share > 1.0):",
        "if np.any(share > 2.0):",
        "oscillator/test_admission.py",
    ),
    # -- physics
    Mutation(
        "oscillator/excitation.py",
        "0.5 * (end_hz - start_hz) / duration",
        "(end_hz - start_hz) / duration",
        EXCITATION,
    ),
    Mutation(
        "oscillator/excitation.py", "jnp.sqrt(2.0 * num_lines)", "jnp.sqrt(num_lines)", EXCITATION
    ),
    Mutation(
        "oscillator/conventions.py",
        "scale = alpha ** (1.0 - other.n)",
        "scale = alpha ** (other.n - 1.0)",
        "oscillator/test_conventions.py",
    ),
    Mutation(
        "oscillator/conventions.py",
        "scale = other.beta * other.mass ** (other.nu - 1.0)",
        "scale = other.beta",
        "oscillator/test_conventions.py",
    ),
    Mutation(
        "oscillator/laws/relaxation.py",
        "jnp.exp(-b * x) + 2.0 * g * w",
        "jnp.exp(-b * x) + g * w",
        LOOPS,
    ),
    Mutation("oscillator/laws/relaxation.py", "(x - w) / b - moment", "x / b - moment", LOOPS),
    Mutation("oscillator/laws/jenkins.py", "part * (1.0 - part)", "part * (1.0 + part)", LOOPS),
    Mutation(
        "oscillator/laws/masing_loop.py",
        "peak * tip - 2.0 * law.lag_integral(peak)",
        "peak * tip - law.lag_integral(peak)",
        LOOPS,
    ),
    Mutation(
        "oscillator/laws/gap_series.py", "energy / (jnp.pi * peak**2)", "energy / peak**2", LOOPS
    ),
    Mutation(
        "oscillator/steady/backbone.py",
        "loop.damping / (2.0 * omega_squared)",
        "loop.damping / omega_squared",
        LOOPS,
    ),
    Mutation(
        "oscillator/laws/dampers.py",
        "self.c * jnp.asarray(y_peak) * omega**2\n        return Loop",
        "self.c * jnp.asarray(y_peak) * omega\n        return Loop",
        LOOPS,
    ),
    Mutation("oscillator/laws/iwan5.py", "(3.0 * theta - 1.0)", "(3.0 * theta + 1.0)", IWAN5),
    Mutation("oscillator/laws/iwan5.py", "_WITHIN = 1.0 - 1e-14", "_WITHIN = 1.0", IWAN5),
    Mutation(
        "oscillator/hold.py",
        "-15.0 * rise + 7.0 * turn - bend",
        "-15.0 * rise + 8.0 * turn - bend",
        "oscillator/test_solver.py",
    ),
    Mutation(
        "oscillator/hold.py",
        "== 0.5 * num, 0.0, theta",
        "== 0.25 * num, 0.0, theta",
        "observables/test_captured_constants.py",
    ),
    # -- statistics
    Mutation(
        "watch/hotelling.py",
        "p * (num - 1) * (num + 1) / (num * (num - p))",
        "p * (num - 1) / (num - p)",
        HOTELLING,
    ),
    Mutation("watch/hotelling.py", "change**2 * num / (num + 1)", "change**2", HOTELLING),
    Mutation("watch/hotelling.py", "np.maximum(values, 0.0)", "np.abs(values)", HOTELLING),
    Mutation("lab/samplers.py", "np.hypot(*errors)", "np.sum(errors)", COMPARISON),
    Mutation("lab/samplers.py", "value < GOOD_R_HAT", "value < 9.0", COMPARISON),
    Mutation(
        "inference/fit/profiles.py",
        "(upper - lower) / math.sqrt(12)",
        "(upper - lower) / 12",
        INFORMATION,
    ),
    Mutation(
        "inference/fit/profiles.py",
        "rows.T / np.sqrt(1 + values)",
        "rows.T / np.sqrt(values)",
        INFORMATION,
    ),
    # -- the verdict
    Mutation("inference/posterior/verdict.py", "R_HAT = 1.01", "R_HAT = 1.1", VERDICT),
    Mutation("inference/posterior/verdict.py", "ESS = 400.0", "ESS = 40.0", VERDICT),
    Mutation("inference/posterior/verdict.py", "BFMI = 0.3", "BFMI = 0.03", VERDICT),
    Mutation("inference/posterior/verdict.py", "GOOD_KHAT = 0.7", "GOOD_KHAT = 7.0", VERDICT),
    Mutation(
        "inference/posterior/verdict.py",
        "CHI_SQUARE = (0.2, 5.0)",
        "CHI_SQUARE = (0.2, 50.0)",
        VERDICT,
    ),
    Mutation(
        "inference/posterior/verdict.py",
        "np.ptp(values, axis=1) == 0",
        "np.ptp(values, axis=0) == 0",
        VERDICT,
    ),
    # -- what other programs are handed
    Mutation(
        "export/joint_parts.py",
        "dashpot = 2.0 * mass * theta",
        "dashpot = mass * theta",
        f"{ELSEWHERE}::test_spring_and_dashpot_are_those_of_the_linear_oscillator",
    ),
    Mutation(
        "export/joint_parts.py",
        "return slow.k * at + tip, slow.k * at + virgin",
        "return slow.k * at + virgin, slow.k * at + tip",
        f"{ELSEWHERE}::test_tables_hold_the_tips_of_steady_loops",
    ),
    Mutation(
        "export/exports/templates/matlab/laws/bouc_wen_nu.m", "k * log(s)", "log(s)", EXPORTED
    ),
    Mutation(
        "export/exports/templates/c/laws/bouc_wen_nu.c",
        "-expm1(nu * log_z) - pole",
        "-expm1(nu * log_z) + pole",
        EXPORTED,
    ),
    Mutation(
        "export/exports/program.py",
        'unit.replace("^", "").replace(" ", ".")',
        'unit.replace("^", "")',
        f"{ELSEWHERE}::test_modelica_writes_products_by_dots_and_powers_without_a_sign",
    ),
    # -- what is read off records
    Mutation("measurement/spectra.py", "/ (averages - 1)", "/ averages", SPECTRA),
    Mutation(
        "measurement/spectra.py",
        "np.exp(2j * np.pi * freq * delay)",
        "np.exp(-2j * np.pi * freq * delay)",
        SPECTRA,
    ),
    Mutation(
        "measurement/demodulation.py",
        "damping = -slope.real / step_s / omega",
        "damping = -slope.real / step_s / (2 * np.pi * centre_hz)",
        READINGS,
    ),
    Mutation(
        "measurement/demodulation.py", "is_reading = (damping > 0) & (", "is_reading = (", READINGS
    ),
    Mutation(
        "measurement/files/wav.py",
        "2.0 ** (8 * samples.dtype.itemsize - 1)",
        "2.0 ** (8 * samples.dtype.itemsize)",
        "measurement/test_files.py",
    ),
    Mutation(
        "measurement/files/wav.py",
        "zero = 128.0 if",
        "zero = 0.0 if",
        "measurement/test_files.py",
    ),
    Mutation(
        "measurement/harmonics.py",
        "(self.drift > DRIFT_LIMIT) & (",
        "(self.drift > DRIFT_LIMIT) | (",
        "measurement/test_harmonics.py",
    ),
    # -- the campaign
    Mutation(
        "campaign/duplicates.py",
        "shorter = min(last - first, end - begin)",
        "shorter = max(last - first, end - begin)",
        DUPLICATES,
    ),
    Mutation(
        "campaign/duplicates.py",
        "return low < high and bool(tones)",
        "return low < high",
        DUPLICATES,
    ),
    Mutation(
        "campaign/together.py",
        "and low.response_rms > high.response_rms",
        "",
        "campaign/test_levels.py",
    ),
    Mutation("campaign/together.py", "APART = 1.5 ", "APART = 0.5 ", "campaign/test_levels.py"),
    Mutation("campaign/gains.py", "1 / mass", "mass", "campaign/test_drive_key.py"),
    Mutation("units.py", '"in/s^2": INCH', '"in/s^2": 1.0', "test_units.py"),
    # -- recorders
    Mutation(f"{RECORDER}/facts.py", "return 1 / increment if", "return increment if", RECORDERS),
    Mutation(f"{RECORDER}/facts.py", '"khz": 1e3', '"khz": 1.0', RECORDERS),
    Mutation(f"{RECORDER}/facts.py", '"us": 1e-6, "\u00b5s"', '"us": 1e-3, "\u00b5s"', RECORDERS),
    Mutation(f"{RECORDER}/flat_channels.py", "count != size", "count > size", RECORDERS),
    Mutation(f"{RECORDER}/labview_lvm.py", "0.5 * 10.0 ** (", "10.0 ** (", RECORDERS),
    Mutation(
        f"{RECORDER}/labview_lvm.py", "is_one_header and declared > 0", "declared > 0", RECORDERS
    ),
    Mutation(
        f"{RECORDER}/matlab_structs.py", "len(texts) == len(series)", "len(texts) > 0", RECORDERS
    ),
    Mutation(
        f"{RECORDER}/oscilloscopes.py", "number_in(numbers[0])", "number_in(numbers[1])", RECORDERS
    ),
    Mutation(f"{RECORDER}/picoscope.py", '"Tstart")', '"Tinterval")', RECORDERS),
    Mutation(
        f"{RECORDER}/python_tables.py",
        "0 if item.shape[0] == len(names) else 1",
        "1 if item.shape[0] == len(names) else 0",
        RECORDERS,
    ),
    Mutation(
        f"{RECORDER}/python_tables.py",
        "{**siblings, **item.attributes}",
        "{**item.attributes, **siblings}",
        RECORDERS,
    ),
    Mutation(
        f"{RECORDER}/siemens_testlab.py",
        "(0.0 if math.isnan(start) else start) + increment",
        "increment",
        RECORDERS,
    ),
    Mutation(f"{RECORDER}/siemens_testlab.py", "count not in (size, 0)", "count > size", RECORDERS),
    Mutation(
        f"{RECORDER}/dewesoft.py",
        'rate_of(1 / number_at(root, "Sample_rate"))',
        'rate_of(number_at(root, "Sample_rate"))',
        RECORDERS,
    ),
    Mutation(f"{RECORDER}/dewesoft.py", "start_s=float(time[0])", "start_s=0.0", RECORDERS),
    Mutation(
        f"{RECORDER}/ni_tdms.py",
        'if not (timed and is_time(n.rpartition(".")[2]))',
        "if x is not None",
        RECORDERS,
    ),
    Mutation("measurement/checks/channels.py", "away > FAR * (high - low)", "away > 0.0", LOST),
    Mutation("measurement/checks/channels.py", "2 * len(others) < len(x)", "not len(others)", LOST),
    # -- held-out answers, each kind of test from the others, and where a fit begins
    Mutation("study/finishing.py", "return min(held, final", "return max(held, final", FINAL),
    Mutation("study/finishing.py", 'ASKED["law"]', 'ASKED["sampling"]', FINAL),
    Mutation("study/finishing.py", 'if not row["fitted"]', 'if row["fitted"]', FINAL),
    Mutation("study/finishing.py", 'keep(f"final_{name}")', "keep(name)", FINAL),
    Mutation(
        "study/finishing.py",
        'held.record["steps"][held.record["main"]]',
        'final.record["steps"][final.record["main"]]',
        FINAL,
    ),
    Mutation("identification/leaving_out.py", "if not x < WIDER", "if x < WIDER", KINDS),
    Mutation(
        "identification/across_kinds.py",
        "np.diag(fit.covariance) / np.diag(best.covariance)",
        "np.diag(best.covariance) / np.diag(fit.covariance)",
        KINDS,
    ),
    Mutation(
        "identification/across_kinds.py",
        "rest = without_kind(kind, data)",
        "rest = data",
        KINDS,
    ),
    Mutation("identification/across_kinds.py", "if len(kinds) < 2:", "if len(kinds) < 3:", KINDS),
    Mutation(
        "identification/across_kinds.py",
        "error.append(rms([",
        "error.append(max([",
        KINDS,
    ),
    Mutation(
        "identification/first_fit.py", "if ends[0].at_bound else ends", "if False else ends", STARTS
    ),
    Mutation(
        "campaign/gains.py",
        "if by_mass is None or FED.keys().isdisjoint(drives):",
        "if True:",
        "campaign/test_drive_key.py",
    ),
)


def survives(mutation: Mutation) -> str:
    """Why a mutation was not noticed; empty where it was."""
    if ended := sound(mutation.tests):
        return f"without it its tests {ended}"
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name)
        for part in ("jbw", "tests"):
            shutil.copytree(
                ROOT / part, copy / part
            )  # with compiled code, which the change outdates
        shutil.copy(ROOT / "pyproject.toml", copy)
        changed = copy / "jbw" / mutation.path
        text = changed.read_text(encoding="utf-8")
        if text.count(mutation.old) != 1:
            return f"the code occurs {text.count(mutation.old)} times"
        changed.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        ended = tested(copy, mutation.tests)
        return "" if ended == FAILED else f"its tests {ended or 'pass'}"


@cache
def sound(tests: str) -> str:
    """How tests end on the package as it is; empty where they pass."""
    return tested(ROOT, tests)


def tested(folder: Path, tests: str) -> str:
    """How tests end on the package of a folder; empty where they pass."""
    known = os.environ | {"PYTHONPATH": str(folder)}
    command = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-p", "no:cacheprovider"]
    command += [f"tests/{each}" for each in tests.split()]
    try:
        ended = subprocess.run(command, cwd=folder, env=known, timeout=LIMIT_S, capture_output=True)
    except subprocess.TimeoutExpired:
        return f"did not end in {LIMIT_S} s"
    return {0: "", 1: FAILED}.get(ended.returncode, f"ended with {ended.returncode}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Try every mutation that is chosen; 1 where one survives."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", help="parts of what a mutation says")
    parser.add_argument("--calls", type=int, default=len(MUTATIONS), help="mutations at most")
    parser.add_argument("--json", type=Path, help="file to write the results to")
    chosen = parser.parse_args(arguments)
    tried = {}
    for one in MUTATIONS:
        if len(tried) < chosen.calls and (
            not chosen.words or any(word in " ".join(one) for word in chosen.words)
        ):
            tried[f"{one.path}: {one.old} -> {one.new}"] = reason = survives(one)
            print(list(tried)[-1], f"SURVIVES, {reason}" if reason else "noticed", flush=True)
    left = sum(map(bool, tried.values()))
    print(f"{len(tried) - left} of {len(tried)} mutations are noticed.")
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(tried, indent=1), encoding="utf-8")
    return int(left > 0)


if __name__ == "__main__":
    sys.exit(main())
