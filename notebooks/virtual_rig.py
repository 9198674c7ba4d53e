"""What the notebooks share: the records of a small campaign, and the run that identifies it.

Both are made by the notebook that asks first and kept in a temporary folder; set JBW_NOTEBOOKS to
keep them elsewhere.
"""

import logging
import os
import platform
import tempfile
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

# Two host devices let two chains run side by side; JAX reads this once, when it starts.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=2")

import jax

import jbw
from jbw import rig

TESTS = (
    *("noise_0p005V", "noise_0p05V"),
    *("tone_5p00Hz", "tone_5p50Hz", "tone_6p00Hz", "tone_6p50Hz", "tone_6p75Hz"),
    *("sweep_0p05V", "sweep_0p10V", "sweep_0p20V"),
    *("loop_0p05V", "loop_0p10V"),
)
NOISE_SECONDS = 128.0
LASER_NOISE = 1e-3
"""A poor laser [m/s], so that the uncertainty can be seen in a figure."""
NUM_SAMPLES = 250
TRUTH = {
    **{name: float(getattr(rig.TRUTH, name)) for name in ("omega_n", "zeta", "alpha")},
    **{name: float(getattr(rig.TRUTH, name)) for name in ("delta", "gamma")},
    "gain": rig.LABORATORY.gain,
}
"""What the rig was built with: drawn into the figures, never used in a fit."""


def folder() -> Path:
    """Where the notebooks keep what they share."""
    chosen = os.environ.get("JBW_NOTEBOOKS")
    return Path(chosen) if chosen else Path(tempfile.gettempdir()) / "jbw_notebooks"


def campaign() -> jbw.Campaign:
    """The campaign, measured on the first call and read from its files."""
    path = folder() / "campaign" / "campaign.toml"
    if not path.exists():
        rig.write(measure(TESTS), path.parent)
    return jbw.load_campaign(path)


def measure(tests: Iterable[str], **conditions: Any) -> rig.RigCampaign:
    """Tests of the rig's laboratory, four repeats each, with shorter noise and a poor laser."""
    short = [
        replace(plan, excitation=replace(plan.excitation, duration=NOISE_SECONDS))
        if isinstance(plan.excitation, rig.Noise)
        else plan
        for plan in rig.LABORATORY.plans
    ]
    preset = replace(rig.LABORATORY, name="notebooks", plans=tuple(short))
    given = {"repeats": 4, "noise_std": LASER_NOISE, **conditions}
    measured = rig.measure(preset, tests=tests, **given)
    return replace(measured, settings={**measured.settings, "num_samples": NUM_SAMPLES})


def run() -> jbw.Study:
    """The identification, made on the first call: one to three minutes."""
    place = folder() / "run"
    if not (place / "summary.json").exists():
        jbw.identify(campaign(), truth=TRUTH).save(place)
    return jbw.load_study(place, campaign())


def print_laws(record: Mapping[str, Any]) -> None:
    """Print a line a law, the best first: errors of tests fitted, left out, and of other targets.

    `left out` is of runs within the fitted amplitudes, `highest` of the highest level as the lower
    ones predict it, `kinds` of the worst kind of test as the other kinds predict it.
    """
    print(f"{'law':20s} {'fit':>7s} {'left out':>8s} {'highest':>8s} {'kinds':>8s}  weight  answer")
    rows = sorted(record["laws"].items(), key=lambda row: -(row[1]["weight"] or 0.0))
    for name, row in rows:
        kinds = max((row.get("error_across") or {}).values(), default=None)
        errors = (row["error"], row["error_left_out"], row["error_highest"], kinds)
        shown = " ".join(f"{_per_cent(error):>8s}" for error in errors)
        weight = "-" if row["weight"] is None else f"{row['weight']:.2f}"
        print(f"{name:19s} {shown} {weight:>7s}  {row['answer']}")


def print_tests(summary: Mapping[str, Any]) -> None:
    """Print a line a test: errors of three models, and what the 99 % bands of the joint hold."""
    print(f"{'test':34s} {'use':9s} {'linear':>8s} {'cubic':>8s} {'joint':>8s}  bands hold")
    rows = sorted(summary["predictions"].items(), key=lambda row: not row[1]["fitted"])
    for name, row in rows:
        errors = (row.get(key) for key in ("nrmse_linear", "nrmse_cubic", "nrmse"))
        shown = " ".join(f"{_per_cent(error):>8s}" for error in errors)
        held = "withheld" if row.get("withheld") else _per_cent(row.get("coverage"))
        print(f"{name:34s} {'fitted' if row['fitted'] else 'held out':9s} {shown} {held:>11s}")


def print_answers(summary: Mapping[str, Any]) -> None:
    """Print the three answers of the verdict, and what each question asks."""
    questions = {
        "sampling": "did the sampling converge",
        "law": "does the law follow the data",
        "knowledge": "do the data know the parameters",
    }
    answers = summary["verdict"]["answers"]
    for name, question in questions.items():
        print(f"{question}: {answers.get(name, {}).get('status', 'not assessed')}")


def _per_cent(ratio: float | None) -> str:
    return "-" if ratio is None else f"{100 * ratio:.3g} %"


def prepare() -> None:
    """Float64, compiled code kept for the next notebook, and no chatter."""
    jbw.enable_x64()
    jax.config.update("jax_compilation_cache_dir", str(folder() / f"compiled-{platform.node()}"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    logging.getLogger("jax").setLevel(logging.ERROR)
    for known in (
        "IProgress not found",  # the bars of tqdm
        "The .* hann window resolves",  # notebook 1 is about this very thing
        "The damping .* is finer than the lines",
        ".* The coherence with the input is",  # away from the mode the laser hears itself
    ):
        warnings.filterwarnings("ignore", message=known)


prepare()
