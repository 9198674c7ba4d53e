"""Names and order through a whole identification: equal numbers, and outputs that are readable."""

import html
import json

import pytest
from same_answers import differences
from scaled_campaigns import (
    NAMES,
    Scale,
    measured,
    renamed,
    reordered,
    with_names_back,
    write_campaign,
)

import jbw.cli.progress
from jbw.cli import run
from jbw.report.result import read_result

pytestmark = pytest.mark.slow
TESTS = ("held_curve", "pulled")
# Of a standard deviation: sums over repeats in another order end a fit elsewhere by its tolerance.
CLOSE = 1e-3


@pytest.fixture
def identified(tmp_path, monkeypatch):
    """The run folder of a campaign, by its name in the folder and the options of the command."""
    monkeypatch.setattr(jbw.cli.progress, "prepare_process", lambda: None)  # JAX is set up already

    def identified(campaign, name, *options):
        folder = tmp_path / name
        path = write_campaign(campaign, folder)
        out = folder / "run"
        assert run(["identify", str(path), "--out", str(out), "--seed", "0", *options]) == 0
        return out

    return identified


def summary(folder):
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("options", [("--quick",), pytest.param((), marks=pytest.mark.release)])
def test_names_and_order_change_no_answer(identified, options):
    campaign = measured(*TESTS)
    plain = identified(campaign, "plain", *options)
    expected = summary(plain)

    named = identified(renamed(campaign), "named", *options)
    assert run(["report", str(named)]) == 0
    assert differences(with_names_back(summary(named)), expected, Scale(), 0.0) == []
    page = (named / "report.html").read_text(encoding="utf-8")
    for name in (NAMES[test] for test in TESTS):
        assert name not in page  # its brackets would be a tag
        assert name in html.unescape(page)
    read_result(named)

    turned = identified(reordered(campaign), "turned", *options)
    rows = (one["steps"]["joint"]["parameters"] for one in (summary(turned), expected))
    assert differences(*rows, Scale(), CLOSE, ("parameters",)) == []
