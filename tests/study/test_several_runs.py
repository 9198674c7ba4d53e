"""Several runs of known posteriors: order, trend with torque and its interval, by closed forms."""

import json

import numpy as np
import pytest
from scipy.stats import norm, t
from test_run_differences import write_run

from jbw.cli import run
from jbw.errors import ConfigError
from jbw.study.several_runs import side_by_side

HZ = 2 * np.pi


def runs(folder, hz_by_torque, sd_hz=0.01, **more):
    """A run for every torque, whose frequency has the same standard deviation everywhere."""
    folders = []
    for name, (torque, hz) in zip("abcdefgh", hz_by_torque, strict=False):
        path = write_run(folder / name, (HZ * hz, HZ * sd_hz), **more)
        summary = json.loads((path / "summary.json").read_text())
        assembly = {} if torque is None else {"torque": torque}
        (path / "summary.json").write_text(json.dumps(summary | {"assembly": assembly}))
        folders.append(path)
    return folders


def frequency_trend(record):
    return next(row for row in record.trends if row.name == "frequency")


def test_the_slope_of_posteriors_about_a_line_is_that_of_least_squares(tmp_path):
    """A doubling adds 1 Hz: its interval is +-2.576 sd / sqrt(sum of squared doublings)."""
    compared = side_by_side(runs(tmp_path, [(8, 31.0), (2, 29.0), (16, 32.0), (4, 30.0)]))
    assert [r.torque for r in compared[0].runs] == [2, 4, 8, 16]
    trend = frequency_trend(compared[0])
    sd = 0.01 / np.sqrt(2 * 0.5**2 + 2 * 1.5**2)
    # 200 draws a run: quantiles of 0.5 % lie between the first two; means to 4 sd / sqrt(200).
    assert trend.per_doubling[1] == pytest.approx(1.0, abs=4 * sd / np.sqrt(200))
    reach = np.subtract(*trend.per_doubling[::-2]) / 2
    assert reach == pytest.approx(norm.ppf(0.995) * sd, rel=0.25)
    assert trend.direction == "rises"
    assert trend.p > 0.5
    middle = compared[1]["frequency"].sel(quantile=0.5).values
    damped = {row.damping[1] for row in compared[0].readings}
    assert list(damped) == pytest.approx([1.0] * len(damped), rel=1e-3)  # per cent
    # Damping of 1 % is of no account: the curve is of omega_n.
    np.testing.assert_allclose(
        middle, np.array([[29.0], [30], [31], [32]]) * np.ones(20), rtol=1e-3
    )


def test_runs_that_scatter_about_the_line_widen_its_interval_as_student_does(tmp_path):
    hz = [30.0, 31.0, 30.4, 31.6]
    compared = side_by_side(runs(tmp_path, zip((1, 2, 4, 8), hz, strict=True)))
    away = np.arange(4) - 1.5
    slope = away @ hz / 5.0
    left = np.array(hz) - np.mean(hz) - slope * away
    deviation = np.sqrt(left @ left / 2 / 5.0)
    trend = frequency_trend(compared[0])
    reach = np.subtract(*trend.per_doubling[::-2]) / 2
    # The posteriors' own share is 1 % of it.
    assert reach == pytest.approx(t.ppf(0.995, 2) * deviation, rel=0.02)
    assert trend.p < 1e-6
    assert trend.direction == ""
    assert any("deviate from a straight line" in x for x in compared[0].statements)


def test_a_rise_from_run_to_run_is_one_although_no_line_follows_it(tmp_path):
    compared = side_by_side(runs(tmp_path, [(1, 30.0), (2, 30.1), (4, 33.0)]))
    trend = frequency_trend(compared[0])
    assert trend.per_doubling[0] < 0.0  # one degree of freedom
    assert trend.direction == "rises"


def test_runs_without_torques_stand_as_given_and_show_no_trend(tmp_path):
    compared = side_by_side(runs(tmp_path, [(None, 31.0), (2, 30.0), (4, 32.0)]))
    assert [row.name for row in compared[0].runs] == ["a", "b", "c"]
    assert compared[0].trends == []
    assert any("State `torque`" in sentence for sentence in compared[0].statements)


def test_two_torques_of_three_runs_have_a_trend_and_equal_ones_none(tmp_path):
    (tmp_path / "two").mkdir()
    trend = frequency_trend(side_by_side(runs(tmp_path / "two", [(2, 30), (2, 30), (4, 31)]))[0])
    assert trend.per_doubling[1] == pytest.approx(1.0, abs=0.01)
    assert side_by_side(runs(tmp_path, [(2, 30), (2, 31), (2, 32)]))[0].trends == []


def test_a_run_without_backbone_is_named(tmp_path):
    folders = runs(tmp_path, [(1, 30.0), (2, 30.5)])
    folders.append(write_run(tmp_path / "other", (190.0, 1.0), laws="cubic"))
    with pytest.raises(ConfigError, match="other lacks the parameters"):
        side_by_side(folders)


def test_the_command_prints_a_row_a_run_and_draws_them(tmp_path, capsys):
    folders = [str(path) for path in runs(tmp_path, [(8, 31.0), (2, 29.0), (4, 30.0)])]
    assert run(["diff", *folders, "--figure", str(tmp_path / "diff.png")]) == 0
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines() if line.strip()]
    assert [row[0] for row in rows if row[0] in "abc"] == list("bca")
    assert "the frequency rises with torque: 1.000" in printed
    assert (tmp_path / "diff.png").read_bytes().startswith(b"\x89PNG")
    assert run(["diff", *folders, "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["readings"]) == 6
