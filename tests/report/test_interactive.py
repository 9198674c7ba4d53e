"""The interactive page: every chart's numbers, nothing from the network, no name trusted."""

import base64
import builtins
import gzip
import json
import re

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from matplotlib.figure import Figure

from jbw.cli.result import report
from jbw.errors import ConfigError, DataError
from jbw.report import page
from jbw.report.charts import charts_of, decimated, shared_limit, traces
from jbw.report.page import render_interactive, write_interactive
from jbw.report.text import plain

HOSTILE = "</script><script>alert(1)</script> & <a href='javascript:x'>"


@pytest.fixture(scope="module")
def few(tree):
    """A result with two charts."""
    group = tree["verification/backbone"].to_dataset()
    return xr.DataTree.from_dict({"/verification/backbone": group})


def test_every_kind_of_response_has_a_chart(tree):
    charts = charts_of(tree)
    kinds = {chart.heading.split()[0] for chart in charts}
    assert kinds == {
        "Frequency",
        "Response",
        "Sweep",
        "Free",
        "Hysteresis",
        "Forced",
        "Ring",
        "Backbone:",
    }
    assert all("[" in label for chart in charts for label in chart.axes)
    assert charts_of(xr.DataTree()) == []


def test_the_numbers_are_the_trees(tree):
    (sweep,) = [chart for chart in charts_of(tree) if chart.heading.startswith("Sweep sweep_0p10")]
    test = tree["verification/sweep/sweep_0p10"]
    shown = {trace["name"]: trace for trace in sweep.lines}
    time = np.asarray(shown["measured"]["x"])
    assert time.size == 12000
    part = test.to_dataset().sel(time=slice(time[0] - 1e-4, time[-1] + 1e-4))
    # 32-bit floats have seven digits.
    np.testing.assert_allclose(shown["measured"]["y"], part["measured"], rtol=1e-6)
    middle = part["model_band"].values[1]
    np.testing.assert_allclose(shown["median of the model"]["y"], middle, rtol=1e-6)
    assert np.argmax(np.abs(part["measured"].values)) > 0


def test_bands_are_filled_and_named(few):
    (frequency, _) = charts_of(few)
    band, median = frequency.lines
    assert band["fill"] == "toself"
    assert band["name"] == "99 % band: parameters alone"
    assert band["legendgroup"] == median["legendgroup"]
    for x, y in zip(median["x"], median["y"], strict=True):
        edges = band["y"][np.isclose(band["x"], x)]
        assert edges.min() <= y <= edges.max()


def test_a_gap_in_a_band_stays_empty():
    ax = Figure().subplots()
    ax.fill_between([0, 1, 2, 3, 4], [0, 0, np.nan, 0, 0], 1, label="_band")
    (band,) = traces(ax)
    assert not band["showlegend"]
    (gap,) = np.flatnonzero(np.isnan(band["x"][:-1]))
    assert band["x"][:gap].max() == 1
    assert band["x"][gap + 1 : -1].min() == 3


def test_names_are_escaped_and_nothing_is_fetched(few):
    pytest.importorskip("plotly")
    ax = Figure().subplots()
    ax.plot([0], [0], label=plain(f"{HOSTILE} $x$"))
    (line,) = traces(ax)
    assert line["name"].startswith("&lt;/script&gt;")
    assert line["name"].endswith("$x$")
    page = render_interactive(few, HOSTILE)
    assert "alert(1)</script>" not in page
    assert "&lt;/script&gt;&lt;script&gt;alert(1)" in page
    assert "default-src 'none'" in page
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=", page)
    assert not re.search(r'(src|href)="', page)
    # No button of plotly's own that would upload a chart.
    assert '"showSendToCloud": false' in page
    assert page.count('class="chart"') == 2


