"""Repetition of fits without parts of the data."""

import logging
from collections.abc import Collection, Hashable, Mapping
from typing import NamedTuple

from jbw.identification.prepare import refit
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box
from jbw.observables.dataset import Dataset
from jbw.observables.noise import silenced

under_way = logging.getLogger("jbw.progress")


class HeldOut(NamedTuple):
    """Held-out data groups, with the fit to all other groups.

    Attributes:
        labels: Labels of the held-out groups.
        rest: The dataset of the same shapes, in which the held-out groups have no weight.
        fit: The fit to the other groups.
    """

    labels: tuple[str, ...]
    rest: Dataset
    fit: Fit


def held_out[Piece: Hashable](
    pieces: Mapping[Piece, Collection[str]],
    best: Fit,
    prior: Box,
    data: Dataset,
    stage: str = "",
) -> dict[Piece, HeldOut]:
    """Repeat a fit, each time without one part of the data; return the fits by omitted part.

    Args:
        pieces: Labels of the groups of each piece.
        best: The fit of all data, from which each fit starts.
        prior: Bounds of the parameters.
        data: The dataset of all fitted tests.
        stage: Progress message that takes the number of a piece and the number of pieces; empty for
            none.
    """
    table: dict[Piece, HeldOut] = {}
    for place, (piece, labels) in enumerate(pieces.items(), start=1):
        if stage:
            under_way.info(stage, place, len(pieces))
        rest = silenced(labels, data)
        table[piece] = HeldOut(tuple(labels), rest, refit(best, prior, rest))
    return table


def labels_by_run(data: Dataset) -> dict[str, list[str]]:
    """Return the labels of the data groups of each run."""
    labels: dict[str, list[str]] = {}
    for label, run in zip(data.labels, data.runs, strict=True):
        labels.setdefault(run, []).append(label)
    return labels
