"""What do several modes with one joint cost, compared with one mode?

The standard sweep passes through `jbw.simulate` of a `BoucWen` and of a `Structure` with 1, 2, 3
and 5 modes, with the gradient of half the sum of squares of the output's velocity by all
parameters. The steady motion is computed at 64 frequencies about the first mode, with 1 and with 5
modes: its unknowns are the joint's harmonics alone, so that modes should cost next to nothing.

    python benchmarks/modes.py [--calls 31] [--json FILE]
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from problem import golden_sweep, joint_of
from timing import Table, Target, ahead, options, show, take_turns, targets

import jbw

COLUMNS = {"model": "", "forward, ms": ".3f", "/ BoucWen": ".2f"}
COLUMNS |= {"value and gradient, ms": ".3f", "/ own forward": ".2f", "compile, s": ".1f"}
STEADY_COLUMNS = {"model": "", "harmonic balance, ms": ".2f", "/ 1 mode": ".3f"}
TONES, NUM_HARMONICS, AMPLITUDE = 2 * np.pi * np.linspace(18.0, 19.4, 64), 16, 0.5
HZ = np.array([18.8, 57.2, 131.0, 83.0, 101.0])


def structure(joint: jbw.BoucWen, modes: int) -> jbw.Structure:
    """Return a structure with the joint's mode and further modes above it."""
    omega_n = jnp.asarray(2 * np.pi * HZ[:modes]).at[0].set(joint.omega_n)
    h, p = (
        jnp.asarray(x[:modes]) for x in ((1.0, -1.7, 2.3, 0.6, -0.9), (1.0, -1.1, 0.8, 0.5, -0.4))
    )
    b = jnp.asarray((1.0, 0.7, -0.5, 0.3, 0.2)[:modes])
    zeta = jnp.full(modes, 0.006).at[0].set(joint.zeta)
    return jbw.Structure(omega_n, zeta, h, p, b, jnp.ones(modes), joint.laws)


def loss(u: jax.Array, fs: float, model: jbw.BoucWen | jbw.Structure) -> jax.Array:
    return 0.5 * jnp.sum(jbw.simulate(model, u, fs).v ** 2)


def steady_table(joint: jbw.BoucWen, calls: int) -> tuple[Table, Target]:
    """Return the table of harmonic balance with 1 and with 5 modes, and the target."""

    def harmonics(model: jbw.Structure) -> jax.Array:
        return jbw.steady_state(model, TONES, AMPLITUDE, NUM_HARMONICS).x

    models = {f"{n} modes": structure(joint, n) for n in (1, 5)}
    runs = {name: partial(ahead(harmonics, one)[0], one) for name, one in models.items()}
    times = {name: x.least for name, x in take_turns(runs, calls).items()}
    base = times["1 modes"]
    rows = [(name, 1e3 * least, least / base) for name, least in times.items()]
    title = f"Steady motion at {len(TONES)} frequencies, {NUM_HARMONICS} harmonics"
    target = Target("harmonic balance, 5 modes / 1 mode", times["5 modes"] / base, 1.1, 1.02)
    return Table(title, STEADY_COLUMNS, rows), target


def tables(calls: int) -> list[Table]:
    case, u = golden_sweep()
    joint = jax.tree.map(jnp.asarray, joint_of(jnp.asarray(list(case["params"].values()))))
    models = {"BoucWen": joint} | {f"{n} modes": structure(joint, n) for n in (1, 2, 3, 5)}
    value = partial(loss, jnp.asarray(u), case["fs"])
    runs, compile_s = {}, {}
    for name, model in models.items():
        for kind, function in (("forward", value), ("gradient", jax.value_and_grad(value))):
            run, seconds = ahead(function, model)
            runs[name, kind], compile_s[name] = partial(run, model), seconds
    times = {key: x.least for key, x in take_turns(runs, calls).items()}  # pyright: ignore
    base = times["BoucWen", "forward"]
    rows = []
    for name in models:
        own, both = times[name, "forward"], times[name, "gradient"]
        rows.append((name, 1e3 * own, own / base, 1e3 * both, both / own, compile_s[name]))
    slower = times["3 modes", "forward"] / times["1 modes", "forward"]
    steady, target = steady_table(joint, calls)
    entries = [
        Target("forward, 3 modes / 1 mode", slower, 1.4, 1.25),
        Target("value and gradient / forward, 3 modes", rows[3][4], 4.5, 3.0),
        Target("value and gradient / forward, 5 modes", rows[4][4], 5.1, 4.0),
        target,
    ]
    return [Table("Several modes with one joint", COLUMNS, rows), steady, targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
