"""What a campaign states of its clock and sensors, in posterior.nc, summary.json and report."""

import numpy as np
import pytest
import toy_campaign

import jbw
from jbw.study.study import load_study

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

STATED = "fs_std = 5e-3\ngain_std = { velocity = 0.02 }\n"


def test_stated_instruments_widen_intervals_and_leave_predictions(tmp_path, monkeypatch):
    # The loop's sensors would be others.
    driven = toy_campaign.CAMPAIGN.partition('[[test]]\nkind = "loop"')[0]
    stated = driven.replace("gain = 15.0\n", STATED)
    assert stated != driven
    monkeypatch.setattr(toy_campaign, "CAMPAIGN", stated)
    path = toy_campaign.write_toy(tmp_path, toy_campaign.PLAIN + toy_campaign.LAW)
    study = jbw.identify(jbw.load_campaign(path), seed=1, report=lambda _: None)
    wide = study.tree["posterior"].to_dataset()
    narrow = study.tree["as_recorded"].to_dataset()

    def spread(draws):
        return float(draws.std() / draws.mean())

    # omega_n with the clock; delta, 1/m, with v by one sensor and t by the clock; gain, a over V,
    # with v and the clock too. Of 200 draws a standard deviation is known to 5 %.
    for name, own in (
        ("omega_n", 5e-3),
        ("delta", np.hypot(5e-3, 0.02)),
        ("gain", np.hypot(5e-3, 0.02)),
    ):
        expected = np.hypot(spread(narrow[name]), own)
        assert spread(wide[name]) == pytest.approx(expected, rel=0.2)
        row = study.record["steps"]["joint"]["parameters"][name]
        assert row["sd"] == pytest.approx(float(wide[name].std(ddof=1)), rel=1e-9)
    assert "zeta" not in narrow
    said = [s for s in study.record["steps"]["joint"]["statements"] if "Stated errors" in s]
    assert len(said) == 1
    assert "the clock (0.005), velocity (0.02); not stated: `gain_std` of input." in said[0]
    study.save(tmp_path / "run")
    assert "the clock (0.005)" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    # A prediction is what the same instruments would read: as narrow as by the records alone.
    band = load_study(tmp_path / "run", study.campaign).predict("strong", 50, noise=False)
    low, middle, high = band["model_band"].transpose("quantile", ...).values
    # The clock alone turns the phase by 5e-3 of hundreds of radians.
    assert np.max(high - low) < 0.02 * np.max(np.abs(middle))
