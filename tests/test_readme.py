"""The README: short, its commands exist, its links lead somewhere, its picture is up to date."""

import ast
import importlib.util
import re
import shlex
from pathlib import Path

import pytest

import jbw
from jbw.cli import COMMANDS, run

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.DOTALL)


def commands():
    """Every line of a shell block that calls jbw, as its words."""
    lines = [line for kind, block in BLOCKS if kind == "sh" for line in block.splitlines()]
    parts = [part for line in lines for part in line.partition("#")[0].split("&&")]
    return [shlex.split(part)[1:] for part in parts if part.split()[:1] == ["jbw"]]


def test_it_is_short_and_says_first_what_it_is_for():
    assert len(re.sub(r"https?://\S+", "", TEXT).split()) <= 500
    first = " ".join(TEXT.split("\n\n")[1].split())
    assert first.startswith("Give jbw your vibration records; it returns frequency and damping")
    assert "git clone" in TEXT
    tables = re.findall(r"(?:^\|.*\n)+", TEXT, re.MULTILINE)
    assert len(tables) == 2
    lines = "".join(tables).splitlines()
    assert {line.count("|") for line in lines} == {4}  # three columns
    (source,) = [block for kind, block in BLOCKS if kind == "python"]
    assert len(source.strip().splitlines()) <= 5


def test_its_first_links_are_notebooks_that_open():
    links = re.findall(r"(?<!!)\[[^\]]*\]\(([^)]+)\)", TEXT)
    assert links[0] == "notebooks/README.md"
    assert [Path(link).suffix for link in links[1:3]] == [".ipynb", ".ipynb"]


def test_its_picture_holds_every_word_that_its_script_draws():
    from PIL import Image

    spec = importlib.util.spec_from_file_location("draw_result", ROOT / "docs" / "draw_result.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    drawn = script.words_in(script.draw())
    # The two axes of each panel, the model with its band, and points of every kind of test.
    assert len(drawn) >= 9
    assert Image.open(script.TARGET).text[script.WORDS].splitlines() == drawn, (
        "The figure has changed: python docs/draw_result.py"
    )


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_a_command_and_its_options_exist(words, capsys):
    assert words[0] in COMMANDS
    assert run([words[0], "--help"]) == 0
    told = capsys.readouterr().out
    missing = [word for word in words if word.startswith("--") and word not in told]
    assert not missing


def test_every_command_named_in_the_text_exists():
    named = set(re.findall(r"`jbw\s+([a-z]+)", TEXT))
    assert named <= set(COMMANDS)


def test_links_lead_to_files():
    local = [link for link in re.findall(r"\]\(([^)]+)\)", TEXT) if "://" not in link]
    assert local
    assert [link for link in local if not (ROOT / link).exists()] == []


def test_python_names_public_things():
    (source,) = [block for kind, block in BLOCKS if kind == "python"]
    named = {
        node.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "jbw"
    }
    assert named <= {*jbw.__all__, "enable_x64"}
