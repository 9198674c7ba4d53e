"""Checks of the arguments and results of public functions; values traced by JAX are not checked.

A joint is a `BoucWen`, its law alone, or an `Oscillator` of any laws.
"""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Complex, Int

from jbw.errors import ConfigError, DataError, ModelError
from jbw.oscillator.guests import require_contract
from jbw.oscillator.hold import HOLDS
from jbw.oscillator.law import laws_in, map_laws
from jbw.report.messages.joint import stiffer_than_structure


def is_concrete(*values: object) -> bool:
    """Return whether none of the values is traced by a JAX transformation.

    Under `jit`, even results of constants are traced: before you look at a result, check that the
    result itself is concrete.
    """
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def require_closed_form(joint: Any) -> None:
    """Raise unless nu = 1, the only exponent with a closed form; nu is static under tracing."""
    if joint.nu != 1.0:
        raise ModelError(
            f"Parameter `nu` must be 1 for the closed-form hysteresis, but nu = {joint.nu:g}.",
            remedy="Integrate `hysteresis_rate`, which is valid for every nu, or set nu = 1.",
        )


def require_finite(joint: Any, **arguments: ArrayLike) -> None:
    """Raise if a parameter of the joint or an argument is NaN or infinite."""
    for kind, group in (("Parameter", parameters(joint)), ("Argument", arguments)):
        for name, value in group.items():
            if is_concrete(value) and not np.all(np.isfinite(np.asarray(value))):
                flat = np.ravel(np.asarray(value))
                bad = flat[~np.isfinite(flat)][0]
                raise ModelError(f"{kind} `{name}` must be finite, but it is {bad}.")


def parameters(joint: Any) -> dict[str, ArrayLike]:
    """Return a joint's parameters by name, such as `restoring.lambda_3` of a restoring force."""
    if hasattr(joint, "parameters"):
        return joint.parameters()
    leaves = jax.tree_util.tree_leaves_with_path(joint)
    return {jax.tree_util.keystr(path).removeprefix("."): leaf for path, leaf in leaves}


def require_at_least(name: str, value: ArrayLike, bound: float, *, open_end: bool = False) -> None:
    """Raise if an argument lies below its bound, or on the bound if that is excluded."""
    if not is_concrete(value):
        return
    least = float(np.min(np.asarray(value)))
    if least < bound or (open_end and least == bound):
        relation = "greater than" if open_end else "at least"
        raise ConfigError(f"Argument `{name}` must be {relation} {bound:g}, but it is {least:g}.")


def require_none(joint: Any, function: str) -> None:
    """Raise if the joint has a restoring force, which the formula of `function` does not have."""
    if joint.restoring is not None:
        raise ModelError(
            f"Parameter `restoring` must be None for `{function}`, but it is a force of kind "
            f"{type(joint.restoring).__name__}.",
            why=f"The formula of `{function}` contains only the hysteretic force and a linear "
            "spring.",
            remedy="Use `steady_state` or `simulate`, which are valid for every restoring force.",
        )


def require_float64(
    what: str = "The periodic response",
    why: str = "Near resonance the balance loses half of its digits",
) -> None:
    """Raise if JAX runs in float32."""
    if not jax.config.jax_enable_x64:
        raise ConfigError(
            f"{what} needs float64, but JAX runs in float32.",
            why=f"{why} in float32.",
            remedy='Call jbw.enable_x64() (or jax.config.update("jax_enable_x64", True)) before '
            "any array is made.",
        )


def check_options(
    fs: float, hold: str, substeps: int, num_samples: int | None, callable_input: bool
) -> None:
    """Raise if JAX runs in float32, or if an option of `simulate` is invalid."""
    require_float64("Time integration", "The gradients of a sweep have no correct digit")
    if hold not in HOLDS:
        raise ConfigError(f"Argument `hold` must be one of {', '.join(HOLDS)}, but is {hold!r}.")
    if is_concrete(fs) and not (np.ndim(fs) == 0 and np.isfinite(fs) and fs > 0):
        raise ConfigError(f"Argument `fs` must be a positive sampling rate in Hz, but is {fs}.")
    if isinstance(substeps, bool) or not isinstance(substeps, int) or substeps < 1:
        raise ConfigError(f"Argument `substeps` must be an integer >= 1, but is {substeps!r}.")
    if callable_input and (not isinstance(num_samples, int) or num_samples < 2):
        raise ConfigError(
            f"A callable `u` needs `num_samples`, an integer >= 2, but it is {num_samples!r}."
        )


