"""The one list of what was fitted and what was held out, as a run stores it."""

import json

import jbw
from jbw.report.result import fitted_text
from jbw.report.tables import every_test
from jbw.results.run import RunSummary


def test_the_list_says_of_every_test_how_many_repeats_were_fitted(toy):
    """`strong` and `pull` are fitted, of three and of two repeats; see the toy's campaign."""
    study = jbw.load_study(toy / "run")
    summary = json.loads((toy / "run" / "summary.json").read_text())
    campaign = jbw.load_campaign(toy / "campaign.toml")
    rows = {row["test"]: row for row in summary["tests"]}
    assert list(rows) == [test.name for test in campaign.tests]
    for test in campaign.tests:
        assert rows[test.name]["repeats"] == len(test.records)
        assert 0 <= rows[test.name]["fitted"] <= len(test.records)
    assert any(row["fitted"] for row in rows.values())
    assert any(not row["fitted"] for row in rows.values())
    # No other part of the result says otherwise of any test.
    for name, part in summary["predictions"].items():
        assert bool(rows[name]["fitted"]) == part["fitted"]
    for path in ("look", "verification/frf", "verification/sweep"):
        for test in study.posterior[path].children.values():
            name = test.attrs.get("test", test.name)
            assert bool(rows[name]["fitted"]) == bool(test.attrs["fitted"]), path
    assert [row.test for row in every_test(RunSummary.read(summary), study.posterior)] == list(rows)


def test_a_comparison_says_whether_its_own_repeats_were_fitted(toy):
    study = jbw.load_study(toy / "run")
    summary = json.loads((toy / "run" / "summary.json").read_text())
    rows = {row["test"]: row for row in summary["tests"]}
    for name, test in study.posterior["verification/sweep"].children.items():
        row, is_seen = rows[name], bool(test.attrs["seen"])
        assert is_seen == (row["fitted"] == row["repeats"])
        words = "held out" if not row["fitted"] else "fitted" if is_seen else "held-out repeats"
        assert fitted_text(test.to_dataset()).endswith(words)
