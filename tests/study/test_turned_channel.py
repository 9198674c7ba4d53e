"""A campaign whose input channel has its sign turned, and that states no gain: it is below zero."""

import h5py
import pytest
import toy_campaign

import jbw

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


def test_a_turned_channel_is_identified_with_a_gain_below_zero(tmp_path, monkeypatch):
    # The loop's force has no source that could be turned, and a gain of its own.
    driven = toy_campaign.CAMPAIGN.partition('[[test]]\nkind = "loop"')[0]
    monkeypatch.setattr(toy_campaign, "CAMPAIGN", driven.replace("gain = 15.0\n", ""))
    path = toy_campaign.write_toy(tmp_path, toy_campaign.PLAIN + toy_campaign.LAW)
    for name in tmp_path.glob("*.h5"):
        with h5py.File(name, "r+") as file:
            if "input" in file:
                file["input"][...] *= -1.0
    study = jbw.identify(jbw.load_campaign(path), seed=1, report=lambda _: None)
    rows = study.record["steps"]["joint"]["parameters"]
    # One step a sample is short: the parameters are off by a few of these sd, of 0.02 %.
    assert rows["gain"]["mean"] == pytest.approx(-toy_campaign.GAIN, rel=1e-3)
    for name, truth in toy_campaign.TRUTH.items():
        assert rows[name]["mean"] == pytest.approx(truth, rel=0.02)
    assert study.record["predictions"]["strong"]["nrmse"] < 0.1
