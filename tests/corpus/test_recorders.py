"""The table of recorders: each says what it rests on, and none takes another's files."""

import importlib.util
import re
from importlib import import_module
from pathlib import Path

import pytest
from corpus.dialects import DIALECTS

from jbw.measurement.files.read import READERS
from jbw.measurement.recorders import modules, recorders

ROOT = Path(__file__).parents[2]


def script():
    """The script of the documentation that writes the table."""
    spec = importlib.util.spec_from_file_location(
        "recorders_table", ROOT / "docs" / "recorders_table.py"
    )
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", modules())
def test_a_docstring_states_every_fact(name):
    made = script()
    found = made.facts_of(import_module(name).__doc__ or "")
    assert set(found) == {"Recorder", *made.FACTS}
    suffixes = re.findall(r"\.\w+", found["Files"])
    assert set(suffixes) <= set(READERS)


def test_the_page_has_the_table_as_it_is():
    made = script()
    page = made.PAGE.read_text(encoding="utf-8")
    assert made.with_table(page) == page, "python docs/recorders_table.py --write"


def test_every_recorder_has_a_dialect_in_the_corpus():
    assert {each.name for each in recorders()} == {d.recorder for d in DIALECTS.values()} - {""}
