"""What `jbw.plots` draws for a notebook: by name, as a figure that a cell shows."""

import pytest
from matplotlib.figure import Figure

import jbw
from jbw.errors import ConfigError
from jbw.report.figures import FIGURES, figure_of


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
