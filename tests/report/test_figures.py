"""Every figure draws what the contract of the result says, and says what it cannot draw."""

import shutil
import sys

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from PIL import Image

from jbw.cli.drawing import DrawingProcess
from jbw.errors import ConfigError, DataError
from jbw.report import figures
from jbw.report.figures import FIGURE_LIST, FIGURES, Files, draw_figures, figure_of, svg
from jbw.report.formats import FORMATS, formats_of
from jbw.report.style import band_label

# The paper's figure 3 shows the rig itself.
NUMBERED = [f"figure_{number}" for number in (1, 2, *range(4, 14))]
WITHOUT_AXES = {"figure_2"}


@pytest.fixture(scope="module")
def drawn(tree):
    return {entry.name: figure_of(entry.draw(tree)) for entry in FIGURE_LIST}


def test_the_papers_figures_are_there_by_number():
    assert set(NUMBERED) <= set(FIGURES)
    assert all(getattr(figures, name) is FIGURES[name] for name in NUMBERED)


def test_the_list_of_figures_is_complete():
    assert len({entry.slug for entry in FIGURE_LIST}) == len(FIGURES) == len(FIGURE_LIST)
    with pytest.raises(AttributeError, match="figure_3"):
        _ = figures.figure_3


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_says_its_unit(drawn, name):
    # Panels of one row or column share the label of the first or the last.
    for shown in (ax for ax in drawn[name].axes if ax.get_visible()):
        labels = [shown.get_xlabel(), shown.get_ylabel()]
        assert all("[" in label for label in labels if label)
    assert any(ax.get_xlabel() for ax in drawn[name].axes) == (name not in WITHOUT_AXES)


@pytest.mark.parametrize("name", FIGURES)
def test_texts_stay_on_the_figure_and_apart(drawn, name):
    figure = drawn[name]
    figure.draw_without_rendering()
    canvas = figure.bbox.padded(2.0)
    texts = [ax.title for ax in figure.axes] + [ax._left_title for ax in figure.axes]
    texts += [axis.label for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)]
    texts += [text for legend in figure.legends for text in legend.get_texts()]
    boxes = [text.get_window_extent() for text in texts if text.get_text() and text.get_visible()]
    for box in boxes:
        assert canvas.x0 <= box.x0
        assert box.x1 <= canvas.x1
        assert canvas.y0 <= box.y0
        assert box.y1 <= canvas.y1
    for first, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[first + 1 :])


@pytest.mark.fault(57)
def test_no_display_and_no_heavy_library_is_touched(drawn):
    assert all(type(figure) is Figure for figure in drawn.values())
    assert "matplotlib.pyplot" not in sys.modules or not matplotlib.pyplot.get_fignums()


def test_the_ridge_has_no_panel_without_draws(tree):
    posterior_alone = xr.DataTree.from_dict({"/posterior": tree["posterior"].to_dataset()})
    (only,) = FIGURES["ridge"](posterior_alone).flat
    assert only.get_title(loc="left") == "Step 4, all parameters, enlarged"
    draws = [line for line in only.lines if line.get_marker() == "."]
    np.testing.assert_array_equal(draws[0].get_ydata(), tree["posterior"]["alpha"].values.ravel())


def test_a_level_has_one_colour_in_every_panel(drawn):
    colours = {}
    for line in (line for ax in drawn["curves"].axes for line in ax.lines):
        if not line.get_label().startswith("_"):
            colours.setdefault(line.get_label().partition(",")[0], set()).add(line.get_color())
    assert len(colours) > 2
    assert all(len(of_level) == 1 for of_level in colours.values())
    assert len({next(iter(of_level)) for of_level in colours.values()}) == len(colours)


def test_measured_phases_stay_with_the_model(drawn):
    for ax in (ax for ax in drawn["curves"].axes if ax.get_ylabel() == "phase [°]"):
        measured = [line.get_ydata() for line in ax.lines if line.get_marker() in "o^"]
        # The toy's measured phases follow the model's to some degrees: no jump of half a turn.
        assert all(np.abs(np.diff(phase)).max() < 90 for phase in measured if len(phase) > 1)


