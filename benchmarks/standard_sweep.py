"""What does a sweep cost, with its gradient and in lanes, against a C loop and naive diffrax?

Prints one table of times in one process, all contenders taking turns, by the smallest of at least
31 calls; machines are shared, so only the ratios mean anything. Fails (exit code 1) when XLA no
longer turns the time loop into one native call.

    python benchmarks/standard_sweep.py [--calls 31]
"""

import argparse
import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from jbw import BoucWen, simulate
from jbw.oscillator.exact_step import advance
from jbw.oscillator.reconstruction import input_polynomials
from jbw.oscillator.solver import oscillate, stepping

jax.config.update("jax_enable_x64", True)

FS, NUM = 1024.0, 16384
TIME = np.arange(NUM) / FS
U = 2.053397886 * np.sin(np.pi * 2.5 * TIME**2)
PAPER = (2 * np.pi * 18.8, 0.00444, 497.4, 340.21, 32.84)
LANES = (1, 2, 4, 8, 16, 32)
# A hoisted step takes 20 to 80 ns; a loop of separate kernels takes microseconds.
HOISTED_NS = 400.0


def c_rk4(steps):
    """Velocity by RK4 in C, or None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    library = Path(tempfile.mkdtemp()) / "standard_sweep.so"
    source = Path(__file__).with_suffix(".c")
    flags = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, str(source), "-o", str(library), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).rk4
    pointer = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    function.argtypes = [
        pointer, pointer, ctypes.c_long, ctypes.c_double, ctypes.c_int, pointer,
    ]  # fmt: skip
    parameters, u = np.array(PAPER), np.ascontiguousarray(U)

    def run():
        v = np.empty(NUM)
        function(parameters, u, NUM, FS, steps, v)
        return v

    return run


def exact(substeps):
    run = jax.jit(lambda joint, u: simulate(joint, u, FS, substeps=substeps).v)
    return lambda: run(joint(), jnp.asarray(U))


def bare_scan():
    @jax.jit
    def run(joint, u):
        steps = stepping(joint, input_polynomials(u, "first", periodic=False), FS, 1)

        def body(state, push):
            state = advance(steps.step, state, push, branch=True)
            return state, state[1]

        rest = jnp.zeros(())
        return jnp.append(0.0, jax.lax.scan(body, (rest, rest, rest), steps.push)[1])

    return lambda: run(joint(), jnp.asarray(U))


def naive_diffrax():
    """As a newcomer writes it: an interpolated input, saved at the samples."""

    @jax.jit
    def run(joint, u):
        held = diffrax.LinearInterpolation(jnp.asarray(TIME), u)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, x, _: jnp.stack(oscillate(joint, held.evaluate(t), x))),
            diffrax.Tsit5(),
            0.0,
            TIME[-1],
            1 / FS,
            jnp.zeros(3),
            saveat=diffrax.SaveAt(ts=jnp.asarray(TIME)),
            max_steps=2 * NUM,
        )
        return solution.ys[:, 1]

    return lambda: run(joint(), jnp.asarray(U))


def gradient(substeps):
    def loss(joint, u):
        return jnp.sum(simulate(joint, u, FS, substeps=substeps).v ** 2)

    run = jax.jit(jax.value_and_grad(loss))
    return lambda: run(joint(), jnp.asarray(U))


def lanes(num, with_gradient=False):
    def loss(joint, u):
        v = simulate(joint, u, FS).v
        return jnp.sum(v**2) if with_gradient else v

    run = jax.jit(jax.vmap(jax.value_and_grad(loss) if with_gradient else loss, in_axes=(0, None)))
    spread = 1.0 + 0.05 * np.linspace(-1.0, 1.0, num)
    joints = BoucWen(*(jnp.asarray(p * spread) for p in PAPER))
    return lambda: run(joints, jnp.asarray(U))


def joint():
    return BoucWen(*(jnp.asarray(p) for p in PAPER))


def best_times(contenders, calls):
    """Smallest time of each contender [s], all taking turns."""
    for run in contenders.values():
        jax.block_until_ready(run())
    best = dict.fromkeys(contenders, np.inf)
    for _ in range(calls):
        for name, run in contenders.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=31)
    calls = parser.parse_args().calls
    reference = np.asarray(exact(32)())
    solvers = {
        "C RK4, 1 step": c_rk4(1),
        "C RK4, 4 steps": c_rk4(4),
        "jbw through diffrax": exact(1),
        "jbw through diffrax, 2 steps": exact(2),
        "bare scan of the same step": bare_scan(),
    }
    solvers = {name: run for name, run in solvers.items() if run is not None}
    best = best_times(solvers, calls)
    slow = best_times({"naive diffrax": naive_diffrax()}, 5)
    unit = best.get("C RK4, 4 steps", best["jbw through diffrax"])
    print(f"{'standard sweep':34}{'error':>9}{'ms':>9}{'ns/sample':>11}{'/ C RK4 x4':>12}")
    for name, seconds in (best | slow).items():
        run = solvers.get(name) or naive_diffrax()
        error = np.linalg.norm(run() - reference) / np.linalg.norm(reference)
        ns = 1e9 * seconds / NUM
        print(f"{name:34}{error:9.1e}{1e3 * seconds:9.3f}{ns:11.1f}{seconds / unit:12.2f}")
    derivatives = {"forward": exact(1), "value and gradient": gradient(1)}
    derivatives |= {"forward, 2 steps": exact(2), "value and gradient, 2 steps": gradient(2)}
    times = best_times(derivatives, calls)
    print(f"\n{'gradient, 5 parameters':34}{'ms':>9}{'/ forward':>12}")
    for name, seconds in times.items():
        forward = times["forward, 2 steps" if "2 steps" in name else "forward"]
        print(f"{name:34}{1e3 * seconds:9.3f}{seconds / forward:12.2f}")
    print(f"\n{'lanes':>5}{'ns/lane-sample':>18}{'/ one lane':>12}{'with gradient':>18}")
    few = max(5, calls // 4)
    forward = best_times({n: lanes(n) if n > 1 else exact(1) for n in LANES}, few)
    both = best_times({n: lanes(n, True) if n > 1 else gradient(1) for n in LANES}, few)
    for n in LANES:
        per_lane, per_gradient = 1e9 * forward[n] / n / NUM, 1e9 * both[n] / n / NUM
        ratio = forward[n] / n / forward[1]
        print(f"{n:5}{per_lane:18.1f}{ratio:12.2f}{per_gradient:18.1f}")
    step_ns = 1e9 * best["jbw through diffrax"] / NUM
    if step_ns > HOISTED_NS:
        sys.exit(f"The time loop takes {step_ns:.0f} ns a step: XLA no longer hoists it.")


if __name__ == "__main__":
    main()
