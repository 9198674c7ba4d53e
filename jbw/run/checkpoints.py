"""Checkpoints of Markov chains in two alternating files, so that a stop or crash loses no draws."""

import hashlib
import io
import os
import signal
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from time import perf_counter
from types import FrameType
from typing import Any

import numpy as np

from jbw.report.messages import run as messages
from jbw.run.files import write_whole

MAGIC = b"jbw-checkpoint-1"
EVERY_S = 5.0  # shortest time between two checkpoints [s]
COST = 0.02  # largest fraction of the run time that may be spent on writing checkpoints
SIGNALS = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED = 5  # exit code of an interrupted command
Watch = Callable[[str, Any], None]


class Interruption:
    """A request to stop a run, and whether the run first waits for its next checkpoint."""

    def __init__(self) -> None:
        self.asked = False
        self.waits = False  # Chains are being drawn, and the next checkpoint will contain them.

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if not self.waits:
            raise KeyboardInterrupt

    @contextmanager
    def heard(self, farewell: Callable[[], str]) -> Iterator[None]:
        """Handle Ctrl-C and SIGTERM in a `with` block; print a last message before the exit.

        Python runs a handler only between two of its own instructions, which compiled chains may
        not reach for a long time. A separate thread therefore receives the signals at once: it
        prints a confirmation of the first one, and ends the process at the second one, which can
        damage no file.
        """
        if threading.current_thread() is not threading.main_thread():
            yield  # Only the main thread may handle signals.
            return
        reader, writer = socket.socketpair()
        writer.setblocking(False)
        before = {number: signal.signal(number, self._ask) for number in SIGNALS}
        wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, args=(reader, farewell), daemon=True).start()
        try:
            yield
        finally:
            signal.set_wakeup_fd(wakeup)
            for number, handler in before.items():
                signal.signal(number, handler)
            writer.close()

    def _listen(self, heard: socket.socket, farewell: Callable[[], str]) -> None:
        count = 0
        while received := heard.recv(1):
            if received[0] not in SIGNALS:
                continue
            count += 1
            if count > 1:
                print(farewell(), file=sys.stderr, flush=True)
                os._exit(INTERRUPTED)
            print(messages.stopping(waits=self.waits), file=sys.stderr, flush=True)
        heard.close()


def pack(number: int, arrays: Mapping[str, np.ndarray]) -> bytes:
    """Encode a checkpoint as bytes: a line with the hash of the rest, then number and arrays."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    content = b"%d\n" % number + stream.getvalue()
    return b"%s %s\n" % (MAGIC, hashlib.sha256(content).hexdigest().encode()) + content


def unpack(content: bytes) -> tuple[int, dict[str, np.ndarray]] | None:
    """Decode a checkpoint's number and arrays from its bytes; return None for damaged bytes."""
    head, _, rest = content.partition(b"\n")
    if head != b"%s %s" % (MAGIC, hashlib.sha256(rest).hexdigest().encode()):
        return None
    number, _, arrays = rest.partition(b"\n")
    with np.load(io.BytesIO(arrays), allow_pickle=False) as stored:
        return int(number), {name: stored[name] for name in stored.files}


class Checkpoint:
    """The checkpoints of one posterior's chains, in two files that are written alternately.

    An interruption may ask to stop after a saving. After every chunk of steps `watch` is called
    with the posterior's name and the progress of the chains.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        interruption: Interruption,
        watch: Watch = lambda name, so_far: None,
    ) -> None:
        self._name, self._watch = name, watch
        self._files = [folder / f"{name}.{i}.checkpoint" for i in (0, 1)]
        self._interruption = interruption
        self._number = 0
        self._saved, self._cost = perf_counter(), 0.0

    def load(self) -> dict[str, np.ndarray] | None:
        """Return the arrays of the last intact checkpoint, or None; warn about damaged files."""
        contents = [path.read_bytes() for path in self._files if path.exists()]
        intact = sorted(filter(None, map(unpack, contents)), key=itemgetter(0))
        if len(intact) < len(contents):
            warnings.warn(
                messages.damaged_checkpoint(
                    self._name, str(self._files[0].parent), has_earlier=bool(intact)
                ),
                stacklevel=2,
            )
        if not intact:
            return None
        number, arrays = intact[-1]
        self._number = number + 1
        return arrays

    def grown(self, so_far: Any) -> None:
        """Report how many draws the chains have."""
        self._watch(self._name, so_far)

    def due(self) -> bool:
        """Return whether to save a checkpoint now: on a stop request, or after enough time."""
        self._interruption.waits = True
        if self._interruption.asked:
            return True
        return perf_counter() - self._saved > max(EVERY_S, self._cost / COST)

    def save(self, arrays: Mapping[str, np.ndarray], *, last: bool) -> None:
        """Replace the older of the two checkpoints; then stop the run if that was requested.

        Raises:
            KeyboardInterrupt: The run was asked to stop.
        """
        clock = perf_counter()
        write_whole(self._files[self._number % 2], pack(self._number, arrays))
        self._number += 1
        self._saved = perf_counter()
        self._cost = self._saved - clock
        self._interruption.waits = not last
        if self._interruption.asked:
            raise KeyboardInterrupt
