"""Settings of all tests: float64, jaxtyping shapes checked by beartype, the golden numbers.

Compiled code is kept in the user's cache folder, as by the command: compiling takes most of the
tests' time. `JAX_ENABLE_COMPILATION_CACHE=0` turns that off.
"""

import gc
import json
import os
import time
from pathlib import Path

# It is read when a worker imports NumPy: each has one core, and waiting threads would spin.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import hypothesis
import jax
import pytest
from compiling import forget_when_large
from durations import LONG, measured, pytest_addoption, pytest_configure, split  # noqa: F401
from finished import forget
from shapes import check_shapes

if os.environ.get("JBW_CHECK_SHAPES") != "0":
    check_shapes()  # This must precede any import of jbw by a test file.
jax.config.update("jax_enable_x64", True)
# Examples are the same in every run, so that a commit is judged by its changes; the release tier
# draws new ones (`pytest --hypothesis-profile=new`).
hypothesis.settings.register_profile("repeated", derandomize=True, database=None)
hypothesis.settings.register_profile("new", derandomize=False)
hypothesis.settings.load_profile("repeated")
# The objects that JAX traces live long; searching them for garbage takes 5 % of the time.
gc.set_threshold(100_000, 20, 20)
from jbw.errors import Attempts  # noqa: E402
from jbw.inference.compiled import forget_when_many  # noqa: E402
from jbw.run.session import keep_compiled  # noqa: E402

KEPT = keep_compiled("tests")
# Each test file compiles hundreds of small programs, which together take as long as the large ones.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

MOST_MEMORY = 3e9  # [bytes]
FORTNIGHT = 14 * 86400  # [s]
GOLDEN = json.loads((Path(__file__).parent / "golden.json").read_text())


@pytest.fixture(scope="session")
def golden():
    return GOLDEN


LEFT_OUT = []  # sentences on parts of results that failed since the test began


def attempted(self, what, build, otherwise, make=Attempts.make):
    """Return the result of `Attempts.make`, and record any sentence that it reports."""
    before = len(self.said)
    made = make(self, what, build, otherwise)
    LEFT_OUT.extend(self.said[before:])
    return made


Attempts.make = attempted


@pytest.fixture(autouse=True)
def _nothing_is_left_out(request):
    """Fail a test whose campaign should work but loses a part of its result.

    `jbw.identify` reports such a part in a sentence and continues, so that an error of jbw would
    stay hidden. Tests of parts that cannot be computed have the mark `leaves_out`.
    """
    LEFT_OUT.clear()
    yield
    if not request.node.get_closest_marker("leaves_out"):
        assert not LEFT_OUT


@pytest.fixture(scope="module", autouse=True)
def _compiled_code_does_not_pile_up():
    """Forget compiled code after each file, before a process exhausts its memory mappings.

    Programs that the next file shares are read from the disk, where compiled code is kept.
    """
    yield
    forget_when_large(MOST_MEMORY)
    forget_when_many()


def pytest_sessionstart(session):
    """Remove compiled code and finished runs that no session used within a fortnight."""
    if hasattr(session.config, "workerinput"):
        return
    forget(FORTNIGHT)
    # This includes code for other processors and versions, which a cache of several machines
    # collects.
    for entry in KEPT.parent.glob("tests*/*") if KEPT is not None else ():
        if time.time() - entry.stat().st_mtime > FORTNIGHT:
            entry.unlink(missing_ok=True)


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items):
    """Put long tests into the slow tier, whose warnings fail no test.

    Short chains and real records cause warnings; these tests check recovery.
    """
    table = measured()
    for item in items:
        path, name = split(item.nodeid)
        is_long = table.get(path, {}).get(name, 0.0) > LONG
        if is_long and not item.get_closest_marker("release"):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("slow") or item.get_closest_marker("release"):
            # It comes first in the list of marks, so that a test's own marks take precedence.
            item.add_marker(pytest.mark.filterwarnings("default"), append=False)
