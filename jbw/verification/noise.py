"""The noise that a run knows for a test, fitted or not; never a guess."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jbw.measurement.records import Test
from jbw.observables.harmonic_groups import harmonic_label
from jbw.observables.repeated import Repeats
from jbw.quantities import in_dialect
from jbw.verification.predictive_basis import Basis, Seen, seen_of

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


NOT_KNOWN = Noise(None, UNKNOWN)


def noise_of(
    basis: Basis, test: Test, repeated: Noise = NOT_KNOWN, *, label: str = "", order: int = 0
) -> Noise:
    """Noise of one repeat of a test, or of one of its harmonics.

    That of the test itself where it was fitted; else the scatter of its own repeats; else the mean
    over fitted tests of its kind and response, those of its level where there are any; else it is
    not known.

    Args:
        basis: The run.
        test: The test to predict.
        repeated: What the scatter of its own repeats tells.
        label: What its group of data is called; the test's name when empty.
        order: Order of the harmonic, where harmonics are compared.
    """
    known, wanted = noise_by_label(basis.posterior), seen_of(test)
    if (label or test.name) in known and _form(basis.seen.get(test.name, wanted)) == _form(wanted):
        return Noise(known[label or test.name], OWN)
    if repeated.std is not None:
        return repeated
    if not basis.seen:  # a run that does not say what its tests were knows of sweeps alone
        alike = {name: (None, std) for name, std in known.items() if test.traits.is_transient}
    else:
        alike = {
            name: (one.level, known[name])
            for test_name, one in {**basis.seen, test.name: wanted}.items()
            if (one.kind, one.response) == (wanted.kind, wanted.response)
            for name in _labels(test_name, one, order)
            if name in known
        }
    near = [std for level, std in alike.values() if level == test.level]
    chosen = near or [std for _, std in alike.values()]
    return Noise(float(np.mean(chosen)), ALIKE) if chosen else NOT_KNOWN


def noise_by_label(posterior: xr.Dataset) -> dict[str, float]:
    """Each labelled group of data and the mean of its noise."""
    found = {}
    for name, values in posterior.data_vars.items():
        dims = [dim for dim in values.dims if dim not in ("chain", "draw")]
        if str(name).startswith("noise_std") and len(dims) == 1 and dims[0] in values.coords:
            means = values.mean(("chain", "draw")).values
            found |= dict(zip(map(str, values[dims[0]].values), map(float, means), strict=True))
    return found


def of_repeats(repeats: Repeats, group: int = 0) -> Noise:
    """What the scatter of a group's repeats tells.

    Args:
        repeats: Repeats of the test's groups.
        group: Which of them.
    """
    count, within = float(repeats.num_repeats[group]), float(repeats.within[group])
    if count < 2:
        return NOT_KNOWN
    return Noise(float(np.sqrt(within / (float(repeats.size[group]) * (count - 1)))), REPEATS)


def of_samples(measured: Float[np.ndarray, "repeat time"], size: int) -> Noise:
    """What the scatter of repeats of one record tells, of which `size` values are independent."""
    if len(measured) < 2:
        return NOT_KNOWN
    within = np.sum((measured - measured.mean(axis=0)) ** 2)
    return Noise(float(np.sqrt(within / (size * (len(measured) - 1)))), REPEATS)


def of_decays(posterior: xr.Dataset, unit: str) -> Noise:
    """Mean noise of the free decays that were fitted, where they were measured in this unit."""
    stored = posterior.get("noise_std")
    if stored is None or "record" not in stored.dims:
        return NOT_KNOWN
    if in_dialect(stored.attrs.get("units", "")) != unit:
        return NOT_KNOWN
    return Noise(float(stored.mean()), ALIKE)


def _form(seen: Seen) -> tuple[str, str, str]:
    return seen.kind, seen.source, seen.response


def _labels(name: str, seen: Seen, order: int) -> tuple[str, ...]:
    """What the groups of data of a test may be called that hold its harmonic of this order."""
    names = (name, seen.family) if seen.family else (name,)
    if not order:
        return names
    return (*(harmonic_label(one, order) for one in names), *(names if order == 1 else ()))