def test_loops_of_one_level_are_told_apart_by_their_tests(tree):
    same = dict.fromkeys(("day 1", "day 2"), next(iter(tree["validation/loops"].children.values())))
    of_days = xr.DataTree.from_dict(
        {f"/validation/loops/{n}": x.to_dataset() for n, x in same.items()}
    )
    upper = figure_of(FIGURES["figure_13"](of_days)).axes[:2]
    assert [ax.get_title(loc="left").partition(",")[0] for ax in upper] == ["day 1", "day 2"]


def test_the_callers_axes_are_used_and_returned(tree):
    figure = Figure()
    ax = figure.subplots()
    assert FIGURES["figure_5"](tree, ax=ax) is ax
    pair = figure.subplots(1, 2)
    assert list(FIGURES["ridge"](tree, ax=pair).flat) == list(pair)
    with pytest.raises(ConfigError, match="must contain 6 axes"):
        FIGURES["figure_4"](tree, ax=pair)


def test_bands_are_named_for_what_they_are(drawn):
    labels = [text.get_text() for text in drawn["figure_12"].legends[0].get_texts()]
    assert "99 % band: parameters alone" in labels
    assert "99 % band: parameters and noise" in labels
    assert "99 % band of the measured repeats" in labels


@pytest.mark.parametrize(
    ("attrs", "noise", "label"),
    [
        ({}, False, "99 % band: parameters alone"),
        ({"scatter": 0}, True, "99 % band: parameters and noise"),
        ({"scatter": 1}, False, "99 % band: parameters and scatter of runs"),
        ({"scatter": 1}, True, "99 % band: parameters, scatter of runs and noise"),
        ({"discrepancy": 1}, True, "99 % band: parameters, model discrepancy and noise"),
    ],
)
def test_a_legend_says_what_is_in_its_band(tree, attrs, noise, label):
    assert band_label(attrs, noise=noise) == label
    groups = {
        f"/verification/sweep/{name}": test.to_dataset().assign_attrs(attrs)
        for name, test in tree["verification/sweep"].children.items()
    }
    drawn = FIGURES["figure_12"](xr.DataTree.from_dict(groups))
    texts = [text.get_text() for text in drawn.flat[0].figure.legends[0].get_texts()]
    assert label in texts


@pytest.mark.parametrize("name", FIGURES)
def test_a_missing_group_is_one_sentence(name):
    with pytest.raises(DataError, match="result has no"):
        FIGURES[name](xr.DataTree())


def test_a_missing_variable_is_named(tree):
    bare = xr.DataTree.from_dict(
        {"/verification/spectrum": tree["verification/spectrum"].to_dataset()}
    )
    bare["verification/h3"] = xr.DataTree(
        tree["verification/h3"].to_dataset().drop_vars("measured_phase")
    )
    with pytest.raises(DataError, match="lacks measured_phase"):
        FIGURES["figure_6"](bare)


def test_files_are_named_in_order_and_are_pictures(tree, tmp_path):
    part = xr.DataTree.from_dict(
        {
            "/steps/linear": tree["steps/linear"].to_dataset(),
            "/steps/opening_nuts/posterior": tree["steps/opening_nuts/posterior"].to_dataset(),
        }
    )
    draw_figures(part, Files(tmp_path / "figures", ["png"]))
    names = ["figure_04_linear_frf.png", "figure_10_opening_posterior.png", "extra_routes.png"]
    assert {path.name for path in (tmp_path / "figures").iterdir()} == set(names)
    with Image.open(tmp_path / "figures" / names[0]) as picture:
        assert picture.width == round(7.2 * 130)


@pytest.fixture(scope="module")
def saved(tree, tmp_path_factory):
    """A small result, and the file where it is saved."""
    names = ("steps/linear", "steps/opening_nuts/posterior")
    groups = {f"/{name}": tree[name].to_dataset() for name in names}
    small = xr.DataTree.from_dict(groups)
    path = tmp_path_factory.mktemp("saved") / "posterior.nc"
    small.to_netcdf(path, engine="h5netcdf")
    return small, path


