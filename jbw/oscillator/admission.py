"""What `simulate` refuses before it starts and what it reports after; tracers are trusted."""

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
    if joint.nu == 1.0 and np.any(np.abs(initial[2]) * softening > np.asarray(joint.alpha)):
        raise ModelError(
            f"Initial z = {initial[2]} N/kg lies beyond the largest force that the joint holds, "
            f"alpha/(delta + |gamma|) = {np.asarray(joint.alpha) / softening} N/kg.",
            remedy="Start within it, or from rest.",
        )


def check_bounded(joint: BoucWen, y: Any) -> None:
    """Report a trajectory that diverged, naming the parameters."""
    if _traced(joint, y) or np.all(finite := np.isfinite(y)):
        return
    sample = int(np.argwhere(~finite)[0][-1])
    raise ModelError(
        f"The trajectory diverges at sample {sample} for alpha = {joint.alpha}, "
        f"delta = {joint.delta}, gamma = {joint.gamma}.",
        why="Nothing bounds z where delta + gamma < 0 or after a start outside the bounded set; "
        "more than one turning point in a step does the same.",
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
