"""The weighted points of all rounds of AMIS, with their mixtures."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import softmax

from jbw.inference.samplers.chunked_run import Arrays
from jbw.inference.samplers.importance import SMALLEST, smooth
from jbw.inference.samplers.mixtures import Mixture, Points, Weights

# the mixtures from which even-numbered and odd-numbered points are drawn
Pair = tuple[Mixture, Mixture]


class Past(NamedTuple):
    """The points drawn so far, with the mixtures from which they were drawn.

    Attributes:
        w: Whitened points.
        terms: Terms of the log likelihood [nats].
        log_density: Log posterior density, not normalised [nats]; -inf where impossible.
        log_mixed: Logarithm of the sum of the densities of all mixtures of a point's half, each
            times its number of points.
        sizes: Number of points in each half, by round.
        rounds: The pair of mixtures of every round.
    """

    w: Points
    terms: Float[np.ndarray, "point term"]
    log_density: Weights
    log_mixed: Weights
    sizes: Int[np.ndarray, " round"]
    rounds: tuple[Pair, ...]

    @property
    def log_weight(self) -> Weights:
        """The log posterior density of each point minus the log of the mixtures' mean density."""
        return self.log_density - self.log_mixed + np.log(len(self.w) / 2)


class SmoothedWeights(NamedTuple):
    """Smoothed importance weights, their k-hat and their effective number.

    The effective number is the smaller one of raw and smoothed weights: smoothing reduces the
    weight of a point far from all others, in another mode, and would hide that mode from the
    evidence.
    """

    weights: Weights
    khat: float
    effective: float


def weighed(past: Past) -> SmoothedWeights:
    """Return the weights of all points, with a smoothed tail."""
    return weights_of(past.log_weight)


def weights_of(log_weight: Weights) -> SmoothedWeights:
    """Return weights with a Pareto-smoothed tail, from their logarithms up to a constant."""
    raw = relative(log_weight)
    log_smoothed, khat = smooth(raw)
    weights = softmax(log_smoothed)
    worth = min(1 / np.sum(normalised**2) for normalised in (weights, softmax(raw)))
    return SmoothedWeights(weights, float(khat), float(worth))


def relative(log_weight: Weights) -> Weights:
    """Return log weights minus the largest one, limited from below so that all are finite."""
    return np.maximum(log_weight - log_weight.max(), SMALLEST)


def as_arrays(past: Past, spent: float, mark: str) -> dict[str, np.ndarray]:
    """Return all rounds as arrays by name, for a checkpoint."""
    arrays: dict[str, Any] = {"fingerprint": mark, "wall_s": spent, **past._asdict()}
    for i, pair in enumerate(arrays.pop("rounds")):
        for half, mixture in enumerate(pair):
            arrays |= {f"{field}/{i}/{half}": v for field, v in mixture._asdict().items()}
    return {name: np.asarray(values) for name, values in arrays.items()}


def resumed(arrays: Arrays | None) -> tuple[Past | None, float]:
    """Return the rounds of a checkpoint and the time spent on them [s], or None."""
    if arrays is None:
        return None, 0.0

    def mixture(i: int, half: int) -> Mixture:
        return Mixture(*(arrays[f"{field}/{i}/{half}"] for field in Mixture._fields))

    count = sum(name.startswith("shares/") for name in arrays) // 2
    rounds = tuple((mixture(i, 0), mixture(i, 1)) for i in range(count))
    fields: dict[str, Any] = {name: arrays[name] for name in Past._fields if name != "rounds"}
    return Past(**fields, rounds=rounds), float(arrays["wall_s"])
