"""What does each route to the gradient of a sweep cost, and how exact is it?

The loss is half the sum of squares of velocity (J1) or of its difference from another joint's (J2),
over the sweep of tests/golden.json. The error is the largest relative error of the five golden
derivatives (or of the only one, for one parameter). All routes take turns in one process.

    python benchmarks/gradients.py [--calls 31] [--json FILE]
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from problem import golden_sweep, joint_of, rk4_velocity
from timing import Table, Target, Times, ahead, options, show, take_turns, targets

import jbw

COLUMNS = {"route": "", "parameters": "d", "min, ms": ".3f", "median, ms": ".3f"}
COLUMNS |= {"/ own forward": ".2f", "/ jbw, 1 step": ".2f", "error of J1": ".0e"}
COLUMNS |= {"error of J2": ".0e", "compile, s": ".1f"}
# step relative to a parameter: the best compromise between truncation and rounding
RELATIVE_STEP = 1e-5

Velocity = Callable[[jax.Array], jax.Array]
Loss = Callable[[jax.Array, jax.Array], jax.Array]


class Route(NamedTuple):
    """A method that computes a loss and its gradient, with the forward solver that it uses."""

    name: str
    solver: str
    derivative: Callable[[Loss], Callable[[jax.Array, jax.Array], Any]]
    parameters: int = 5


def reverse(loss: Loss):
    return jax.value_and_grad(loss)


def forward_all(loss: Loss):
    def both(theta, data):
        value = loss(theta, data)
        return value, value

    def value_and_gradient(theta, data):
        gradient, value = jax.jacfwd(both, has_aux=True)(theta, data)
        return value, gradient

    return value_and_gradient


def forward_one(loss: Loss):
    """Return a function for a loss and its derivative with respect to zeta alone."""

    def value_and_slope(theta, data):
        zeta = jnp.zeros(5).at[1].set(1.0)
        return jax.jvp(lambda theta: loss(theta, data), (theta,), (zeta,))

    return value_and_slope


def central_differences(loss: Loss):
    def value_and_gradient(theta, data):
        h = jnp.diag(RELATIVE_STEP * theta)
        points = jnp.concatenate([theta[None], theta + h, theta - h])
        values = jax.lax.map(lambda x: loss(x, data), points)
        return values[0], (values[1:6] - values[6:]) / (2.0 * RELATIVE_STEP * theta)

    return value_and_gradient


ROUTES = (
    Route("jbw, reverse", "jbw, 1 step", reverse),
    Route("jbw, reverse, 2 steps a sample", "jbw, 2 steps", reverse),
    Route("jbw, reverse, 4 steps a sample", "jbw, 4 steps", reverse),
    Route("jbw, jvp", "jbw, 1 step", forward_one, 1),
    Route("jbw, jacfwd", "jbw, 1 step", forward_all),
    Route("jbw, jacfwd, 4 steps a sample", "jbw, 4 steps", forward_all),
    Route("jbw, central differences", "jbw, 1 step", central_differences),
    Route("RK4, RecursiveCheckpointAdjoint", "RK4, RecursiveCheckpointAdjoint", reverse),
    Route("RK4, DirectAdjoint", "RK4, DirectAdjoint", reverse),
    Route("RK4, ForwardMode, jvp", "RK4, ForwardMode", forward_one, 1),
    Route("RK4, ForwardMode, jacfwd", "RK4, ForwardMode", forward_all),
)


def solvers(u: jax.Array, fs: float) -> dict[str, Velocity]:
    """Return for each forward solver the velocity as a function of the parameters."""

    def exact(m):
        return lambda theta: jbw.simulate(joint_of(theta), u, fs, substeps=m).v

    def rk4(adjoint):
        return lambda theta: rk4_velocity(joint_of(theta), u, fs, adjoint)

    return {
        "jbw, 1 step": exact(1),
        "jbw, 2 steps": exact(2),
        "jbw, 4 steps": exact(4),
        "RK4, RecursiveCheckpointAdjoint": rk4(diffrax.RecursiveCheckpointAdjoint()),
        "RK4, DirectAdjoint": rk4(diffrax.DirectAdjoint()),
        "RK4, ForwardMode": rk4(diffrax.ForwardMode()),
    }


def squares(velocity: Velocity, theta: jax.Array, data: jax.Array) -> jax.Array:
    return 0.5 * jnp.sum((velocity(theta) - data) ** 2)


def error(found: Any, golden: Sequence[float]) -> float:
    """Return the largest relative error of a gradient; that of zeta alone if it is the only one."""
    exact = np.asarray(golden) if np.size(found) == 5 else np.asarray(golden)[1]
    return float(np.max(np.abs(np.asarray(found) / exact - 1.0)))


def tables(calls: int) -> list[Table]:
    case, u = golden_sweep()
    theta, truth = (jnp.asarray(list(case[k].values())) for k in ("params", "params_data"))
    velocities = solvers(jnp.asarray(u), case["fs"])
    data = {name: jax.jit(velocity)(truth) for name, velocity in velocities.items()}
    none = jnp.zeros(u.size)
    runs, rows = {}, {}
    for name, velocity in velocities.items():
        run, seconds = ahead(partial(squares, velocity), theta, none)
        runs[f"forward: {name}"] = partial(run, theta, none)
        rows[f"forward: {name}"] = (name, None, None, None, seconds)
    for route in ROUTES:
        loss = partial(squares, velocities[route.solver])
        run, seconds = ahead(route.derivative(loss), theta, none)
        runs[route.name] = partial(run, theta, none)
        first = error(run(theta, none)[1], case["gradJ1"])
        second = error(run(theta, data[route.solver])[1], case["gradJ2"])
        rows[route.name] = (route.solver, route.parameters, first, second, seconds)
    return summaries(rows, take_turns(runs, calls))


def summaries(rows: dict[str, tuple], times: dict[str, Times]) -> list[Table]:
    """Return the table of methods, and the table of targets."""
    base = times["forward: jbw, 1 step"].least
    lines = []
    for name, (solver, parameters, first, second, seconds) in rows.items():
        least, median = times[name]
        own = least / times[f"forward: {solver}"].least
        line = (name, parameters, 1e3 * least, 1e3 * median, own, least / base)
        lines.append((*line, first, second, seconds))
    relative = times["jbw, reverse"].least / base
    worst = max(rows["jbw, reverse, 4 steps a sample"][2:4])
    entries = [
        Target("value and gradient, 5 parameters / forward, 1 step", relative, 3.5, 2.5),
        Target("error of the gradient, 4 steps a sample", worst, 5e-5, 1e-6),
    ]
    return [Table("Routes to value and gradient", COLUMNS, lines), targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
