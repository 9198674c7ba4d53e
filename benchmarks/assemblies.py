"""What do several joints cost, compared with one joint and with SciPy?

A chirp passes through `jbw.simulate` of three modes with one, two and three Bouc-Wen joints, with
the gradient of half the sum of squares of the output's velocity in all parameters. Every joint
costs the same, and the cost of the modes is shared, so that the ratio should stay below the number
of joints. All times are processor times.

Two joints are also integrated by `scipy.integrate.solve_ivp`, with the right-hand side in NumPy,
over the golden chirp of 1 s. Errors are those of the modal displacements relative to the golden
peaks.

    python benchmarks/assemblies.py [--calls 31] [--json FILE]
"""

import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from timing import Table, Target, Times, compiled, options, show, take_turns, targets

import jbw

COLUMNS = {"joints": "d", "ns a step": ".0f", "/ one joint": ".2f"}
COLUMNS |= {"value and gradient, ns a step": ".0f", "/ own forward": ".2f"}
COLUMNS |= {"compile, CPU s": ".1f", "with gradient, CPU s": ".1f"}
SCIPY_COLUMNS = {"solver": "", "setting": "", "error of q": ".1e", "CPU ms": ".2f"}
SCIPY_COLUMNS |= {"/ jbw, 1 step": ".1f"}
GOLDEN = Path(__file__).parents[1] / "tests" / "golden_assemblies.json"
SUBSTEPS = (1, 2, 4)
SETTINGS = (("RK45", 1e-6), ("DOP853", 1e-6), ("LSODA", 1e-6), ("DOP853", 1e-9))
FS, NUM = 1024.0, 4096
ROWS = np.array([[1.0, -1.7, 0.8], [0.7, 1.3, -1.9], [0.35, 0.9, 1.4]])
LAWS = ((497.4, 340.21, 32.84), (900.0, 500.0, 120.0), (700.0, 420.0, 80.0))


def structure(joints: int) -> jbw.Structure:
    """Return three modes at 18.8, 57 and 131 Hz with a given number of joints."""
    modes = 2 * np.pi * np.array([18.8, 57.0, 131.0]), np.array([4e-3, 6e-3, 8e-3])
    laws = tuple((jbw.laws.BoucWenLaw(*numbers),) for numbers in LAWS[:joints])
    b = np.array([1.0, 0.7, -0.5])
    stated = jbw.Structure(*modes, ROWS[:joints], b=b, c=np.ones(3), laws=laws)
    return jax.tree.map(jnp.asarray, stated)


def chirp() -> jax.Array:
    """Return a chirp from 5 to 145 Hz, through all modes."""
    t = np.arange(NUM) / FS
    return jnp.asarray(8.0 * np.sin(2 * np.pi * (5.0 * t + 17.5 * t**2)))


def loss(u: jax.Array, model: jbw.Structure) -> jax.Array:
    return 0.5 * jnp.sum(jbw.simulate(model, u, FS).v ** 2)


def ahead(function: Callable, model: jbw.Structure) -> tuple[Callable, float]:
    """Return the function compiled in advance, and the processor time of its compilation [s]."""
    start = time.process_time()
    run = jax.jit(function).lower(model).compile()
    return run, time.process_time() - start


def joints_table(calls: int) -> tuple[Table, list[Target]]:
    """Return the table of times with one, two and three joints, and the targets."""
    value = partial(loss, chirp())
    runs, compile_s = {}, {}
    for joints in (1, 2, 3):
        model = structure(joints)
        for kind, function in (("forward", value), ("gradient", jax.value_and_grad(value))):
            run, compile_s[joints, kind] = ahead(function, model)
            runs[joints, kind] = partial(run, model)
    times: dict[Any, float] = {
        key: x.least for key, x in take_turns(runs, calls, clock=time.process_time).items()
    }  # pyright: ignore
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
    return Table("Three modes with several joints", COLUMNS, rows), entries


def golden_pair() -> tuple[dict[str, Any], np.ndarray, jbw.Structure]:
    """Return the chirp through two joints from tests/golden.json: values, input, structure."""
    golden = json.loads(GOLDEN.read_text())["transient"]
    case, t = golden["cases"][0], np.arange(golden["num_samples"]) / golden["fs"]
    drive, system = case["input"], case["system"]
    phase = drive["f0"] * t + drive["rate"] * t**2 / 2
    u = drive["A"] * np.sin(2 * np.pi * phase + drive["phase"])
    omega, zeta, h, b = (np.array(system[name]) for name in ("omega", "zeta", "H", "b"))
    laws = tuple(
        (jbw.laws.BoucWenLaw(joint["alpha"], joint["delta"], joint["gamma"]),)
        for joint in system["joints"]
    )
    return case, u, jbw.Structure(omega, zeta, h, b=b, c=np.ones(3), laws=laws)


def by_scipy(system: dict[str, Any], u: np.ndarray, method: str, rtol: float) -> np.ndarray:
    """Return the modal displacements at the samples by SciPy, from an interpolated input."""
    t = np.arange(len(u)) / FS
    omega, zeta, h, b = (np.array(system[name]) for name in ("omega", "zeta", "H", "b"))
    alpha, delta, gamma = (
        np.array([joint[name] for joint in system["joints"]])
        for name in ("alpha", "delta", "gamma")
    )

    def field(time: float, state: np.ndarray) -> np.ndarray:
        q, v, z = state[:3], state[3:6], state[6:]
        rate = h @ v
        force = b * np.interp(time, t, u) - h.T @ (z - alpha * (h @ q))
        a = force - 2 * zeta * omega * v - omega**2 * q
        return np.concatenate((v, a, alpha * rate - gamma * abs(rate) * z - delta * rate * abs(z)))

    options = {"t_eval": t, "method": method, "rtol": rtol, "atol": 1e-3 * rtol}
    return solve_ivp(field, (0.0, t[-1]), np.zeros(8), **options).y[:3]


def scipy_table(calls: int) -> Table:
    """Return the table that compares two joints by jbw and by SciPy."""
    case, u, model = golden_pair()

    def moved(substeps: int) -> Callable[[], Any]:
        model_of_arrays = jax.tree.map(jnp.asarray, model)
        push = jnp.asarray(u)
        return compiled(
            lambda given: jbw.simulate(given, push, FS, substeps=substeps).q, model_of_arrays
        )

    contenders = {("jbw", f"{m} step(s) a sample"): moved(m) for m in SUBSTEPS}
    plain = {
        (f"solve_ivp, {method}", f"rtol = {rtol:g}"): partial(
            by_scipy, case["system"], u, method, rtol
        )
        for method, rtol in SETTINGS
    }
    times: dict[Any, Times] = {
        **take_turns(contenders, calls, clock=time.process_time),  # pyright: ignore
        **take_turns(plain, min(calls, 3), clock=time.process_time),  # pyright: ignore
    }
    expected = np.transpose(case["q"])
    rows = []
    for key, run in (contenders | plain).items():
        q = np.asarray(run())
        error = np.max(np.abs(q[:, case["index"]] - expected)) / np.max(np.abs(q))
        least = times[key].least
        rows.append((*key, error, 1e3 * least, least / times["jbw", "1 step(s) a sample"].least))
    return Table("Two joints over a chirp of 1 s", SCIPY_COLUMNS, rows)


def tables(calls: int) -> list[Table]:
    joints, entries = joints_table(calls)
    return [joints, scipy_table(calls), targets(entries)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__).parse_args(arguments)
    jbw.enable_x64()
    show(tables(chosen.calls), file=chosen.json)


if __name__ == "__main__":
    main()
