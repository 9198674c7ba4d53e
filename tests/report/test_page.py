"""The page stands by itself, says the verdict first and trusts no name from a file."""

import json
import re
import time
from html.parser import HTMLParser

import pytest
import xarray as xr
from click.testing import CliRunner
from toy_summary import result_summary

from jbw.cli.result import report
from jbw.errors import RunError
from jbw.report.figures import FIGURE_LIST, GROUPS
from jbw.report.page import render_page, write_page
from jbw.report.tables import loops_table
from jbw.results.run import RunSummary
from jbw.run import files

HOSTILE = '<script>alert(1)<script> $x_{ & "q"'


class Outline(HTMLParser):
    """Collects tags in order and checks that they close."""

    VOID = ("meta", "br", "link", "img", "hr")

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.texts = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def outline(text):
    parser = Outline()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    return parser


@pytest.fixture(scope="module")
def small(tree):
    """A result with one quick figure; the others are named as missing."""
    name = "steps/opening_nuts/posterior"
    return xr.DataTree.from_dict({f"/{name}": tree[name].to_dataset()})


@pytest.fixture(scope="module")
def whole(tree, tmp_path_factory):
    """The page with all figures, written once."""
    folder = tmp_path_factory.mktemp("whole")
    began = time.process_time()
    write_page(RunSummary.read(result_summary()), tree, folder / "report.html")
    # Six seconds on one free core; the limit leaves room for a slower one.
    assert time.process_time() - began < 30.0
    return folder / "report.html"


def test_the_whole_page(whole):
    assert whole.stat().st_size < 8e6
    assert list(whole.parent.iterdir()) == [whole]
    text = whole.read_text(encoding="utf-8")
    parsed = outline(text)
    figures = [facts["id"] for tag, facts in parsed.tags if tag == "figure"]
    # What stands first, or beside what the records say, is not drawn again below.
    first, looked, *others = figures
    assert (first, looked) == ("extra_amplitude", "extra_look")
    assert "Nonlinear: yes, it softens." in text
    grouped = [entry.slug for name in GROUPS for entry in FIGURE_LIST if entry.group == name]
    assert others == [slug for slug in grouped if slug not in (first, looked)]
    identities = re.findall(r'\bid="([^"]+)"', text)
    assert len(identities) == len(set(identities))
    # Every link within the page leads somewhere.
    targets = [facts["href"] for tag, facts in parsed.tags if tag == "a"]
    assert len(targets) >= 5
    assert {target.removeprefix("#") for target in targets} <= set(identities)


def test_nothing_comes_from_the_network(whole):
    parsed = outline(whole.read_text(encoding="utf-8"))
    assert not {"script", "link", "iframe", "img"} & {tag for tag, _ in parsed.tags}
    for _, facts in parsed.tags:
        for key in ("href", "src", "xlink:href"):
            assert str(facts.get(key, "#")).startswith(("#", "data:image/png;base64,"))


def test_all_of_it_is_printed_and_every_section_is_in_the_side_bar(whole):
    """What is folded on the screen is open on paper; only the side bar is not printed."""
    text = whole.read_text(encoding="utf-8")
    paper = text[text.index("@media print") : text.index("</style>")]
    hidden = re.findall(r"([^{}]+)\{[^{}]*display: none", paper)
    assert [selector.strip() for selector in hidden] == ["nav"]
    assert "details::details-content { content-visibility: visible" in paper
    bar = text[text.index("<nav") : text.index("</nav>")]
    linked = re.findall(r'href="#([^"]+)"', bar)
    folds = re.findall(r'<details class="fold"[^>]*>.*?<div id="([^"]+)">', text, flags=re.DOTALL)
    assert len(folds) > 5
    assert set(folds) <= set(linked)
    # A link into a fold opens it: its target is the content and not the heading.
    assert all(f'<div id="{name}">' in text for name in folds)


def test_findings_that_ask_for_the_same_stand_together(small, summary):
    ask = {"status": "failed", "action": "Draw more.", "number": None}
    findings = [{**ask, "code": code, "reason": f"{code} is 3."} for code in ("ess_bulk", "r_hat")]
    findings.append({"code": "solver", "status": "ok", "reason": "Steps are fine.", "number": 2.0})
    summary["verdict"] = {"status": "failed", "findings": findings}
    text = "".join(outline(render_page(RunSummary.read(summary), small)).texts)
    assert text.count("What to do: Draw more.") == 1
    assert "bulk ESS is 3." in text
    assert "R-hat is 3." in text
    assert "1 check passed" in text
    assert "Steps are fine. (2.00)" in text
    assert "Provisional, since the verdict is failed" in text


def test_input_files_are_told_below_the_folder_they_share(small, summary):
    summary["inputs"] = {f"/data/joint/{name}.h5": 64 * name for name in "ab"}
    text = "".join(outline(render_page(RunSummary.read(summary), small)).texts)
    assert "2 files in /data/joint" in text
    assert f"{64 * 'a'}  a.h5" in text
    summary["inputs"] = {"a.h5": 64 * "a"}
    assert f"{64 * 'a'}  a.h5" in render_page(RunSummary.read(summary), small)


