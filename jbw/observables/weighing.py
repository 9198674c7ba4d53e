"""What a fit leaves of every group of data, and the evidence weighed by it."""

from collections.abc import Mapping
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from jbw.observables import loops
from jbw.observables.decay import Decays
from jbw.observables.evidence import Evidence, Part
from jbw.observables.harmonics import Points
from jbw.observables.linear import READ, LineReading
from jbw.observables.loops import Loops
from jbw.observables.repeats import Repeats
from jbw.observables.response import Records


def left_by_label(
    rows: Float[np.ndarray, " values"], data: Evidence
) -> dict[str, Float[np.ndarray, " n"] | Complex[np.ndarray, " n"]]:
    """What a fit leaves of the mean of each group; complex for harmonics and lines of a spectrum.

    Args:
        rows: `residual` at the fit.
        data: The evidence.
    """
    found, position = {}, 0
    for part in data.parts:
        if isinstance(part, LineReading):
            position += len(READ)
        elif not isinstance(part, Decays):
            own = part.repeats
            shape = len(own.labels), own.directions.shape[-1]
            block = rows[position : position + shape[0] * shape[1]].reshape(shape)
            weight = np.sqrt(np.asarray(own.num_values / own.size)) / np.asarray(own.noise_std)
            left = block / weight[:, None]
            sizes = np.asarray(own.size).astype(int)
            if isinstance(part, Points) or (isinstance(part, Records) and part.lines):
                real, imaginary = np.split(left, 2, axis=1)
                left, sizes = real + 1j * imaginary, sizes // 2
            counted = loops.counted_of(part) if isinstance(part, Loops) else None
            for i, label in enumerate(own.labels):
                keep = slice(sizes[i]) if counted is None else counted[i]
                found[label] = left[i, keep]
            position += block.size
    return found


def error_by_label(left: Mapping[str, np.ndarray], data: Evidence) -> dict[str, float]:
    """Size of what a fit leaves of the mean of each group, over that of the mean.

    Args:
        left: From `left_by_label`.
        data: The evidence.
    """
    sizes = size_by_label(data)
    return {label: float(np.linalg.norm(left[label])) / size for label, size in sizes.items()}


def size_by_label(data: Evidence) -> dict[str, float]:
    """Root of the sum of squares of the mean of each group of repeated data."""
    return {
        label: float(np.linalg.norm(part.mean[i]))
        for part in data.parts
        if not isinstance(part, LineReading | Decays)
        for i, label in enumerate(part.repeats.labels)
    }


def with_fitted_noise(left: Mapping[str, np.ndarray], data: Evidence) -> Evidence:
    r"""The evidence with the noise that a fit leaves in every group, $\sigma^2 = Q / (N K)$.

    Args:
        left: From `left_by_label`.
        data: The evidence.
    """

    def fitted(part: Part) -> Part:
        if isinstance(part, LineReading | Decays):
            return part
        own = part.repeats
        squares = jnp.asarray([np.sum(np.abs(left[label]) ** 2) for label in own.labels])
        total = own.num_repeats * squares + own.within
        noise = jnp.sqrt(total / (own.size * own.num_repeats))
        return replace(part, repeats=replace(own, noise_std=noise))

    return replace(data, parts=tuple(fitted(part) for part in data.parts))


def with_worth(worth: Mapping[str, float], data: Evidence) -> Evidence:
    """The evidence with as many independent values as the residuals have.

    Args:
        worth: Share of independent values, by label; 1 where not named.
        data: The evidence.
    """

    def counted(part: Part) -> Part:
        if isinstance(part, LineReading | Decays):
            return part
        one: Repeats = part.repeats
        share = jnp.asarray(np.array([worth.get(label, 1.0) for label in one.labels]))
        return replace(part, repeats=replace(one, num_values=share * one.size * one.num_repeats))

    return replace(data, parts=tuple(counted(part) for part in data.parts))
