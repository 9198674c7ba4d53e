"""What does the standard sweep cost with diffrax, compared with C and with a newcomer's diffrax?

A 16-s sweep at 1024 Hz is solved from rest under a first-order hold; all contenders take turns in
one process. Machines are shared, so that only the ratios of the least times mean anything.

    python benchmarks/standard_sweep.py [--calls 31] [--json FILE]
"""

from collections.abc import Sequence

import jax.numpy as jnp
import yardstick
from problem import (
    FS,
    NUM,
    PAPER,
    TIME,
    U,
    exact_velocity,
    joint,
    newcomers_velocity,
    relative_error,
    rk4_velocity,
)
from timing import Table, Target, Times, compiled, options, show, take_turns, targets

import jbw

C_1, C_4 = "C RK4, 1 step a sample", "C RK4, 4 steps"
EXACT_1, EXACT_2 = "jbw, 1 step a sample", "jbw, 2 steps"
RK4, NAIVE = "diffrax, RK4, 1 step a sample", "diffrax as a newcomer writes it"
COLUMNS = {"solver": "", "error of v": ".1e", "min, ms": ".3f", "median, ms": ".3f"}
COLUMNS |= {"ns a sample": ".1f", "/ C, 1 step": ".2f", "/ C, 4 steps": ".2f"}


def contenders():
    u, t = jnp.asarray(U), jnp.asarray(TIME)

    def exact(substeps):
        return compiled(lambda p, u: jbw.simulate(p, u, FS, substeps=substeps).v, joint(), u)

    runs = {
        EXACT_1: exact(1),
        EXACT_2: exact(2),
        RK4: compiled(lambda p, u: rk4_velocity(p, u, FS), joint(), u),
        NAIVE: compiled(newcomers_velocity, joint(), t, u),
    }
    if yardstick.library() is None:
        return runs
    return {
        C_1: lambda: yardstick.rk4(PAPER, U, FS, 1),
        C_4: lambda: yardstick.rk4(PAPER, U, FS, 4),
        **runs,
    }


def ratio(times: dict[str, Times], over: str, under: str) -> float | None:
    """Return one contender's least time over another's; None where either is absent."""
    if over not in times or under not in times:
        return None
    return times[over].least / times[under].least


def tables(calls: int) -> list[Table]:
    runs, exact = contenders(), exact_velocity()
    errors = {name: relative_error(run(), exact) for name, run in runs.items()}
    times = take_turns(runs, calls)
    rows = [
        (
            name,
            errors[name],
            1e3 * t.least,
            1e3 * t.median,
            1e9 * t.least / NUM,
            ratio(times, name, C_1),
            ratio(times, name, C_4),
        )
        for name, t in times.items()
    ]
    rows += [(name, "no C compiler", *[None] * 5) for name in (C_1, C_4) if name not in times]
    same = f"jbw at error {errors[EXACT_1]:.0e} / C RK4 of 4 steps"
    naive = f"newcomer's diffrax at error {errors[NAIVE]:.0e} / jbw"
    entries = [
        Target(same, ratio(times, EXACT_1, C_4), 1.0, 0.6),
        Target("diffrax with one RK4 step / C RK4 of 1 step", ratio(times, RK4, C_1), 2.0, 1.5),
        Target(naive, ratio(times, NAIVE, EXACT_1), 10.0, 25.0, at_most=False),
    ]
    return [Table("The standard sweep", COLUMNS, rows), targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
