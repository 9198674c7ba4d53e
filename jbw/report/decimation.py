"""Fewer points for the interactive page: the extremes of a curve stay, its size does not."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Values = Float[np.ndarray, " point"]


class CurvePoints(NamedTuple):
    """A curve or the outline of a band, not a number between its parts."""

    x: Values
    y: Values


def shared_limit(sizes: Sequence[int], total: int) -> int:
    """The most points a curve may have so that all together have `total` at most; two at least."""
    low, high = 2, max([2, *sizes])
    while low < high:
        middle = (low + high + 1) // 2
        fits = sum(min(size, middle) for size in sizes) <= total
        low, high = (middle, high) if fits else (low, middle - 1)
    return low


def decimated(points: CurvePoints, most: int) -> CurvePoints:
    """The least and the largest ordinate of every stretch, in their order, `most` points or so.

    Each part between values that are no numbers keeps its first and last point, so that a band
    stays closed and a gap stays a gap; a curve of `most` points or fewer is returned as it is.
    """
    size = len(points.x)
    if size <= most:
        return points
    width = max(1, int(np.ceil(2 * size / max(most, 1))))  # two points remain of each stretch
    gaps = np.flatnonzero(~(np.isfinite(points.x) & np.isfinite(points.y)))
    ends = np.concatenate([[-1], gaps, [size]])
    indices = [gaps]
    for start, stop in zip(ends[:-1] + 1, ends[1:], strict=True):
        part = points.y[start:stop]
        if len(part):
            indices.append(start + _extremes(part, width))
    order = np.unique(np.concatenate(indices))
    return CurvePoints(points.x[order], points.y[order])


def _extremes(y: Values, width: int) -> np.ndarray:
    """Places of the least and the largest value of every stretch, and of both ends."""
    starts = np.arange(0, len(y), width)
    padded = np.append(y, np.full(-len(y) % width, y[-1])).reshape(-1, width)
    extremes = (starts + padded.argmin(axis=1), starts + padded.argmax(axis=1))
    return np.minimum(np.concatenate([[0], *extremes, [len(y) - 1]]), len(y) - 1)
