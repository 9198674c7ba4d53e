"""What `simulate` refuses before it starts and what it reports after; tracers are trusted."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jbw.errors import ConfigError, DataError, ModelError
from jbw.oscillator.parameters import BoucWen
from jbw.oscillator.reconstruction import HOLDS


def _traced(*values: Any) -> bool:
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def check_options(
    fs: float, hold: str, substeps: int, num_samples: int | None, callable_input: bool
) -> None:
    """Refuse a float32 session and options that cannot be meant."""
    if jnp.zeros(()).dtype != jnp.float64:
        raise ConfigError(
            "Time integration needs float64, but JAX runs in float32.",
            why="A sweep keeps no correct digit of its gradients in float32.",
            remedy='Call jbw.enable_x64() (or jax.config.update("jax_enable_x64", True)) before '
            "any array is made.",
        )
    if hold not in HOLDS:
        raise ConfigError(f"Argument `hold` must be one of {', '.join(HOLDS)}, but is {hold!r}.")
    if not _traced(fs) and not (np.ndim(fs) == 0 and np.isfinite(fs) and fs > 0):
        raise ConfigError(f"Argument `fs` must be a positive sampling rate in Hz, but is {fs}.")
    if isinstance(substeps, bool) or not isinstance(substeps, int) or substeps < 1:
        raise ConfigError(f"Argument `substeps` must be an integer >= 1, but is {substeps!r}.")
    if callable_input and (not isinstance(num_samples, int) or num_samples < 2):
        raise ConfigError(
            f"A callable `u` needs `num_samples`, an integer >= 2, but it is {num_samples!r}."
        )


def check_input(u: Any, num_samples: int | None) -> None:
    """Refuse an input without a time axis or with values that are not finite."""
    if u.ndim == 0 or u.shape[-1] < 2:
        raise DataError(
            f"Argument `u` must have at least 2 samples on its last axis, but has shape {u.shape}."
        )
    if num_samples is not None and num_samples != u.shape[-1]:
        raise DataError(
            f"Argument `num_samples` is {num_samples}, but `u` has {u.shape[-1]} samples.",
            remedy="Leave `num_samples` out for a sampled input.",
        )
    if not _traced(u) and not np.all(finite := np.isfinite(u)):
        first = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise DataError(
            f"Argument `u` must be finite, but u{list(first)} is {u[first]} "
            f"({np.sum(~finite)} such samples)."
        )


def check_state(joint: BoucWen, initial: Any) -> None:
    """Refuse an initial state that is not (y, v, z) or whose z the joint cannot hold."""
    if len(initial) != 3:
        raise ConfigError(f"Argument `initial` must be (y, v, z), but has {len(initial)} entries.")
    if _traced(joint, initial):
        return
    if not all(np.all(np.isfinite(value)) for value in initial):
        raise DataError(f"Argument `initial` must be finite, but is {initial}.")
    # Beyond alpha/(delta + gamma) z cannot come by itself, and with delta > gamma a z beyond
    # alpha/(delta - gamma) runs away on unloading.
    softening = np.maximum(np.asarray(joint.delta) + np.abs(np.asarray(joint.gamma)), 0.0)
    limit = np.maximum(np.asarray(joint.alpha), 0.0)
    if joint.nu == 1.0 and np.any(np.abs(initial[2]) * softening > limit):
        raise ModelError(
            f"Initial z = {initial[2]} N/kg lies beyond the largest force that the joint holds, "
            f"alpha/(delta + |gamma|) = {limit / softening} N/kg.",
            remedy="Start within it, or from rest.",
        )


def warn_of_unbounded_law(joint: BoucWen) -> None:
    """Warn of parameters for which nothing bounds z (the motion may stay bounded all the same)."""
    if _traced(joint):
        return
    alpha, delta, gamma = (np.asarray(x) for x in (joint.alpha, joint.delta, joint.gamma))
    linear = (delta == 0.0) & (gamma == 0.0)
    conditions = {
        "alpha > 0": alpha > 0.0,
        "delta + gamma > 0": (delta + gamma > 0.0) | linear,
        "gamma >= 0": gamma >= 0.0,
    }
    broken = [name for name, holds in conditions.items() if not np.all(holds)]
    if broken:
        warnings.warn(
            f"The joint is bounded for {' and '.join(conditions)}, but alpha = {joint.alpha}, "
            f"delta = {joint.delta}, gamma = {joint.gamma} break {' and '.join(broken)}: z may "
            "diverge. Check their signs, or keep the input so small that it does not.",
            stacklevel=3,
        )


def warn_of_long_steps(fs: Any, substeps: int, y: Any, v: Any) -> None:
    """Warn where the motion turns twice within a step, as the cubic through its ends shows.

    With equal signs of v at both ends, v is least (or largest) at the cubic's inflection; it has
    turned twice if v has the other sign there, by more than 1 % of the largest velocity.
    """
    if _traced(fs, y, v):
        return
    y, v = np.asarray(y), np.asarray(v)
    start, end, rise = v[..., :-1], v[..., 1:], fs * np.diff(y)
    # v(s) = start + bend s + twist s^2 within an interval.
    bend, twist = 6.0 * rise - 4.0 * start - 2.0 * end, 3.0 * (start + end) - 6.0 * rise
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -0.5 * bend / twist
        least = start + 0.5 * bend * s
        apart = 2.0 * np.sqrt(-least / twist)
    deep = (start * end > 0.0) & (least * start < 0.0) & (s > 0.0) & (s < 1.0)
    deep &= np.abs(least) > 0.01 * np.max(np.abs(v), axis=-1, keepdims=True)
    count = int(np.sum(deep & (apart * substeps < 1.0)))
    if count:
        warnings.warn(
            f"In {count} of {deep.size} sample intervals the motion turns twice within one step, "
            f"and only one turning point a step is resolved: `substeps` = {substeps} at `fs` = "
            f"{fs:g} Hz is too coarse for the input's highest content. Raise `substeps`, or sample "
            "the input faster.",
            stacklevel=3,
        )


def check_bounded(joint: BoucWen, y: Any) -> None:
    """Report a trajectory that diverged, naming the parameters."""
    if _traced(joint, y) or np.all(finite := np.isfinite(y)):
        return
    sample = int(np.argwhere(~finite)[0][-1])
    beside = "" if joint.restoring is None else f", restoring = {joint.restoring}"
    raise ModelError(
        f"The trajectory diverges at sample {sample} for alpha = {joint.alpha}, "
        f"delta = {joint.delta}, gamma = {joint.gamma}{beside}.",
        why="Nothing bounds z where delta + gamma < 0 or after a start outside the bounded set; "
        "more than one turning point in a step does the same, and so does a restoring force that "
        "pushes away from y = 0.",
        remedy="Check the parameters and the input's scale; raise `substeps`.",
    )


def check_settled(residual: Any) -> None:
    """Report a periodic record whose steady state Newton did not find."""
    if _traced(residual) or np.all(np.asarray(residual) < 1e-8):
        return
    raise ModelError(
        f"No steady state was found: the state changes by {np.max(residual):.1e} of its largest "
        "value over the period.",
        why="The response may not be periodic with the input's period.",
        remedy="Give a nearer `initial`, or simulate several periods with `periodic=False`.",
    )
