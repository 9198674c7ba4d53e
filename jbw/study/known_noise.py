"""The noise that a run's posterior knows for a test, fitted or not; never a guess."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from jbw.measurement.records import Record, Test
from jbw.observables.repeats import Repeats
from jbw.prediction import noise_of_mean
from jbw.study.basis import Seen, seen_of

OWN = "of this test, as fitted"
ALIKE = "mean of the fitted tests of its kind"
REPEATS = "scatter of the test's own repeats"
UNKNOWN = "not known: band of the parameters alone"
LEFT_OUT = "left out, as asked: band of the parameters alone"


class Noise(NamedTuple):
    """Noise of one repeat of a test.

    Attributes:
        std: Its standard deviation, in the unit of what is compared; None where the band is that
            of the parameters alone.
        says: Where it is known from, or why not.
    """

    std: float | None
    says: str


def noise_of(
    posterior: xr.Dataset,
    seen: Mapping[str, Seen],
    test: Test,
    label: str = "",
    order: int | None = None,
) -> Noise:
    """Noise of one repeat, as the posterior knows it.

    That of the test itself where it was fitted; else the mean over fitted tests of its kind and
    response; else the scatter of its own repeats of one input; else it is not known.

    Args:
        posterior: The main posterior.
        seen: Tests of the run's campaign by name; none where the run does not say.
        test: The test to predict.
        label: What its group of data is called; the test's name when empty.
        order: Order of the harmonic, where harmonics are compared.
    """
    known = dict(_groups(posterior))
    label = label or test.name
    if label in known and _same_form(seen, test):
        return Noise(known[label], OWN if label.startswith(test.name) else ALIKE)
    ending = "" if order is None or test.kind == "frf" else f" order {order}"
    alike = [
        std
        for name, std in known.items()
        if name.endswith(ending) and _alike(seen, name.removesuffix(ending), test)
    ]
    if alike:
        return Noise(float(np.mean(alike)), ALIKE)
    return Noise(None, UNKNOWN)


def or_of_repeats(noise: Noise, repeats: Repeats, group: int = 0) -> Noise:
    """A noise, or where it is not known that of a test's own repeats.

    Args:
        noise: What the posterior knows.
        repeats: Repeats of the test's groups.
        group: Which of them.
    """
    found = noise_of_mean(repeats, group)
    if noise.std is not None or found is None:
        return noise
    return Noise(found * float(np.sqrt(repeats.num_repeats[group])), REPEATS)


def _groups(posterior: xr.Dataset) -> Iterator[tuple[str, float]]:
    """Each labelled group of data and the mean of its noise."""
    for name, values in posterior.data_vars.items():
        dims = [dim for dim in values.dims if dim not in ("chain", "draw")]
        if not str(name).startswith("noise_std") or len(dims) != 1 or dims[0] not in values.coords:
            continue
        for label in values[dims[0]].values:
            yield str(label), float(values.sel({dims[0]: label}).mean())


def _same_form(seen: Mapping[str, Seen], test: Test) -> bool:
    """Whether a test of this name in the run was of this kind, source and response."""
    return not seen or seen.get(test.name, seen_of(test)) == seen_of(test)


def _alike(seen: Mapping[str, Seen], name: str, test: Test) -> bool:
    """Whether a fitted group is of a test's kind and response.

    Tones of one level make one group, called after the level. A run that does not say what its
    tests were has labels of sweeps alone.
    """
    wanted = seen_of(test)
    if not seen:
        return test.kind == "sweep"
    if name.startswith("tones ") and name not in seen:
        return wanted.kind == "tones"
    found = seen.get(name)
    return found is not None and (found.kind, found.response) == (wanted.kind, wanted.response)


def repeated(test: Test) -> tuple[Record, ...]:
    """Repeats of the first record's input; the first alone where every repeat has its own."""
    first = test.records[0]
    source = first.channels[first.source]
    size = 0.1 * np.linalg.norm(source)  # noise of the input channel is far below
    same = [
        record
        for record in test.records
        if record.num_samples == first.num_samples
        and np.linalg.norm(record.channels[record.source] - source) <= size
    ]
    return tuple(same)
