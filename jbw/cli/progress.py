"""What commands that compute share: JAX, and how far they are, a line a stage and one a chain."""

import logging
import os
import platform
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import numpy as np
import platformdirs
from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from jbw.cli.printing import duration

LOOK_S = 1.0  # between two looks at the chains at least, on a terminal
PLAIN_S = 15.0  # between two lines where there is none
FEWEST = 8  # draws of a chain from where on their effective number is estimated


class Teller:
    """Tells stages, called with a sentence, and chains under way, on a console."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live: Live | None = None
        self._started = perf_counter()
        self._told = self._started
        self._said: set[str] = set()

    def __call__(self, stage: str) -> None:
        """Print one sentence with the seconds since the start."""
        self.clear()
        self._console.print(Text(f"[{perf_counter() - self._started:5.1f} s] {stage}"))

    def chains(self, name: str, so_far: Any) -> None:
        """Tell how far the chains of a posterior are, no oftener than anybody can read.

        `so_far` is what is known of them, a `jbw.inference.samplers.chunked_run.SoFar`.
        """
        last = so_far.done >= so_far.total
        every = LOOK_S if self._console.is_terminal else PLAIN_S
        due = perf_counter() - self._told > every
        if not (due or (last and name in self._said)):
            return
        self._told = perf_counter()
        self._said.add(name)
        if not self._console.is_terminal:
            self(chain_sentence(name, so_far))
        elif last:
            self.clear()
        else:
            if self._live is None:
                self._live = Live(console=self._console, auto_refresh=False, transient=True)
                self._live.start()
            self._live.update(chain_table(name, so_far), refresh=True)

    def clear(self) -> None:
        """Take the live lines away."""
        if self._live is not None:
            self._live.stop()
            self._live = None


def prepare_jax() -> None:
    """Two host devices, so that chains run side by side, float64, and compiled code kept.

    Before JAX starts. What was compiled stays in the user's cache folder, one a machine, for the
    code holds instructions of its processor; JAX_ENABLE_COMPILATION_CACHE=0 turns that off.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "host_platform_device_count" not in flags and (os.cpu_count() or 1) > 1:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count=2".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        kept = platformdirs.user_cache_path("jbw") / platform.node()
        jax.config.update("jax_compilation_cache_dir", str(kept))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    logging.getLogger("jax").setLevel(logging.ERROR)


@contextmanager
def computing() -> Iterator[Teller]:
    """JAX set up, and a teller on stderr; warnings go to the same place. Import JAX within."""
    prepare_jax()
    say = Teller(Console(stderr=True, highlight=False))

    def show(message: Any, *_: Any) -> None:
        say(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.showwarning = show  # restored with the filters
        try:
            yield say
        finally:
            say.clear()


def chain_table(name: str, so_far: Any) -> Table:
    """One line a chain: steps, draws, effective draws so far, divergences, time left."""
    table = Table.grid(padding=(0, 2))
    sizes, left = effective(so_far.draws), duration(so_far.left_s)
    for i, size in enumerate([None] if sizes is None else sizes):
        row = [
            name if size is None else f"{name} {i + 1}",
            ProgressBar(total=so_far.total, completed=so_far.done, width=24),
            f"{so_far.done}/{so_far.total}",
            "warming up" if size is None else f"{size:.0f} effective draws",
        ]
        if so_far.divergences is not None:
            row.append(f"{int(so_far.divergences[i])} divergences")
        table.add_row(*row, f"{left} left")
    return table


def chain_sentence(name: str, so_far: Any) -> str:
    """The same in one line for all chains."""
    parts = [f"{name}: {so_far.done} of {so_far.total} steps"]
    sizes = effective(so_far.draws)
    if sizes is None:
        parts.append("warming up")
    else:
        parts.append(f"{' '.join(f'{size:.0f}' for size in sizes)} effective draws")
        if so_far.divergences is not None:
            parts.append(f"{int(np.sum(so_far.divergences))} divergences")
    if so_far.done < so_far.total:
        parts.append(f"{duration(so_far.left_s)} left")
    return ", ".join(parts)


def effective(draws: dict[str, np.ndarray]) -> list[float] | None:
    """Effective draws of every chain so far, of the parameter that has fewest; None before any."""
    from jbw.inference.posterior.summary import diagnose

    if not draws or next(iter(draws.values())).shape[1] < FEWEST:
        return None
    rows = [[diagnose(chain[None])["ess_bulk"] for chain in values] for values in draws.values()]
    return [float(ess) for ess in np.min(np.nan_to_num(rows), axis=0)]
