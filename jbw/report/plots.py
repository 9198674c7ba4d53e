"""Figures of results, public as `jbw.plots`: runs, laws, populations, predictions.

`draw` draws a figure of a run's report by its name, `laws` draws the tree of `jbw.compare_laws`,
and `prediction` the bands of `Study.predict`. A notebook shows the returned figure.

Examples:
    The first figure of a report is drawn by its name:

    >>> import jbw; jbw.enable_x64()
    >>> campaign = jbw.rig.measure(tests=["sweep_0p20V"], repeats=2, fs=256.0, noise_ratio=0.02)
    >>> study = jbw.identify(campaign, quick=True)
    >>> jbw.plots.draw(study.tree, "backbone").savefig("backbone.png")
    >>> print([name for name in jbw.plots.names() if name.startswith("b")])
    ['backbone']
"""

import xarray as xr
from matplotlib.figure import Figure

from jbw.errors import ConfigError
from jbw.report.figures import FIGURES, figure_of
from jbw.report.laws import laws_figure
from jbw.report.loops import enclosed_areas
from jbw.report.population import population_figure
from jbw.report.prediction import prediction as prediction_panels

__all__ = ["draw", "enclosed_areas", "laws", "names", "population_figure", "prediction"]


def names() -> tuple[str, ...]:
    """Return the names of the report's figures, in the report's order."""
    return tuple(FIGURES)


def draw(tree: xr.DataTree, name: str) -> Figure:
    """Draw a figure of a run's report by its name, such as "figure_7" or "backbone".

    Args:
        tree: Result of a run, from `Study.tree` or `posterior.nc`.
        name: One of `jbw.plots.names()`.

    Raises:
        ConfigError: No figure has that name.
    """
    if name not in FIGURES:
        raise ConfigError(
            f"Argument `name` must be the name of a figure, not {name!r}.",
            remedy=f"Give one of these names: {', '.join(FIGURES)}.",
        )
    return figure_of(FIGURES[name](tree))


def laws(tree: xr.DataTree) -> Figure:
    """Draw a comparison of laws: curves, loops, residuals and errors of held-out sessions.

    Args:
        tree: Tree of `jbw.compare_laws`.
    """
    return figure_of(laws_figure(tree))


def prediction(name: str, bands: xr.Dataset) -> Figure:
    """Draw the predicted bands of a test with its measured values.

    Args:
        name: Title of the figure.
        bands: Result of `Study.predict`.
    """
    return figure_of(prediction_panels(name, bands))