def test_a_process_beside_draws_the_same(saved, tmp_path):
    """Pictures and what the page takes, byte by byte."""
    small, path = saved
    here = draw_figures(small, Files(tmp_path / "here", FORMATS))
    with DrawingProcess() as process:
        assert draw_figures(small, Files(tmp_path / "beside", FORMATS), (process, path)) == here
    pictures = sorted((tmp_path / "here").iterdir())
    endings = {picture.suffix for picture in pictures if picture.stem == "figure_04_linear_frf"}
    assert endings == {".png", ".svg", ".pdf"}
    for picture in pictures:
        assert picture.read_bytes() == (tmp_path / "beside" / picture.name).read_bytes()


@pytest.mark.parametrize("program", ["no such program", shutil.which("false"), None])
def test_all_is_drawn_here_where_no_process_beside_can(saved, tmp_path, monkeypatch, program):
    small, path = saved
    monkeypatch.setattr(sys, "executable", program or sys.executable)
    # The last can start, but finds no result.
    where = path if program else path.with_name("missing.nc")
    with DrawingProcess() as process:
        drawn = draw_figures(small, Files(tmp_path, ["png"]), (process, where))
    assert drawn["figure_4"].svg
    assert drawn == draw_figures(small, Files(tmp_path / "again", ["png"]))
    assert (tmp_path / "figure_04_linear_frf.png").is_file()


def test_the_page_needs_no_files(saved, tmp_path):
    """A process beside draws for the page alone where no format is asked for."""
    small, path = saved
    with DrawingProcess() as process:
        drawn = draw_figures(small, None, (process, path))
    assert drawn["figure_4"].svg.startswith("<svg")
    assert drawn["figure_10"].svg.startswith("<svg")
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_figure_that_fails_leaves_no_file_in_any_format(saved, tmp_path, monkeypatch):
    small, _ = saved
    monkeypatch.setattr(figures, "svg", lambda *_: 1 / 0)
    drawn = draw_figures(small, Files(tmp_path, FORMATS))
    assert "ZeroDivisionError" in drawn["figure_4"].missing
    assert not list(tmp_path.iterdir())


def test_a_pdf_has_its_fonts_within_as_journals_ask(saved, tmp_path):
    small, _ = saved
    draw_figures(small, Files(tmp_path, ["pdf"]))
    content = (tmp_path / "figure_04_linear_frf.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert b"/FontFile2" in content  # TrueType
    assert b"/Type3" not in content


def test_a_process_beside_ends_with_its_command():
    with DrawingProcess() as process:
        child = process._process
        assert child is not None
        assert child.poll() is None
    assert child.poll() is not None
    with DrawingProcess() as process:
        process._process.stdin.close()  # as where the command was killed
        assert process._process.wait(60) == 0


def test_the_measured_peak_falls_with_the_level(drawn):
    # The toy resonances lie at 18.8 Hz (1 - 0.15 level): 18.66, 18.52, 18.24 Hz.
    labels = [text.get_text() for text in drawn["figure_5"].legends[0].get_texts()]
    peaks = [float(label.split("peak at ")[1].removesuffix(" Hz")) for label in labels]
    # Half a line of the spectrum, 1/128 Hz, and as much again for the noise on a flat peak.
    np.testing.assert_allclose(peaks, [18.659, 18.518, 18.236], atol=0.05)


def test_svg_follows_the_theme_and_keeps_its_ids_to_itself(drawn):
    text = svg(drawn["figure_10"], "figure_10")
    assert text.startswith("<svg")
    assert "var(--ink)" in text
    assert "#0072b2" not in text
    assert 'id="figure_10-' in text
    assert "url(#figure_10-" in text
    assert text == svg(drawn["figure_10"], "figure_10")


def test_formats_are_named_in_any_spelling_and_a_slip_is_refused():
    assert formats_of(["PNG", " .pdf", "png"], "Option --figures") == ("png", "pdf")
    assert formats_of([], "Option --figures") == ()
    with pytest.raises(ConfigError, match=r"Option --figures must name formats .* 'jpg'"):
        formats_of(["png", "jpg"], "Option --figures")
