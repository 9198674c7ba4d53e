"""What do several joints cost, beside one?

A chirp through `jbw.simulate` of three modes with one, two and three Bouc-Wen joints, and the
gradient of half the sum of squares of the output's velocity by all parameters. A joint asks for as
much as the others, and what the modes do is shared, so that the ratio should stay below that of
the joints.

    python benchmarks/assemblies.py [--calls 31] [--json FILE]
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from timing import Table, Target, ahead, options, show, take_turns, targets

import jbw

COLUMNS = {"joints": "d", "ns a step": ".0f", "/ one joint": ".2f"}
COLUMNS |= {"value and gradient, ns a step": ".0f", "/ own forward": ".2f"}
COLUMNS |= {"compile, s": ".1f", "with gradient, s": ".1f"}
FS, NUM = 1024.0, 4096
ROWS = np.array([[1.0, -1.7, 0.8], [0.7, 1.3, -1.9], [0.35, 0.9, 1.4]])
LAWS = ((497.4, 340.21, 32.84), (900.0, 500.0, 120.0), (700.0, 420.0, 80.0))


def structure(joints: int) -> jbw.Structure:
    """Three modes at 18.8, 57 and 131 Hz with some joints."""
    modes = 2 * np.pi * np.array([18.8, 57.0, 131.0]), np.array([4e-3, 6e-3, 8e-3])
    laws = tuple((jbw.laws.BoucWenLaw(*numbers),) for numbers in LAWS[:joints])
    b = np.array([1.0, 0.7, -0.5])
    stated = jbw.Structure(*modes, ROWS[:joints], b=b, c=np.ones(3), laws=laws)
    return jax.tree.map(jnp.asarray, stated)


def chirp() -> jax.Array:
    """5 to 145 Hz, through all modes."""
    t = np.arange(NUM) / FS
    return jnp.asarray(8.0 * np.sin(2 * np.pi * (5.0 * t + 17.5 * t**2)))


def loss(u: jax.Array, model: jbw.Structure) -> jax.Array:
    return 0.5 * jnp.sum(jbw.simulate(model, u, FS).v ** 2)


def tables(calls: int) -> list[Table]:
    value = partial(loss, chirp())
    runs, compile_s = {}, {}
    for joints in (1, 2, 3):
        model = structure(joints)
        for kind, function in (("forward", value), ("gradient", jax.value_and_grad(value))):
            run, compile_s[joints, kind] = ahead(function, model)
            runs[joints, kind] = partial(run, model)
    times = {key: x.least for key, x in take_turns(runs, calls).items()}  # pyright: ignore
    rows = []
    for joints in (1, 2, 3):
        forward, both = times[joints, "forward"], times[joints, "gradient"]
        seconds = compile_s[joints, "forward"], compile_s[joints, "gradient"]
        ratio = forward / times[1, "forward"]
        per_step = (1e9 * x / NUM for x in (forward, both))
        rows.append((joints, next(per_step), ratio, next(per_step), both / forward, *seconds))
    longer = compile_s[2, "gradient"] / compile_s[1, "gradient"]
    entries = [
        Target("forward, 2 joints / 1 joint", rows[1][2], 1.7, 1.5),
        Target("forward, 3 joints / 1 joint", rows[2][2], 2.6, 2.2),
        Target("value and gradient / forward, 2 joints", rows[1][4], 5.2, 4.0),
        Target("compiling the gradient, 2 joints / 1 joint", longer, 1.5, None),
    ]
    return [Table("Three modes with several joints", COLUMNS, rows), targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
