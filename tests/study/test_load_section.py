"""The section of a run's report on other loads: what it shows, and what it never shows."""

import numpy as np
import pytest
from made_runs import a_test, a_tree, spread

from jbw.report.load_section import FILE, FOLDER, load_rows, load_section
from jbw.run.files import hash_of
from jbw.study.store import save_loads
from jbw.study.study import Study


@pytest.fixture(scope="module")
def found():
    study = Study(a_tree(spread(), seen=[a_test(0.1)]), {})
    return {
        "resonance": study.resonance([0.1, 0.2], draws=8),
        "response at 0.1 V": study.response_curve(0.1, (15.0, 25.0), draws=8),
    }


@pytest.fixture
def run(found, tmp_path):
    """A run's folder with predictions by its posterior, of which the hash alone is looked at."""
    (tmp_path / "posterior.nc").write_bytes(b"draws")
    (tmp_path / FOLDER).mkdir()
    rows = [row for name, dataset in found.items() for row in load_rows(name, dataset)]
    save_loads(tmp_path / FOLDER, found, rows, hash_of(tmp_path / "posterior.nc"))
    return tmp_path


def test_a_run_without_predictions_has_no_such_section(tmp_path):
    assert load_section(tmp_path) is None


def test_every_number_and_curve_is_shown(run, found):
    section = load_section(run)
    assert section is not None
    rows = section.table.sections[0].rows
    medians = {(r.level, r.quantity): r.median for r in rows}
    frequency = found["resonance"]["frequency"].sel(quantile=0.5, method="nearest").values
    assert [medians[level, "frequency"] for level in (0.1, 0.2)] == pytest.approx(frequency)
    assert all(np.isfinite(row.median) for row in rows)
    assert [figure["svg"][:4] for figure in section.figures] == ["<svg", "<svg"]
    assert "99 %" in section.remark


def test_predictions_with_an_earlier_posterior_are_named_and_not_shown(run):
    (run / "posterior.nc").write_bytes(b"other draws")
    section = load_section(run)
    assert section is not None
    assert not section.figures
    assert not section.table.rows
    assert "earlier posterior" in section.remark


def test_damaged_predictions_never_cost_the_report(run):
    (run / FOLDER / FILE).write_bytes(b"no file of numbers")
    section = load_section(run)
    assert section is not None
    assert not section.figures
    assert "cannot be read" in section.remark
