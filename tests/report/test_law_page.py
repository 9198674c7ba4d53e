"""The page of laws: points that lie on the curve of the law that made them, scores, and why."""

import numpy as np
import pytest
import xarray as xr

from jbw.report.law_table import law_order, laws_table
from jbw.report.laws import law_backbones, laws_sheet, render_laws
from jbw.report.messages.laws import not_distinguished
from jbw.results.laws import StoredLaws

HOSTILE = "<script>alert(1)</script> $x_{"
LAWS = ("bouc_wen", "cubic", "linear", "iwan4", "masing_power", HOSTILE)
AMPLITUDE = np.linspace(1e-4, 5e-3, 40)


def frequency_of(law, y):
    """Falls by 1 Hz over 5 mm under the first law, by its place more under the others."""
    return 20.0 - (1 + LAWS.index(law)) * y / 5e-3


def row(answer, elpd, error):
    keys = ("error_left_out", "error_highest", "error_held_out", "error_beyond", "weight",
            "elpd_difference", "elpd_difference_se", "log_evidence", "log_evidence_difference",
            "log_evidence_error")  # fmt: skip
    return dict.fromkeys(keys) | {
        "answer": answer, "elpd": elpd, "error": error, "num_parameters": 5,
    }  # fmt: skip


@pytest.fixture
def record():
    answers = ("best", "not told apart", "worse", "worse", "worse", "worse")
    rows = {
        law: row(answer, -10.0 * i, 0.01 * (1 + i))
        for i, (law, answer) in enumerate(zip(LAWS, answers, strict=True))
    }
    return StoredLaws.read({
        "campaign": HOSTILE,
        "laws": dict(reversed(rows.items())),
        "line": None,
        "refused": {"jenkins_3": HOSTILE},
        "statements": ["Best is bouc_wen, by what each law predicts."],
    })  # fmt: skip


@pytest.fixture
def comparison():
    band = np.array([-0.02, 0.0, 0.02])[:, None]
    curves = xr.Dataset(
        {
            "frequency": (("law", "quantile", "amplitude"),
                          [frequency_of(law, AMPLITUDE) + band for law in LAWS]),
            "damping": (("law", "quantile", "amplitude"),
                        [0.01 + 0.0 * AMPLITUDE + 0.01 * band for _ in LAWS]),
        },
        {"law": list(LAWS), "amplitude": AMPLITUDE},
        {"y_fitted": 4e-3},
    )  # fmt: skip
    y = np.array([1e-3, 2e-3, 3e-3])
    decay = xr.Dataset(
        {"y": ("reading", y), "frequency_hz": ("reading", frequency_of("bouc_wen", y)),
         "damping": ("reading", np.full(3, 0.01))},
        attrs={"test": "decay", "kind": "decay", "fitted": 1},
    )  # fmt: skip
    scores = xr.Dataset({"error": (("law", "run"), np.ones((len(LAWS), 2)))},
                        {"law": list(LAWS), "run": ["a", "b"]})  # fmt: skip
    return xr.DataTree.from_dict({"/curves": curves, "/scores": scores, "/look/decay": decay})


def test_points_lie_on_the_backbone_of_the_law_that_made_them(comparison, record):
    axes = law_backbones(comparison, record, law_order(record)[:2])
    assert axes.shape == (2, 2)
    away = []
    for ax in axes[:, 0]:
        (median,) = [line for line in ax.lines if line.get_label() == "median of the law"]
        (points,) = [line for line in ax.lines if line.get_label() == "decay"]
        x, measured = points.get_data()
        np.testing.assert_allclose(x, [1.0, 2.0, 3.0])
        away.append(np.max(np.abs(np.interp(x, *median.get_data()) - measured)))
    # A straight line is interpolated to round-off; the second law falls twice as fast.
    assert away[0] < 1e-9
    assert away[1] == pytest.approx(3e-3 / 5e-3, rel=1e-9)
    # All laws at one scale, which holds the best law and the points.
    assert axes[0, 0].get_ylim() == axes[1, 0].get_ylim()
    assert "preferred" in axes[0, 0].get_title(loc="left")


def test_the_page_has_scores_the_preferred_law_and_why(comparison, record):
    page = render_laws(comparison, record)
    assert f"is the preferred law{not_distinguished(['cubic'])}." in page
    assert page.index("preferred law") < page.index("Best is bouc_wen") < page.index("Scores")
    assert page.count("<figure") == 3  # four laws, the other two, and the loops folded
    assert "The other laws" in page
    assert "could not be judged" in page
    assert "<script" not in page.lower()
    assert 'src="http' not in page
    assert laws_sheet(record).status.kind == "doubt"
    laws = {law: row.replaced(answer="worse") for law, row in record.laws.items()}
    laws["bouc_wen"] = laws["bouc_wen"].replaced(answer="best")
    assert laws_sheet(record.replaced(laws=laws)).status == ("bouc_wen", "good")


def test_a_comparison_without_readings_has_its_page(comparison, record):
    del comparison["look"]
    assert "Scores" in render_laws(comparison, record)


def test_the_preferred_law_stands_first_whatever_the_scores_of_few_runs():
    row = {"log_evidence": 0.0}
    laws = {
        "high": {**row, "elpd": 500.0, "answer": "worse"},
        "low": {**row, "elpd": -10.0, "answer": "not told apart"},
        "chosen": {**row, "elpd": 0.0, "answer": "best"},
    }
    assert law_order(StoredLaws.read({"laws": laws})) == ["chosen", "high", "low"]


def test_the_worst_kind_of_test_stands_for_all_that_others_predict():
    law = {"answer": "best", "error_across": {"sweeps": 0.04, "loops": 0.31}}
    shown = laws_table(StoredLaws.read({"laws": {"cubic": law}}))
    (column,) = [column for column in shown.columns if column.heading == "other kinds [%]"]
    assert column.cell(shown.rows[0]).text == "31"
