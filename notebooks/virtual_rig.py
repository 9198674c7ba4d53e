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
    """Print a line a law, the best first, with what it misses of tests fitted and left out."""
    print("law                     fit  left out  weight  answer")
    rows = sorted(record["laws"].items(), key=lambda row: -(row[1]["weight"] or 0.0))
    for name, row in rows:
        errors = [row["error"], row["error_left_out"]]
        shown = ["     -" if error is None else f"{error:6.2%}" for error in errors]
        weight = "   -" if row["weight"] is None else f"{row['weight']:.2f}"
        print(f"{name:20s} {shown[0]:>6s} {shown[1]:>9s} {weight:>7s}  {row['answer']}")


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
