"""What does a batch of solves cost, with and without gradient, on one and on two devices?

The standard sweep is solved for 1 to 128 sets of parameters at once, with one step per sample. The
yardstick is RK4 in C with 16 sets in the arithmetic units at once, with 4 steps at jbw's error, and
with 1. All contenders take turns in one process, which splits the processor into two devices of
JAX.

    python benchmarks/lanes.py [--calls 31] [--json FILE]
"""

from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import yardstick
from jax.sharding import Mesh, PartitionSpec
from problem import FS, NUM, PAPER, U, lanes, rk4_velocity
from timing import Table, Target, Times, compiled, options, show, take_turns, targets

import jbw

LANES = (1, 2, 4, 8, 16, 32, 64, 128)
DEVICES = (1, 2)
SAME_SCHEME = "diffrax, RK4, 32 lanes"
COLUMNS = {"lanes": "d", "forward, ns a lane-sample": ".1f", "/ one lane": ".2f"}
COLUMNS |= {"/ C, 4 steps": ".1f", "two devices, ns": ".1f", "gradient, ns a lane-sample": ".1f"}
COLUMNS |= {"gradient / forward": ".2f", "gradient, two devices, ns": ".1f"}


def velocity(joints, u):
    return jbw.simulate(joints, u, FS).v


def value_and_gradient(joints, u):
    def loss(joint):
        return 0.5 * jnp.sum(velocity(joint, u) ** 2)

    one = jax.value_and_grad(loss)
    return jax.vmap(one)(joints) if joints.omega_n.ndim else one(joints)


def shared(function: Callable, devices: int) -> Callable:
    """Return the function with its batch shared among several devices."""
    if devices == 1:
        return function
    mesh = Mesh(np.array(jax.devices()[:devices]), ("lane",))
    each = PartitionSpec("lane")
    specs = {"in_specs": (each, PartitionSpec()), "out_specs": each}
    return jax.shard_map(function, mesh=mesh, check_vma=False, **specs)


def contenders(kind: str, function: Callable) -> dict[str, Callable]:
    """Return compiled calls by batch size and number of devices, at least one solve on each."""
    u = jnp.asarray(U)
    return {
        label(kind, num, devices): compiled(shared(function, devices), lanes(num), u)
        for num in LANES
        for devices in DEVICES
        if num >= devices
    }


def label(kind: str, num: int, devices: int) -> str:
    return f"{kind}, {num} lanes, {devices} devices"


def c_lanes() -> dict[str, Callable]:
    """Return calls of RK4 in C with 1 and with 4 steps per sample, for 16 sets at once."""
    if yardstick.library() is None:
        return {}
    spread = 1.0 + 0.05 * np.linspace(-1.0, 1.0, yardstick.WIDTH)
    parameters = np.outer(PAPER, spread)

    def run(steps):
        return lambda: yardstick.rk4_lanes(parameters, U, FS, steps)

    return {"C, 1 step": run(1), "C, 4 steps": run(4)}


def per_lane(times: Mapping[str, Times], name: str, num: int) -> float | None:
    """Return the nanoseconds per solve and sample; None where not measured."""
    return 1e9 * times[name].least / (num * NUM) if name in times else None


def ratio(over: float | None, under: float | None) -> float | None:
    return over / under if over and under else None


def tables(calls: int) -> list[Table]:
    runs = contenders("forward", velocity) | contenders("gradient", value_and_gradient)
    rk4 = jax.vmap(lambda joint, u: rk4_velocity(joint, u, FS), in_axes=(0, None))
    runs[SAME_SCHEME] = compiled(rk4, lanes(32), jnp.asarray(U))
    return summaries(take_turns(runs | c_lanes(), calls))


def summaries(times: Mapping[str, Times]) -> list[Table]:
    """Return the table of batch sizes, and the table of targets."""
    c_1, c_4 = (per_lane(times, f"C, {name}", yardstick.WIDTH) for name in ("1 step", "4 steps"))
    forward = {num: per_lane(times, label("forward", num, 1), num) for num in LANES}
    one, rk4 = forward[1], per_lane(times, SAME_SCHEME, 32)
    rows = []
    for num in LANES:
        both, gradient, gradient_both = (
            per_lane(times, label(kind, num, devices), num)
            for kind, devices in (("forward", 2), ("gradient", 1), ("gradient", 2))
        )
        row = (num, forward[num], ratio(forward[num], one), ratio(forward[num], c_4), both)
        rows.append((*row, gradient, ratio(gradient, forward[num]), gradient_both))
    c_rows = [(f"C RK4, {name}", ns) for name, ns in (("1 step", c_1), ("4 steps", c_4))]
    c_columns = {f"{yardstick.WIDTH} sets at once": "", "ns a lane-sample": ".1f"}
    entries = [
        Target("32 lanes, a lane-sample / one lane", ratio(forward[32], one), 0.6, 0.2),
        Target("the same, / C of 4 steps, the same error", ratio(forward[32], c_4), 9.0, 5.0),
        Target("the same, / C of 1 step, 240 times the error", ratio(forward[32], c_1), 9.0, 5.0),
        Target("32 lanes of RK4 in diffrax / C of 1 step", ratio(rk4, c_1), 9.0, 5.0),
    ]
    absent = [(name, "no C compiler") for name, _ in c_rows]
    return [
        Table("Lanes, one step a sample", COLUMNS, rows),
        Table("The yardstick", c_columns, c_rows if c_4 else absent),
        targets(entries),
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    jax.config.update("jax_num_cpu_devices", max(DEVICES))
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
