"""The documentation: it builds strictly, knows all that there is, and what it shows is so."""

import importlib.util
import json
import re
import shlex
import subprocess
import sys
from html import unescape
from itertools import takewhile
from pathlib import Path
from types import ModuleType, SimpleNamespace

import click
import numpy as np
import pytest
from tiers import not_run_yet

import jbw
from jbw.campaign.schema import parse
from jbw.cli import COMMANDS, cli, run
from jbw.cli.about import first_page
from jbw.errors import RunError
from jbw.measurement.kinds import KINDS
from jbw.oscillator.laws import FAMILIES, LAWS
from jbw.report.figures import FIGURES
from jbw.report.messages.findings import explanations

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def commands(page):
    """Every line of a page's shell blocks that calls jbw, as its words but for redirections."""
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    parts = [part.partition(">")[0] for line in lines for part in line.split("&&")]
    return [shlex.split(part)[1:] for part in parts if part.split()[:1] == ["jbw"]]


def loaded(name, path):
    """A script that is no module of a package."""
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as it is built for release: a warning is an error."""
    pytest.importorskip("mkdocs", reason="needs the extra `docs`: pip install -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def article(site, name):
    """What stands on a page, without the frame about it."""
    return (site / name).read_text(encoding="utf-8").partition("<article")[2]


def in_code(text):
    """All that stands in code font."""
    return {
        unescape(re.sub("<[^>]+>", "", part)) for part in re.findall("<code>(.*?)</code>", text)
    }


def test_nothing_of_another_host_is_loaded(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|link|img|iframe)[^>]*?(?:src|href)="([^"]*)"', text)
        assert not [link for link in loaded if "//" in link], page.name
    for sheet in site.rglob("*.css"):
        assert "url(http" not in sheet.read_text(encoding="utf-8")


def test_every_mark_is_made_and_every_formula_drawn(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "<!-- make" not in text
        assert 'class="arithmatex"' not in text
        assert "$$" not in text


def test_no_page_shows_an_escape_code(site):
    # As the terminal's own, as an entity, or as what is left where a browser drops the first sign.
    code = re.compile(r"\x1b|&#(?:27|x1b);|\[\d+(?:;\d+)*m", re.IGNORECASE)
    assert all(code.search(text) for text in ("\x1b[1mlaw", "[1;34mlaw"))
    for page in site.rglob("*.html"):
        assert not code.search(page.read_text(encoding="utf-8")), page.name


def test_every_picture_of_a_page_is_there(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for link in re.findall(r'<img[^>]*? src="([^"]+)"', text):
            assert (page.parent / link).is_file(), (page.name, link)


def test_the_gallery_shows_every_notebook(site):
    text = article(site, "notebooks/index.html")
    kept = list((ROOT / "notebooks").glob("*.ipynb"))
    assert kept
    for path in kept:
        assert f'src="thumbnails/{path.stem}.png"' in text
        page = article(site, f"notebooks/{path.stem}.html")
        assert f'src="outputs/{path.stem}_0.png"' in page


def test_every_public_name_is_in_the_reference(site):
    text = "".join(article(site, page.relative_to(site)) for page in site.glob("reference/*.html"))
    assert [name for name in jbw.__all__ if f'id="jbw.{name}"' not in text] == []
    assert [name for name in jbw.paper.__all__ if f'id="jbw.paper.{name}"' not in text] == []


def test_every_equation_of_the_paper_has_its_row(site):
    text = article(site, "equations.html")
    rows = [unescape(re.sub("<[^>]+>", "", row)) for row in re.findall("<tr>.*?</tr>", text, re.S)]
    numbered = {row.split()[0] for row in rows}
    assert [n for n in range(1, 43) if f"({n})" not in numbered] == []
    for row in jbw.paper.equations():
        assert f"#{row.function}" in text
        assert row.note in unescape(re.sub("<[^>]+>", "", text))


def test_every_equation_of_the_paper_stands_on_a_page_of_the_theory(site):
    text = "".join(article(site, f"theory/{page}.html") for page in ("loop", "kernels", "bayes"))
    cells = re.findall(r"<tr>\s*<td>([^<]*)</td>", text)
    named = {number for cell in cells for number in cell.split(", ")}
    assert [n for n in range(1, 43) if f"({n})" not in named] == []
    for name in ("loop", "square_wave", "kernels", "describing_function"):
        assert f'src="{name}.png"' in text


def test_every_command_has_its_options_and_arguments(site):
    text = article(site, "reference/commands.html")
    for name in COMMANDS:
        section = text.partition(f'<h2 id="jbw-{name}">')[2].partition("<h2 ")[0]
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        plain = unescape(re.sub("<[^>]+>", "", section))
        for param in command.params:
            if isinstance(param, click.Option):
                assert param.opts[0] in plain, (name, param.name)
            else:
                assert param.make_metavar(click.Context(command)) in plain, (name, param.name)
        assert "\\|" not in plain, name  # of a table's source, which no reader should see


def test_every_key_of_a_campaign_is_told_with_its_meaning(site, capsys):
    assert run(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    text = article(site, "reference/campaign.html")
    for table, model in (
        ("campaign", "Head"), ("assembly", "Assembly"), ("joint", "JointLaws"),
        ("test", "TestSpec"),
        ("identify", "Identify"), ("structure", "Structured"), ("matrices", "AssembledStructure"),
        ("joints", "JointTable"),
    ):  # fmt: skip
        section = text.partition(f'<h2 id="{table}">')[2].partition("<h2 ")[0]
        known = in_code(section)
        plain = unescape(re.sub("<[^>]+>", "", section))
        for key, field in schema["$defs"][model]["properties"].items():
            assert key in known, (table, key)
            assert field["description"].split("*")[0] in plain, (table, key)
    assert set(KINDS) <= in_code(text)


def test_every_law_finding_and_figure_has_its_place(site):
    laws = in_code(article(site, "reference/laws.html"))
    # A family stands for its members.
    assert {name for name in LAWS if name not in FAMILIES} <= laws
    assert {f"{name}_N" for name in FAMILIES} <= laws
    findings, figures = article(site, "findings.html"), article(site, "figures.html")
    assert [code for code in explanations() if f'<h2 id="{code}">' not in findings] == []
    assert [name for name in FIGURES if f'<h3 id="{name}">' not in figures] == []


def test_every_notebook_has_its_page():
    notebooks = {path.stem for path in (ROOT / "notebooks").glob("[0-9]*_*.py")}
    assert {page.stem for page in (DOCS / "notebooks").glob("[0-9]*.md")} == notebooks


@each_page
def test_a_command_of_a_page_exists_with_its_options(page, capsys):
    for words in commands(page):
        assert words[0] in COMMANDS
        assert run([words[0], "--help"]) == 0
        told = capsys.readouterr().out
        assert [word for word in words if word.startswith("--") and word not in told] == []
    # What the text itself names, alone or with what follows.
    named = re.findall(r"`jbw\s+([a-z]+)", page.read_text(encoding="utf-8"))
    assert set(named) <= set(COMMANDS)


@each_page
def test_a_campaign_of_a_page_is_one(page):
    for text in blocks(page, "toml"):
        assert parse(text, page.name).tests


@each_page
def test_python_of_a_page_names_public_things(page):
    text = "".join(blocks(page, "python"))
    named = {name for name in re.findall(r"\bjbw\.(\w+)", text)}
    assert named <= {*jbw.__all__, "report"}
    assert set(re.findall(r"\bpaper\.(\w+)\(", text)) <= set(jbw.paper.__all__)


def test_the_page_of_a_wheel_comes_first_and_a_stranger_s_site_never(tmp_path):
    package = tmp_path / "jbw"
    for place in (package / "site", tmp_path / "site"):
        place.mkdir(parents=True)
        (place / "index.html").touch()
    assert first_page(package) == package / "site" / "index.html"
    (package / "site" / "index.html").unlink()
    with pytest.raises(RunError, match="mkdocs build"):  # a folder of that name, and no clone
        first_page(package)
    (tmp_path / "mkdocs.yml").touch()
    assert first_page(package) == tmp_path / "site" / "index.html"


@pytest.mark.parametrize(("target", "place"), [("wheel", "jbw/site"), ("sdist", "site")])
def test_a_site_that_was_built_is_packed_and_none_is_no_fault(target, place, tmp_path, monkeypatch):
    interface = ModuleType("hatchling.builders.hooks.plugin.interface")
    interface.BuildHookInterface = SimpleNamespace  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, interface.__name__, interface)
    hook = loaded("hatch_build", ROOT / "hatch_build.py").Site(root=tmp_path, target_name=target)

    def packed(version):
        build_data = {"force_include": {}}
        hook.initialize(version, build_data)
        return build_data["force_include"]

    assert packed("standard") == {}
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "index.html").touch()
    assert packed("standard") == {str(tmp_path / "site"): place}
    assert packed("editable") == {}


def test_the_terminal_s_picture_shows_a_demonstration_without_a_warning():
    text = (DOCS / "terminal.svg").read_text(encoding="utf-8")
    shown = unescape("\n".join(re.sub("<[^>]+>", "", line) for line in text.split("</text>")))
    shown = shown.replace("\xa0", " ")
    assert "Verdict: ok" in shown
    assert "Report: demo/report.html" in shown
    assert not re.search(r"warning|\.\.\.", shown, re.IGNORECASE)


def test_five_recorders_come_to_a_look_in_two_commands_each():
    text = (DOCS / "recorders.svg").read_text(encoding="utf-8")
    shown = unescape("\n".join(re.sub("<[^>]+>", "", line) for line in text.split("</text>")))
    shown = shown.replace("\xa0", " ")
    folders = loaded("draw_recorders", DOCS / "draw_recorders.py").FOLDERS
    assert len(folders) == 5
    typed = re.findall(r"\$ jbw (\w+) (\w+)", shown)
    assert typed == [(command, name) for name in folders for command in ("init", "look")]
    # The joint that was simulated has 30 Hz at small motion, and softens.
    assert shown.count("measured without a model of the joint") == 5
    assert not re.search(r"Doubtful|were not read|error", shown)


def test_lines_that_a_log_broke_are_whole_in_the_terminal_s_picture():
    script = loaded("draw_terminal", DOCS / "draw_terminal.py")
    recording = (
        "[  1.0 s] Verification: every test against the model, and without\nhysteresis\n"
        "[  2.0 s] ... Verification: every test, for 10 s so\nfar\n"
        "[  3.0 s] Done\nVerdict: ok\nReport: demo/report.html\n"
    )
    assert list(script.lines_of(recording)) == [
        "[  1.0 s] Verification: every test against the model, and without hysteresis",
        "[  3.0 s] Done", "Verdict: ok", "Report: demo/report.html",
    ]  # fmt: skip


def test_docs_prints_its_page_or_how_to_build_it_and_loads_nothing_heavy():
    code = (
        "import sys\nfrom jbw.cli import run\ncode = run(['docs', '--json'])\n"
        "print(sorted({'arviz', 'jax', 'matplotlib'} & set(sys.modules)), file=sys.stderr)\n"
        "sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    told = json.loads(done.stdout)
    assert done.stderr.splitlines()[-1] == "[]"
    if done.returncode == 0:
        assert Path(told["page"]).is_file()
    else:
        assert "mkdocs build" in told["error"]["remedy"]


laboratories = loaded("run_laboratories", DOCS / "run_laboratories.py")
# Not run yet: python docs/run_laboratories.py NAME, some minutes each on an idle machine.
WAITING: set[str] = set()
each_laboratory = pytest.mark.parametrize(
    "page",
    not_run_yet(
        sorted(laboratories.PAGES.glob("*.md")),
        WAITING,
        lambda page: f"python docs/run_laboratories.py {page.stem}",
    ),
)


@each_laboratory
def test_a_laboratory_shows_what_its_own_blocks_gave(page):
    kept = json.loads((laboratories.SHOWN / f"{page.stem}.json").read_text(encoding="utf-8"))
    remedy = f"Run it again: python docs/run_laboratories.py {page.stem}"
    assert kept["source"] == laboratories.source_of(page), remedy
    words = [shlex.split(one["command"]) for one in kept["shown"]]
    assert words == laboratories.commands(page)
    # Identified, with a verdict that the page shows; looked at, without a fault.
    assert [one["code"] for one in kept["shown"][:-1]] == [0] * (len(words) - 1)
    assert kept["shown"][-1]["code"] in (0, 4)
    assert "Verdict: " in kept["shown"][-1]["text"]
    text = page.read_text(encoding="utf-8")
    for mark in (*range(1, len(words) + 1), "figure"):
        assert f"<!-- shown {mark} -->" in text
    assert text == laboratories.with_outputs(page, text), remedy
    assert (laboratories.SHOWN / f"{page.stem}.png").is_file()


@pytest.mark.slow
@each_laboratory
def test_a_laboratory_runs_up_to_its_identification(page, tmp_path, monkeypatch, capsys):
    """Its blocks run in this process, since each new one would import JAX again."""
    kept = json.loads((laboratories.SHOWN / f"{page.stem}.json").read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", laboratories.WIDTH)
    (code,), (campaign,) = blocks(page, "python"), blocks(page, "toml")
    exec(compile(code, page.name, "exec"), {"__name__": "page"})
    (target,) = {Path(words[2]) for words in laboratories.commands(page)}
    target.write_text(campaign, encoding="utf-8")
    capsys.readouterr()
    for words, shown in zip(laboratories.commands(page)[:-1], kept["shown"], strict=False):
        assert run(words[1:]) == 0
        again = capsys.readouterr().out.rstrip()
        # Digits may differ from machine to machine, lines may not.
        assert len(again.splitlines()) == len(shown["text"].splitlines())


@pytest.mark.release
@each_laboratory
def test_a_laboratory_is_identified_as_its_page_shows(page, tmp_path):
    kept = json.loads((laboratories.SHOWN / f"{page.stem}.json").read_text(encoding="utf-8"))
    laboratories.prepare(page, tmp_path)
    again = laboratories.printed(laboratories.commands(page)[-1], tmp_path)
    assert again["code"] == kept["shown"][-1]["code"]
    verdicts = [re.findall("Verdict: .*", one["text"]) for one in (again, kept["shown"][-1])]
    assert verdicts[0] == verdicts[1]


@pytest.fixture
def tutorial(tmp_path, monkeypatch):
    """Return names of the tutorial's first block, its last block, and commands after the draft."""
    page = DOCS / "tutorial.md"
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    first, last = blocks(page, "python")
    exec(compile(first, "tutorial.md, first", "exec"), names)
    drafting, *rest = commands(page)
    assert run(drafting) == 0
    draft = Path("beam/campaign.toml")
    assert "CHECK" in draft.read_text(encoding="utf-8")
    (campaign,) = blocks(page, "toml")
    draft.write_text(campaign, encoding="utf-8")
    return names, last, rest


