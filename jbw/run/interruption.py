"""Ctrl-C and SIGTERM: stop where nothing is lost, and at once when asked twice."""

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED = 5  # exit code


class Interruption:
    """Whether a run was asked to stop, and whether it waits for a saving to do so."""

    def __init__(self) -> None:
        self.asked = False
        self._waiting = False

    def wait(self, waiting: bool) -> None:
        """Let a stop wait for the next saving, or not.

        Args:
            waiting: Whether chains are growing that the next saving will hold.
        """
        self._waiting = waiting

    def stop_if_asked(self) -> None:
        """Stop here, if it was asked for.

        Raises:
            KeyboardInterrupt: If it was.
        """
        if self.asked:
            raise KeyboardInterrupt

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if not self._waiting:
            raise KeyboardInterrupt

    @contextmanager
    def heard(self, farewell: Callable[[], str]) -> Iterator[None]:
        """Listen to Ctrl-C and SIGTERM.

        Python runs a handler only between two of its own instructions, which compiled chains may
        be far from. A thread therefore hears the signals as they come: it says at once that the
        first was heard, and ends the process at the second, which can tear no file.

        Args:
            farewell: What to say before the process ends.
        """
        if threading.current_thread() is not threading.main_thread():
            yield  # only the main thread may listen
            return
        heard, told = socket.socketpair()
        told.setblocking(False)
        before = {number: signal.signal(number, self._ask) for number in SIGNALS}
        wakeup = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, args=(heard, farewell), daemon=True).start()
        try:
            yield
        finally:
            signal.set_wakeup_fd(wakeup)
            for number, handler in before.items():
                signal.signal(number, handler)
            told.close()

    def _listen(self, heard: socket.socket, farewell: Callable[[], str]) -> None:
        count = 0
        while received := heard.recv(1):
            if received[0] not in {int(number) for number in SIGNALS}:
                continue
            count += 1
            if count > 1:
                _say(farewell())
                os._exit(INTERRUPTED)
            when = " when this chunk of draws is saved" if self._waiting else ""
            _say(f"Stopping{when}; again to leave at once.")
        heard.close()


def _say(sentence: str) -> None:
    sys.stderr.write(f"{sentence}\n")
    sys.stderr.flush()
