"""Every remedy that jbw can print: a line is pasted by a test, a command is one that there is."""

import ast
import re
from pathlib import Path

import click
import pytest
from pasted import CAMPAIGN, lines_of, pasted
from remedies import PASTED, bare_lines, commands, lines

from jbw.campaign.schema import parse
from jbw.cli import COMMANDS, cli
from jbw.identification.accuracy import another_law
from jbw.inference.posterior.remedies import more_draws
from jbw.inference.posterior.verdict import modes_findings
from jbw.measurement.faults.unlike_gains import unlike
from jbw.report.messages.findings import explanations
from jbw.report.messages.remedies import draw_more, put
from jbw.report.messages.words import words

TESTS = Path(__file__).parent
# Words that follow the name of the program in prose.
PROSE = {"makes", "never", "and", "in", "does", "then"}


def test_every_line_has_a_test_that_pastes_it():
    proposed = lines()
    assert proposed - set(PASTED) == set(), "a remedy without a case: add one, and a row to PASTED"
    assert set(PASTED) - proposed == set(), "a row of PASTED whose remedy is gone"


@pytest.mark.parametrize("where", sorted(set(PASTED.values())))
def test_the_tests_of_the_registry_are_there_and_paste(where):
    file, _, name = where.partition("::")
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    (test,) = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == name)
    called = {ast.unparse(n.func) for n in ast.walk(test) if isinstance(n, ast.Call)}
    assert called & {"pasted", "lines_of", "with_line", "PUT.findall"}


CURVE = """kind = "frf"
files = "frf.h5"
channels = { frequency = "f", force = "F", displacement = "x", phase = "p" }
units = { frequency = "Hz", force = "N", displacement = "m", phase = "rad" }"""
# Tables that hold a key which a driven test has not; parts of `matrices` are in test_joint_tables.
OF_CURVES, OF_MATRICES = {"gaps", "units"}, {"dofs", "mass", "stiffness", "tip"}


# The code is searched within a test: every process that collects the tests would search it.
def test_a_line_in_plain_words_is_taken():
    """A whole line without backquotes, in the place of the one that the table has."""
    for _, key, line in sorted(bare_lines()):
        if key not in OF_MATRICES:
            take(key, line)


def take(key, line):
    """Parse a campaign file with a line in the place of its key."""
    test = CURVE if key in OF_CURVES else CAMPAIGN["[test]"]
    kept = "\n".join(one for one in test.splitlines() if not one.startswith(f"{key} ="))
    beside = {  # what such a table holds besides
        "units": '{ frequency = "Hz", force = "N", displacement = "m",',
        "channels": '{ input = "u",',
    }
    added = line.replace("{", beside.get(key, "{"))
    tables = {"campaign": CAMPAIGN["campaign"], "[test]": kept}
    table = "identify" if key in ("sampler", "profiles") else "[test]"
    tables[table] = f"{tables.get(table, '')}\n{added}"
    parse("\n".join(f"[{name}]\n{lines}" for name, lines in tables.items()))


def options_of(command):
    """Every option that a command and its own commands take."""
    found = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
    inner = getattr(command, "commands", {})
    return found.union(*(options_of(each) for each in inner.values()))


def test_every_command_that_is_named_is_one():
    for where, command, options in sorted(commands()):
        if command not in PROSE:
            assert_is_one(where, command, options)


def assert_is_one(where, command, options):
    assert command in COMMANDS, where
    found = cli.get_command(click.Context(cli), command)
    assert found is not None
    named = {word for word in options.split() if word.startswith("-")}
    assert named <= options_of(found), where


def test_a_factor_is_pasted():
    """Of the channel that drives the test: another role would be refused."""
    for factor in (-1.0, 9.80665):
        (test,) = pasted(unlike(factor, "input", "sweep").remedy).tests
        assert test.scale == pytest.approx({"input": factor}, rel=1e-3)
        assert "scale = { force" in lines_of(unlike(factor, "force", "sweep").remedy)[0][1]


def crossing():
    """Two chains, each in a mode of its own."""
    import numpy as np

    x = np.random.default_rng(0).standard_normal((4, 500))
    x[2:] += 40.0
    (finding,) = modes_findings({"x": x})
    return finding.action


# What findings of a run end with, each made by the function that they all call.
OF_A_RUN = {
    "accuracy laws": (another_law(("bouc_wen",)), lambda c: c.laws == ("bouc_wen", "cubic")),
    "accuracy substeps": (put("identify", "substeps", 4), lambda c: c.settings.substeps == 4),
    "equivalent laws": (
        put("joint", "laws", ["quadratic_damping"]), lambda c: c.laws == ("quadratic_damping",)
    ),
    "no joint": (put("joint", "laws", []), lambda c: c.laws == ()),
    "residuals": (put("[test]", "residuals", "none"), lambda c: c.tests[0].residuals == "none"),
    "modes": (crossing(), lambda c: c.settings.sampler == "tempered_smc"),
    "draws": (
        draw_more(**more_draws(1000, 200.0, 400.0)), lambda c: c.settings.num_samples == 2000
    ),
    "offsets": (put("identify", "offsets", "runs"), lambda c: c.settings.offsets == "runs"),
}  # fmt: skip


@pytest.mark.parametrize("what", OF_A_RUN)
def test_a_line_of_a_finding_is_taken(what):
    action, holds = OF_A_RUN[what]
    assert lines_of(action)
    assert holds(pasted(action))


WHOLE_LINE = re.compile(r"`(\w+ = [^`]+)`")
OF_A_PAGE = sorted({x for page in (*explanations().values(), *words().values())
                    for x in WHOLE_LINE.findall(" ".join(page.split()))})  # fmt: skip


@pytest.mark.parametrize("line", OF_A_PAGE)
def test_a_line_of_a_page_is_taken(line):
    """Of `jbw explain`: under the table that has its key, as the page says beside it."""
    table = "joint" if line.startswith("laws") else "identify"
    assert pasted(f"Put under [{table}]: `{line}`.")
