"""Shared by all tests: float64, jaxtyping shapes checked by beartype, the golden numbers.

Compiled code is kept in the user's cache folder, one a machine, as the command does it: most of the
tests' time is compiling. `JAX_ENABLE_COMPILATION_CACHE=0` turns that off.
"""

import gc
import json
import os
import platform
import time
from pathlib import Path

# Read when a worker imports NumPy: each has a core, and threads that wait for others turn idly.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import jax
import pytest
from shapes import check_shapes

if os.environ.get("JBW_CHECK_SHAPES") != "0":
    check_shapes()  # before any test file imports jbw
jax.config.update("jax_enable_x64", True)
# What JAX traces lives long, and looking through it for garbage takes a twentieth of the time.
gc.set_threshold(100_000, 20, 20)
from jbw.inference.compiled import forget_when_many  # noqa: E402
from jbw.run.session import keep_compiled  # noqa: E402

KEPT = keep_compiled(f"tests of {platform.node()}")
# Each test file compiles hundreds of small things anew, together as long as the few large ones.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# Tests of more than two seconds alone on an idle core, which the slow tier runs: of those that
# `pytest --durations=0` shows at that, all but the quickest case of each function.
LONG = frozenset((Path(__file__).parent / "long_tests.txt").read_text().splitlines())
# Files of minutes, longest first, so that no process works on one alone at the end.
FIRST = (
    "test_notebooks.py", "test_demo.py", "test_mixed_campaign.py", "test_resume.py",
    "test_documentation.py", "test_calibration.py", "test_rank_calibration.py",
    "test_sliders_campaign.py", "test_sequential.py", "test_amis.py", "test_outside_campaigns.py",
    "test_mixed_campaign_scores.py", "test_campaign_scores.py", "test_fleet_of_the_rig.py",
    "test_comparing.py", "test_linear_structure.py",
)  # fmt: skip
GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())


@pytest.fixture(scope="session")
def golden():
    return GOLDEN


@pytest.fixture(scope="module", autouse=True)
def _compiled_code_does_not_pile_up():
    """A process that runs out of mappings dies in the compiler, not in the test that filled it."""
    yield
    forget_when_many()


def pytest_sessionstart(session):
    """Forget compiled code that a fortnight did not make anew."""
    if not hasattr(session.config, "workerinput") and KEPT is not None:
        for entry in KEPT.glob("*"):
            if time.time() - entry.stat().st_mtime > 14 * 86400:
                entry.unlink(missing_ok=True)


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items):
    """Put long tests into the slow tier, whose warnings fail nothing, and long files first.

    Short chains and real records warn of what they are; what is asked of them is recovery.
    """
    items.sort(key=lambda item: FIRST.index(n) if (n := item.path.name) in FIRST else len(FIRST))
    for item in items:
        if item.nodeid in LONG and not item.get_closest_marker("release"):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("slow") or item.get_closest_marker("release"):
            # First in the list of marks, and so the first to give way to a test's own.
            item.add_marker(pytest.mark.filterwarnings("default"), append=False)
