"""The choice of the posterior draw that represents the joint in programs that take one joint."""

from collections.abc import Mapping

import numpy as np
import xarray as xr
from jaxtyping import Float
from numpy.typing import NDArray

from jbw.errors import ConfigError, DataError
from jbw.oscillator.laws import laws_named
from jbw.verification.backbone import curves
from jbw.verification.bands import band, within
from jbw.verification.predictive_basis import Draws, Laws, count_of

# number of the most probable draws whose backbone is checked
NUM_TRIED = 64
ROUNDING = 1e-12  # relative tolerance for bands of zero width

Bands = Mapping[str, NDArray[np.float64]]


def products_of(draws: Draws, laws: Laws) -> list[tuple[str, str, Float[np.ndarray, " draw"]]]:
    """Return name, unit and values at every draw of the products that weak motion determines.

    An example is `alpha_delta`; the products are those of all laws.
    """
    products = (product for law in laws_named(laws) for product in law.products)
    return [
        (product.name, product.quantity.unit, np.asarray(product.of(draws))) for product in products
    ]


def density_of(tree: xr.DataTree) -> NDArray[np.float64]:
    """Return the log density of every draw of the main posterior [nats], one chain after another.

    Raises:
        DataError: The run stored no density.
    """
    stats = tree.children.get("sample_stats")
    if stats is None or "lp" not in stats.data_vars:
        raise DataError(
            "The result lacks the log density of its draws: the group /sample_stats has no `lp`.",
            why="Without the density, the most probable draw cannot be determined.",
            remedy="Choose a draw by its number: --draw N.",
        )
    return np.ravel(stats["lp"].transpose("chain", "draw").values)


def best_draw(
    draws: Draws,
    density: NDArray[np.float64],
    amplitude: Float[np.ndarray, " amplitude"],
    bands: Bands,
    laws: Laws,
) -> int:
    """Return the number of the most probable draw whose products and backbone are typical.

    The means along a ridge are no joint at all: the mean of alpha times that of delta is not the
    mean of alpha delta. A draw is a joint. Where a parameter ends at its bound, the draw of highest
    density may be an extreme one at that bound. The chosen draw is therefore the most probable one
    among those whose products and backbone lie within the 99 % intervals, or among all draws if
    there is none.

    Args:
        draws: Values of every draw, by parameter name.
        density: Log density of each draw [nats].
        amplitude: Amplitudes of the backbone [m].
        bands: 99 % bands of the backbone by name, `frequency` [Hz] and `damping`.
        laws: Laws of the joint.
    """
    candidates = np.isfinite(density)
    for _, _, values in products_of(draws, laws):
        candidates &= within(values, band(values))
    ranked = np.argsort(-np.where(candidates, density, -np.inf), kind="stable")
    tried = ranked[: min(NUM_TRIED, max(1, int(candidates.sum())))]
    inside = backbone_within(picked(draws, tried), amplitude, bands, laws)
    return int(tried[int(np.argmax(inside))])


def backbone_within(
    draws: Draws, amplitude: Float[np.ndarray, " amplitude"], bands: Bands, laws: Laws
) -> NDArray[np.bool_]:
    """Return for each draw whether its backbone lies inside the bands at every amplitude."""
    frequency, damping, _ = curves(draws, amplitude, laws)
    inside = np.ones(count_of(draws), bool)
    for values, edges in ((frequency, bands["frequency"]), (damping, bands["damping"])):
        lower, upper = edges[0], edges[-1]
        rounding = ROUNDING * (np.abs(lower) + np.abs(upper))
        inside &= within(values, np.array([lower - rounding, upper + rounding])).all(axis=1)
    return inside


def picked(draws: Draws, numbers: NDArray[np.intp] | list[int]) -> Draws:
    """Return the draws with the given numbers."""
    return {name: values[numbers] for name, values in draws.items()}


def stated_draw(draws: Draws, number: int) -> int:
    """Return the number of a requested draw; raise an error if there is no such draw.

    Raises:
        ConfigError: There is no such draw.
    """
    count = count_of(draws)
    if not 0 <= number < count:
        raise ConfigError(
            f"Argument `draw` must be 0 to {count - 1}, as there are {count} draws, but it is "
            f"{number}."
        )
    return number
