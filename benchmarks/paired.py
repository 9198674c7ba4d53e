"""Did a change make the solver slower? Two source trees take turns in one process.

The standard sweep, its gradient, 32 lanes of it with and without gradient, and the steady state at
five tones are compiled from the packages of both trees; a ratio above one is slower than before.

    python benchmarks/paired.py PATH_OF_THE_OLDER_TREE [--calls 31] [--json FILE]
"""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from timing import Table, Target, compiled, options, show, take_turns, targets

PAPER = (2 * np.pi * 18.8, 0.00444, 497.4, 340.21, 32.84)
FS, NUM = 1024.0, 16384
U = 2.053397886 * np.sin(np.pi * 2.5 * (np.arange(NUM) / FS) ** 2)
OMEGA = 2 * np.pi * np.array([5.0, 10.0, 18.0, 18.8, 20.0])
LANES = 32
MOST = 1.03
COLUMNS = {"what": "", "before, ms": ".3f", "now, ms": ".3f", "now / before": ".3f"}


def package(tree: Path) -> ModuleType:
    """Import the package of a source tree, next to one that was imported before."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "jbw"]:
        del sys.modules[name]
    sys.path.insert(0, str(tree))
    found = importlib.import_module("jbw")
    _ = found.simulate, found.steady_state, found.BoucWen  # These names are loaded on first use.
    sys.path.pop(0)
    if not Path(found.__file__).is_relative_to(tree):
        raise SystemExit(f"No package jbw in {tree}.")
    return found


def contenders(jbw: ModuleType) -> dict[str, Callable[[], Any]]:
    """Return the compiled calls of one package, by name."""
    joint = jbw.BoucWen(*(jnp.asarray(p, float) for p in PAPER))
    spread = 1.0 + 0.05 * jnp.linspace(-1.0, 1.0, LANES)
    joints = jbw.BoucWen(*(p * spread for p in PAPER))

    def velocity(joint: Any) -> Any:
        return jbw.simulate(joint, U, FS).v

    def loss(joint: Any) -> Any:
        return 0.5 * jnp.sum(velocity(joint) ** 2)

    gradient = jax.value_and_grad(loss)
    return {
        "standard sweep": compiled(velocity, joint),
        "its gradient": compiled(gradient, joint),
        f"{LANES} lanes": compiled(jax.vmap(velocity), joints),
        f"{LANES} lanes with gradient": compiled(jax.vmap(gradient), joints),
        "steady state at five tones": compiled(
            lambda joint: jbw.steady_state(joint, OMEGA, 2.0), joint
        ),
    }


def main() -> None:
    """Print the ratios of times, new package to old."""
    jax.config.update("jax_enable_x64", True)
    parser = options(__doc__)
    parser.add_argument("tree", type=Path, help="the tree of the older package")
    arguments = parser.parse_args()
    here = Path(__file__).resolve().parents[1]
    before, now = (contenders(package(tree.resolve())) for tree in (arguments.tree, here))
    rows = []
    for what in now:
        times = take_turns({"before": before[what], "now": now[what]}, arguments.calls)
        old, new = times["before"].least * 1e3, times["now"].least * 1e3
        rows.append((what, old, new, new / old))
    reached = targets([Target(what, ratio, MOST, None) for what, _, _, ratio in rows])
    show([Table("Two packages in turns", COLUMNS, rows), reached], file=arguments.json)


if __name__ == "__main__":
    main()
