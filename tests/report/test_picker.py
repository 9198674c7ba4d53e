"""The page on which a band and modes are chosen: peaks where modes are, lines to copy."""

import html
import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lsim
from test_browser import CHROMIUM, browse

from jbw.cli.look import look
from jbw.errors import ConfigError, DataError
from jbw.measurement.records import Record, Test
from jbw.report.picker import NUM_SHOWN, peaks_of, render_picker, shown, spectrum_of

FS, SIZE = 512.0, 8192
MODES_HZ, ZETA = (20.0, 51.0), 0.005
HOSTILE = "</script><script>alert(1)</script>"


def response(u, t):
    """Velocity of two modes of unit mass under a force per mass, by scipy."""
    total = np.zeros_like(t)
    for hertz in MODES_HZ:
        omega = 2 * np.pi * hertz
        total += lsim(([1.0, 0.0], [1.0, 2 * ZETA * omega, omega**2]), u, t)[1]
    return total


def a_test(kind, name, band_hz=None, noise=1e-4):
    rng = np.random.default_rng(3)
    t = np.arange(SIZE) / FS
    u = rng.normal(size=SIZE) if kind == "noise" else np.r_[FS, np.zeros(SIZE - 1)]
    y = response(u, t)
    y += noise * np.abs(y).max() * rng.normal(size=SIZE)
    channels, units = {"velocity": y}, {"velocity": "m/s"}
    if kind == "noise":
        channels, units = {"input": u, **channels}, {"input": "N/kg", **units}
    record = Record(FS, channels, units)
    return Test(kind, (record,), name, level=1.0, band_hz=band_hz)


def data_of(page):
    return json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', page)[1]
    )


@pytest.mark.parametrize("kind", ["noise", "decay"])
def test_peaks_are_found_where_the_modes_are_and_no_others(kind):
    peaks = peaks_of({"only": spectrum_of(a_test(kind, "only"))})
    # Smoothed over nine lines of 1/16 Hz: within half of that width.
    np.testing.assert_allclose([peak.freq_hz for peak in peaks], MODES_HZ, atol=4.5 / 16)
    (low, high), (_, last) = peaks[0].band_hz, peaks[1].band_hz
    assert low < MODES_HZ[0] < high < MODES_HZ[1] < last


def test_neighbouring_modes_share_no_band():
    freq = np.linspace(1.0, 100.0, 4000)
    size = sum(1 / np.hypot(freq - centre, 0.02) for centre in (40.0, 43.0))
    first, second = peaks_of({"only": type(spectrum_of(a_test("decay", "x")))(freq, size)})
    assert first.band_hz[1] == second.band_hz[0] == 41.5


def test_what_is_shown_keeps_every_peak():
    spectrum = spectrum_of(a_test("decay", "only"))
    fewer = shown(spectrum)
    assert len(fewer.size) <= NUM_SHOWN < len(spectrum.size)
    assert fewer.size.max() == spectrum.size.max()


def test_the_page_needs_nothing_else_and_trusts_no_name():
    page = render_picker(HOSTILE, [a_test("noise", HOSTILE, (18.0, 22.0)), a_test("decay", "tap")])
    assert "alert(1)</script>" not in page
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=", page)
    assert "default-src 'none'" in page
    data = data_of(page)
    assert [test["band"] for test in data["tests"]] == [[18.0, 22.0], None]
    assert [round(peak["freq"]) for peak in data["peaks"]] == [20, 51]
    # Without a script the peaks and the lines to copy are there.
    low, high = data["peaks"][0]["band"]
    assert f"band = [{low}, {high}]" in html.unescape(page)
    assert len(page) < 1e5


def test_force_loops_have_no_band():
    record = Record(
        FS, {"displacement": np.ones(64), "restoring_force": np.ones(64)},
        {"displacement": "m", "restoring_force": "N"},
    )  # fmt: skip
    with pytest.raises(DataError, match="No test of the campaign has a spectrum"):
        render_picker("x", [Test("loop", (record,), "loop", level=1.0)])


def test_the_page_is_named_as_one(tmp_path):
    campaign = tmp_path / "campaign.toml"
    campaign.touch()
    done = CliRunner().invoke(look, [str(campaign), "--html", "page.pdf"])
    assert isinstance(done.exception, ConfigError)
    assert "look.html" in str(done.exception)


DRIVE = """<!doctype html>
<iframe id="f" src="page.html" width="1280" height="1400"></iframe><script>
addEventListener("load", () => {
  const w = document.getElementById("f").contentWindow, d = w.document, found = {};
  const svg = d.getElementById("plot"), lines = () => d.getElementById("lines").value;
  const point = (kind, x) => {
    const box = svg.getBoundingClientRect();
    const place = {clientX: box.left + x * box.width / 1100, clientY: box.top + 200};
    const event = new w.PointerEvent(kind, {...place, bubbles: true, pointerId: 1});
    (kind === "pointerup" ? w : svg).dispatchEvent(event);
  };
  svg.setPointerCapture = () => {};
  found.first = lines();
  found.curves = d.querySelectorAll("polyline").length;
  // Where a frequency lies follows from the two peaks.
  const peaks = JSON.parse(d.getElementById("data").textContent).peaks.map(peak => peak.freq);
  const places = [...d.querySelectorAll("circle")].map(each => Number(each.getAttribute("cx")));
  const slope = (places[1] - places[0]) / (peaks[1] - peaks[0]);
  const across = freq => places[0] + slope * (freq - peaks[0]);
  const [a, b] = [across(45), across(60)];
  point("pointerdown", a); point("pointermove", b); point("pointerup", b);
  found.dragged = lines();
  const [c, e] = [across(15), across(60)];
  point("pointerdown", c); point("pointermove", e); point("pointerup", e);
  found.doubt = d.getElementById("doubt").textContent;
  for (const button of d.querySelectorAll("#modes button")) button.click();
  found.both = lines();
  found.wide = d.documentElement.scrollWidth <= d.documentElement.clientWidth;
  document.body.textContent = "RESULT" + JSON.stringify(found) + "END";
});</script>"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_band_is_dragged_and_modes_are_chosen_in_a_browser(tmp_path):
    page = render_picker(
        "two modes", [a_test("noise", "shaken", (18.0, 22.0)), a_test("decay", "tap")]
    )
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    (tmp_path / "around.html").write_text(DRIVE)
    text = re.search("RESULT(.*)END</body>", browse(tmp_path / "around.html"), re.DOTALL)
    choice = json.loads(html.unescape(text[1]))
    assert "band = [18, 22]" in choice["first"]
    assert choice["curves"] == 2
    low, high = map(float, re.search(r"band = \[([\d.]+), ([\d.]+)\]", choice["dragged"]).groups())
    assert (low, high) == pytest.approx((45.0, 60.0), rel=1e-3)  # as it is rounded
    assert "2 peaks lie in this band" in choice["doubt"]
    modes = re.search(r"\[structure\]\nmodes = \[([\d.]+), ([\d.]+)\]", choice["both"])
    np.testing.assert_allclose([float(x) for x in modes.groups()], MODES_HZ, atol=4.5 / 16)
    assert choice["wide"]
