"""A page for every finding that the package can make."""

import ast
from pathlib import Path

import pytest

from jbw.cli import run
from jbw.cli.about import pages

PACKAGE = Path(__file__).parents[2] / "jbw"
JUDGES = (
    "inference",
    "identification",
    "verification",
    "study",
)  # campaign and measurement check data instead


def codes():
    """First argument of every finding in the source, where it is written out."""
    found = set()
    for path in (p for part in JUDGES for p in (PACKAGE / part).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(getattr(node, "func", None), "id", "")
            if name in ("Finding", "checked") and node.args:
                if isinstance(node.args[0], ast.Constant):
                    found.add(node.args[0].value)
            if name == "replace":
                given = [word.value for word in node.keywords if word.arg == "code"]
                found |= {one.value for one in given if isinstance(one, ast.Constant)}
    return found | {"ess_bulk", "ess_tail"}  # made in a loop


def test_every_finding_has_a_page_and_every_page_a_finding():
    assert codes() == set(pages())


@pytest.mark.parametrize("code", sorted(pages()))
def test_a_page_says_what_was_looked_at_and_what_to_do(code, capsys):
    assert run(["explain", code]) == 0
    told = capsys.readouterr().out
    assert told.startswith(code)
    assert "Looked at: " in told
    assert "To do: " in told


def test_an_unknown_code_is_answered_with_the_nearest(capsys):
    assert run(["explain", "rhat"]) == 2
    assert "Did you mean 'r_hat'?" in capsys.readouterr().err


def test_without_a_code_all_are_named(capsys):
    assert run(["explain"]) == 0
    assert capsys.readouterr().out.split() == list(pages())
