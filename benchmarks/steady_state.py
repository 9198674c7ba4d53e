"""What does the periodic response at five tones cost, and how exact is it?

The harmonic balance is compared with integration from rest until the transient has died, in C and
through `simulate`, and with shooting. Each turn is three calls, of which the first finds the caches
cold.

    python benchmarks/steady_state.py [--calls 93] [--json FILE]
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import yardstick
from problem import PAPER, joint
from timing import Table, Target, options, show, take_turns, targets

import jbw

TONES = 2 * np.pi * np.array([5.0, 5.5, 6.0, 6.5, 6.75])
AMPLITUDE = 9.0
FS, NUM_SAMPLES = 1024, 65536
# The last 32 s contain whole periods of every tone.
LAST = 32 * FS
C_ROUTE, BALANCE = "C RK4, 64 s from rest", "harmonic balance, 8 harmonics"
COLUMNS = {"route": "", "min, ms": ".2f", "median, ms": ".2f", "/ C": ".3f"}
COLUMNS |= {"error of Y_1": ".0e", "error of Y_3": ".0e"}


class Route(NamedTuple):
    """A method for the periodic response, and a function for Y_1 and Y_3 of its result."""

    run: Callable[[], Any]
    harmonics: Callable[[Any], np.ndarray]


def integrated_harmonics(y: Any) -> np.ndarray:
    """Return Y_1 and Y_3 by Fourier's integral over the last whole periods."""
    t = np.arange(NUM_SAMPLES - LAST, NUM_SAMPLES) / FS
    orders = np.array([1, 3])
    basis = np.exp(-1j * TONES[:, None, None] * orders[:, None] * t)
    return 2.0 * np.mean(np.asarray(y)[:, None, -LAST:] * basis, axis=-1)


def first_two(harmonics: Any) -> np.ndarray:
    return np.asarray(harmonics)[:, :2]


def c_integration() -> list[np.ndarray]:
    return [yardstick.rk4_tone(PAPER, omega, AMPLITUDE, NUM_SAMPLES, FS) for omega in TONES]


def routes() -> dict[str, Route]:
    one = joint()
    u = jnp.asarray(AMPLITUDE * np.cos(TONES[:, None] * np.arange(NUM_SAMPLES) / FS))
    shoot = jax.jit(jax.vmap(lambda omega: jbw.shooting(one, omega, AMPLITUDE).harmonics))

    def balance(num_harmonics):
        return lambda: jbw.steady_state(one, TONES, AMPLITUDE, num_harmonics)

    found = {
        BALANCE: Route(balance(8), first_two),
        "harmonic balance, 4 harmonics": Route(balance(4), first_two),
        "shooting": Route(lambda: shoot(TONES), first_two),
        "simulate, 64 s from rest": Route(lambda: jbw.simulate(one, u, FS).y, integrated_harmonics),
    }
    if yardstick.library() is not None:
        found[C_ROUTE] = Route(c_integration, integrated_harmonics)
    return found


def tables(calls: int) -> list[Table]:
    exact = first_two(jbw.steady_state(joint(), TONES, AMPLITUDE, num_harmonics=32))
    found = routes()
    times = take_turns({name: route.run for name, route in found.items()}, calls, in_a_row=3)
    base = times[C_ROUTE].least if C_ROUTE in times else None
    rows = []
    for name, (run, harmonics) in found.items():
        least, median = times[name]
        relative = least / base if base else None
        errors = np.max(np.abs(harmonics(run()) / exact - 1.0), axis=0)
        rows.append((name, 1e3 * least, 1e3 * median, relative, *errors))
    if base is None:
        rows.append((C_ROUTE, "no C compiler", *[None] * 4))
    measured = times[BALANCE].least / base if base else None
    entries = [Target("harmonic balance of 5 tones / C integration", measured, 0.2, 0.1)]
    return [Table(f"Five tones of {AMPLITUDE:g} N/kg", COLUMNS, rows), targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__, calls=93).parse_args(arguments)
    jbw.enable_x64()
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
