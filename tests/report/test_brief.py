"""The brief: one page of A4 on which nothing overlaps, with the verdict first."""

import datetime
import json
import re

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

from jbw.cli.result import report
from jbw.errors import ConfigError
from jbw.report.brief import HEIGHT, WIDTH, draw_brief, write_brief
from jbw.report.messages.brief import USE
from jbw.results.run import RunSummary

DAY = datetime.date(2026, 11, 26)
LONG = '$x_{ & </b> "quoted" 試験 \u202e' + 40 * "bolt" + " " + 30 * "a word "


def texts(figure):
    """All texts that are seen, of the page, its axes and its legends."""
    drawn_texts = [
        *figure.texts,
        *(text for legend in figure.legends for text in legend.get_texts()),
    ]
    for ax in figure.axes:
        drawn_texts += [ax.title, ax._left_title, ax.xaxis.label, ax.yaxis.label]
        low, high = sorted(ax.get_xlim())
        drawn_texts += [t.label1 for t in ax.xaxis.get_major_ticks() if low <= t.get_loc() <= high]
        low, high = sorted(ax.get_ylim())
        drawn_texts += [t.label1 for t in ax.yaxis.get_major_ticks() if low <= t.get_loc() <= high]
    return [text for text in drawn_texts if text.get_text() and text.get_visible()]


def require_order(figure):
    """Every text lies on the page, and none on another or on axes that are not its own."""
    figure.draw_without_rendering()
    shown = texts(figure)
    boxes = [text.get_window_extent() for text in shown]
    margin = 0.3 * figure.dpi
    for text, box in zip(shown, boxes, strict=True):
        assert margin < box.x0, text
        assert box.x1 < WIDTH * figure.dpi - margin, text
        assert margin < box.y0, text
        assert box.y1 < HEIGHT * figure.dpi - margin, text
        if text.axes is None:
            assert not any(box.overlaps(ax.get_window_extent()) for ax in figure.axes), text
    for i, box in enumerate(boxes):
        for text, other in zip(shown[i + 1 :], boxes[i + 1 :], strict=True):
            assert not box.overlaps(other), (shown[i], text)


def num_pages(pdf):
    return len(re.findall(rb"/Type\s*/Page(?!s)", pdf))


def words(figure):
    return " ".join(text.get_text() for text in figure.texts)


def failed(summary):
    summary["verdict"] = {
        "status": "failed",
        "findings": [
            {"code": "r_hat", "status": "ok", "reason": "Chains agree.", "action": ""},
            {
                "code": "law",
                "status": "failed",
                "reason": "The law fails.",
                "action": "Try another.",
            },
        ],
    }
    return summary


def several_modes(tree):
    posterior = tree["posterior"].to_dataset()
    more = {"omega_2": 2.5 * posterior["omega_n"], "zeta_2": 2 * posterior["zeta"]}
    parts = {node.path: node.to_dataset() for node in tree.subtree if node.path != "/posterior"}
    return xr.DataTree.from_dict({**parts, "/posterior": posterior.assign(more)})


def test_nothing_overlaps_on_the_page(tree, summary):
    require_order(draw_brief(RunSummary.read(summary), tree, DAY))
    assert num_pages(write_brief(RunSummary.read(summary), tree, DAY)) == 1


@pytest.mark.filterwarnings("ignore:Glyph")  # the font lacks it: a box
def test_long_names_and_many_tests_stay_on_the_page(tree, summary):
    summary["campaign"] = LONG
    failed(summary)["verdict"]["findings"][1] |= {"reason": LONG, "action": LONG}
    summary["tests"] = [
        {
            "test": f"{LONG} {i}",
            "kind": LONG,
            "level": 1e-7 * i,
            "level_unit": LONG,
            "fitted": i % 2,
        }
        for i in range(40)
    ]
    figure = draw_brief(RunSummary.read(summary), tree, DAY)
    require_order(figure)
    assert "more lines: see report.html" in words(figure)
    assert num_pages(write_brief(RunSummary.read(summary), tree, DAY)) == 1


