"""Set-up of commands that compute: JAX, and progress messages for each stage and chain.

Events within a stage arrive as messages of the logger `jbw.progress`.
"""

import logging
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from jbw.cli.printing import duration
from jbw.memory import address_space
from jbw.report.messages import stages
from jbw.report.messages.run import KEPT
from jbw.run.session import RESERVED
from jbw.run.session import prepare_process as prepare_process

if TYPE_CHECKING:
    from jbw.study.store import Job

RESULT_ONLY = ("out", "json_")  # options that have no effect on the results
LOOK_S = 1.0  # shortest time between two updates of the chains on a terminal [s]
PLAIN_S = 10.0  # time between two reports on the chains if stderr is not a terminal [s]
# The current stage is printed if nothing was printed for this time [s] plus one BEAT_S.
SILENT_S = 4.0
BEAT_S = 0.5  # time between two checks whether something was printed [s]
POINTS = "jbw.progress.points"  # logger of the number of model evaluations
STARTING = "Loading numerical libraries"
STEPS = {
    "joint_": "joint posterior", "decay_": "posterior of free decays", "third_order_": "Step 3",
    "opening_": "Step 4",
}  # fmt: skip
WAYS = {"amis": "weighed points", "ridge": "along the ridge,", "valley": "along the valley,",
        "wide": "wider prior bounds,"}  # fmt: skip
# number of effective draws that a verdict requires, as in jbw.inference.posterior.verdict
ESS = 400.0
FEWEST = 8  # smallest number of draws of a chain for which an effective number is estimated


