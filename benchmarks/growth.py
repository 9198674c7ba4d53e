"""How does the cost grow with record length, repeats, levels and chains?

Straight lines in a log-log plot are expected: each table states the measured points, the last one
their slopes and where they bend. Repeats enter the likelihood by sufficient statistics, so that
they should cost nothing after one reduction.

    python benchmarks/growth.py [--calls 31] [--json FILE]
"""

import re
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from problem import FS, PAPER, joint
from timing import Table, Target, Times, compiled, options, show, take_turns, targets

import jbw
from jbw.measurement.records import Record, Test
from jbw.observables.records import Records

SECONDS = (1, 4, 16, 64, 250, 1000)
REPEATS = (2, 4, 8, 16, 32, 64)
LEVELS = (1, 2, 4, 8, 16)
CHAINS = (1, 2, 4, 8, 16, 32, 64)
NAMES = ("omega_n", "zeta", "alpha", "delta", "gamma")
# Number of samples in the records of the likelihoods.
RECORD = 4096
NOISE = 1e-3
# A change of slope below this is noise of the timing.
BEND = 0.2


class Line(NamedTuple):
    """A line of log time over log size: its slope, and its best bend if there is one."""

    slope: float
    bend: float | None
    before: float | None
    after: float | None


def log_line(sizes: Sequence[int], seconds: Sequence[float]) -> Line:
    """Fit a straight line, or one with a single bend, to the logarithms by least squares."""
    x, y = np.log(np.asarray(sizes, float)), np.log(np.asarray(seconds))
    slope = float(np.polyfit(x, y, 1)[0])
    fits = []
    for at in x[1:-1]:
        basis = np.stack([np.ones_like(x), x, np.maximum(x - at, 0.0)], axis=1)
        found = np.linalg.lstsq(basis, y)[0]
        fits.append((float(np.sum((basis @ found - y) ** 2)), float(np.exp(at)), found))
    _, bend, (_, before, change) = min(fits, key=lambda fit: fit[0])
    if abs(change) < BEND:
        return Line(slope, None, None, None)
    return Line(slope, bend, float(before), float(before + change))