def test_the_library_and_the_numbers_come_whole_out_of_the_page(few):
    plotly = pytest.importorskip("plotly.offline")
    page = render_interactive(few)
    packed = re.search(r'const packed = "([^"]+)"', page)
    assert gzip.decompress(base64.b64decode(packed[1])).decode() == plotly.get_plotlyjs()
    (first, _) = re.findall(r'<script type="application/json">(.*?)</script>', page)
    shown = json.loads(first)["data"][1]["y"]
    values = np.frombuffer(base64.b64decode(shown["bdata"]), shown["dtype"])
    median = few["verification/backbone/frequency"].transpose("quantile", ...).values[1]
    np.testing.assert_allclose(values, median, rtol=1e-6)


def test_a_page_of_many_long_records_stays_below_five_megabytes(tree):
    """Twelve records of 40,000 samples, of which 12,000 are shown."""
    pytest.importorskip("plotly")
    (name, sweep), *_ = tree["verification/sweep"].children.items()
    test = sweep.to_dataset()
    copies = -(-40_000 // test.sizes["time"])
    long = xr.concat([test.drop_vars("time")] * copies, "time", data_vars="minimal")
    long = long.assign_coords(time=np.arange(long.sizes["time"]) / 1024.0)
    many = xr.DataTree.from_dict({f"/verification/sweep/{name}_{i}": long for i in range(12)})
    assert len(charts_of(many)) == 12
    assert len(render_interactive(many)) < 5e6


def test_extremes_stay_and_gaps_stay_gaps():
    rng = np.random.default_rng(3)
    y = rng.normal(size=10_000)
    y[4000:4003] = np.nan
    x, thinned = decimated(np.arange(10_000.0), y, 1000)
    assert len(x) <= 1000 + 8
    assert np.all(np.diff(x) > 0)
    for part in (slice(0, 4000), slice(4003, None)):
        inside = (x >= np.arange(10_000)[part][0]) & (x <= np.arange(10_000)[part][-1])
        assert np.nanmax(thinned[inside]) == y[part].max()
        assert np.nanmin(thinned[inside]) == y[part].min()
        # No stretch of twenty samples loses its largest value.
    stretch = y[:4000].reshape(-1, 20)
    peaks = (np.arange(200) * 20 + stretch.argmax(axis=1)).astype(float)
    assert np.isin(peaks, x).all()
    assert np.isnan(thinned).sum() == 3
    assert decimated(x, thinned, 2000)[0] is x


def test_a_limit_is_shared_so_that_short_curves_keep_their_points():
    assert shared_limit([10, 1000, 1000], 810) == 400
    assert shared_limit([10, 20], 1000) == 20
    assert shared_limit([], 5) == 2


def test_nothing_to_draw_is_one_sentence():
    pytest.importorskip("plotly")
    with pytest.raises(DataError, match="no response, loop or curve"):
        render_interactive(xr.DataTree())


def test_without_plotly_there_is_a_remedy(few, monkeypatch):
    real_import = builtins.__import__

    def absent(name, *rest):
        if name.startswith("plotly"):
            raise ImportError(name)
        return real_import(name, *rest)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(ConfigError, match="plotly") as caught:
        render_interactive(few)
    assert 'pip install "jbw[interactive]"' in str(caught.value)


def test_a_failed_page_leaves_the_old_one(few, tmp_path, monkeypatch):
    path = tmp_path / "interactive.html"
    path.write_text("old")
    monkeypatch.setattr(page, "render_interactive", lambda *_: "\ud800")
    with pytest.raises(UnicodeEncodeError):
        write_interactive(few, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_command_writes_it_beside_the_report(few, tmp_path):
    pytest.importorskip("plotly")
    (tmp_path / "summary.json").write_text("{}")
    few.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    done = CliRunner().invoke(report, [str(tmp_path), "--interactive", "--json"])
    assert done.exit_code == 0, done.output
    written = json.loads(done.stdout)
    assert written == {
        "report": str(tmp_path / "report.html"),
        "interactive": str(tmp_path / "interactive.html"),
    }
    assert (tmp_path / "interactive.html").stat().st_size > 1e6
