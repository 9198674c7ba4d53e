"""What `jbw.plots` draws for a notebook: by name, as a figure that a cell shows."""

import pytest
import xarray as xr
from matplotlib.figure import Figure

import jbw
from jbw.errors import ConfigError
from jbw.report.figures import FIGURES, figure_of
from jbw.report.measured_points import draw_free_band
from jbw.report.style import panels


def test_a_figure_is_drawn_by_its_name(tree):
    drawn = jbw.plots.draw(tree, "backbone")
    assert isinstance(drawn, Figure)
    labels = [ax.get_ylabel() for ax in drawn.axes]
    assert labels == [ax.get_ylabel() for ax in figure_of(FIGURES["backbone"](tree)).axes]
    assert labels[0].startswith("natural frequency")


def test_an_unknown_figure_is_refused_with_those_there_are(tree):
    with pytest.raises(ConfigError, match="not 'figure_3'") as error:
        jbw.plots.draw(tree, "figure_3")
    assert all(name in str(error.value) for name in jbw.plots.names())


def test_a_band_that_widens_without_end_does_not_move_the_axes():
    band = xr.Dataset(
        {"frequency": (("quantile", "amplitude"), [[1.0, 0.0], [2.0, 2.0], [3.0, 9e9]])},
        {"amplitude": [0.1, 1.0]},
    )
    (ax,) = panels(None, 1, 1, height=3.0)[0]
    ax.plot([0.1, 1.0], [1.5, 2.5])
    limits = ax.get_ylim()
    draw_free_band(ax, xr.DataTree.from_dict({"/free_law": band}), "frequency", 1e3, 2.0)
    assert ax.get_ylim() == limits
    low, high = (line.get_xydata().tolist() for line in ax.lines[1:])
    assert low == [[100.0, 2.0], [1000.0, 0.0]]
    assert high == [[100.0, 6.0], [1000.0, 18e9]]
