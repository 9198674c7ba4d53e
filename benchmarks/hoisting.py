"""Does XLA still turn the time loop into one native call?

A small loop that is compiled as a whole takes tens of nanoseconds per step; one that XLA runs
kernel by kernel takes microseconds. XLA compiles no loop as a whole that contains a custom call
(LAPACK, callbacks, checks) or a scatter. The compiled program shows which case it is, whatever the
machine and its load; the times show the cost. The exit code is 1 if `jbw.simulate` has such a loop.

    python benchmarks/hoisting.py [--calls 31] [--json FILE] [--control]

With --control a custom call is put into the same loop, to show that the check can fail.
"""

import re
import sys
from collections.abc import Callable, Sequence
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from problem import FS, joint
from timing import Table, options, show, take_turns

import jbw
from jbw.oscillator import batch
from jbw.oscillator.hold import held, input_polynomials
from jbw.oscillator.oscillator import as_oscillator
from jbw.oscillator.residual_sums import Compared, residual_sums
from jbw.oscillator.solver import HysteresisExact, stepping

NUM = 4096
COLUMNS = {"loop": "", "ns a step": ".0f", "loops left": "d", "result": ""}
# A computation in the text of a compiled program begins with its name at the start of a line.
COMPUTATION = re.compile(r"^(ENTRY )?%(\S+) [^\n]*\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
CALLED = re.compile(
    r"(?:to_apply|calls|body|condition|branch_computations|(?:true|false)_computation)="
    r"\{?((?:%[\w.-]+(?:, )?)+)"
)
NATIVE = 'xla_cpu_small_call="true"'


class Spoiled(HysteresisExact):
    """The same time step with a custom call: LAPACK's factorisation of a 1 x 1 matrix."""

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """Advance by one substep, with a custom call."""
        (y, v, z), *rest = super().step(terms, t0, t1, y0, args, solver_state, made_jump)
        factor = jnp.linalg.cholesky(jnp.reshape(1.0 + v**2, (1, 1)))[0, 0]
        return (y, v, z + 0.0 * factor), *rest


def forward(joint, u):
    return jbw.simulate(joint, u, FS).v


def summed(joint, u):
    """Return sums over a residual, computed by a time loop that stores no response."""
    empty = jnp.zeros((0, NUM))
    compared = Compared(u, empty, jnp.zeros(0), empty, order=1)
    source = held(u, "first", periodic=False)
    return residual_sums(as_oscillator(joint), source, FS, 1, compared).square


def batched(joint, u):
    """Return sums over the residuals of eight joints in parallel, without stored responses."""
    joints = jax.tree.map(lambda x: x * jnp.linspace(0.99, 1.01, 8), joint)
    return jax.vmap(lambda joint: summed(joint, u))(joints)


def piece_of_march(joint, u):
    """Return the arguments of the program for fits and sampling: many joints under one record."""
    size, ones = batch.INTERVALS + 1, np.ones(batch.LANES)
    joints = jax.tree.map(lambda x: jnp.asarray(x) * ones, as_oscillator(joint))
    rows = input_polynomials(u, "first", periodic=False)
    piece = batch._Piece(
        jnp.zeros((size - 1, 2)).at[: NUM - 1].set(rows), jnp.zeros(size).at[:NUM].set(u),
        jnp.zeros((size, 1 + batch.NUM_DIRECTIONS)),
    )  # fmt: skip
    none, state = jnp.int32(0), batch._at_rest(joints)
    parts = jnp.zeros((batch.LANES, batch.NUM_DIRECTIONS))
    lanes = batch._Lanes(joints, ones, parts)
    steps = batch._Span(FS, jnp.int32(1), jnp.int32(NUM - 1), none, jnp.bool_(True))
    return lanes, piece, steps, state, batch._none()


def gradient(joint, u):
    return jax.grad(lambda joint: jnp.sum(forward(joint, u) ** 2))(joint)


def control(joint, u):
    """Run the time loop of `forward`, with a custom call in its step."""
    source = held(u, "first", periodic=False)
    steps = stepping(joint, FS, source.gain, source.pieces(1))
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


def loops_left(program: str) -> int:
    """Count the loops of a compiled program that are not inside a native call."""
    found = COMPUTATION.findall(program)
    lines = {name: body.splitlines() for _, name, body in found}
    reached = [name for entry, name, _ in found if entry]
    for name in reached:
        for line in lines[name]:
            called = CALLED.findall(line) if NATIVE not in line else []
            names = [n.strip(" %") for group in called for n in group.split(",")]
            reached += [n for n in names if n in lines and n not in reached]
    return sum(" while(" in line for name in reached for line in lines[name])


def measure(loops: dict[str, Callable], calls: int) -> Table:
    u = jnp.asarray(np.random.default_rng(0).normal(size=NUM))
    given = joint(), u
    lowered = {name: (jax.jit(f).lower(*given), given) for name, f in loops.items()}
    # This program has compiler options, which an outer program would refuse.
    piece = piece_of_march(*given)
    marched = jax.jit(
        batch._marched.__wrapped__, static_argnums=0, compiler_options=batch.WIDE
    )  # fmt: skip
    lowered["32 lanes of one program"] = marched.lower(1, *piece), piece
    programs = {name: (program.compile(), takes) for name, (program, takes) in lowered.items()}
    runs = {name: partial(run, *takes) for name, (run, takes) in programs.items()}
    times = take_turns(runs, calls)
    rows = []
    for name, (run, _) in programs.items():
        left = loops_left(run.as_text())
        result = "NOT HOISTED" if left else "hoisted"
        rows.append((name, 1e9 * times[name].least / NUM, left, result))
    return Table("Time loops", COLUMNS, rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__)
    parser.add_argument("--control", action="store_true", help="put a custom call into the loop")
    chosen = parser.parse_args(arguments)
    jbw.enable_x64()
    loops = {"forward": forward, "sums": summed, "sums of 8": batched, "gradient": gradient}
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