class Teller:
    """A printer of progress on a console: the stages of a command, and its running chains."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._rewrites = console.is_terminal and not console.is_dumb_terminal
        self._live: Live | None = None
        # the table of the chains' progress, on terminal lines that the next update overwrites
        self._chains: Table | None = None
        self._lock = threading.RLock()  # a lock, because `beat` runs in a separate thread
        self._started = perf_counter()
        self._told = self._started
        self._said: set[str] = set()
        self._stage, self._since, self._within, self._count = "", self._started, "", 0

    def __call__(self, stage: str) -> None:
        """Print the name of the stage that begins now, after the seconds since the start."""
        self._stage, self._since, self._within, self._count = stage, perf_counter(), "", 0
        self.remark(stage)

    def within(self, what: str) -> None:
        """Store the current activity within the stage; it is printed if it takes long."""
        self._within = what

    def count(self, number: int) -> None:
        """Count evaluations of the model within the stage."""
        self._count += number

    def remark(self, sentence: str) -> None:
        """Print a sentence that does not begin a stage."""
        with self._lock:
            self.clear()
            self._told = perf_counter()
            self._print(self._line(sentence))

    def beat(self) -> None:
        """Print the current stage and its duration if nothing was printed for five seconds.

        On a terminal the line is overwritten; elsewhere each line is new.
        """
        with self._lock:
            now = perf_counter()
            if not self._stage or now - self._told <= SILENT_S:
                return
            what = f"{self._stage}: {self._within}" if self._within else self._stage
            lasts = f"... {what}, for {duration(round(now - self._since))} so far"
            line = self._line(stages.evaluated(lasts, self._count) if self._count else lasts)
            if self._rewrites:
                self._show(Group(*filter(None, (self._chains, line))))
            else:
                self._told = now
                self._print(line)

    def _print(self, line: Text) -> None:
        self._console.print(line, soft_wrap=not self._rewrites)

    def _line(self, sentence: str) -> Text:
        return Text(f"[{perf_counter() - self._started:5.1f} s] {sentence}")

    def _show(self, lines: RenderableType) -> None:
        """Replace the overwritten lines on the terminal by new ones."""
        if self._live is None:
            self._live = Live(
                console=self._console, auto_refresh=False, transient=True, redirect_stdout=False
            )
            self._live.start()
        self._live.update(lines, refresh=True)

    def chains(self, name: str, so_far: Any) -> None:
        """Print the progress of a posterior's chains, not more often than one can read.

        `so_far` is the state of the chains, a `jbw.inference.samplers.chunked_run.SoFar`.
        """
        last = so_far.done >= so_far.total
        every = LOOK_S if self._rewrites else PLAIN_S
        with self._lock:
            due = perf_counter() - self._told > every
            if not (due or (last and name in self._said)):
                return
            self._told = perf_counter()
            self._said.add(name)
            if not self._rewrites:
                self._print(self._line(chain_sentence(name, so_far)))
            elif last:
                self.clear()
            else:
                self._chains = chain_table(name, so_far)
                self._show(self._chains)

    def clear(self) -> None:
        """Remove the overwritten lines from the terminal."""
        with self._lock:
            if self._live is not None:
                self._live.stop()
                self._live = self._chains = None


class _Within(logging.Handler):
    """A log handler that passes messages of the logger `jbw.progress` on as current activity."""

    def __init__(self, say: Teller) -> None:
        super().__init__(logging.INFO)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        """Store a log message as the current activity, or count evaluations of the model."""
        if record.name == POINTS:
            self._say.count(int(record.getMessage()))
        else:
            self._say.within(record.getMessage())


@contextmanager
def telling(first: str = "") -> Iterator[Teller]:
    """Yield a printer of progress on stderr; it also shows warnings and reports long computations.

    `first` is printed at once, before anything is imported.
    """
    say = Teller(Console(stderr=True, highlight=False))
    if first:
        say(first)

    def show(message: Any, *_: Any) -> None:
        say.remark(f"warning: {message}")

    done = threading.Event()

    def beat() -> None:
        while not done.wait(BEAT_S):
            say.beat()

    beating = threading.Thread(target=beat, daemon=True)
    under_way, heard = logging.getLogger("jbw.progress"), _Within(say)
    before = under_way.level, under_way.propagate
    under_way.setLevel(logging.INFO)
    under_way.propagate = False
    under_way.addHandler(heard)
    with warnings.catch_warnings():
        warnings.showwarning = show  # `catch_warnings` restores the original function at the end.
        beating.start()
        try:
            yield say
        finally:
            done.set()
            beating.join()
            say.clear()
            under_way.removeHandler(heard)
            under_way.level, under_way.propagate = before


@contextmanager
def computing() -> Iterator[Teller]:
    """Set up JAX and yield a progress printer; import what needs JAX inside the `with` block."""
    with telling(STARTING) as say:
        if (limit := address_space()) < RESERVED:
            say.remark(stages.little_address_space(limit / 2**30, RESERVED / 2**30))
        prepare_process()
        yield say


@contextmanager
def working(say: Teller, folder: Path) -> "Iterator[Job]":
    """Yield the job of a command; an interruption keeps the partial results and says so."""
    from jbw.study.store import claimed

    context = click.get_current_context()
    asked = {name: value for name, value in context.params.items() if name not in RESULT_ONLY}
    with claimed(folder, command=context.info_name, **asked) as job:
        try:
            yield job
        except KeyboardInterrupt:
            if job.num_kept:
                say.remark(KEPT)
            raise


def called(name: str) -> str:
    """Return the displayed name of a posterior that is sampled, given the name of its draws."""
    base, _, round_number = name.rpartition("_") if name[-1:].isdigit() else (name, "", "0")
    step = next((prefix for prefix in STEPS if f"{base}_".startswith(prefix)), base)
    how = f"{base}_".removeprefix(step).strip("_").replace("_", " ")
    for word, plain in WAYS.items():
        how = how.replace(word, plain)
    words = ", ".join(filter(None, (STEPS.get(step, step), how)))
    if round_number == "0":
        return words
    return stages.later_round(words, int(round_number) + 1)


def chain_table(name: str, so_far: Any) -> Table:
    """Return a table line per chain: steps, draws, effective draws, divergences, remaining time."""
    table = Table.grid(padding=(0, 2))
    table.title, table.title_justify = called(name), "left"
    sizes = effective(so_far.draws)
    groups = "group" if so_far.in_rounds else "chain"
    for i, size in enumerate([None] if sizes is None else sizes):
        row = [
            "" if size is None else f"{groups} {i + 1}",
            ProgressBar(total=so_far.total, completed=so_far.done, width=24),
            f"round {so_far.done}" if so_far.in_rounds else f"{so_far.done}/{so_far.total}",
            "warming up" if size is None else f"{size:.0f} effective draws",
        ]
        if so_far.divergences is not None:
            row.append(f"{int(so_far.divergences[i])} divergences")
        if so_far.left_s is not None:
            row.append(f"{duration(so_far.left_s)} left")
        table.add_row(*row)
    return table


def chain_sentence(name: str, so_far: Any) -> str:
    """Return one line on all chains: steps, effective draws, divergences, remaining time."""
    sizes = effective(so_far.draws)
    if so_far.in_rounds and sizes is not None:
        # Effective draws of groups of points add up, because the groups are independent of each
        # other.
        worth = stages.effective(sum(sizes), ESS)
        return f"{called(name)}: round {so_far.done} of {so_far.total} at most, {worth}"
    parts = [f"{called(name)}: {so_far.done} of {so_far.total} steps"]
    if sizes is None:
        parts.append("warming up")
    else:
        parts.append(f"{' '.join(f'{size:.0f}' for size in sizes)} effective draws")
        if so_far.divergences is not None:
            parts.append(f"{int(np.sum(so_far.divergences))} divergences")
    if so_far.left_s is not None and so_far.done < so_far.total:
        parts.append(f"{duration(so_far.left_s)} left")
    return ", ".join(parts)


def effective(draws: dict[str, np.ndarray]) -> list[float] | None:
    """Return each chain's smallest effective number of draws; None if there are too few draws."""
    from jbw.inference.posterior.summary import diagnose

    if not draws or next(iter(draws.values())).shape[1] < FEWEST:
        return None
    rows = [[diagnose(chain[None])["ess_bulk"] for chain in values] for values in draws.values()]
    return [float(ess) for ess in np.min(np.nan_to_num(rows), axis=0)]
