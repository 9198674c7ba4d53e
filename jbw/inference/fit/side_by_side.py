"""Several searches at once, whose points are evaluated together."""

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from threading import Lock

import numpy as np
from jaxtyping import Float

Evaluate = Callable[[Float[np.ndarray, "point parameter"]], Float[np.ndarray, "point value"]]


def side_by_side[Start, End](
    search: Callable[[Start, Evaluate], End], starts: Sequence[Start], evaluate: Evaluate
) -> list[End]:
    """Where searches from several starts end, in the order of the starts.

    Each runs in a thread of its own. Once all that still run wait for values, one call evaluates
    the points of all: together they fill the lanes that one search leaves empty. A search sees no
    other, so that it ends where it would alone. An error of one ends all.
    """
    if len(starts) == 1:
        return [search(starts[0], evaluate)]
    meeting = _Meeting(evaluate, len(starts))

    def run(start: Start) -> End:
        try:
            return search(start, meeting.values_at)
        finally:
            meeting.leave()

    with ThreadPoolExecutor(len(starts)) as threads:
        searches = [threads.submit(run, start) for start in starts]
        try:
            return [one_search.result() for one_search in searches]
        except BaseException:  # an interruption too must not wait for the others' ends
            meeting.close()
            raise


class _Meeting:
    """Points that running searches have asked for, and who waits for their values."""

    def __init__(self, evaluate: Evaluate, num_running: int) -> None:
        self._evaluate, self._num_running = evaluate, num_running
        self._asked: list[tuple[np.ndarray, Future[np.ndarray]]] = []
        self._is_closed, self._lock = False, Lock()

    def values_at(self, points: np.ndarray) -> np.ndarray:
        """Values at the points of one search, once all others wait too."""
        values: Future[np.ndarray] = Future()
        with self._lock:
            if self._is_closed:
                raise CancelledError
            self._asked.append((points, values))
            asked = self._complete()
        self._answer(asked)
        return values.result()

    def leave(self) -> None:
        """One search has ended: the others wait for it no more."""
        with self._lock:
            self._num_running -= 1
            asked = self._complete()
        self._answer(asked)

    def close(self) -> None:
        """End the searches that run, each where it asks for values."""
        with self._lock:
            self._is_closed = True
            asked, self._asked = self._asked, []
        for _, values in asked:
            values.cancel()

    def _complete(self) -> list[tuple[np.ndarray, Future[np.ndarray]]]:
        """What all running searches ask for, where all of them ask."""
        if len(self._asked) < self._num_running:
            return []
        asked, self._asked = self._asked, []
        return asked

    def _answer(self, asked: list[tuple[np.ndarray, Future[np.ndarray]]]) -> None:
        if not asked:
            return
        try:
            rows = self._evaluate(np.concatenate([points for points, _ in asked]))
        except BaseException as cause:
            for _, values in asked:
                values.set_exception(cause)
            return
        ends = np.cumsum([len(points) for points, _ in asked])
        for (_, values), own in zip(asked, np.split(rows, ends[:-1]), strict=True):
            values.set_result(own)