def test_a_failed_verdict_is_said_before_any_number(tree, summary):
    page_words = words(draw_brief(RunSummary.read(failed(summary)), tree, DAY))
    assert page_words.index(USE["failed"]) < page_words.index("The law fails. Try another.")
    assert page_words.index("The law fails.") < page_words.index("RMS error")
    fine = {"status": "ok", "findings": []}
    assert USE["ok"] in words(draw_brief(RunSummary.read({**summary, "verdict": fine}), tree, DAY))
    doubt = {"status": "not assessed", "findings": []}
    assert "provisional" in words(
        draw_brief(RunSummary.read({**summary, "verdict": doubt}), tree, DAY)
    )


def test_numbers_are_those_of_the_backbone(tree, summary):
    """At the largest fitted amplitude: its frequency, and Q = 1/(2 zeta) with swapped ends."""
    group = tree["verification/backbone"].to_dataset()
    y_peak = group.attrs["y_fitted"]
    at = group.interp(amplitude=y_peak)
    page_words = words(draw_brief(RunSummary.read(summary), tree, DAY))
    assert f"{1e3 * y_peak:.3g} mm" in page_words
    hertz = float(at["frequency"].values[1])
    shown = [float(x) for x in re.findall(r"(\d+\.\d+) \[", page_words)]
    assert np.min(np.abs(np.array(shown) - hertz)) < 1e-3 * hertz
    quality = 0.5 / np.asarray(at["damping"].values, float)[::-1]
    rows = re.findall(r"([\d.]+) \[([\d.]+), ([\d.]+)\]", page_words)
    ends = np.array(rows, float)[:, [1, 0, 2]]
    assert np.min(np.abs(ends / quality - 1).max(axis=1)) < 2e-2  # as it is rounded
    assert "2026-11-26" in page_words


def test_several_modes_have_a_table_of_their_own(tree, summary):
    both = several_modes(tree)
    figure = draw_brief(RunSummary.read(summary), both, DAY)
    require_order(figure)
    page_words = words(figure)
    assert "of the first mode" in page_words
    assert "mode 2" in page_words
    second = 2.5 * float(tree["posterior"]["omega_n"].median()) / (2 * np.pi)
    assert f"{second:.1f}" in page_words
    assert "mode 2" not in words(draw_brief(RunSummary.read(summary), tree, DAY))


def test_another_law_and_a_bare_run_have_their_page(tree, summary):
    iwan = tree.copy()
    iwan.attrs = {**tree.attrs, "laws": '["iwan4", "cubic"]'}
    assert "iwan4 and cubic spring" in words(draw_brief(RunSummary.read(summary), iwan, DAY))
    bare = draw_brief(RunSummary.read({}), xr.DataTree(), DAY)
    require_order(bare)
    assert "provisional" in words(bare)
    assert num_pages(write_brief(RunSummary.read({}), xr.DataTree(), DAY)) == 1


def test_the_command_writes_one_page_and_nothing_else(tree, summary, tmp_path):
    part = xr.DataTree.from_dict({"/posterior": tree["posterior"].to_dataset()})
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    part.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    done = CliRunner().invoke(report, [str(tmp_path), "--brief", "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.output) == {"brief": str(tmp_path / "brief.pdf")}
    assert (tmp_path / "brief.pdf").read_bytes().startswith(b"%PDF")
    assert {path.name for path in tmp_path.iterdir()} == {
        "summary.json", "posterior.nc", "brief.pdf",
    }  # fmt: skip
    other = CliRunner().invoke(report, [str(tmp_path), "--brief", "--out", "page.html"])
    assert isinstance(other.exception, ConfigError)
    assert "--out brief.pdf" in str(other.exception)
    both = CliRunner().invoke(report, [str(tmp_path), "--brief", "--interactive"])
    assert both.exit_code == 2


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.parametrize("name", ["a" * 300, "\t\n", "🔩 " * 60, "Ünïcödé"])
def test_any_name_is_shortened_to_its_line(name):
    figure = draw_brief(RunSummary.read({"campaign": name}), xr.DataTree(), DAY)
    require_order(figure)
    assert num_pages(write_brief(RunSummary.read({"campaign": name}), xr.DataTree(), DAY)) == 1
