"""What does each solver cost at a given error?

The standard sweep is solved by C, numba, scipy, SUNDIALS, diffrax and jbw at several accuracies.
The error is the relative L2 error of the velocity against C RK4 with 1024 steps per sample, which
is itself compared with the event-located solution of tests/golden.json.

    python benchmarks/solvers.py [--calls 31] [--json FILE] [--plot FILE.svg]
"""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import yardstick
from problem import (
    FS,
    NUM,
    PAPER,
    TIME,
    U,
    exact_velocity,
    indexed_tsit5_velocity,
    joint,
    newcomers_velocity,
    reference_line,
    relative_error,
)
from scipy.integrate import solve_ivp
from timing import Table, compiled, options, show, take_turns

import jbw

COLUMNS = {"solver": "", "setting": "", "error of v": ".1e", "min, ms": ".3f"}
COLUMNS |= {"median, ms": ".3f", "/ C, 1 step": ".3g"}
TOLERANCES = (1e-4, 1e-6, 1e-8)
# Calls of these take seconds, far longer than others, so that their ratios need no exact timing.
SLOW_CALLS = 3
# Okabe and Ito's colours, which colour-blind readers can distinguish
COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#7F7F7F")
MARKERS = "osD^vP*X<"
# A label is above the first point of its line unless another position is given.
BESIDE = (-1, (8, -4))
PLACES = {"SUNDIALS CVODE": (-1, (-112, -4)), "scipy RK45": BESIDE, "scipy DOP853": BESIDE}
PLACES |= {"C RK4": BESIDE, "jbw": BESIDE, "diffrax Tsit5, input by index": BESIDE}


class Solver(NamedTuple):
    """One row of the table: a solver with one setting; `run` is None if it is absent."""

    family: str
    setting: str
    run: Callable[[], Any] | None
    slow: bool = False

    @property
    def name(self) -> str:
        """The family and the setting of the solver."""
        return f"{self.family}, {self.setting}"


def steps(number: int) -> str:
    return "1 step a sample" if number == 1 else f"{number} steps"


def c_rk4() -> list[Solver]:
    def run(m):
        return lambda: yardstick.rk4(PAPER, U, FS, m)

    present = yardstick.library() is not None
    return [Solver("C RK4", steps(m), run(m) if present else None) for m in (1, 2, 4, 8, 16)]


def exact_step() -> list[Solver]:
    def run(m):
        return compiled(lambda p, u: jbw.simulate(p, u, FS, substeps=m).v, joint(), jnp.asarray(U))

    return [Solver("jbw", steps(m), run(m)) for m in (1, 2, 4, 8)]


def diffrax_tsit5() -> list[Solver]:
    t, u = jnp.asarray(TIME), jnp.asarray(U)

    def indexed(m):
        return compiled(lambda p, u: indexed_tsit5_velocity(p, u, FS, m), joint(), u)

    def interpolated(m):
        return compiled(lambda p, t, u: newcomers_velocity(p, t, u, m), joint(), t, u)

    return [
        *[Solver("diffrax Tsit5, input by index", steps(m), indexed(m)) for m in (1, 2, 4)],
        *[Solver("diffrax Tsit5, a newcomer's", steps(m), interpolated(m)) for m in (1, 2)],
    ]


def numba_rk4() -> list[Solver]:
    """Return the C loop, written in Python and compiled by numba, as a solver."""
    if find_spec("numba") is None:
        return [Solver("numba RK4", steps(1), None)]
    import numba

    @numba.njit
    def rate(u, y, v, z, omega_n, zeta, alpha, delta, gamma):
        dv = u - 2 * zeta * omega_n * v - (omega_n**2 - alpha) * y - z
        return v, dv, alpha * v - gamma * abs(v) * z - delta * v * abs(z)

    @numba.njit
    def rk4(p, u, fs, m):
        response, h = np.zeros(u.size), 1.0 / (fs * m)
        y = v = z = 0.0
        for i in range(u.size - 1):
            slope = (u[i + 1] - u[i]) / m
            for j in range(m):
                start = u[i] + slope * j
                a = rate(start, y, v, z, *p)
                w = start + 0.5 * slope
                b = rate(w, y + 0.5 * h * a[0], v + 0.5 * h * a[1], z + 0.5 * h * a[2], *p)
                c = rate(w, y + 0.5 * h * b[0], v + 0.5 * h * b[1], z + 0.5 * h * b[2], *p)
                d = rate(start + slope, y + h * c[0], v + h * c[1], z + h * c[2], *p)
                y += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
                v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
                z += h / 6 * (a[2] + 2 * b[2] + 2 * c[2] + d[2])
            response[i + 1] = v
        return response

    def run(m):
        return lambda: rk4(PAPER, U, FS, m)

    return [Solver("numba RK4", steps(m), run(m)) for m in (1, 4)]