@pytest.mark.slow
def test_the_tutorial_runs_up_to_its_identification(tutorial):
    _, _, commands_after_draft = tutorial
    before = list(takewhile(lambda words: words[0] != "identify", commands_after_draft))
    assert [words[0] for words in before] == ["check", "look"]
    for words in before:
        assert run(words) == 0, words
    assert Path("look").exists()


@pytest.mark.release  # two minutes, most of them the identification
def test_the_tutorial_is_so(tutorial, capsys):
    names, last, commands_after_draft = tutorial
    for words in commands_after_draft:
        assert run(words) == 0, words
    exec(compile(last, "tutorial.md, last", "exec"), names)
    study, truth = names["study"], jbw.rig.TRUTH
    assert study.verdict.status == "ok"
    for name in ("omega_n", "zeta", "alpha", "delta", "gamma"):
        draws = study.posterior["posterior"][name]
        # Five standard deviations: once in 3e5 by chance for each of five parameters.
        assert abs(draws.mean() - getattr(truth, name)) < 5 * draws.std(), name
    # The laser's noise of 1e-3 m/s is 1.1 % of the middle sweep; a line misses its softening.
    middle = study.record["predictions"]["middle"]
    assert not middle["fitted"]
    assert middle["nrmse"] < 0.015
    assert middle["nrmse_linear"] > 0.1
    for file in ("look", "run/report.html", "run/export/backbone.csv"):
        assert Path(file).exists()
    assert "BEYOND" in capsys.readouterr().out  # of the sweep at twice the highest level


