"""What the notebooks share: the records of a small campaign, and the run that identifies it.

Both are made by the notebook that asks first and kept in a temporary folder; set JBW_NOTEBOOKS to
keep them elsewhere.
"""

import logging
import os
import platform
import tempfile
import warnings
from pathlib import Path

# Two host devices let two chains run side by side; JAX reads this once, when it starts.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=2")

import jax
import xarray as xr

import jbw
from jbw import rig
from jbw.report.result import read_result

TESTS = (
    *("noise_0p005V", "noise_0p05V"),
    *("tone_5p00Hz", "tone_5p50Hz", "tone_6p00Hz", "tone_6p50Hz", "tone_6p75Hz"),
    *("sweep_0p05V", "sweep_0p10V", "sweep_0p20V"),
    *("loop_0p05V", "loop_0p10V"),
)
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
    """The campaign of four repeats a test, measured on the first call and read from its files."""
    path = folder() / "campaign" / "campaign.toml"
    if not path.exists():
        rig.write(rig.measure(tests=TESTS, repeats=4), path.parent)
    return jbw.load_campaign(path)


def run() -> xr.DataTree:
    """The identification's result, made on the first call: one to three minutes."""
    place = folder() / "run"
    if not (place / "summary.json").exists():
        jbw.identify(campaign(), truth=TRUTH).save(place)
    return read_result(place)[1]


def prepare() -> None:
    """Float64, compiled code kept for the next notebook, and no chatter."""
    jbw.enable_x64()
    jax.config.update("jax_compilation_cache_dir", str(folder() / f"compiled-{platform.node()}"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    logging.getLogger("jax").setLevel(logging.ERROR)
    # Notebook 1 is about this very thing.
    warnings.filterwarnings("ignore", message="The .* hann window resolves")


prepare()
