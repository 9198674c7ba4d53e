"""What users can call is held in `public_names.json`; what leaves needs a reason.

A name, or a function of one of the paper's equations, may leave only by a line of the changelog,
under "Removed" of the unreleased version, that has it in code font and says why. New names are
added by

    python tests/test_public_names.py
"""

import json
import re
from importlib import import_module
from pathlib import Path

import pytest

import jbw
from jbw.paper.table import LAST, equations, numbers, rows_of

FILE = Path(__file__).with_name("public_names.json")
CHANGELOG = Path(__file__).parents[1] / "CHANGELOG.md"
MODULES = {
    "jbw": "jbw",
    "jbw.conventions": "jbw.oscillator.conventions",
    "jbw.excitation": "jbw.oscillator.excitation",
    "jbw.forced": "jbw.forced",
    "jbw.plots": "jbw.report.plots",
    "jbw.laws": "jbw.oscillator.laws",
    "jbw.paper": "jbw.paper",
    "jbw.rig": "jbw.rig",
    "jbw.sampling": "jbw.inference.sampling",
    "jbw.steps": "jbw.identification.paper.steps",
}


def names_today():
    """Public names of every public module."""
    found = {}
    for name, home in MODULES.items():
        module = import_module(home)
        homes = {n: getattr(value, "__module__", "") for n, value in vars(module).items()}
        ours = [n for n in homes if n[0] != "_" and homes[n].startswith("jbw.oscillator")]
        found[name] = sorted(getattr(module, "__all__", ours))
    return found


def equations_today():
    """Functions of every equation of the paper."""
    found = {}
    for row in equations():
        found.setdefault(str(row.number), []).append(row.function)
    return found


def removed():
    """Names in code font under "Removed" of the unreleased version."""
    unreleased = CHANGELOG.read_text(encoding="utf-8").partition("## [Unreleased]")[2]
    section = unreleased.partition("\n## ")[0].partition("### Removed")[2].partition("\n### ")[0]
    return set(re.findall(r"`([\w.]+)`", section))


HELD = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


@pytest.mark.parametrize("module", MODULES)
def test_no_public_name_leaves_in_silence(module):
    gone = {f"{module}.{name}" for name in HELD["names"][module]}
    gone -= {f"{module}.{name}" for name in names_today()[module]}
    assert gone <= removed(), 'Name what leaves, with its reason, under "Removed" in CHANGELOG.md.'


@pytest.mark.parametrize("module", MODULES)
def test_every_public_name_is_held_and_there(module):
    new = set(names_today()[module]) - set(HELD["names"][module])
    assert not new, "Add them: python tests/test_public_names.py"
    loaded = import_module(MODULES[module])
    assert [name for name in names_today()[module] if not hasattr(loaded, name)] == []


def test_every_equation_of_the_paper_has_its_function():
    assert {row.number for row in equations()} == set(range(1, LAST + 1))


def test_no_function_of_an_equation_leaves_in_silence():
    today = equations_today()
    gone = {
        name for number, names in HELD["equations"].items() for name in names
        if name not in today.get(number, ())
    }  # fmt: skip
    assert gone <= removed()


def test_every_function_of_the_paper_says_where_it_stands():
    from jbw import paper

    helpers = {"Equation", "equations", "STEP_SIZE"}
    records = {"Smoothing", "EquivalentResponse", "Terms", "Lines", "VolterraResponse", "Repeats"}
    section = re.compile(r"Reference:\n\s+Section 3\.2")
    silent = [
        name
        for name in paper.__all__
        if name not in helpers | records | {"Walk"}
        and not rows_of(name, getattr(paper, name).__doc__)
        and not section.search(getattr(paper, name).__doc__)
    ]
    assert silent == []


def test_references_are_read_as_they_are_written():
    said = """Something.

    Reference:
        Eqs. (3)-(5), (9), corrected: a sign,
        which changes.
        Eq. (7), as printed for unit weight.
    """
    rows = rows_of("f", said)
    assert [row.number for row in rows] == [3, 4, 5, 9, 7]
    assert rows[0].status == "corrected"
    assert rows[0].note == "a sign, which changes"
    assert rows_of("f", "Nothing.") == []
    assert (rows[-1].status, rows[-1].note) == ("as printed", "for unit weight")
    assert rows_of("f", "A.\n\nReference:\n    Theory, section 4.\n") == []
    assert numbers("(10)-(13), (24)") == [10, 11, 12, 13, 24]


if __name__ == "__main__":
    jbw.enable_x64()
    text = json.dumps({"names": names_today(), "equations": equations_today()}, indent=1)
    FILE.write_text(text + "\n", encoding="utf-8")
