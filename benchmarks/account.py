"""How is a command's time divided between tracing, lowering, compiling and the rest, by stage?

Every trace, lowering and compilation is recorded with its program, and the processor time with
every stage that the command names. Seconds of tracing, lowering and compiling are wall times of the
thread that does them, which are too long on a busy machine. No code compiled before is used.

    python benchmarks/account.py [--calls 7] [--json FILE] [--kept] [COMMAND ...]

The command is `demo` unless another is given. With --kept, compiled code is kept and used as the
command usually does. After the stages the programs that took longest are listed, and the processor
time of one evaluation of the log likelihood, in batches like those of the sampler.
"""

import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "trace",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lower",
    "/jax/core/compile/backend_compile_duration": "compile",
}
STAGES = {
    "stage": "", "trace, s": ".1f", "lower, s": ".1f", "compile, s": ".1f", "CPU, s": ".1f",
    "programs": "d",
}  # fmt: skip
PROGRAMS = {"program": "", "number": "d", "compile, s": ".1f"}
EVALUATION = {"evaluation": "", "min, CPU ms": ".2f", "median, CPU ms": ".2f"}
LONGEST = 12  # number of listed programs
POINTS = 64  # points of the log likelihood in a timed batch


class Account:
    """The record of a command's times, by stage; a stage begins where the command names it."""

    def __init__(self) -> None:
        self.stage = "imports"
        self.order = [self.stage]
        self.seconds: dict[str, Counter[str]] = defaultdict(Counter)
        self.compiled: Counter[str] = Counter()
        self.spent: Counter[str] = Counter()
        self.evaluation: tuple[Any, ...] | None = None
        self._since = 0.0

    def begin(self, stage: str) -> None:
        """End the present stage of a command and begin another."""
        now = time.process_time()
        self.seconds[self.stage]["CPU"] += now - self._since
        self.stage, self._since = stage, now
        if stage not in self.order:
            self.order.append(stage)

    def record(self, event: str, duration: float, **about: Any) -> None:
        """Record one event of JAX."""
        if (kind := EVENTS.get(event)) is None:
            return
        self.seconds[self.stage][kind] += duration
        if kind == "compile":
            name = str(about.get("fun_name", "unnamed"))
            self.compiled[name] += 1
            self.spent[name] += duration
            self.seconds[self.stage]["programs"] += 1

    def stages(self) -> list[tuple[Any, ...]]:
        """Return one row per stage, and a row with their sum."""
        rows = [(stage[:60], self.seconds[stage]) for stage in self.order]
        whole = sum((counts for _, counts in rows), Counter())
        kinds = "trace", "lower", "compile", "CPU"
        return [
            (name, *(float(counts[kind]) for kind in kinds), int(counts["programs"]))
            for name, counts in [*rows, ("all", whole)]
        ]

    def programs(self) -> list[tuple[Any, ...]]:
        """Return the programs that took longest to compile, with counts and seconds."""
        return [(name, self.compiled[name], s) for name, s in self.spent.most_common(LONGEST)]


def listen(account: Account) -> None:
    """Record a command's stages, JAX's compilations, and the first batch of a likelihood."""
    import jax

    from jbw.cli import progress
    from jbw.inference.samplers import amis

    jax.monitoring.register_event_duration_secs_listener(account.record)
    tell, at_points = progress.Teller.__call__, amis.at_points

    def told(teller: Any, stage: str) -> None:
        account.begin(str(stage))
        tell(teller, stage)

    def followed(function: Any, theta: Any, data: Any) -> Any:
        account.evaluation = function, theta, data
        return at_points(function, theta, data)

    progress.Teller.__call__ = told
    amis.at_points = followed


def evaluation(account: Account, calls: int) -> list[tuple[Any, ...]]:
    """Return the processor time of one evaluation of the last requested log likelihood."""
    import numpy as np

    from jbw.inference.lanes import at_points

    if account.evaluation is None:
        return []
    function, theta, data = account.evaluation
    points = {name: np.resize(np.asarray(x), POINTS) for name, x in theta.items()}
    at_points(function, points, data)  # The code is compiled by now, and caches are filled.
    spent = []
    for _ in range(calls):
        start = time.process_time()
        at_points(function, points, data)
        spent.append(1e3 * (time.process_time() - start) / POINTS)
    groups = len(data.labels)
    return [(f"log likelihood of {groups} groups", min(spent), float(np.median(spent)))]


def main(arguments: Sequence[str] | None = None) -> None:
    from timing import Table, options, show

    parser = options(__doc__, calls=7)
    parser.add_argument("--kept", action="store_true", help="use compiled code that was kept")
    parser.add_argument("command", nargs="*", default=["demo"], help="of jbw, with its arguments")
    chosen = parser.parse_args(arguments)
    file = chosen.json.absolute() if chosen.json else None
    account = Account()
    with tempfile.TemporaryDirectory() as folder:
        if not chosen.kept:
            os.environ["JAX_COMPILATION_CACHE_DIR"] = os.path.join(folder, "compiled")
        if chosen.command == ["demo"]:  # The demo writes into the folder where it runs.
            os.chdir(folder)
        run(account, chosen.command)
        tables = [
            Table(f"jbw {' '.join(chosen.command)}", STAGES, account.stages()),
            Table("Programs", PROGRAMS, account.programs()),
            Table("Evaluation", EVALUATION, evaluation(account, chosen.calls)),
        ]
        os.chdir("/")  # The temporary folder is about to be removed.
    show(tables, file=file)


def run(account: Account, command: Sequence[str]) -> None:
    """Run a command in this process, with its output on standard error."""
    from contextlib import redirect_stdout

    from jbw.cli import main as jbw

    listen(account)
    sys.argv = ["jbw", *command]
    try:
        with redirect_stdout(sys.stderr):
            jbw()
    except SystemExit as end:
        if end.code:
            sys.exit(f"jbw {' '.join(command)} ended with {end.code}.")
    account.begin("end")


if __name__ == "__main__":
    main()
