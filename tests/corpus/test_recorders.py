"""The table of recorders: each says what it rests on, and none takes another's files."""

import importlib.util
import re
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from corpus.dialects import DIALECTS

from jbw.measurement import recorders as package
from jbw.measurement.files.read import READERS, read
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


GUEST = '''"""A guest."""

from dataclasses import replace

from jbw.measurement.recorders.recorder import top
from jbw.measurement.recorders.recorder import Recorder


def read(contents):
    told = {name: replace(item, fs=50.0, unit="g") for name, item in top(contents).items()}
    return replace(contents, root=told)


RECORDER = Recorder("guest", lambda contents: "zz_counts" in top(contents), read)
'''


def test_a_recorder_is_added_by_one_file(tmp_path, monkeypatch):
    (tmp_path / "zz_guest.py").write_text(GUEST)
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    package.modules.cache_clear()
    package.recorders.cache_clear()
    try:
        np.savez(tmp_path / "a.npz", zz_counts=np.sin(np.arange(500.0)))
        (record,) = read(tmp_path / "a.npz", {"acceleration": "zz_counts"})
    finally:
        package.modules.cache_clear()
        package.recorders.cache_clear()
        sys.modules.pop("jbw.measurement.recorders.zz_guest", None)
    assert record.fs == 50.0
    np.testing.assert_allclose(
        record.channels["acceleration"], 9.80665 * np.sin(np.arange(500.0)), rtol=1e-12
    )
