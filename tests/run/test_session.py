"""A process of jbw's own: threads of linear algebra, which only a fresh process shows."""

import os
import subprocess
import sys

import pytest

from jbw.run.session import THREADS

SHOWN = """
from jbw.run.session import prepare_process
prepare_process()
from threadpoolctl import threadpool_info
print({one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"})
"""


@pytest.mark.parametrize(("named", "found"), [({}, "{1}"), ({"OPENBLAS_NUM_THREADS": "2"}, "{2}")])
def test_linear_algebra_has_one_thread_unless_the_environment_names_more(named, found):
    """A thread that waits for another turns idly, which beside a busy process takes seconds."""
    if (os.cpu_count() or 1) < 2:
        pytest.skip("one core has one thread")
    without = {name: value for name, value in os.environ.items() if name not in THREADS}
    shown = subprocess.run(
        [sys.executable, "-c", SHOWN], env=without | named, capture_output=True, text=True
    )
    assert shown.stdout.strip() == found, shown.stderr