def field(t: float, x: np.ndarray) -> tuple[float, float, float]:
    """Return the right-hand side in Python, with an interpolated input."""
    omega_n, zeta, alpha, delta, gamma = PAPER
    y, v, z = x.tolist()
    dv = np.interp(t, TIME, U) - 2 * zeta * omega_n * v - (omega_n**2 - alpha) * y - z
    return v, dv, alpha * v - gamma * abs(v) * z - delta * v * abs(z)


def scipy_solvers() -> list[Solver]:
    def run(method, rtol):
        rest = np.zeros(3)

        def velocity():
            span, atol = (0.0, TIME[-1]), 1e-3 * rtol
            found = solve_ivp(field, span, rest, method, t_eval=TIME, rtol=rtol, atol=atol)
            return found.y[1]

        return velocity

    return [
        Solver(f"scipy {method}", f"rtol {rtol:.0e}", run(method, rtol), slow=True)
        for method in ("RK45", "DOP853", "LSODA")
        for rtol in TOLERANCES
    ]


def sundials() -> list[Solver]:
    if find_spec("sksundae") is None:
        return [Solver("SUNDIALS CVODE", "Adams", None)]
    from sksundae.cvode import CVODE

    def rates(t, x, rate):
        rate[:] = field(t, x)

    def run(rtol):
        # The step limit applies between two samples.
        solver = CVODE(rates, method="Adams", rtol=rtol, atol=1e-3 * rtol, max_num_steps=10_000)
        return lambda: solver.solve(TIME, np.zeros(3)).y[:, 1]

    return [
        Solver("SUNDIALS CVODE", f"Adams, rtol {rtol:.0e}", run(rtol), slow=True)
        for rtol in TOLERANCES
    ]


def measure(solvers: Sequence[Solver], calls: int) -> list[tuple]:
    """Return the rows of the table; slow solvers take fewer turns, separately."""
    exact = exact_velocity()
    unit = solvers[0]
    times = {}
    for slow, number in ((False, calls), (True, min(calls, SLOW_CALLS))):
        runs = {s.name: s.run for s in solvers if s.run and s.slow == slow}
        times |= take_turns(runs, number)
    base = times[unit.name].least if unit.run else None
    rows = []
    for s in solvers:
        if s.run is None:
            absent = "no C compiler" if s.family == "C RK4" else "not installed"
            rows.append((s.family, s.setting, absent, None, None, None))
            continue
        least, median = times[s.name]
        error = relative_error(s.run(), exact)
        relative = least / base if base else None
        rows.append((s.family, s.setting, error, 1e3 * least, 1e3 * median, relative))
    return rows


def plot(rows: Sequence[tuple], file: Path) -> None:
    """Plot error against time, with one labelled line per solver."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.fonttype"] = "none"
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8.0, 5.0), layout="constrained")
    present = [row for row in rows if row[3] is not None]
    families = [(name, list(group)) for name, group in groupby(present, key=lambda row: row[0])]
    for index, (name, group) in enumerate(families):
        points = [(milliseconds, error) for _, _, error, milliseconds, *_ in group]
        colour = COLOURS[index % len(COLOURS)]
        marker = MARKERS[index % len(MARKERS)]
        axes.loglog(*zip(*points, strict=True), color=colour, marker=marker, markersize=5)
        where, offset = PLACES.get(name, (0, (-4, 7)))
        axes.annotate(name, points[where], offset, textcoords="offset points", color=colour)
    axes.set_xlabel("time of the standard sweep [ms]")
    axes.set_ylabel("relative error of velocity [-]")
    axes.grid(color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.15, y=0.08)
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--plot", type=Path, help="draw error against time into this file")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    solvers = [
        *c_rk4(), *numba_rk4(), *exact_step(), *diffrax_tsit5(), *scipy_solvers(), *sundials(),
    ]  # fmt: skip
    rows = measure(solvers, chosen.calls)
    title = f"Solvers of the standard sweep ({NUM} samples)"
    packages = ("scipy", "numba", "scikit-sundae")
    show([Table(title, COLUMNS, rows)], packages, chosen.json)
    print(f"\n{reference_line()}")
    if chosen.plot is not None:
        plot(rows, chosen.plot)


if __name__ == "__main__":
    main()
