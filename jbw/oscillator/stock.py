"""Time response through a stock diffrax solver: any nu, any input, for checks of the exact step."""

from collections.abc import Callable

import diffrax
import jax.numpy as jnp

from jbw.oscillator.adjoint import Trajectory
from jbw.oscillator.exact_step import State
from jbw.oscillator.parameters import BoucWen, Scalar
from jbw.oscillator.solver import oscillate

# An adaptive solver may take this many steps a sample on average before it gives up.
_MAX_STEPS_PER_SAMPLE = 64


def solve_stock(
    joint: BoucWen,
    u: Callable[[Scalar], Scalar],
    num_samples: int,
    fs: Scalar,
    initial: State,
    substeps: int,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractStepSizeController,
) -> Trajectory:
    """States at the samples; time counts samples inside, so that 1/fs is never accumulated.

    Args:
        joint: Bouc-Wen parameters, any nu.
        u: Input as a function of time in samples [N/kg].
        num_samples: Number of samples.
        fs: Sampling rate [Hz].
        initial: (y, v, z) at the first sample.
        substeps: First (or constant) number of steps per sample.
        solver: Diffrax solver.
        controller: Diffrax step-size controller.

    Returns:
        y [m], v [m/s], z [N/kg]; inf from where an adaptive solver gave up.
    """

    def rate(tau, state, joint):
        return tuple(x / fs for x in oscillate(joint, u(tau), state))

    constant = isinstance(controller, diffrax.ConstantStepSize)
    num_steps = (num_samples - 1) * substeps
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        solver,
        t0=0.0,
        t1=float(num_samples - 1),
        dt0=1.0 / substeps,
        y0=initial,
        args=joint,
        saveat=diffrax.SaveAt(t0=True, steps=substeps)
        if constant
        else diffrax.SaveAt(ts=jnp.arange(num_samples, dtype=float)),
        stepsize_controller=controller,
        adjoint=diffrax.DirectAdjoint(),
        max_steps=num_steps if constant else _MAX_STEPS_PER_SAMPLE * num_samples,
        throw=False,
    )
    return tuple(x[:num_samples] for x in solution.ys)  # pyright: ignore
