"""Shared by all tests: float64, jaxtyping shapes checked by beartype, the golden numbers."""

import gc
import json
import os
from pathlib import Path

import jax
import pytest
from shapes import check_shapes

if os.environ.get("JBW_CHECK_SHAPES") != "0":
    check_shapes()  # before any test file imports jbw
jax.config.update("jax_enable_x64", True)

# Linux lets a process map 65,530 pieces of memory; each compiled function holds a dozen.
MAPS, MANY_MAPS = Path("/proc/self/maps"), 40_000
# Tests of more than two seconds alone on an idle core, which the slow tier runs: of those that
# `pytest --durations=0` shows at that, all but the quickest case of each function.
LONG = frozenset((Path(__file__).parent / "long_tests.txt").read_text().splitlines())
GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())


@pytest.fixture(scope="session")
def golden():
    return GOLDEN


@pytest.fixture(scope="module", autouse=True)
def _compiled_code_does_not_pile_up():
    """A process that runs out of mappings dies in the compiler, not in the test that filled it."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MANY_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items):
    """Put long tests into the slow tier, whose warnings fail nothing.

    Short chains and real records warn of what they are; what is asked of them is recovery.
    """
    for item in items:
        if item.nodeid in LONG:
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("slow"):
            # First in the list of marks, and so the first to give way to a test's own.
            item.add_marker(pytest.mark.filterwarnings("default"), append=False)