def test_the_verdict_comes_first_then_what_is_known(small, summary):
    text = "".join(outline(render_page(RunSummary.read(summary), small)).texts)
    text = text[text.index("not assessed") :]  # below the links to the sections
    order = [
        "Some checks could not be made",
        "RMS error of the fitted test: 1.1\N{NO-BREAK SPACE}%",
        "To do next: Look at figure 12",
        "Verdict: ",
        "What to do: Look at figure 12",
        "R-hat is at most 1.004",
        "What was identified, and what was not",
        "Identified, with the coefficient of variation: ωₙ",
        "Table 1",
        "340.3",
        "All five parameters are determined by the sweeps.",
        "Tests: fitted and held out",
        "inside the",
        "Fitted (1 test)",
        "Held out (1 test)",
        "Posterior and sampling",
        "Not drawn",
        "The result has no group /steps/linear.",
        "Other posteriors",
        "The linear mode is identified.",
        "That they fail is expected",
        "Only the product α·δ is determined",
        "Strong correlations: α and δ: −0.994",
        "By the cut, γ holds only for the held α.",
        "Provenance",
        "jbw identify campaign.toml --out run --seed 7",
        "ab" * 32,
    ]
    positions = [text.find(heading) for heading in order]
    assert -1 not in positions
    assert positions == sorted(positions)


def test_no_red_mark_stands_above_the_papers_route_when_the_main_answer_is_good(small, summary):
    """Its steps fail in the toy; they are told within the one fold, which is closed."""
    summary["verdict"] = {"status": "ok", "findings": []}
    text = render_page(RunSummary.read(summary), small)
    start = text.rindex("<details", 0, text.index('<div id="steps">'))
    fold = text[start : text.rindex("<details", 0, text.index('<div id="provenance">'))]
    outside = text.replace(fold, "")
    outside = outside[outside.index("<main>") :]
    assert fold.startswith('<details class="fold">')
    assert 'class="badge bad"' in fold
    assert 'class="badge bad"' not in outside
    # Where the main answer itself is bad, the mark is there to be seen.
    summary["verdict"] = {"status": "failed", "findings": []}
    text = render_page(RunSummary.read(summary), small)
    assert 'class="badge bad"' in text[text.index("<main>") : text.index('<div id="steps">')]


def test_a_failed_posterior_of_decays_is_not_excused_with_the_papers_route(small, summary):
    """It is no step of the paper: nothing says that its failing is expected."""
    failed = summary["steps"]["third_order_paper"]
    summary["steps"] = {"decay": failed, "joint": summary["steps"]["joint"]}
    text = render_page(RunSummary.read(summary), small)
    others = text[text.index('<div id="others">') : text.index('<div id="provenance">')]
    assert "Free decays" in others
    assert 'class="badge bad"' in others
    assert "The chains disagree" in others
    assert "expected" not in text
    assert "own route" not in text


def test_a_step_that_was_not_judged_has_no_mark(small, summary):
    """The published route may stop before its verdict, beside steps that have one."""
    for step in summary["steps"].values():
        step["main"] = False
    next(iter(summary["steps"].values())).pop("verdict")
    assert 'class="badge bad"' in render_page(RunSummary.read(summary), small)


@pytest.mark.fault(52)
def test_names_from_files_are_escaped(tree, summary):
    summary["campaign"] = HOSTILE
    summary["predictions"] = {HOSTILE: summary["predictions"]["sweep_0p05"]}
    summary["inputs"] = {HOSTILE: "ef" * 32}
    summary["steps"][HOSTILE] = summary["steps"].pop("joint")
    summary["steps"][HOSTILE]["statements"] = [HOSTILE]
    name = f"/verification/sweep/{HOSTILE}"
    sweep = tree["verification/sweep/sweep_0p10"].to_dataset()
    sweep.attrs["level_unit"] = HOSTILE
    text = render_page(RunSummary.read(summary), xr.DataTree.from_dict({name: sweep}))
    assert "<script" not in text.lower()
    assert text.count("&lt;script&gt;") >= 5
    assert "script" not in {tag for tag, _ in outline(text).tags}


def test_the_loops_areas_stand_beside_each_other(tree, summary):
    loops = xr.DataTree.from_dict({"/validation/loops": tree["validation/loops"]})
    text = "".join(outline(render_page(RunSummary.read(summary), loops)).texts)
    assert "Areas of the hysteresis loops" in text
    # pi * 0.12 * 4 mm * 500 1/s^2 * 4 mm = 3.016 mJ/kg: the toy's ellipse.
    assert "3.016 (2.986 to 3.046)" in text
    assert "with viscous" in text
    # Out of the band and without a band of their own.
    areas = {"measured_area": 9.0, "model_area": ("quantile", [1.0, 2.0, 3.0])}
    shown = loops_table(xr.DataTree.from_dict({"/validation/loops/other": xr.Dataset(areas)}))
    cells = {
        column.heading: column.cell(row).text for row in shown.rows for column in shown.columns
    }
    assert cells["test"] == "other"
    assert cells["measured [mJ/kg]"] == "9000"
    assert cells["bands\nmeet"] == "no"


@pytest.mark.parametrize("status", ["ok", "failed", "not assessed", "unheard of"])
def test_every_status_has_words(small, summary, status):
    summary["verdict"] = {"status": status, "findings": []}
    assert status in render_page(RunSummary.read(summary), small)


def test_a_bare_summary_still_makes_a_page():
    text = render_page(RunSummary.read({}), xr.DataTree())
    assert "not judged" in text
    assert text.count("<li>Figure") == 12


def test_a_failed_page_leaves_the_old_one(small, summary, tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    path.write_text("old")

    def refuse(*_):
        raise OSError("disk full")

    monkeypatch.setattr(files.os, "replace", refuse)
    with pytest.raises(RunError, match="disk full"):
        write_page(RunSummary.read(summary), small, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_command_writes_the_page(small, summary, tmp_path):
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    small.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    done = CliRunner().invoke(report, [str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert done.stdout.strip() == str(tmp_path / "report.html")
    done = CliRunner().invoke(report, [str(tmp_path), "--out", str(tmp_path / "other.html")])
    assert (tmp_path / "other.html").is_file()
