"""A page for every finding that the package can make."""

import ast
from pathlib import Path

import pytest

from jbw.cli import run
from jbw.cli.about import explained
from jbw.oscillator.laws import LAWS, vocabulary
from jbw.quantities import BY_NAME
from jbw.report.messages import tables
from jbw.report.messages.findings import FINDINGS, explanations
from jbw.report.messages.words import WORDS, words

PACKAGE = Path(__file__).parents[2] / "jbw"
JUDGES = (
    "inference",
    "identification",
    "verification",
    "study",
)  # campaign and measurement check data instead


def codes():
    """First argument of every finding in the source, where it is written out."""
    in_source = set()
    for path in (p for part in JUDGES for p in (PACKAGE / part).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(getattr(node, "func", None), "id", "")
            if name in ("Finding", "checked") and node.args:
                if isinstance(node.args[0], ast.Constant):
                    in_source.add(node.args[0].value)
            if name == "replace":
                new_codes = [word.value for word in node.keywords if word.arg == "code"]
                in_source |= {
                    constant.value for constant in new_codes if isinstance(constant, ast.Constant)
                }
    return in_source | {"ess_bulk", "ess_tail"}  # made in a loop


def test_every_finding_has_a_page_and_every_page_a_finding():
    assert codes() == set(explanations())


@pytest.mark.parametrize("code", sorted(explanations()))
def test_a_page_says_what_was_looked_at_and_what_to_do(code, capsys):
    assert run(["explain", code]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(code)
    assert "Check: " in printed
    assert "Remedy: " in printed


def test_an_unknown_code_is_answered_with_the_nearest(capsys):
    assert run(["explain", "rhat"]) == 2
    assert "Did you mean 'r_hat'?" in capsys.readouterr().err


def test_without_a_code_all_are_named(capsys):
    assert run(["explain"]) == 0
    lines = capsys.readouterr().out.splitlines()
    told = [line.split(maxsplit=1) for line in lines]
    assert [code for code, _ in told] == list(explanations())
    # What stands behind a code is the beginning of its page.
    for code, sentence in told:
        assert sentence in " ".join(explanations()[code].split())
        assert len(sentence.split()) >= 3, code


MAKERS = {"Column", "words", "named", "digits", "shares", "by_sd", "_number", "_percent", "number"}


def headings():
    """Every heading of a column in the source or in the catalogue, with where it is used."""
    in_source = {}
    for path in sorted([*PACKAGE.glob("report/*.py"), *PACKAGE.glob("cli/*.py")]):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if getattr(getattr(node, "func", None), "id", "") in MAKERS and node.args:
                heading = heading_of(node.args[0])
                if heading:
                    in_source[heading] = path.name
    return in_source


def heading_of(node):
    """A heading that is written out, or a constant of the catalogue; empty where it is built."""
    match node:
        case ast.Constant(value=text):
            return " ".join(str(text).split())
        case ast.Attribute(value=ast.Name(id="notes"), attr=name):
            return " ".join(getattr(tables, name).split())
    return ""


def test_there_are_headings_to_look_at():
    in_source = headings()
    assert len(in_source) > 60
    assert "RMS error / rms of the record" in in_source


def test_every_column_of_a_table_is_explained():
    missing = {heading: path for heading, path in headings().items() if not explained(heading)}
    assert not missing


def test_every_parameter_of_every_law_is_explained():
    names = {*vocabulary(), *BY_NAME}
    for name in names:
        explanation = explained(name)
        assert explanation, name
    for name, parameter in vocabulary().items():
        if name not in words():  # a word of its own is explained as that
            assert parameter.symbol in explained(name)
            assert parameter.unit == "1" or parameter.unit in explained(name)


@pytest.mark.parametrize(
    "word",
    [
        "nats",
        "direction",
        "valley",
        "contraction",
        "ESS",
        "Step 4",
        "held out",
        "k-hat",
        "R-hat",
        "usable",
        "half width",
    ],
)
def test_words_that_nobody_understood_are_explained(word, capsys):
    assert run(["explain", word]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(word)
    assert len(printed.split()) > 10


@pytest.mark.parametrize(
    ("slip", "nearest"), [("alhpa", "alpha"), ("contractoin", "contraction"), ("khatt", "khat")]
)
def test_an_unknown_word_is_answered_with_the_nearest_of_all(slip, nearest, capsys):
    assert run(["explain", slip]) == 2
    assert f"Did you mean '{nearest}'?" in capsys.readouterr().err


def test_no_word_is_explained_twice():
    names = [name.lower() for group in WORDS for name in group]
    assert len(names) == len(set(names))
    assert not set(names) & set(explanations())


def test_a_variant_belongs_to_a_finding_that_is_explained():
    for entry, message in FINDINGS.items():
        code, _, variant = entry.partition(".")
        assert code in explanations()
        assert bool(variant) != bool(message.explanation), entry


def test_a_parameter_at_a_joint_is_explained():
    assert explained("alpha@bolt_1") == explained("alpha")
    said = explained("motion_factor_2@bolt_1")
    assert said is not None
    assert said.startswith("Motion of bolt_1 in mode 2 relative to the structural model")
    assert explained("alpah@bolt_1") is None


@pytest.mark.parametrize("law", LAWS)
def test_every_law_is_explained_with_its_parameters_and_its_line(law):
    page = explained(law)
    assert all(quantity.name in page for quantity in LAWS[law].table)
    assert f'[joint] laws = ["{law}"]' in page
    assert len(page.splitlines()[0].split()) >= 3