@pytest.mark.release  # a minute; test_numpyro_model.py has the model
def test_a_likelihood_of_one_s_own_mixes(tmp_path, monkeypatch):
    page = DOCS / "howto" / "likelihood.md"
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for i, text in enumerate(blocks(page, "python")):
        exec(compile(text, f"likelihood.md, snippet {i + 1}", "exec"), names)
    # Noise of the rig's laser in the mean of three records.
    assert names["noise"] == pytest.approx(1e-3 / np.sqrt(3), rel=0.03)  # 5 sd of its own error
    table, truth = names["table"], {**vars(jbw.rig.TRUTH), "gain": 15.0}
    for name, row in table.iterrows():
        assert row["r_hat"] < 1.03  # 500 draws: its own scatter is about a hundredth
        assert row["ess_bulk"] > 200
        assert abs(row["mean"] - truth[name]) < 5 * row["sd"], name
    extra = names["mcmc"].get_extra_fields()
    assert extra["diverging"].sum() == 0
    assert extra["num_steps"].mean() < 20  # gradients a draw: more than that is bad scaling


howto = loaded("run_howto", DOCS / "run_howto.py")
each_shown = pytest.mark.parametrize(
    "page", [page for page in sorted(howto.PAGES.glob("*.md")) if howto.asked(page)],
    ids=lambda page: page.stem,
)  # fmt: skip


