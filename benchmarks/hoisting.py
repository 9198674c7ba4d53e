"""Does XLA still turn the time loop into one native call?

A small loop is compiled whole and takes tens of nanoseconds a step; one that XLA runs kernel by
kernel takes microseconds. XLA refuses as soon as anything in the loop is a custom call (LAPACK,
callbacks, checks) or a scatter. Exits with code 1 when a step of `jbw.simulate` takes too long.

    python benchmarks/hoisting.py [--calls 31] [--json FILE] [--control]

With --control a custom call is put into the same loop, to show that the check can fail.
"""

import sys
from collections.abc import Callable, Sequence

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from problem import FS, joint
from timing import Table, compiled, options, show, take_turns

import jbw
from jbw.oscillator.hold import input_polynomials
from jbw.oscillator.solver import HysteresisExact, stepping

NUM = 4096
LIMIT_NS = 400.0
COLUMNS = {"loop": "", "ns a step": ".0f", "limit, ns": ".0f", "result": ""}


class Spoiled(HysteresisExact):
    """The same step with a custom call in it, LAPACK's factor of a 1 x 1 matrix."""

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One substep."""
        (y, v, z), *rest = super().step(terms, t0, t1, y0, args, solver_state, made_jump)
        factor = jnp.linalg.cholesky(jnp.reshape(1.0 + v**2, (1, 1)))[0, 0]
        return (y, v, z + 0.0 * factor), *rest


def forward(joint, u):
    return jbw.simulate(joint, u, FS).v


def gradient(joint, u):
    return jax.grad(lambda joint: jnp.sum(forward(joint, u) ** 2))(joint)


def control(joint, u):
    """The loop of `forward` around the spoiled step."""
    steps = stepping(joint, input_polynomials(u, "first", periodic=False), FS, 1)
    rest = jnp.zeros(())
    return diffrax.diffeqsolve(
        diffrax.ODETerm(lambda tau, state, args: state),
        Spoiled(),
        t0=0.0,
        t1=float(NUM - 1),
        dt0=1.0,
        y0=(rest, rest, rest),
        args=steps,
        saveat=diffrax.SaveAt(t0=True, steps=True),
        adjoint=diffrax.ForwardMode(),
        max_steps=NUM - 1,
        throw=False,
    ).ys


def measure(loops: dict[str, Callable], calls: int) -> Table:
    u = jnp.asarray(np.random.default_rng(0).normal(size=NUM))
    times = take_turns({name: compiled(f, joint(), u) for name, f in loops.items()}, calls)
    rows = []
    for name, (least, _) in times.items():
        ns = 1e9 * least / NUM
        rows.append((name, ns, LIMIT_NS, "hoisted" if ns <= LIMIT_NS else "NOT HOISTED"))
    return Table("Time loops", COLUMNS, rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--control", action="store_true", help="put a custom call into the loop")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    loops = {"forward": forward, "gradient": gradient}
    if chosen.control:
        loops |= {"forward with a custom call": control}
    table = measure(loops, chosen.calls)
    show([table], file=chosen.json)
    lost = [name for name, _, _, result in table.rows if result != "hoisted"]
    if lost:
        sys.exit(
            f"\nXLA NO LONGER HOISTS THE TIME LOOP: {', '.join(lost)}. Look for a custom call."
        )


if __name__ == "__main__":
    main()
