"""What a cell shows of a campaign, a verdict and a study: short, the worst first, escaped."""

import re
import sys

import numpy as np
import pytest
import xarray as xr

from jbw.campaign.load import Campaign
from jbw.inference.posterior.finding import Finding, judge
from jbw.measurement.records import Record, Test
from jbw.study.study import Study, load_study

HOSTILE = "<script>alert('&')</script> "


def findings(count=30):
    told = [Finding("ess_bulk", "ok", "Enough.", 900.0)] * 11
    for i in range(count):
        status = "usable" if i % 2 else "failed"
        told.append(Finding("r_hat", status, 9 * HOSTILE, 2.0, f"Do {HOSTILE}."))
    return tuple(told)


def a_study():
    told = [
        {"code": f.code, "status": f.status, "reason": f.reason, "number": f.number,
         "action": f.action}
        for f in findings()
    ]  # fmt: skip
    facts = {"mean": 118.0, "sd": 0.1, "cv": 1e-3, "kl": 3.0, "q005": 117.0, "q995": 119.0}
    steps = {"joint": {"parameters": {"omega_n": {**facts, "unit": "rad/s"}}}}
    record = {"campaign": HOSTILE, "main": "joint", "steps": steps}
    record["verdict"] = {"status": "failed", "findings": told}
    return Study(xr.DataTree(), record)


def a_campaign(count=400):
    record = Record(64.0, {"input": np.zeros(9999), "velocity": np.zeros(9999)}, {})
    tests = tuple(Test("sweep", (record,) * 8, f"{HOSTILE}{i}", level=0.1) for i in range(count))
    return Campaign(HOSTILE, None, tests)


@pytest.mark.parametrize("make", [a_study, a_campaign, lambda: judge(findings())])
def test_a_cell_is_short_and_trusts_no_name(make):
    shown = make()
    page = shown._repr_html_()
    assert len(page.encode()) < 2000
    assert "<script" not in page
    assert "&lt;script" in page


def test_the_verdict_stands_on_top_and_what_fails_first():
    page = a_study()._repr_html_()
    assert re.match(
        r"<p style=[^>]*#d55e00[^>]*><b>Verdict: failed \(sampling failed\)</b></p>", page
    )
    assert page.index("<td>failed</td>") < page.index("11 of 41 checks passed")
    assert "<td>usable</td>" not in page[: page.index("<td>failed</td>")]
    said = repr(a_study()).splitlines()
    assert said[0] == "Verdict: failed (sampling failed)"
    assert "omega" in said[-1]


def test_a_cell_of_a_run_has_a_row_per_parameter_and_the_backbone(toy, monkeypatch):
    study = load_study(toy / "run")
    page = study._repr_html_()
    for name in study.table().index:
        assert f"<tr><td>{name}</td><td>" in page
    assert page.count('<img alt="Frequency and damping against amplitude" src="data:image/png') == 1
    monkeypatch.setitem(sys.modules, "jbw.report.plots", None)  # as where matplotlib is absent
    without = study._repr_html_()
    assert "<img" not in without
    assert page.startswith(without)


def test_a_printed_campaign_and_a_good_verdict_are_a_few_lines():
    said = repr(a_campaign(12)).splitlines()
    assert len(said) == 12
    assert said[-1] == "and 2 more"
    assert said[1].endswith("0: sweep, 8 records, level 0.1")
    good = judge(findings(0))
    assert repr(good) == "Verdict: ok (sampling ok)\n  11 of 11 checks passed"
    assert "<table>" not in good._repr_html_()
    assert "Study of" in repr(Study(xr.DataTree(), {"campaign": "x"}))
