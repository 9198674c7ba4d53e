"""Ctrl-C while compiled code runs: heard at once, obeyed at the second time."""

import signal
import subprocess
import sys
import threading

import pytest

from jbw.run.checkpoints import Interruption

# The key derivation stands for compiled chains: it lets other threads run and knows no signals.
LONG = """
import hashlib
from jbw.run.checkpoints import Interruption
interruption = Interruption()
interruption.waits = True
with interruption.heard(lambda: "Saved."):
    print("working", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
"""


@pytest.mark.fault(41)
def test_the_second_signal_ends_a_process_that_hears_none():
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", LONG], **pipes) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "working\n"
        process.send_signal(signal.SIGINT)
        assert "again to stop at once" in process.stderr.readline()
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.stderr.readline() == "Saved.\n"
        assert process.wait(timeout=20) == 5


def test_the_handlers_of_before_are_put_back():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with Interruption().heard(lambda: ""):
        assert signal.getsignal(signal.SIGINT) not in before
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_another_thread_runs_without_listening():
    def run():
        with Interruption().heard(lambda: ""):
            done.append(True)

    done = []
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert done == [True]