def noise(num: int, seed: int = 0) -> np.ndarray:
    """Return noise from 5 to 60 Hz of 2 N/kg rms, so that the motion is alike for any length."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).normal(size=num))
    frequency = np.fft.rfftfreq(num, 1 / FS)
    u = np.fft.irfft(np.where((frequency > 5.0) & (frequency < 60.0), spectrum, 0.0), num)
    return 2.0 * u / u.std()


def loss(joint, u):
    return 0.5 * jnp.sum(jbw.simulate(joint, u, FS).v ** 2)


def theta_of(scale) -> dict[str, jax.Array]:
    """Return the published parameters, with zeta and all following ones multiplied by a factor."""
    values = {name: jnp.asarray(p) * scale for name, p in zip(NAMES, PAPER, strict=True)}
    return values | {"omega_n": PAPER[0] * jnp.ones_like(scale), "gain": jnp.ones_like(scale)}


def level(factor: float, num_repeats: int) -> Test:
    """Return a test of one level with several repeats."""
    u = factor * noise(RECORD)
    v = np.asarray(jbw.simulate(joint(), jnp.asarray(u), FS, hold="band_limited").v)
    rng = np.random.default_rng(1)
    units = {"input": "N/kg", "velocity": "m/s"}
    rows = [
        Record(FS, {"input": u, "velocity": v + NOISE * rng.normal(size=RECORD)}, units)
        for _ in range(num_repeats)
    ]
    return Test("noise", tuple(rows), f"noise {factor:g}")


def log_likelihood(theta, data):
    """Return the log likelihood of all repeats, marginal over the noise, up to a constant."""
    return -0.5 * RECORD * jnp.sum(jnp.log(data.squares(theta)))


def value_and_gradient(theta, data):
    return jax.value_and_grad(log_likelihood)(theta, data)


def with_record() -> dict[str, dict[int, Callable]]:
    signals = {s: jnp.asarray(noise(int(s * FS))) for s in SECONDS}
    one = joint()
    return {
        "forward": {s: compiled(loss, one, u) for s, u in signals.items()},
        "value and gradient": {
            s: compiled(jax.value_and_grad(loss), one, u) for s, u in signals.items()
        },
    }


def with_repeats() -> dict[str, dict[int, Callable]]:
    measured = {k: level(1.0, k) for k in REPEATS}
    theta = theta_of(jnp.ones(()))
    return {
        "reduce, once": {
            k: lambda test=test: Records.of([test]).mean for k, test in measured.items()
        },
        "value and gradient": {
            k: compiled(value_and_gradient, theta, Records.of([test]))
            for k, test in measured.items()
        },
    }


def with_levels() -> dict[str, dict[int, Callable]]:
    theta = theta_of(jnp.ones(()))
    tests = [level(0.2 + 0.1 * i, 2) for i in range(max(LEVELS))]
    data = {n: Records.of(tests[:n]) for n in LEVELS}
    return {
        "value": {n: compiled(log_likelihood, theta, d) for n, d in data.items()},
        "value and gradient": {n: compiled(value_and_gradient, theta, d) for n, d in data.items()},
    }


def with_chains() -> dict[str, dict[int, Callable]]:
    data = Records.of([level(1.0, 2)])
    chains = {n: theta_of(jnp.asarray(1.0 + 0.01 * np.linspace(-1.0, 1.0, n))) for n in CHAINS}
    lanes, lanes_with_gradient = (
        jax.vmap(f, in_axes=(0, None)) for f in (log_likelihood, value_and_gradient)
    )
    return {
        "value": {n: compiled(lanes, theta, data) for n, theta in chains.items()},
        "value and gradient": {
            n: compiled(lanes_with_gradient, theta, data) for n, theta in chains.items()
        },
    }


def measured(runs: Mapping[str, Mapping[int, Callable]], calls: int) -> dict[str, dict[int, Times]]:
    """Return the times by computation and size."""
    flat = {f"{what}|{n}": run for what, sizes in runs.items() for n, run in sizes.items()}
    times = take_turns(flat, calls, in_a_row=3)
    return {what: {n: times[f"{what}|{n}"] for n in sizes} for what, sizes in runs.items()}


def points(title: str, size: str, times: Mapping[str, Mapping[int, Times]]) -> Table:
    """Return a table of least times by size, and of the cost per unit of size."""
    columns = {size: "d"}
    for what in times:
        columns |= {f"{what}, ms": ".3f", f"{what}, us a unit": ".2f"}
    rows = []
    for n in next(iter(times.values())):
        least = [by_size[n].least for by_size in times.values()]
        rows.append((n, *(value for s in least for value in (1e3 * s, 1e6 * s / n))))
    return Table(title, columns, rows)


def slopes(times: Mapping[str, Mapping[str, Mapping[int, Times]]]) -> Table:
    """Return a table of the slope of every line, and of where it bends."""
    columns = {"grows": "", "cost of": "", "slope": ".2f", "bends at": ".3g"}
    columns |= {"slope before": ".2f", "slope after": ".2f"}
    rows = []
    for size, costs in times.items():
        for what, by_size in costs.items():
            line = log_line(list(by_size), [t.least for t in by_size.values()])
            bend = "straight" if line.bend is None else line.bend
            rows.append((size, what, line.slope, bend, line.before, line.after))
    return Table("Slopes in log-log", columns, rows)


def peak_mib() -> float:
    """Return the largest memory of this process so far [MiB]."""
    status = Path("/proc/self/status")
    # Unlike this file, getrusage would include the process that started this one.
    if status.exists():
        return int(re.findall(r"VmHWM:\s*(\d+) kB", status.read_text())[0]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def print_peak(seconds: int) -> None:
    """Print the memory of value and gradient of a long record, for a separate process."""
    run = compiled(jax.value_and_grad(loss), joint(), jnp.asarray(noise(int(seconds * FS))))
    jax.block_until_ready(run())
    print(peak_mib())


def peaks() -> Table:
    """Return the peak memory of fresh processes; the shortest record's is Python and compiler."""
    rows = []
    for seconds in (SECONDS[0], SECONDS[-1]):
        command = [sys.executable, __file__, "--memory", str(seconds)]
        found = subprocess.run(command, capture_output=True, text=True, check=True)
        rows.append((seconds, float(found.stdout)))
    columns = {"record, s": "d", "peak of the process, MiB": ".0f"}
    return Table("Memory of value and gradient", columns, rows)


def tables(calls: int) -> list[Table]:
    times = {
        "record, s": measured(with_record(), calls),
        "repeats": measured(with_repeats(), calls),
        "levels": measured(with_levels(), calls),
        "chains": measured(with_chains(), calls),
    }
    titles = (
        "Record length",
        "Repeats of a 4-s record, likelihood",
        "Levels of 4 s each, likelihood",
        "Chains as lanes, likelihood of a 4-s record",
    )
    memory = peaks()
    peak = memory.rows[-1][1]
    return [
        *(points(title, *pair) for title, pair in zip(titles, times.items(), strict=True)),
        slopes(times),
        memory,
        targets(
            [Target("peak memory of a 1000-s record with gradient, GiB", peak / 1024, 1, None)]
        ),
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--memory", type=int, help="only print the peak memory of such a record")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    if chosen.memory is not None:
        print_peak(chosen.memory)
        return
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