def check_input(u: Any, num_samples: int | None) -> None:
    """Raise if an input has no time axis, or values that are not finite."""
    if u.ndim == 0 or u.shape[-1] < 2:
        raise DataError(
            f"Argument `u` must have at least 2 samples on its last axis, but has shape {u.shape}."
        )
    if num_samples is not None and num_samples != u.shape[-1]:
        raise DataError(
            f"Argument `num_samples` is {num_samples}, but `u` has {u.shape[-1]} samples.",
            remedy="Leave out `num_samples` for a sampled input.",
        )
    if is_concrete(u) and not np.all(finite := np.isfinite(u)):
        first = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise DataError(
            f"Argument `u` must be finite, but u{list(first)} is {u[first]} "
            f"({np.sum(~finite)} such samples)."
        )


def initial_state(joint: Any, initial: tuple) -> tuple:
    """Return the initial state from (y, v), with or without the internal states of the laws.

    `initial` is (y, v), (y, v, z) if only one law has a memory, or (y, v, memories).
    """
    if len(initial) not in (2, 3):
        raise ConfigError(f"Argument `initial` must be (y, v, z), but has {len(initial)} entries.")
    y, v, *start_memory = initial
    memory = joint.at_rest()
    remembering = [law.remembers for law in laws_in(joint.laws)]
    if start_memory and isinstance(start_memory[0], tuple):
        memory = start_memory[0]
    elif start_memory and sum(remembering) == 1 == len(jax.tree.leaves(memory)):
        memory = map_laws(
            lambda law, rest_memory: start_memory[0] if law.remembers else rest_memory,
            joint.laws,
            memory,
        )
    elif start_memory and np.any(np.asarray(start_memory[0]) != 0.0):
        raise ConfigError(
            "Argument `initial` contains a single z, but the laws of the joint do not have exactly "
            "one internal state.",
            remedy="Give (y, v), or (y, v, memories) with the internal state of every law.",
        )
    expected = jax.tree.structure(joint.at_rest())
    if (tree := jax.tree.structure(memory)) != expected:
        raise ConfigError(
            f"Argument `initial` must contain the internal states of the laws as {expected}, "
            f"but has {tree}."
        )
    if is_concrete(joint, initial):
        if not all(np.all(np.isfinite(value)) for value in jax.tree.leaves(initial)):
            raise DataError(f"Argument `initial` must be finite, but is {initial}.")
        map_laws(_admit, joint.laws, memory)
    return y, v, memory


def _admit(law: Any, memory: Any) -> None:
    """Raise a ModelError if a law cannot start with this internal state."""
    if hasattr(law, "admits"):
        law.admits(memory)


def warn_of_unbounded_law(joint: Any) -> None:
    """Warn of parameters for which the force of a law may diverge."""
    for law in laws_in(joint.laws) if is_concrete(joint) else ():
        if (doubt := law.doubts()) is not None:
            warnings.warn(doubt, stacklevel=3)


def warn_of_negative_stiffness(oscillator: Any) -> None:
    r"""Warn if the joint is stiffer than the whole structure.

    $$\alpha > \omega_n^2$$

    Here alpha is the stiffness of the laws: once the joint slips, no positive stiffness is left.
    """
    if not oscillator.laws or not is_concrete(oscillator):
        return
    alpha = sum(np.asarray(law.stiffness()) for law in oscillator.laws)
    limit = np.asarray(oscillator.omega_n) ** 2
    share = alpha / limit
    if np.any(share > 1.0):
        worst = np.unravel_index(np.argmax(share), np.shape(share))
        most, least = (np.broadcast_to(x, np.shape(share))[worst] for x in (alpha, limit))
        warnings.warn(stiffer_than_structure("omega_n^2", most, least), stacklevel=3)


def warn_of_long_steps(fs: Any, substeps: int, y: Any, v: Any) -> None:
    """Warn if the velocity changes sign twice within a time step.

    With equal signs of v at both ends, v is least (or largest) at the cubic's inflection; it has
    turned twice if v has the other sign there, by more than 1 % of the largest velocity.
    """
    if not is_concrete(fs, y, v):
        return
    y, v = np.asarray(y), np.asarray(v)
    start, end, rise = v[..., :-1], v[..., 1:], fs * np.diff(y)
    # On an interval v(s) = start + bend s + twist s^2.
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
            f"In {count} of {deep.size} sample intervals the motion reverses twice within one "
            f"step, but a step can resolve only one reversal: `substeps` = {substeps} at `fs` = "
            f"{fs:g} Hz is too coarse for the highest frequencies of the input. Raise "
            "`substeps`, or sample the input faster.",
            stacklevel=3,
        )


