"""In which parameters the joint posterior lives, and within which bounds."""

from collections.abc import Mapping
from typing import NamedTuple

from jbw.campaign.settings import Identify
from jbw.identification.priors import joint_box, stated
from jbw.inference.fit.fitting import Fit
from jbw.inference.space.box import Box, box
from jbw.observables.dataset import Dataset, largest_displacement
from jbw.oscillator.law import Bounds, Coordinates, Law
from jbw.oscillator.laws import laws_named

PAPER = "paper"  # the laws' own parameters


class Chosen(NamedTuple):
    """A law's other coordinates, chosen to sample in.

    Attributes:
        law: The law.
        coordinates: Which of its coordinates.
    """

    law: type[Law]
    coordinates: Coordinates

    @property
    def sentence(self) -> str:
        """What is sampled and why, in words."""
        names, own = (
            [quantity.name for quantity in table]
            for table in (self.law.table, self.coordinates.table)
        )
        *most, last = names
        meanings = "; ".join(quantity.meaning for quantity in self.coordinates.table)
        return (
            f"The data know {', '.join(most)} and {last} by their products alone: "
            f"{', '.join(own)} are sampled in their place ({meanings})."
        )


def box_of(settings: Identify, data: Dataset, known: Mapping[str, float]) -> Box:
    """Box of the joint route: the joint's parameters, and the gain, where they are not held.

    Args:
        settings: The campaign's [identify] table.
        data: The dataset.
        known: First values of omega_n, zeta and gain.

    Returns:
        The box, the campaign's own bounds where it states them.
    """
    # Where nothing tells of damping, the displacement is prescribed in every test.
    forced = all("zeta" not in part.informs for part in data.parts)
    omega_n = known.get("omega_n") or _stiffest(data) ** 0.5
    gain = None if "gain" in data.held else (known["gain"], min(p.gain_std() for p in data.parts))
    prior = joint_box(
        settings,
        omega_n,
        known.get("zeta", 0.01),
        gain,
        largest_displacement(data, omega_n),
        laws=data.laws,
        linear=any(part.is_linear for part in data.parts),
        forced=forced,
    )
    return box({name: pair for name, pair in bounds_of(prior).items() if name not in data.held})


def bounds_of(prior: Box) -> Bounds:
    """Bounds of a box by name."""
    sides = zip(prior.names, prior.lower, prior.upper, strict=True)
    return {name: (float(low), float(high)) for name, low, high in sides}


def _stiffest(data: Dataset) -> float:
    """Force over displacement of the stiffest loop, peak to peak, per unit mass [1/s^2]."""
    gain = float(data.held.get("gain", 1.0))
    found = [part.stiffness(gain) for part in data.parts]
    return max(value for value in found if value is not None)


def chosen_coordinates(best: Fit, settings: Identify, laws: tuple[str, ...]) -> list[Chosen]:
    """Coordinates to sample in, law by law: its products where no more is known.

    A campaign says so by `coordinates`; otherwise, where it bounds none of the law's parameters
    itself and the fit leaves one of them open.

    Args:
        best: The fit, in the laws' own parameters or already in other coordinates.
        settings: The campaign's [identify] table.
        laws: Names of the laws.
    """
    found = []
    for law in laws_named(laws):
        own, asked = set(law.names()), settings.coordinates
        if not own <= best.theta.keys():
            continue
        weak = set() if best.weak is None else own & set(best.weak.names)
        is_open = bool(weak) and not own & set(stated(settings))
        for name, coordinates in law.coordinates.items():
            if asked == name or (asked == "auto" and is_open):
                found.append(Chosen(law, coordinates))
                break
    return found


def coordinate_box(
    prior: Box, theta: Mapping[str, float], settings: Identify, chosen: Chosen
) -> Box:
    """Box of a law's other coordinates about a fit, that of the other parameters kept.

    Args:
        prior: The box of the laws' own parameters.
        theta: The fit, in these.
        settings: The campaign's [identify] table, whose own bounds count.
        chosen: The coordinates.
    """
    bounds, (law, coordinates) = bounds_of(prior), chosen
    other = law.coordinate_bounds(coordinates.name, bounds, theta, stated(settings))
    found: Bounds = {}
    for name, pair in bounds.items():
        if name not in law.names():
            found[name] = pair
        elif not other.keys() <= found.keys():
            found |= other
    return box(found)
