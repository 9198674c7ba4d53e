"""The pages as a browser shows them: as wide as the window, nothing broken, light and dark.

Skipped where no Chromium is installed.
"""

import html
import json
import re
import shutil
import subprocess

import pytest

from jbw.report.page import write_page
from jbw.results.run import RunSummary

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
CHROMIUM = next((path for name in NAMES if (path := shutil.which(name))), None)
TRIES = 3  # a busy machine may not load the frames before the browser's own clock runs out
WINDOWS = ((1280, "light"), (800, "light"), (400, "light"), (1280, "dark"))
PAPER = {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 23, 27)"}
# Frames of every window in one page, measured from outside: the report allows no script. A frame
# takes its theme from the element that holds it.
FRAMES = """<!doctype html><meta charset="utf-8"><body>{frames}<script>
const pictures = d => [...d.images].map(i => i.src).concat(
  [...d.querySelectorAll("image")].map(i => i.getAttribute("xlink:href")));
const broken = async d => (await Promise.all(pictures(d).map(async source => {{
  const picture = new Image(); picture.src = source;
  try {{ await picture.decode(); return 0; }} catch {{ return 1; }}
}}))).reduce((a, b) => a + b, 0);
const boxes = d => [...d.querySelectorAll(".scroll")];
addEventListener("load", async () => {{
  const found = [];
  for (const frame of document.querySelectorAll("iframe")) {{
    const d = frame.contentDocument, root = d.documentElement;
    for (const fold of d.querySelectorAll("details")) fold.open = true;
    found.push({{
      width: root.clientWidth, wide: root.scrollWidth, pictures: pictures(d).length,
      broken: await broken(d), paper: getComputedStyle(d.body).backgroundColor,
      figures: d.querySelectorAll("figure svg").length,
      flat: [...d.querySelectorAll("figure svg")]
        .filter(each => each.getBoundingClientRect().height < 100).length,
      table: Math.max(...[...d.querySelectorAll("#identified table")].map(t => t.scrollWidth)),
      opening: d.getElementById("opening").getBoundingClientRect().bottom,
      scrolling: boxes(d).filter(b => b.scrollWidth > b.clientWidth + 1).length,
    }});
  }}
  document.body.textContent = "RESULT" + JSON.stringify(found) + "END";
}});
</script>"""


def browse(path):
    """The page's elements after its scripts have run."""
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu"]
    command += ["--allow-file-access-from-files", "--virtual-time-budget=20000", "--dump-dom"]
    home = f"--user-data-dir={path.parent / 'browser'}"
    done = subprocess.run(
        [*command, home, path.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout


def measured(page):
    """What the frames of every window hold."""
    frames = "".join(
        f'<iframe src="{page.name}" width={width} style="color-scheme: {theme}"></iframe>'
        for width, theme in WINDOWS
    )
    around = page.with_name("frames.html")
    around.write_text(FRAMES.format(frames=frames), encoding="utf-8")
    for _ in range(TRIES):
        match = re.search("RESULT(.*)END</body>", browse(around), flags=re.DOTALL)
        if match is not None:
            return json.loads(html.unescape(match[1]))
    raise AssertionError(f"The frames did not load within the browser's time, {TRIES} times.")


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_page_fits_every_window(tree, summary, tmp_path):
    path = tmp_path / "report.html"
    write_page(RunSummary.read(summary), tree, path)
    for (_, theme), measures in zip(WINDOWS, measured(path), strict=True):
        assert measures["wide"] <= measures["width"]
        assert measures["pictures"] > 0
        assert measures["broken"] == 0
        assert measures["figures"] > 20
        assert measures["flat"] == 0
        assert measures["paper"] == PAPER[theme]
        # In a wide window nothing has to be scrolled; in a narrow one the boxes do, not the page.
        assert (measures["scrolling"] == 0) == (measures["width"] > 1200)
        assert measures["table"] <= 1100
        # Verdict, picture and sentences are seen at once in a window of 900 pixels.
        assert measures["opening"] < 900 or measures["width"] < 700


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_interactive_page_draws_every_chart(tree, tmp_path):
    pytest.importorskip("plotly")
    from jbw.report.page import write_interactive

    path = tmp_path / "interactive.html"
    hostile = tree.copy()
    name = "<img src=x onerror=document.title='broken'> & <b>x"
    hostile["verification/sweep"] = tree["verification/sweep"].copy()
    hostile[f"verification/sweep/{name}"] = tree["verification/sweep/sweep_0p10"].copy()
    write_interactive(hostile, path, name)
    page = browse(path)
    assert page.count('id="chart-') == page.count('class="chart js-plotly-plot"') > 10
    assert "<title>broken" not in page
    assert "onerror=document.title='broken'>" not in page
