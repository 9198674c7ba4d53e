"""Shared by all tests: float64, jaxtyping shapes checked by beartype, the golden numbers.

Compiled code is kept in the user's cache folder, as the command does it: most of the tests' time is
compiling. `JAX_ENABLE_COMPILATION_CACHE=0` turns that off.
"""

import gc
import json
import os
import time
from pathlib import Path

# Read when a worker imports NumPy: each has a core, and threads that wait for others turn idly.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import hypothesis
import jax
import pytest
from durations import LONG, measured, pytest_addoption, pytest_configure, split  # noqa: F401
from finished import forget
from shapes import check_shapes

if os.environ.get("JBW_CHECK_SHAPES") != "0":
    check_shapes()  # before any test file imports jbw
jax.config.update("jax_enable_x64", True)
# The same examples in every run, so that a commit is judged by what it changes; the release tier
# draws new ones (`pytest --hypothesis-profile=new`).
hypothesis.settings.register_profile("repeated", derandomize=True, database=None)
hypothesis.settings.register_profile("new", derandomize=False)
hypothesis.settings.load_profile("repeated")
# What JAX traces lives long, and looking through it for garbage takes a twentieth of the time.
gc.set_threshold(100_000, 20, 20)
from jbw.errors import Attempts  # noqa: E402
from jbw.inference.compiled import forget_when_large, forget_when_many  # noqa: E402
from jbw.run.session import keep_compiled  # noqa: E402

KEPT = keep_compiled("tests")
# Each test file compiles hundreds of small things anew, together as long as the few large ones.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

MOST_MEMORY = 3e9  # [bytes]
FORTNIGHT = 14 * 86400  # [s]
GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())


@pytest.fixture(scope="session")
def golden():
    return GOLDEN


LEFT_OUT = []  # sentences on parts of results that failed since the test began


def attempted(self, what, build, otherwise, make=Attempts.make):
    """What `Attempts.make` returns; a sentence that it says is noted."""
    before = len(self.said)
    made = make(self, what, build, otherwise)
    LEFT_OUT.extend(self.said[before:])
    return made


Attempts.make = attempted


@pytest.fixture(autouse=True)
def _nothing_is_left_out(request):
    """Fail a test whose campaign is meant to work and loses a part of its result.

    `jbw.identify` says such a part in a sentence and goes on, so that a fault of jbw would hide
    there. A test of what cannot be made has the mark `leaves_out`.
    """
    LEFT_OUT.clear()
    yield
    if not request.node.get_closest_marker("leaves_out"):
        assert not LEFT_OUT


@pytest.fixture(scope="module", autouse=True)
def _compiled_code_does_not_pile_up():
    """A process that runs out of mappings dies in the compiler, not in the test that filled it.

    What the next file shares comes back from the disk, where compiled code is kept.
    """
    yield
    forget_when_large(MOST_MEMORY)
    forget_when_many()


def pytest_sessionstart(session):
    """Forget compiled code and finished runs that a fortnight did not make anew."""
    if hasattr(session.config, "workerinput"):
        return
    forget(FORTNIGHT)
    # Of other processors and versions too, which a cache of several machines gathers.
    for entry in KEPT.parent.glob("tests*/*") if KEPT is not None else ():
        if time.time() - entry.stat().st_mtime > FORTNIGHT:
            entry.unlink(missing_ok=True)


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items):
    """Put long tests into the slow tier, whose warnings fail nothing.

    Short chains and real records warn of what they are; what is asked of them is recovery.
    """
    table = measured()
    for item in items:
        path, name = split(item.nodeid)
        is_long = table.get(path, {}).get(name, 0.0) > LONG
        if is_long and not item.get_closest_marker("release"):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("slow") or item.get_closest_marker("release"):
            # First in the list of marks, and so the first to give way to a test's own.
            item.add_marker(pytest.mark.filterwarnings("default"), append=False)
