"""What a watch shows and how its command ends, by given readings."""

import numpy as np
import pytest
from matplotlib.collections import FillBetweenPolyCollection
from scipy.stats import t as student

from jbw.cli import progress, run
from jbw.report.changes import watch_figure
from jbw.results.watch import WatchLine, WatchSettings

SETTINGS = WatchSettings(reference=5, amplitudes=[1e-3], unit="m", false_alarms=1e-3)
REFUSED, ALARM, QUIET = (
    WatchLine(kind="refused"),
    WatchLine(kind="watched", alarm="drift"),
    WatchLine(kind="watched"),
)


@pytest.mark.parametrize(
    ("added", "code"),
    [([QUIET], 0), ([QUIET, REFUSED], 3), ([ALARM, QUIET], 6), ([REFUSED, ALARM], 6)],
)
def test_an_alarm_ends_with_six_and_a_refused_record_alone_with_three(
    tmp_path, monkeypatch, added, code
):
    added = [line.replaced(record="a.csv", values=[20.0, -5.0]) for line in added]
    monkeypatch.setattr("jbw.watch.watch.watch", lambda *_, **__: (SETTINGS, [], added))
    monkeypatch.setattr(progress, "prepare_process", lambda: None)
    assert run(["watch", str(tmp_path)]) == code


def test_the_band_is_that_of_a_further_reading_of_the_references():
    """Of n readings a further one lies within t_(n-1) s sqrt(1 + 1/n) of their mean."""
    hz = np.array([20.1, 19.9, 20.3, 20.0, 19.8])
    readings = [WatchLine(kind="reading", values=[x, -5.0]) for x in hz]
    panel = watch_figure(SETTINGS, readings)[0, 0]
    (band,) = (c for c in panel.collections if isinstance(c, FillBetweenPolyCollection))
    ends = band.get_paths()[0].vertices[:, 1]
    reach = student.ppf(0.995, 4) * hz.std(ddof=1) * np.sqrt(1 + 1 / 5)
    assert (ends.min(), ends.max()) == pytest.approx((hz.mean() - reach, hz.mean() + reach))
