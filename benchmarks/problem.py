"""The standard sweep, which most benchmarks solve, and its solution by diffrax without jbw."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar

import diffrax
import jax.numpy as jnp
import numpy as np
import yardstick

from jbw import BoucWen, simulate
from jbw.oscillator.solver import oscillate

GOLDEN = Path(__file__).parent.parent / "tests" / "golden.json"
PAPER = (2 * np.pi * 18.8, 0.00444, 497.4, 340.21, 32.84)
FS, NUM = 1024.0, 16384
TIME = np.arange(NUM) / FS
# This sweep goes from 0 to 40 Hz in 16 s; the peak displacement is 4.80 mm.
U = 2.053397886 * np.sin(np.pi * 2.5 * TIME**2)


def joint() -> BoucWen:
    """Return the joint with the published parameters."""
    return joint_of(PAPER)


def joint_of(values: Iterable[Any]) -> BoucWen:
    """Return a joint with parameters (omega_n, zeta, alpha, delta, gamma), which may be arrays."""
    omega_n, zeta, alpha, delta, gamma = (jnp.asarray(value, float) for value in values)
    return BoucWen(omega_n, zeta, alpha, delta, gamma)


def lanes(num: int) -> BoucWen:
    """Return `num` joints within 5 % of the published one; a single one is scalar and faster."""
    if num == 1:
        return joint()
    return joint_of(p * (1.0 + 0.05 * np.linspace(-1.0, 1.0, num)) for p in PAPER)


def exact_velocity() -> np.ndarray:
    """Return the velocity of the standard sweep with an error of about 1e-10 [m/s]."""
    if yardstick.library() is None:
        return np.asarray(simulate(joint(), jnp.asarray(U), FS, substeps=64).v)
    return yardstick.reference(PAPER, U, FS)


def relative_error(found: Any, exact: np.ndarray) -> float:
    """Return the relative error, as a ratio of L2 norms."""
    return float(np.linalg.norm(np.asarray(found) - exact) / np.linalg.norm(exact))


def golden_sweep() -> tuple[dict, np.ndarray]:
    """Return the sweep of tests/golden.json (linear between samples, A = 2), and its input."""
    case = json.loads(GOLDEN.read_text())["sweep"]["cases"][0]
    t = np.arange(case["N"] + 1) / case["fs"]
    return case, case["A"] * np.sin(np.pi * case["rate_hz_per_s"] * t**2)


def reference_line() -> str:
    """Return a sentence on the error of the reference, from a solution that locates events."""
    case, u = golden_sweep()
    if yardstick.library() is None:
        return "Reference: jbw with 64 steps a sample, for want of a C compiler."
    found = yardstick.reference(list(case["params"].values()), u, case["fs"])
    error = relative_error(found[case["index"]], np.array(case["v"]))
    return f"The reference is within {error:.0e} of the event-located velocity of golden.json."


class SampledRK4(diffrax.AbstractSolver):
    """The classical RK4 from input sample to input sample; `args` are (joint, u, dt)."""

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        """Return the order of convergence for a smooth field."""
        return 4

    def init(self, terms, t0, t1, y0, args):
        """Return the initial solver state, the index of the sample."""
        return jnp.zeros((), jnp.int32)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """Advance by one sample."""
        joint, u, dt = args
        u_0, u_1 = u[solver_state], u[solver_state + 1]
        middle = 0.5 * (u_0 + u_1)

        def moved(h, rates):
            return tuple(x + h * rate for x, rate in zip(y0, rates, strict=True))

        a = oscillate(joint, u_0, y0)
        b = oscillate(joint, middle, moved(0.5 * dt, a))
        c = oscillate(joint, middle, moved(0.5 * dt, b))
        d = oscillate(joint, u_1, moved(dt, c))
        mean = tuple((p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(a, b, c, d, strict=True))
        y1 = moved(dt, mean)
        return y1, None, dict(y0=y0, y1=y1), solver_state + 1, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        """Return the vector field."""
        return terms.vf(t0, y0, args)


def rk4_velocity(joint, u, fs, adjoint: diffrax.AbstractAdjoint | None = None):
    """Return the velocity through diffrax with one RK4 step per sample [m/s]."""
    num = u.shape[0] - 1
    zero = jnp.zeros(())
    solution = diffrax.diffeqsolve(
        # This term is unused, as the solver contains its field.
        diffrax.ODETerm(lambda tau, state, args: state),
        SampledRK4(),
        t0=0.0,
        t1=float(num),
        dt0=1.0,
        y0=(zero, zero, zero),
        args=(joint, u, 1.0 / fs),
        saveat=diffrax.SaveAt(t0=True, steps=True, fn=lambda t, state, args: state[1]),
        adjoint=diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint,
        max_steps=num,
        throw=False,
    )
    return solution.ys[: num + 1]  # pyright: ignore


def indexed_tsit5_velocity(joint, u, fs, substeps: int):
    """Return the velocity by diffrax's Tsit5; time in samples, input read by index [m/s]."""
    num = u.shape[0] - 1

    def field(tau, state, args):
        n = jnp.clip(jnp.floor(tau).astype(jnp.int32), 0, num - 1)
        held = u[n] + (tau - n) * (u[n + 1] - u[n])
        return tuple(rate / fs for rate in oscillate(joint, held, state))

    zero = jnp.zeros(())
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Tsit5(),
        t0=0.0,
        t1=float(num),
        dt0=1.0 / substeps,
        y0=(zero, zero, zero),
        saveat=diffrax.SaveAt(t0=True, steps=substeps, fn=lambda t, state, args: state[1]),
        max_steps=num * substeps,
        throw=False,
    )
    return solution.ys[: num + 1]  # pyright: ignore


def newcomers_velocity(joint, t, u, substeps: int = 1):
    """Return the velocity by a newcomer's diffrax: interpolated input, packed state [m/s].

    The times of the output are requested by `ts`.
    """
    held = diffrax.LinearInterpolation(t, u)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, x, _: jnp.stack(oscillate(joint, held.evaluate(t), x))),
        diffrax.Tsit5(),
        t0=t[0],
        t1=t[-1],
        dt0=(t[1] - t[0]) / substeps,
        y0=jnp.zeros(3),
        saveat=diffrax.SaveAt(ts=t),
        max_steps=2 * substeps * t.size,
    )
    return solution.ys[:, 1]  # pyright: ignore