@each_shown
def test_a_how_to_page_shows_what_was_run_for_it(page):
    remedy = f"Run it again: jbw demo && python docs/run_howto.py demo {page.stem}"
    kept = howto.kept()[page.stem]
    assert kept["source"] == howto.source_of(page), remedy
    assert page.read_text(encoding="utf-8") == howto.with_outputs(page), remedy


@pytest.mark.parametrize("page", sorted(howto.PAGES.glob("*.md")), ids=lambda page: page.stem)
def test_every_how_to_page_has_a_picture_or_an_output(page):
    text = page.read_text(encoding="utf-8")
    assert re.search(r"!\[[^]]+\]\(", text) or howto.asked(page)


@pytest.mark.parametrize("name", ["drives", "neighbours"])
def test_python_of_a_how_to_page_prints_what_it_shows(name, tmp_path):
    page = howto.PAGES / f"{name}.md"
    shown = howto.printed(howto.asked(page)["python"], tmp_path)
    assert shown == howto.kept()[name]["shown"]["python"]  # three digits, of least squares


def test_sentences_of_an_output_are_folded_and_tables_stay_whole():
    folded = loaded("docs_hooks", DOCS / "hooks.py").folded
    sentence = "RMS error of the tests: " + ", ".join(["0.2 %"] * 30)
    table = f"  test   {'x' * 60}   {'y' * 60}  "
    rule = "─" * 130
    lines = folded(f"{sentence}\n{table}\n{rule}\n").splitlines()
    assert lines[-2:] == [table.rstrip(), rule]
    assert " ".join(lines[:-2]) == sentence
    assert max(map(len, lines[:-2])) <= 96