def warn_of_guesses(guesses: Any) -> None:
    """Warn if motion returned to load reversals that a law no longer remembered."""
    if not is_concrete(guesses) or not np.any(count := np.asarray(guesses)):
        return
    warnings.warn(
        "The motion has more nested loops than a law can remember: the motion returned "
        f"{int(np.max(count))} times to load reversals that had been dropped. After each of these "
        "returns the force may be wrong until a larger loop closes.",
        stacklevel=3,
    )


def check_bounded(joint: Any, y: Any) -> None:
    """Raise if a trajectory has diverged; name the parameters."""
    if not is_concrete(joint, y) or np.all(finite := np.isfinite(y)):
        return
    sample = int(np.argwhere(~finite)[0][-1])
    law_parameters = {
        name: x for name, x in parameters(joint).items() if name not in ("omega_n", "zeta")
    }
    text = ", ".join(f"{name} = {value}" for name, value in law_parameters.items())
    if np.any((zeta := np.asarray(parameters(joint).get("zeta", 0.0))) < 0.0):
        raise ModelError(
            f"The trajectory diverges at sample {sample}: zeta = {np.min(zeta):g} is negative, "
            "so that the damper adds energy.",
            remedy="Give zeta >= 0, as a ratio and not in per cent.",
        )
    raise ModelError(
        f"The trajectory diverges at sample {sample} for {text}.",
        why="z has no bound in any of these cases: delta + gamma < 0; z starts outside its bounded "
        "range; the motion reverses more than once within a step; a restoring force pushes away "
        "from y = 0.",
        remedy="Check the law's parameters and the scale of the input, or raise `substeps`.",
    )


def check_settled(residual: Any) -> None:
    """Raise if Newton's iteration did not find the steady state of a periodic record."""
    if not is_concrete(residual) or np.all(np.asarray(residual) < 1e-8):
        return
    raise ModelError(
        f"No steady state was found: the state changes by {np.max(residual):.1e} of its largest "
        "value over the period.",
        why="Perhaps the response does not have the period of the input.",
        remedy="Give an `initial` nearer to the steady state, or simulate several periods with "
        "`periodic=False`.",
    )


def require_periodic(joint: Any) -> None:
    """Raise if a law does not support periodic motion with odd harmonics."""
    require_contracts(joint)
    for law in laws_in(joint.laws):
        law.check_periodic()


def require_contracts(joint: Any) -> None:
    """Raise if a law from outside jbw breaks its contract (see `jbw.oscillator.contract`)."""
    require_contract({type(law) for law in laws_in(joint.laws)})


def require_sense(
    joint: Any, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int, max_turns: int
) -> None:
    """Raise if an argument of a periodic response is not finite or out of range."""
    require_periodic(joint)
    require_finite(joint, omega=omega, amplitude=amplitude)
    require_float64()
    if num_harmonics < 1:
        raise ConfigError(f"Argument `num_harmonics` must be at least 1, but is {num_harmonics}.")
    if max_turns < 2 or max_turns % 2:
        raise ConfigError(f"Argument `max_turns` must be even, 2 or more, but is {max_turns}.")
    require_at_least("omega", omega, 0.0, open_end=True)
    require_at_least("amplitude", amplitude, 0.0)


def require_concrete(function: str, *values: object) -> None:
    """Raise if a function that branches on the values of its arguments is being traced."""
    if is_concrete(*values, jnp.zeros(())):
        return
    raise ConfigError(
        f"`{function}` cannot be traced by `jit`, `grad` or `vmap`.",
        why="The number of points depends on the values of the arguments.",
        remedy=f"Call `{function}` outside `jit`, `grad` and `vmap`, or use `frequency_response`, "
        "which has as many points as `omega`.",
    )


def require_converged(
    joint: Any,
    omega: ArrayLike,
    amplitude: ArrayLike,
    harmonics: Complex[Array, "... harmonic"],
    turns: Int[Array, "..."],
) -> None:
    """Raise if harmonics are NaN; name the first tone whose response was not found."""
    failed = np.isnan(np.asarray(harmonics)).any(axis=-1)
    if not failed.any():
        return
    shape = failed.shape
    first = np.unravel_index(np.argmax(failed), shape)
    leaves = {"omega": omega, "amplitude": amplitude, **parameters(joint)}
    values = {
        name: float(np.broadcast_to(np.asarray(leaf), shape)[first])
        for name, leaf in leaves.items()
    }
    text = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    raise ModelError(
        f"The periodic response did not converge for {failed.sum()} of {failed.size} tones, the "
        f"first at {text} ({int(np.asarray(turns)[first])} turning points per period).",
        why="At these tones several periodic responses may exist, or none with at most "
        "`max_turns` turning points per period.",
        remedy="Lower `amplitude`, follow the branch with `response_curve`, or raise `max_turns`.",
    )
